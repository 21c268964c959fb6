# SPDX-License-Identifier: Apache-2.0
"""A fit is the same to the last bit, by however many workers and threads it is done."""

from __future__ import annotations

import numpy as np
import pytest

from waferbot_lockstep.timing import Timing
from waferbot_pmac.experiments import commanded_positions, load_experiment
from waferbot_pmac.i_variables import servo_parameters
from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant
from waferbot_twin.estimation.gauss_newton import (
    _sound,
    all_signatures,
    fit_causes,
    linearise,
    names_of,
)
from waferbot_twin.estimation.hypothesis import evaluate
from waferbot_twin.models import load_model
from waferbot_twin.residuals.closed_loop_record import run_commanded
from waferbot_twin.residuals.from_recording import record_of_signals
from waferbot_twin.residuals.problem import Cause, Problem

AXIS = 'y_linear'
TRUE = {'coulomb_friction': 3.0, 'cable_compliance': 2e-7}


def cause(name, share=1.0):
    effect = find(name)
    (parameter,) = effect.parameters(Variant.of(load_model('rigid')), AXIS)
    return Cause(effect, AXIS, {parameter.name: share * TRUE[name]})


@pytest.fixture(scope='module')
def problem():
    """Two logs, of unlike length, of a machine with friction and cables that give."""
    nominal, timing = Variant.of(load_model('rigid')), Timing()
    real = nominal
    for name in TRUE:
        real = find(name).apply(real, AXIS, cause(name).values)
    records = []
    for name, duration_s in (('random_y_linear', 0.4), ('full_stroke_y_linear', 0.2)):
        parameters = servo_parameters(nominal.pmac, nominal.name)
        commanded = commanded_positions(load_experiment(name), parameters, timing.servo_hz)
        signals = run_commanded(real, timing, commanded, timing.ticks(duration_s))
        records.append(record_of_signals(name, signals))
    return Problem(nominal, records)


def test_what_is_left_is_the_same_by_threads(problem):
    one, two = (evaluate(problem, (cause('cable_compliance'),), workers) for workers in (1, 2))
    assert one.residuals.keys() == two.residuals.keys()
    for block, channels in one.residuals.items():
        for own, other in zip(channels, two.residuals[block], strict=True):
            np.testing.assert_array_equal(own, other)
    assert one.log_likelihood == two.log_likelihood


def test_a_fit_is_the_same_by_workers(problem):
    start = (cause('coulomb_friction', 0.5), cause('cable_compliance', 0.8))
    one, two = (fit_causes(problem, start, 4, workers) for workers in (1, 2))
    assert [item.values for item in one.causes] == [item.values for item in two.causes]
    assert [item.values for item in one.causes] != [item.values for item in start]
    np.testing.assert_array_equal(one.covariance, two.covariance)
    assert one.log_likelihood == two.log_likelihood


def test_which_steps_do_no_harm_is_the_same_by_workers(problem):
    now = evaluate(problem, (cause('coulomb_friction', 0.5), cause('cable_compliance', 3.0)))
    names = names_of(problem, now.causes)
    linear = linearise(problem, now, all_signatures(problem, now))
    one, two = (_sound(problem, now, names, linear, workers) for workers in (1, 2))
    np.testing.assert_array_equal(one.value, two.value)
    assert np.any(one.value)
