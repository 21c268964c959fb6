# SPDX-License-Identifier: Apache-2.0
"""
Do the signals of a log fit one another? A wrong unit, scale or sign rarely shows in one alone.

Nothing is changed here: a signal that does not fit stays as it is and is reported as suspect, with the
factor that is off, because only the user knows which of the two is wrong.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid

from waferbot_twin.logs.counting import AVERAGE
from waferbot_twin.logs.findings import Finding
from waferbot_twin.logs.measured import Signal
from waferbot_twin.logs.units import explain_factor

Array = NDArray[np.float64]

ALIKE = 0.9
"""Correlation above which two signals count as the same thing in other units."""

TOLERANCE = 0.1
"""Share by which a factor may miss 1 before it is reported."""

LATTICE = 0.9
"""Mean of the directions of values on a circle of one step, below which they are no multiples of it."""

SLOW_HZ, FAST_HZ = 1.0, 1e6
"""Sampling slower or faster than this is more likely a wrong unit of time."""

FAR = {'m': 100.0, 'rad': 1e6}
"""A path longer than this is more likely a wrong scale."""


def check_signals(signals: Iterable[Signal], peak_current: dict[str, float]) -> list[Finding]:
    """
    Return what looks wrong with signals, alone and beside each other.

    `peak_current` is what the drive of an axis can give (A), for those axes for which it is known.
    """
    by_axis: dict[str, dict[str, Signal]] = {}
    for signal in signals:
        by_axis.setdefault(signal.axis, {})[signal.kind] = signal
    findings = []
    for axis, of_kind in by_axis.items():
        for signal in of_kind.values():
            findings += _alone(signal, peak_current.get(axis))
        findings += _velocity(of_kind)
        findings += _following_error(of_kind)
        findings += _pair(of_kind, 'current', 'current_command')
        findings += _pair(of_kind, 'position', 'commanded_position')
    return findings


def _alone(signal: Signal, peak_current: float | None) -> list[Finding]:
    findings = []
    low, high = float(signal.value.min()), float(signal.value.max())
    if low == high and signal.kind not in ('commanded_position', 'temperature', 'voltage'):
        findings.append(
            Finding(
                signal.name, f'is {low:g} {signal.unit} throughout: it tells nothing', 'suspect'
            )
        )
    if not SLOW_HZ <= signal.rate_hz <= FAST_HZ and signal.kind != 'temperature':
        findings.append(
            Finding(
                signal.name,
                f'{signal.rate_hz:.4g} samples per second; is the unit of time right?',
                'suspect',
            )
        )
    limit = FAR.get(signal.unit)
    if limit and high - low > limit:
        reason = f'moves by {high - low:.4g} {signal.unit}; is the scale right?'
        findings.append(Finding(signal.name, reason, 'suspect'))
    if peak_current and signal.unit == 'A' and max(-low, high) > 1.2 * peak_current:
        reason = (
            f'reaches {max(-low, high):.4g} A, but the drive gives {peak_current:.4g} A at most; '
            'is the scale right?'
        )
        findings.append(Finding(signal.name, reason, 'suspect'))
    if signal.resolution > 0.0 and low != high and signal.counting != AVERAGE:
        # Direction of each value on a circle of one step; they agree if all sit on one lattice.
        turns = np.exp(2j * np.pi * (signal.value / signal.resolution))
        if abs(turns.mean()) < LATTICE and np.ptp(signal.value) < 1e9 * signal.resolution:
            reason = (
                f'its values are no multiples of its step, {signal.resolution:.4g} {signal.unit}'
            )
            findings.append(Finding(signal.name, reason, 'suspect'))
    return findings


def _velocity(of_kind: dict[str, Signal]) -> list[Finding]:
    """
    Compare velocity with position: integral of v = f * position + a + b t, f should be 1.

    The integral is far less noisy than a derivative; a + b t takes up start and offset.
    """
    velocity, position = of_kind.get('velocity'), of_kind.get('position')
    if velocity is None or position is None or len(velocity.time_s) < 16:
        return []
    time_s = velocity.time_s
    path = cumulative_trapezoid(velocity.value, time_s, initial=0.0)
    place, known = position.at(time_s)
    steady = np.column_stack([np.ones(len(time_s)), time_s])
    return _compare(path, place, known, steady, 'velocity', 'the rate of position', velocity)


def _following_error(of_kind: dict[str, Signal]) -> list[Finding]:
    """Compare following error with commanded minus actual position."""
    error = of_kind.get('following_error')
    command, position = of_kind.get('commanded_position'), of_kind.get('position')
    if error is None or command is None or position is None:
        return []
    commanded, known = command.at(error.time_s)
    actual, also = position.at(error.time_s)
    steady = np.ones((len(error.time_s), 1))
    what = 'commanded minus actual position'
    return _compare(
        error.value, commanded - actual, known & also, steady, 'following_error', what, error
    )


def _pair(of_kind: dict[str, Signal], kind: str, command_kind: str) -> list[Finding]:
    """Compare a measured signal with its command."""
    measured, command = of_kind.get(kind), of_kind.get(command_kind)
    if measured is None or command is None:
        return []
    commanded, known = command.at(measured.time_s)
    steady = np.ones((len(measured.time_s), 1))
    return _compare(
        measured.value, commanded, known, steady, kind, command_kind, measured, tolerance=0.25
    )


def _compare(
    one: Array,
    other: Array,
    known: NDArray[np.bool_],
    steady: Array,
    name: str,
    other_name: str,
    signal: Signal,
    tolerance: float = TOLERANCE,
) -> list[Finding]:
    """Fit one = f * other + what is steady; report f if both are alike and f is not 1."""
    if np.count_nonzero(known) < 16:
        return []
    one, other, steady = one[known], other[known], steady[known]
    one = one - steady @ np.linalg.lstsq(steady, one, rcond=None)[0]
    other = other - steady @ np.linalg.lstsq(steady, other, rcond=None)[0]
    norms = float(np.linalg.norm(one)), float(np.linalg.norm(other))
    # Two that stand still, or nearly so, say nothing about a factor.
    if min(norms) <= 1e-12 * max(norms) or max(norms) == 0.0:
        return []
    correlation = float(one @ other) / (norms[0] * norms[1])
    if abs(correlation) < ALIKE:
        return []
    factor = float(one @ other) / norms[1] ** 2
    if abs(factor - 1.0) <= tolerance:
        return []
    reason = f'{name} is {factor:.4g} times {other_name}{explain_factor(factor)}'
    return [Finding(signal.name, reason, 'suspect')]
