# SPDX-License-Identifier: Apache-2.0
"""
Parameters that every machine has a little different from its model: corrected, but no cause.

A parameter p = p_0 + c x, or p_0 exp(x), has the usual spread s of x as its prior, and cannot be
further off than that of its bounds (`inference.nuisance`, equation (1)). Its interval ends there. What
the spreads of this machine are, as a multiple k of the usual ones, follows from all of them
(`estimation.usual_spread`). Where logs tell nothing of a parameter, its standard error is that of the
prior, k s.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from waferbot_twin.diagnosis.findings import lies_on_bound
from waferbot_twin.effects.effect import Parameter
from waferbot_twin.estimation.intervals import NORMAL_95
from waferbot_twin.estimation.usual_spread import scales_of_spread

if TYPE_CHECKING:
    from waferbot_twin.diagnosis.diagnose import Diagnosis

TOLD_BELOW = 0.9
"""Standard error over that of the prior below which logs tell a parameter: a fifth of what is known."""


@dataclass(frozen=True)
class Correction:
    """
    A parameter that was corrected within its usual spread.

    `parameter` says it in words ("mass of carriage"), `path` where it stands in the description
    (`bodies.carriage.mass_kg`); `nominal`, `found` and the ends of the 95 % interval `low`, `high` are
    in `unit`. One that is known `to_a_factor` is p_0 exp(x).
    """

    parameter: str
    path: str
    unit: str
    nominal: float
    found: float
    low: float
    high: float
    to_a_factor: bool = False


def corrected(nominal: float, x: float, to_a_factor: bool) -> float:
    """Return the parameter p of an x, as above."""
    return nominal * math.exp(x) if to_a_factor else nominal + (nominal or 1.0) * x


@dataclass(frozen=True)
class StatedCorrection:
    """A correction as it is told: its interval within bounds, `told` by the logs, `on_bound`."""

    correction: Correction
    low: float
    high: float
    told: bool
    on_bound: bool


def stated(diagnosis: Diagnosis) -> list[StatedCorrection]:
    """Return the corrections of a diagnosis with what is possible and what the logs tell of each."""
    known = {
        item.name: (item, cause.values[item.name])
        for cause in diagnosis.after.causes
        for item in cause.effect.parameters(diagnosis.problem.nominal, cause.axis)
        if item.spread > 0.0
    }
    scales = scales_of_spread(diagnosis.problem, diagnosis.after)
    return [
        _stated(correction, *known[correction.path], scales[correction.path])
        if correction.path in known
        else StatedCorrection(correction, correction.low, correction.high, True, False)
        for correction in diagnosis.corrections
    ]


def stated_accelerations(diagnosis: Diagnosis) -> list[StatedCorrection]:
    """Return what several corrections make together (`accelerations`), all of it told by the logs."""
    return [
        StatedCorrection(item, item.low, item.high, True, False)
        for item in diagnosis.accelerations
    ]


def _stated(correction: Correction, item: Parameter, x: float, scale: float) -> StatedCorrection:
    """Return a correction whose x has a value; `scale` is the k of its prior."""
    nominal, to_a_factor = correction.nominal, correction.to_a_factor
    ends = sorted(corrected(nominal, end, to_a_factor) for end in (item.low, item.high))
    if to_a_factor:
        width = math.log(correction.high / correction.low)
    else:
        width = (correction.high - correction.low) / (nominal or 1.0)
    error = 0.5 * width / NORMAL_95
    return StatedCorrection(
        correction,
        min(max(correction.low, ends[0]), correction.found),
        max(min(correction.high, ends[1]), correction.found),
        abs(error) < TOLD_BELOW * scale * item.spread,
        lies_on_bound(item, x),
    )
