# SPDX-License-Identifier: Apache-2.0
"""
A described controller alone: given measured and commanded positions, what is left of its output.

Residual is the measured drive signal less what the law computes (`controllers.law`), A of the motor. The
law is exact, but what a log says the controller saw is not always what it saw: counts that it
differentiates, rounding of the log, a position between two samples. So, unlike with the servo of a
PMAC, noise is left over, and is coloured.

How full an integrator was when the log began is not known: it begins such that nothing is left over on
average. Whether a log shows an output when it is computed or when it goes out, a computation delay
later, differs from logger to logger: the delay, in whole cycles, is that of the two which leaves less
over.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from waferbot_twin.controllers import law
from waferbot_twin.effects import places
from waferbot_twin.effects.variant import Variant
from waferbot_twin.noise_model.prediction_error import Noise, freedom_of
from waferbot_twin.residuals.record import Array, Record

FLOOR_STEPS = 0.05
"""Smallest standard deviation of the residual, in what a step of the encoder makes of the output."""

LEAST_CYCLES = 40
"""An axis with fewer cycles than this is not looked at."""

NEAR = 0.25
"""
A sample is what the controller saw in a cycle if it is so near, in cycles, whatever its time was rounded
to. A faster log has others, too: there what it saw lies between two samples.
"""

FASTER = 0.6
"""Cycles from sample to sample up to which a log is faster than the controller."""

SPARSE = 1.5
"""Cycles from sample to sample of a log that is too slow to tell what a controller saw."""

PASSES = 2
"""How often an integrator's beginning is corrected; more than once where an output was limited."""

SETTLING_CYCLES = 20
"""Cycles that are left out at the beginning of a log and behind a gap: filters forget."""


