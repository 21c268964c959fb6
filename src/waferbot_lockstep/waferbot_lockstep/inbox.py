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
from waferbot_lockstep.timing import Timing


class _TopicInput:
    """What every input of the contract checks, whichever way time is kept."""

    def __init__(self, topic: Topic, timing: Timing, needed: int) -> None:
        self.topic = topic
        self.timing = timing
        self.needed = needed
        self.spacing = topic.ticks_between(timing)
        whole = topic.message == 'Encoders'
        self.values = np.zeros(len(topic.places) * topic.width, np.int64 if whole else np.float64)
        self.mask = 0
        self.heard = 0

    def _check(self, tick: int, stamp_ns: int, valid: int, values: Sequence[float]) -> None:
        self.heard |= valid
        if valid == 0 or valid & ~self.topic.all_places:
            raise self._error(tick, f'speaks for axes that do not exist (valid = {valid:#x})')
        if tick % self.spacing:
            raise self._error(tick, f'is no tick of this topic, which has every {self.spacing}th')
        if stamp_ns != self.timing.stamp_ns(tick):
            raise self._error(
                tick,
                f'has the stamp {stamp_ns} ns, which is not that of its tick '
                f'({self.timing.stamp_ns(tick)} ns)',
            )
        if not math.isfinite(sum(values)) and not self._finite(valid, values):
            raise self._error(tick, f'holds a value that is no finite number: {tuple(values)}')

    def _finite(self, valid: int, values: Sequence[float]) -> bool:
        """Tell whether all values of the places in `valid` are finite numbers, one by one."""
        width = self.topic.width
        return all(
            math.isfinite(value)
            for index, value in enumerate(values[: self.values.size])
            if valid >> index // width & 1
        )

    def _keep(self, relevant: int, values: Sequence[float]) -> None:
        """Put the values and mask bits of the places in `relevant` where they belong."""
        if relevant == self.topic.all_places:
            self.values[:] = values[: self.values.size]
        else:
            width = self.topic.width
            for place in range(len(self.topic.places)):
                if relevant >> place & 1:
                    own = slice(place * width, (place + 1) * width)
                    self.values[own] = values[own]
        if self.topic.mask:
            self.mask = self.mask & ~relevant | int(values[-1]) & relevant

    def _error(self, tick: int, what: str, mask: int = 0) -> LockstepError:
        axes = f' ({self.topic.names_of(mask)})' if self.topic.names_of(mask) else ''
        return LockstepError(
            f'topic {self.topic.name}, tick {tick}{axes} from {self.topic.publisher}: {what}'
        )


class Inbox(_TopicInput):
    """
    The lock-step input of one topic.

    `values` is a float64 or int64 array of shape (places * width,), the last complete values; it is
    the same array for the inbox's whole life, so that compiled functions can be handed it once.
    `mask` has the bits of the topic's mask field (`Topic.mask`), 0 if it has none. `due` is the tick
    that the inbox waits for. `heard` collects the mask of the places from which any message came,
    repetitions included; whoever watches for silence reads and clears it.
    """

    def __init__(self, topic: Topic, timing: Timing, needed: int) -> None:
        """Start at tick 0, needing the places whose bits are set in `needed`."""
        super().__init__(topic, timing, needed)
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
        return self.topic.names_of(self.needed & ~self._covered)

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
        self._check(tick, stamp_ns, valid, values)
        relevant = valid & self.needed
        if not relevant:
            return False
        message = (relevant, values)
        if tick == self.due:
            if not relevant & self._covered:
                self._keep(relevant, values)
                self._covered |= relevant
                self._messages.append(message)
                return True
            if message in self._messages:
                return False
            raise self._error(
                tick,
                'came twice, and not the same: two nodes speak for the same axis',
                relevant & self._covered,
            )
        if tick == self.due - self.spacing and message in self._previous:
            return False
        if tick < self.due:
            raise self._error(tick, f'is stale or out of order: tick {self.due} is due', relevant)
        raise self._error(
            self.due,
            f'is missing: tick {tick} came instead',
            relevant & ~self._covered or relevant,
        )


class NewestInput(_TopicInput):
    """
    The input of one topic when the plant follows the wall clock: the newest value wins.

    Nothing waits, so lateness is counted instead: `late` messages are older than `now`, the tick at
    which their receiver already is; `missed` ticks of a place were passed over without a message.
    A message older than the newest of its place changes nothing. `newest_possible` is the last tick
    that anybody can speak for (None: the receiver does not know); one beyond it would shut out all
    that follow, so it raises `LockstepError`.
    """

    def __init__(self, topic: Topic, timing: Timing, needed: int) -> None:
        """Start with all values zero and nothing received."""
        super().__init__(topic, timing, needed)
        self.now = 0
        self.newest_possible: int | None = None
        self.received = 0
        self.late = 0
        self.missed = 0
        self._newest = [-1] * len(topic.places)

    @property
    def complete(self) -> bool:
        """Whether every needed place has spoken at least once."""
        return all(
            tick >= 0 for place, tick in enumerate(self._newest) if self.needed >> place & 1
        )

    @property
    def missing(self) -> str:
        """The places that have not spoken yet, by name."""
        silent = [
            place
            for place, tick in enumerate(self._newest)
            if self.needed >> place & 1 and tick < 0
        ]
        return ', '.join(self.topic.places[place] for place in silent)

    @property
    def behind(self) -> int:
        """How many ticks the oldest of the values in use lags behind `now`."""
        return max(0, self.now - self.newest_tick)

    @property
    def newest_tick(self) -> int:
        """The newest tick that every needed place has reached (-1: some have not spoken)."""
        return min(tick for place, tick in enumerate(self._newest) if self.needed >> place & 1)

    def push(self, tick: int, stamp_ns: int, valid: int, values: Sequence[float]) -> bool:
        """Take one message; return whether any needed place became newer by it."""
        self._check(tick, stamp_ns, valid, values)
        if self.newest_possible is not None and tick > self.newest_possible:
            raise self._error(
                tick, f'is from the future: time stands at tick {self.newest_possible}'
            )
        relevant = valid & self.needed
        new = 0
        for place, newest in enumerate(self._newest):
            if relevant >> place & 1 and tick > newest:
                if newest >= 0:
                    self.missed += (tick - newest) // self.spacing - 1
                self._newest[place] = tick
                new |= 1 << place
        if new:
            self._keep(new, values)
            self.received += 1
            self.late += tick < self.now
        return bool(new)
