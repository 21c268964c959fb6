# SPDX-License-Identifier: Apache-2.0
"""What causes leave over in a block that would leave nothing if they were right."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from waferbot_lockstep.timing import Timing
from waferbot_pmac.experiments import commanded_positions, load_experiment
from waferbot_twin.diagnosis.inference.settings import Settings
from waferbot_twin.diagnosis.inference.single_effects import Posterior, squares_of
from waferbot_twin.diagnosis.inference.unexplained import follows_command, unexplained
from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant, built
from waferbot_twin.engines.inprocess import Twin
from waferbot_twin.estimation.hypothesis import evaluate
from waferbot_twin.models import load_model
from waferbot_twin.residuals.from_recording import record_of_signals
from waferbot_twin.residuals.noise_free_motion import motions
from waferbot_twin.residuals.problem import (
    AMPLIFIER,
    CONTROLLER,
    PLANT,
    Cause,
    Problem,
    apply_all,
)
from waferbot_twin.synthesis import noise


def cause(name, **values):
    effect, axis = name.split(':')
    return Cause(find(effect), axis, values)


DERIVATIVE = cause('wrong_derivative_gain:y_linear', ratio=0.99)
DEAD_TIME = cause('dead_time:x_rotate', voltage=0.5)


@pytest.fixture(scope='module')
def problem():
    """Return a log of a machine with a wrong setting of the controller and one of an amplifier."""
    nominal = Variant.of(load_model('rigid'))
    variant = apply_all(nominal, [DERIVATIVE, DEAD_TIME])
    timing = Timing()
    twin = Twin(built(variant, timing), variant.pmac, variant.copley, timing, 'rigid')
    twin.commanded = commanded_positions(
        load_experiment('step'), twin.servo_parameters, timing.servo_hz
    )
    return Problem(nominal, [record_of_signals('log', twin.advance(timing.ticks(0.3)))])


def left_over(problem, *causes):
    found = Posterior(evaluate(problem), evaluate(problem, causes), (), 0)
    return {
        (item.axis, item.block): item
        for item in unexplained(problem, found, follows_command(problem, found, Settings()))
        if item.block in (CONTROLLER, AMPLIFIER)
    }


def test_right_causes_leave_nothing_over(problem):
    assert left_over(problem, DERIVATIVE, DEAD_TIME) == {}


def test_what_no_cause_explains_in_an_exact_block_is_said(problem):
    found = left_over(problem)
    assert set(found) == {('y_linear', CONTROLLER), ('x_rotate', AMPLIFIER)}
    assert all(item.share == 1.0 for item in found.values())
    assert {item.with_what for item in found.values()} == {'its input'}


@pytest.mark.parametrize(
    'stand_in',
    [
        cause('wrong_velocity_feedforward:y_linear', difference=5.0),
        cause('notch:y_linear', depth=5e-5, frequency=100.0),
    ],
)
def test_what_stands_in_for_the_cause_leaves_some_over(problem, stand_in):
    found = left_over(problem, DEAD_TIME, stand_in)
    assert set(found) == {('y_linear', CONTROLLER)}


def test_a_cause_nearly_right_leaves_a_small_share(problem):
    nearly = cause('wrong_derivative_gain:y_linear', ratio=0.9905)
    (left,) = left_over(problem, DEAD_TIME, nearly).values()
    assert left.share < 0.02


def test_a_signal_that_one_log_does_not_have_is_asked_of_none(problem, monkeypatch):
    """An imported log without line currents beside one with them, of the same axis."""
    two = Problem(problem.nominal, [*problem.records, replace(problem.records[0], name='second')])
    found = Posterior(evaluate(two), evaluate(two, (DERIVATIVE, DEAD_TIME)), (), 0)
    known = unexplained(two, found, follows_command(two, found, Settings()))

    def without_currents(*asked):
        every = motions(*asked)
        second = id(two.records[1])
        return {
            key: replace(one, currents=tuple(np.nan * part for part in one.currents))
            if key[0] == second
            else one
            for key, one in every.items()
        }

    monkeypatch.setattr('waferbot_twin.diagnosis.inference.unexplained.motions', without_currents)
    assert {
        item.axis for item in unexplained(two, found, follows_command(two, found, Settings()))
    } <= {item.axis for item in known}


def test_shares_are_those_of_what_is_wrong_beyond_noise(problem):
    """A force in a log whose readings are mostly noise explains nearly all that is wrong."""
    force = cause('constant_force:x_rotate', force=3.0)
    truth = apply_all(problem.nominal, [force])
    loud = truth.with_overlay(noise(truth, 30.0, 3, np.random.default_rng(3)))
    twin = Twin.of(loud.model(), Timing(), load_experiment('step'))
    logs = Problem(problem.nominal, [record_of_signals('log', twin.advance(Timing().ticks(0.3)))])
    before, after = evaluate(logs), evaluate(logs, (force,))
    raw, kept = (squares_of(logs, one, PLANT, 'x_rotate') for one in (before, after))
    assert 0.01 * raw < raw - kept < 0.5 * raw
    posterior = Posterior(before, after, (), 1)
    assert posterior.share(logs, 0) == pytest.approx(1.0)
    follows = {(PLANT, 'x_rotate'): 0.5}
    wanted = (raw - kept) / (raw - 0.5 * kept)
    assert posterior.share(logs, 0, follows) == pytest.approx(wanted)
    (left,) = (
        one for one in unexplained(logs, posterior, follows) if one.with_what != 'its input'
    )
    assert left.share == pytest.approx(1.0 - wanted)
