# SPDX-License-Identifier: Apache-2.0
"""
Parameters of the mathematical plant, and their making from bodies given in the base frame.

The equations want each link's centre of gravity and inertia tensor in its own Denavit-Hartenberg
frame. A designer has them in the frame of the machine, at the zero pose;
``parameters_from_base_frame`` turns the one into the other.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from waferbot_lockstep.errors import UserError

PARAMETERS = np.dtype(
    [
        # Link 1: carriage with all that it carries and that never turns (X-Rotate stator).
        ('carriage_mass', 'f8'),  # m1, kg
        ('carriage_centre_of_gravity', 'f8', (3,)),  # r_G1/1 in frame 1, m
        # Link 2: X-Rotate rotor, shaft and load, with Y-Rotate motor and gearbox as if locked.
        ('x_rotate_mass', 'f8'),  # m2, kg
        ('x_rotate_centre_of_gravity', 'f8', (3,)),  # r_G2/2 in frame 2, m
        ('x_rotate_inertia', 'f8', (3, 3)),  # I2 about its centre of gravity in frame 2, kg m^2
        # Link 3: what the belt turns, end effector and wafer included.
        ('y_rotate_mass', 'f8'),  # m3, kg
        ('y_rotate_centre_of_gravity', 'f8', (3,)),  # r_G3/3 in frame 3, m
        ('y_rotate_inertia', 'f8', (3, 3)),  # I3 about its centre of gravity in frame 3, kg m^2
        ('counterweight_mass', 'f8'),  # m_cw, kg
        ('x_rotate_offset', 'f8'),  # d2, m: frame 1 to frame 2 along x of the base
        ('y_rotate_offset', 'f8'),  # a2, m: frame 2 to frame 3 along x2; zero in Table 2.1
        ('payload_origin', 'f8', (3,)),  # origin of frame 4 in frame 3, m; Table 2.1: [0, 0, d4]
        # Cable (2.1); heights upwards, m.
        ('cable_pulley_height', 'f8'),  # c3, pulley centre over the base
        ('carriage_cable_mount_height', 'f8'),  # c1, mount over frame 1
        ('counterweight_cable_mount_height', 'f8'),  # c2, mount over the centre of gravity
        ('cable_length', 'f8'),  # L_cable
        ('cable_pulley_radius', 'f8'),  # r_p
        # Y-Rotate drive (2.3 to 2.8).
        ('motor_inertia', 'f8'),  # J_3M, motor and gearbox at the motor's shaft, kg m^2
        ('gear_ratio', 'f8'),  # R_G, turns of the motor per turn of the gearbox output
        ('drive_pulley_radius', 'f8'),  # r1, m
        ('driven_pulley_radius', 'f8'),  # r2, m
        ('gravity', 'f8'),  # g, m/s^2, along -y of the base
    ],
    align=True,
)
"""
One record, used as an array of one element.

Inertia tensors are tensors: their off-diagonal elements are -(integral of x y dm), the negative of
the "products of inertia" that some CAD programs print. The carriage needs no inertia tensor as it
never turns.
"""

# Axes of frames 1, 2 and 3 at the zero pose, as columns, in base axes (2.9 with Table 2.1).
_FRAME_1 = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
_FRAME_2 = np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]])
_FRAME_3 = _FRAME_1

# Relative. Covers the rounding of printed tensors; anything bigger is a wrong sign or axis.
_TENSOR_TOLERANCE = 1e-9


@dataclass(frozen=True)
class RigidBody:
    """
    A rigid body at the zero pose, in axes of the base frame (x, y up, z).

    mass_kg                 > 0
    centre_of_gravity_m     (3,)   from the origin of the base frame
    inertia_kg_m2           (3, 3) about the centre of gravity, a tensor (see PARAMETERS on signs)
    """

    mass_kg: float
    centre_of_gravity_m: Sequence[float]
    inertia_kg_m2: Sequence[Sequence[float]]


@dataclass(frozen=True)
class CableGeometry:
    """
    The cable over the pulleys at the zero pose (2.1); heights upwards from the base frame's
    origin.

    Only the height of the counterweight, and with it the constant of the potential energy, depends
    on this. The motion does not.
    """

    pulley_height_m: float
    carriage_mount_height_m: float
    counterweight_mount_above_centre_of_gravity_m: float
    cable_length_m: float
    pulley_radius_m: float


@dataclass(frozen=True)
class YRotateDrive:
    """Motor, gearbox and belt of Y-Rotate (2.3 to 2.8); inertia at the motor's shaft."""

    motor_inertia_kg_m2: float
    gear_ratio: float
    drive_pulley_radius_m: float
    driven_pulley_radius_m: float


