# SPDX-License-Identifier: Apache-2.0
"""
What an axis carries is another load than in the model: another tool, a part that was added, a drawing
that is out of date.

Mass, centre of gravity and inertia of the heaviest body that the axis carries are all other ones, as a
robot's load is identified. Its inertia J about the centre of gravity is told by the second moments of
its mass, S = integral of r r' dm,

    J = tr(S) 1 - S,        J_xx = S_yy + S_zz,                                                    (1)

as any S of which each diagonal entry is positive is one that a body can have. Along the base axes at
home; products of inertia stay as they are. It is another by nearly half of its mass and a fifth of its
radius of gyration at most: what the bearings that were chosen for it still carry. Only where another
axis carries this one, and feels weight and reaction of the load: elsewhere inertia about the axis and
offset of the centre of gravity across it say all of it (`wrong_inertia`, `centre_of_gravity`).

Source: W. Khalil, E. Dombre, Modeling, Identification and Control of Robots, chapter 12.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from waferbot_plant.description import Body
from waferbot_twin.effects import places
from waferbot_twin.effects.effect import Block, Effect, Parameter, Values
from waferbot_twin.effects.variant import Overlay, Variant

DIRECTIONS = 'xyz'

PARTS = ('wrong_inertia', 'centre_of_gravity')
"""Effects that change a part of what a load changes, on its axis."""


def _second_moments(body: Body) -> np.ndarray:
    """Return the S (3, 3) of a body, kg m2, by equation (1)."""
    return np.asarray(0.5 * np.trace(body.inertia) * np.eye(3) - body.inertia)


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    body = places.carried_body(variant, axis)
    largest = float(np.max(np.diag(body.inertia)))
    radius = (largest / body.mass) ** 0.5
    least = -0.9 * np.maximum(np.diag(_second_moments(body)), 0.0)
    return (
        Parameter(
            'mass', 'kg', 0.0, 0.1 * body.mass, -0.45 * body.mass, 0.45 * body.mass,
            'more than the model has',
        ),
        *(
            Parameter(
                f'offset_{name}', 'm', 0.0, 0.02 * radius, -0.2 * radius, 0.2 * radius,
                f'of the centre of gravity, along {name} at home',
            )
            for name in DIRECTIONS
        ),
        *(
            Parameter(
                f'moment_{name}', 'kg m2', 0.0, 0.1 * largest, low, 3.0 * largest,
                f'second moment of mass along {name}, more than the model has',
            )
            for name, low in zip(DIRECTIONS, least.tolist(), strict=True)
        ),
    )  # fmt: skip


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    body = variant.description.bodies[places.carried_body(variant.base, axis).name]
    offset, more = (
        np.array([values[f'{kind}_{name}'] for name in DIRECTIONS])
        for kind in ('offset', 'moment')
    )
    inertia = body.inertia + np.sum(more) * np.eye(3) - np.diag(more)
    return Overlay(
        {
            'bodies': {
                body.name: {
                    'mass_kg': body.mass + values['mass'],
                    'centre_of_gravity_m': (body.centre_of_gravity + offset).tolist(),
                    'inertia_kg_m2': places.tensor_entries(inertia),
                }
            }
        }
    )


def load_of(nominal: Variant, variant: Variant, axis: str) -> Values:
    """Return the values of a load that make the body of the nominal model that of a variant."""
    name = places.carried_body(nominal.base, axis).name
    before, after = (one.description.bodies[name] for one in (nominal, variant))
    offset = after.centre_of_gravity - before.centre_of_gravity
    more = np.diag(_second_moments(after) - _second_moments(before))
    bounds = {item.name: item for item in _parameters(nominal.base, axis)}
    values = {
        'mass': after.mass - before.mass,
        **{f'offset_{one}': float(offset[n]) for n, one in enumerate(DIRECTIONS)},
        **{f'moment_{one}': float(more[n]) for n, one in enumerate(DIRECTIONS)},
    }
    return {
        key: min(max(value, bounds[key].low), bounds[key].high) for key, value in values.items()
    }


EFFECT = Effect(
    'load',
    Block.PLANT,
    'load with another mass, centre of gravity and inertia than in the model',
    places.carried_axes,
    _parameters,
    _overlay,
    equation='J = tr(S) 1 - S, S = S_model + moment',
    usual=True,
    title='load error',
)
