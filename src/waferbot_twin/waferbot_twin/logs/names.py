# SPDX-License-Identifier: Apache-2.0
"""Names of logs that tell them apart: `monday/step` and `tuesday/step`, not `step` twice."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path


def names_of(paths: Sequence[Path]) -> list[str]:
    """
    Return a name for each log: its folder's or file's, with as many folders above as set it apart.

    Where a log is given twice the second one has its number behind it.
    """
    parts = [path.absolute().parts for path in paths]
    given: Counter[tuple[str, ...]] = Counter()
    found = []
    for own in parts:
        given[own] += 1
        count = next(n for n in range(1, len(own) + 1) if _alone(own, n, parts))
        name = '/'.join(own[-count:])
        found.append(name if given[own] == 1 else f'{name} ({given[own]})')
    return found


def _alone(own: tuple[str, ...], count: int, every: Sequence[tuple[str, ...]]) -> bool:
    """Return whether the last parts of a path are those of no other one."""
    return all(other == own or other[-count:] != own[-count:] for other in every)
