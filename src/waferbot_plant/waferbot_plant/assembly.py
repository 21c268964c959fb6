# SPDX-License-Identifier: Apache-2.0
"""
From a description to arrays: links, minimal coordinates, elements.

What is rigid goes away here, once, when a description is loaded: bodies that cannot move against
each other are merged, a rigid transmission makes two coordinates one, and what is left is a tree
of links with one freedom each over the minimal coordinates z.

Deflections of connections are counted from the static equilibrium at the home pose: a machine is
aligned under its own weight, and a secant stiffness means nothing far from the load that it was
taken at. Every spring therefore carries, undeflected, the weight that hangs on it at home (with
the axes held by their motors), and a cable is stretched by it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from waferbot_lockstep.errors import UserError
from waferbot_plant.description import BASE, Connection, Description, Freedom, Transmission
from waferbot_plant.spring_curves import SpringCurve
from waferbot_plant.spring_curves import in_series as curves_in_series

Vector = NDArray[np.float64]


@dataclass
class Link:
    """
    A moving part with one freedom; `parent` is a place in the list of links, -1 for the base.

    `point` is where the freedom acts (home pose, base frame), `mass`, `first_moment` and `inertia`
    (both about that point) are those of everything fixed to the link.
    """

    freedom: Freedom
    parent: int
    point: Vector
    mass: float
    first_moment: Vector
    inertia: Vector


@dataclass(frozen=True)
class Element:
    """
    A spring between minimal coordinates: deflection = sum of ratio * z over `terms`.

    `law` has the parameters of `spring_laws` by name; those not in it have no effect. With a `curve`
    the force is that of e, and the stiffness its slope at home.
    """

    name: str
    connections: tuple[str, ...]
    terms: tuple[tuple[int, float], ...]
    stiffness: float
    damping: float
    rest: float
    pulls_only: bool
    law: Mapping[str, float] = field(default_factory=dict)
    curve: SpringCurve | None = None

    @property
    def static_force(self) -> float:
        """What the spring bears at home, undeflected: the weight, N or Nm."""
        if self.curve is not None:
            return self.curve.force(-self.rest)
        return -self.stiffness * self.rest


@dataclass(frozen=True)
class Assembly:
    """
    A machine in minimal coordinates.

    `coordinates` names z in order; `placing` gives for every coordinate of the description that
    can move its (place in z, ratio); `link_of` gives for every body the place of its link, -1 for
    one that stands still. `springs` includes the viscous dampers, as springs of no stiffness.
    """

    description: Description
    links: tuple[Link, ...]
    link_of: dict[str, int]
    coordinates: tuple[str, ...]
    placing: dict[str, tuple[int, float]]
    rotor_inertia: Vector
    springs: tuple[Element, ...]
    cables: tuple[Element, ...]

    @property
    def locked(self) -> frozenset[int]:
        """The places in z that stand still: of what is locked, and of what is tied to it rigidly."""
        names = self.description.locked
        return frozenset(self.placing[name][0] for name in names if name in self.placing)


def assemble(description: Description) -> Assembly:
    """Build the arrays of a description with its connections switched as they are."""
    links, link_of, placing, coordinates = _reduce(
        description,
        {name for name, part in description.connections.items() if part.flexible},
    )
    ropes = _heavy_ropes(description)
    coordinates += ropes
    inertia = np.append(
        _rotor_inertia(description, placing, len(coordinates) - len(ropes)), list(ropes.values())
    )
    behaviour = Behaviour(description)
    elements = [
        *_held_freedoms(description, placing, behaviour),
        *_soft_transmissions(description, placing, behaviour),
        *_dampers(description, placing),
    ]
    for cable in (element for element in elements if element.pulls_only):
        if cable.rest >= 0.0:
            raise UserError(
                f'{description.name}: cable {cable.name} is slack at the home pose; '
                'nothing hangs on the coordinate that it drives'
            )
    elements = [
        half
        for element in elements
        for half in _lengthened_and_halved(description, element, coordinates)
    ]
    return Assembly(
        description=description,
        links=tuple(links),
        link_of=link_of,
        coordinates=tuple(coordinates),
        placing=placing,
        rotor_inertia=inertia,
        springs=tuple(element for element in elements if not element.pulls_only),
        cables=tuple(element for element in elements if element.pulls_only),
    )


def build_links(description: Description, flexible: set[str]) -> tuple[list[Link], dict[str, int]]:
    """
    Return the links of the tree, parents first, and the place of every body's link among them.

    The links are those of the freedoms that `flexible` leaves; -1 is the base.
    """
    links: list[Link] = []
    link_of = {BASE: -1}
    waiting = list(description.joints.values())
    while waiting:
        joint = next(joint for joint in waiting if joint.parent in link_of)
        waiting.remove(joint)
        place = link_of[joint.parent]
        for freedom in joint.freedoms:
            if not freedom.connections or flexible.intersection(freedom.connections):
                nothing = np.zeros(3), np.zeros((3, 3))
                links.append(Link(freedom, place, joint.at, 0.0, *nothing))
                place = len(links) - 1
        link_of[joint.child] = place
    for body in description.bodies.values():
        if link_of[body.name] >= 0:
            link = links[link_of[body.name]]
            arm = body.centre_of_gravity - link.point
            link.mass += body.mass
            link.first_moment = link.first_moment + body.mass * arm
            link.inertia = (
                link.inertia
                + body.inertia
                + body.mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
            )
    return links, link_of


def _reduce(
    description: Description, flexible: set[str]
) -> tuple[list[Link], dict[str, int], dict[str, tuple[int, float]], list[str]]:
    """Return links, links of bodies, placing of every coordinate in z, and the names of z."""
    links, link_of = build_links(description, flexible)
    names = [link.freedom.name for link in links] + [
        rotor.name for rotor in description.rotors.values() if rotor.coordinate == rotor.name
    ]
    rigid = [
        transmission
        for transmission in description.transmissions.values()
        if not any(stage.connection in flexible for stage in transmission.stages)
    ]
    # a group of coordinates tied rigidly, each with its ratio to the group's first
    groups = {name: {name: 1.0} for name in names}
    for transmission in rigid:
        first, second = groups[transmission.driving], groups[transmission.driven]
        scale = first[transmission.driving] * transmission.ratio / second[transmission.driven]
        first.update({name: ratio * scale for name, ratio in second.items()})
        for name in second:
            groups[name] = first
    # a group goes by the name of an axis if it has one, then of a joint, then of a rotor
    rank = {name: place for place, name in enumerate([*description.axes.values(), *names])}
    coordinates: list[str] = []
    placing: dict[str, tuple[int, float]] = {}
    for name in names:
        group = groups[name]
        leader = min(
            group, key=lambda member: (member not in description.axes.values(), rank[member])
        )
        if leader not in coordinates:
            coordinates.append(leader)
        placing[name] = coordinates.index(leader), group[name] / group[leader]
    return links, link_of, placing, coordinates


LOCKED = 1e12
"""Inertia of a coordinate that is locked, kg or kg m2: 10 kN move it by 5 nm in a second."""


def _rotor_inertia(
    description: Description, placing: dict[str, tuple[int, float]], size: int
) -> Vector:
    """
    Return the rotors' inertia on each minimal coordinate, sum of J ratio^2 (2.21).

    What is locked has `LOCKED` there.
    """
    inertia = np.zeros(size)
    for rotor in description.rotors.values():
        place, ratio = placing[rotor.coordinate]
        inertia[place] += rotor.inertia * ratio**2
    for name in description.locked:
        if name in placing:
            place, ratio = placing[name]
            inertia[place] += LOCKED * ratio**2
    return inertia


class Behaviour:
    """
    How the elastic parts of a machine behave by themselves, whatever else is switched rigid.

    Taken from the machine at home with every connection flexible: the mass matrix, the weight on
    each coordinate, and from them each connection's stiffness, damping and first frequency.
    """

    def __init__(self, description: Description) -> None:
        self.description = description
        everything = set(description.connections)
        self.links, _, self.placing, self.coordinates = _reduce(description, everything)
        self.mass_matrix, self.weight = home_mass_matrix_and_weight(
            self.links, self.placing, len(self.coordinates), description.gravity
        )
        rotors = _rotor_inertia(description, self.placing, len(self.coordinates))
        self.mass_matrix[np.diag_indices_from(self.mass_matrix)] += rotors
        self.freedom_of = {
            connection: freedom.name
            for joint in description.joints.values()
            for freedom in joint.freedoms
            for connection in freedom.connections
        }

    def weight_on(self, coordinate: str) -> float:
        """Return the generalised force of gravity on a coordinate at home, N or Nm."""
        place, ratio = self.placing[coordinate]
        return float(self.weight[place] / ratio)

    def freedom_frequency(self, connection: Connection) -> float:
        """
        Return the first frequency of a connection in a joint, rad/s, (5.26), (5.29), (5.31).

        One mass on one spring: everything that the freedom carries, with everything else held, but
        for the coordinates that the connection says are free to follow.
        """
        place, _ = self.placing[self.freedom_of[connection.name]]
        free = [self.placing[name][0] for name in connection.free]
        inertia = self.mass_matrix[place, place]
        if free:
            coupling = self.mass_matrix[place, free]
            inertia -= coupling @ np.linalg.solve(self.mass_matrix[np.ix_(free, free)], coupling)
        return math.sqrt(connection.stiffness / inertia)

    def transmission_frequency(self, transmission: Transmission, stiffness: float) -> float:
        """
        Return the first frequency of a soft transmission, rad/s, (5.18), (5.36).

        Two masses on one spring: both ends free, everything else held. `stiffness` is that seen at
        the driven end.
        """
        ends = [self.placing[transmission.driving], self.placing[transmission.driven]]
        places = [place for place, _ in ends]
        arms = np.array([transmission.ratio * ends[0][1], -ends[1][1]])
        inertia = self.mass_matrix[np.ix_(places, places)]
        return math.sqrt(stiffness * float(arms @ np.linalg.solve(inertia, arms)))

    def first_frequencies(self) -> dict[str, float]:
        """
        Return the first frequency of every connection in Hz, the quantity of Table 6.7.

        The connections of one transmission share one: it has one pair of ends.
        """
        frequencies = {}
        for transmission in self.description.transmissions.values():
            seen = stages_seen_at_output(
                transmission, self.description.connections, set(self.description.connections)
            )
            if seen:
                total = in_series([(stiffness, 0.0) for _, stiffness in seen])[0]
                for part, _ in seen:
                    frequencies[part.name] = self.transmission_frequency(transmission, total)
        for name, part in self.description.connections.items():
            if name in self.freedom_of:
                frequencies[name] = self.freedom_frequency(part)
        return {name: frequencies[name] / (2.0 * math.pi) for name in self.description.connections}

    def damping(self, connection: Connection, stiffness: float, frequency: float) -> float:
        """Return the viscous damping of a part, structural damping by b = eta k / omega (5.5)."""
        if connection.loss_factor is None:
            return (connection.damping or 0.0) * stiffness / connection.stiffness
        return connection.loss_factor * stiffness / frequency


def home_mass_matrix_and_weight(
    links: list[Link], placing: dict[str, tuple[int, float]], size: int, gravity: Vector
) -> tuple[Vector, Vector]:
    """
    Return M (size, size) and the generalised force of gravity (size,) at the home pose.

    From the Jacobians of every body: M = sum of m J_v' J_v + J_w' I J_w, weight = sum of m J_v' g.
    Written for clearness; the compiled `multibody` is checked against it.
    """
    mass_matrix = np.zeros((size, size))
    weight = np.zeros(size)
    for own, link in enumerate(links):
        if link.mass == 0.0:
            continue
        centre = link.point + link.first_moment / link.mass
        arm = centre - link.point
        inertia = link.inertia - link.mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
        linear = np.zeros((3, size))
        angular = np.zeros((3, size))
        above = own
        while above >= 0:
            mover = links[above]
            place, ratio = placing[mover.freedom.name]
            if mover.freedom.revolute:
                angular[:, place] += ratio * mover.freedom.axis
                linear[:, place] += ratio * _cross(mover.freedom.axis, centre - mover.point)
            else:
                linear[:, place] += ratio * mover.freedom.axis
            above = mover.parent
        mass_matrix += link.mass * linear.T @ linear + angular.T @ inertia @ angular
        weight += link.mass * linear.T @ gravity
    return mass_matrix, weight


def _cross(a: Vector, b: Vector) -> Vector:
    """Return the vector product (3,); numpy's takes 20 times as long for a single one."""
    (a0, a1, a2), (b0, b1, b2) = a.tolist(), b.tolist()
    return np.array([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0])


