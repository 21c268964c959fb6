# SPDX-License-Identifier: Apache-2.0
"""Small machines for the tests, and MuJoCo's twin of any machine."""

from __future__ import annotations

import itertools
import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from waferbot_plant.plant import Machine

_FOLDER = tempfile.TemporaryDirectory(prefix='waferbot_test_')  # goes when the tests end
_NUMBERS = itertools.count()


def remove_losses(parameters: Any) -> None:
    """Take all friction and damping out of a machine's parameters, in place."""
    parameters[0]['friction_resistance'] = 0.0
    parameters[0]['spring_damping'] = 0.0
    parameters[0]['cable_damping'] = 0.0


def write(description: dict[str, Any]) -> Path:
    """Write a description to a file of its own and return its path."""
    path = Path(_FOLDER.name) / f'machine_{next(_NUMBERS)}.yaml'
    unshared = json.loads(json.dumps(description))  # else YAML would write aliases
    path.write_text(yaml.safe_dump(unshared, sort_keys=False), encoding='utf-8')
    return path


def single_mass(**more: Any) -> dict[str, Any]:
    """Return one mass of 2 kg on a vertical slide."""
    return {
        'name': 'single mass',
        'bodies': {
            'slider': {
                'mass_kg': 2.0,
                'centre_of_gravity_m': [0, 0, 0],
                'inertia_kg_m2': {'xx': 0.01, 'yy': 0.01, 'zz': 0.01},
            }
        },
        'joints': {
            'guide': {
                'parent': 'base',
                'child': 'slider',
                'at_m': [0, 0, 0],
                'freedoms': {'travel': {'type': 'prismatic', 'axis': [0, 1, 0]}},
            }
        },
        'axes': {'y_linear': 'travel'},
        **more,
    }


def write_single_mass(**more: Any) -> Path:
    """Write `single_mass` to a file."""
    return write(single_mass(**more))


def two_slides(**more: Any) -> dict[str, Any]:
    """Return two masses of 2 kg on vertical slides of their own."""
    body = {
        'mass_kg': 2.0,
        'centre_of_gravity_m': [0, 0, 0],
        'inertia_kg_m2': {'xx': 0.01, 'yy': 0.01, 'zz': 0.01},
    }
    return {
        'name': 'two slides',
        'bodies': {'first': dict(body), 'second': dict(body)},
        'joints': {
            f'{name}_guide': {
                'parent': 'base',
                'child': name,
                'at_m': [0, 0, 0],
                'freedoms': {name: {'type': 'prismatic', 'axis': [0, 1, 0]}},
            }
            for name in ('first', 'second')
        },
        'axes': {'y_linear': 'first'},
        **more,
    }


def write_pendulum(**more: Any) -> Path:
    """Write a physical pendulum about z that hangs down at home."""
    return write(
        {
            'name': 'pendulum',
            'bodies': {
                'bob': {
                    'mass_kg': 1.5,
                    'centre_of_gravity_m': [0, -0.4, 0],
                    'inertia_kg_m2': {'xx': 0.03, 'yy': 0.01, 'zz': 0.025},
                }
            },
            'joints': {
                'pivot': {
                    'parent': 'base',
                    'child': 'bob',
                    'at_m': [0, 0, 0],
                    'freedoms': {'swing': {'type': 'revolute', 'axis': [0, 0, 1]}},
                }
            },
            'axes': {'x_rotate': 'swing'},
            **more,
        }
    )


def random_tree(random: np.random.Generator, size: int) -> dict[str, Any]:
    """Return a tree of `size` bodies, each on a joint of random kind, place and parent."""
    bodies, joints = {}, {}
    for number in range(size):
        weights = random.uniform(0.2, 2.0, 6)
        centre = random.uniform(-0.5, 0.5, 3)
        spread = random.normal(0.0, 0.1, (6, 3))
        spread -= weights @ spread / weights.sum()
        tensor = sum(
            w * (s @ s * np.eye(3) - np.outer(s, s)) for w, s in zip(weights, spread, strict=True)
        )
        bodies[f'body_{number}'] = {
            'mass_kg': float(weights.sum()),
            'centre_of_gravity_m': centre.tolist(),
            'inertia_kg_m2': {
                axes: float(tensor['xyz'.index(axes[0]), 'xyz'.index(axes[1])])
                for axes in ('xx', 'yy', 'zz', 'xy', 'xz', 'yz')
            },
        }
        parent = int(random.integers(-1, number)) if number else -1
        joints[f'joint_{number}'] = {
            'parent': f'body_{parent}' if parent >= 0 else 'base',
            'child': f'body_{number}',
            'at_m': random.uniform(-0.5, 0.5, 3).tolist(),
            'freedoms': {
                f'q_{number}': {
                    'type': str(random.choice(['revolute', 'revolute', 'prismatic'])),
                    'axis': random.normal(0.0, 1.0, 3).tolist(),
                }
            },
        }
    gravity = random.normal(0.0, 6.0, 3).tolist()
    return {'name': 'random tree', 'gravity_m_s2': gravity, 'bodies': bodies, 'joints': joints}


