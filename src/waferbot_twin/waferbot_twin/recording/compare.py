# SPDX-License-Identifier: Apache-2.0
"""Compares two recordings bit by bit."""

from __future__ import annotations

from waferbot_lockstep.contract import CONTRACT_TOPICS
from waferbot_twin.recording.reader import Recording


def differing_signals(one: Recording, other: Recording) -> list[str]:
    """
    Return the contract topics and fields in which two recordings differ in any bit, at any tick.

    Empty: the recordings hold the same signals. A topic that only one of them has is named too.
    """
    different = []
    for topic in CONTRACT_TOPICS:
        a, b = one.topics.get(topic.name), other.topics.get(topic.name)
        if a is None or b is None:
            if a is not b:
                different.append(f'{topic.name}: only in one of them')
            continue
        if len(a) != len(b):
            different.append(f'{topic.name}: {len(a)} ticks against {len(b)}')
            continue
        for field in a.dtype.names or ():
            if a[field].tobytes() != b[field].tobytes():
                different.append(f'{topic.name}.{field}')
    return different