def in_series(parts: list[tuple[float, float]]) -> tuple[float, float]:
    """
    Return stiffness and damping of spring-dampers in series, from (stiffness, damping) of each.

    1/k = sum of 1/k_j. The damping is that which loses the same energy when the parts share the
    deflection as their springs do, d = k^2 sum of d_j / k_j^2; good while omega d is small against
    k.
    """
    stiffness = 1.0 / sum(1.0 / part_stiffness for part_stiffness, _ in parts)
    damping = sum(part_damping / part_stiffness**2 for part_stiffness, part_damping in parts)
    return stiffness, stiffness**2 * damping


def law_in_series(
    parts: Sequence[tuple[Connection, float, float]], stiffness: float
) -> dict[str, float]:
    """
    Return the law of connections in series, seen as one spring of `stiffness` (see `spring_laws`).

    Of each: connection, its stiffness k_j as seen there, and its own deflection over that seen
    there, l_j (so k_j is its own times l_j^2). All carry one force; so gaps add up, gap_j / l_j,
    the weakest slips, slip_j l_j, and hardening is sum of H_j l_j^2 (k / k_j)^3, to first order. A belt
    with one strand slack has k_j / 2, which leaves 1 / (1 + k / k_j) of the slope.
    """
    law: dict[str, float] = {}
    for part, seen, lever in parts:
        if part.gap:
            law['gap'] = law.get('gap', 0.0) + part.gap / lever
        if part.hardening:
            law['hardening'] = (
                law.get('hardening', 0.0) + part.hardening * lever**2 * (stiffness / seen) ** 3
            )
        if part.slip is not None:
            law['slip'] = min(law.get('slip', math.inf), part.slip * lever)
        if part.slack_preload is not None:
            law['slack_force'] = 2.0 * part.slack_preload * lever
            law['slack_slope'] = 1.0 / (1.0 + stiffness / seen)
    return law


