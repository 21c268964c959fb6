# SPDX-License-Identifier: Apache-2.0
"""
The force follows what the drive is told with a first-order lag: the bandwidth of its current loop.

    T dF/dt = F_told - F,        bandwidth 1 / (2 pi T)

Of drives whose current was not measured. A delay shifts the force in time, a lag rounds it as well: they
differ in what is as fast as 1 / T, at reversals and in oscillations. Next to none of it is a delay to
first order, and logs have a time of the drive: so it is tried at sizes at which it is more.

Source: W. Leonhard, Control of Electrical Drives, 3rd ed., Springer 2001: a closed current loop as one
time constant.
"""

from __future__ import annotations

from collections.abc import Mapping

from waferbot_plant.description_drives import LAG_KEY
from waferbot_twin.effects import places
from waferbot_twin.effects.effect import Block, Effect, Parameter
from waferbot_twin.effects.variant import Overlay, Variant

TYPICAL_MS, MOST_MS = 0.3, 5.0
"""A current loop of 500 Hz, which is usual; a drive of 30 Hz is no servo drive."""


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    return (Parameter('lag', 'ms', 0.0, TYPICAL_MS, 0.0, MOST_MS, 'more than in the model'),)


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    own = variant.description.motors[axis].lag
    return Overlay({'motors': {axis: {LAG_KEY: own + 1e-3 * values['lag']}}})


EFFECT = Effect(
    'drive_lag',
    Block.PLANT,
    'the force follows what the drive is told with a first-order lag',
    places.lagging_axes,
    _parameters,
    _overlay,
    equation='lag dF/dt = F_told - F',
    title='lag of the drive',
    usual=True,
    tried_at=(1.0, 3.0),
)
