# SPDX-License-Identifier: Apache-2.0
"""Rings at lines are found once for a line; which of them is likely is asked each time."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from waferbot_twin.diagnosis.proposals import rings
from waferbot_twin.diagnosis.proposals.spectral_lines import Line
from waferbot_twin.effects import find
from waferbot_twin.residuals.problem import Cause


def compliance(name, axis, value):
    return Cause(find(name), axis, {'compliance': value}, narrow=('compliance',))


BELT = compliance('belt_compliance', 'y_rotate', 1e-6)
CLOSE_BY = BELT.with_values({'compliance': 1.001e-6})
CABLE = compliance('cable_compliance', 'y_linear', 1e-7)
AT = {400.0: [(BELT, 'belt'), (CABLE, 'cable')], 600.0: [(CLOSE_BY, 'belt')]}


@pytest.fixture
def asked(monkeypatch):
    """Stand in for what simulates; return what was asked for."""
    said = []
    gains = {'belt': 30.0, 'cable': 50.0, 'belt closer': 80.0, 'cable closer': -10.0}

    def at_line(problem, base, rivals, line, workers):
        said.append(line.frequency_hz)
        return AT[line.frequency_hz]

    def closer(problem, base, cause):
        said.append(cause.name)
        return cause

    monkeypatch.setattr(rings, 'lines', lambda problem, base: base.lines)
    monkeypatch.setattr(rings, 'at_line', at_line)
    monkeypatch.setattr(rings, 'closer', closer)
    monkeypatch.setattr(
        rings,
        'ring_of',
        lambda problem, base, cause: (cause, f'{cause.name.split("_")[0]} closer'),
    )
    for name in ('gain_in_any_phase', 'gain_as_it_is'):
        monkeypatch.setattr(rings, name, lambda problem, base, change: gains[change])
    return said


def base_with(*frequencies_hz, causes=()):
    found = [Line('y_linear', frequency_hz, 2.0, 2250.0) for frequency_hz in frequencies_hz]
    return SimpleNamespace(causes=causes, lines=found, samples=1)


def test_each_line_is_looked_at_once_while_nothing_else_gives(asked):
    find_rings = rings.Rings(None, 8)
    first = find_rings(base_with(400.0, 600.0), [BELT, CABLE])
    assert asked == [400.0, 600.0, 'cable_compliance:y_linear', 'belt_compliance:y_rotate']
    # As it is the cable makes the logs less likely, though in some phase it gains most.
    assert {item.cause.name: item.score for item in first} == {CABLE.name: -5.0, BELT.name: 40.0}
    friction = Cause(find('coulomb_friction'), 'y_linear', {'friction': 1.0})
    again = find_rings(base_with(600.0, 400.0, causes=(friction,)), [BELT, CABLE])
    assert {item.cause.name for item in again} == {CABLE.name, BELT.name}
    assert asked[4:] == ['belt_compliance:y_rotate']  # begun at the other line, close by
    find_rings(base_with(400.0, causes=(CABLE,)), [BELT])
    assert asked[5:] == [400.0, 'belt_compliance:y_rotate']


def test_only_so_many_are_tried_closer(asked):
    (best,) = rings.Rings(None, 1)(base_with(400.0), [BELT, CABLE])
    assert best.cause is CABLE
    assert asked == [400.0, 'cable_compliance:y_linear']
