# SPDX-License-Identifier: Apache-2.0
"""
A spring that follows points of force over deflection, such as a bearing's chart.

Between the points (e_i, f_i) the force is a cubic with slopes d_i at its ends, and with h the width of
the interval, r = f_i+1 - f_i and t = (e - e_i) / h from 0 to 1,

    f = f_i + t h d_i + t^2 (3 r - 2 h d_i - h d_i+1) + t^3 (h d_i + h d_i+1 - 2 r)

odd in e; beyond the last point it goes on straight with the last slope. The slopes are those of the
monotone piecewise cubic (PCHIP) through the points and their mirror images, or known ones, limited to
three times the secants r / h beside them. So f is once continuously differentiable and rises wherever
the points do. The energy is the integral of f, exact by Simpson's rule in each interval, as f is a
cubic there.

Source: F. N. Fritsch, R. E. Carlson, Monotone piecewise cubic interpolation, SIAM Journal on Numerical
Analysis 17 (1980). Limits: the second derivative jumps at the points; f is no better than the points
are dense.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.optimize import brentq

from waferbot_lockstep.compiled import compiled
from waferbot_lockstep.errors import UserError

LONGEST_CURVE = 32
"""Most points of a curve, the first one at zero included."""


@compiled
def _in_interval(deflections, forces, slopes, place, at):
    """Return force and slope of the cubic of one interval at a deflection."""
    width = deflections[place + 1] - deflections[place]
    rise = forces[place + 1] - forces[place]
    begin, end = width * slopes[place], width * slopes[place + 1]
    square, cube = 3.0 * rise - 2.0 * begin - end, begin + end - 2.0 * rise
    t = (at - deflections[place]) / width
    force = forces[place] + t * (begin + t * (square + t * cube))
    return force, (begin + t * (2.0 * square + 3.0 * t * cube)) / width


@compiled
def _interval(deflections, points, at):
    """Return the interval that a deflection of zero or more is in; the last point's if beyond it."""
    place = 0
    while place < points - 1 and at >= deflections[place + 1]:
        place += 1
    return place


@compiled
def force_and_slope(deflections, forces, slopes, points, at):
    """Return force (N, Nm) and slope of a curve of so many points at a deflection of zero or more."""
    place = _interval(deflections, points, at)
    if place == points - 1:
        return forces[place] + slopes[place] * (at - deflections[place]), slopes[place]
    return _in_interval(deflections, forces, slopes, place, at)


@compiled
def work(deflections, forces, slopes, points, low, high):
    """Return the integral of the force from `low` to `high`, 0 <= low <= high, J."""
    total = 0.0
    place = _interval(deflections, points, low)
    start = low
    while True:
        last = place == points - 1 or high <= deflections[place + 1]
        end = high if last else deflections[place + 1]
        middle = 0.5 * (start + end)
        if place == points - 1:
            total += (end - start) * (
                forces[place] + slopes[place] * (middle - deflections[place])
            )
        else:
            ends = (
                _in_interval(deflections, forces, slopes, place, start)[0]
                + _in_interval(deflections, forces, slopes, place, end)[0]
            )
            between = _in_interval(deflections, forces, slopes, place, middle)[0]
            total += (end - start) * (ends + 4.0 * between) / 6.0
        if last:
            return total
        start = end
        place += 1


@dataclass(frozen=True)
class SpringCurve:
    """Points of deflection (m, rad), force (N, Nm) and slope, from zero up; made by `through`."""

    deflections: tuple[float, ...]
    forces: tuple[float, ...]
    slopes: tuple[float, ...]

    @classmethod
    def through(
        cls,
        deflections: Sequence[float],
        forces: Sequence[float],
        name: str = 'curve',
        slopes: Sequence[float] | None = None,
    ) -> SpringCurve:
        """
        Return the curve through points that rise strictly from (0, 0), with `slopes` if they are known.

        Raises `UserError`, with `name`, for points that do not, fewer than two, or more than
        `LONGEST_CURVE`.
        """
        rising = all(a < b for values in (deflections, forces) for a, b in pairwise(values))
        if len(deflections) != len(forces) or not 2 <= len(forces) <= LONGEST_CURVE:
            raise UserError(
                f'{name}: {len(deflections)} deflections and {len(forces)} forces; give the same '
                f'number of each, from 2 to {LONGEST_CURVE}.'
            )
        if not rising or deflections[0] != 0.0 or forces[0] != 0.0:
            raise UserError(f'{name}: deflections and forces must rise strictly from 0.')
        e, f = np.array(deflections, float), np.array(forces, float)
        secants = np.diff(f) / np.diff(e)
        if slopes is None:
            mirrored = PchipInterpolator(np.append(-e[:0:-1], e), np.append(-f[:0:-1], f))
            d = mirrored.derivative()(e)
            # PCHIP ends flat where the curve, bent as before, would turn back within the last
            # interval. Nothing could bear on a slope of zero; the interval's secant is one that can.
            if d[-1] <= 0.0:
                d[-1] = secants[-1]
        else:
            least = np.minimum(np.append(secants[0], secants), np.append(secants, secants[-1]))
            d = np.minimum(slopes, 3.0 * least)
        return cls(tuple(e.tolist()), tuple(f.tolist()), tuple(d.tolist()))

    @cached_property
    def _arrays(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        return np.array(self.deflections), np.array(self.forces), np.array(self.slopes)

    def force(self, deflection: float) -> float:
        """Return the force, N or Nm, with the sign of the deflection (m, rad)."""
        e, f, d = self._arrays
        magnitude, _ = force_and_slope(e, f, d, len(f), abs(deflection))
        return float(np.copysign(magnitude, deflection))

    def slope(self, deflection: float) -> float:
        """Return the slope of the force, N/m or Nm/rad, at a deflection of either sign."""
        e, f, d = self._arrays
        return float(force_and_slope(e, f, d, len(f), abs(deflection))[1])

    def deflection(self, force: float) -> float:
        """Return the deflection, m or rad, that a force (N, Nm) of either sign makes."""
        e, f, d = self._arrays
        load = abs(force)
        place = int(np.searchsorted(f, load, side='right')) - 1
        if place == len(f) - 1:
            found = e[place] + (load - f[place]) / d[place]
        else:
            begin, end = e[place], e[place + 1]

            def missing(at: float) -> float:
                return float(_in_interval(e, f, d, place, at)[0] - load)

            # At the right end the cubic may be f_i+1 but for its last bit.
            found = end if missing(end) <= 0.0 else brentq(missing, begin, end, xtol=1e-15 * end)
        return float(np.copysign(found, force))


def in_series(
    curves: Sequence[SpringCurve], compliance: float = 0.0, name: str = 'springs in series'
) -> SpringCurve:
    """
    Return curves in series with springs whose compliances add up to `compliance` (m/N, rad/Nm).

    All carry the same force f, so that deflections add up, e = sum of e_j(f) + compliance f: exactly so
    at the forces of all points, slopes too, and by the cubic through these in between.
    """
    forces = sorted({force for curve in curves for force in curve.forces})
    each = [[curve.deflection(force) for curve in curves] for force in forces]
    deflections = [sum(own) + compliance * force for own, force in zip(each, forces, strict=True)]
    slopes = [
        1.0
        / (compliance + sum(1.0 / curve.slope(at) for curve, at in zip(curves, own, strict=True)))
        for own in each
    ]
    return SpringCurve.through(deflections, forces, name, slopes)
