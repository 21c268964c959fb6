# SPDX-License-Identifier: Apache-2.0
"""Ranges of validity against statics by hand, and what is told when one is left."""

from __future__ import annotations

import math

import numpy as np
import pytest

from waferbot_lockstep.timing import Timing
from waferbot_plant import loads
from waferbot_plant.parts import belt, cable
from waferbot_plant.plant import load_machine
from waferbot_plant.validity import Extremes, Watch


@pytest.fixture(scope='module')
def machine():
    return load_machine('flexible')


def rest(machine, ticks: int = 3) -> np.ndarray:
    """Return rows of a machine at home, at 0, 180, ..."""
    parameters = machine.parameters()
    state, row = machine.initial_state(parameters), np.zeros(loads.width(3))
    loads.take(state, parameters, loads.begin(3), row)
    return np.tile(row, (ticks, 1))


def watched(machine, rows: np.ndarray) -> dict[tuple[str, str], Extremes]:
    watch = Watch(machine)
    watch.note(loads.Loads.of_rows(180 * np.arange(len(rows)), rows))
    return {(one.check.place, one.check.what): one for one in watch.extremes()}


def place_of(machine, spring: str) -> int:
    return [element.name for element in machine.assembly.springs].index(spring)


def carried(machine, names: tuple[str, ...], at: np.ndarray) -> tuple[float, np.ndarray]:
    """Return mass of bodies and their centre of gravity from a point."""
    bodies = [machine.description.bodies[name] for name in names]
    mass = sum(body.mass for body in bodies)
    return mass, sum(body.mass * body.centre_of_gravity for body in bodies) / mass - at


def test_loads_at_rest_are_those_of_statics(machine) -> None:
    """(5.20), (5.21) for the guide; m g and m g x for the ring. They lie in the middle of the range."""
    found = watched(machine, rest(machine))
    payload = tuple(name for name in machine.description.bodies if name != 'counterweight')
    guide = machine.description.parts['payload_bearing']
    mass, centre = carried(machine, payload, np.zeros(3))
    for what, offset in (('radial load', centre[0]), ('transverse load', centre[2])):
        extremes = found['payload_bearing block', what]
        expected = mass * 9.81 * abs(offset) / (2.0 * guide.vertical_spacing_m)
        assert extremes.high == pytest.approx(expected, rel=1e-3)
        assert extremes.check.least == pytest.approx(0.75 * expected, rel=1e-3)
        assert extremes.check.most == pytest.approx(1.25 * expected, rel=1e-3)
    joint = machine.description.joints['x_rotate']
    beyond = ('x_rotate_rotor', 'x_rotate_load', 'y_rotate_load')
    mass, centre = carried(machine, beyond, joint.at)
    ring = found['x_rotate_bearing', 'moment']
    assert ring.high == pytest.approx(mass * 9.81 * abs(centre[0]), rel=1e-3)
    assert not any(extremes.outside for extremes in found.values())


def test_belt_under_a_torque(machine) -> None:
    """The spans share the pull T / r_2; the slack one is gone at 2 F_pre."""
    part = machine.description.parts['belt']
    place = place_of(machine, 'y_rotate_drive')
    radius = part.driven_pulley_teeth * part.tooth_pitch_m / (2.0 * math.pi)
    rows = rest(machine)
    pulls = (100.0, 1.1 * 2.0 * part.span_pretension_n, 300.0)
    for row, pull in zip(rows, pulls, strict=True):
        row[place], row[loads.SPRINGS + place] = -pull * radius, 0.2 * pull * radius
    found = watched(machine, rows)
    slack, tight = (found['belt', f'tension of the {side} span'] for side in ('slack', 'tight'))
    assert slack.low == pytest.approx(part.span_pretension_n - 150.0)
    assert (slack.first_tick, slack.low_tick) == (180, 360)
    assert tight.high == pytest.approx(300.0)  # the slack span bears nothing
    assert not tight.outside
    text = slack.text(Timing())
    assert text.startswith('belt: tension of the slack span -30 N (at least 0 N) at 0.020 s')
    assert 'first left at 0.010 s' in text
    rows[2, place] = -400.0 * radius
    assert watched(machine, rows)['belt', 'tension of the tight span'].outside


