# SPDX-License-Identifier: Apache-2.0
"""
Keeps account of which ticks have been recorded, so that a gap is found and said.

A repeated message (a sign of life) is not recorded twice. At the end every place of every topic must
have been given at every one of its ticks.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from waferbot_lockstep.contract import (
    AMPLIFIER_STATE,
    CONTRACT_TOPICS,
    SERVO_STATE,
    SLOW_DIVIDER,
    Topic,
)
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.layout import SHIPPED, Layout
from waferbot_lockstep.timing import Timing
from waferbot_twin.recording.writer import RecordingWriter


def reported(without: Sequence[str], layout: Layout = SHIPPED) -> dict[Topic, int]:
    """
    Return the places of the report topics that a run's own nodes speak for.

    `without` names the nodes that somebody else provides, who need not report their inner state.
    """
    servo = 0 if 'pmac' in without else SERVO_STATE.all_places(layout)
    amplifiers = 0 if 'copley' in without else AMPLIFIER_STATE.all_places(layout)
    for axis, name in enumerate(layout.axes):
        if f'copley_{name}' in without:
            amplifiers &= ~(1 << axis)
    return {SERVO_STATE: servo, AMPLIFIER_STATE: amplifiers}


class TopicAccount:
    """
    What has been recorded of one topic: the last tick of each place, and how many were due.

    `needed` is the mask of the places that must be there; `first_gap` the first tick at which one of
    them was passed over, None if none was.
    """

    def __init__(
        self, topic: Topic, timing: Timing, needed: int, layout: Layout = SHIPPED
    ) -> None:
        """Begin with nothing recorded."""
        # The slow topic must have a message every so often and may have more.
        self.spacing = SLOW_DIVIDER if topic is AMPLIFIER_STATE else topic.ticks_between(timing)
        self.needed = needed
        places = len(topic.places(layout))
        self.last = [-1] * places
        self.given = [0] * places
        self.first_gap: int | None = None

    def is_new(self, tick: int, valid: int) -> bool:
        """Note a message; return False if all it says has been recorded before."""
        due = tick % self.spacing == 0
        new = False
        for place, last_tick in enumerate(self.last):
            if tick > last_tick and valid >> place & 1:
                if tick - last_tick > self.spacing and self.needed >> place & 1:
                    self._note_gap(self._due_behind(last_tick))
                self.last[place] = tick
                self.given[place] += due
                new = True
        return new

    def note_all(self, ticks: np.ndarray, valid: np.ndarray) -> None:
        """Note many messages (n,) in their order, as `is_new` does with each of them."""
        ticks = ticks.astype(np.int64)
        for place, last_tick in enumerate(self.last):
            own = ticks[(valid >> place & 1).astype(bool)]
            before = np.maximum.accumulate(np.concatenate([[last_tick], own]))
            new, newest_before = own > before[:-1], before[:-1]
            self.given[place] += int(np.count_nonzero(new & (own % self.spacing == 0)))
            if self.needed >> place & 1:
                gaps = np.flatnonzero(new & (own - newest_before > self.spacing))
                if len(gaps):
                    self._note_gap(self._due_behind(int(newest_before[gaps[0]])))
            self.last[place] = int(before[-1])

    def needed_places(self) -> list[int]:
        """Return the indices of the places that must be there."""
        return [place for place in range(len(self.last)) if self.needed >> place & 1]

    def reached(self) -> list[int]:
        """Return, for each needed place, the first tick that is still to come."""
        return [self._due_behind(self.last[place]) for place in self.needed_places()]

    def _due_behind(self, tick: int) -> int:
        return (tick // self.spacing + 1) * self.spacing

    def _note_gap(self, tick: int) -> None:
        self.first_gap = tick if self.first_gap is None else min(tick, self.first_gap)


class Account:
    """
    What has been recorded of each contract topic, in `topics`.

    `needed` maps a topic to the mask of the places that must be there; a topic that it does not name
    must be there whole. (A node that somebody else provides need not report its inner state.)
    """

    def __init__(
        self,
        timing: Timing,
        needed: Mapping[Topic, int] | None = None,
        layout: Layout = SHIPPED,
    ) -> None:
        """Begin with nothing recorded."""
        self.timing = timing
        self.layout = layout
        masks = needed or {}
        self.topics = {
            topic: TopicAccount(topic, timing, masks.get(topic, topic.all_places(layout)), layout)
            for topic in CONTRACT_TOPICS
        }

    def begun(self) -> bool:
        """Tell whether every needed place of every topic has been given at least once."""
        return all(
            own.last[place] >= 0 for own in self.topics.values() for place in own.needed_places()
        )

    def missing(self, ticks: int) -> dict[str, int]:
        """
        Return, per topic, how many messages of the run's `ticks` ticks lack (places counted).

        A place that is beyond that already must have been given up to where it is.
        """
        return {
            topic.name: sum(
                self.timing.messages(max(ticks, own.last[place] + 1), own.spacing)
                - own.given[place]
                for place in own.needed_places()
            )
            for topic, own in self.topics.items()
        }

    def unheard(self) -> dict[str, list[str]]:
        """Return, by publisher, the topics of which a needed place has not been given yet."""
        found: dict[str, list[str]] = {}
        for topic, own in self.topics.items():
            lacking = [
                topic.places(self.layout)[place]
                for place in own.needed_places()
                if own.last[place] < 0
            ]
            if lacking:
                found.setdefault(topic.publisher, []).append(
                    f'{topic.name} ({", ".join(lacking)})'
                )
        return found

    def ended(self, node: str) -> str:
        """
        Return which message of a node, that has ended, is the first that never came.

        A node publishes whole topics, or, named `<publisher>_<place>`, one place of them.
        """
        first: dict[tuple[str, str], int] = {}
        for topic, own in self.topics.items():
            for place, tick in zip(own.needed_places(), own.reached(), strict=True):
                name = topic.places(self.layout)[place]
                if node in (topic.publisher, f'{topic.publisher}_{name}'):
                    first[topic.name, name] = tick
        if not first:
            return 'none of its messages is recorded'
        (topic_name, place_name), tick = min(first.items(), key=lambda item: item[1])
        return f'topic {topic_name} ({place_name}), tick {tick} never came'

    def expected(self, ticks: int) -> int:
        """Return how many places of messages a complete run of `ticks` ticks has."""
        return sum(
            self.timing.messages(ticks, own.spacing) * len(own.needed_places())
            for own in self.topics.values()
        )

    def reached(self) -> int:
        """Return the first tick that is still to come on some topic, whatever lacks before it."""
        return min(tick for own in self.topics.values() for tick in own.reached())

    def complete_until(self) -> int:
        """Return the first tick at which something is missing."""
        gaps = [own.first_gap for own in self.topics.values() if own.first_gap is not None]
        return min([self.reached(), *gaps])


def close_complete(
    writer: RecordingWriter | None,
    account: Account,
    ticks: int,
    failure: str = '',
    told: Mapping[str, str] | None = None,
) -> str:
    """
    Close a recording of `ticks` ticks, if there is one; return `0 missing of N`.

    `told` is what else its metadata tell of the run. Raises `UserError`, after closing the file, if a
    message is missing, or with `failure`, which makes the run no result though all of it is there.
    """
    if writer is None:
        if failure:
            raise UserError(failure)
        return f'ran {ticks} ticks, not recorded (no --out)'
    missing = {name: count for name, count in account.missing(ticks).items() if count}
    expected = account.expected(ticks)
    line = f'{sum(missing.values())} missing of {expected}'
    writer.close(
        {
            'complete': 'false' if missing else 'true',
            'ticks': str(ticks),
            'missing': str(sum(missing.values())),
            'expected': str(expected),
            **({'failure': failure} if failure else {}),
            **(told or {}),
        }
    )
    if failure:
        raise UserError(f'{failure}; recorded to {writer.path}, {line}')
    if missing:
        topics = ', '.join(f'{name}: {count}' for name, count in missing.items())
        raise UserError(
            f'{writer.path}: {line} messages ({topics}); everything up to tick '
            f'{account.complete_until()} is there'
        )
    return line