def combine(bodies: Iterable[RigidBody]) -> RigidBody:
    """
    Bodies fixed to one another as one: sum of masses, common centre of gravity, parallel axes.

    I = sum(I_i + m_i (|s_i|^2 1 - s_i s_i^T)), with s_i from the common centre of gravity to that
    of body i. Raises ``UserError`` if there is no mass.
    """
    bodies = list(bodies)
    mass = float(sum(body.mass_kg for body in bodies))
    if not mass > 0.0:
        raise UserError(
            f'bodies to be combined must have mass; {len(bodies)} given weigh {mass} kg'
        )
    centre = np.zeros(3)
    for body in bodies:
        centre += body.mass_kg / mass * np.asarray(body.centre_of_gravity_m)
    inertia = np.zeros((3, 3))
    for body in bodies:
        offset = np.asarray(body.centre_of_gravity_m) - centre
        inertia += np.asarray(body.inertia_kg_m2)
        inertia += body.mass_kg * (np.sum(offset * offset) * np.eye(3) - np.outer(offset, offset))
    return RigidBody(mass, tuple(centre.tolist()), tuple(map(tuple, inertia.tolist())))


def parameters_from_base_frame(
    *,
    carriage: RigidBody,
    x_rotate: RigidBody,
    y_rotate: RigidBody,
    counterweight_mass_kg: float,
    drive: YRotateDrive,
    cable: CableGeometry,
    x_rotate_at_m: Sequence[float] = (0.0, 0.0, 0.0),
    y_rotate_at_m: Sequence[float] = (0.0, 0.0, 0.0),
    payload_origin_m: Sequence[float] | None = None,
    gravity_m_s2: float = 9.81,
) -> np.ndarray:
    """
    Parameter record, (1,) of PARAMETERS, from bodies at the zero pose in the machine's base frame.

    ``carriage``, ``x_rotate`` and ``y_rotate`` are links 1, 2 and 3 (``combine`` joins the parts
    of a link). The Y-Rotate motor and gearbox belong to ``x_rotate``, which carries them.

    ``x_rotate_at_m`` is any point of the X-Rotate axis (parallel to x), ``y_rotate_at_m`` any
    point of the Y-Rotate axis (parallel to y), at the zero pose. d2 is the x of the latter; a2 is
    how far the axes miss each other along z, zero in the thesis.

    The equations' own base frame is the machine's, moved along y and z to the X-Rotate axis:
    results of ``payload_frame``, ``counterweight_height`` and the potential energy count from
    there.

    ``payload_origin_m`` is the wafer's centre at the zero pose, by default the origin of frame 3:
    on the Y-Rotate axis, at the height of the X-Rotate axis.

    Raises ``UserError`` for a record that ``check`` refuses.
    """
    _, height, depth = _vector(x_rotate_at_m, 'x_rotate_at_m')
    d2, _, y_rotate_depth = _vector(y_rotate_at_m, 'y_rotate_at_m')
    origin_1 = np.array([0.0, height, depth])
    origin_2 = np.array([d2, height, depth])
    origin_3 = np.array([d2, height, y_rotate_depth])
    payload = (
        origin_3 if payload_origin_m is None else _vector(payload_origin_m, 'payload_origin_m')
    )

    parameters = np.zeros(1, PARAMETERS)
    p = parameters[0]
    for link, body, axes, origin in (
        ('carriage', carriage, _FRAME_1, origin_1),
        ('x_rotate', x_rotate, _FRAME_2, origin_2),
        ('y_rotate', y_rotate, _FRAME_3, origin_3),
    ):
        centre = _vector(body.centre_of_gravity_m, f'{link}: centre_of_gravity_m')
        p[f'{link}_mass'] = body.mass_kg
        p[f'{link}_centre_of_gravity'] = axes.T @ (centre - origin)
        if link != 'carriage':
            tensor = _tensor(body.inertia_kg_m2, f'{link}: inertia_kg_m2')
            p[f'{link}_inertia'] = axes.T @ tensor @ axes
    p['counterweight_mass'] = counterweight_mass_kg
    p['x_rotate_offset'] = d2
    p['y_rotate_offset'] = y_rotate_depth - depth
    p['payload_origin'] = _FRAME_3.T @ (payload - origin_3)
    p['cable_pulley_height'] = cable.pulley_height_m - height
    p['carriage_cable_mount_height'] = cable.carriage_mount_height_m - height
    p['counterweight_cable_mount_height'] = cable.counterweight_mount_above_centre_of_gravity_m
    p['cable_length'] = cable.cable_length_m
    p['cable_pulley_radius'] = cable.pulley_radius_m
    p['motor_inertia'] = drive.motor_inertia_kg_m2
    p['gear_ratio'] = drive.gear_ratio
    p['drive_pulley_radius'] = drive.drive_pulley_radius_m
    p['driven_pulley_radius'] = drive.driven_pulley_radius_m
    p['gravity'] = gravity_m_s2
    check(parameters)
    return parameters


