# SPDX-License-Identifier: Apache-2.0
"""
The topics of the twin: who speaks, how often, for which axes.

This is the table that a replacement for any node has to keep. Each message of the lock-step speaks
for the places (axes, or encoders) whose bit is set in its `valid` mask; several publishers may share
a topic, each with its own axes. Which those are says the layout of the machine
(`waferbot_lockstep.layout`). The message files in `waferbot_msgs` give units and signs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from waferbot_lockstep.layout import MOST_AXES, MOST_ENCODERS, SHIPPED, Layout
from waferbot_lockstep.timing import Timing

AXES = SHIPPED.axes
"""The axes of the shipped machine, in the order of every array with one place per axis."""

ENCODERS = SHIPPED.encoders
"""The encoders of the shipped machine, in the order of `Encoders.counts`."""

AXIS_OF = {name: SHIPPED.axis_of(name) for name in ENCODERS}
"""The axis that each of them is on."""

USUAL_UNITS: Mapping[str, str] = {'y_linear': 'm', 'x_rotate': 'rad', 'y_rotate': 'rad'}
"""
The unit of each axis' position where no machine is described, as on the shipped one.

Where one is, it says so: `Description.axis_units` of `waferbot_plant`.
"""


class _Titles(dict[str, str]):
    """Titles by axis; one that is not in it is called by its name: `wrist_roll` Wrist roll."""

    def __missing__(self, axis: str) -> str:
        return axis.replace('_', ' ').capitalize()


USUAL_TITLES: Mapping[str, str] = _Titles(
    y_linear='Y-Linear', x_rotate='X-Rotate', y_rotate='Y-Rotate'
)
"""
What each axis is called in reports and plots where no machine is described, as on the shipped one; any
other by its name.

Where one is, it may say so: `Description.titles` of `waferbot_plant`.
"""


def usual_axis(axis: str, unit: str) -> str:
    """
    Return the axis of the shipped machine whose numbers suit an axis with this unit, `m` or `rad`.

    It is the axis of that name, if it has the unit there, otherwise the first one that has it.
    """
    if USUAL_UNITS.get(axis) == unit:
        return axis
    return next(one for one in AXES if USUAL_UNITS[one] == unit)


ALL_AXES = SHIPPED.all_axes
ALL_ENCODERS = SHIPPED.all_encoders

OF_AXES, OF_ENCODERS = 'axes', 'encoders'
"""What a topic has a place for each of."""

SLOW_DIVIDER = 180
"""Ticks between two messages on the slow topics (100 Hz at 18 kHz)."""

HISTORY_DEPTH = 1024
"""Depth of the reliable, volatile, keep-last history of the lock-step topics, in messages."""


@dataclass(frozen=True, eq=False)  # each topic is one object, looked up several times a tick
class Topic:
    """
    One topic of the contract.

    `of` says what the bits of `valid` stand for, `OF_AXES` or `OF_ENCODERS` of the machine's layout;
    `width` is the number of values for each place. `divider` is the name of the `Timing` field that
    gives the rate, or '' for every tick. `mask` is the name of a field behind the values that holds one
    bit for each place, or ''.
    """

    name: str
    message: str
    publisher: str
    of: str
    width: int
    divider: str = ''
    mask: str = ''

    def ticks_between(self, timing: Timing) -> int:
        """Return the number of ticks from one message to the next."""
        return getattr(timing, self.divider) if self.divider else 1

    @property
    def type_name(self) -> str:
        """The full ROS name of the message type, on a machine with the axes of the shipped one."""
        return f'waferbot_msgs/msg/{self.message}'

    def type_for(self, layout: Layout) -> str:
        """
        Return the full ROS name of the message type for a machine.

        One with axes of its own has types of its own, whose arrays are as long as it needs; so the
        messages of the shipped machine are always the same, and never taken for those of another.
        """
        return self.type_name if layout == SHIPPED else f'waferbot_msgs/msg/Axes{self.message}'

    def places(self, layout: Layout) -> tuple[str, ...]:
        """Return what the bits of `valid` stand for in a machine, by name."""
        return layout.encoders if self.of == OF_ENCODERS else layout.axes

    @property
    def most_places(self) -> int:
        """How many places its messages have room for."""
        return MOST_ENCODERS if self.of == OF_ENCODERS else MOST_AXES

    def all_places(self, layout: Layout) -> int:
        """Return the mask with every place of a machine set."""
        return layout.all_encoders if self.of == OF_ENCODERS else layout.all_axes

    def names_of(self, mask: int, layout: Layout) -> str:
        """Return the places of a mask by name, for messages to the user."""
        places = self.places(layout)
        return ', '.join(name for place, name in enumerate(places) if mask >> place & 1)


ENCODERS_TOPIC = Topic('encoders', 'Encoders', 'plant', OF_ENCODERS, 1, 'encoder_divider')
PHASE_CURRENTS = Topic('phase_currents', 'PhaseCurrents', 'plant', OF_AXES, 2)
CURRENT_COMMAND = Topic('current_command', 'CurrentCommand', 'pmac', OF_AXES, 1, 'servo_divider')
PHASE_VOLTAGES = Topic('phase_voltages', 'PhaseVoltages', 'copley', OF_AXES, 3, mask='open')

LOCKSTEP_TOPICS = (ENCODERS_TOPIC, PHASE_CURRENTS, CURRENT_COMMAND, PHASE_VOLTAGES)
"""The topics that somebody waits for."""

SERVO_STATE = Topic('servo_state', 'ServoState', 'pmac', OF_AXES, 5, 'servo_divider')
AMPLIFIER_STATE = Topic('amplifier_state', 'AmplifierState', 'copley', OF_AXES, 4)

REPORT_TOPICS = (SERVO_STATE, AMPLIFIER_STATE)
"""The topics that only tell what a controller did; `amplifier_state` is sent slowly and on change."""

CONTRACT_TOPICS = LOCKSTEP_TOPICS + REPORT_TOPICS

PLANT_STATE = Topic('plant_state', 'PlantState', 'plant', OF_AXES, 1)
"""
The topic on which the plant tells what its parts bear, 100 Hz, and no sensor shows. It is recorded, but
not counted: a plant that is somebody else's, or a machine, has nothing to say there.
"""

MACHINE_AXES_TOPIC = 'machine_axes'
"""
Topic on which the plant of a machine with axes of its own says once which axes and encoders it has
(`std_msgs/msg/String`, latched), so that a node that was started for another one ends and says so.
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
