# SPDX-License-Identifier: Apache-2.0
"""What the currents of a drive say that has folded back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from waferbot_lockstep.timing import Timing
from waferbot_pmac.experiments import commanded_positions, load_experiment
from waferbot_twin.diagnosis.inference.candidate_pool import CandidatePool
from waferbot_twin.diagnosis.inference.search import infer
from waferbot_twin.diagnosis.inference.settings import Settings
from waferbot_twin.diagnosis.proposals.folded_back import folded_back
from waferbot_twin.diagnosis.proposals.screening import candidates
from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant, built
from waferbot_twin.engines.inprocess import Twin
from waferbot_twin.models import load_model
from waferbot_twin.residuals.from_recording import record_of_signals
from waferbot_twin.residuals.problem import Problem
from waferbot_twin.synthesis import with_noise

AXIS = 'x_rotate'
SEED = 20261124


@pytest.fixture(scope='module')
def nominal():
    return Variant.of(load_model('rigid'))


def problem_of(nominal, machine, random):
    timing = Timing()
    noisy = with_noise(machine, nominal, 1.0, random)
    twin = Twin(built(noisy, timing), noisy.pmac, noisy.copley, timing, noisy.name)
    motion = load_experiment('step')
    twin.commanded = commanded_positions(motion, twin.servo_parameters, timing.servo_hz)
    return Problem(nominal, [record_of_signals('log', twin.advance(timing.ticks(0.2)))])


@pytest.mark.slow
def test_level_and_time_of_a_fold_back_are_read_from_the_log(nominal):
    print(f'seed {SEED}')
    random = np.random.default_rng(SEED)
    effect = find('i2t_foldback')
    free = problem_of(nominal, nominal, random)
    assert folded_back(free) == []
    largest = np.abs(free.records[0].command[:, 1]).max()
    for _ in range(4):
        true = {
            'continuous': largest * random.uniform(0.3, 0.45),
            'time': random.uniform(2e-3, 6e-3),
        }
        problem = problem_of(nominal, effect.apply(nominal, AXIS, true), random)
        (shown,) = folded_back(problem)
        assert shown.axes(nominal) == (AXIS,)
        (trial,) = shown.trials(nominal, AXIS)
        print(true, trial)
        assert trial['continuous'] == pytest.approx(true['continuous'], rel=0.02)
        assert trial['time'] == pytest.approx(true['time'], rel=0.1)
        (cause,) = candidates(problem, [shown])  # as it is, on no rungs
        assert cause.values == trial
        pool = CandidatePool(problem, [shown], Settings(), lambda *_: None)
        found = infer(pool).found
        assert [cause.name for cause in found.causes] == [f'i2t_foldback:{AXIS}']
        continuous = found.causes[0].values['continuous']
        assert continuous == pytest.approx(true['continuous'], rel=1e-4)


def test_a_log_without_currents_or_commands_shows_none(nominal):
    print(f'seed {SEED}')
    problem = problem_of(nominal, nominal, np.random.default_rng(SEED))
    (record,) = problem.records
    for less in (replace(record, terminals=None), replace(record, command=None)):
        assert folded_back(Problem(nominal, [less])) == []
