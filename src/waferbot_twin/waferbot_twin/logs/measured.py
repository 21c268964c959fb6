# SPDX-License-Identifier: Apache-2.0
"""A measured log: signals in SI units, each at its own times, with what was found wrong with them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from waferbot_lockstep.errors import UserError
from waferbot_twin.logs.findings import Finding
from waferbot_twin.logs.kinds import DRIVES, KINDS, axes_in_order
from waferbot_twin.logs.timebase import longest_step_s, median_step_s

Array = NDArray[np.float64]

ZERO_ORDER, LINEAR = 'zero_order', 'linear'
"""How a signal goes between samples: it stands until the next one, or goes straight to it."""

SNAP = 1e-6
"""Share of a step by which two times may differ and still be the same: rounding, not motion."""


@dataclass(frozen=True, eq=False)
class Signal:
    """
    One signal of one axis.

    `time_s` rises strictly and `value` is finite, in the SI unit `unit`; what each kind means is in
    `kinds.KINDS`. `resolution` is the smallest step that the value can make (one count), in `unit`; 0
    where it is not known. A place where the steps of time are longer than `gap_s` is a gap: nothing
    is known there.

    `hold` says how the signal goes between samples, '' where nobody says: then commands stand and the
    rest goes straight. `counting` says how a position became steps: `floor`, `round`, `average`, or ''
    where nobody knows; `half_step` is by how much its values are too low on average because of that,
    in `unit` (negative where a negative scale turns rounding down into rounding up).
    """

    kind: str
    axis: str
    unit: str
    time_s: Array
    value: Array
    resolution: float = 0.0
    hold: str = ''
    counting: str = ''
    half_step: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what is no signal; readers clean their data before they make one."""
        if not self.axis.isidentifier() or self.kind not in KINDS:
            raise ValueError(f'{self.axis}.{self.kind} is no signal')
        if self.time_s.shape != self.value.shape or self.time_s.ndim != 1:
            raise ValueError(f'{self.name}: times and values do not go together')
        if not (np.isfinite(self.time_s).all() and np.isfinite(self.value).all()):
            raise ValueError(f'{self.name}: not finite')
        if np.any(np.diff(self.time_s) <= 0.0):
            raise ValueError(f'{self.name}: time does not rise')

    @property
    def name(self) -> str:
        """Axis and kind, as `x_rotate.current`."""
        return f'{self.axis}.{self.kind}'

    @property
    def held(self) -> bool:
        """Whether a value stands until the next one."""
        return self.hold == ZERO_ORDER if self.hold else KINDS[self.kind].held

    @property
    def rate_hz(self) -> float:
        """One over the median step of time; 0 with fewer than two samples."""
        return 1.0 / median_step_s(self.time_s) if len(self.time_s) > 1 else 0.0

    @property
    def gap_s(self) -> float:
        """The longest step of time that is no gap, s."""
        return longest_step_s(self.time_s)

    def gaps(self) -> list[tuple[float, float]]:
        """Return begin and end of every gap, s."""
        after = np.flatnonzero(np.diff(self.time_s) > self.gap_s)
        return [(float(self.time_s[row]), float(self.time_s[row + 1])) for row in after]

    def at(self, time_s: Array) -> tuple[Array, NDArray[np.bool_]]:
        """
        Return the values at other times, and where they are known.

        Held signals stand until their next sample, the others are interpolated linearly. Before
        the first sample, behind the last one (a held one stands for one more usual step) and inside
        gaps nothing is known: NaN. No value is made up there.
        """
        if len(self.time_s) == 0:
            return np.full(len(time_s), np.nan), np.zeros(len(time_s), bool)
        usual_s = median_step_s(self.time_s) if len(self.time_s) > 1 else 0.0
        time_s = _snapped(np.asarray(time_s, np.float64), self.time_s, SNAP * usual_s)
        row = np.searchsorted(self.time_s, time_s, side='right') - 1
        held = np.clip(row, 0, None)
        if self.held:
            value = self.value[held]
            last = time_s < self.time_s[-1] + (1.0 - SNAP) * usual_s
        else:
            value = np.interp(time_s, self.time_s, self.value)
            last = time_s <= self.time_s[-1]
        steps_s = np.append(np.diff(self.time_s), 0.0)[held]
        on_sample = self.time_s[held] == time_s
        known = (row >= 0) & last & ((steps_s <= self.gap_s) | on_sample)
        return np.where(known, value, np.nan), known

    def means(self, edges_s: Array) -> Array:
        """
        Return the mean value (n,) between each two of some times (n + 1,), NaN where it is not known.

        Of one that goes straight from sample to sample it is the value in the middle.
        """
        middle, known = self.at(0.5 * (edges_s[1:] + edges_s[:-1]))
        if not self.held or len(self.time_s) < 2:
            return middle
        whole = np.concatenate([[0.0], np.cumsum(self.value[:-1] * np.diff(self.time_s))])
        area = np.diff(np.interp(edges_s, self.time_s, whole))
        inside = known & (edges_s[:-1] >= self.time_s[0]) & (edges_s[1:] <= self.time_s[-1])
        return np.where(inside, area / np.diff(edges_s), middle)


@dataclass(frozen=True, eq=False)
class Grid:
    """Signals at common, evenly spaced times; `valid` says where each is known, else it is NaN."""

    time_s: Array
    value: Mapping[tuple[str, str], Array]
    valid: Mapping[tuple[str, str], NDArray[np.bool_]]

    def all_valid(self, keys: Iterable[tuple[str, str]] | None = None) -> NDArray[np.bool_]:
        """Return where all the named signals (axis, kind) are known; all of them by default."""
        masks = [self.valid[key] for key in (self.valid if keys is None else keys)]
        return np.logical_and.reduce(masks) if masks else np.ones(len(self.time_s), bool)


