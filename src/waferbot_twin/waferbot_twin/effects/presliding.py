# SPDX-License-Identifier: Apache-2.0
"""
Friction that is a spring before it slides: bristles of rolling contacts and seals (LuGre).

    z' = v - |v| z / z_s,    F = F_c / z_s (z + relaxation z')

with z the deflection of the bristles and z_s that at which they give way. The stiffness before
sliding is F_c / z_s, the damping there `relaxation` times that (sigma_1 = relaxation sigma_0 of LuGre).
In steady sliding this is Coulomb friction of F_c, whatever the relaxation.

Source: C. Canudas de Wit, H. Olsson, K. J. Astrom, P. Lischinsky, A new model for control of systems
with friction, IEEE Trans. Automatic Control 40 (1995); their example has a relaxation of 3.2 ms.
"""

from __future__ import annotations

from collections.abc import Mapping

from waferbot_twin.effects import frictions, places
from waferbot_twin.effects.effect import Block, Effect, Parameter, Values
from waferbot_twin.effects.variant import Overlay, Variant


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    rated = places.rated_force(variant, axis)
    unit, length = places.force_unit(variant, axis), places.length_unit(variant, axis)
    distance = _distances(variant, axis)[1]
    return (
        Parameter('friction', unit, 0.0, 0.1 * rated, 0.0, 10.0 * rated, 'when sliding'),
        Parameter(
            'distance', length, distance, distance, 0.01 * distance, 100.0 * distance,
            'deflection at which it slides', shape=True,
        ),
        Parameter(
            'relaxation', 's', 0.0, 0.0, 0.0, 0.02, 'damping over stiffness, before it slides',
            shape=True,
        ),
    )  # fmt: skip


def _distances(variant: Variant, axis: str) -> tuple[float, float, float]:
    """Return tenths of millimetres as of rolling guides; of a bearing of 50 mm radius."""
    radius = 0.05 if places.rotary(variant, axis) else 1.0
    return 1e-5 / radius, 5e-5 / radius, 2e-4 / radius


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    turns = places.rotary(variant, axis)
    stiffness = values['friction'] / values['distance']
    bristles = {'stiffness_nm_rad' if turns else 'stiffness_n_m': stiffness}
    if values['relaxation'] > 0.0:
        damping = values['relaxation'] * stiffness
        bristles['damping_nm_s_rad' if turns else 'damping_n_s_m'] = damping
    law = {'presliding': bristles}
    return Overlay(frictions.slot(variant, axis, 'presliding', [0.0], [values['friction']], law))


def _trials(variant: Variant, axis: str) -> tuple[Values, ...]:
    return tuple({'distance': distance} for distance in _distances(variant, axis))


EFFECT = Effect(
    'presliding',
    Block.PLANT,
    'friction that is a spring before it slides',
    places.motor_axes,
    _parameters,
    _overlay,
    _trials,
    equation="LuGre: z' = v - |v| z / distance, F = friction (z + relaxation z') / distance",
    tried_at=frictions.STICKS,
    title='presliding friction',
)