def curve_in_series(parts: Sequence[Connection]) -> SpringCurve | None:
    """
    Return the curve of connections in series that hold a freedom; None where none has one.

    Raises `UserError` where one follows a chart and another has a law of its own.
    """
    curves = [part.curve for part in parts if part.curve is not None]
    if not curves:
        return None
    names = ' + '.join(part.name for part in parts)
    others = [part for part in parts if part.curve is None]
    for part in others:
        if part.gap or part.hardening or part.slip is not None:
            raise UserError(
                f'{names}: in series with one that follows a chart, {part.name} must be linear'
            )
    return curves_in_series(curves, sum(1.0 / part.stiffness for part in others), names)


def _error_law(
    transmission: Transmission, driving_ratio: float, driven_ratio: float
) -> dict[str, float]:
    """Return the law of a transmission error, as a wave over the minimal coordinate."""
    error = transmission.error
    if error is None:
        return {}
    return {
        'error_amplitude': error.amplitude,
        'error_wave': error.order * (driven_ratio if error.of_driven else driving_ratio),
        'error_phase': error.phase,
        'error_of_driven': float(error.of_driven),
    }


def _heavy_ropes(description: Description) -> dict[str, float]:
    """
    Return the coordinates of cables that have mass, with it, kg.

    A rope's coordinate is the motion of its middle along itself, towards the driving end, so that the
    driven coordinate moves by as much as long as nothing stretches.
    """
    return {
        f'{transmission.name}_rope': description.connections[stage.connection].rope_mass
        for transmission in description.transmissions.values()
        for stage in transmission.stages
        if transmission.pulls_only
        and stage.connection is not None
        and description.connections[stage.connection].rope_mass > 0.0
        and giving_connections(description, [stage.connection])
    }