class DescribedControllerBlock:
    """The residual of the described controllers of one log, for any variant of the model."""

    order = 8
    """Steps of an encoder, differentiated and filtered."""

    def __init__(self, record: Record, variant: Variant) -> None:
        """Prepare what does not depend on the values of the model."""
        assert record.commanded is not None
        assert record.command is not None
        self.record = record
        per_unit = places.counts_per_unit(variant)
        self._encoders = places.encoder_places(variant)
        self._hz = record.timing.servo_hz
        cycles = len(record.command)
        self._commanded = record.commanded / per_unit
        self._position = np.full((cycles, len(record.layout.axes)), np.nan)
        self._axes: list[int] = []
        self._judged: dict[int, NDArray[np.intp]] = {}
        for axis in places.described_axes(variant):
            place = record.layout.place(axis)
            seen = self._seen(place, variant)
            self._position[:, place] = seen / per_unit[place]
            judged = self._cycles_to_judge(place, variant)
            if axis in record.controlled and len(judged) >= LEAST_CYCLES:
                self._axes.append(place)
                self._judged[place] = judged
        self.channels = [record.layout.axes[place] for place in self._axes]
        self._late = dict.fromkeys(self._axes, 0)
        for place in self._axes:
            self._late[place] = self._shown_late(place, variant)
        freedom = freedom_of(record.duration_s)
        self.noises = [
            Noise(self._floor(place, variant), self.order, freedom=freedom) for place in self._axes
        ]

    def times_s(self, channel: str) -> Array:
        """Return the time of every sample of a channel's residual, s from the log's beginning."""
        return np.asarray(self._judged[self.record.layout.place(channel)] / self._hz)

    def residuals(self, variant: Variant) -> list[Array]:
        """Return measured less computed output of every controlled axis, A."""
        return [self._left(place, variant, self._late[place])[0] for place in self._axes]

    def first_integral(self, variant: Variant) -> Array:
        """Return what integrators (axes,) made of the outputs when the log began, A."""
        found = np.zeros(len(self.record.layout.axes))
        for place in self._axes:
            _, found[place] = self._left(place, variant, self._late[place])
        return found

    def _left(self, place: int, variant: Variant, late: int) -> tuple[Array, float]:
        """
        Return what is left of an axis' output, and what its integrator made of it at the beginning, A.

        The log shows outputs so many cycles late.
        """
        assert self.record.command is not None
        amperes = places.amperes_per_output(variant, self.record.layout.axes[place])
        judged = self._judged[place]
        measured = self.record.command[judged, place] / amperes
        integral = 0.0
        left = measured - self._computed(place, variant, integral)[judged - late]
        if variant.description.controllers[self.record.layout.axes[place]].integrates:
            for _ in range(PASSES):
                integral += float(np.mean(left))
                left = measured - self._computed(place, variant, integral)[judged - late]
        return np.asarray(left * amperes), integral * amperes

    def _computed(self, place: int, variant: Variant, integral: float) -> Array:
        """Return the output of an axis' controller at every cycle, in its unit."""
        commanded, position = (
            _without_gaps(signal) for signal in (self._commanded, self._position)
        )
        velocity, integrals = (
            np.zeros(len(self.record.layout.axes)),
            np.zeros(len(self.record.layout.axes)),
        )
        integrals[place] = integral
        first = min(len(position), SETTLING_CYCLES)
        velocity[place] = (
            (position[first - 1, place] - position[0, place]) * self._hz / (first - 1)
        )
        computed = np.zeros_like(position)
        laws = law.law_parameters(variant.description.controllers, self.record.layout.axes)
        law.replay(
            law.initial_state(laws),
            laws,
            commanded,
            position,
            velocity,
            integrals,
            computed,
        )
        return computed[:, place]

    def _seen(self, place: int, variant: Variant) -> Array:
        """Return the counts (cycles,) that the controller saw, NaN where the log does not tell."""
        record, timing = self.record, self.record.timing
        encoder = self._encoders[place]
        reading = record.reading[:, encoder]
        rows = np.flatnonzero(np.isfinite(reading))
        cycles = np.arange(len(self._position))
        if len(rows) < LEAST_CYCLES:
            return np.full(len(cycles), np.nan)
        # At a row stands what was read when the controller saw it, plus what the model's encoders take.
        row_s = timing.encoder_divider * timing.tick_s
        taken_s = (rows - variant.description.encoder_delay) * row_s
        if record.late_s is not None:
            taken_s = taken_s + record.late_s[rows, encoder]
        counts = reading[rows] - record.half_step[encoder]
        at = taken_s * self._hz
        nearest = np.clip(np.searchsorted(at, cycles), 1, len(at) - 1)
        nearest -= cycles - at[nearest - 1] < at[nearest] - cycles
        near = NEAR if np.median(np.diff(at)) > FASTER else 0.0
        own = np.abs(at[nearest] - cycles) < near
        found = np.where(own, counts[nearest], np.interp(cycles, at, counts))
        after = np.clip(np.searchsorted(at, cycles + near), 1, len(at) - 1)
        sparse = (at[after] - at[after - 1] > SPARSE) & ~own
        outside = (cycles < at[0] - NEAR) | (cycles > at[-1] + NEAR)
        return np.where(sparse | outside, np.nan, found)

    def _cycles_to_judge(self, place: int, variant: Variant) -> NDArray[np.intp]:
        """Return the cycles of an axis' controller in which all that it takes is known."""
        assert self.record.command is not None
        known = np.isfinite(self._position[:, place]) & np.isfinite(self._commanded[:, place])
        known &= np.isfinite(self.record.command[:, place])
        unknown = np.flatnonzero(~known)
        begins = np.concatenate([[-1], unknown])
        cycles = np.arange(len(known))
        since = cycles - begins[np.searchsorted(begins, cycles, side='right') - 1]
        controllers = variant.description.controllers
        every = round(law.cycle_hz(controllers) / controllers[self.record.layout.axes[place]].rate)
        first = round(self.record.judged_from_s * self._hz)
        use = known & (since > SETTLING_CYCLES) & (cycles >= first) & (cycles % every == 0)
        return np.flatnonzero(use)

    def _shown_late(self, place: int, variant: Variant) -> int:
        """Return how many cycles later than it is computed an output stands in the log."""
        controllers = variant.description.controllers
        delay = controllers[self.record.layout.axes[place]].delay * self._hz
        whole = int(np.ceil(delay - 1e-6))
        spread = [
            (float(np.std(self._left(place, variant, late)[0])), late)
            for late in sorted({0, min(whole, SETTLING_CYCLES)})
        ]
        return min(spread)[1]

    def _floor(self, place: int, variant: Variant) -> float:
        """Return the smallest standard deviation of an axis' residual, A."""
        controller = variant.description.controllers[self.record.layout.axes[place]]
        step = self.record.resolution[self._encoders[place]] / abs(
            places.counts_per_unit(variant)[place]
        )
        gain = controller.proportional + controller.velocity_gain * controller.position_gain
        rates = controller.derivative + controller.velocity_gain
        of_step = step * (gain + rates * controller.rate)
        return (
            FLOOR_STEPS
            * of_step
            * places.amperes_per_output(variant, self.record.layout.axes[place])
        )


def _without_gaps(signal: Array) -> Array:
    """Return signals (n, k) with what is unknown taken straight from what is known; 0 if nothing is."""
    filled = np.zeros_like(signal)
    rows = np.arange(len(signal))
    for place, column in enumerate(signal.T):
        known = np.flatnonzero(np.isfinite(column))
        if len(known):
            filled[:, place] = np.interp(rows, known, column[known])
    return filled
