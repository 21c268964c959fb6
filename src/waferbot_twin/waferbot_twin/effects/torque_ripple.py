# SPDX-License-Identifier: Apache-2.0
"""
The motor's constant changes along its electrical cycle: a ripple of the force that grows with the
current.

    k = k_model (1 + cosine cos(order theta) + sine sin(order theta))

theta the electrical angle. Order 6 comes from the fifth and seventh harmonic of the back-EMF,
order 2 from windings that differ. `cogging` is there without current.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict

from waferbot_plant.motors import RIPPLES
from waferbot_twin.effects import places
from waferbot_twin.effects.effect import Block, Effect, Parameter, several_trials
from waferbot_twin.effects.variant import Overlay, Variant

MOST = 0.4


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    return (
        Parameter('cosine', '', 0.0, 0.04, -MOST, MOST, 'relative amplitude of the cosine'),
        Parameter('sine', '', 0.0, 0.03, -MOST, MOST, 'relative amplitude of the sine'),
        Parameter(
            'order',
            '1/cycle',
            6.0,
            6.0,
            0.01,
            50.0,
            'per electrical cycle',
            shape=True,
            fixed=True,
        ),
    )


def _axes(variant: Variant) -> tuple[str, ...]:
    """Return the axes whose motor has room for another ripple."""
    return tuple(
        axis
        for axis in places.wound_axes(variant)
        if len(variant.description.motors[axis].ripple) < RIPPLES
    )


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    if values['cosine'] == 0.0 and values['sine'] == 0.0:
        return Overlay()
    own = {'order': values['order'], 'cosine': values['cosine'], 'sine': values['sine']}
    others = [asdict(ripple) for ripple in variant.description.motors[axis].ripple]
    return Overlay({'motors': {axis: {'ripple': [*others, own]}}})


EFFECT = Effect(
    'torque_ripple',
    Block.MOTOR,
    'force per ampere changes along the electrical cycle',
    _axes,
    _parameters,
    _overlay,
    several_trials('order', 6.0, 2.0),
    equation='k = k_model (1 + cosine cos(order theta) + sine sin(order theta))',
    repeats_after=places.period_of_order,
)