@dataclass(frozen=True, eq=False)
class MeasuredLog:
    """
    Everything that came out of one log.

    `signals` are in a fixed order (axis, then kind), at most one of each. `findings` tell what was
    left out, put in order or looks wrong. `source` is the name of the file or folder, `digest` its
    SHA-256, `mapping` the text of the mapping file, if one was used. `origin_ns` is the instant of
    time zero on the clock of the source (nanoseconds since its epoch), 0 if it has none.
    """

    name: str
    signals: tuple[Signal, ...]
    findings: tuple[Finding, ...] = ()
    source: str = ''
    digest: str = ''
    mapping: str = ''
    origin_ns: int = 0
    _by_key: dict[tuple[str, str], Signal] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        """Put the signals in order; refuse two of the same axis and kind."""
        axes, kinds = axes_in_order(signal.axis for signal in self.signals), list(KINDS)
        ordered = sorted(
            self.signals, key=lambda one: (axes.index(one.axis), kinds.index(one.kind))
        )
        object.__setattr__(self, 'signals', tuple(ordered))
        self._by_key.clear()
        for signal in ordered:
            if (signal.axis, signal.kind) in self._by_key:
                raise UserError(f'{self.name}: {signal.name} is given twice')
            self._by_key[signal.axis, signal.kind] = signal

    def get(self, axis: str, kind: str) -> Signal | None:
        """Return a signal, or None if the log does not have it."""
        return self._by_key.get((axis, kind))

    def __getitem__(self, key: tuple[str, str]) -> Signal:
        """Return the signal of (axis, kind); raises `UserError` if the log does not have it."""
        if key not in self._by_key:
            raise UserError(f'{self.name}: there is no {key[1]} of {key[0]}')
        return self._by_key[key]

    def with_signal(self, signal: Signal) -> MeasuredLog:
        """Return the log with a signal in place of its own one of that axis and kind."""
        kept = [one for one in self.signals if (one.axis, one.kind) != (signal.axis, signal.kind)]
        return replace(self, signals=(*kept, signal))

    def axes(self) -> tuple[str, ...]:
        """Return the axes of which there is anything."""
        return axes_in_order(axis for axis, _ in self._by_key)

    def usable_axes(self) -> tuple[str, ...]:
        """Return the axes with the least that a diagnosis needs: position and what drives it."""
        return tuple(
            axis
            for axis in self.axes()
            if self.get(axis, 'position') and any(self.get(axis, kind) for kind in DRIVES)
        )

    def on_grid(
        self, rate_hz: float, start_s: float | None = None, end_s: float | None = None
    ) -> Grid:
        """
        Return all signals at the whole multiples of 1 / `rate_hz` from `start_s` to `end_s`.

        By default that is from the first sample of any signal to the last; where a signal is not
        known, its mask is False. See `Signal.at` for what happens between samples.
        """
        if not rate_hz > 0.0:
            raise UserError(f'rate is {rate_hz} Hz; it must be positive')
        begins = [signal.time_s[0] for signal in self.signals if len(signal.time_s)]
        ends = [signal.time_s[-1] for signal in self.signals if len(signal.time_s)]
        if not begins:
            return Grid(np.zeros(0), {}, {})
        # A time that misses a multiple by rounding only belongs to it.
        first = np.ceil((min(begins) if start_s is None else start_s) * rate_hz - SNAP)
        last = np.floor((max(ends) if end_s is None else end_s) * rate_hz + SNAP)
        time_s = np.arange(first, last + 1.0) / rate_hz
        sampled = {key: signal.at(time_s) for key, signal in self._by_key.items()}
        return Grid(
            time_s,
            {key: value for key, (value, _) in sampled.items()},
            {key: known for key, (_, known) in sampled.items()},
        )

    def describe(self) -> dict[str, Any]:
        """Return what the log holds as plain values, for tables and JSON."""
        return {
            'name': self.name,
            'source': self.source,
            'digest': self.digest,
            'origin_ns': self.origin_ns,
            'usable_axes': list(self.usable_axes()),
            'signals': [
                {
                    'axis': signal.axis,
                    'kind': signal.kind,
                    'unit': signal.unit,
                    'samples': len(signal.time_s),
                    'rate_hz': signal.rate_hz,
                    'start_s': float(signal.time_s[0]),
                    'end_s': float(signal.time_s[-1]),
                    'lowest': float(signal.value.min()),
                    'highest': float(signal.value.max()),
                    'resolution': signal.resolution,
                    'hold': signal.hold,
                    'held': signal.held,
                    'counting': signal.counting,
                    'half_step': signal.half_step,
                    'gaps': len(signal.gaps()),
                }
                for signal in self.signals
            ],
            'findings': [
                {'place': finding.place, 'reason': finding.reason, 'action': finding.action}
                for finding in self.findings
            ],
        }


def _snapped(time_s: Array, samples_s: Array, within_s: float) -> Array:
    """Return times, those that miss a sample by no more than `within_s` moved onto it."""
    after = np.clip(np.searchsorted(samples_s, time_s), 0, len(samples_s) - 1)
    before = np.maximum(after - 1, 0)
    nearer = np.abs(samples_s[before] - time_s) < np.abs(samples_s[after] - time_s)
    nearest = samples_s[np.where(nearer, before, after)]
    return np.where(np.abs(nearest - time_s) <= within_s, nearest, time_s)
