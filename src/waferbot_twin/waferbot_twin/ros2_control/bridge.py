# SPDX-License-Identifier: Apache-2.0
"""
A node in the place of the PMAC, behind which ros2_control closes the loop.

    ros2 run waferbot_twin joint_bridge --ros-args -p timekeeping:=realtime

It says positions and velocities of the joints on `/robot_joint_states`, takes their efforts from
`/robot_joint_commands`, and gives the newest ones to the amplifiers, as currents, once in each servo
cycle. That is what the hardware component JointStateTopicSystem of ros2_control speaks.

Controllers keep wall time, so the twin must be in real time. A plant that waits at tick 0
(`start_paused`) is let go by the first command: nothing falls before a controller is there. If commands
stay out, the currents are zero, and the diagnostics say so.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.clock import Clock, ClockType
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool

from waferbot_lockstep.contract import (
    CURRENT_COMMAND,
    ENCODERS_TOPIC,
    Topic,
)
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.layout import Layout
from waferbot_lockstep.node import LockstepNode, Trouble, run_node
from waferbot_lockstep.node_settings import REALTIME
from waferbot_lockstep.parameters import Parameter
from waferbot_lockstep.standard_messages import joint_state_message
from waferbot_plant.plant import load_machine
from waferbot_twin.ros2_control.joints import COMMANDS, STATES, JointScales

SETTINGS = (
    Parameter(
        'state_rate_hz', 500.0, 'Hz', 1.0, 2250.0, 'joint states per second of wall time', fixed=True
    ),
    Parameter(
        'command_timeout_s', 0.1, 's', 1e-3, 3600.0,
        'wall time without a command after which the currents are zero',
    ),
)  # fmt: skip

ASK_AGAIN_S = 1.0
"""Wall time after which a plant that still waits at tick 0 is asked again to go on."""


class JointBridge(LockstepNode):
    """Speaks the contract to plant and amplifiers, and joint states and efforts to ros2_control."""

    def __init__(self, **node_options: Any) -> None:
        """Open both sides; raises `UserError` if time is not real time, or an axis lacks something."""
        super().__init__('joint_bridge', (ENCODERS_TOPIC,), (CURRENT_COMMAND,), **node_options)
        if self.timekeeping != REALTIME:
            raise UserError(
                'controllers of ros2_control keep wall time: start plant, amplifiers and this node '
                'with timekeeping:=realtime'
            )
        settings = self.declare_settings('', SETTINGS)
        self._scales = JointScales.of(self._machine)
        self._cycle = -1  # the newest that was answered
        self._counts: np.ndarray | None = None
        self._tick = 0
        self._said: tuple[int, np.ndarray] | None = None  # tick and positions of the last states
        self._efforts: dict[str, float] = {}
        self._commands = 0
        self._commanded_s = 0.0
        self._asked_s = 0.0
        self._states = self.create_publisher(JointState, STATES, QoSProfile(depth=10))
        self.create_subscription(JointState, COMMANDS, self._on_command, QoSProfile(depth=1))
        self._pause = self.create_client(SetBool, 'plant/pause')
        wall = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(1.0 / float(settings['state_rate_hz']), self._tell, clock=wall)

    def find_layout(self) -> Layout:
        """Load the machine, which has the axes and encoders; raises `UserError`."""
        description = self.declare_fixed(
            'description', 'rigid', 'name, file or text of the machine, for counts and efforts'
        )
        self._machine = load_machine(description, timing=self.timing).description
        return self._machine.layout

    @property
    def tick(self) -> int:
        """The tick of the newest counts."""
        return self._tick

    def on_input(self, topic: Topic) -> None:
        """Answer the servo cycle of the newest counts, once, with the newest efforts."""
        inbox = self.inboxes[topic]
        if not inbox.complete:
            return
        self._tick, self._counts = inbox.newest_tick, inbox.values
        cycle = self._tick // self.timing.servo_divider
        if cycle > self._cycle:
            self._cycle = cycle
            efforts = {} if self._silence_s() else self._efforts
            tick = cycle * self.timing.servo_divider
            self.give(CURRENT_COMMAND, tick, self.layout.all_axes, self._scales.currents(efforts))
        if self.end_tick and self._tick + inbox.spacing >= self.end_tick:
            self.finish()

    def begin_anew(self) -> None:
        """Answer from tick 0 on again."""
        self._cycle, self._said = -1, None

    def watch(self, now_s: float) -> None:
        """Let a plant go on that waits at tick 0 though a controller is there."""
        waits = self._counts is not None and self._tick == 0 and self._commands > 0
        if waits and now_s - self._asked_s > ASK_AGAIN_S and self._pause.service_is_ready():
            self._asked_s = now_s
            self._pause.call_async(SetBool.Request(data=False))

    def diagnostics(self) -> tuple[dict[str, str], list[Trouble]]:
        """Tell whether anybody commands the joints."""
        silence_s = self._silence_s()
        troubles: list[Trouble] = []
        if not self._commands:
            troubles = [(DiagnosticStatus.WARN, 'no controller yet: nothing on ' + COMMANDS)]
        elif silence_s:
            text = f'no joint command for {silence_s:.1f} s: the currents are zero'
            troubles = [(DiagnosticStatus.ERROR, text)]
        return {'joint commands': str(self._commands)}, troubles

    def _on_command(self, command: Any) -> None:
        self._efforts = dict(zip(command.name, command.effort, strict=False))
        self._commands += 1
        self._commanded_s = time.monotonic()

    def _silence_s(self) -> float:
        """Return how long nobody has commanded the joints, 0 if that is not too long."""
        silence_s = time.monotonic() - self._commanded_s
        return silence_s if silence_s > self.get_parameter('command_timeout_s').value else 0.0

    def _tell(self) -> None:
        """Say where the joints are; their velocity since that was last said, or since time began."""
        if self._counts is None or self.outcome is not None:
            return
        positions = self._scales.positions(np.asarray(self._counts))
        velocity = np.zeros_like(positions)
        if self._said is not None and self._tick > self._said[0]:
            passed_s = (self._tick - self._said[0]) * self.timing.tick_s
            velocity = (positions - self._said[1]) / passed_s
        elif self._said is not None:
            return  # nothing new
        if self._tick:
            self._said = self._tick, positions
        self._states.publish(
            joint_state_message(
                self.get_clock().now().nanoseconds,
                self.layout.axes,
                positions.tolist(),
                velocity.tolist(),
            )
        )


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the node."""
    return run_node(JointBridge, arguments)


if __name__ == '__main__':
    sys.exit(main())
