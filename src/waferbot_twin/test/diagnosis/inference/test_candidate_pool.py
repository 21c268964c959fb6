# SPDX-License-Identifier: Apache-2.0
"""Prior odds of candidates: of several ways in which one may be made, one is true."""

from __future__ import annotations

import math

import pytest

from waferbot_lockstep.timing import Timing
from waferbot_pmac.experiments import commanded_positions, load_experiment
from waferbot_pmac.i_variables import servo_parameters
from waferbot_twin.diagnosis.inference.candidate_pool import CandidatePool
from waferbot_twin.diagnosis.inference.settings import Settings
from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant
from waferbot_twin.models import load_model
from waferbot_twin.residuals.closed_loop_record import run_commanded
from waferbot_twin.residuals.from_recording import record_of_signals
from waferbot_twin.residuals.problem import Cause, Problem


def test_prior_odds_are_shared_between_the_orders_of_a_candidate():
    """A cause that is tried at three orders, and with the order free, is no likelier for it."""
    nominal, timing = Variant.of(load_model('rigid')), Timing()
    motion = load_experiment('full_stroke_y_linear')
    parameters = servo_parameters(nominal.pmac, nominal.name)
    commanded = commanded_positions(motion, parameters, timing.servo_hz)
    signals = run_commanded(nominal, timing, commanded, timing.ticks(0.3))
    names = ('coulomb_friction', 'viscous_friction', 'cogging')
    problem = Problem(nominal, [record_of_signals('log', signals)])
    pool = CandidatePool(problem, [find(name) for name in names], Settings(), lambda *_: None)
    odds = {}
    for name in pool.names:
        effect, axis = find(name.split(':')[0]), name.split(':')[1]
        odds[name] = pool.log_prior(Cause(effect, axis, effect.typical(nominal, axis)))
    alone = -math.log(len(pool.names))
    assert odds['coulomb_friction:y_linear'] == pytest.approx(alone)
    trials = len(find('cogging').trials(nominal, 'y_linear'))
    assert trials == 3
    assert odds['cogging:y_linear'] == pytest.approx(alone - math.log(trials + 1))
