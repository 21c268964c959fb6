# SPDX-License-Identifier: Apache-2.0
"""
Sensitivities by variance: what share of a measure's variance a parameter explains.

First order S: by itself. Total T: with all that it does together with others; T - S is interaction, T
near zero says that the parameter does not matter. From the points of method `saltelli` (SALib), with
95 % intervals by resampling.

Source: A. Saltelli et al., Variance based sensitivity analysis of model output, Computer Physics
Communications 181 (2010).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from waferbot_lockstep.errors import UserError
from waferbot_twin.sweep.variation import Variation, problem


def sensitivities(
    variations: Sequence[Variation], table: pd.DataFrame, measures: Sequence[str], seed: int
) -> pd.DataFrame:
    """
    Return `measure`, `parameter`, `first`, `first_95`, `total`, `total_95` for each pair.

    `..._95` is half the width of the interval. Raises `UserError` if a run gave no number: every point
    counts.
    """
    from SALib.analyze import sobol

    rows = []
    for measure in measures:
        values = table[measure].to_numpy(float)
        bad = int(np.sum(~np.isfinite(values)))
        if bad:
            raise UserError(
                f'no sensitivities of {measure}: {bad} of {len(values)} runs gave no number; '
                'take narrower ranges'
            )
        if np.ptp(values) == 0.0:
            found = {
                name: np.zeros(len(variations)) for name in ('S1', 'S1_conf', 'ST', 'ST_conf')
            }
        else:
            found = sobol.analyze(problem(variations), values, calc_second_order=False, seed=seed)
        for place, one in enumerate(variations):
            rows.append(
                {
                    'measure': measure,
                    'parameter': one.path,
                    'first': float(found['S1'][place]),
                    'first_95': float(found['S1_conf'][place]),
                    'total': float(found['ST'][place]),
                    'total_95': float(found['ST_conf'][place]),
                }
            )
    return pd.DataFrame(rows)
