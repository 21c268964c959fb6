# SPDX-License-Identifier: Apache-2.0
"""A measured log laid on the ticks of the twin: what the blocks are replayed with."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from waferbot_lockstep.layout import SHIPPED, Layout
from waferbot_lockstep.timing import Timing
from waferbot_twin.residuals.drive_path import DrivePath

Array = NDArray[np.float64]

FIRST_READINGS = 40
"""Readings at most that tell how a log begins."""

STANDS_STEPS = 3.0
"""What goes by less than so many steps of its encoder then stands."""


@dataclass(frozen=True)
class Terminals:
    """
    What was measured at the amplifiers' terminals, at every tick.

    current  (ticks, 2 axes) A, lines 1 and 2 of each motor as the current sensors showed them at the
    tick voltage  (ticks, 3 axes) V, terminals 1, 2, 3 of each motor over the tick, or None off
    (ticks,) bit i set: the bridge of axis i is off, its terminals are open
    """

    current: Array
    voltage: Array | None
    off: NDArray[np.uint8]

    def part(self, ticks: slice) -> Terminals:
        """Return a stretch of ticks."""
        voltage = None if self.voltage is None else self.voltage[ticks]
        return Terminals(self.current[ticks], voltage, self.off[ticks])


@dataclass(frozen=True)
class Record:
    """
    One log.

    line_current  (ticks, 2 axes) A, lines 1 and 2 of each motor as measured, mean over each tick; NaN
                  for a motor of which nothing is known
    reading       (rows, encoders) counts as published at encoder ticks, NaN where missing
    commanded     (cycles, axes) counts, commanded position at servo ticks, NaN for an axis of which it
    is
                  not known; or None
    command       (cycles, axes) A, current command at servo ticks, likewise
    terminals     what was measured at the amplifiers' terminals, or None

    current       (ticks, axes) A, the part of each motor's current that makes force, mean over each
                  tick; it drives motors whose line currents are not known; NaN or None where that is
                  neither
    path          what is open of that between the samples of an imported log, or None
    late_s        (rows, encoders) s, how much after the tick of its row a reading was taken; None: not
                  at all
    resolution    smallest step of each encoder's readings, counts
    half_step     counts that were added to what each encoder published, so that readings are right on
                  average: half a step of those that an imported log has rounded down
    counted       whether each encoder's readings are whole steps of its resolution
    controlled    the axes whose controller the model knows
    force_driven  the axes whose force was logged, and no current
    told_alone    the axes of which the log has what the drive was told or reckons, a force or a command,
                  and no measured current
    skew_spread_s standard deviation of what is not known of the time of each axis' drive against its
                  position, s: 0 where a log has the same clock for both, and every tick
    observer_hz   with which frequency each encoder is followed (`plant_block`), where that was found in
                  the log (`observer_bandwidth`); None where not
    notes         what a reader of the results should know of the log
    log           name of the log that it is a part of; empty of a whole one
    layout        the axes and encoders of the machine, in the order of the columns

    `whole_counts` tells whether readings are the whole counts that the controller saw. A log need not
    have a reading in every row: `late_s` and gaps of NaN keep the times at which it was really measured.
    What lies before `judged_from_s` is simulated, so that the machine is in the state that it had by
    then, but not judged.

    That a log tells what was commanded does not mean that anything is known of the controller. Ask
    `has_commanded` (does what is left over follow the command?), `has_controller` (can controllers be
    replayed alone?) or `closes_loop` (can the model do what the machine was told to do?).
    """

    name: str
    timing: Timing
    line_current: Array
    reading: Array
    commanded: Array | None
    command: Array | None
    whole_counts: bool = True
    terminals: Terminals | None = None
    judged_from_s: float = 0.0
    current: Array | None = None
    path: DrivePath | None = None
    late_s: Array | None = None
    resolution: tuple[float, ...] = (1.0,) * len(SHIPPED.encoders)
    half_step: tuple[float, ...] = (0.0,) * len(SHIPPED.encoders)
    counted: tuple[bool, ...] = (True,) * len(SHIPPED.encoders)
    controlled: tuple[str, ...] = SHIPPED.axes
    force_driven: tuple[str, ...] = ()
    told_alone: tuple[str, ...] = ()
    skew_spread_s: tuple[float, ...] = (0.0,) * len(SHIPPED.axes)
    observer_hz: tuple[float, ...] | None = None
    notes: tuple[str, ...] = ()
    log: str = ''
    layout: Layout = SHIPPED

    @property
    def is_imported(self) -> bool:
        """Whether it is of a log that was imported, with times and units of its own."""
        return self.current is not None

    @property
    def has_commanded(self) -> bool:
        """Whether the log tells what any axis was commanded."""
        return self.commanded is not None

    def path_commanded(self, axis: str) -> Array | None:
        """Return what an axis was commanded at servo ticks (cycles,), counts; None if unknown."""
        if self.commanded is None:
            return None
        path = self.commanded[:, self.layout.place(axis)]
        return path if np.isfinite(path).all() else None

    @property
    def has_controller(self) -> bool:
        """Whether the log has what a known controller was given and what it made of it."""
        return self.commanded is not None and self.command is not None and bool(self.controlled)

    @property
    def closes_loop(self) -> bool:
        """Whether every axis that the log shows was commanded, by a controller that is known."""
        if self.commanded is None:
            return False
        axes = {
            self.layout.axis_of(name)
            for place, name in enumerate(self.layout.encoders)
            if np.isfinite(self.reading[:, place]).any()
        }
        return axes <= set(self.controlled)

    @property
    def ticks(self) -> int:
        """How many ticks of the current loop the log has."""
        return len(self.line_current)

    @property
    def duration_s(self) -> float:
        """How long the log is, s."""
        return self.timing.seconds(self.ticks)

    def first_motion(self, place: int, within_s: float, degree: int = 1) -> tuple[float, float]:
        """
        Return position (counts) and speed (counts/s) of an encoder when the log begins.

        By a polynomial through the readings of so long, at most `FIRST_READINGS`; what does not go by
        some steps stands.
        """
        reading = self.reading[:, place]
        step_s = self.timing.encoder_divider * self.timing.tick_s
        rows = np.flatnonzero(np.isfinite(reading))
        few = rows[rows - rows[0] < self.timing.encoder_hz * within_s][:FIRST_READINGS]
        if len(few) <= degree:
            return float(reading[rows[0]]), 0.0
        *_, slope, start = np.polyfit(few * step_s, reading[few], degree)
        travel = abs(slope) * (few[-1] - few[0]) * step_s
        if degree > 1:
            travel = float(np.ptp(reading[few]))
        if travel < STANDS_STEPS * self.resolution[place]:
            return float(np.mean(reading[few])), 0.0
        return float(start), float(slope)

    def with_encoder_ticks(self) -> Record:
        """
        Return the record with ticks as long as the encoders' cycle and the mean current of each.

        Without what was measured at the terminals, which is of the shorter ticks.
        """
        timing, times = self.timing, self.timing.encoder_divider
        longer = Timing(timing.current_loop_hz // times, 1, timing.servo_divider // times)
        return replace(
            self,
            timing=longer,
            line_current=_means(self.line_current, times),
            current=None if self.current is None else _means(self.current, times),
            path=None if self.path is None else self.path.in_longer_ticks(times),
            terminals=None,
        )

    def part(self, first_s: float, last_s: float, begin_s: float = 0.0) -> Record:
        """
        Return the record from `begin_s` to a time, of which only what lies between two times is judged.

        It begins with a cycle of the servo, and as the log does by then: in motion, if the axes moved.
        """
        timing = self.timing
        before = math.floor(begin_s * timing.servo_hz)
        cycles = slice(before, round(last_s * timing.servo_hz))
        ticks = slice(before * timing.servo_divider, cycles.stop * timing.servo_divider)
        rows = slice(ticks.start // timing.encoder_divider, ticks.stop // timing.encoder_divider)
        return replace(
            self,
            name=f'{self.log or self.name} {first_s:.2f} to {last_s:.2f} s',
            log=self.log or self.name,
            line_current=self.line_current[ticks],
            reading=self.reading[rows],
            commanded=None if self.commanded is None else self.commanded[cycles],
            command=None if self.command is None else self.command[cycles],
            terminals=None if self.terminals is None else self.terminals.part(ticks),
            judged_from_s=first_s - before / timing.servo_hz,
            current=None if self.current is None else self.current[ticks],
            path=None if self.path is None else self.path.part(ticks),
            late_s=None if self.late_s is None else self.late_s[rows],
        )


def read_exactly(layout: Layout) -> dict[str, Any]:
    """
    Return what a `Record` of the twin's own signals says of how it was read, for a machine's places.

    In whole counts, with every axis' controller known, and one clock for all.
    """
    encoders = len(layout.encoders)
    return {
        'resolution': (1.0,) * encoders,
        'half_step': (0.0,) * encoders,
        'counted': (True,) * encoders,
        'controlled': layout.axes,
        'skew_spread_s': (0.0,) * len(layout.axes),
        'layout': layout,
    }


def _means(values: Array, times: int) -> Array:
    """Return the mean of every so many rows of (n, k)."""
    whole = len(values) // times * times
    return np.asarray(values[:whole].reshape(-1, times, values.shape[1]).mean(axis=1))


def common_step(readings: Array) -> int:
    """
    Return the step of which all changes of an encoder's readings (n,) are multiples, counts.

    0 where readings are no whole counts, or never change.
    """
    changes = np.diff(readings[np.isfinite(readings)])
    if np.any(changes % 1.0 != 0.0):
        return 0
    return int(np.gcd.reduce(changes.astype(np.int64)))


def mean_over_ticks(current: Array) -> Array:
    """Return the mean of each tick's current, from the values at its beginning and end."""
    return 0.5 * (current + np.vstack([current[1:], current[-1:]]))
