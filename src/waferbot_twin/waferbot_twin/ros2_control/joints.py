# SPDX-License-Identifier: Apache-2.0
"""
Joints as ros2_control knows them, from what the contract carries, and back.

    position = counts / counts_per_unit        velocity = its difference over the time between
    current  = effort / effort_per_ampere      (A, peak of the sine; effort in N or Nm at the axis)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from waferbot_lockstep.contract import AXES
from waferbot_lockstep.errors import UserError
from waferbot_plant.description import Description
from waferbot_plant.inverse_dynamics import InverseDynamics
from waferbot_plant.mjcf import force_ratio
from waferbot_plant.motors import force_constant

Floats = NDArray[np.float64]

COMMANDS, STATES = '/robot_joint_commands', '/robot_joint_states'
"""Topics of the hardware component, as it has them where it is not told others."""

PLUGIN = 'joint_state_topic_hardware_interface/JointStateTopicSystem'
"""The hardware component: states and commands of joints by topics (sensor_msgs/JointState)."""


@dataclass(frozen=True)
class JointScales:
    """Of each axis (axes,): place and counts per m or rad of its position encoder, effort per ampere."""

    axes: tuple[str, ...]
    encoders: NDArray[np.intp]
    counts_per_unit: Floats
    effort_per_ampere: Floats

    @classmethod
    def of(cls, description: Description) -> JointScales:
        """Return those of a machine; raises `UserError` for an axis that lacks encoder or motor."""
        dynamics = InverseDynamics(description)
        placing = dynamics.machine.assembly.placing
        places, counts, efforts = [], [], []
        for axis in description.layout.axes:
            name = description.position_encoder(axis)
            if axis not in dynamics.axes or name not in description.encoders:
                raise UserError(f'{description.name}: {axis} needs a motor and an encoder')
            encoder = description.encoders[name]
            places.append(description.layout.encoder_place(name))
            ratio = placing[encoder.coordinate][1] / placing[description.axes[axis]][1]
            counts.append(encoder.counts_per_unit * ratio)
            constant = force_constant(description.motors[axis])
            efforts.append(constant * force_ratio(dynamics, axis))
        return cls(description.layout.axes, np.array(places), np.array(counts), np.array(efforts))

    def positions(self, counts: NDArray[np.int64] | Floats) -> Floats:
        """Return the positions of the axes from the counts of all encoders (encoders,)."""
        found: Floats = counts[self.encoders] / self.counts_per_unit
        return found

    def currents(self, efforts: Mapping[str, float]) -> list[float]:
        """Return the currents of the axes, A; 0 where no effort, or none that is finite, is given."""
        given = np.array([efforts.get(axis, 0.0) for axis in self.axes])
        currents = np.where(np.isfinite(given), given, 0.0) / self.effort_per_ampere
        return [float(current) for current in currents]


def with_ros2_control(urdf: str, axes: Sequence[str] = AXES) -> str:
    """Return a URDF with the tag by which ros2_control finds the joints and what they take."""
    robot = ElementTree.fromstring(urdf)
    system = ElementTree.SubElement(robot, 'ros2_control', name='waferbot', type='system')
    hardware = ElementTree.SubElement(system, 'hardware')
    ElementTree.SubElement(hardware, 'plugin').text = PLUGIN
    for name, value in (
        ('joint_commands_topic', COMMANDS),
        ('joint_states_topic', STATES),
        ('trigger_joint_command_threshold', '-1'),  # always: efforts are no positions to compare
    ):
        ElementTree.SubElement(hardware, 'param', name=name).text = value
    for axis in axes:
        joint = ElementTree.SubElement(system, 'joint', name=axis)
        ElementTree.SubElement(joint, 'command_interface', name='effort')
        for name in ('position', 'velocity'):
            ElementTree.SubElement(joint, 'state_interface', name=name)
    ElementTree.indent(robot)
    return ElementTree.tostring(robot, encoding='unicode') + '\n'
