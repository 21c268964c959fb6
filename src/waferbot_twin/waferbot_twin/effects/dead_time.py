# SPDX-License-Identifier: Apache-2.0
"""
The bridge loses voltage against the sign of the current while both its switches are off.

Lost is U_d sign(i) at each terminal, in proportion below 0.5 A. It distorts the current six times
per electrical cycle, as far as the current loop lets it, and most at low current. A negative
voltage is a compensation that does too much.
"""

from __future__ import annotations

from collections.abc import Mapping

from waferbot_lockstep.timing import Timing
from waferbot_twin.effects import places
from waferbot_twin.effects.effect import Block, Effect, Parameter
from waferbot_twin.effects.variant import Overlay, Variant

STABLE_SHARE = 0.4
"""Of the voltage at which the loss of one tick would turn the sign of the current (see the setting)."""


def _largest(variant: Variant, axis: str) -> float:
    """Return the largest voltage that is stable, V, at most 20 V."""
    per_tick = 0.5 * variant.description.motors[axis].inductance * Timing().current_loop_hz
    ramp = variant.amplifier_setting(axis, 'dead_time_current')
    return min(20.0, STABLE_SHARE * per_tick * ramp)


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    largest = _largest(variant, axis)
    return (
        Parameter(
            'voltage', 'V', 0.0, min(3.0, 0.8 * largest), -largest, largest, 'lost per terminal'
        ),
    )


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    voltage = variant.amplifier_setting(axis, 'dead_time_voltage') + values['voltage']
    return Overlay(copley={axis: {'dead_time_voltage': voltage}})


EFFECT = Effect(
    'dead_time',
    Block.AMPLIFIER,
    'dead time of the bridge: voltage lost against the sign of the current',
    places.amplified_axes,
    _parameters,
    _overlay,
    equation='u_k = u_k - voltage sign(i_k)',
    title='dead time of the bridge',
)
