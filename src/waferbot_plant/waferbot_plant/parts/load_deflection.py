# SPDX-License-Identifier: Apache-2.0
"""
A bearing supplier's chart of load against deflection, and the stiffness read from it.

Rolling contacts stiffen with load (deflection grows about as load^(2/3) for balls, load^0.9 for
rollers), so one number of stiffness holds for one load only. The thesis takes the secant over the
range of loads that the mechanism sees, equation (5.22). Between the points of the chart the curve
is a monotonic cubic (PCHIP), which does not overshoot.

The chart can also be followed as it is, `force_curve`: force over deflection, with the slope that it has
at the load of the moment.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

from scipy.interpolate import PchipInterpolator

from waferbot_lockstep.errors import UserError
from waferbot_plant.parts.checks import (
    require_finite,
    require_fraction,
    require_not_negative,
    require_positive,
)
from waferbot_plant.spring_curves import SpringCurve

METRES_PER_MICROMETRE = 1e-6
RADIANS_PER_MICRORADIAN = 1e-6


@dataclass(frozen=True)
class LoadDeflection:
    """
    A chart in SI units: loads (N or Nm) and the deflections (m or rad) that they cause.

    Both start at zero and rise strictly; at least two points. Raises `UserError` otherwise. `name`
    tells the chart in messages. Loads are magnitudes: a direction with another curve is another
    chart.
    """

    loads: tuple[float, ...]
    deflections: tuple[float, ...]
    name: str = 'load-deflection curve'

    def __post_init__(self) -> None:
        """Check the points."""
        if len(self.loads) != len(self.deflections) or len(self.loads) < 2:
            raise UserError(
                f'{self.name} has {len(self.loads)} loads and {len(self.deflections)} '
                'deflections; give the same number of each, two at least.'
            )
        for label, values in (('load', self.loads), ('deflection', self.deflections)):
            for value in values:
                require_finite(value, f'{self.name}: {label}')
            if values[0] != 0.0:
                raise UserError(f'{self.name}: first {label} is {values[0]!r}; it must be 0.')
            for before, after in pairwise(values):
                if after <= before:
                    raise UserError(
                        f'{self.name}: {label} {after!r} follows {before!r}; '
                        'points must rise strictly.'
                    )

    def _within(self, load: float) -> float:
        require_not_negative(load, f'{self.name}: load')
        if load > self.loads[-1]:
            raise UserError(
                f'{self.name}: load {load:.6g} lies beyond the last point {self.loads[-1]:.6g}; '
                'extend the curve or choose a larger part.'
            )
        return load

    def deflection(self, load: float) -> float:
        """Return the deflection (m or rad) under `load` (N or Nm, zero to the last point)."""
        return float(PchipInterpolator(self.loads, self.deflections)(self._within(load)))

    def secant_over_range(self, load: float, variability: float) -> float:
        """
        Return the secant stiffness over [(1 - gamma) F, (1 + gamma) F], equation (5.22).

        `load` F is the static load (N or Nm, above zero); `variability` gamma lies between 0 and
        1, for a vertical axis the peak vertical acceleration in units of g. The result (N/m or
        Nm/rad) resists a change of load along the static load. Raises `UserError` if the range
        leaves the curve.
        """
        require_positive(load, f'{self.name}: static load')
        require_fraction(variability, f'{self.name}: load variability')
        low = (1.0 - variability) * load
        high = (1.0 + variability) * load
        return (high - low) / (self.deflection(high) - self.deflection(low))

    def force_curve(self) -> SpringCurve:
        """
        Return the chart read the other way round: force (N, Nm) over deflection (m, rad), odd.

        It meets the chart's points; between them it is a cubic in the deflection where `deflection` is
        one in the load, which differ by the error of interpolation. Beyond the last point it goes on
        straight. Raises `UserError` for more points than `LONGEST_CURVE`.
        """
        return SpringCurve.through(self.deflections, self.loads, self.name)

    def secant_from_zero(self, load: float) -> float:
        """
        Return load over deflection (N/m or Nm/rad).

        In a bearing that is alike in all directions this is the stiffness *across* the static
        load: with the elastic potential U(r) of a radial deflection r, the second derivative along
        the deflection is U'' and across it U'/r, which is load over deflection. Raises `UserError`
        for a load of zero or beyond the curve.
        """
        require_positive(load, f'{self.name}: static load')
        return load / self.deflection(load)


@dataclass(frozen=True)
class ForceDeflection:
    """A chart of force in N against deflection in micrometres, as suppliers print it."""

    load_n: tuple[float, ...]
    deflection_um: tuple[float, ...]

    def __post_init__(self) -> None:
        """Check the points."""
        self.curve('load_n, deflection_um')

    def curve(self, name: str) -> LoadDeflection:
        """Return the chart in N and m, under `name` in messages."""
        metres = tuple(value * METRES_PER_MICROMETRE for value in self.deflection_um)
        return LoadDeflection(self.load_n, metres, name)


@dataclass(frozen=True)
class MomentTilt:
    """A chart of moment in Nm against tilt in microradians."""

    moment_nm: tuple[float, ...]
    tilt_urad: tuple[float, ...]

    def __post_init__(self) -> None:
        """Check the points."""
        self.curve('moment_nm, tilt_urad')

    def curve(self, name: str) -> LoadDeflection:
        """Return the chart in Nm and rad, under `name` in messages."""
        radians = tuple(value * RADIANS_PER_MICRORADIAN for value in self.tilt_urad)
        return LoadDeflection(self.moment_nm, radians, name)
