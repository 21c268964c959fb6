# SPDX-License-Identifier: Apache-2.0
"""
A robot's URDF as the description of a machine: bodies, joints, friction; and what it lacks.

A robot of one to eight joints that slide or turn, in a row or a tree. Fixed joints are melted into the
body that they are fixed to. The frame stays the robot's, z up, with gravity to match; every vector is at
the home pose, where all joints are zero. `<dynamics>` becomes friction and damping.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from waferbot_lockstep.contract import AXES
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.layout import MOST_AXES, SIDES

Vector = NDArray[np.float64]

GRAVITY_M_S2 = [0.0, 0.0, -9.81]
MOVING = {'revolute': 'revolute', 'continuous': 'revolute', 'prismatic': 'prismatic'}


@dataclass
class _Body:
    """What is fixed together: mass, first moment and inertia about the origin, base frame."""

    mass: float = 0.0
    moment: Vector = field(default_factory=lambda: np.zeros(3))
    inertia: Vector = field(default_factory=lambda: np.zeros((3, 3)))


@dataclass(frozen=True)
class FromUrdf:
    """A description as data, the axes in the order of the joints, and what a user has to add."""

    description: dict[str, Any]
    lacks: tuple[str, ...]


def read_urdf(text: str, source: str) -> FromUrdf:
    """
    Return a robot's URDF as a description; raises `UserError` naming `source` and the element.

    Of up to three joints, one with the name of an axis of the shipped machine becomes that one; the
    others, in their order, those that are left: `y_linear`, `x_rotate`, `y_rotate`, whatever they are on
    that robot. Of more, each becomes an axis of its own name.
    """
    try:
        robot = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise UserError(f'{source}: it is no XML: {error}') from error
    if robot.tag != 'robot':
        raise UserError(f'{source}: its root is <{robot.tag}>; it must be <robot>')
    links = {_name(link, source): link for link in robot.findall('link')}
    joints = robot.findall('joint')
    children = {_link(joint, 'child', source) for joint in joints}
    roots = [name for name in links if name not in children]
    if len(roots) != 1:
        raise UserError(f'{source}: {len(roots)} links are no child of a joint; there must be one')
    moving = [joint for joint in joints if joint.get('type') != 'fixed']
    for joint in moving:
        if joint.get('type') not in MOVING:
            raise UserError(
                f'{source}: joint {joint.get("name")!r} is {joint.get("type")}; it must be fixed, '
                'revolute, continuous or prismatic'
            )
    if not 1 <= len(moving) <= MOST_AXES:
        raise UserError(f'{source}: {len(moving)} joints move; one to {MOST_AXES} can be taken')
    return _Reader(source, links, joints, str(robot.get('name', 'robot'))).read(roots[0])


class _Reader:
    """Walks from the root outwards."""

    def __init__(
        self,
        source: str,
        links: dict[str, ElementTree.Element],
        joints: list[ElementTree.Element],
        name: str,
    ) -> None:
        self.source, self.links, self.joints, self.name = source, links, joints, name
        self.bodies: dict[str, _Body] = {}
        self.found: dict[str, Any] = {'joints': {}, 'axes': {}, 'frictions': {}, 'dampers': {}}
        self.lacks: list[str] = []

    def read(self, root: str) -> FromUrdf:
        self._walk(root, 'base', Rotation.identity(), np.zeros(3))
        for name, body in self.bodies.items():
            if name != 'base' and body.mass <= 0.0:
                raise UserError(f'{self.source}: {name} moves without a mass; give it <inertial>')
        data: dict[str, Any] = {
            'name': self.name,
            'gravity_m_s2': GRAVITY_M_S2,
            'bodies': {
                name: _as_data(body) for name, body in self.bodies.items() if name != 'base'
            },
            **{key: value for key, value in self.found.items() if value},
        }
        self.lacks += [
            'motors: force or torque per ampere of each axis (motors.AXIS.force_per_ampere_n_a, '
            'torque_per_ampere_nm_a), or the data sheet',
            'encoders: counts of each axis (encoders.PLACE.counts_per_m, counts_per_revolution)',
            'stiffness of joints, gears and belts: everything is rigid',
        ]
        return FromUrdf(data, tuple(self.lacks))

    def _walk(self, link: str, body: str, turn: Rotation, at: Vector) -> None:
        """Put a link, whose frame is turned and shifted so, into a body; then what hangs on it."""
        self._add_link(link, self.bodies.setdefault(body, _Body()), turn, at)
        for joint in self.joints:
            if _link(joint, 'parent', self.source) != link:
                continue
            child = _link(joint, 'child', self.source)
            if child not in self.links:
                raise UserError(f'{self.source}: joint {joint.get("name")!r} leads to no link')
            shift, own = self._origin(joint)
            place, turned = at + turn.apply(shift), turn * own
            if joint.get('type') == 'fixed':
                self._walk(child, body, turned, place)
            else:
                inner = _word(child)
                self._add_joint(joint, body, inner, turned, place)
                self._walk(child, inner, turned, place)

    def _add_link(self, link: str, body: _Body, turn: Rotation, at: Vector) -> None:
        inertial = self.links[link].find('inertial')
        if inertial is None:
            return
        mass = self._number(inertial.find('mass'), 'value', f'mass of {link}')
        shift, own = self._origin(inertial)
        centre = at + turn.apply(shift)
        tensor = np.zeros((3, 3))
        element = inertial.find('inertia')
        for name, cell in (
            ('ixx', (0, 0)), ('iyy', (1, 1)), ('izz', (2, 2)),
            ('ixy', (0, 1)), ('ixz', (0, 2)), ('iyz', (1, 2)),
        ):  # fmt: skip
            value = self._number(element, name, f'inertia of {link}')
            tensor[cell] = tensor[cell[::-1]] = value
        matrix = (turn * own).as_matrix()
        body.mass += mass
        body.moment += mass * centre
        body.inertia += matrix @ tensor @ matrix.T
        body.inertia += mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))

    def _add_joint(
        self, joint: ElementTree.Element, parent: str, child: str, turn: Rotation, at: Vector
    ) -> None:
        name = _word(_name(joint, self.source))
        element = joint.find('axis')
        axis = self._vector(element.get('xyz') if element is not None else None, (1.0, 0.0, 0.0))
        if not np.linalg.norm(axis):
            raise UserError(f'{self.source}: the axis of joint {name} has no direction')
        direction = turn.apply(axis / np.linalg.norm(axis))
        kind = MOVING[str(joint.get('type'))]
        self.found['joints'][f'{name}_joint'] = {
            'parent': parent,
            'child': child,
            'at_m': _list(at),
            'freedoms': {name: {'type': kind, 'axis': _list(direction)}},
        }
        self.found['axes'][self._axis(name)] = name
        dynamics = joint.find('dynamics')
        if dynamics is None:
            self.lacks.append(f'friction of {name}: it has no <dynamics>')
            return
        rotary = kind == 'revolute'
        friction = self._number(dynamics, 'friction', f'dynamics of {name}', 0.0)
        damping = self._number(dynamics, 'damping', f'dynamics of {name}', 0.0)
        if friction:
            self.found['frictions'][f'{name}_friction'] = {
                'coordinate': name,
                'speed_rad_s' if rotary else 'speed_m_s': [0],
                'torque_nm' if rotary else 'force_n': [friction],
            }
        if damping:
            key = 'damping_nm_s_rad' if rotary else 'damping_n_s_m'
            self.found['dampers'][f'{name}_damping'] = {'coordinate': name, key: damping}

    def _axis(self, name: str) -> str:
        """Return the axis that a joint becomes: of its own name, or the next that no joint has."""
        moving = [joint for joint in self.joints if joint.get('type') != 'fixed']
        if len(moving) > len(AXES):
            return f'{name}_axis' if name.endswith(SIDES[1:]) else name
        if name in AXES:
            return name
        named = {_word(str(joint.get('name'))) for joint in self.joints}
        return next(axis for axis in AXES if axis not in self.found['axes'] and axis not in named)

    def _origin(self, element: ElementTree.Element) -> tuple[Vector, Rotation]:
        origin = element.find('origin')
        if origin is None:
            return np.zeros(3), Rotation.identity()
        shift = self._vector(origin.get('xyz'), (0.0, 0.0, 0.0))
        turn = self._vector(origin.get('rpy'), (0.0, 0.0, 0.0))
        return shift, Rotation.from_euler('xyz', turn)

    def _vector(self, text: str | None, default: tuple[float, ...]) -> Vector:
        if text is None:
            return np.array(default)
        try:
            values = np.array([float(word) for word in text.split()])
        except ValueError:
            values = np.zeros(0)
        if len(values) != 3 or not np.isfinite(values).all():
            raise UserError(f'{self.source}: {text!r} is not three numbers')
        return values

    def _number(
        self,
        element: ElementTree.Element | None,
        name: str,
        what: str,
        default: float | None = None,
    ) -> float:
        text = None if element is None else element.get(name)
        if text is None and default is not None:
            return default
        try:
            value = float(str(text))
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise UserError(f'{self.source}: {what}: {name} is {text!r}; it must be a number')
        return value


def _name(element: ElementTree.Element, source: str) -> str:
    name = element.get('name')
    if not name:
        raise UserError(f'{source}: a <{element.tag}> has no name')
    return name


def _link(joint: ElementTree.Element, tag: str, source: str) -> str:
    element = joint.find(tag)
    link = None if element is None else element.get('link')
    if not link:
        raise UserError(f'{source}: joint {joint.get("name")!r} has no {tag}')
    return link


def _word(name: str) -> str:
    """Return a name as descriptions have it: lower case with underscores, not `base`."""
    word = ''.join(letter if letter.isalnum() else '_' for letter in name.lower()).strip('_')
    word = word if word and word[0].isalpha() else f'part_{word}'
    return f'{word}_link' if word == 'base' else word


def _list(values: Vector) -> list[float]:
    return [float(f'{value:.12g}') + 0.0 for value in values]


def _as_data(body: _Body) -> dict[str, Any]:
    centre = body.moment / body.mass
    tensor = body.inertia - body.mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    names = {
        'xx': (0, 0), 'yy': (1, 1), 'zz': (2, 2), 'xy': (0, 1), 'xz': (0, 2), 'yz': (1, 2)
    }  # fmt: skip
    return {
        'mass_kg': body.mass,
        'centre_of_gravity_m': _list(centre),
        'inertia_kg_m2': {name: float(f'{tensor[cell]:.12g}') for name, cell in names.items()},
    }