def check(parameters: np.ndarray) -> None:
    """
    Raise ``UserError`` if a record could not belong to a real machine.

    Finite values; positive link masses, gear ratio and pulley radii; counterweight and motor
    inertia not negative; inertia tensors symmetric, positive definite and within the triangle
    inequality (no principal moment bigger than the sum of the other two). This makes M(q) positive
    definite at every pose.
    """
    if parameters.dtype != PARAMETERS or parameters.shape != (1,):
        raise UserError(
            'parameters of the mathematical plant must be an array of one lagrange.PARAMETERS '
            f'record, not {parameters.dtype} of shape {parameters.shape}'
        )
    p = parameters[0]
    for name in p.dtype.names or ():
        if not np.all(np.isfinite(p[name])):
            raise UserError(f'{name}: must be finite, is {p[name].tolist()}')
    for name in (
        'carriage_mass',
        'x_rotate_mass',
        'y_rotate_mass',
        'gear_ratio',
        'drive_pulley_radius',
        'driven_pulley_radius',
    ):
        if not p[name] > 0.0:
            raise UserError(f'{name}: must be greater than zero, is {p[name]}')
    for name in ('counterweight_mass', 'motor_inertia'):
        if not p[name] >= 0.0:
            raise UserError(f'{name}: must not be negative, is {p[name]}')
    for name in ('x_rotate_inertia', 'y_rotate_inertia'):
        _check_inertia(p[name], name)


def _check_inertia(tensor: np.ndarray, name: str) -> None:
    size = np.max(np.abs(tensor))
    if np.max(np.abs(tensor - tensor.T)) > _TENSOR_TOLERANCE * size:
        raise UserError(f'{name}: must be symmetric, is {tensor.tolist()}')
    smallest, middle, biggest = np.linalg.eigvalsh(tensor)
    moments = f'principal moments {smallest:.6g}, {middle:.6g}, {biggest:.6g} kg m^2'
    if not smallest > 0.0:
        raise UserError(f'{name}: must be positive definite; {moments}')
    if biggest > (smallest + middle) * (1.0 + _TENSOR_TOLERANCE):
        raise UserError(
            f'{name}: no body has these {moments}: none may exceed the sum of the others; '
            'check the signs of the off-diagonal elements and the units'
        )


def _vector(values: Sequence[float], name: str) -> np.ndarray:
    vector = np.asarray(values, dtype=float)
    if vector.shape != (3,):
        raise UserError(f'{name}: must be three numbers x, y, z; has shape {vector.shape}')
    return vector


def _tensor(values: Sequence[Sequence[float]], name: str) -> np.ndarray:
    tensor = np.asarray(values, dtype=float)
    if tensor.shape != (3, 3):
        raise UserError(f'{name}: must be three rows of three numbers; has shape {tensor.shape}')
    return tensor
