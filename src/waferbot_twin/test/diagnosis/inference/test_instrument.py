# SPDX-License-Identifier: Apache-2.0
"""What the command makes of a cause: what a block leaves over of a noise-free log is none."""

from __future__ import annotations

import itertools
import math
from types import SimpleNamespace

import numpy as np
import pytest

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.timing import Timing
from waferbot_pmac.experiments import load_experiment
from waferbot_twin.diagnosis.inference.instrument import (
    GivingWay,
    NoiseFree,
    explained,
    instrumented_gain,
    log_odds_beside_noise,
    noise_free_logs,
)
from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant
from waferbot_twin.engines.inprocess import Twin
from waferbot_twin.estimation.evidence import gain
from waferbot_twin.estimation.gauss_newton import all_signatures, fit_causes
from waferbot_twin.estimation.hypothesis import evaluate
from waferbot_twin.estimation.separable import fitted_apart
from waferbot_twin.models import load_model
from waferbot_twin.residuals.from_recording import record_of_signals
from waferbot_twin.residuals.problem import Cause, Problem, apply_all
from waferbot_twin.synthesis import noise

SEED = 5


def gained(mismatch):
    """
    Return what wrong gains of the sensors of Y-Rotate gain in ln L, in the logs and by the command.

    With a gearbox that gives, the motor is seen in coarse steps.
    """
    print(f'seed {SEED}')
    nominal = Variant.of(load_model('rigid'))
    gearbox, sensor = find('gearbox_compliance'), find('phase_gain_mismatch')
    known = Cause(gearbox, 'y_rotate', gearbox.typical(nominal, 'y_rotate'))
    lines = Cause(sensor, 'y_rotate', {'line_1': mismatch, 'line_2': mismatch})
    truth = apply_all(nominal, [known, lines])
    noisy = truth.with_overlay(noise(truth, 1.0, SEED, np.random.default_rng(SEED)))
    twin = Twin.of(noisy.model(), Timing(), load_experiment('random_y_rotate'))
    problem = Problem(nominal, [record_of_signals('log', twin.advance(Timing().ticks(1.0)))])
    base = evaluate(problem, (known,))
    begun = lines.with_values({'line_1': 0.0, 'line_2': 0.0})
    more = fit_causes(problem, (known, begun))
    noise_free = noise_free_logs(problem, more)
    others = more.causes[:1]
    there = [
        [NoiseFree.of(logs, more).signatures[cause.name] for cause in others]
        for logs in noise_free
    ]
    giving_way = GivingWay.of(problem, others, all_signatures(problem, more)[:1], there)
    return gain(more, base), instrumented_gain(problem, more, others, noise_free, giving_way)


@pytest.mark.parametrize('mismatch', [0.0, 0.01])
def test_counts_that_are_taken_for_motion_make_no_sensor_wrong(mismatch):
    """
    Gains of sensors seem 0.06 % wrong where none are.

    That is as plain in the likelihood as a true percent; the instrument tells them apart.
    """
    plain, by_command = gained(mismatch)
    assert plain > 10.0
    if mismatch:
        assert by_command > 20.0
    else:
        assert by_command < 3.0


def test_half_of_what_a_true_percent_gains_is_left_by_the_command():
    plain, by_command = gained(0.01)
    assert by_command > 0.5 * plain


def test_the_odds_are_those_of_all_four_cases():
    """There or not, feigned or not, each weighed by hand."""
    prior = math.log(0.02)
    share = 0.02 / 1.02
    for by_logs, by_command in itertools.product((-3.0, 2.0, 40.0), (-6.0, 1.0, 30.0)):
        feigns = math.exp(by_logs - by_command)
        there = (1.0 - share) * math.exp(by_logs) + share * math.exp(by_command) * feigns
        not_there = (1.0 - share) + share * feigns
        found = log_odds_beside_noise(by_logs, by_command, prior)
        assert found == pytest.approx(math.log(there / not_there), abs=1e-9)
    assert log_odds_beside_noise(math.inf, 5.0, prior) == pytest.approx(5.0 - math.log(share))


def test_a_loop_that_rings_takes_nothing_from_what_another_one_says():
    """What the command makes of a cause, seen through noise, and two loops: one of them rings."""
    print(f'seed {SEED}')
    random = np.random.default_rng(SEED)
    caused = np.sin(0.01 * np.arange(4000.0))
    change = caused + 0.3 * random.standard_normal(4000)
    rings = 100.0 * np.sin(1.9 * np.arange(4000.0))
    for instruments in ([[caused]], [[rings], [0.7 * caused]], [[-caused], [0.7 * caused]]):
        (found,) = explained([change], instruments)
        assert np.corrcoef(found, caused)[0, 1] > 0.99
        assert np.std(found) == pytest.approx(np.std(caused), rel=0.1)
    (nothing,) = explained([change], [[-caused]])
    assert not nothing.any()
    assert explained([], []) == []


def test_noise_free_logs_are_those_of_the_loops_that_are_stable():
    unstable = {'found'}

    def ideal(causes):
        if unstable.intersection(causes):
            raise UserError('the loop is unstable')
        return f'logs of {[*causes]}'

    problem = SimpleNamespace(ideal=ideal)
    found = SimpleNamespace(causes=('found',))
    problem.records = [SimpleNamespace(current=None)]
    assert noise_free_logs(problem, found) == ['logs of []']
    unstable.clear()
    assert noise_free_logs(problem, found) == ["logs of ['found']", 'logs of []']
    problem.ideal = lambda causes: None
    assert noise_free_logs(problem, found) == []


def test_a_loop_with_other_channels_is_no_instrument():
    """An encoder in coarse steps moves no windings: the nominal model's has channels more."""
    nominal = Variant.of(load_model('rigid'))
    coarse = find('coarse_quantisation')
    cause = Cause(coarse, 'x_rotate', {'step': 20.0})
    twin = Twin.of(
        apply_all(nominal, [cause]).model(), Timing(), load_experiment('random_x_rotate')
    )
    problem = Problem(nominal, [record_of_signals('log', twin.advance(Timing().ticks(0.6)))])
    found = evaluate(problem, (cause,))
    (own,) = noise_free_logs(problem, found)
    assert {block: own.channel_names(block) for block in own.blocks} == {
        block: problem.channel_names(block) for block in problem.blocks
    }
    assert problem.ideal(()) is None


def test_blocks_of_which_nothing_was_fitted_are_judged_as_well():
    """A friction changes the plant alone; the windings have noise, too, and nothing that was fitted."""
    print(f'seed {SEED}')
    nominal, friction = Variant.of(load_model('rigid')), find('coulomb_friction')
    typical = friction.typical(nominal, 'x_rotate')
    real = friction.apply(nominal, 'x_rotate', typical)
    noisy = real.with_overlay(noise(real, 1.0, SEED, np.random.default_rng(SEED)))
    twin = Twin.of(noisy.model(), Timing(), load_experiment('random_x_rotate'))
    problem = Problem(nominal, [record_of_signals('log', twin.advance(Timing().ticks(0.6)))])
    more = fitted_apart(problem, (Cause(friction, 'x_rotate', typical),))
    assert all(more.fits['plant'].leverages)
    assert not any(more.fits['windings'].leverages)
    by_command = instrumented_gain(problem, more, (), noise_free_logs(problem, more))
    assert by_command > 10.0
