# SPDX-License-Identifier: Apache-2.0
"""
Starting values of a new machine: what the library knows of parts of the same type.

A number of the description gets the median of the library's values of its own path. Where there is
none, a number without a unit (a loss factor, an efficiency) gets that of the same type of part and
parameter; one with a unit stays, for a mass or a torque constant goes with the size of its part. That is
where an identification begins, and no more: of another guide the loss factor may be twice that.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from statistics import median

from waferbot_lockstep.errors import UserError
from waferbot_twin.effects.variant import Variant
from waferbot_twin.identification.named_parameters import SETTINGS, at_path
from waferbot_twin.library.entries import Entry
from waferbot_twin.library.ranges import entries_of


@dataclass(frozen=True)
class Start:
    """A number that was set: from what, to what, in `unit`, and of how many entries."""

    path: str
    unit: str
    before: float
    value: float
    entries: int


def with_starting_values(
    variant: Variant, entries: Sequence[Entry]
) -> tuple[Variant, list[Start]]:
    """Return a model with the library's values, and what was set; raises `UserError`."""
    starts = []
    changed = variant
    for path in _paths(variant, entries):
        try:
            named = at_path(path, variant)
        except UserError:  # a word or a list stands there
            continue
        known = [one for one in entries_of(entries, named) if one.path == path or not named.unit]
        if not known:
            continue
        value = min(max(float(median(one.value for one in known)), named.low), named.high)
        if value == named.start:
            continue
        changed = changed.with_overlay(named.overlay(changed, value))
        starts.append(Start(path, named.unit, named.start, value, len(known)))
    return changed, starts


def _paths(variant: Variant, entries: Sequence[Entry]) -> Iterator[str]:
    """Yield the paths of a model that an entry may be of, each once, in the order of the model."""
    names = {entry.parameter for entry in entries}
    for section, parts in variant.machine.items():
        for name, part in parts.items() if isinstance(parts, Mapping) else ():
            for key in part if isinstance(part, Mapping) else ():
                if str(key) in names:
                    yield f'{section}.{name}.{key}'
    standing = {entry.path for entry in entries if entry.path.split('.')[0] in SETTINGS}
    yield from sorted(standing)
