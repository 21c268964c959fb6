# SPDX-License-Identifier: Apache-2.0
"""
Where a run leaves the range in which the model holds, and what its parts bear.

    watch = Watch(machine)
    watch.note(loads)                  # as they come, see `loads`
    watch.departures()                 # what left its range: place, amount, when first and worst

| place | amount | range |
|---|---|---|
| belt | tension of the slack span, F_pre - F/2 | above 0: the pretension is enough, teeth do not climb |
| belt | tension of the tight span | up to what the maker allows |
| flat belt, belt with `slip_force_n` | effective pull F | up to where it slips: `belt.slip_pull_n` |
| cable | tension of one rope | above the least that bends it around its pulley; at 0 it is slack |
| guide | load on a block, F +- abs(M - M_0)/(2 b) | secant's range (1 +- gamma) F (5.22); the chart |
| cross-roller bearing | radial load, moment | likewise |
| motor | temperature of the windings | up to what the insulation bears |

Loads are those of springs, so a rigid connection has none: what a rigid model asks of its parts is not
told. The two moments on a guide are added as if their peaks fell together: blocks bear that at most.
A block at the chart's end is beyond the supplier's data, one outside the secant's range has another
stiffness than the one that the model has; what follows the chart (`stiffness_by`) has no such range.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from waferbot_lockstep.timing import Timing
from waferbot_plant.assembly import Element
from waferbot_plant.description import Connection, Stage, Transmission
from waferbot_plant.loads import CABLES, SPRINGS, Loads
from waferbot_plant.parts import belt, cable
from waferbot_plant.parts.belt import Belt
from waferbot_plant.parts.cable import Cable
from waferbot_plant.parts.cross_roller_bearing import CrossRollerBearing
from waferbot_plant.parts.linear_bearing import LinearBearing
from waferbot_plant.plant import Machine

Amount = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Least and greatest amount (n,) between two messages."""


@dataclass(frozen=True)
class Check:
    """
    What is looked at: the place, what of it in which unit, and between which limits it may be.

    `why` says what is beyond them.
    """

    place: str
    what: str
    unit: str
    least: float
    most: float
    why: str

    @property
    def limits(self) -> str:
        """The limits as text."""
        if np.isinf(self.most):
            return f'at least {self.least:.4g} {self.unit}'
        if np.isinf(self.least):
            return f'at most {self.most:.4g} {self.unit}'
        return f'{self.least:.4g} to {self.most:.4g} {self.unit}'


@dataclass
class Extremes:
    """
    What came of a check: least and greatest amount, and the ticks of them; first tick out of range.

    A tick of -1: never. Times are those of the messages, 10 ms apart.
    """

    check: Check
    low: float = np.inf
    high: float = -np.inf
    low_tick: int = -1
    high_tick: int = -1
    first_tick: int = -1

    def note(self, tick: NDArray[np.int64], low: NDArray, high: NDArray) -> None:
        """Take more amounts in."""
        if len(tick) == 0:
            return
        outside = np.flatnonzero((low < self.check.least) | (high > self.check.most))
        if self.first_tick < 0 and len(outside):
            self.first_tick = int(tick[outside[0]])
        place = int(np.argmin(low))
        if low[place] < self.low:
            self.low, self.low_tick = float(low[place]), int(tick[place])
        place = int(np.argmax(high))
        if high[place] > self.high:
            self.high, self.high_tick = float(high[place]), int(tick[place])

    @property
    def outside(self) -> bool:
        """Whether the range was left."""
        return self.first_tick >= 0

    @property
    def worst(self) -> tuple[float, int]:
        """
        Return the amount farthest out of the range, or nearest to its end, and its tick.

        Of two that are equally far (a bearing's load more and less by as much) the greater one.
        """
        below, above = self.check.least - self.low, self.high - self.check.most
        if below > above and not np.isclose(below, above):
            return self.low, self.low_tick
        return self.high, self.high_tick

    def amount_text(self) -> str:
        """Return place and worst amount with the limits."""
        check, amount = self.check, self.worst[0]
        return f'{check.place}: {check.what} {amount:.4g} {check.unit} ({check.limits})'

    def text(self, timing: Timing) -> str:
        """Return place, amount and times of a range that was left, as one line."""
        return (
            f'{self.amount_text()} at {timing.seconds(self.worst[1]):.3f} s, first left at '
            f'{timing.seconds(self.first_tick):.3f} s: {self.check.why}'
        )


@dataclass
class Watch:
    """Keeps the extremes of all checks of a machine; `note` takes loads in as they come."""

    machine: Machine
    _found: list[tuple[Extremes, Callable[[Loads], Amount]]] = field(init=False)

    def __post_init__(self) -> None:
        """Find what the machine's parts can be checked for."""
        self._found = [(Extremes(check), measure) for check, measure in checks_of(self.machine)]

    def note(self, loads: Loads) -> None:
        """Take loads in."""
        for extremes, measure in self._found:
            extremes.note(loads.tick, *measure(loads))

    def forget(self) -> None:
        """Begin anew."""
        self.__post_init__()

    def extremes(self) -> list[Extremes]:
        """Return what came of every check so far; none of those that nothing was noted for."""
        return [found for found, _ in self._found if found.low_tick >= 0]

    def departures(self) -> list[Extremes]:
        """Return those whose range was left."""
        return [found for found in self.extremes() if found.outside]


