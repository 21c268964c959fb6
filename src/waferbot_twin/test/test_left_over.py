# SPDX-License-Identifier: Apache-2.0
"""What causes leave over in a block that would leave nothing if they were right."""

from __future__ import annotations

import pytest

from waferbot_lockstep.timing import Timing
from waferbot_pmac.experiments import commanded_positions, load_experiment
from waferbot_twin.diagnosis.left_over import LeftOver, axes_that_differ
from waferbot_twin.diagnosis.search_state import Search
from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant, built
from waferbot_twin.engines.inprocess import Twin
from waferbot_twin.estimation.hypothesis import evaluate
from waferbot_twin.models import load_model
from waferbot_twin.residuals.from_recording import record_of_signals
from waferbot_twin.residuals.problem import AMPLIFIER, CONTROLLER, Cause, Problem, apply_all


def cause(name, **values):
    effect, axis = name.split(':')
    return Cause(find(effect), axis, values)


DERIVATIVE = cause('wrong_derivative_gain:y_linear', ratio=0.99)
FEEDFORWARD = cause('wrong_velocity_feedforward:y_linear', difference=5.0)
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


def searched(problem, *causes):
    nothing, found = evaluate(problem), evaluate(problem, causes)
    return Search(found, found, nothing, nothing)


@pytest.mark.slow
def test_right_causes_leave_nothing_over(problem):
    found = searched(problem, DERIVATIVE, DEAD_TIME)
    assert axes_that_differ(problem, problem, found) == {CONTROLLER: [], AMPLIFIER: []}


@pytest.mark.slow
def test_a_cause_that_stands_in_for_another_leaves_some_over_and_is_in_doubt(problem):
    found = searched(problem, FEEDFORWARD)
    axes = axes_that_differ(problem, problem, found)
    assert axes == {CONTROLLER: ['y_linear'], AMPLIFIER: ['x_rotate']}
    rest = LeftOver(different=axes)
    assert rest.axes == ['y_linear', 'x_rotate']
    assert rest.in_doubt(FEEDFORWARD, problem)
    assert not rest.in_doubt(cause('wrong_derivative_gain:x_rotate', ratio=0.99), problem)
    # what also acts on the plant is judged by noise there
    assert not rest.in_doubt(cause('force_constant:x_rotate', ratio=0.9), problem)


@pytest.mark.slow
def test_causes_that_explain_nearly_all_leave_the_rest_over(problem):
    """Right ones leave single bits, so that what stands in for them shows however near it comes."""
    found = searched(
        problem, DERIVATIVE, DEAD_TIME, cause('notch:y_linear', depth=5e-5, frequency=100.0)
    )
    left, at_first = (
        problem.less_likely_than_nothing(CONTROLLER, item.residuals[CONTROLLER])['y_linear']
        for item in (found.found, found.nothing)
    )
    assert left < 0.02 * at_first
    assert axes_that_differ(problem, problem, found) == {CONTROLLER: ['y_linear'], AMPLIFIER: []}
