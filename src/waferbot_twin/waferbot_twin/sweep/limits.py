# SPDX-License-Identifier: Apache-2.0
"""
Constraints of an optimisation: measures that may not be above a value, g_j(x) <= limit_j.

A point violates a constraint by [g_j - limit_j] / |limit_j|, [.] the positive part.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from waferbot_lockstep.errors import UserError
from waferbot_twin.effects.variant import Variant
from waferbot_twin.sweep.evaluation import check_measures
from waferbot_twin.sweep.variation import Floats


@dataclass(frozen=True)
class Limit:
    """A measure that may not be above a value."""

    measure: str
    highest: float


def parse_limits(texts: Sequence[str], variant: Variant) -> tuple[Limit, ...]:
    """Return limits, `FIGURE.AXIS<VALUE`; raises `UserError`."""
    found = []
    for text in texts:
        measure, sign, value = text.partition('<')
        try:
            highest = float(value)
        except ValueError:
            highest = math.nan
        if not sign or not math.isfinite(highest) or highest == 0.0:
            raise UserError(f'--limit {text}: give FIGURE.AXIS<VALUE, a number that is not 0')
        (measure,) = check_measures([measure.strip()], variant)
        found.append(Limit(measure, highest))
    return tuple(found)


def excess(limits: Sequence[Limit], names: Sequence[str], measures: Floats) -> Floats:
    """Return (g - limit) / |limit| of every limit, (n, limits), of measures (n, names)."""
    columns = [
        (measures[:, names.index(one.measure)] - one.highest) / abs(one.highest) for one in limits
    ]
    return np.column_stack(columns) if columns else np.zeros((len(measures), 0))
