# SPDX-License-Identifier: Apache-2.0
"""Small corrections: intervals end at what is possible, and what the logs do not tell says so."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from waferbot_twin.diagnosis.corrections import Correction, stated
from waferbot_twin.diagnosis.inference.nuisance import corrections, nuisance
from waferbot_twin.diagnosis.inference.settings import Settings
from waferbot_twin.diagnosis.report import correction_row
from waferbot_twin.effects.variant import Variant
from waferbot_twin.estimation.intervals import NORMAL_95
from waferbot_twin.models import load_model
from waferbot_twin.residuals.prior_block import KNOWN_FROM
from waferbot_twin.residuals.problem import Cause

PATH = 'bodies.carriage.mass_kg'
SPREAD = Settings().spread_of_masses


@pytest.fixture(scope='module')
def nominal():
    return Variant.of(load_model('rigid'))


def told(nominal, x, error):
    """Return the row of a mass that is off by a share `x` with a standard error, all else as it was."""
    (effect, *_), known = nuisance(nominal, [], Settings())
    (axis,) = effect.axes(nominal)
    values = {item.name: 0.0 for item in effect.parameters(nominal, axis)}
    cause = Cause(effect, axis, {**values, PATH: x})
    mass = next(item.value for item in known if item.path == PATH)
    ends = (mass * (1.0 + x + side * NORMAL_95 * error) for side in (-1.0, 1.0))
    correction = Correction('mass of y_linear', PATH, 'kg', mass, mass * (1.0 + x), *ends)
    errors = [error if item.name == PATH else 0.0 for item in effect.parameters(nominal, axis)]
    diagnosis = SimpleNamespace(
        problem=SimpleNamespace(nominal=nominal),
        after=SimpleNamespace(causes=(cause,), covariance=np.diag(np.square(errors))),
        corrections=[correction],
    )
    squares = (x**2 + error**2) / SPREAD**2
    prior = SPREAD * math.sqrt((KNOWN_FROM + squares) / (KNOWN_FROM + len(values)))
    (item,) = stated(diagnosis)
    return mass, prior, item


def test_an_interval_ends_at_what_is_possible(nominal):
    mass, _, item = told(nominal, 0.08, 0.01)
    assert item.high == pytest.approx(mass * (1.0 + 3.0 * SPREAD))
    assert item.low == pytest.approx(mass * (1.08 - NORMAL_95 * 0.01))
    assert item.told
    assert not item.on_bound


def test_a_value_on_its_bound_is_no_finding(nominal):
    _, _, item = told(nominal, 3.0 * SPREAD, 0.001)
    assert item.on_bound
    assert 'on its bound: no finding' in correction_row(item, nominal.titles)['interval']


@pytest.mark.parametrize(
    ('share', 'known'), [(1.0, False), (0.95, False), (0.8, True), (0.1, True)]
)
def test_what_is_known_no_better_than_before_the_logs_is_not_told(nominal, share, known):
    _, prior, _ = told(nominal, 0.0, 0.01)
    _, _, item = told(nominal, 0.0, share * prior)
    assert item.told == known
    assert ('the logs do not tell it' in correction_row(item, nominal.titles)['interval']) != known


def test_an_axis_is_said_as_it_is_called(nominal):
    _, _, item = told(nominal, 0.01, 0.001)
    assert correction_row(item, nominal.titles)['parameter'] == 'mass of Y-Linear'


@pytest.mark.parametrize('x', [0.0, 1.2])
def test_what_is_known_to_a_factor_has_an_interval_of_factors(nominal, x):
    """Of the damping of a bearing 20 % either way is told, a factor of e as well known before is not."""
    path, error = 'connections.x_rotate_bearing_radial.damping_factor', 0.2
    (_, effect), known = nuisance(nominal, [], Settings())
    number = next(item for item in known if item.path == path)
    cause = Cause(
        effect, 'y_linear', {**dict.fromkeys(effect.typical(nominal, 'y_linear'), 0.0), path: x}
    )
    problem = SimpleNamespace(nominal=nominal)
    errors = [error if item == path else 9.0 for item in cause.values]
    found = SimpleNamespace(causes=(cause,), covariance=np.diag(np.square(errors)))
    rows = {row.path: row for row in corrections(problem, found, list(known))}
    row = rows[path]
    assert row.found == pytest.approx(number.value * math.exp(x))
    assert row.high / row.found == pytest.approx(math.exp(NORMAL_95 * error))
    assert row.found / row.low == pytest.approx(math.exp(NORMAL_95 * error))
    diagnosis = SimpleNamespace(problem=problem, after=found, corrections=list(rows.values()))
    told = {item.correction.path: item for item in stated(diagnosis)}
    assert told[path].told
    assert not any(item.told for other, item in told.items() if other != path)
    assert not told[path].on_bound
