# SPDX-License-Identifier: Apache-2.0
"""A load that is another one comes in place of the forces and inertias that stood for its parts."""

from __future__ import annotations

from dataclasses import replace

import pytest

from waferbot_lockstep.package_data import package_data
from waferbot_twin.diagnosis.inference.forward_selection import as_fitted
from waferbot_twin.diagnosis.inference.load_model import or_other_loads
from waferbot_twin.effects import find, places
from waferbot_twin.effects.variant import Variant
from waferbot_twin.estimation.gauss_newton import fit_causes
from waferbot_twin.models import load_model
from waferbot_twin.residuals.problem import Cause, apply_all

EXPERIMENT = str(package_data('waferbot_twin', 'config', 'demo', 'moves.yaml'))
EFFECTS = ('load', 'wrong_inertia', 'constant_force', 'counterweight_mass', 'centre_of_gravity')
RING = {'mass': 4.0, 'moment_y': 0.2, 'moment_z': 0.3}


@pytest.fixture(scope='module')
def nominal():
    return Variant.of(load_model('rigid'))


def cause(nominal, name, axis, **values):
    effect = find(name)
    neutral = {item.name: item.neutral for item in effect.parameters(nominal, axis)}
    return Cause(effect, axis, {**neutral, **values})


def moved(variant, axis):
    """Return the mass or inertia that an axis moves, all else rigid."""
    return places.moving_inertia(replace(variant, origin=None), axis)


def begun(pool, causes):
    before = fit_causes(pool.problem, tuple(causes))
    pool.begin(before)
    return before, [as_fitted(pool, before, one) for one in before.causes]


def test_a_load_comes_in_place_of_what_stood_for_it(nominal, pool_of):
    """A ring of 4 kg was bolted on: a force on the lifting axis and an inertia of the turning one."""
    hidden = [cause(nominal, 'load', 'x_rotate', **RING)]
    pool = pool_of(EXPERIMENT, EFFECTS, hidden=hidden)
    parts = [('constant_force', 'y_linear'), ('wrong_inertia', 'x_rotate')]
    before, effects = begun(pool, [cause(nominal, *part) for part in parts])
    found, own, tentative = or_other_loads(pool, before, effects, [])
    assert own == []
    assert 'constant_force:y_linear' not in {one.name for one in found.causes}
    assert {one.best.cause.name for one in tentative} == {one.name for one in found.causes}
    machine, true = (apply_all(nominal, causes) for causes in (found.causes, hidden))
    for axis in ('y_linear', 'x_rotate'):
        # How the axes share a load a rigid machine does not show.
        assert moved(machine, axis) == pytest.approx(moved(true, axis), rel=0.01)


@pytest.mark.parametrize(
    'there', [(), (('constant_force', 'y_linear', {'force': 40.0}),)], ids=['nothing', 'a hose']
)
def test_where_the_load_is_right_all_stays_as_it_is(nominal, pool_of, there):
    """Beside nothing there is nothing to take the place of; a force without any mass is no load."""
    hidden = [cause(nominal, name, axis, **values) for name, axis, values in there]
    pool = pool_of(EXPERIMENT, EFFECTS, hidden=hidden)
    before, effects = begun(pool, hidden)
    assert or_other_loads(pool, before, effects, []) == (before, effects, [])
