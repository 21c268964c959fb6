# SPDX-License-Identifier: Apache-2.0
"""What a report works out from a diagnosis is kept with it: page, JSON and console say the same."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

Result = TypeVar('Result')


def once(owner: object, name: str, work_out: Callable[[], Result]) -> Result:
    """Return what `work_out` returns, from the first call on; kept under a name in its owner."""
    kept = vars(owner)
    if name not in kept:
        kept[name] = work_out()
    found: Result = kept[name]
    return found
