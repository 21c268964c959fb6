# SPDX-License-Identifier: Apache-2.0
"""Screening where a little of an effect says nothing of more, in logs whose cause is known."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from waferbot_lockstep.timing import Timing
from waferbot_pmac.experiments import commanded_positions, load_experiment
from waferbot_pmac.i_variables import servo_parameters
from waferbot_twin.diagnosis.inference.nuisance import each_once, nuisance, prior_groups
from waferbot_twin.diagnosis.inference.settings import Settings
from waferbot_twin.diagnosis.proposals.offered import offered_effects
from waferbot_twin.diagnosis.proposals.periodogram import tuned_to
from waferbot_twin.diagnosis.proposals.screening import (
    Gain,
    candidates,
    screen,
    signatures,
)
from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant
from waferbot_twin.estimation.evidence import gain, log_evidence
from waferbot_twin.estimation.gauss_newton import all_signatures, fit_causes
from waferbot_twin.estimation.hypothesis import away_from_bounds, evaluate, in_quick_steps, lets_go
from waferbot_twin.models import load_model
from waferbot_twin.residuals.closed_loop_record import run_commanded
from waferbot_twin.residuals.from_recording import record_of_signals
from waferbot_twin.residuals.problem import Cause, Problem, apply_all

SEED = 20261122
TIMING = Timing()

pytestmark = pytest.mark.slow

BEYOND_DOUBT = 20.0
"""ln BF: odds of 5e8."""


def log_of(nominal: Variant, cause: Cause, experiment: str, noise: float = 0.5) -> Problem:
    """Return the problem of a noisy log of half a second of a machine with a cause."""
    print(f'seed {SEED}')
    variant = apply_all(nominal, [cause])
    parameters = servo_parameters(variant.pmac, variant.name)
    motion = load_experiment(experiment)
    commanded = commanded_positions(motion, parameters, TIMING.servo_hz)
    signals = run_commanded(variant, TIMING, commanded, TIMING.ticks(0.5))
    record = record_of_signals('log', signals)
    more = np.random.default_rng(SEED).normal(0.0, noise, record.reading.shape)
    steps = np.array([cause.values.get('step', 1.0), 1.0, 1.0, 1.0])  # of Y-Linear's encoder
    reading = steps * np.round((record.reading + more) / steps)
    return Problem(nominal, [replace(record, reading=reading)])


def quiet(what: str, done: int, total: int) -> None:
    """Show no progress."""


def best_screened(problem: Problem, *names: str, axis: str = 'y_rotate'):
    """Return what screening promises most of some effects on an axis."""
    base = evaluate(problem)
    effects = [find(name) for name in names]
    every = [item for item in candidates(problem, effects) if item.axis == axis]
    found = signatures(problem, base, every, 1, quiet)
    first, *_ = screen(problem, base, every, found, [], Settings().prior_scales)
    return first


def test_an_error_of_teeth_is_found_from_where_the_drive_has_let_go():
    nominal = Variant.of(load_model('rigid'))
    effect = find('transmission_error')
    true = Cause(effect, 'y_rotate', effect.typical(nominal, 'y_rotate'))
    problem = log_of(nominal, true, 'full_stroke_y_rotate')
    first = best_screened(problem, 'transmission_error', 'encoder_eccentricity', 'backlash')
    assert (first.cause.name, first.cause.values['order']) == (true.name, true.values['order'])
    # It is in proportion once there is a little, so that a fit gets from there to the truth.
    names = ('cosine', 'sine')
    little = np.array([first.cause.values[name] for name in names])
    asked = dict(zip(names, little + first.value[:2], strict=True))
    (found,) = fit_causes(problem, (first.cause.with_values(asked),)).causes
    for name in names:
        assert found.values[name] == pytest.approx(true.values[name], rel=0.02)


def test_a_soft_belt_promises_what_it_gains_in_the_size_that_is_tried():
    nominal = Variant.of(load_model('rigid'))
    effect = find('belt_compliance')
    true = Cause(effect, 'y_rotate', effect.typical(nominal, 'y_rotate'))
    problem = log_of(nominal, true, 'random_y_rotate')
    first = best_screened(problem, 'belt_compliance', 'coulomb_friction', 'cogging')
    assert first.cause.name == true.name
    assert first.score > BEYOND_DOUBT
    assert gain(evaluate(problem, (first.cause,)), evaluate(problem)) > BEYOND_DOUBT


def test_what_lets_a_part_go_is_judged_in_its_own_noise():
    """
    What it gains as it is counts as that of two models of which each has the noise that it leaves.

    In the noise of the rigid model alone a true belt promised nothing in the demonstration: it left 23
    of 641 counts of the load's error but, where the motor's friction lacks as well, 121 for 23 of the
    motor's.
    """
    nominal = Variant.of(load_model('rigid'))
    belt, teeth = find('belt_compliance'), find('transmission_error')
    true = Cause(belt, 'y_rotate', belt.typical(nominal, 'y_rotate'))
    problem = log_of(nominal, true, 'random_y_rotate')
    friction = Cause(find('coulomb_friction'), 'y_rotate', {'friction': 1.0})
    assert lets_go(problem, (), true)
    assert lets_go(problem, (friction,), true)
    assert not lets_go(problem, (true,), Cause(belt, 'y_rotate', {'compliance': 1e-6}))
    assert not lets_go(problem, (), friction)
    base = evaluate(problem, (friction,))
    every = [
        cause
        for cause in candidates(problem, [belt, teeth, find('coulomb_friction')])
        if cause.axis == 'y_rotate' and any(cause.values.values())
    ]
    changes = signatures(problem, base, every, 1, quiet)
    quick, begun = in_quick_steps(problem, base)
    for cause, change in zip(every, changes, strict=True):
        if cause.effect is not belt:
            assert change.own is None
            continue
        model = evaluate(quick, (friction, cause))
        without = replace(begun, fits=quick.judge(begun.residuals))
        assert change.own.score == pytest.approx(gain(model, without), rel=1e-6)
    # Beside another cause of the plant it would be another gain.
    other = evaluate(problem, (friction.with_values({'friction': 2.0}),))
    trial = next(place for place, cause in enumerate(every) if cause.effect is belt)
    much = replace(changes[trial], own=Gain(1e3, 1e3))
    for beside, counts in ((base, True), (other, False)):
        (found,) = screen(problem, beside, [every[trial]], [much], [], Settings().prior_scales)
        assert (found.score > 900.0) == counts


def test_what_carries_a_cause_does_alone_is_no_evidence_for_it():
    """
    An error of teeth takes a spring where the model is rigid: here the spring is true, the error is not.

    In a log of another simulator an error of 0.2 urad had the evidence of its spring, 26.
    """
    nominal, teeth = Variant.of(load_model('rigid')), find('transmission_error')
    true = Cause(teeth, 'y_rotate', {'cosine': 0.0, 'sine': 1e-12, 'order': 1.0}, ('order',))
    problem = log_of(nominal, true, 'random_y_rotate')
    nothing = evaluate(problem)
    found = fit_causes(problem, (true.with_values({'sine': 1e-6}),))
    assert gain(found, nothing) > BEYOND_DOUBT
    assert log_evidence(problem, found, nothing, Settings().prior_scales) < 0.0


def test_the_step_of_a_coarse_encoder_is_tried_as_it_is():
    nominal = Variant.of(load_model('rigid'))
    true = Cause(find('coarse_quantisation'), 'y_linear', {'step': 16.0})
    problem = log_of(nominal, true, 'step')
    (effect,) = (item for item in offered_effects(problem, []) if item.name == true.effect.name)
    (cause,) = candidates(problem, [effect])
    assert (cause.name, cause.values, cause.free) == (true.name, true.values, 0)
    base = evaluate(problem)
    found = signatures(problem, base, [cause], 1, quiet)
    (first,) = screen(problem, base, [cause], found, [], Settings().prior_scales)
    found = fit_causes(problem, (first.cause,))
    assert first.score > BEYOND_DOUBT
    assert gain(found, base) > BEYOND_DOUBT
    assert found.log_likelihood - base.log_likelihood > 500.0


def test_whole_steps_are_likelier_of_an_encoder_that_has_nothing_between():
    nominal = Variant.of(load_model('rigid'))
    effect = find('coarse_quantisation')
    problem = log_of(nominal, Cause(effect, 'y_linear', {'step': 16.0}), 'step')

    def gained(step: float) -> float:
        with_steps = evaluate(problem, (Cause(effect, 'y_linear', {'step': step}),))
        return with_steps.log_likelihood - evaluate(problem).log_likelihood

    samples = len(evaluate(problem).residuals['plant'][0]) - problem.noises('plant')[0].order
    # what is predicted, the middle of a step, moves with the step, and no observer minds
    for step in (2.0, 4.0, 8.0, 16.0):
        assert gained(step) == pytest.approx(samples * math.log(step), rel=0.01)
    for step in (3.0, 12.0, 17.0, 32.0):  # readings are no multiples of these
        assert gained(step) == pytest.approx(0.0, abs=0.01 * samples)


def test_friction_that_sticks_is_known_from_other_dry_friction_by_what_it_holds():
    nominal = Variant.of(load_model('rigid'))
    effect = find('direction_dependent_friction')
    true = Cause(effect, 'y_linear', effect.typical(nominal, 'y_linear'))
    problem = log_of(nominal, true, 'swept_sine_y_linear')
    dry, steady = (
        Cause(find(name), 'y_linear', find(name).typical(nominal, 'y_linear'))
        for name in effect.same_as
    )
    found = fit_causes(problem, (dry, steady))
    for name in ('presliding', 'stribeck_friction'):
        other = Cause(find(name), 'y_linear', find(name).typical(nominal, 'y_linear'))
        assert found.log_likelihood > fit_causes(problem, (other, steady)).log_likelihood
    dry, steady = found.causes
    forward, backward = true.values.values()
    assert dry.values['friction'] == pytest.approx(0.5 * (forward + backward), rel=0.02)
    assert steady.values['force'] == pytest.approx(0.5 * (backward - forward), rel=0.02)


def test_a_delay_of_two_interrupts_that_sets_a_loop_swinging_is_tried_as_two():
    nominal = Variant.of(load_model('rigid'))
    effect = find('command_delay')
    true = Cause(effect, 'x_rotate', effect.typical(nominal, 'x_rotate'))
    assert true.values == {'delay': 2e3 / Timing().servo_hz}
    problem = log_of(nominal, true, 'step', noise=0.0)
    first = best_screened(
        problem, 'command_delay', 'notch', 'wrong_derivative_gain', axis='x_rotate'
    )
    assert (first.cause.name, first.cause.values) == (true.name, true.values)


def test_what_the_logs_tell_beside_another_cause_as_a_difference_only_is_offered():
    """Friction by direction beside viscous friction, which may take all of what both have in common."""
    nominal = Variant.of(load_model('rigid'))
    effect, viscous = find('direction_dependent_damping'), find('viscous_friction')
    typical = effect.typical(nominal, 'y_rotate')
    true = Cause(effect, 'y_rotate', {name: 3.0 * value for name, value in typical.items()})
    problem = log_of(nominal, true, 'random_y_rotate')
    start = Cause(viscous, 'y_rotate', viscous.typical(nominal, 'y_rotate'))
    base = fit_causes(problem, (start,))
    rivals = [item for item in candidates(problem, [effect]) if item.axis == 'y_rotate']
    quick, begun = in_quick_steps(problem, base)
    found = signatures(problem, base, rivals, 1, quiet)
    (first,) = screen(
        problem, base, rivals, found, all_signatures(quick, begun), Settings().prior_scales
    )
    assert first.likelihood > BEYOND_DOUBT


def test_what_was_taken_over_at_a_bound_goes_back_beside_its_cause():
    """Inertia of a load, 30 % too large: all that is a little off has gone as far as it can."""
    nominal = Variant.of(load_model('rigid'))
    effect = find('wrong_inertia')
    inertia = nominal.description.bodies['y_rotate_load'].inertia[1, 1]
    true = Cause(effect, 'y_rotate', {'inertia': -0.3 * inertia})
    problem = log_of(nominal, true, 'random_y_rotate')
    dense, numbers = nuisance(nominal, problem.records, Settings())
    problem = Problem(nominal, problem.records).with_prior(prior_groups(numbers))
    (little,) = candidates(problem, dense[:1])
    base = fit_causes(problem, (little,))
    at_bounds = away_from_bounds(problem, base.causes) != 0.0
    assert sum(at_bounds) > 1
    rivals = [item for item in candidates(problem, [effect]) if item.axis == 'y_rotate']
    quick, begun = in_quick_steps(problem, base)
    found = signatures(problem, base, rivals, 1, quiet)
    of_base = all_signatures(quick, begun)
    (first,) = screen(problem, base, rivals, found, of_base, Settings().prior_scales)
    together = fit_causes(problem, each_once(problem, (*base.causes, rivals[0])))
    # The dense effect's own inertia of the load, which a fit would hold, keeps some of it.
    share = float(first.value[0]) / together.causes[-1].values['inertia']
    assert 0.5 < share < 1.1
    assert first.likelihood > 0.0


def test_a_tone_promises_what_it_gains_though_noise_could_have_its_colour():
    """Two encoders of an axis have any spectrum as noise, and a floor that shakes is a line in it."""
    nominal = Variant.of(load_model('rigid'))
    true = Cause(
        find('floor_vibration'), 'y_rotate', {'cosine': 0.15, 'sine': 0.08, 'frequency': 55.5}
    )
    problem = log_of(nominal, true, 'random_y_rotate')
    base = evaluate(problem)
    (tuned,) = tuned_to(
        problem, true.with_values({'cosine': 0.0, 'sine': 0.0}), 'frequency', [55.5]
    )
    found = signatures(problem, base, [tuned], 1, quiet)
    (first,) = screen(problem, base, [tuned], found, [], Settings().prior_scales)
    gained = gain(evaluate(problem, (true,)), base, power_known=True)
    assert first.likelihood > 0.5 * gained > BEYOND_DOUBT