def test_pull_of_the_belt_is_told_of_a_belt_that_slips() -> None:
    """A flat belt by Euler and Eytelwein on the wrap of the smaller pulley; `slip_force_n` if less."""
    overlay = {'parts': {'belt': {'friction_coefficient': 0.3}}}
    machine = load_machine('flexible', overlays=[overlay])
    part = machine.description.parts['belt']
    difference = part.driven_pulley_radius_m - part.drive_pulley_radius_m
    wrap = 2.0 * math.acos(difference / belt.centre_distance_m(part))
    ratio = math.exp(0.3 * wrap)
    expected = 2.0 * part.span_pretension_n * (ratio - 1.0) / (ratio + 1.0)
    assert watched(machine, rest(machine))['belt', 'pull'].check.most == pytest.approx(expected)
    toothed = load_machine('flexible').description.parts['belt']
    assert belt.slip_pull_n(toothed) == 2.0 * toothed.span_pretension_n
    slipping = {'connections': {'belt': {'slip_force_n': 50.0}}}
    both = load_machine('flexible', overlays=[overlay, slipping])
    assert watched(both, rest(both))['belt', 'pull'].check.most == 50.0


def test_least_tension_of_a_rope_is_where_the_elastica_is_upright() -> None:
    """A long free end bends by theta' = 2 sqrt(T / E I) sin(theta / 2), and leaves with 1 / R."""
    part = load_machine('flexible').description.parts['cable']
    least = cable.least_tension_n(part)
    wire = part.nominal_diameter_m / 15.0
    rigidity = part.elastic_modulus_pa * 133.0 * math.pi * wire**4 / 64.0
    tension = 3.0 * least
    length = math.sqrt(rigidity / tension)
    theta = 2.0 * math.asin(0.5 * length / part.pulley_radius_m)
    assert 1.0 - math.cos(theta) == pytest.approx(least / tension)
    upright = 2.0 * math.asin(0.5 * math.sqrt(rigidity / least) / part.pulley_radius_m)
    assert upright == pytest.approx(math.pi / 2.0)


def test_a_slack_cable_and_a_loaded_ring_are_told(machine) -> None:
    rows = rest(machine)
    rows[1, 2 * loads.SPRINGS] = 0.0
    place = place_of(machine, 'x_rotate_bearing_z')
    rows[2, loads.SPRINGS + place] += 30.0
    watch = Watch(machine)
    for tick, row in zip((0, 180, 360), rows, strict=True):  # one by one, as a node does
        watch.note(loads.Loads.of_rows(np.array([tick]), row[np.newaxis]))
    told = {one.check.what: one for one in watch.departures()}
    assert set(told) == {'tension of a rope', 'moment', 'moment beside the chart'}
    assert told['tension of a rope'].low == 0.0
    assert told['moment'].high == pytest.approx(abs(rows[0, place]) + 30.0)
    watch.forget()
    assert watch.extremes() == []


def test_hot_windings_are_told_and_cold_motors_and_rigid_parts_have_nothing_to_tell() -> None:
    warming = {'motors': {'y_linear': {'heating': {'state': 'warming'}}}}
    machine = load_machine('flexible', overlays=[warming])
    rows = rest(machine)
    first = 2 * (loads.SPRINGS + loads.CABLES)
    rows[2, first : first + 3] = 160.0
    found = watched(machine, rows)
    assert found['motor y_linear', 'temperature of the windings'].first_tick == 360
    assert ('motor x_rotate', 'temperature of the windings') not in found
    assert watched(load_machine('rigid'), rest(load_machine('rigid'))) == {}
