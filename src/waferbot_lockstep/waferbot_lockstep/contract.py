# SPDX-License-Identifier: Apache-2.0
"""
The topics of the twin: who speaks, how often, for which axes.

This is the table that a replacement for any node has to keep. Each message of the lock-step speaks
for the places (axes, or encoders) whose bit is set in its `valid` mask; several publishers may share
a topic, each with its own axes. The message files in `waferbot_msgs` give units and signs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from waferbot_lockstep.timing import Timing

AXES = ('y_linear', 'x_rotate', 'y_rotate')
"""The axes, in the order of every array with one place per axis."""

ENCODERS = ('y_linear', 'x_rotate', 'y_rotate_load', 'y_rotate_motor')
"""The encoders, in the order of `Encoders.counts`."""

AXIS_OF = dict(zip(ENCODERS, (*AXES, AXES[-1]), strict=True))
"""The axis that each encoder is on."""

USUAL_UNITS: Mapping[str, str] = {'y_linear': 'm', 'x_rotate': 'rad', 'y_rotate': 'rad'}
"""
The unit of each axis' position where no machine is described, as on the shipped one.

Where one is, it says so: `Description.axis_units` of `waferbot_plant`.
"""

USUAL_TITLES: Mapping[str, str] = {
    'y_linear': 'Y-Linear',
    'x_rotate': 'X-Rotate',
    'y_rotate': 'Y-Rotate',
}
"""
What each axis is called in reports and plots where no machine is described, as on the shipped one.

Where one is, it may say so: `Description.titles` of `waferbot_plant`.
"""


def usual_axis(axis: str, unit: str) -> str:
    """
    Return the axis of the shipped machine whose numbers suit an axis with this unit, `m` or `rad`.

    It is the axis of that name, if it has the unit there, otherwise the first one that has it.
    """
    if USUAL_UNITS[axis] == unit:
        return axis
    return next(one for one in AXES if USUAL_UNITS[one] == unit)


ALL_AXES = 0b111
ALL_ENCODERS = 0b1111

SLOW_DIVIDER = 180
"""Ticks between two messages on the slow topics (100 Hz at 18 kHz)."""

HISTORY_DEPTH = 1024
"""Depth of the reliable, volatile, keep-last history of the lock-step topics, in messages."""


@dataclass(frozen=True, eq=False)  # each topic is one object, looked up several times a tick
class Topic:
    """
    One topic of the contract.

    `places` names what the bits of `valid` stand for, `width` is the number of values for each
    place. `divider` is the name of the `Timing` field that gives the rate, or '' for every tick.
    `mask` is the name of a field behind the values that holds one bit for each place, or ''.
    """

    name: str
    message: str
    publisher: str
    places: tuple[str, ...]
    width: int
    divider: str = ''
    mask: str = ''

    def ticks_between(self, timing: Timing) -> int:
        """Return the number of ticks from one message to the next."""
        return getattr(timing, self.divider) if self.divider else 1

    @property
    def type_name(self) -> str:
        """Return the full ROS name of the message type."""
        return f'waferbot_msgs/msg/{self.message}'

    def names_of(self, mask: int) -> str:
        """Return the places of a mask by name, for messages to the user."""
        return ', '.join(name for place, name in enumerate(self.places) if mask >> place & 1)

    @property
    def all_places(self) -> int:
        """Return the mask with every place set."""
        return (1 << len(self.places)) - 1


ENCODERS_TOPIC = Topic('encoders', 'Encoders', 'plant', ENCODERS, 1, 'encoder_divider')
PHASE_CURRENTS = Topic('phase_currents', 'PhaseCurrents', 'plant', AXES, 2)
CURRENT_COMMAND = Topic('current_command', 'CurrentCommand', 'pmac', AXES, 1, 'servo_divider')
PHASE_VOLTAGES = Topic('phase_voltages', 'PhaseVoltages', 'copley', AXES, 3, mask='open')

LOCKSTEP_TOPICS = (ENCODERS_TOPIC, PHASE_CURRENTS, CURRENT_COMMAND, PHASE_VOLTAGES)
"""The topics that somebody waits for."""

SERVO_STATE = Topic('servo_state', 'ServoState', 'pmac', AXES, 5, 'servo_divider')
AMPLIFIER_STATE = Topic('amplifier_state', 'AmplifierState', 'copley', AXES, 4)

REPORT_TOPICS = (SERVO_STATE, AMPLIFIER_STATE)
"""The topics that only tell what a controller did; `amplifier_state` is sent slowly and on change."""

CONTRACT_TOPICS = LOCKSTEP_TOPICS + REPORT_TOPICS

PLANT_STATE = ('plant_state', 'waferbot_msgs/msg/PlantState')
"""
Name and type of the topic on which the plant tells what its parts bear, 100 Hz, and no sensor shows.
It is recorded, but not counted: a plant that is somebody else's, or a machine, has nothing to say there.
"""

RECORDED_TOPIC = 'recorded'
"""Topic on which a recorder says how far it has come (`waferbot_msgs/msg/Recorded`)."""

RECORDER_WINDOW = 256
"""
Ticks that the plant may be ahead of a recorder. No topic has more messages in as many ticks than
HISTORY_DEPTH, so a reliable publisher never drops one that the recorder has not received.
"""

STOP_TOPIC = 'stop'
"""Topic on which a node that leaves the lock-step says why (`waferbot_msgs/msg/Stop`)."""


def axes_mask(names: list[str] | tuple[str, ...]) -> int:
    """Return the mask of the named axes; raises `ValueError` for a name that is no axis."""
    mask = 0
    for name in names:
        mask |= 1 << AXES.index(name)
    return mask
