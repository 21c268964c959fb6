# SPDX-License-Identifier: Apache-2.0
"""Limits that an exact block has: fitted where a fit by slopes stops beside the valley."""

from __future__ import annotations

import numpy as np
import pytest

from waferbot_lockstep.timing import Timing
from waferbot_pmac.experiments import commanded_positions, load_experiment
from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant, built
from waferbot_twin.engines.inprocess import Twin
from waferbot_twin.estimation.gauss_newton import fit_causes
from waferbot_twin.estimation.nelder_mead import downhill
from waferbot_twin.models import load_model
from waferbot_twin.residuals.from_recording import record_of_signals
from waferbot_twin.residuals.problem import AMPLIFIER, PLAIN, Cause, Problem

AXIS = 'x_rotate'


@pytest.fixture(scope='module')
def nominal():
    return Variant.of(load_model('rigid'))


def log_of(variant):
    timing = Timing()
    twin = Twin(built(variant, timing), variant.pmac, variant.copley, timing, variant.name)
    motion = load_experiment('step')
    twin.commanded = commanded_positions(motion, twin.servo_parameters, timing.servo_hz)
    return record_of_signals('log', twin.advance(timing.ticks(0.2)))


def left(problem, hypothesis):
    return problem.less_likely_than_nothing(AMPLIFIER, hypothesis.residuals[AMPLIFIER])[AXIS]


@pytest.mark.slow
def test_a_fold_back_is_found_where_a_fit_by_slopes_leaves_it(nominal):
    seed = 20261122
    print(f'seed {seed}')
    random = np.random.default_rng(seed)
    effect = find('i2t_foldback')
    free = log_of(nominal)
    largest = np.abs(free.command[:, 1]).max()
    left_by_slopes = 0
    for _ in range(4):
        continuous = largest * random.uniform(0.25, 0.4)
        true = {'continuous': continuous, 'time': random.uniform(2e-3, 1e-2)}
        record = log_of(effect.apply(nominal, AXIS, true))
        problem = Problem(nominal, [record])

        start = {name: value * random.uniform(0.97, 1.03) for name, value in true.items()}
        begun = Cause(effect, AXIS, start)
        by_slopes = fit_causes(problem, (begun,), rounds=2)
        left_by_slopes += left(problem, by_slopes) > PLAIN
        found = downhill(problem, begun, by_slopes)
        assert left(problem, found) < PLAIN
        assert found.causes[0].values['continuous'] == pytest.approx(true['continuous'], rel=1e-5)
        assert found.causes[0].values['time'] == pytest.approx(true['time'], rel=0.1)  # a tick's
    assert left_by_slopes, 'none of these needed it'


@pytest.mark.slow
def test_what_leaves_nothing_over_or_has_no_threshold_is_left_as_it_is(nominal):
    problem = Problem(nominal, [log_of(nominal)])
    for name in ('i2t_foldback', 'coulomb_friction'):
        effect = find(name)
        neutral = {p.name: p.neutral for p in effect.parameters(nominal, AXIS)}
        fitted = fit_causes(problem, (Cause(effect, AXIS, neutral),), rounds=0)
        assert downhill(problem, fitted.causes[0], fitted) is fitted
