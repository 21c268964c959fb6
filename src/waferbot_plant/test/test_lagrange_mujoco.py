# SPDX-License-Identifier: Apache-2.0
"""
The mathematical plant against MuJoCo, an independent engine (no common code, no common frames).

MuJoCo gets the bodies in the machine's base frame, with world axes as joint axes; it knows nothing
of Denavit-Hartenberg frames, so the conversion of the parameters is tested along.

Counterweight and Y-Rotate rotor enter in two ways. With three joints: their inertias reflected on
the joints (MuJoCo's armature) and the counterweight's weight as an applied force. With five
joints: as true bodies, the counterweight on a slide of its own and the rotor on a hinge on the
X-Rotate body with its mass, place and whole inertia tensor; the constraints d_cw = const - d1
(2.1) and theta_M = N theta3 (2.3, 2.6) then give M = B^T M5 B, h = B^T h5 with a constant B. The
second shows that the thesis' single term for the drive is exact.
"""

import numpy as np
import pytest
from lagrange_machines import Machine, random_machine, random_state

from waferbot_plant import lagrange
from waferbot_plant.lagrange import RigidBody

mujoco = pytest.importorskip('mujoco')

SEED = 20250301
SAMPLES = 1000
TOLERANCE = 1e-9


def _numbers(values) -> str:
    return ' '.join(repr(float(value)) for value in values)


def _inertial(body: RigidBody, origin: np.ndarray) -> str:
    i = np.asarray(body.inertia_kg_m2)
    full = (i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2])
    return (
        f'<inertial mass="{body.mass_kg!r}" fullinertia="{_numbers(full)}" '
        f'pos="{_numbers(np.asarray(body.centre_of_gravity_m) - origin)}"/>'
    )


def _mjcf(machine: Machine, free_drives: bool) -> str:
    """Write the machine for MuJoCo, with counterweight and rotor as bodies if ``free_drives``."""
    x_at, y_at = machine.x_rotate_at_m, machine.y_rotate_at_m
    x_rotate, extra_slide, rotor = machine.x_rotate, '', ''
    d1_armature, theta3_armature = 0.0, 0.0
    if free_drives:
        extra_slide = (
            '<body><joint name="d_cw" type="slide" axis="0 1 0"/>'
            f'<inertial mass="{machine.counterweight_mass_kg!r}" pos="0 0 0" '
            'diaginertia="1 1 1"/></body>'
        )
        place = np.asarray(machine.rotor.centre_of_gravity_m)
        rotor = (
            f'<body pos="{_numbers(place - x_at)}"><joint name="theta_M" axis="0 1 0"/>'
            f'{_inertial(machine.rotor, place)}</body>'
        )
    else:
        x_rotate = lagrange.combine([machine.x_rotate, machine.rotor])
        d1_armature = machine.counterweight_mass_kg
        theta3_armature = machine.drive.motor_inertia_kg_m2 * machine.drive_ratio**2
    return f"""
    <mujoco>
      <option gravity="0 {-machine.gravity_m_s2!r} 0"/>
      <worldbody>
        <body>
          <joint name="d1" type="slide" axis="0 1 0" armature="{d1_armature!r}"/>
          {_inertial(machine.carriage, np.zeros(3))}
          <body pos="{_numbers(x_at)}">
            <joint name="theta2" axis="1 0 0"/>
            {_inertial(x_rotate, x_at)}
            {rotor}
            <body pos="{_numbers(y_at - x_at)}">
              <joint name="theta3" axis="0 1 0" armature="{theta3_armature!r}"/>
              {_inertial(machine.y_rotate, y_at)}
              <site name="payload" pos="{_numbers(machine.payload_origin_m - y_at)}"/>
            </body>
          </body>
        </body>
        {extra_slide}
      </worldbody>
    </mujoco>"""


def _relative(ours: np.ndarray, theirs: np.ndarray) -> float:
    """
    Give the biggest difference of any element, relative to the biggest element.

    Not relative to each element itself: where two large terms happen to cancel in one of them,
    that element has no digits left to compare, in either engine.
    """
    return float(np.max(np.abs(ours - theirs)) / np.max(np.abs(theirs)))


