# SPDX-License-Identifier: Apache-2.0
"""
Keeps account of which ticks have been recorded, so that a gap is found and said.

A repeated message (a sign of life) is not recorded twice. At the end every place of every topic must
have been given at every one of its ticks.
"""

from __future__ import annotations

from waferbot_lockstep.contract import AMPLIFIER_STATE, CONTRACT_TOPICS, SLOW_DIVIDER, Topic
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.timing import Timing

from waferbot_twin.recording.writer import RecordingWriter


class Account:
    """What has been recorded of each contract topic."""

    def __init__(self, timing: Timing) -> None:
        """Begin with nothing recorded."""
        self.timing = timing
        self._last = {topic: [-1] * len(topic.places) for topic in CONTRACT_TOPICS}
        self._due_given = {topic: [0] * len(topic.places) for topic in CONTRACT_TOPICS}

    def is_new(self, topic: Topic, tick: int, valid: int) -> bool:
        """Note a message; return False if all it says has been recorded before."""
        last = self._last[topic]
        spacing = self.spacing(topic)
        new = False
        for place, last_tick in enumerate(last):
            if valid >> place & 1 and tick > last_tick:
                last[place] = tick
                new = True
                if tick % spacing == 0:
                    self._due_given[topic][place] += 1
        return new

    def spacing(self, topic: Topic) -> int:
        """Return the ticks between the messages that must be there (the slow topic also has more)."""
        return SLOW_DIVIDER if topic is AMPLIFIER_STATE else topic.ticks_between(self.timing)

    def begun(self) -> bool:
        """Tell whether every place of every topic has been given at least once."""
        return all(tick >= 0 for last in self._last.values() for tick in last)

    def missing(self, ticks: int) -> dict[str, int]:
        """Return, per topic, how many messages of the run's `ticks` ticks lack (places counted)."""
        missing = {}
        for topic in CONTRACT_TOPICS:
            expected = self.timing.messages(ticks, self.spacing(topic))
            missing[topic.name] = sum(expected - given for given in self._due_given[topic])
        return missing

    def expected(self, ticks: int) -> int:
        """Return how many places of messages a complete run of `ticks` ticks has."""
        return sum(
            self.timing.messages(ticks, self.spacing(topic)) * len(topic.places)
            for topic in CONTRACT_TOPICS
        )

    def complete_until(self) -> int:
        """Return the first tick at which something is missing, judging by the newest messages."""
        return max(
            0,
            min(
                self.spacing(topic) + tick if tick >= 0 else 0
                for topic, last in self._last.items()
                for tick in last
            ),
        )


def close_complete(writer: RecordingWriter, account: Account, ticks: int) -> str:
    """
    Close a recording of `ticks` ticks; return `0 missing of N`.

    Raises `UserError`, after closing the file, if a message is missing.
    """
    missing = {name: count for name, count in account.missing(ticks).items() if count}
    expected = account.expected(ticks)
    line = f'{sum(missing.values())} missing of {expected}'
    writer.close(
        {
            'complete': 'false' if missing else 'true',
            'ticks': str(ticks),
            'missing': str(sum(missing.values())),
            'expected': str(expected),
        }
    )
    if missing:
        topics = ', '.join(f'{name}: {count}' for name, count in missing.items())
        raise UserError(
            f'{writer.path}: {line} messages ({topics}); everything up to tick '
            f'{account.complete_until()} is there'
        )
    return line
