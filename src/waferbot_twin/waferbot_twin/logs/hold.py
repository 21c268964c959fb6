# SPDX-License-Identifier: Apache-2.0
"""
How a drive signal goes between its samples, as far as its samples show it.

A log that is faster than the controller repeats a held value until the controller's next cycle: nearly
all runs of equal values are whole multiples of one length m, of two samples or more. A measured current
does not do that: where its sensor has steps, the lengths of its runs are any. At one sample for each
cycle the two look alike; then the mapping has to say it (`hold`), or the kind does: commands are held.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from waferbot_twin.logs.findings import Finding
from waferbot_twin.logs.kinds import DRIVES
from waferbot_twin.logs.measured import ZERO_ORDER, Signal

FEWEST_RUNS = 32
MOST, HARDLY = 0.95, 0.02
"""Share of runs that must be multiples of one length, and of runs of one sample that there may be."""

LONG_RUN = 5
"""Runs of so many samples may be one longer or shorter: two clocks."""


def repeats(signal: Signal) -> int:
    """Return how many samples a value of a signal usually stands for; 1 where it shows no hold."""
    changes = np.flatnonzero(np.diff(signal.value) != 0.0)
    runs = np.diff(changes)
    if len(runs) < FEWEST_RUNS:
        return 1
    length = int(np.median(runs))
    if length < 2 or np.mean(runs == 1) > HARDLY:
        return 1
    apart = np.abs(runs - length * np.maximum(np.round(runs / length), 1.0))
    return length if np.mean(apart <= (length >= LONG_RUN)) >= MOST else 1


def with_hold(signal: Signal, findings: list[Finding]) -> Signal:
    """Return a drive signal as held if its samples show that and nobody said otherwise."""
    if signal.kind not in DRIVES or signal.hold or signal.held:
        return signal
    length = repeats(signal)
    if length == 1:
        return signal
    reason = (
        f'each value stands for {length} samples: taken as held between them '
        '(hold: linear in the mapping, if not)'
    )
    findings.append(Finding(signal.name, reason, 'note'))
    return replace(signal, hold=ZERO_ORDER)
