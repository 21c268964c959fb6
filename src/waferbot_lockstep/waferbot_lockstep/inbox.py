# SPDX-License-Identifier: Apache-2.0
"""
What a node waits for on one topic, and what it refuses.

An inbox holds the values of the tick that is due. It is complete when every place (axis or encoder)
that its node needs has been given for that tick, by one message or by several. It accepts a repeated
message, because a node that waits repeats its last one as a sign of life. Everything else that does
not fit - a tick too early or too late, the same axis twice with different values, an axis that does
not exist, a value that is no finite number - raises `LockstepError` with peer, topic and tick.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from waferbot_lockstep.contract import Topic
from waferbot_lockstep.errors import LockstepError
from waferbot_lockstep.layout import SHIPPED, Layout
from waferbot_lockstep.timing import Timing


class TopicInput:
    """What every input of the contract checks, whichever way time is kept."""

    def __init__(
        self, topic: Topic, timing: Timing, needed: int, layout: Layout = SHIPPED
    ) -> None:
        self.topic = topic
        self.timing = timing
        self.needed = needed
        self.layout = layout
        self.places = topic.places(layout)
        self.all_places = topic.all_places(layout)
        self.spacing = topic.ticks_between(timing)
        whole = topic.message == 'Encoders'
        self.values = np.zeros(len(self.places) * topic.width, np.int64 if whole else np.float64)
        self.mask = 0
        self.heard = 0

    def check(self, tick: int, stamp_ns: int, valid: int, values: Sequence[float]) -> None:
        """Refuse what no honest peer can send; note from which places something came."""
        self.heard |= valid
        if valid == 0 or valid & ~self.all_places:
            raise self.error(tick, f'speaks for axes that do not exist (valid = {valid:#x})')
        if tick % self.spacing:
            raise self.error(tick, f'is no tick of this topic, which has every {self.spacing}th')
        if stamp_ns != self.timing.stamp_ns(tick):
            raise self.error(
                tick,
                f'has the stamp {stamp_ns} ns, which is not that of its tick '
                f'({self.timing.stamp_ns(tick)} ns)',
            )
        if not math.isfinite(sum(values)) and not self._finite(valid, values):
            raise self.error(tick, f'holds a value that is no finite number: {tuple(values)}')

    def _finite(self, valid: int, values: Sequence[float]) -> bool:
        """Tell whether all values of the places in `valid` are finite numbers, one by one."""
        width = self.topic.width
        return all(
            math.isfinite(value)
            for index, value in enumerate(values[: self.values.size])
            if valid >> index // width & 1
        )

    def keep(self, relevant: int, values: Sequence[float]) -> None:
        """Put the values and mask bits of the places in `relevant` where they belong."""
        if relevant == self.all_places:
            self.values[:] = values[: self.values.size]
        else:
            width = self.topic.width
            for place in range(len(self.places)):
                if relevant >> place & 1:
                    own = slice(place * width, (place + 1) * width)
                    self.values[own] = values[own]
        if self.topic.mask:
            self.mask = self.mask & ~relevant | int(values[-1]) & relevant

    def names_of(self, mask: int) -> str:
        """Return the places of a mask by name."""
        return self.topic.names_of(mask, self.layout)

    def error(self, tick: int, what: str, mask: int = 0) -> LockstepError:
        """Return the error that names topic, tick and peer."""
        names = self.names_of(mask)
        axes = f' ({names})' if names else ''
        return LockstepError(
            f'topic {self.topic.name}, tick {tick}{axes} from {self.topic.publisher}: {what}'
        )


class Inbox(TopicInput):
    """
    The lock-step input of one topic.

    `values` is a float64 or int64 array of shape (places * width,), the last complete values; it is
    the same array for the inbox's whole life, so that compiled functions can be handed it once.
    `mask` has the bits of the topic's mask field (`Topic.mask`), 0 if it has none. `due` is the tick
    that the inbox waits for. `heard` collects the mask of the places from which any message came,
    repetitions included; whoever watches for silence reads and clears it.
    """

    def __init__(
        self, topic: Topic, timing: Timing, needed: int, layout: Layout = SHIPPED
    ) -> None:
        """Start at tick 0, needing the places whose bits are set in `needed`."""
        super().__init__(topic, timing, needed, layout)
        self.due = 0
        self._covered = 0
        # (places, values) of the messages of the tick that is due, and of the one before
        self._messages: list[tuple[int, Sequence[float]]] = []
        self._previous: list[tuple[int, Sequence[float]]] = []

    @property
    def complete(self) -> bool:
        """Whether every needed place has been given for the tick that is due."""
        return self._covered == self.needed

    @property
    def missing(self) -> str:
        """The places that are still to come, by name."""
        return self.names_of(self.needed & ~self._covered)

    def consumed(self) -> None:
        """Say that the complete values have been used: wait for the next tick of this topic."""
        self.due += self.spacing
        self._covered = 0
        self._messages, self._previous = [], self._messages

    def push(self, tick: int, stamp_ns: int, valid: int, values: Sequence[float]) -> bool:
        """
        Take one message; return whether it brought anything new (False for a repetition).

        `values` is the tuple of all values behind `valid` in the message. Places that this node does
        not need are passed over. Raises `LockstepError` as the module's docstring says.
        """
        self.check(tick, stamp_ns, valid, values)
        relevant = valid & self.needed
        if not relevant:
            return False
        message = (relevant, values)
        if tick == self.due:
            if not relevant & self._covered:
                self.keep(relevant, values)
                self._covered |= relevant
                self._messages.append(message)
                return True
            if message in self._messages:
                return False
            raise self.error(
                tick,
                'came twice, and not the same: two nodes speak for the same axis',
                relevant & self._covered,
            )
        if tick == self.due - self.spacing and message in self._previous:
            return False
        if tick < self.due:
            raise self.error(tick, f'is stale or out of order: tick {self.due} is due', relevant)
        raise self.error(
            self.due,
            f'is missing: tick {tick} came instead',
            relevant & ~self._covered or relevant,
        )
