# SPDX-License-Identifier: Apache-2.0
"""The dense effect: what every machine has a little different, and what no drawing shows."""

from __future__ import annotations

import pytest

from waferbot_twin.diagnosis.inference.nuisance import nuisance
from waferbot_twin.diagnosis.inference.settings import Settings
from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant
from waferbot_twin.models import load_model
from waferbot_twin.residuals.problem import Cause, apply_all


@pytest.fixture(scope='module')
def nominal():
    return Variant.of(load_model('rigid'))


def dense(nominal, **values):
    effect, _ = nuisance(nominal, Settings())
    (axis,) = effect.axes(nominal)
    parameters = effect.parameters(nominal, axis)
    return Cause(effect, axis, {item.name: values.get(item.name, 0.0) for item in parameters})


def test_with_nothing_off_the_machine_is_as_it_was(nominal):
    changed = apply_all(nominal, [dense(nominal)])
    assert changed.description.bodies.keys() == nominal.description.bodies.keys()
    for name, body in nominal.description.bodies.items():
        assert changed.description.bodies[name].mass == body.mass
    assert not any(changed.deviations.values())


def test_what_a_data_sheet_has_is_off_by_shares_and_what_no_drawing_shows_by_what_is_typical(
    nominal,
):
    _, known = nuisance(nominal, Settings())
    by_path = {item.path: item for item in known}
    mass = by_path['bodies.carriage.mass_kg']
    friction = by_path['frictions.x_rotate_usual.x_rotate']
    (typical,) = find('coulomb_friction').parameters(nominal, 'x_rotate')
    assert friction.spread == typical.typical
    off = {mass.path: 0.06, friction.path: 2.0 * friction.spread}
    changed = apply_all(nominal, [dense(nominal, **off)])
    assert changed.description.bodies['carriage'].mass == pytest.approx(
        1.06 * nominal.description.bodies['carriage'].mass
    )
    assert changed.deviations[mass.path] == pytest.approx(0.06 / Settings().spread_of_masses)
    assert changed.deviations[friction.path] == pytest.approx(2.0)


def test_friction_that_every_axis_has_adds_to_that_of_a_cause(nominal):
    cause = Cause(find('coulomb_friction'), 'x_rotate', {'friction': 1.5})
    usual = dense(nominal, **{'frictions.x_rotate_usual.x_rotate': 0.5})
    for causes in ([cause, usual], [usual, cause]):
        frictions = apply_all(nominal, causes).description.frictions
        added = frictions.keys() - nominal.description.frictions.keys()
        of_x = [name for name in added if name.startswith('x_rotate')]
        assert sorted(of_x) == ['x_rotate_coulomb_friction', 'x_rotate_usual']


def test_friction_cannot_push_and_a_constant_force_goes_either_way(nominal):
    effect, _ = nuisance(nominal, Settings())
    room = {item.name: (item.low, item.high) for item in effect.parameters(nominal, 'y_linear')}
    assert room['frictions.y_linear_usual.y_linear'][0] == 0.0
    assert room['dampers.y_linear_usual.y_linear'][0] == 0.0
    low, high = room['disturbances.y_linear_usual.y_linear']
    assert low == -high < 0.0
