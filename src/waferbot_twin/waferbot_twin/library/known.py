# SPDX-License-Identifier: Apache-2.0
"""
What the library knows of one machine: values with standard errors, for the next logs of it.

The latest entry of a path counts alone (by date, then by its line). An identification or a diagnosis
that the library took part in holds what was known before, so older entries would count twice.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.parameters import did_you_mean
from waferbot_twin.estimation.intervals import NORMAL_95
from waferbot_twin.estimation.known_values import Known
from waferbot_twin.library.entries import Entry, load


def known_of(entries: Sequence[Entry], machine: str) -> dict[str, Known]:
    """
    Return what is known of a machine, by path: of entries that have one, and an interval.

    Raises `UserError` if there is no such machine in it.
    """
    machines = {entry.machine for entry in entries if entry.machine}
    if machine not in machines:
        raise UserError(
            f'--machine {machine}: the library has none of that name{did_you_mean(machine, machines)}'
        )
    found: dict[str, tuple[str, Known]] = {}
    for entry in entries:
        error = (entry.high - entry.low) / (2.0 * NORMAL_95)
        if entry.machine != machine or not entry.path or not error > 0.0 or math.isnan(error):
            continue
        before = found.get(entry.path)
        if before is None or entry.date >= before[0]:
            origin = ', '.join(filter(None, (entry.origin, entry.date)))
            found[entry.path] = entry.date, Known(entry.value, error, origin)
    return {path: known for path, (_, known) in found.items()}


def read_known(library: Path | None, machine: str) -> dict[str, Known]:
    """Return what a library's file knows of a machine, nothing if none is named; raises `UserError`."""
    if not machine:
        return {}
    if library is None:
        raise UserError(
            '--machine says of which machine the library is asked: give --library, too'
        )
    return known_of(load(library), machine)
