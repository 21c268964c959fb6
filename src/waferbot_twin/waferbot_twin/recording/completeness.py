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


class TopicAccount:
    """What has been recorded of one topic: the last tick of each place, and how many were due."""

    def __init__(self, topic: Topic, timing: Timing) -> None:
        """Begin with nothing recorded."""
        # The slow topic must have a message every so often and may have more.
        self.spacing = SLOW_DIVIDER if topic is AMPLIFIER_STATE else topic.ticks_between(timing)
        self.last = [-1] * len(topic.places)
        self.given = [0] * len(topic.places)

    def is_new(self, tick: int, valid: int) -> bool:
        """Note a message; return False if all it says has been recorded before."""
        due = tick % self.spacing == 0
        new = False
        for place, last_tick in enumerate(self.last):
            if tick > last_tick and valid >> place & 1:
                self.last[place] = tick
                self.given[place] += due
                new = True
        return new


class Account:
    """What has been recorded of each contract topic, in `topics`."""

    def __init__(self, timing: Timing) -> None:
        """Begin with nothing recorded."""
        self.timing = timing
        self.topics = {topic: TopicAccount(topic, timing) for topic in CONTRACT_TOPICS}

    def begun(self) -> bool:
        """Tell whether every place of every topic has been given at least once."""
        return all(tick >= 0 for topic in self.topics.values() for tick in topic.last)

    def missing(self, ticks: int) -> dict[str, int]:
        """Return, per topic, how many messages of the run's `ticks` ticks lack (places counted)."""
        return {
            topic.name: sum(
                self.timing.messages(ticks, own.spacing) - given for given in own.given
            )
            for topic, own in self.topics.items()
        }

    def expected(self, ticks: int) -> int:
        """Return how many places of messages a complete run of `ticks` ticks has."""
        return sum(
            self.timing.messages(ticks, own.spacing) * len(own.last)
            for own in self.topics.values()
        )

    def complete_until(self) -> int:
        """Return the first tick at which something is missing, judging by the newest messages."""
        return min(
            own.spacing + tick if tick >= 0 else 0
            for own in self.topics.values()
            for tick in own.last
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
