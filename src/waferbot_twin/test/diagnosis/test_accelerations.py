# SPDX-License-Identifier: Apache-2.0
"""The acceleration per ampere: of a mass and a force constant that are both a little off."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from waferbot_twin.diagnosis.accelerations import accelerations
from waferbot_twin.diagnosis.inference.nuisance import nuisance
from waferbot_twin.diagnosis.inference.settings import Settings
from waferbot_twin.effects import places
from waferbot_twin.effects.variant import Variant
from waferbot_twin.estimation.gauss_newton import names_of
from waferbot_twin.estimation.intervals import NORMAL_95
from waferbot_twin.models import load_model
from waferbot_twin.residuals.problem import Cause

MASS, CONSTANT = 'bodies.carriage.mass_kg', 'motors.y_linear.back_emf_lead_to_lead_v_s_m'


@pytest.fixture(scope='module')
def nominal():
    return Variant.of(load_model('rigid'))


def of_y_linear(nominal, mass, constant, covariance):
    """Return the rows of Y-Linear with both off by a share, and their covariance (2, 2)."""
    (effect, _), _ = nuisance(nominal, [], Settings())
    (axis,) = effect.axes(nominal)
    values = {item.name: 0.0 for item in effect.parameters(nominal, axis)}
    off = {MASS: mass, CONSTANT: constant}
    cause = Cause(effect, axis, values | {path: off[path] for path in off if path in values})
    problem = SimpleNamespace(nominal=nominal)
    names = [item.name for _, item in names_of(problem, [cause])]
    spread = np.zeros((len(names), len(names)))
    for row, path in enumerate(off):
        for column, other in enumerate(off):
            if path in names and other in names:
                spread[names.index(path), names.index(other)] = covariance[row, column]
    found = accelerations(problem, SimpleNamespace(causes=(cause,), covariance=spread))
    return [item for item in found if 'y_linear' in item.path]


def test_it_is_told_where_neither_mass_nor_force_constant_is(nominal):
    """Both are open by 2 %, and move together: by as much, all that moves of it is the carriage."""
    moving = places.moving_inertia(nominal, 'y_linear')
    share = nominal.description.bodies['carriage'].mass / moving
    along = np.array([1.0, share])
    covariance = 0.02**2 * np.outer(along, along) + np.diag([0.0, 1e-3**2])
    (row,) = of_y_linear(nominal, 0.05, -0.02, covariance)
    before = places.force_per_ampere(nominal, 'y_linear') / moving
    assert row.nominal == pytest.approx(before)
    assert row.found == pytest.approx(before * 0.98 / (1.0 + 0.05 * share))
    assert row.high - row.found == pytest.approx(NORMAL_95 * 1e-3 * before, rel=0.1)
    assert row.found - row.low == pytest.approx(row.high - row.found)
    assert row.unit == 'm/s2/A'


def test_what_the_logs_leave_open_is_no_row(nominal):
    assert not of_y_linear(nominal, 0.05, -0.02, np.diag([0.05**2, 0.05**2]))
    by_force = replace(nominal, force_driven=frozenset(['y_linear']))
    assert not of_y_linear(by_force, 0.05, -0.02, np.diag([1e-6, 1e-6]))
    assert of_y_linear(nominal, 0.05, -0.02, np.diag([1e-6, 1e-6]))
