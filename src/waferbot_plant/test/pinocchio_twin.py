# SPDX-License-Identifier: Apache-2.0
"""Pinocchio's twin of any machine: the same bodies and freedoms, for tests and the bench."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from waferbot_plant.description import BASE
from waferbot_plant.plant import Machine


class PinocchioTwin:
    """
    The machine as a tree of one-freedom joints, built from the description's bodies, not our links.

    Rotors are joints of their own on the base. What a rigid transmission ties is put in by the
    projection q = B z; springs, dampers and cables are added as outside forces by the caller.
    """

    def __init__(self, machine: Machine) -> None:
        self.pin = pin = pytest.importorskip('pinocchio')
        self.machine = machine
        description = machine.description
        flexible = {name for name, part in description.connections.items() if part.flexible}
        model = pin.Model()
        model.gravity = pin.Motion(np.array(description.gravity), np.zeros(3))
        frames = {BASE: (0, np.zeros(3))}
        waiting = list(description.joints.values())
        while waiting:
            joint = next(joint for joint in waiting if joint.parent in frames)
            waiting.remove(joint)
            parent, origin = frames[joint.parent]
            for freedom in joint.freedoms:
                if freedom.connections and not flexible.intersection(freedom.connections):
                    continue
                kind = (
                    pin.JointModelRevoluteUnaligned
                    if freedom.revolute
                    else pin.JointModelPrismaticUnaligned
                )
                at = pin.SE3(np.eye(3), joint.at - origin)
                parent = model.addJoint(parent, kind(freedom.axis), at, freedom.name)
                origin = joint.at
            body = description.bodies[joint.child]
            if parent:
                inertia = pin.Inertia(body.mass, body.centre_of_gravity - origin, body.inertia)
                model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
            frames[joint.child] = parent, origin
        for rotor in description.rotors.values():
            if rotor.coordinate != rotor.name:
                continue
            total = sum(
                other.inertia
                for other in description.rotors.values()
                if other.coordinate == rotor.name
            )
            axis = pin.JointModelRevoluteUnaligned(np.array([0.0, 0.0, 1.0]))
            place = model.addJoint(0, axis, pin.SE3.Identity(), rotor.name)
            inertia = pin.Inertia(0.0, np.zeros(3), np.diag([0.0, 0.0, total]))
            model.appendBodyToJoint(place, inertia, pin.SE3.Identity())
        self.model = model
        self.data = model.createData()
        self.projection = np.zeros((model.nv, len(machine.coordinates)))
        for name, (place, ratio) in machine.assembly.placing.items():
            row = model.joints[model.getJointId(name)].idx_v
            self.projection[row, place] = ratio

    def acceleration(self, position: Any, velocity: Any, force: Any) -> Any:
        """Return z'' under the forces `force` on z; M by composite bodies, bias by Newton-Euler."""
        q, v = self.projection @ position, self.projection @ velocity
        upper = np.triu(self.pin.crba(self.model, self.data, q))
        mass = upper + np.triu(upper, 1).T
        bias = self.pin.nonLinearEffects(self.model, self.data, q, v)
        return np.linalg.solve(
            self.projection.T @ mass @ self.projection, force - self.projection.T @ bias
        )
