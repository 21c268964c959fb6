# SPDX-License-Identifier: Apache-2.0
"""What was found wrong with a log while it was read."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass

import numpy as np

MOST_NAMES = 12
"""Names that a message lists."""

ACTIONS = ('left out', 'put in order', 'suspect', 'note')
"""
What became of it: data are not in the signals; are, in another order; are, but look wrong; or all is
as it should be, and the user may want to know.
"""


@dataclass(frozen=True)
class Finding:
    """One remark: where (file, line, topic, time), why, and what became of it (`ACTIONS`)."""

    place: str
    reason: str
    action: str = 'left out'

    def __str__(self) -> str:
        """Return it as one line."""
        return f'{self.action}: {self.place}: {self.reason}'


def unique(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return the findings in their order, each once: signals of one file share its troubles."""
    return tuple(dict.fromkeys(findings))


def rows_text(rows: np.ndarray, place_of: Callable[[int], str]) -> str:
    """Return where the given rows are, in few words: the first, how many more, and the last."""
    first = place_of(int(rows[0]))
    if len(rows) == 1:
        return first
    return f'{first} and {len(rows) - 1} more up to {place_of(int(rows[-1]))}'


def names_text(names: Collection[str]) -> str:
    """Return names in words, the first `MOST_NAMES` of many; `none` if there is none."""
    listed = ', '.join(sorted(names)[:MOST_NAMES])
    more = f' and {len(names) - MOST_NAMES} more' if len(names) > MOST_NAMES else ''
    return listed + more if listed else 'none'
