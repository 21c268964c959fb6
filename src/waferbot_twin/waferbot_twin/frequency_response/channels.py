# SPDX-License-Identifier: Apache-2.0
"""
Input, output and reference of a frequency response, taken from a measured log.

A channel is a signal of the log (`logs.kinds`), or one of

    acceleration, velocity    from position
    force                     from current, by the force constant of the model, where the log has none

Positions are taken as their second difference, -c P with c = (2 - 2 cos w h) / h^2 at the sampling
time h, which flattens their spectra so that little leaks from low frequencies; the response is put
right by the exact factor afterwards, 1 / -c for a position, w^2 / c for an acceleration, -j w / c for a
velocity.

A command is held; it counts at the middle of its hold, so that a held command and a mean over the same
cycle (which `current` is in recordings of the twin's topics) stand at the same time, to half a tick.
Such a mean is smaller than what it is of by sin(x) / x, x = pi f / 2250 Hz: 3 % at 300 Hz, in
measurement and simulation alike.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.parameters import did_you_mean
from waferbot_twin.effects.places import force_per_ampere, motor_axes
from waferbot_twin.effects.variant import Variant
from waferbot_twin.frequency_response.estimate import Array, ComplexArray, Run
from waferbot_twin.logs.kinds import KINDS, UNITS, axes_in_order, is_linear
from waferbot_twin.logs.measured import MeasuredLog, Signal
from waferbot_twin.logs.pauses import with_short_pauses
from waferbot_twin.logs.timebase import median_step_s

DERIVED = {'acceleration': '/s2', 'velocity': '/s'}
"""What is derived from position, and what that adds to its unit."""

TWICE_DIFFERENCED = (
    'position', 'motor_position', 'commanded_position', 'following_error', *DERIVED,
)  # fmt: skip

FEWEST_SAMPLES = 64


@dataclass(frozen=True)
class Channel:
    """A signal of an axis, or what is derived from it."""

    axis: str
    kind: str

    @property
    def name(self) -> str:
        """Axis and kind, as `x_rotate.current`."""
        return f'{self.axis}.{self.kind}'

    def unit(self, linear: bool) -> str:
        """Return the SI unit on an axis that slides or turns."""
        if self.kind in DERIVED:
            return UNITS[KINDS['position'].quantity(linear)] + DERIVED[self.kind]
        return UNITS[KINDS[self.kind].quantity(linear)]

    def factor(self, frequency_hz: Array, step_s: float) -> ComplexArray:
        """Return by what the spectrum of `sampled` must be multiplied to be that of the channel."""
        omega = 2.0 * np.pi * frequency_hz
        curvature = (2.0 - 2.0 * np.cos(omega * step_s)) / step_s**2
        if self.kind == 'acceleration':
            return (omega**2 / curvature).astype(np.complex128)
        if self.kind == 'velocity':
            return np.asarray(-1j * omega / curvature, np.complex128)
        if self.kind in TWICE_DIFFERENCED:
            return (-1.0 / curvature).astype(np.complex128)
        return np.ones(len(frequency_hz), np.complex128)


RESPONSES = {
    'plant': ('force', 'acceleration'),
    'loop': ('commanded_position', 'position'),
    'drive': ('current_command', 'current'),
}
"""Responses by name: from which channel to which."""


def parse_channel(text: str, axis: str, axes: Sequence[str]) -> Channel:
    """Read `KIND` or `AXIS.KIND` of these axes; raises `UserError` for what is no channel."""
    first, dot, last = text.rpartition('.')
    kinds = (*KINDS, 'acceleration')
    if dot and first not in axes:
        raise UserError(f'{text}: no axis {first!r}{did_you_mean(first, axes)}')
    if last not in kinds:
        raise UserError(
            f'{text}: no signal {last!r}{did_you_mean(last, kinds)} (signals: {", ".join(kinds)})'
        )
    return Channel(first if dot else axis, last)


def moving_axis(logs: Iterable[MeasuredLog]) -> str:
    """
    Return the one axis that is commanded to move, or the only one that there is.

    Raises `UserError` if there are several.
    """
    logs = list(logs)
    axes = axes_in_order(axis for log in logs for axis in log.axes())
    moved = [
        axis
        for axis in axes
        if any(
            (signal := log.get(axis, 'commanded_position')) is not None
            and np.ptp(signal.value) > 0.0
            for log in logs
        )
    ]
    candidates = moved or [axis for axis in axes if any(axis in log.usable_axes() for log in logs)]
    if len(candidates) == 1:
        return candidates[0]
    found = ', '.join(candidates) or 'none'
    raise UserError(f'give --axis: which axis was excited is not plain (candidates: {found})')


def run_of(log: MeasuredLog, channels: tuple[Channel, Channel], variant: Variant | None) -> Run:
    """
    Return input and output on common, even times, with the commanded position of the input's axis.

    The times are those of the slower signal, their longest stretch without a gap. Without `variant`
    there is no force from current. Raises `UserError` if a signal lacks.
    """
    source, target = (_signal(log, channel, variant) for channel in channels)
    commanded = log.get(channels[0].axis, 'commanded_position')
    step_s = max(median_step_s(signal.time_s) for signal in (source, target))
    there = [signal for signal in (source, target, commanded) if signal is not None]
    signals, _ = with_short_pauses(there, step_s)
    slower = max(signals[:2], key=lambda signal: median_step_s(signal.time_s))
    count = int(np.floor((slower.time_s[-1] - slower.time_s[0]) / step_s + 0.5)) + 1
    middle_s = 0.5 * step_s if slower.held else 0.0
    time_s = slower.time_s[0] + middle_s + step_s * np.arange(count)
    values = [signal.at(time_s)[0] for signal in signals]
    known = np.isfinite(values).all(axis=0)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], known.astype(int), [0]])))
    stretches = list(zip(edges[::2], edges[1::2], strict=True))
    first, last = max(stretches, key=lambda pair: pair[1] - pair[0], default=(0, 0))
    if last - first < FEWEST_SAMPLES:
        raise UserError(
            f'{log.name}: {" and ".join(signal.name for signal in signals)} have no '
            f'{FEWEST_SAMPLES} samples in common without a gap'
        )
    kinds = [channel.kind for channel in channels] + ['commanded_position']
    sampled = [
        _second_difference(value[first:last], step_s)
        if kind in TWICE_DIFFERENCED
        else value[first + 1 : last - 1]
        for value, kind in zip(values, kinds, strict=False)
    ]
    return Run(step_s, sampled[0], sampled[1], sampled[2] if commanded is not None else None)


def _signal(log: MeasuredLog, channel: Channel, variant: Variant | None) -> Signal:
    """Return the signal that a channel is made of; raises `UserError` if the log lacks it."""
    kind = 'position' if channel.kind in DERIVED else channel.kind
    if kind == 'force' and log.get(channel.axis, 'force') is None and variant is not None:
        if channel.axis not in motor_axes(variant):
            raise UserError(f'model {variant.name} has no motor on {channel.axis}')
        current = log[channel.axis, 'current']
        return replace(current, value=current.value * force_per_ampere(variant, channel.axis))
    return log[channel.axis, kind]


def _second_difference(value: Array, step_s: float) -> Array:
    return np.diff(value, 2) / step_s**2


def unit_of(channels: tuple[Channel, Channel], variant: Variant | None) -> str:
    """Return the unit of the response from one channel to the other."""
    linear = None
    if variant is not None:
        description = variant.description
        linear = {axis: not description.turns(axis) for axis in description.axes}
    source, target = (channel.unit(is_linear(channel.axis, linear)) for channel in channels)
    return '1' if source == target else f'({target})/({source})'
