# SPDX-License-Identifier: Apache-2.0
"""
The floor shakes at one frequency, in the direction that this axis feels most.

    a(t) = cosine cos(2 pi f t) + sine sin(2 pi f t)

A linear axis feels it along itself; a rotary one across itself, by the arm of what is out of
balance. Time counts from the start of a run, so the phase is a matter of chance in each log. There
is one floor: of several, only the last one laid over the model counts, and of axes that feel the same
direction most only the first is offered.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from waferbot_plant.assembly import home_mass_matrix_and_weight
from waferbot_twin.effects import places
from waferbot_twin.effects.effect import Block, Effect, Parameter, several_trials
from waferbot_twin.effects.variant import Overlay, Variant


def _direction(variant: Variant, axis: str) -> np.ndarray | None:
    """
    Return the unit vector of the acceleration that the axis feels most, None if it feels none.

    The force on the axis of an acceleration of the floor is -J a, with J the sum of mass times the
    motion of its centre per unit of the axis: what gravity does in that direction.
    """
    variant = variant.base
    assembly = variant.rigid
    row, ratio = assembly.placing[places.coordinate(variant, axis)]
    felt = np.array(
        [
            home_mass_matrix_and_weight(
                list(assembly.links), assembly.placing, len(assembly.coordinates), unit
            )[1][row]
            / ratio
            for unit in np.eye(3)
        ]
    )
    length = float(np.linalg.norm(felt))
    return felt / length if length > LEAST_SHARE * places.moving_inertia(variant, axis) else None


PARALLEL = 0.999
"""Cosine of an angle from which on two directions are one."""

LEAST_SHARE = 1e-3
"""Mass or first moment over mass or inertia from which an axis counts as feeling the floor, 1 or 1/m."""


def _axes(variant: Variant) -> tuple[str, ...]:
    """Return the axes that feel the floor, one for each direction: there is but one floor."""
    found: dict[str, np.ndarray] = {}
    for axis in places.jointed_axes(variant):
        direction = _direction(variant, axis)
        if direction is not None and all(
            abs(direction @ other) < PARALLEL for other in found.values()
        ):
            found[axis] = direction
    return tuple(found)


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    return (
        Parameter('cosine', 'm/s2', 0.0, 0.1, -10.0, 10.0, 'amplitude of the cosine'),
        Parameter('sine', 'm/s2', 0.0, 0.06, -10.0, 10.0, 'amplitude of the sine'),
        Parameter('frequency', 'Hz', 25.0, 25.0, 0.2, 2000.0, 'of the floor', shape=True),
    )


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    direction = _direction(variant, axis)
    amplitude = math.hypot(values['cosine'], values['sine'])
    if direction is None or amplitude == 0.0:
        return Overlay()
    entry = {
        'acceleration_m_s2': (amplitude * direction).tolist(),
        'frequency_hz': values['frequency'],
        'phase_rad': math.atan2(values['cosine'], values['sine']),
    }
    return Overlay({'vibration': entry})


EFFECT = Effect(
    'floor_vibration',
    Block.ENVIRONMENT,
    'the floor shakes at one frequency',
    _axes,
    _parameters,
    _overlay,
    several_trials('frequency', 12.0, 25.0, 50.0),
    tone='frequency',
    equation='a(t) = cosine cos(2 pi frequency t) + sine sin(2 pi frequency t)',
)
