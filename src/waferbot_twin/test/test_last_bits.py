# SPDX-License-Identifier: Apache-2.0
"""Causes so small that they change the controller's output by a bit now and then."""

from __future__ import annotations

import numpy as np
import pytest

from waferbot_lockstep.timing import Timing
from waferbot_pmac.experiments import commanded_positions, load_experiment
from waferbot_twin.diagnosis.from_recording import record_of_signals
from waferbot_twin.diagnosis.hypothesis import evaluate
from waferbot_twin.diagnosis.last_bits import acts_on_bits_alone, with_fewest_differences
from waferbot_twin.diagnosis.problem import CONTROLLER, Cause, Problem, apply_all
from waferbot_twin.effects import find
from waferbot_twin.effects.host import built, host
from waferbot_twin.effects.variant import Variant
from waferbot_twin.engines.inprocess import Twin
from waferbot_twin.models import load_model


def filtered(time_constant):
    return Cause(find('feedback_filter'), 'y_linear', {'time_constant': time_constant})


@pytest.mark.slow
@pytest.mark.parametrize('far_off', [0.0015, 0.1, 3.0])
def test_a_filter_that_changes_single_bits_is_found_from_an_estimate_that_is_far_off(far_off):
    truth, timing = 4e-4, Timing()
    nominal = host(Variant.of(load_model('rigid')))
    variant = apply_all(nominal, [filtered(truth)])
    twin = Twin(built(variant, timing), variant.pmac, variant.copley, timing, 'rigid')
    twin.commanded = commanded_positions(
        load_experiment('random_y_linear'), twin.servo_parameters, timing.servo_hz
    )
    problem = Problem(nominal, [record_of_signals('log', twin.advance(timing.ticks(0.8)))])
    base = evaluate(problem)
    differing = np.count_nonzero(base.residuals[CONTROLLER][0])
    assert 0 < differing < 0.3 * len(base.residuals[CONTROLLER][0])

    start = filtered(far_off * truth)
    assert acts_on_bits_alone(problem, start)
    found = with_fewest_differences(
        problem, base, start, lambda size: filtered(size * far_off * truth)
    )
    assert found.values['time_constant'] == pytest.approx(truth, rel=0.03)
    assert not evaluate(problem, (found,)).residuals[CONTROLLER][0].any()


@pytest.mark.slow
def test_what_also_moves_the_plant_is_left_to_the_fit():
    nominal, timing = host(Variant.of(load_model('rigid'))), Timing()
    twin = Twin(built(nominal, timing), nominal.pmac, nominal.copley, timing, 'rigid')
    problem = Problem(nominal, [record_of_signals('log', twin.advance(timing.ticks(0.3)))])
    force = Cause(find('constant_force'), 'y_linear', {'force': 1.0})
    assert not acts_on_bits_alone(problem, force)
