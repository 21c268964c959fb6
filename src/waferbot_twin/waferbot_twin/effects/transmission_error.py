# SPDX-License-Identifier: Apache-2.0
"""
The teeth of a drive are not where they should be: the output stands ahead, periodically.

    t = cosine cos(order phi) + sine sin(order phi)

with phi the angle of the motor. Runout of a wheel or pulley on the motor is order 1; on the
output, the ratio of the drive; each tooth, the number of teeth. Where the model holds the drive
rigid, its first stage becomes a spring, much stiffer than its data say, to take the error up.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from waferbot_plant.description import Transmission
from waferbot_twin.effects import places
from waferbot_twin.effects.compliances import let_go
from waferbot_twin.effects.effect import Block, Effect, Parameter, Values
from waferbot_twin.effects.variant import Overlay, Variant


def _transmission(variant: Variant, axis: str) -> Transmission | None:
    """Return what drives the axis from an angle, with connections and without a cable."""
    for transmission in variant.description.transmissions.values():
        if (
            transmission.driven == places.coordinate(variant, axis)
            and variant.description.revolute[transmission.driving]
            and not transmission.pulls_only
            and _connections(transmission)
        ):
            return transmission
    return None


def _connections(transmission: Transmission) -> tuple[str, ...]:
    return tuple(stage.connection for stage in transmission.stages if stage.connection)


def _axes(variant: Variant) -> tuple[str, ...]:
    return tuple(
        axis for axis in places.jointed_axes(variant) if _transmission(variant, axis) is not None
    )


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    unit = places.length_unit(variant, axis)
    typical = 3e-4 if places.rotary(variant, axis) else 3e-5
    most = 100.0 * typical
    return (
        Parameter('cosine', unit, 0.0, typical, -most, most, 'amplitude of the cosine'),
        Parameter('sine', unit, 0.0, 0.7 * typical, -most, most, 'amplitude of the sine'),
        Parameter(
            'order', '', 1.0, 1.0, 1e-3, 500.0, 'per turn of the motor', shape=True, fixed=True
        ),
    )


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    transmission = _transmission(variant, axis)
    amplitude = math.hypot(values['cosine'], values['sine'])
    if transmission is None or amplitude == 0.0:
        return Overlay()
    entry = {
        f'amplitude_{places.length_unit(variant, axis)}': amplitude,
        'order': values['order'],
        'of': 'driving',
        'phase_rad': math.atan2(values['sine'], values['cosine']),
    }
    names = _connections(transmission)
    giving = any(variant.description.connections[name].flexible for name in names)
    machine = {} if giving else let_go(variant, names[:1])
    return Overlay(
        {**machine, 'transmissions': {transmission.name: {'transmission_error': entry}}}
    )


def _repeats_after(variant: Variant, axis: str, values: Mapping[str, float]) -> float:
    return 2.0 * math.pi / values['order'] / places.motor_ratio(variant, axis)


def _trials(variant: Variant, axis: str) -> tuple[Values, ...]:
    transmission = _transmission(variant, axis)
    assert transmission is not None
    return tuple({'order': order} for order in dict.fromkeys((1.0, 2.0, abs(transmission.ratio))))


EFFECT = Effect(
    'transmission_error',
    Block.PLANT,
    'periodic error of the teeth of a drive',
    _axes,
    _parameters,
    _overlay,
    _trials,
    equation='t = cosine cos(order phi) + sine sin(order phi)',
    repeats_after=_repeats_after,
    begins_at=1e-3,
)
