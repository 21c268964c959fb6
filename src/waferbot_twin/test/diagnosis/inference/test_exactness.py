# SPDX-License-Identifier: Apache-2.0
"""Controllers have no noise: what is left over there refutes what was found there."""

from __future__ import annotations

import pytest

from waferbot_lockstep.timing import Timing
from waferbot_pmac.experiments import commanded_positions, load_experiment
from waferbot_pmac.i_variables import servo_parameters
from waferbot_twin.diagnosis.inference.exactness import as_likely_as_not_where_inexact, inexact
from waferbot_twin.diagnosis.inference.settings import Settings
from waferbot_twin.diagnosis.inference.single_effects import Member, Posterior, SingleEffect
from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant
from waferbot_twin.estimation.hypothesis import evaluate
from waferbot_twin.models import load_model
from waferbot_twin.residuals.closed_loop_record import run_commanded
from waferbot_twin.residuals.from_recording import record_of_signals
from waferbot_twin.residuals.problem import CONTROLLER, Cause, Problem, apply_all

AXIS = 'x_rotate'
TRUE = Cause(find('wrong_velocity_feedforward'), AXIS, {'difference': -300.0})
STANDS_IN = Cause(find('wrong_derivative_gain'), AXIS, {'ratio': 1.1})
ELSEWHERE = Cause(find('constant_force'), AXIS, {'force': 0.1})


@pytest.fixture(scope='module')
def problem():
    timing, nominal = Timing(), Variant.of(load_model('rigid'))
    machine = apply_all(nominal, [TRUE])
    parameters = servo_parameters(machine.pmac, machine.name)
    motion = load_experiment('random_x_rotate')
    commanded = commanded_positions(motion, parameters, timing.servo_hz)
    signals = run_commanded(machine, timing, commanded, timing.ticks(0.5))
    return Problem(nominal, [record_of_signals('log', signals)])


def posterior(problem, *causes):
    found = evaluate(problem, causes)
    effects = tuple(
        SingleEffect((Member(evaluate(problem, (one,)), 100.0, 0.0, 1.0),), 0.0) for one in causes
    )
    return Posterior(evaluate(problem), found, effects, 1)


def test_what_explains_a_controller_to_the_last_bit_keeps_its_name(problem) -> None:
    found = posterior(problem, TRUE)
    assert inexact(problem, found) == []
    assert as_likely_as_not_where_inexact(problem, found, Settings()) == found


def test_what_stands_in_for_it_has_no_name_and_other_blocks_have_theirs(problem) -> None:
    found = posterior(problem, STANDS_IN, ELSEWHERE)
    assert inexact(problem, found) == [(CONTROLLER, AXIS)]
    stands_in, elsewhere = as_likely_as_not_where_inexact(problem, found, Settings()).effects
    assert stands_in.inclusion == pytest.approx(0.5)
    assert elsewhere.inclusion == 1.0
