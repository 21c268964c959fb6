# SPDX-License-Identifier: Apache-2.0
"""The payload frame against Appendix B's kinematics, differences in time, and levers by hand."""

from __future__ import annotations

import numpy as np
import pytest

from waferbot_plant import lagrange, payload, plant
from waferbot_plant.lagrange.from_description import mathematical_parameters
from waferbot_plant.plant import load_machine

POSITION, QUATERNION, VELOCITY = slice(0, 3), slice(3, 7), slice(7, 10)
ANGULAR, ACCELERATION, ERROR, TILT = slice(10, 13), slice(13, 16), slice(16, 19), slice(19, 22)
AWAY = {'payload': {'body': 'y_rotate_load', 'at_m': [0.7, 0.05, 0.1]}}


def frame(state, parameters) -> np.ndarray:
    row = np.zeros(payload.WIDTH)
    payload.payload_frame(state[0], parameters[0], row)
    return row


def rotation_of(quaternion: np.ndarray) -> np.ndarray:
    x, y, z, w = quaternion
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + 2.0 * w * cross + 2.0 * cross @ cross


def test_rigid_machine_has_the_frame_of_appendix_b() -> None:
    """Random states; the thesis' frame 4 is turned against ours, which is the base's at home."""
    machine = load_machine('rigid', overlays=[AWAY])
    parameters = machine.parameters()
    record = mathematical_parameters(machine.description)
    state = machine.initial_state(parameters)
    expected = np.zeros(1, lagrange.PAYLOAD_FRAME)
    lagrange.payload_frame(np.zeros(3), np.zeros(3), np.zeros(3), record, expected)
    home = expected[0]['rotation'].copy()
    random = np.random.default_rng(5)
    for _ in range(50):
        position = random.uniform(-3.0, 3.0, 3)
        velocity, acceleration = random.normal(0.0, 2.0, 3), random.normal(0.0, 20.0, 3)
        s = state[0]
        s['position'][:3], s['velocity'][:3] = position, velocity
        s['velocity_change'][:3] = acceleration * parameters[0]['step']
        lagrange.payload_frame(position, velocity, acceleration, record, expected)
        found = frame(state, parameters)
        for part, name in ((POSITION, 'position'), (VELOCITY, 'velocity')):
            np.testing.assert_allclose(found[part], expected[0][name], atol=1e-12)
        np.testing.assert_allclose(found[ANGULAR], expected[0]['angular_velocity'], atol=1e-12)
        np.testing.assert_allclose(found[ACCELERATION], expected[0]['acceleration'], atol=1e-10)
        turned = rotation_of(found[QUATERNION])
        np.testing.assert_allclose(turned @ home, expected[0]['rotation'], atol=1e-12)
        assert not found[ERROR].any()
        assert not found[TILT].any()


def test_rates_of_the_flexible_machine_are_differences_in_time() -> None:
    machine = load_machine('flexible', overlays=[AWAY, {'substeps': 20}])
    parameters = machine.parameters()
    state = machine.initial_state(parameters, holding=True)
    size = len(machine.coordinates)
    state[0]['velocity'][:size] = np.random.default_rng(6).normal(0.0, 0.05, size)
    parameters[0]['substeps'] = 1  # steps of a twentieth of a tick
    step = float(parameters[0]['step'])
    rows = []
    for _ in range(40):
        rows.append(frame(state, parameters))
        plant.advance(state, parameters, np.zeros(9))
    rows = np.array(rows)
    middle = 0.5 * (rows[1:] + rows[:-1])
    change = np.diff(rows, axis=0) / step
    np.testing.assert_allclose(change[:, POSITION], middle[:, VELOCITY], atol=2e-6)
    # the acceleration told is the mean of the step before
    scale = np.abs(rows[1:, ACCELERATION]).max()
    np.testing.assert_allclose(change[:, VELOCITY], rows[1:, ACCELERATION], atol=2e-3 * scale)


@pytest.mark.parametrize('angle', [1e-6, 2e-4])
def test_error_is_the_lever_times_the_give(angle: float) -> None:
    """The X-Rotate bearing tilts about z: the frame at (x, y) from it moves by angle (-y, x)."""
    machine = load_machine('flexible', overlays=[AWAY])
    parameters = machine.parameters()
    state = machine.initial_state(parameters)
    state[0]['position'][machine.coordinates.index('x_rotate_bearing_z')] = angle
    found = frame(state, parameters)
    arm = np.array([0.7, 0.05, 0.1]) - machine.description.joints['x_rotate'].at
    expected = angle * np.array([-arm[1], arm[0], 0.0])
    np.testing.assert_allclose(found[ERROR], expected, atol=angle**2)
    np.testing.assert_allclose(found[TILT], [0.0, 0.0, angle], atol=1e-3 * angle)


def test_motion_of_the_axes_is_no_error() -> None:
    machine = load_machine('flexible')
    parameters = machine.parameters()
    state = machine.initial_state(parameters)
    for axis, value in (('y_linear', 0.1), ('x_rotate', 2.5), ('y_rotate', -2.0)):
        state[0]['position'][machine.coordinates.index(axis)] = value
    found = frame(state, parameters)
    assert not found[ERROR].any()
    assert not found[TILT].any()
    assert found[1] == pytest.approx(0.1 + 0.05 * np.cos(2.5), abs=1e-12)  # on the Y-Rotate axis


def test_without_a_payload_there_is_nothing_to_tell() -> None:
    for machine in (
        load_machine('single_mass'),
        load_machine('rigid', overlays=[{'payload': None}]),
    ):
        parameters = machine.parameters()
        assert not frame(machine.initial_state(parameters), parameters).any()