def _lengthened_and_halved(
    description: Description, element: Element, coordinates: list[str]
) -> list[Element]:
    """
    Return a cable with its slack; in two halves, each twice as stiff, if the rope has mass.

    All other elements are returned as they are. The rope's weight is left out: it hangs on both
    sides of its pulley.
    """
    if not element.pulls_only:
        return [element]
    slack = sum(description.connections[name].slack for name in element.connections)
    whole = replace(element, rest=element.rest + slack)
    rope = f'{element.name}_rope'
    if rope not in coordinates:
        return [whole]
    place = coordinates.index(rope)
    half = replace(
        whole, stiffness=2.0 * whole.stiffness, damping=2.0 * whole.damping, rest=0.5 * whole.rest
    )
    return [
        replace(
            half, name=f'{element.name} (driving half)', terms=(whole.terms[0], (place, -1.0))
        ),
        replace(half, name=f'{element.name} (driven half)', terms=((place, 1.0), whole.terms[1])),
    ]


def giving_connections(description: Description, names: Iterable[str]) -> set[str]:
    """Return those of some connections in series that give: the flexible ones."""
    return {name for name in names if description.connections[name].flexible}


def _held_freedoms(
    description: Description,
    placing: dict[str, tuple[int, float]],
    behaviour: Behaviour,
) -> list[Element]:
    """Return the springs of the freedoms that are held by flexible connections."""
    elements = []
    for joint in description.joints.values():
        for freedom in joint.freedoms:
            giving = giving_connections(description, freedom.connections)
            soft = [
                description.connections[name] for name in freedom.connections if name in giving
            ]
            if soft:
                stiffness, damping = in_series(
                    [
                        (
                            part.stiffness,
                            behaviour.damping(
                                part, part.stiffness, behaviour.freedom_frequency(part)
                            ),
                        )
                        for part in soft
                    ]
                )
                names = tuple(part.name for part in soft)
                weight = behaviour.weight_on(freedom.name)
                rest = -weight / stiffness
                curve = curve_in_series(soft)
                if curve is not None:
                    rest = -curve.deflection(weight)
                    stiffness = curve.slope(rest)
                term = placing[freedom.name]
                elements.append(
                    Element(
                        freedom.name,
                        names,
                        (term,),
                        stiffness,
                        damping,
                        rest,
                        False,
                        law_in_series([(part, part.stiffness, 1.0) for part in soft], stiffness),
                        curve,
                    )
                )
    return elements


