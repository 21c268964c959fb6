# SPDX-License-Identifier: Apache-2.0
"""
How the messages of nodes in one process reach one another, without the way through the middleware.

Nodes that share an `Exchange` hand each other the bytes that they publish, in the order in which they
were published. Every message is published on its ROS topic all the same, for whoever listens there. A
topic is taken inside the process if all the places that are needed are given there; otherwise it is
taken by its ROS topic as a whole, so that nothing comes twice.

With a `Channel` the same goes between processes; then all topics but those named in `from_topics` are
taken from the exchange. A node with an exchange of its own and no channel takes all by topics.

Delivery is one after another, from a queue: a node that answers while it is served is not entered
again. So the order, and with it every bit, depends on no thread.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection
from typing import Any

from waferbot_lockstep.channel import Channel

Taker = Callable[..., None]
"""Takes a message: its bytes, and behind them what the decoder of its topic makes of them."""

MOST_DELIVERIES = 64
"""How many messages are delivered before the executor has its turn (about 1 ms)."""

IDLE_S = 0.002
"""With a channel, wall time to wait for it before the executor has its turn."""


class Exchange:
    """
    The messages of the nodes in one process.

    Topics go by their full names. `offer` all of them before anybody asks `takes`.
    """

    def __init__(self, channel: Channel | None = None, from_topics: Collection[str] = ()) -> None:
        """Begin with nobody; `from_topics` are those that other processes give by ROS topics only."""
        self.channel = channel
        self.from_topics = from_topics
        self._offered: dict[str, int] = {}
        self._takers: dict[str, list[Taker]] = {}
        self._decoders: dict[str, Callable[[bytes], tuple[Any, ...]]] = {}
        self._waiting: deque[tuple[str, bytes]] = deque()

    def offer(self, name: str, mask: int = 1) -> None:
        """Say that a node of this process speaks for the places in `mask` of a topic."""
        self._offered[name] = self._offered.get(name, 0) | mask

    def takes(self, name: str, mask: int = 1) -> bool:
        """Tell whether the places in `mask` of a topic come by this exchange."""
        if name in self.from_topics:
            return False
        return self.channel is not None or mask & ~self._offered.get(name, 0) == 0

    def listen(
        self, name: str, taker: Taker, decode: Callable[[bytes], tuple[Any, ...]] | None = None
    ) -> None:
        """
        Have `taker(data, *decode(data))` called with every message of a topic.

        Each message is decoded once, by the decoder that came first: all of a topic do the same.
        """
        self._takers.setdefault(name, []).append(taker)
        self._decoders.setdefault(name, decode or _nothing)
        if self.channel is not None:
            self.channel.want(name)

    def put(self, name: str, data: bytes) -> None:
        """Hand over a message to all who listen, in other processes at once, in this one in turn."""
        if self.channel is not None:
            self.channel.send(name, data)
        if name in self._takers:
            self._waiting.append((name, data))

    def serve(self, executor: Any, timeout_s: float) -> int:
        """
        Deliver what waits, then let the executor do what it has to.

        If there is nothing at all, wait `timeout_s` at most. Return how many messages were delivered, or
        1 for what the executor did.
        """
        if self.channel is not None:
            delivered = self._deliver(self.channel, min(timeout_s, IDLE_S))
            self.channel.look_around()
            serve_what_waits(executor)
            return delivered
        if self._waiting:
            delivered = self._deliver(None, 0.0)
            if self._waiting:
                serve_what_waits(executor)
            return delivered
        executor.spin_once(timeout_sec=timeout_s)
        return 1

    def close(self) -> None:
        """End the connections with other processes."""
        if self.channel is not None:
            self.channel.close()

    def _deliver(self, channel: Channel | None, timeout_s: float) -> int:
        waiting, takers, decoders = self._waiting, self._takers, self._decoders
        for delivered in range(MOST_DELIVERIES):
            if not waiting:
                if channel is None:
                    return delivered
                waiting.extend(channel.receive(timeout_s))
                if not waiting:
                    return delivered
            name, data = waiting.popleft()
            fields = decoders[name](data)
            for take in takers[name]:
                take(data, *fields)
        return MOST_DELIVERIES


def serve_what_waits(executor: Any) -> None:
    """
    Let an executor do all that it has to by now, and wait for nothing.

    `spin_once` with no time to wait still sleeps for the kernel's timer slack, 0.1 ms, if there is
    nothing; a task of its own behind all that waits makes it return at once.
    """
    reached: list[bool] = []
    executor.create_task(reached.append, True)
    while not reached:
        executor.spin_once(timeout_sec=0.1)


def _nothing(data: bytes) -> tuple[Any, ...]:
    return ()
