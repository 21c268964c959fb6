# SPDX-License-Identifier: Apache-2.0
"""
How a drive signal goes between its samples, as far as its samples show it.

A log that is faster than the controller repeats a held value until the controller's next cycle: nearly
all runs of equal values are whole multiples of one length m, of two samples or more. A measured current
does not do that: where its sensor has steps, the lengths of its runs are any. At one sample for each
cycle the two look alike; then the mapping has to say it (`hold`), or the kind does: commands are held.

Then the motion may tell: taken as what it is not, a drive stands half a sample beside the position that
it moves (`alignment.skew`). `evidence` says what of this a log shows. It changes nothing: a log whose
channels really are late by half a sample looks the same.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from waferbot_twin.logs.alignment import Skew, skew
from waferbot_twin.logs.findings import Finding
from waferbot_twin.logs.kinds import DRIVES
from waferbot_twin.logs.measured import LINEAR, ZERO_ORDER, MeasuredLog, Signal

FEWEST_RUNS = 32
MOST, HARDLY = 0.95, 0.02
"""Share of runs that must be multiples of one length, and of runs of one sample that there may be."""

NEAR_SAMPLES = 0.25
"""Samples that a drive may be beside its position and not be late: half of what the two ways differ."""

NOT_HELD = '(hold: linear in the mapping, if not)'
"""What is said to who knows better of a signal that was found to be held."""

LONG_RUN = 5
"""Runs of so many samples may be one longer or shorter: two clocks."""


def repeats(signal: Signal) -> int:
    """Return how many samples a value of a signal usually stands for; 1 where it shows no hold."""
    changes = np.flatnonzero(np.diff(signal.value) != 0.0)
    return run_length(np.diff(changes))


def run_length(runs: NDArray[np.intp]) -> int:
    """Return the length of which nearly all runs of equal values (n,) are multiples; 1 if none is."""
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
    reason = f'each value stands for {length} samples: taken as held between them {NOT_HELD}'
    findings.append(Finding(signal.name, reason, 'note'))
    return replace(signal, hold=ZERO_ORDER)


@dataclass(frozen=True)
class Evidence:
    """
    How a drive signal was taken, and what its log speaks for.

    `taken` and `speaks_for` are `zero_order` or `linear`, the latter '' where the log does not tell;
    `told_by` says who chose: `mapping`, `kind` or `samples`. `late` are the skews against the position,
    in samples of the drive with their standard errors, by how it is taken; empty if none was looked for.
    """

    axis: str
    kind: str
    taken: str
    told_by: str
    speaks_for: str
    samples_per_value: int
    late: dict[str, tuple[float, float]]

    @property
    def against(self) -> bool:
        """Whether the log speaks for another way than was taken."""
        return self.speaks_for not in ('', self.taken)

    def __str__(self) -> str:
        """Return it as one line."""
        name = f'{self.axis}.{self.kind}'
        way = {ZERO_ORDER: 'held', LINEAR: 'straight'}
        said = f'{name}: taken as {way[self.taken]} between samples (by its {self.told_by})'
        if self.samples_per_value > 1:
            why = f'each value stands for {self.samples_per_value} samples'
        else:
            why = ', '.join(
                f'taken as {way[hold]} it is {late:+.2f} ± {2.0 * error:.2f} samples late'
                for hold, (late, error) in self.late.items()
            )
        if not self.speaks_for:
            return f'{said}; the log does not tell' + (f' ({why})' if why else '')
        agrees = 'another way' if self.against else 'the same'
        return f'{said}; the log speaks for {agrees}, {way[self.speaks_for]}: {why}'

    def as_dict(self) -> dict[str, Any]:
        """Return it as plain values."""
        return {
            'axis': self.axis,
            'kind': self.kind,
            'taken': self.taken,
            'told_by': self.told_by,
            'speaks_for': self.speaks_for,
            'samples_per_value': self.samples_per_value,
            'samples_late': {
                hold: {'value': late, 'standard_error': error}
                for hold, (late, error) in self.late.items()
            },
        }


def evidence(log: MeasuredLog) -> list[Evidence]:
    """Return for what drives each axis how it was taken, and what its samples and the motion show."""
    found = []
    for axis in log.usable_axes():
        drive = next(drive for kind in DRIVES if (drive := log.get(axis, kind)))
        by_samples = any(
            finding.place == drive.name and finding.reason.endswith(NOT_HELD)
            for finding in log.findings
        )
        told_by = 'kind' if not drive.hold else 'samples' if by_samples else 'mapping'
        found.append(_evidence(log[axis, 'position'], drive, told_by))
    return found


def _evidence(position: Signal, drive: Signal, told_by: str) -> Evidence:
    length = repeats(drive)
    taken = ZERO_ORDER if drive.held else LINEAR
    if length > 1:
        return Evidence(drive.axis, drive.kind, taken, told_by, ZERO_ORDER, length, {})
    late = {}
    for hold in (ZERO_ORDER, LINEAR):
        shown = skew(position, replace(drive, hold=hold))
        if shown is not None:
            late[hold] = shown
    samples = {
        hold: (one.late_s * drive.rate_hz, one.standard_error_s * drive.rate_hz)
        for hold, one in late.items()
    }
    return Evidence(
        drive.axis, drive.kind, taken, told_by, _told_by_motion(late, samples), 1, samples
    )


def _told_by_motion(late: dict[str, Skew], samples: dict[str, tuple[float, float]]) -> str:
    """Return the way in which a drive is not late, if it is late the other way; '' if nothing tells."""
    if len(late) < 2:
        return ''
    right = [
        hold
        for hold, one in late.items()
        if not one.significant and abs(samples[hold][0]) < NEAR_SAMPLES
    ]
    wrong = [hold for hold, one in late.items() if one.significant]
    return right[0] if right and wrong else ''
