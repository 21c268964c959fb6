# SPDX-License-Identifier: Apache-2.0
"""What the command shows of a cause decides whether noise may have feigned it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from waferbot_lockstep.contract import ENCODERS
from waferbot_lockstep.timing import Timing
from waferbot_pmac.experiments import commanded_positions, load_experiment
from waferbot_twin.diagnosis.confirmation import (
    ByCommand,
    _beyond_noise,
    _too_little,
    caused_by_command,
)
from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant, built
from waferbot_twin.engines.inprocess import Twin
from waferbot_twin.estimation.hypothesis import Hypothesis, evaluate
from waferbot_twin.models import load_model
from waferbot_twin.noise_model.prediction_error import Noise, likelihood
from waferbot_twin.residuals.from_recording import record_of_signals
from waferbot_twin.residuals.problem import PLANT, Cause, Problem
from waferbot_twin.synthesis import noise


@pytest.mark.parametrize(
    ('gains', 'too_little'),
    [
        (((34.0, 560.0), (14.0, 433.0)), True),  # a sensor's gain of -50 % that noise feigned
        (((6.0, 19.0), (87.0, 214.0)), True),
        (((699.0, 700.0), (591.0, 618.0)), False),
        (((105.0, 158.0), (30.0, 69.0)), False),
        (((2.0, 16.0), (0.0, 0.0)), False),  # by four standard deviations at most
        (((-1.0, 0.0), (0.0, 0.0)), False),
    ],
)
def test_currents_must_show_what_they_should(gains, too_little):
    logs = [ByCommand(0.0, 0.0, gain, expected) for gain, expected in gains]
    assert _too_little(*logs) is too_little


def test_what_the_plant_shows_does_not_count_as_currents():
    assert not _too_little(ByCommand(100.0, 320.0))


def leaving(motion, causes=()):
    """Return a hypothesis that leaves a slow motion of this size, counts, over in noise of one."""
    white = np.random.default_rng(20261129).normal(size=4000)
    left = [motion * np.sin(np.linspace(0.0, 60.0, 4000)) + white]
    return Hypothesis(causes, {PLANT: left}, {PLANT: likelihood(left, [Noise(0.1, 24)])})


@pytest.mark.parametrize(
    ('before', 'after', 'beyond'),
    [
        (100.0, 20.0, True),
        (100.0, 60.0, False),  # most of it is still there
        (5.0, 0.0, False),  # noise may be as large
    ],
)
def test_a_motion_too_large_for_noise_needs_no_noise_free_log(before, after, beyond):
    effect, values = find('wrong_inertia'), {'mass': 1.0}
    cause = Cause(effect, 'y_linear', values)
    assert _beyond_noise(leaving(before), leaving(after, (cause,))) is beyond
    # beside another cause it may stand in for a third
    assert not _beyond_noise(leaving(before, (cause,)), leaving(after, (cause, cause)))


@pytest.mark.slow
def test_a_belt_that_never_slips_shows_by_what_it_gives():
    """A little more or less of its limit changes nothing then: the whole of it has to be asked."""
    nominal, timing = Variant.of(load_model('rigid')), Timing()
    effect = replace(find('belt_slip'), drive_train=False)  # as if the motor had no encoder
    slip = Cause(effect, 'y_rotate', {'force': 9000.0})
    variant = slip.effect.apply(nominal, slip.axis, slip.values)
    twin = Twin(built(variant, timing), variant.pmac, variant.copley, timing, 'rigid')
    twin.commanded = commanded_positions(
        load_experiment('random_y_rotate'), twin.servo_parameters, timing.servo_hz
    )
    problem = Problem(nominal, [record_of_signals('log', twin.advance(timing.ticks(0.3)))])
    shown = caused_by_command(problem, evaluate(problem), evaluate(problem, (slip,)))
    assert shown.gain > 100.0
    assert shown.gain == pytest.approx(shown.expected, rel=0.2)


@pytest.mark.slow
def test_an_encoder_that_is_late_by_several_readings_gains_what_it_should():
    """Windings feel a speed: the slope at eight readings is not an eighth of what they do."""
    seed = 20261124
    print(f'seed {seed}')
    nominal, timing = Variant.of(load_model('rigid')), Timing()
    late = Cause(find('encoder_delay'), 'x_rotate', {'delay': 8e3 / timing.encoder_hz})
    variant = late.effect.apply(nominal, late.axis, late.values)
    noisy = variant.with_overlay(noise(nominal, 0.5, seed, np.random.default_rng(seed)))
    twin = Twin(built(noisy, timing), noisy.pmac, noisy.copley, timing, 'rigid')
    twin.commanded = commanded_positions(
        load_experiment('random_x_rotate'), twin.servo_parameters, timing.servo_hz
    )
    problem = Problem(nominal, [record_of_signals('log', twin.advance(timing.ticks(0.5)))])
    shown = caused_by_command(problem, evaluate(problem), evaluate(problem, (late,)))
    assert shown.gain_in_currents > 100.0
    assert shown.gain_in_currents > 0.8 * shown.expected_in_currents
    assert not _too_little(shown)


@pytest.mark.slow
def test_what_parts_two_encoders_needs_no_other_proof():
    """Without noise a motor stands on the other flank of its play; the readings show it all the same."""
    seed = 3
    print(f'seed {seed}')
    nominal, timing = Variant.of(load_model('rigid')), Timing()
    play = Cause(find('backlash'), 'y_rotate', {'gap': 1e-3})
    variant = play.effect.apply(nominal, play.axis, play.values)
    twin = Twin(built(variant, timing), variant.pmac, variant.copley, timing, 'rigid')
    twin.commanded = commanded_positions(
        load_experiment('step'), twin.servo_parameters, timing.servo_hz
    )
    record = record_of_signals('log', twin.advance(timing.ticks(0.4)))
    shaken = np.random.default_rng(seed).normal(scale=0.5, size=record.reading.shape)
    record = replace(record, reading=np.round(record.reading + shaken))
    problem = Problem(nominal, [record])
    assert problem.sees_both_ends('y_rotate')
    assert not problem.sees_both_ends('x_rotate')  # one encoder for both
    nothing, with_it = evaluate(problem), evaluate(problem, (play,))
    plain = 2.0 * (with_it.log_likelihood - nothing.log_likelihood)
    assert plain > 1000.0
    assert caused_by_command(problem, nothing, with_it).gain == plain
    blind = record.reading.copy()
    blind[:, ENCODERS.index('y_rotate_motor')] = np.nan
    record = replace(record, reading=blind, commanded=None)
    assert not Problem(nominal, [record]).sees_both_ends('y_rotate')
