# SPDX-License-Identifier: Apache-2.0
"""Held connections in the closed loop: the run of the rigid machine, counts and all."""

from __future__ import annotations

import numpy as np
import pytest

from waferbot_lockstep.timing import Timing
from waferbot_plant.plant import load_machine
from waferbot_twin.engines.inprocess import Twin
from waferbot_twin.plan import make_plan


@pytest.mark.slow
def test_closed_loop_of_held_follows_that_of_rigid() -> None:
    """A count at its edge may fall either way by rounding, so to two counts over 0.2 s."""
    found = []
    for state in ('held', 'rigid'):
        plan = make_plan('flexible', 'step', 0.2)
        twin = Twin.of(plan.model, plan.timing, plan.experiment)
        twin.machine = load_machine('flexible', state, timing=Timing())
        twin.plant_parameters = twin.machine.parameters()
        twin.plant_state = twin.machine.resting_state(twin.plant_parameters)
        found.append(twin.advance(plan.ticks).counts.copy())
    moved = np.abs(found[1] - found[1][0]).max(axis=0)
    difference = np.abs(found[0] - found[1]).max(axis=0)
    print('moved', moved, 'difference', difference)
    assert (moved > 700).all()
    assert (difference <= 2).all()
