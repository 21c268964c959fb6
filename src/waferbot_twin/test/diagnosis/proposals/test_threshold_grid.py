# SPDX-License-Identifier: Apache-2.0
"""Limits, held shapes and steps that readings show: where fits of such causes begin."""

from __future__ import annotations

import itertools
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from waferbot_lockstep.contract import ENCODERS
from waferbot_lockstep.timing import Timing
from waferbot_pmac.experiments import commanded_positions, load_experiment
from waferbot_twin.diagnosis.inference.refit import within_reach
from waferbot_twin.diagnosis.inference.settings import Settings
from waferbot_twin.diagnosis.proposals.offered import limited_commands
from waferbot_twin.diagnosis.proposals.screening import Screened, candidates
from waferbot_twin.diagnosis.proposals.threshold_grid import between_rungs, rungs
from waferbot_twin.effects import find, places
from waferbot_twin.effects.variant import Variant, built
from waferbot_twin.engines.inprocess import Twin
from waferbot_twin.estimation.hypothesis import evaluate, parameters_of
from waferbot_twin.models import load_model
from waferbot_twin.noise_model.prediction_error import Noise, likelihood
from waferbot_twin.residuals.closed_loop_record import simulate
from waferbot_twin.residuals.from_recording import record_of_signals
from waferbot_twin.residuals.plant_block import PlantBlock
from waferbot_twin.residuals.problem import CONTROLLER, Cause, Problem


@pytest.fixture(scope='module')
def nominal():
    return Variant.of(load_model('rigid'))


def log_of(variant, duration_s, experiment='step'):
    timing = Timing()
    twin = Twin(built(variant, timing), variant.pmac, variant.copley, timing, variant.name)
    if experiment is not None:
        motion = load_experiment(experiment)
        twin.commanded = commanded_positions(motion, twin.servo_parameters, timing.servo_hz)
    return record_of_signals('log', twin.advance(timing.ticks(duration_s)))


@pytest.mark.slow
@pytest.mark.parametrize('share', [0.97, 0.6])
def test_a_limit_is_found_between_rungs_however_little_it_cuts_off(nominal, share):
    effect, axis = find('output_limit'), 'y_linear'
    free = log_of(nominal, 0.2)
    per_bit = nominal.i_variable(axis, 'amplifier_peak_current') / 32768.0
    limit = round(share * np.abs(free.command[:, 0]).max() / per_bit)
    record = log_of(effect.apply(nominal, axis, {'limit': limit}), 0.2)
    assert np.any(np.abs(free.command[:, 0]) / per_bit > limit)
    problem = Problem(nominal, [record])
    base = evaluate(problem)
    start = Cause(effect, axis, effect.typical(nominal, axis))
    tight = [rung for rung in rungs(problem, start) if rung.values['limit'] < limit]
    found = between_rungs(problem, base, tight[0])
    assert found.values['limit'] == pytest.approx(limit, abs=3.0)
    left_over = evaluate(problem, (found,)).residuals[CONTROLLER][0]
    assert np.abs(left_over).max() <= 3.5 * per_bit


@pytest.mark.slow
def test_rungs_lead_down_to_the_least_that_is_possible(nominal):
    problem = Problem(nominal, [log_of(nominal, 0.05)])
    effect, axis = find('i2t_foldback'), 'y_linear'
    (item, _) = effect.parameters(nominal, axis)
    found = [
        rung.values['continuous']
        for rung in rungs(problem, Cause(effect, axis, effect.typical(nominal, axis)))
    ]
    assert found[-1] == item.low
    assert found[0] < item.neutral
    assert all(1.0 < above / below < 1.3 for above, below in itertools.pairwise(found))


@pytest.mark.slow
def test_a_log_that_begins_off_home_with_an_eccentric_encoder_is_simulated_from_where_it_was(
    nominal,
):
    effect, axis = find('encoder_eccentricity'), 'x_rotate'
    values = {'cosine': 4e-4, 'sine': 2e-4, 'period': np.pi}
    eccentric = effect.apply(nominal, axis, values)
    record = log_of(eccentric, 0.05)
    assert abs(record.reading[0, 1]) > 10.0  # the error at home, in counts
    again = simulate(eccentric, record)
    # whole counts are a count wide: where it stood in the first one, nobody knows
    assert np.abs(again.reading - record.reading)[:, 1].max() <= 2.0


@pytest.mark.slow
def test_the_delay_of_an_encoder_does_not_show_where_nothing_moves(nominal):
    seed = 20261122
    print(f'seed {seed}')
    random = np.random.default_rng(seed)
    still = log_of(nominal, 1.0, None)
    noisy = replace(still, reading=still.reading + random.normal(0.0, 2.0, still.reading.shape))
    block = PlantBlock(noisy, nominal)
    effect = find('encoder_delay')
    for axis in ('y_linear', 'x_rotate', 'y_rotate'):
        for delay in (0.5, 3.0):  # phase cycles
            late = effect.apply(nominal, axis, {'delay': 1e3 * delay / Timing().encoder_hz})
            spreads = [
                likelihood(residuals, [Noise(0.0, 24)] * 4)
                for residuals in (block.residuals(nominal), block.residuals(late))
            ]
            # what an observer makes of white noise depends on its delay, unless that is made up for;
            # what is left is what a correction of the speed moves within the delay
            before, after = ([one.deviation for one in fit.colours] for fit in spreads)
            assert after == pytest.approx(before, rel=0.003 * (1.0 + delay))


def test_the_largest_command_is_tried_as_a_limit(nominal):
    per_bit = places.current_per_bit(nominal, 'x_rotate')
    command = np.zeros((50, 3))
    command[:, 1] = per_bit * np.linspace(-11821.0, 7000.0, 50)
    record = SimpleNamespace(command=command, layout=nominal.layout)
    problem = SimpleNamespace(nominal=nominal, records=[record])
    (effect,) = limited_commands(problem)
    assert effect.axes(nominal) == ('x_rotate',)  # the others were commanded nothing
    assert effect.trials(nominal, 'x_rotate') == ({'limit': 11821.0},)
    assert not limited_commands(SimpleNamespace(nominal=nominal, records=[]))


def test_what_construction_fixes_is_held_and_costs_no_parameter(nominal):
    goes = SimpleNamespace(channels=ENCODERS, measured=lambda name: np.arange(100.0))
    problem = SimpleNamespace(
        nominal=nominal, touched=lambda effect, axis: ('plant',), plants=[goes]
    )
    found = candidates(problem, [find('torque_ripple')])
    assert {cause.held for cause in found} == {('order',)}
    assert {cause.values['order'] for cause in found} == {2.0, 6.0}
    assert [item.name for item in parameters_of(problem, found[0])] == ['cosine', 'sine']
    assert found[0].free == 2


def test_the_best_two_trials_of_a_name_are_fitted(nominal):
    problem = SimpleNamespace(nominal=nominal)
    effect = find('torque_ripple')

    def at(order, score):
        cause = Cause(effect, 'y_linear', {'cosine': 0.0, 'sine': 0.0, 'order': order}, ('order',))
        return Screened(cause, score, np.zeros(2), score)

    screened = [at(2.0, 100.0), at(6.0, 99.0), at(1.0, 50.0)]
    chosen = within_reach(problem, screened, Settings())
    assert [item.score for item in chosen] == [100.0, 99.0]
    tied = [at(float(order), 100.0) for order in range(1, 8)]
    assert len(within_reach(problem, tied, Settings())) == 2
