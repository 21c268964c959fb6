# SPDX-License-Identifier: Apache-2.0
"""
The loop of one axis, opened at its current command, with the loops of the other axes closed.

With G(z) the plant as the servo sees it (counts over currents, `SampledPlant`) and K(z) the servo
(currents over counts, `ServoLaw`, the minus of the feedback in it), P = K G is a matrix of the axes,
and with i the axis and o the others

    L_i = -(P_ii + P_io (1 - P_oo)^-1 P_oi)        closed: L_i / (1 + L_i)

both at z = exp(2 pi i f Ts), up to half of the servo rate: sampling, hold and delays are in it as they
are in the controller. An axis' loop counts as stable if closing it leaves no mode growing which the
others do not leave growing without it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from waferbot_lockstep.layout import Layout
from waferbot_lockstep.timing import Timing
from waferbot_plant.plant import Machine
from waferbot_twin import closed_loop
from waferbot_twin.closed_loop import Matrix, SampledPlant, ServoLaw, closed
from waferbot_twin.tuning.margins import Array, ComplexArray, Margins, margins

LOWEST_HZ = 0.2
POINTS = 1500
"""Of the grid of frequencies, besides those around the modes of the machine."""

AROUND = np.concatenate([-np.geomspace(40.0, 0.05, 16), [0.0], np.geomspace(0.05, 40.0, 16)])
"""Points around a mode, in half-widths of its resonance."""

NARROW = 0.2
"""Damping ratio below which a mode gets points of its own."""

MARGINAL = 1e-6
"""How far outside the unit circle rounding may put an eigenvalue that is on it."""


@dataclass(frozen=True, eq=False)
class Linearised:
    """A machine at a pose, linearised: its name, the pose (m, rad), and what the servo sees of it."""

    name: str
    pose: Mapping[str, float]
    plant: SampledPlant
    timing: Timing
    layout: Layout

    @classmethod
    def of(
        cls, name: str, machine: Machine, pose: Mapping[str, float], timing: Timing
    ) -> Linearised:
        """Linearise a machine at a pose; raises `UserError`."""
        plant = closed_loop.sampled_plant(machine, timing, pose)
        return cls(name, dict(pose), plant, timing, machine.layout)

    @cached_property
    def frequency_hz(self) -> Array:
        """The grid, Hz: logarithmic up to half of the servo rate, and dense around the modes."""
        nyquist_hz = 0.5 * self.timing.servo_hz
        grid = np.geomspace(LOWEST_HZ, 0.9999 * nyquist_hz, POINTS)
        eigenvalues = np.linalg.eigvals(self.plant.state)
        poles = (
            np.log(eigenvalues[np.abs(eigenvalues) > 1e-6].astype(complex)) * self.timing.servo_hz
        )
        modes = poles[(poles.imag > 0.0) & (-poles.real < NARROW * np.abs(poles))]
        near = (modes.imag[:, None] + np.maximum(-modes.real, 1e-3)[:, None] * AROUND) / (
            2.0 * np.pi
        )
        near = near[(near > LOWEST_HZ) & (near < 0.9999 * nyquist_hz)]
        return np.unique(np.concatenate([grid, near]))

    @cached_property
    def _counts_over_current(self) -> ComplexArray:
        return self.counts_over_current(self.frequency_hz)

    @cached_property
    def _counts_at_nyquist(self) -> ComplexArray:
        return self.counts_over_current(np.array([0.5 * self.timing.servo_hz]))

    def counts_over_current(self, frequency_hz: Array) -> ComplexArray:
        """Return G (n, encoders, axes), counts per A, at frequencies (n,), Hz."""
        return response(
            self.plant.state, self.plant.input, self.plant.output,
            np.zeros((len(self.plant.output), self.plant.input.shape[1])), frequency_hz, self.timing,
        )  # fmt: skip

    def loop(self, servo: np.void, axis: str) -> Loop:
        """Return the loop of an axis under a servo (its `SERVO_PARAMETERS` record)."""
        law = closed_loop.servo_law(servo, len(self.plant.output))
        return Loop(self, law, self.layout.place(axis))


@dataclass(frozen=True, eq=False)
class Loop:
    """The loop of an axis (its place) of a linearised machine under a servo."""

    machine: Linearised
    law: ServoLaw
    place: int

    @property
    def frequency_hz(self) -> Array:
        """The frequencies of `response`, Hz."""
        return self.machine.frequency_hz

    @cached_property
    def response(self) -> ComplexArray:
        """L (n,) at the frequencies."""
        return self._open(self.frequency_hz, self.machine._counts_over_current)

    def at(self, frequency_hz: Array) -> ComplexArray:
        """Return L (n,) at other frequencies (n,), Hz."""
        return self._open(frequency_hz, self.machine.counts_over_current(frequency_hz))

    def _open(self, frequency_hz: Array, counts: ComplexArray) -> ComplexArray:
        law = self.law
        current = response(
            law.state, law.input, law.output, law.feedthrough, frequency_hz, self.machine.timing
        )
        product = current @ counts
        i = self.place
        others = [place for place in range(product.shape[1]) if place != i]
        rest = np.eye(len(others)) - product[:, others][:, :, others]
        through = np.linalg.solve(rest, product[:, others, i][..., None])[..., 0]
        return np.asarray(-(product[:, i, i] + np.sum(product[:, i, others] * through, axis=1)))

    @cached_property
    def _at_nyquist(self) -> tuple[float, float]:
        """Half of the servo rate, Hz, and L there, which is real."""
        nyquist_hz = 0.5 * self.machine.timing.servo_hz
        counts = self.machine._counts_at_nyquist
        return nyquist_hz, float(self._open(np.array([nyquist_hz]), counts)[0].real)

    @cached_property
    def margins(self) -> Margins:
        """The margins, to rounding."""
        return margins(self.frequency_hz, self.response, self.at, *self._at_nyquist)

    @cached_property
    def quick_margins(self) -> Margins:
        """The margins by interpolation on the grid: what a search needs."""
        return margins(self.frequency_hz, self.response, None, *self._at_nyquist)

    @property
    def stable(self) -> bool:
        """Whether closing the loop leaves no mode growing that does not grow without it."""
        without = self.law.output.copy(), self.law.feedthrough.copy()
        for matrix in without:
            matrix[self.place] = 0.0
        opened = ServoLaw(self.law.state, self.law.input, *without)
        return _growing(closed(self.machine.plant, self.law)) <= _growing(
            closed(self.machine.plant, opened)
        )

    @cached_property
    def bandwidth_hz(self) -> float:
        """The frequency at which |L / (1 + L)| falls below -3 dB, Hz; NaN if nowhere."""
        closed_loop_gain = np.abs(self.response / (1.0 + self.response))
        below = np.flatnonzero(closed_loop_gain < 2.0**-0.5)
        first = below[below > 0]
        return float(self.frequency_hz[first[0]]) if len(first) else float('nan')


def _growing(cycle: Matrix) -> int:
    """Return how many eigenvalues lie outside the unit circle."""
    return int(np.sum(np.abs(np.linalg.eigvals(cycle)) > 1.0 + MARGINAL))


def response(
    state: Matrix,
    given: Matrix,
    output: Matrix,
    feedthrough: Matrix,
    frequency_hz: Array,
    timing: Timing,
) -> ComplexArray:
    """Return C (z - A)^-1 B + D (n, outputs, inputs) at z = exp(2 pi i f Ts)."""
    z = np.exp(2j * np.pi * frequency_hz / timing.servo_hz)
    dynamic = z[:, None, None] * np.eye(len(state)) - state
    right = np.broadcast_to(given.astype(complex), (len(z), *given.shape))
    return np.asarray(output @ np.linalg.solve(dynamic, right) + feedthrough)
