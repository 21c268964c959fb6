# SPDX-License-Identifier: Apache-2.0
"""
Replay over ROS: a real node against a player that speaks for all its peers.

The player knows nothing but the contract: it publishes the recorded messages of the other nodes and
waits, tick by tick, for those of the node under test.
"""

from __future__ import annotations

import contextlib
import time
from typing import Any

import numpy as np
import rclpy
from rclpy.signals import SignalHandlerOptions

from waferbot_lockstep.contract import Topic
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.interrupt import Interrupt
from waferbot_lockstep.layout import Layout
from waferbot_lockstep.node import LockstepNode, make_executor
from waferbot_lockstep.ros_logs import ensure_log_folder
from waferbot_lockstep.wire import wire_of
from waferbot_twin.engines.domain import Domain, check_loopback
from waferbot_twin.engines.layout import RosOptions, layout
from waferbot_twin.engines.members import END_TIMEOUT_S, SeparateProcesses
from waferbot_twin.engines.ros import Progress, ros_environment
from waferbot_twin.models import NODES
from waferbot_twin.plan import Plan
from waferbot_twin.recording.reader import Recording
from waferbot_twin.replay import FIELDS, INPUTS, OUTPUTS, Difference, check_inputs, compare

SPOKEN_FOR = {node: [topic for topic in INPUTS[node] if topic in FIELDS] for node in NODES}
"""What the player publishes to each node; commanded positions are the PMAC's own experiment."""


class Player(LockstepNode):
    """Speaks for all peers of one node, out of a recording, and keeps what the node answers."""

    def __init__(self, recording: Recording, node: str, ticks: int, **node_options: Any) -> None:
        """Prepare to play `ticks` ticks to `node`."""
        outputs = OUTPUTS[node]
        self._layout = recording.layout
        super().__init__('replay', outputs, SPOKEN_FOR[node], **node_options)
        self.ticks = ticks
        self._tick = 0
        # Within a tick the plant speaks first; to every other node the player does.
        self._plays_first = node != 'plant'
        self._inputs = {
            topic: (_values(recording[topic], topic), topic.ticks_between(self.timing))
            for topic in SPOKEN_FOR[node]
        }
        self.answers = {
            topic: wire_of(topic, self.layout).blank(
                self.timing.messages(ticks, topic.ticks_between(self.timing))
            )
            for topic in outputs
        }

    def find_layout(self) -> Layout:
        """Return the axes and encoders of the recording's machine."""
        return self._layout

    @property
    def tick(self) -> int:
        """The tick that is being played."""
        return self._tick

    def begin(self) -> None:
        """Send the inputs of tick 0, if it is the player's turn."""
        super().begin()
        if self._plays_first:
            self._play()

    def on_input(self, topic: Topic) -> None:
        """Keep an answer; go on when all answers of this tick are there."""
        while self._answered() and self.outcome is None:
            for answer_topic, inbox in self.inboxes.items():
                if inbox.due == self._tick:
                    row = self._tick // inbox.spacing
                    records = self.answers[answer_topic]
                    records['tick'][row] = self._tick
                    records[FIELDS[answer_topic][0]][row] = inbox.values
                    inbox.consumed()
            if not self._plays_first:
                self._play()
            self._tick += 1
            if self._tick >= self.ticks:
                self.finish()
            elif self._plays_first:
                self._play()

    def _answered(self) -> bool:
        return all(inbox.complete for inbox in self.inboxes.values() if inbox.due == self._tick)

    def _play(self) -> None:
        for topic, (rows, spacing) in self._inputs.items():
            if self._tick % spacing == 0:
                places = topic.all_places(self.layout)
                self.give(topic, self._tick, places, rows[self._tick // spacing])


def replay_over_ros(
    recording: Recording, plan: Plan, node: str, progress: Progress
) -> list[Difference]:
    """
    Start one node as a process, play a recording to it and compare its answers.

    Raises `UserError` if an input was not recorded from tick 0 on, or the node stops with an error.
    """
    recording.check_machine(plan.model.layout)
    check_inputs(recording, node)
    ticks = min(
        len(recording[topic]) * topic.ticks_between(plan.timing) for topic in SPOKEN_FOR[node]
    )
    ticks = min(ticks, plan.ticks)
    others = tuple(name for name in NODES if name != node)
    options = RosOptions(
        without=others, overrides={'plant': {'start_paused': False, 'recorder_window': 0}}
    )
    check_loopback()
    with contextlib.ExitStack() as stack:
        domain = Domain()
        stack.callback(domain.release)
        stack.enter_context(ros_environment(domain.number, any_host=False))
        interrupt = stack.enter_context(Interrupt())
        ensure_log_folder()
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        stack.callback(rclpy.try_shutdown)
        player = Player(recording, node, ticks)
        stack.callback(player.destroy_node)
        process = SeparateProcesses(dict(layout(plan, options)))
        stack.callback(process.end)
        executor = make_executor()
        executor.add_node(player)
        process.begin(executor)
        player.begin()
        gone_s: float | None = None
        while player.outcome is None:
            executor.spin_once(timeout_sec=0.1)
            progress(player.tick, ticks)
            if interrupt.raised:
                raise KeyboardInterrupt
            if process.failure():
                gone_s = gone_s or time.monotonic()
                if time.monotonic() > gone_s + END_TIMEOUT_S:
                    raise UserError(process.failure())
        executor.remove_node(player)
        executor.shutdown(0.0)
        if player.outcome:
            raise UserError(player.outcome)
    return [
        difference
        for topic in OUTPUTS[node]
        for difference in compare(
            topic, _until(recording[topic], ticks), player.answers[topic], recording.layout
        )
    ]


def _values(array: np.ndarray, topic: Topic) -> list[list[float]]:
    """Return all that follows `valid` in each message, as `give` takes it."""
    rows: list[list[float]] = array[FIELDS[topic][0]].tolist()
    if topic.mask:
        return [[*row, mask] for row, mask in zip(rows, array[topic.mask].tolist(), strict=True)]
    return rows


def _until(array: np.ndarray, ticks: int) -> np.ndarray:
    return array[array['tick'] < ticks]
