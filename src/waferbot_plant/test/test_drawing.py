# SPDX-License-Identifier: Apache-2.0
"""Pictures of the machine: boxes that weigh what the bodies weigh, in the right places."""

from __future__ import annotations

import math
import struct
from pathlib import Path

import numpy as np
import pytest

from waferbot_plant import drawing, modes
from waferbot_plant.plant import load_machine


def test_boxes_have_the_moments_of_the_bodies() -> None:
    machine = load_machine('flexible')
    for body in machine.description.bodies.values():
        sides, axes = body.equivalent_box()
        own = body.mass / 12.0 * (np.sum(sides**2) - sides**2)
        assert axes @ np.diag(own) @ axes.T == pytest.approx(body.inertia, rel=1e-9, abs=1e-9)
        points = drawing.corners(machine.description)[body.name]
        assert points.mean(axis=0) == pytest.approx(body.centre_of_gravity)


def test_bodies_are_drawn_where_the_pose_puts_them() -> None:
    """Y-Linear lifts the payload and lowers the counterweight; X-Rotate turns about its axis."""
    machine = load_machine('rigid')
    parameters = machine.parameters()
    home = drawing.corners(machine.description)
    state = machine.initial_state(parameters, {'y_linear': 0.1, 'x_rotate': math.pi / 2})
    moved = drawing.moved_corners(machine, state, parameters)
    up = np.array([0.0, 0.1, 0.0])
    assert moved['carriage'] == pytest.approx(home['carriage'] + up)
    assert moved['counterweight'] == pytest.approx(home['counterweight'] - up)
    x, y, z = home['x_rotate_load'].T
    assert moved['x_rotate_load'] == pytest.approx(np.column_stack([x, -z, y]) + up)


@pytest.mark.slow
def test_pictures_are_the_same_each_time(tmp_path: Path) -> None:
    machine = load_machine('flexible')
    found = modes.coupled_modes(machine)
    for name in ('a', 'b'):
        drawing.draw_mechanism(machine, tmp_path / f'{name}.svg')
        drawing.draw_modes(machine, found[:2], tmp_path / f'modes_{name}.png')
    assert (tmp_path / 'a.svg').read_bytes() == (tmp_path / 'b.svg').read_bytes()
    pictures = [(tmp_path / f'modes_{name}.png').read_bytes() for name in ('a', 'b')]
    assert pictures[0] == pictures[1]
    text = (tmp_path / 'a.svg').read_text('utf-8')
    for name in (*machine.description.bodies, *machine.description.connections, 'y_rotate_motor'):
        if name not in ('gearbox', 'belt', 'cable'):  # those stand in their transmission's line
            assert name in text


@pytest.mark.slow
@pytest.mark.parametrize('count', [4, 20])
def test_the_picture_of_the_modes_fits_a_screen(count: int, tmp_path: Path) -> None:
    """The size of a PNG stands in its header; a laptop's screen is 1920 by 1080."""
    machine = load_machine('flexible')
    found = modes.coupled_modes(machine)
    picture = tmp_path / 'modes.png'
    drawing.draw_modes(machine, (found + found)[:count], picture)
    width, height = struct.unpack('>II', picture.read_bytes()[16:24])
    assert width <= 1920
    assert height <= 1080


@pytest.mark.parametrize(
    'name', ['single_mass', 'two_mass_drive', 'planar_two_link_arm', 'simplified', 'rigid']
)
def test_any_machine_can_be_drawn(name: str, tmp_path: Path) -> None:
    drawing.draw_mechanism(load_machine(name), tmp_path / 'machine.png')
    assert (tmp_path / 'machine.png').read_bytes()[:4] == b'\x89PNG'
