# SPDX-License-Identifier: Apache-2.0
"""
Which stops count: those of nodes that take part in the lock-step.

A node takes part if it publishes a topic of the lock-step, or did; the graph of ROS knows it by its
name. A stop of anybody else is a stranger's. Who is only just being discovered may look like one, so a
stop is held for `DOUBT_S` before it is passed over. A name can be forged: this keeps mistakes out, and
the transport keeps other hosts out (`waferbot_lockstep.transport`).
"""

from __future__ import annotations

import time
from typing import Any

from rclpy.node import Node

from waferbot_lockstep.contract import LOCKSTEP_TOPICS

DOUBT_S = 2.0


class Stops:
    """The stops that a node has heard; `ignored` counts those of strangers."""

    def __init__(self, node: Node) -> None:
        """Know nobody yet."""
        self.ignored = 0
        self._node = node
        self._participants: set[str] = set()
        self._in_doubt: list[tuple[float, Any]] = []

    def heard(self, stop: Any) -> Any:
        """Take a stop; return it if it counts, else None."""
        if not self._counts(stop):
            self.look_around()
        if self._counts(stop):
            return stop
        self._in_doubt.append((time.monotonic() + DOUBT_S, stop))
        return None

    def look_around(self) -> Any:
        """Note who takes part, ten times a second; return a stop that counts now, or None."""
        for topic in LOCKSTEP_TOPICS:
            name = self._node.resolve_topic_name(topic.name)
            for info in self._node.get_publishers_info_by_topic(name):
                self._participants.add(f'{info.node_namespace.rstrip("/")}/{info.node_name}')
        now_s = time.monotonic()
        doubts, self._in_doubt = self._in_doubt, []
        for until_s, stop in doubts:
            if self._counts(stop):
                return stop
            if now_s < until_s:
                self._in_doubt.append((until_s, stop))
                continue
            self.ignored += 1
            self._node.get_logger().warning(
                f'passed over a stop of {stop.node}, which takes no part in this twin: {stop.reason}'
            )
        return None

    def _counts(self, stop: Any) -> bool:
        return stop.node in self._participants
