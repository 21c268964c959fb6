# SPDX-License-Identifier: Apache-2.0
"""Parameters that every machine has a little different from its model: corrected, but no cause."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Correction:
    """
    A parameter that was corrected within its usual spread.

    `parameter` says it in words ("mass of carriage"), `path` where it stands in the description
    (`bodies.carriage.mass_kg`); `nominal`, `found` and the ends of the 95 % interval `low`, `high` are
    in `unit`.
    """

    parameter: str
    path: str
    unit: str
    nominal: float
    found: float
    low: float
    high: float
