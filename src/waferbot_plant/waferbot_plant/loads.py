# SPDX-License-Identifier: Apache-2.0
"""
What the elastic parts bear: forces of springs, tensions of cables, temperatures of windings.

    loads = begin(motors)
    note(state, parameters, loads)        # at every servo interrupt
    take(state, parameters, loads, row)   # at a message: writes it, begins anew

`loads` and `row` are float64 (width(motors),) in the order of the message `PlantState`: least and
greatest of each spring since the last message (N, Nm), least and greatest of each cable (N),
temperatures (degC), and the payload frame as it is then (`payload`). None of it goes back into the
plant.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from waferbot_lockstep.compiled import compiled
from waferbot_plant import payload
from waferbot_plant.elements import cable_elongation
from waferbot_plant.spring_laws import force_and_arms_now

SPRINGS = 24
CABLES = 4
"""Places in the message; of a larger machine the first so many."""

_SPRING_MOST = SPRINGS
_CABLE_LEAST = 2 * SPRINGS
_CABLE_MOST = _CABLE_LEAST + CABLES
_TEMPERATURE = _CABLE_MOST + CABLES


def width(motors: int) -> int:
    """Return the number of values of the message, of a machine with places for so many motors."""
    return _TEMPERATURE + motors + payload.WIDTH


def begin(motors: int) -> NDArray[np.float64]:
    """Return loads of which nothing has been noted yet."""
    loads = np.zeros(width(motors))
    _forget(loads)
    return loads


@compiled
def note(state, parameters, loads):
    """
    Take the present forces into `loads`.

    A spring: that of its law and damper (5.4). A cable, Appendix C of the thesis: k e and d e', the
    latter at most k e; zero when slack.
    """
    s = state[0]
    p = parameters[0]
    position = s['position']
    velocity = s['velocity']
    for spring in range(min(p['springs'], SPRINGS)):
        force, _, _ = force_and_arms_now(s, p, spring, position, velocity)
        loads[spring] = min(loads[spring], force)
        loads[_SPRING_MOST + spring] = max(loads[_SPRING_MOST + spring], force)
    for cable in range(min(p['cables'], CABLES)):
        tension = _tension(p, cable, position, velocity)
        loads[_CABLE_LEAST + cable] = min(loads[_CABLE_LEAST + cable], tension)
        loads[_CABLE_MOST + cable] = max(loads[_CABLE_MOST + cable], tension)


@compiled
def take(state, parameters, loads, row):
    """Take the present forces in too, write all into `row`, and begin anew."""
    note(state, parameters, loads)
    p = parameters[0]
    springs = min(p['springs'], SPRINGS)
    cables = min(p['cables'], CABLES)
    row[:] = 0.0
    for start in (0, _SPRING_MOST):
        for spring in range(springs):
            row[start + spring] = loads[start + spring]
    for start in (_CABLE_LEAST, _CABLE_MOST):
        for cable in range(cables):
            row[start + cable] = loads[start + cable]
    motors = len(p['winding'])
    for motor in range(motors):
        row[_TEMPERATURE + motor] = state[0]['winding_temperature'][motor]
    payload.payload_frame(state[0], p, row[_TEMPERATURE + motors :])
    _forget(loads)


@compiled
def _tension(p, cable, position, velocity):
    """Return the tension of a cable at one instant, N."""
    spring = p['cable_stiffness'][cable] * cable_elongation(p, cable, position)
    if spring <= 0.0:
        return 0.0
    rate = (
        p['cable_first_ratio'][cable] * velocity[p['cable_first'][cable]]
        + p['cable_second_ratio'][cable] * velocity[p['cable_second'][cable]]
    )
    return spring + min(max(p['cable_damping'][cable] * rate, -spring), spring)


@compiled
def _forget(loads):
    """Begin with nothing noted."""
    loads[:_SPRING_MOST] = np.inf
    loads[_SPRING_MOST:_CABLE_LEAST] = -np.inf
    loads[_CABLE_LEAST:_CABLE_MOST] = np.inf
    loads[_CABLE_MOST:_TEMPERATURE] = -np.inf


def fields(rows: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Return rows (n, width) as the fields of the message, (n, ...) each."""
    frame = rows.shape[1] - payload.WIDTH
    edges = (
        *(_SPRING_MOST, _CABLE_LEAST, _CABLE_MOST, _TEMPERATURE, frame),
        *(frame + place for place in (3, 7, 10, 13, 16, 19)),
    )
    return np.split(rows, edges, axis=1)


@dataclass(frozen=True)
class Loads:
    """
    Loads at ticks (n,): of springs (n, SPRINGS) in N or Nm, of cables (n, CABLES) in N, least and
    greatest since the tick before; temperatures of the windings (n, motors) in degC.
    """

    tick: NDArray[np.int64]
    spring_least: NDArray[np.float64]
    spring_most: NDArray[np.float64]
    cable_least: NDArray[np.float64]
    cable_most: NDArray[np.float64]
    temperature: NDArray[np.float64]

    @classmethod
    def of_rows(cls, tick: NDArray[np.int64], rows: NDArray[np.float64]) -> Loads:
        """Return the loads in rows (n, width) that `take` wrote, without those that nobody wrote."""
        written = np.isfinite(rows).all(axis=1)
        return cls(np.asarray(tick)[written], *fields(rows[written])[:5])
