# SPDX-License-Identifier: Apache-2.0
"""A compliance beside which the machine rings on."""

from __future__ import annotations

import pytest

from waferbot_lockstep.timing import Timing
from waferbot_pmac.experiments import commanded_positions, load_experiment
from waferbot_twin.diagnosis.left_over import LeftOver
from waferbot_twin.diagnosis.still_ringing import still_ringing
from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant, built
from waferbot_twin.engines.inprocess import Twin
from waferbot_twin.estimation.hypothesis import evaluate
from waferbot_twin.models import load_model
from waferbot_twin.residuals.from_recording import record_of_signals
from waferbot_twin.residuals.problem import Cause, Problem

COUNTERWEIGHT = Cause(find('counterweight_bearing_compliance'), 'y_linear', {'compliance': 5e-8})
SIDEWAYS = Cause(find('bearing_radial_compliance'), 'x_rotate', {'compliance': 5e-9})
FRICTION = Cause(find('coulomb_friction'), 'y_linear', {'friction': 1.0})


@pytest.fixture(scope='module')
def problem():
    nominal = Variant.of(load_model('rigid'))
    timing = Timing()
    twin = Twin(built(nominal, timing), nominal.pmac, nominal.copley, timing, 'rigid')
    twin.commanded = commanded_positions(
        load_experiment('step'), twin.servo_parameters, timing.servo_hz
    )
    return Problem(nominal, [record_of_signals('log', twin.advance(timing.ticks(0.3)))])


@pytest.mark.slow
def test_what_makes_an_axis_ring_is_in_doubt_while_that_still_rings(problem):
    found = evaluate(problem, (COUNTERWEIGHT, FRICTION))
    assert still_ringing(problem, found, {}) == []
    assert still_ringing(problem, found, {'y_rotate': 349.5}) == []
    (doubt,) = still_ringing(problem, found, {'y_linear': 349.5})
    assert doubt.cause == COUNTERWEIGHT
    assert 'y_linear still rings at 349.5 Hz' in str(doubt)
    rest = LeftOver(sounding={'y_linear': 349.5}, doubts=[doubt])
    assert rest.in_doubt(COUNTERWEIGHT, problem)
    assert not rest.in_doubt(FRICTION, problem)


@pytest.mark.slow
def test_a_bearing_is_asked_where_it_shows_which_is_not_always_its_own_axis(problem):
    """The shaft of X-Rotate goes sideways, along Y-Linear: its own encoder sees next to nothing."""
    found = evaluate(problem, (SIDEWAYS,))
    assert still_ringing(problem, found, {'y_linear': 971.0})[0].axis == 'y_linear'
    assert still_ringing(problem, found, {'y_rotate': 971.0}) == []
