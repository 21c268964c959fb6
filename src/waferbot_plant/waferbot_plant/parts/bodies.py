# SPDX-License-Identifier: Apache-2.0
"""Rigid bodies taken together: mass, centre of gravity and moments of inertia about a point."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from waferbot_lockstep.errors import UserError
from waferbot_plant.parts.checks import require_finite, require_positive

Point = tuple[float, float, float]


@dataclass(frozen=True)
class Body:
    """
    A rigid body at the zero pose, in the base frame.

    Mass in kg, centre of gravity in m, moments of inertia about axes through the centre of gravity
    parallel to x, y, z in kg m2. Products of inertia do not matter here, as each spring is taken
    by itself. Raises `UserError` for moments that no body has: each must be at most the sum of the
    other two.
    """

    mass_kg: float
    centre_of_gravity_m: Point
    inertia_kg_m2: Point

    def __post_init__(self) -> None:
        """Check the data."""
        require_positive(self.mass_kg, 'body: mass_kg')
        for coordinate in self.centre_of_gravity_m:
            require_finite(coordinate, 'body: centre_of_gravity_m')
        for moment in self.inertia_kg_m2:
            require_positive(moment, 'body: inertia_kg_m2')
        if 2.0 * max(self.inertia_kg_m2) > sum(self.inertia_kg_m2):
            raise UserError(
                f'body: inertia_kg_m2 {self.inertia_kg_m2!r} breaks the triangle inequality; no '
                'moment may exceed the sum of the other two.'
            )


def total_mass_kg(bodies: Iterable[Body]) -> float:
    """Return the sum of the masses in kg."""
    return sum(body.mass_kg for body in bodies)


def centre_of_gravity_m(bodies: Iterable[Body]) -> Point:
    """Return the common centre of gravity in m, base frame."""
    bodies = tuple(bodies)
    mass_kg = total_mass_kg(bodies)
    x, y, z = (
        sum(body.mass_kg * body.centre_of_gravity_m[axis] for body in bodies) / mass_kg
        for axis in range(3)
    )
    return x, y, z


def inertia_about_kg_m2(bodies: Iterable[Body], point: Point) -> Point:
    """
    Return the moments of inertia in kg m2 about axes through `point` parallel to x, y, z.

    Own moments plus m times the squared distance from the axis (Huygens-Steiner).
    """
    moments = [0.0, 0.0, 0.0]
    for body in bodies:
        offset = [body.centre_of_gravity_m[axis] - point[axis] for axis in range(3)]
        squared = sum(component**2 for component in offset)
        for axis in range(3):
            moments[axis] += body.inertia_kg_m2[axis]
            moments[axis] += body.mass_kg * (squared - offset[axis] ** 2)
    return moments[0], moments[1], moments[2]