def _report(name: str, differences: list[float]) -> None:
    print(
        f'seed {SEED}, {len(differences)} samples, {name}: biggest relative difference '
        f'{max(differences):.3g}, median {np.median(differences):.3g}'
    )
    assert max(differences) < TOLERANCE


@pytest.mark.slow
def test_acceleration_and_payload_motion_with_reflected_inertias():
    """Compare accelerations, and the wafer's position, orientation, velocity, acceleration."""
    random = np.random.default_rng(SEED)
    accelerations, motions = [], []
    ours = np.zeros(3)
    frame = np.zeros(1, lagrange.PAYLOAD_FRAME)
    for _ in range(SAMPLES):
        machine = random_machine(random)
        position, velocity, force = random_state(random)
        parameters = machine.parameters()
        lagrange.forward_dynamics(position, velocity, force, parameters, ours)

        model = mujoco.MjModel.from_xml_string(_mjcf(machine, free_drives=False))
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = position, velocity
        data.qfrc_applied[:] = force
        data.qfrc_applied[0] += machine.counterweight_mass_kg * machine.gravity_m_s2
        mujoco.mj_forward(model, data)
        accelerations.append(_relative(ours, data.qacc))

        lagrange.payload_frame(position, velocity, ours, parameters, frame)
        f = frame[0]
        site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, 'payload')
        mujoco.mj_rnePostConstraint(model, data)
        rates, accelerated = np.zeros(6), np.zeros(6)
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_SITE, site, rates, 0)
        mujoco.mj_objectAcceleration(model, data, mujoco.mjtObj.mjOBJ_SITE, site, accelerated, 0)
        accelerated[3:] += model.opt.gravity  # MuJoCo's is what an accelerometer feels
        origin = np.array([0.0, *machine.x_rotate_at_m[1:]])
        axes_at_zero_pose = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
        for mine, theirs in (
            (f['position'] + origin, data.site_xpos[site]),
            (f['rotation'], data.site_xmat[site].reshape(3, 3) @ axes_at_zero_pose),
            (f['angular_velocity'], rates[:3]),
            (f['velocity'], rates[3:]),
            (f['angular_acceleration'], accelerated[:3]),
            (f['acceleration'], accelerated[3:]),
        ):
            motions.append(_relative(mine, theirs))
    _report('joint acceleration', accelerations)
    _report('payload motion', motions)


def test_mass_matrix_bias_and_acceleration_with_true_counterweight_and_rotor():
    """Project MuJoCo's five free coordinates on our three and compare M, h and M^-1 (Q - h)."""
    random = np.random.default_rng(SEED + 1)
    names = ('d1', 'theta2', 'theta3', 'theta_M', 'd_cw')
    differences: dict[str, list[float]] = {'mass matrix': [], 'bias': [], 'joint acceleration': []}
    matrix, bias, acceleration = np.zeros((3, 3)), np.zeros(3), np.zeros(3)
    for _ in range(SAMPLES):
        machine = random_machine(random)
        position, velocity, force = random_state(random)
        parameters = machine.parameters()

        model = mujoco.MjModel.from_xml_string(_mjcf(machine, free_drives=True))
        data = mujoco.MjData(model)
        order = [model.joint(name).dofadr[0] for name in names]
        ratio = machine.drive_ratio
        projection = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, ratio], [-1, 0, 0]])
        data.qpos[order], data.qvel[order] = projection @ position, projection @ velocity
        mujoco.mj_forward(model, data)
        full = np.zeros((5, 5))
        for column in range(5):
            unit = np.zeros(5)
            unit[column] = 1.0
            mujoco.mj_mulM(model, data, full[column], unit)
        theirs_m = projection.T @ full[np.ix_(order, order)] @ projection
        theirs_h = projection.T @ data.qfrc_bias[order]

        lagrange.mass_matrix(position, parameters, matrix)
        lagrange.bias(position, velocity, parameters, bias)
        lagrange.forward_dynamics(position, velocity, force, parameters, acceleration)
        differences['mass matrix'].append(_relative(matrix, theirs_m))
        differences['bias'].append(_relative(bias, theirs_h))
        differences['joint acceleration'].append(
            _relative(acceleration, np.linalg.solve(theirs_m, force - theirs_h))
        )
    for name, values in differences.items():
        _report(name, values)
