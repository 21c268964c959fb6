# SPDX-License-Identifier: Apache-2.0
"""
The input of a topic whose messages are the clock: each lets time go on by one of its cycles.

A device that runs by itself, as real hardware does, gives its messages when it likes. The twin computes
the cycle of each and waits for the next, however fast or slow they come. What the device is ahead is
kept in order, `LONGEST_LEAD` messages at most. A tick that it has passed over is computed with the
values before it and counted as `missed`; a message of a tick that has been computed is counted as `late`
and passed over, as is a repetition.

When the device is silent, `ramp` lets a number of cycles go on without it, with values that go to zero
in a straight line. Then time stands.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np

from waferbot_lockstep.contract import Topic
from waferbot_lockstep.inbox import TopicInput
from waferbot_lockstep.layout import SHIPPED, Layout
from waferbot_lockstep.timing import Timing

LONGEST_LEAD = 1024
"""Messages that a device may be ahead; the topic's history holds as many."""


class DeviceInput(TopicInput):
    """
    The messages of a device on one topic, cycle by cycle; used like an `Inbox`.

    `missed` and `late` count as the module's docstring says, `ramped` the cycles without the device.
    """

    def __init__(
        self, topic: Topic, timing: Timing, needed: int, layout: Layout = SHIPPED
    ) -> None:
        """Start at tick 0, needing the places whose bits are set in `needed`, of one device."""
        super().__init__(topic, timing, needed, layout)
        self.due = 0
        self.complete = False
        self.missed = 0
        self.late = 0
        self.ramped = 0
        self._newest = -1
        self._ahead: deque[tuple[int, Sequence[float]]] = deque()
        self._ramp_from = self.values.copy()
        self._ramp_cycles = 0
        self._ramp_left = 0

    @property
    def missing(self) -> str:
        """The places that are still to come, by name."""
        return '' if self.complete else self.names_of(self.needed)

    def push(self, tick: int, stamp_ns: int, valid: int, values: Sequence[float]) -> bool:
        """Take one message; return whether there are values now for the tick that is due."""
        self.check(tick, stamp_ns, valid, values)
        if self.needed & ~valid:
            raise self.error(
                tick, 'speaks for some axes only; a device that is the clock gives all'
            )
        if tick == self._newest:
            return False
        if tick < self._newest:
            raise self.error(
                tick, f'is stale or out of order: tick {self._newest} was there before'
            )
        self._newest = tick
        self._ramp_left = 0
        if tick < self.due or (tick == self.due and self.complete):
            self.late += 1
            return False
        if len(self._ahead) >= LONGEST_LEAD:
            raise self.error(tick, f'is more than {LONGEST_LEAD} cycles ahead of the twin')
        self._ahead.append((tick, values))
        return self._look_ahead()

    def consumed(self) -> None:
        """Say that the values have been used: go on to the next tick."""
        self.due += self.spacing
        self.complete = False
        self._look_ahead()

    def ramp(self, cycles: int) -> bool:
        """
        Go on without the device for `cycles`, towards zero, unless the values are that already.

        Return whether there are values now for the tick that is due.
        """
        if not self.values.any():
            return False
        self._ramp_from = self.values.copy()
        self._ramp_cycles = self._ramp_left = cycles
        return self._look_ahead()

    def _look_ahead(self) -> bool:
        """Take the values of the tick that is due, if there are any; return whether it has them now."""
        if self.complete:
            return False
        if self._ahead:
            if self._ahead[0][0] == self.due:
                self.keep(self.needed, self._ahead.popleft()[1])
            else:
                self.missed += 1
        elif self._ramp_left > 0:
            self._ramp_left -= 1
            self.ramped += 1
            np.multiply(self._ramp_from, self._ramp_left / self._ramp_cycles, out=self.values)
        else:
            return False
        self.complete = True
        return True
