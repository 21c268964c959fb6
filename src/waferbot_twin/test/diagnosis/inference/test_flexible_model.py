# SPDX-License-Identifier: Apache-2.0
"""All that a model holds rigid comes as soft as described, where the logs are likelier so."""

from __future__ import annotations

import math

import pytest

from waferbot_twin.diagnosis.inference.flexible_model import or_flexible
from waferbot_twin.diagnosis.inference.forward_selection import as_fitted
from waferbot_twin.diagnosis.inference.nuisance import nuisance
from waferbot_twin.diagnosis.inference.refit import to_the_end
from waferbot_twin.diagnosis.inference.settings import Settings
from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant
from waferbot_twin.estimation.gauss_newton import fit_causes
from waferbot_twin.models import load_model
from waferbot_twin.residuals.problem import Cause

SOFT = {
    'cable_compliance': 'y_linear',
    'bearing_moment_compliance': 'x_rotate',
    'payload_bearing_compliance': 'y_linear',
}


@pytest.fixture(scope='module')
def nominal():
    return Variant.of(load_model('rigid'))


def typical(nominal, name, times=1.0):
    values = find(name).typical(nominal, SOFT[name])
    return Cause(find(name), SOFT[name], {key: times * one for key, one in values.items()})


EXPERIMENT, EFFECTS = 'full_stroke_y_linear', (*SOFT, 'coulomb_friction')


@pytest.mark.parametrize('times', [1.0, 1.3])
@pytest.mark.parametrize('known', [(), ('cable_compliance',)])
def test_all_that_gives_comes_and_is_tentative(nominal, pool_of, times, known):
    """Of machines as soft as described, or softer; what was found already is not asked twice."""
    hidden = [typical(nominal, name, times) for name in SOFT]
    pool = pool_of(EXPERIMENT, EFFECTS, hidden=hidden)
    before = fit_causes(pool.problem, tuple(typical(nominal, name, times) for name in known))
    effects = [as_fitted(pool, before, cause) for cause in before.causes]
    pool.begin(before)
    found, own, tentative = or_flexible(pool, before, effects, [])
    assert own == effects
    there = {cause.name: cause for cause in found.causes}
    came = {one.best.cause.name for one in tentative}
    assert came == there.keys() - {cause.name for cause in before.causes}
    assert there.keys() >= {cause.name for cause in hidden}
    for cause in hidden:
        values = there[cause.name].values
        assert values['compliance'] == pytest.approx(cause.values['compliance'], rel=0.1)


def test_what_gives_has_a_damping_of_its_own(nominal, pool_of):
    """
    Eight times that of the description: its value comes out, and stiffnesses are not wrong by it.

    With the damping held as described a ring that dies quickly is taken for another stiffness.
    """
    hidden = [typical(nominal, name) for name in SOFT]
    effects, numbers = nuisance(nominal, [], Settings())
    (dampings,) = (one for one in effects if one.name == 'nuisance_dampings')
    (axis,) = dampings.axes(nominal)
    more = Cause(dampings, axis, {item.path: math.log(8.0) for item in numbers if item.is_damping})
    pool = pool_of(EXPERIMENT, EFFECTS, hidden=[*hidden, more], with_dense=True)
    before = fit_causes(pool.problem, ())
    pool.begin(before)
    found, _, _ = or_flexible(pool, before, [], [])
    found = to_the_end(pool.problem, found)
    there = {cause.effect.name: cause for cause in found.causes}
    for cause in hidden:
        values = there[cause.effect.name].values
        assert values['compliance'] == pytest.approx(cause.values['compliance'], rel=0.02)
    free = there['nuisance_dampings']
    told = {name: math.exp(x) for name, x in free.values.items() if name not in free.held}
    assert told['connections.cable.damping_factor'] == pytest.approx(8.0, rel=0.3)
    assert told['connections.payload_bearing_x.damping_factor'] == pytest.approx(8.0, rel=0.3)
    assert 'connections.belt.damping_factor' in free.held


@pytest.mark.parametrize('known', [(), tuple(SOFT)])
def test_where_nothing_more_gives_all_stays_as_it_is(nominal, pool_of, known):
    """Of a rigid machine, and of one whose compliances are all known."""
    hidden = [typical(nominal, name) for name in known]
    pool = pool_of(EXPERIMENT, EFFECTS, hidden=hidden)
    before = fit_causes(pool.problem, tuple(hidden))
    effects = [as_fitted(pool, before, cause) for cause in before.causes]
    pool.begin(before)
    assert or_flexible(pool, before, effects, []) == (before, effects, [])


def test_what_may_give_has_the_stiffness_of_its_description(nominal, pool_of):
    pool = pool_of(EXPERIMENT, EFFECTS)
    parts = pool.parts_that_may_give()
    assert {one.name for one in parts} >= {f'{name}:{axis}' for name, axis in SOFT.items()}
    stiffness = [one.stiffness for one in nominal.description.connections.values()]
    assert all(1.0 / one.values['compliance'] in stiffness for one in parts)
