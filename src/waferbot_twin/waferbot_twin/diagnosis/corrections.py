# SPDX-License-Identifier: Apache-2.0
"""Parameters that every machine has a little different from its model: corrected, but no cause."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Correction:
    """
    A parameter that was corrected within its usual spread.

    `parameter` says it in words ("viscous friction on X-Rotate"); `nominal`, `found` and the ends of the
    95 % interval `low`, `high` are in `unit`. `path` is `effect:axis.parameter`: the effect of the
    library that makes `found` of `nominal`, by what it adds to it or, if the parameter is a ratio, by
    what it multiplies it with. It is empty where no effect does that.
    """

    parameter: str
    unit: str
    nominal: float
    found: float
    low: float
    high: float
    path: str = ''
