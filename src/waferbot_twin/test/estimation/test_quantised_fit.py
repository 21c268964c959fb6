# SPDX-License-Identifier: Apache-2.0
"""Causes so small that they change the controller's output by a bit now and then."""

from __future__ import annotations

import numpy as np
import pytest

from waferbot_lockstep.timing import Timing
from waferbot_pmac.experiments import commanded_positions, load_experiment
from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant, built
from waferbot_twin.engines.inprocess import Twin
from waferbot_twin.estimation.gauss_newton import fit_causes
from waferbot_twin.estimation.hypothesis import evaluate, standard_errors
from waferbot_twin.estimation.nelder_mead import downhill
from waferbot_twin.estimation.quantised_fit import (
    acts_on_bits_alone,
    cycles_that_differ,
    same_bits,
    with_fewest_differences,
)
from waferbot_twin.models import load_model
from waferbot_twin.residuals.from_recording import record_of_signals
from waferbot_twin.residuals.problem import CONTROLLER, Cause, Problem, apply_all


def filtered(time_constant):
    return Cause(find('feedback_filter'), 'y_linear', {'time_constant': time_constant})


@pytest.mark.slow
@pytest.mark.parametrize('far_off', [0.0015, 0.1, 3.0])
def test_a_filter_that_changes_single_bits_is_found_from_an_estimate_that_is_far_off(far_off):
    truth, timing = 4e-4, Timing()
    nominal = Variant.of(load_model('rigid'))
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
    nominal, timing = Variant.of(load_model('rigid')), Timing()
    twin = Twin(built(nominal, timing), nominal.pmac, nominal.copley, timing, 'rigid')
    problem = Problem(nominal, [record_of_signals('log', twin.advance(timing.ticks(0.3)))])
    force = Cause(find('constant_force'), 'y_linear', {'force': 1.0})
    assert not acts_on_bits_alone(problem, force)
    assert not same_bits(problem, evaluate(problem, (force,)), 0).any()


@pytest.mark.slow
def test_a_notch_of_a_few_bits_is_found_where_no_cycle_differs_as_well_as_bits_tell_it():
    nominal, timing = Variant.of(load_model('rigid')), Timing()
    truth = Cause(find('notch'), 'x_rotate', {'depth': 1.6e-5, 'frequency': 43.0})
    variant = apply_all(nominal, [truth])
    twin = Twin(built(variant, timing), variant.pmac, variant.copley, timing, 'rigid')
    twin.commanded = commanded_positions(
        load_experiment('random_x_rotate'), twin.servo_parameters, timing.servo_hz
    )
    problem = Problem(nominal, [record_of_signals('log', twin.advance(timing.ticks(0.8)))])
    start = truth.with_values({'depth': 1.45e-5, 'frequency': 43.4})
    by_slopes = fit_causes(problem, (start,))
    assert cycles_that_differ(problem, by_slopes.causes, 'x_rotate') > 0

    found = downhill(problem, start, by_slopes)
    assert cycles_that_differ(problem, found.causes, 'x_rotate') == 0
    (notch,) = found.causes
    assert notch.values['frequency'] == pytest.approx(43.0, rel=1e-3)
    depth, _ = same_bits(problem, found, 0)
    assert 0.0 < depth < 0.3 * truth.values['depth']
    reach = depth + 1.96 * standard_errors(found)[0]
    assert notch.values['depth'] == pytest.approx(truth.values['depth'], abs=reach)
    # there a little further it is another notch
    for sign in (-1.0, 1.0):
        beyond = notch.with_values({'depth': notch.values['depth'] + sign * 1.2 * depth})
        assert cycles_that_differ(problem, (beyond,), 'x_rotate') > 0
    assert downhill(problem, start, found) is found