def axes_and_motors(machine: Machine) -> set[str]:
    """Return the coordinates that move far: axes and rotors, not the give of connections."""
    return {
        name
        for name in machine.coordinates
        if not any(name == element.name for element in machine.assembly.springs)
    }


class MujocoTwin:
    """
    The same machine in MuJoCo, built from the description's bodies, not from our links.

    Every freedom is a joint with its spring and damper in MuJoCo's own terms; rotors are bodies
    with armature on hinges of their own; what a rigid transmission ties is put in by the
    projection q = B z on MuJoCo's full mass matrix and bias, so that no soft constraint enters.
    """

    def __init__(self, machine: Machine) -> None:
        mujoco = pytest.importorskip('mujoco')
        self.mujoco = mujoco
        self.machine = machine
        description = machine.description
        flexible = {name for name, part in description.connections.items() if part.flexible}
        spec = mujoco.MjSpec()
        spec.option.gravity = description.gravity
        spec.compiler.degree = 0
        spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        held = {element.name: element for element in machine.assembly.springs}
        frames = {'base': (spec.worldbody, np.zeros(3))}
        waiting = list(description.joints.values())
        while waiting:
            joint = next(joint for joint in waiting if joint.parent in frames)
            waiting.remove(joint)
            parent, origin = frames[joint.parent]
            body = description.bodies[joint.child]
            inertia = body.inertia
            child = parent.add_body(
                name=joint.child,
                pos=joint.at - origin,
                mass=body.mass,
                ipos=body.centre_of_gravity - joint.at,
                fullinertia=inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]],
                explicitinertial=True,
            )
            for freedom in joint.freedoms:
                if freedom.connections and not flexible.intersection(freedom.connections):
                    continue
                kind = (
                    mujoco.mjtJoint.mjJNT_HINGE
                    if freedom.revolute
                    else mujoco.mjtJoint.mjJNT_SLIDE
                )
                added = child.add_joint(
                    name=freedom.name, type=kind, axis=freedom.axis, pos=[0.0, 0.0, 0.0]
                )
                if freedom.name in held:
                    element = held[freedom.name]
                    added.stiffness = _first(added.stiffness, element.stiffness)
                    added.damping = _first(added.damping, element.damping)
                    added.springref = element.rest
            frames[joint.child] = child, joint.at
        for rotor in description.rotors.values():
            if rotor.coordinate != rotor.name:
                continue
            total = sum(
                other.inertia
                for other in description.rotors.values()
                if other.coordinate == rotor.name
            )
            body = spec.worldbody.add_body(
                name=rotor.name, mass=1.0, inertia=[rotor.inertia] * 3, explicitinertial=True
            )
            body.add_joint(
                name=rotor.name,
                type=mujoco.mjtJoint.mjJNT_HINGE,
                axis=[0, 0, 1],
                armature=total - rotor.inertia,
            )
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self.projection = np.zeros((self.model.nv, len(machine.coordinates)))
        for name, (place, ratio) in machine.assembly.placing.items():
            self.projection[self.address(name), place] = ratio

    def address(self, coordinate: str) -> int:
        """Return where MuJoCo keeps a coordinate."""
        return int(self.model.joint(coordinate).dofadr[0])

    def acceleration(self, position: Any, velocity: Any, force: Any) -> Any:
        """Return z'' under the forces `force` on z, springs and dampers of both kinds included."""
        self.data.qpos[:] = self.projection @ position
        self.data.qvel[:] = self.projection @ velocity
        self.mujoco.mj_forward(self.model, self.data)
        full = np.zeros((self.model.nv, self.model.nv))
        self.full_mass_matrix(full)
        bias = self.data.qfrc_bias - self.data.qfrc_passive
        right = force - self.projection.T @ bias
        for element in [*self.machine.assembly.cables, *self.machine.assembly.springs]:
            if len(element.terms) == 2 or not element.connections:
                arms = np.zeros(len(position))
                for place, ratio in element.terms:
                    arms[place] += ratio
                deflection = arms @ position - element.rest
                tension = element.stiffness * deflection + element.damping * (arms @ velocity)
                if element.pulls_only:
                    spring = max(0.0, element.stiffness * deflection)
                    damper = np.clip(element.damping * (arms @ velocity), -spring, spring)
                    tension = spring + damper if spring > 0.0 else 0.0
                right -= arms * tension
        return np.linalg.solve(self.projection.T @ full @ self.projection, right)

    def full_mass_matrix(self, full: Any) -> None:
        """Fill MuJoCo's dense mass matrix."""
        try:
            self.mujoco.mj_fullM(self.model, full, self.data.qM)
        except (AttributeError, TypeError):
            self.mujoco.mj_fullM(self.model, self.data, full)


def _first(current: Any, value: float) -> Any:
    """Return `value` as this version of MuJoCo keeps it: a number, or a polynomial."""
    if np.ndim(current) == 0:
        return value
    filled = np.zeros(np.shape(current))
    filled[0] = value
    return filled
