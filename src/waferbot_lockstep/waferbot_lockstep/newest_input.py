# SPDX-License-Identifier: Apache-2.0
"""
What a node in real time holds of one topic: the newest values, and an account of how they came.

In lock-step a message that does not fit stops the twin (`waferbot_lockstep.inbox`). Here nothing that a
busy machine or a lossy network does to honest messages stops anybody. A message of tick t is

    late      the receiver has already gone past t; its values are used if none newer are held
    early     the receiver is not at t yet, by more than a message; it is held back until then. Further
              ahead than `HORIZON` it belongs to another beginning of time, and is dropped
    missed    a later one of the same place came first
    doubled   it says what has been said before (signs of life do)
    contradicting   it says something else for a tick that has been given: two nodes for one axis

What no honest peer sends (a value that is no finite number, an axis that does not exist, a stamp that
is not the tick's) raises `LockstepError`, as in lock-step.

The plant gives the time. Its topics are never early or late: their newest tick is where time stands. A
plant that was started again begins anew at tick 0; see `NewestInput.began_anew`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from waferbot_lockstep.contract import HISTORY_DEPTH, PHASE_CURRENTS, Topic
from waferbot_lockstep.inbox import TopicInput
from waferbot_lockstep.layout import SHIPPED, Layout
from waferbot_lockstep.timing import Timing

HORIZON = HISTORY_DEPTH
"""
Ticks. No reliable publisher holds more messages than that, so nothing honest arrives out of order by
more.
"""

TIME_GIVER = PHASE_CURRENTS.publisher
REMEMBERED = 10_000
"""Messages over which the 99th percentile of the lateness is taken."""


@dataclass
class Arrivals:
    """
    How the messages of one topic came, counted from the start of the node.

    `received` counts those that said something for a tick for the first time, in whatever order they
    came: with `missed` they are all messages from the first one on to the newest, each counted once.
    `lateness_s` has, for the last messages, the wall time from when the receiver reached their tick to
    when they came (0 for those that were there already); `worst_s` is the largest of all.
    `longest_silence_s` is the longest wall time between two messages, repetitions included.
    """

    received: int = 0
    late: int = 0
    missed: int = 0
    early: int = 0
    doubled: int = 0
    contradicting: int = 0
    worst_s: float = 0.0
    longest_silence_s: float = 0.0
    lateness_s: deque[float] = field(default_factory=lambda: deque(maxlen=REMEMBERED))
    last_heard_s: float | None = None

    def heard(self, now_s: float) -> None:
        """Note that something came at the monotonic wall time `now_s`."""
        if self.last_heard_s is not None:
            self.longest_silence_s = max(self.longest_silence_s, now_s - self.last_heard_s)
        self.last_heard_s = now_s

    def came_after(self, lateness_s: float) -> None:
        """Note the lateness of a message."""
        self.lateness_s.append(lateness_s)
        if lateness_s > self.worst_s:
            self.worst_s = lateness_s

    def percentile_s(self, percent: float) -> float:
        """Return a percentile of the lateness of the last messages, s; 0 if there were none."""
        return float(np.percentile(self.lateness_s, percent)) if self.lateness_s else 0.0

    @property
    def trouble(self) -> int:
        """How many messages were late, missing, early or contradicting; doubled ones do no harm."""
        return self.late + self.missed + self.early + self.contradicting


class NewestInput(TopicInput):
    """
    The real-time input of one topic: the newest values win, and nobody is waited for for ever.

    `now` is the tick at which the receiver stands, told by `reach` (-1: it does not know yet).
    `began_anew` is set when the plant has begun again at an earlier tick; whoever acts on it clears
    it.
    """

    def __init__(
        self, topic: Topic, timing: Timing, needed: int, layout: Layout = SHIPPED
    ) -> None:
        """Start with all values zero and nothing received."""
        super().__init__(topic, timing, needed, layout)
        self.gives_time = topic.publisher == TIME_GIVER
        self.arrivals = Arrivals()
        self.began_anew = False
        self._places = [place for place in range(len(self.places)) if needed >> place & 1]
        self.forget()

    def forget(self) -> None:
        """Wait for a first message again, as time begins anew; the account goes on."""
        self.now = -1
        self._newest = [-1] * len(self.places)
        self._gone = 0  # places that are not waited for until they are heard again
        self._passed = [-1] * len(self.places)  # what was due when they were last waited for
        self._gaps: dict[int, int] = {}  # tick: places that were passed over there
        self._held_back: list[tuple[int, int, Sequence[float]]] = []
        self._far_back = 0  # messages in a row from far before what is held
        self._reached_s = [
            0.0
        ] * HORIZON  # wall time at which `now` came to a tick, by tick % HORIZON

    @property
    def complete(self) -> bool:
        """Whether every needed place has spoken at least once."""
        return self.newest_tick >= 0

    @property
    def missing(self) -> str:
        """The places that have not spoken yet, by name."""
        silent = (place for place in self._places if self._newest[place] < 0)
        return ', '.join(self.places[place] for place in silent)

    @property
    def behind(self) -> int:
        """How many ticks the oldest of the values in use lags behind `now`."""
        return max(0, self.now - self.newest_tick)

    @property
    def newest_tick(self) -> int:
        """The newest tick that every needed place has reached (-1: some have not spoken)."""
        return min(self._newest[place] for place in self._places)

    def waits_for(self, tick: int) -> bool:
        """Tell whether a place that answers as a rule lacks the message that is due by `tick`."""
        due = tick - tick % self.spacing
        for place in self._places:
            if max(self._newest[place], self._passed[place]) < due and not self._gone >> place & 1:
                return True
        return False

    def give_up(self, tick: int, gone: int) -> None:
        """
        Wait no longer for the message that is due by `tick`, of the places that lack it.

        The next one is waited for again, or else a single message that was lost would leave its sender
        behind; but none of the places in the mask `gone`, until they are heard again.
        """
        due = tick - tick % self.spacing
        for place in self._places:
            if self._newest[place] < due:
                self._passed[place] = due
                self._gone |= gone & 1 << place

    def reach(self, tick: int, now_s: float) -> None:
        """Say that the receiver stands at `tick` since wall time `now_s`; use what was held for it."""
        for passed in range(max(self.now + 1, tick - HORIZON + 1), tick + 1):
            self._reached_s[passed % HORIZON] = now_s
        self.now = tick
        if self._held_back:
            held = sorted(self._held_back, key=lambda message: message[0])
            self._held_back = [message for message in held if message[0] > tick]
            for message in held[: len(held) - len(self._held_back)]:
                self._take(*message, now_s)

    def push(
        self, tick: int, stamp_ns: int, valid: int, values: Sequence[float], now_s: float = 0.0
    ) -> bool:
        """Take one message, come at wall time `now_s`; return whether a needed place is newer by it."""
        self.check(tick, stamp_ns, valid, values)
        relevant = valid & self.needed
        if not relevant:
            return False
        self.arrivals.heard(now_s)
        if self.gives_time:
            if self._is_another_beginning(tick):
                self.forget()
                self.began_anew = True
            self.now = max(self.now, tick)
        elif tick > self.now:
            # One message ahead is no trouble: peers that are awake at once answer before we look.
            # Before the receiver knows the time, nothing is.
            ahead = tick - self.now if self.now >= 0 else 0
            self.arrivals.early += ahead > self.spacing
            if ahead <= HORIZON:
                self._held_back = [*self._held_back[-HORIZON:], (tick, relevant, values)]
            return False
        return self._take(tick, relevant, values, now_s)

    def _take(self, tick: int, relevant: int, values: Sequence[float], now_s: float) -> bool:
        """Keep what is newer than what is held, and count."""
        new = 0
        passed_over = 0
        newest = self._newest
        for place in self._places:
            if relevant >> place & 1 and tick > newest[place]:
                new |= 1 << place
                gap = (tick - newest[place]) // self.spacing - 1
                if gap and newest[place] >= 0:
                    passed_over = max(passed_over, gap)
                    self._note_gap(newest[place], tick, 1 << place)
                newest[place] = tick
        if tick == 0 and new:  # what is held came before it, so it belongs to another beginning
            self._held_back = [
                (held, mask & ~new, old) for held, mask, old in self._held_back if mask & ~new
            ]
        if not new:
            self._account_for_old(tick, relevant, values)
            return False
        self.arrivals.received += 1
        self.arrivals.missed += passed_over
        if not self.gives_time:
            self.arrivals.late += tick < self.now
            age = self.now - tick
            reached_s = self._reached_s[(tick if age < HORIZON else self.now + 1) % HORIZON]
            self.arrivals.came_after(max(0.0, now_s - reached_s))
        self._gone &= ~new
        self._far_back = 0
        self.keep(new, values)
        return True

    def _note_gap(self, last: int, tick: int, place: int) -> None:
        """Remember the ticks between two messages of a place, to know one of them if it comes."""
        for passed in range(max(last + self.spacing, tick - HORIZON), tick, self.spacing):
            self._gaps[passed] = self._gaps.get(passed, 0) | place
        while len(self._gaps) > HORIZON:
            del self._gaps[next(iter(self._gaps))]

    def _account_for_old(self, tick: int, relevant: int, values: Sequence[float]) -> None:
        """Count a message that is not newer than what is held."""
        arrivals = self.arrivals
        lacking = self._gaps.get(tick, 0) & relevant
        if lacking:
            arrivals.received += 1
            arrivals.late += 1
            arrivals.missed -= 1
            self._gaps[tick] &= ~lacking
        elif self._contradicts(tick, relevant, values):
            arrivals.contradicting += 1
        else:
            arrivals.doubled += 1

    def _contradicts(self, tick: int, relevant: int, values: Sequence[float]) -> bool:
        """Tell whether the values differ from those held for the same tick."""
        width = self.topic.width
        return any(
            self._newest[place] == tick
            and tuple(self.values[place * width : (place + 1) * width])
            != tuple(values[place * width : (place + 1) * width])
            for place in self._places
            if relevant >> place & 1
        )

    def _is_another_beginning(self, tick: int) -> bool:
        """
        Tell whether time has begun anew: two messages in a row from where no late one can be.

        That is tick 0, where a plant that was started again stands until it is answered, or more than
        `HORIZON` before what is held. A single one may be a stray; it counts as doubled or late.
        """
        newest = max(self._newest)
        if tick >= newest or (tick > 0 and newest - tick <= HORIZON):
            return False
        self._far_back += 1
        return self._far_back > 1