def checks_of(machine: Machine) -> Iterator[tuple[Check, Callable[[Loads], Amount]]]:
    """Yield what the parts of a machine can be checked for, with how it is measured."""
    connections = machine.description.connections
    for place, element in enumerate(machine.assembly.springs[:SPRINGS]):
        for name in element.connections:
            yield from _belt_checks(machine, place, element, connections[name])
    for place, element in enumerate(machine.assembly.cables[:CABLES]):
        for name in element.connections:
            yield from _cable_checks(place, element, connections[name])
    for part_name, part in machine.description.parts.items():
        springs = _springs_of_part(machine, part)
        if isinstance(part, LinearBearing):
            yield from _guide_checks(part_name, part, springs)
        elif isinstance(part, CrossRollerBearing):
            yield from _ring_checks(part_name, part, springs)
    for place, axis in enumerate(machine.layout.axes):
        motor = machine.description.motors.get(axis)
        limit = motor.heating.limit if motor is not None and motor.heating is not None else None
        if limit is not None:
            yield _temperature_check(axis, place, float(limit))


# --- belt -------------------------------------------------------------------------------------------


def _belt_checks(
    machine: Machine, place: int, element: Element, connection: Connection
) -> Iterator[tuple[Check, Callable[[Loads], Amount]]]:
    part = connection.part
    stage, following = _stage_of(machine, connection.name)
    if not isinstance(part, Belt) or stage is None:
        return
    # The element's force is that at the driven end; a stage's is as much as it is faster there.
    per_force = following / stage.lever

    def pull(loads: Loads) -> Amount:
        ends = per_force * loads.spring_least[:, place], per_force * loads.spring_most[:, place]
        return np.zeros(len(loads.tick)), np.maximum(np.abs(ends[0]), np.abs(ends[1]))

    def slack_span(loads: Loads) -> Amount:
        slack = part.span_pretension_n - 0.5 * pull(loads)[1]
        return slack, np.full_like(slack, part.span_pretension_n)

    def tight_span(loads: Loads) -> Amount:
        tight = np.array([belt.span_tensions_n(part, one)[0] for one in pull(loads)[1].tolist()])
        return np.full_like(tight, part.span_pretension_n), tight

    yield (
        Check(
            connection.name,
            'tension of the slack span',
            'N',
            0.0,
            np.inf,
            'the pretension is not enough: a span is slack, teeth can climb',
        ),
        slack_span,
    )
    if part.allowed_span_tension_n is not None:
        yield (
            Check(
                connection.name,
                'tension of the tight span',
                'N',
                -np.inf,
                part.allowed_span_tension_n,
                'more than the belt is allowed',
            ),
            tight_span,
        )
    slip = min(
        belt.slip_pull_n(part) if part.friction_coefficient is not None else np.inf,
        np.inf if connection.slip is None else connection.slip,
    )
    if np.isfinite(slip):
        yield (
            Check(connection.name, 'pull', 'N', -np.inf, slip, 'the belt slips'),
            pull,
        )


def _stage_of(machine: Machine, connection: str) -> tuple[Stage | None, float]:
    """Return the stage that a connection is in, and the ratio of the stages behind it."""
    for transmission in machine.description.transmissions.values():
        found = _stage_within(transmission, connection)
        if found is not None:
            return found
    return None, 1.0


def _stage_within(transmission: Transmission, connection: str) -> tuple[Stage, float] | None:
    following = 1.0
    for stage in reversed(transmission.stages):
        if stage.connection == connection:
            return stage, following
        following *= stage.ratio
    return None


# --- cable ------------------------------------------------------------------------------------------


def _cable_checks(
    place: int, element: Element, connection: Connection
) -> Iterator[tuple[Check, Callable[[Loads], Amount]]]:
    part = connection.part
    ropes = float(part.number_of_cables) if isinstance(part, Cable) else 1.0
    least = cable.least_tension_n(part) if isinstance(part, Cable) else 0.0

    def tension(loads: Loads) -> Amount:
        return loads.cable_least[:, place] / ropes, loads.cable_most[:, place] / ropes

    yield (
        Check(
            element.name,
            'tension of a rope',
            'N',
            float(np.nextafter(least, np.inf)),  # at zero it is slack
            np.inf,
            'it is slack at 0, and below the limit does not bend around its pulley',
        ),
        tension,
    )