def stages_seen_at_output(
    transmission: Transmission, connections: Mapping[str, Connection], flexible: set[str]
) -> list[tuple[Connection, float]]:
    """
    Return the flexible connections of a transmission with their stiffness seen at its driven end.

    A stage deflects by `lever` times its motion out, so that it has the stiffness k lever^2 there;
    a following stage of ratio r makes it k lever^2 / r^2.
    """
    seen = []
    following = 1.0
    for stage in reversed(transmission.stages):
        if stage.connection in flexible:
            part = connections[stage.connection]
            seen.append((part, part.stiffness * stage.lever**2 / following**2))
        following *= stage.ratio
    return seen[::-1]


def _soft_transmissions(
    description: Description,
    placing: dict[str, tuple[int, float]],
    behaviour: Behaviour,
) -> list[Element]:
    """Return the springs of the transmissions that give: deflection = ratio * driving - driven."""
    elements = []
    for transmission in description.transmissions.values():
        stages = [stage.connection for stage in transmission.stages if stage.connection]
        giving = giving_connections(description, stages)
        seen = stages_seen_at_output(transmission, description.connections, giving)
        if not seen:
            continue
        total = in_series([(stiffness, 0.0) for _, stiffness in seen])[0]
        frequency = behaviour.transmission_frequency(transmission, total)
        stiffness, damping = in_series(
            [
                (stiffness, behaviour.damping(part, stiffness, frequency))
                for part, stiffness in seen
            ]
        )
        driving, driving_ratio = placing[transmission.driving]
        driven, driven_ratio = placing[transmission.driven]
        elements.append(
            Element(
                transmission.name,
                tuple(part.name for part, _ in seen),
                ((driving, transmission.ratio * driving_ratio), (driven, -driven_ratio)),
                stiffness,
                damping,
                behaviour.weight_on(transmission.driven) / stiffness,
                transmission.pulls_only,
                {
                    **law_in_series(
                        [
                            (part, stiffness_there, math.sqrt(stiffness_there / part.stiffness))
                            for part, stiffness_there in seen
                        ],
                        stiffness,
                    ),
                    **_error_law(transmission, driving_ratio, driven_ratio),
                },
            )
        )
    return elements


def _dampers(description: Description, placing: dict[str, tuple[int, float]]) -> list[Element]:
    """Return the viscous dampers, as springs without stiffness."""
    return [
        Element(damper.name, (), (placing[damper.coordinate],), 0.0, damper.damping, 0.0, False)
        for damper in description.dampers.values()
    ]
