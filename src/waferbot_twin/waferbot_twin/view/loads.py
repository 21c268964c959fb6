# SPDX-License-Identifier: Apache-2.0
"""
What the parts of a recorded machine bore, for the page: tensions, forces, moments, temperatures.

They are the amounts that `waferbot_plant.validity` looks at, with its ranges: of a belt the tensions of
its spans, of a cable that of one rope, of bearings the loads on a block or ring. The plant tells the
least and the greatest of each every 10 ms, of the time since it told them last.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from waferbot_lockstep.timing import Timing
from waferbot_plant.loads import Loads
from waferbot_plant.plant import Machine
from waferbot_plant.validity import checks_of

MOST_STRETCHES = 3000
"""Stretches of time that the page gets, at most: 30 s whole; a longer recording has wider ones."""


def loads_of(
    machine: Machine, told: Sequence[NDArray[np.void]], timing: Timing
) -> tuple[list[float], list[dict[str, Any]]]:
    """
    Return the ends of the stretches in s, and of each amount name, unit, range, least and greatest.

    `told` are the messages of `plant_state`, in pieces and in their order. Nothing of a machine whose
    connections are all rigid, nor of a recording in which the plant did not tell it.
    """
    checks = list(checks_of(machine))
    if not checks or not sum(map(len, told)):
        return [], []
    records = np.concatenate(list(told))
    loads = Loads(
        records['tick'].astype(np.int64),
        records['spring_least'],
        records['spring_most'],
        records['cable_least'],
        records['cable_most'],
        records['winding_temperature'],
    )
    count = len(records)
    starts = np.unique(
        np.linspace(0, count, min(count, MOST_STRETCHES), endpoint=False).astype(int)
    )
    ends = np.append(starts[1:], count) - 1
    rows = []
    for check, measure in checks:
        least, most = measure(loads)
        least, most = np.minimum.reduceat(least, starts), np.maximum.reduceat(most, starts)
        rows.append(
            {
                'place': check.place,
                'what': check.what,
                'unit': check.unit,
                'range': check.limits,
                'least': least.tolist(),
                'most': most.tolist(),
                'outside': ((least < check.least) | (most > check.most)).tolist(),
            }
        )
    return [timing.seconds(int(tick)) for tick in loads.tick[ends]], rows