# --- bearings ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Spring:
    """Where the load of a bearing in one direction is found, and what hangs on it at home (N, Nm)."""

    place: int
    static: float
    by_chart: bool

    def departure(self, loads: Loads) -> NDArray[np.float64]:
        """Return the greatest distance of the load from the static one, N or Nm."""
        least, most = loads.spring_least[:, self.place], loads.spring_most[:, self.place]
        return np.maximum(np.abs(least - self.static), np.abs(most - self.static))

    def greatest(self, loads: Loads) -> NDArray[np.float64]:
        """Return the greatest magnitude of the load, N or Nm."""
        least, most = loads.spring_least[:, self.place], loads.spring_most[:, self.place]
        return np.maximum(np.abs(least), np.abs(most))


def _springs_of_part(machine: Machine, part: object) -> dict[str, _Spring]:
    """Return the springs that hold a part's directions and give, by direction."""
    found = {}
    for place, element in enumerate(machine.assembly.springs[:SPRINGS]):
        for name in element.connections:
            connection = machine.description.connections[name]
            if connection.part is part and connection.direction:
                by_chart = connection.curve is not None
                found[connection.direction] = _Spring(place, element.static_force, by_chart)
    return found


def _about(
    springs: Iterable[tuple[_Spring | None, float]],
) -> Callable[[Loads], NDArray[np.float64]]:
    """Return what gives the departures of several springs, each divided by its arm, added up."""
    present = [(spring, arm) for spring, arm in springs if spring is not None]

    def departure(loads: Loads) -> NDArray[np.float64]:
        return sum((spring.departure(loads) / arm for spring, arm in present), np.zeros(1))

    return departure


def _guide_checks(
    name: str, part: LinearBearing, springs: dict[str, _Spring]
) -> Iterator[tuple[Check, Callable[[Loads], Amount]]]:
    """Yield the checks of the load on a block: M = F b / 2 for each of four, so F = M / (2 b)."""
    about_x, about_y, about_z = (springs.get(f'about_{axis}') for axis in 'xyz')
    vertical, horizontal = 2.0 * part.vertical_spacing_m, 2.0 * part.horizontal_spacing_m
    charts = (part.radial, part.reverse)
    if about_z is not None:
        yield from _load_checks(
            f'{name} block',
            'radial load',
            'N',
            abs(about_z.static) / vertical,
            _about([(about_z, vertical), (about_y, horizontal)]),
            None if about_z.by_chart else part.load_variability,
            min(chart.load_n[-1] for chart in charts),
        )
    if about_x is not None:
        yield from _load_checks(
            f'{name} block',
            'transverse load',
            'N',
            abs(about_x.static) / vertical,
            _about([(about_x, vertical)]),
            None if about_x.by_chart else part.load_variability,
            part.transverse.load_n[-1],
        )


def _ring_checks(
    name: str, part: CrossRollerBearing, springs: dict[str, _Spring]
) -> Iterator[tuple[Check, Callable[[Loads], Amount]]]:
    """Yield the checks of radial load and moment of a cross-roller bearing."""
    radial, about_y, about_z = (springs.get(key) for key in ('radial_y', 'about_y', 'about_z'))
    if radial is not None:
        yield from _load_checks(
            name,
            'radial load',
            'N',
            abs(radial.static),
            _about([(radial, 1.0)]),
            None if radial.by_chart else part.load_variability,
            part.radial.load_n[-1],
        )
    if about_z is not None:

        def moment(loads: Loads) -> NDArray[np.float64]:
            """Return by how much the moment is more, about z and y together, Nm."""
            across = np.zeros(1) if about_y is None else about_y.greatest(loads)
            return np.hypot(about_z.departure(loads), across)

        yield from _load_checks(
            name,
            'moment',
            'Nm',
            abs(about_z.static),
            moment,
            None if about_z.by_chart else part.load_variability,
            part.moment.moment_nm[-1],
        )


def _load_checks(
    place: str,
    what: str,
    unit: str,
    static: float,
    departure: Callable[[Loads], NDArray[np.float64]],
    variability: float | None,
    chart_end: float,
) -> Iterator[tuple[Check, Callable[[Loads], Amount]]]:
    """
    Yield the checks of a bearing's load against the range of its secant (5.22) and its chart.

    The former only where there is a secant: with `variability`.
    """

    def amount(loads: Loads) -> Amount:
        away = departure(loads)
        return static - away, static + away

    if variability is not None:
        yield (
            Check(
                place,
                what,
                unit,
                (1.0 - variability) * static,
                (1.0 + variability) * static,
                'outside of the range that its secant stiffness is taken over (5.22)',
            ),
            amount,
        )
    yield (
        Check(
            place,
            f'{what} beside the chart',
            unit,
            -np.inf,
            chart_end,
            "beyond the last point of the supplier's chart",
        ),
        amount,
    )


# --- motors -----------------------------------------------------------------------------------------


def _temperature_check(
    axis: str, place: int, limit: float
) -> tuple[Check, Callable[[Loads], Amount]]:
    def temperature(loads: Loads) -> Amount:
        return loads.temperature[:, place], loads.temperature[:, place]

    check = Check(
        f'motor {axis}',
        'temperature of the windings',
        'degC',
        -np.inf,
        limit,
        'more than the insulation bears',
    )
    return check, temperature
