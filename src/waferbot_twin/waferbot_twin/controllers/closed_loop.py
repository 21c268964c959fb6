# SPDX-License-Identifier: Apache-2.0
"""
The closed loop of a plant and described controllers, compiled, without any noise.

Within a tick: encoders are read; controllers compute, where it is a cycle of theirs; the plant moves on
under what they put out `delay` ago, held until the next output takes its place. The drive does what it
is told, at once or with the lag of its motor (`motors.lag_step`). An axis without a
controller stands still. Controllers see what
encoders show at that tick (later by what an encoder is late beyond the others), in the whole steps in
which the log counts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from waferbot_lockstep.compiled import compiled
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.timing import Timing
from waferbot_plant import encoders, motors, plant
from waferbot_twin.controllers import law
from waferbot_twin.effects import places
from waferbot_twin.effects.variant import Variant, built

Array = NDArray[np.float64]

LOOK_TICKS = 180
"""Ticks between two looks whether the plant blew up."""


@dataclass(frozen=True)
class Counting:
    """
    How each encoder's readings become steps, by its place.

    `step` in counts, 0 where readings are not counted in steps; `down` (0 or 1) whether they are rounded
    down rather than to the nearest.
    """

    step: Array
    down: Array


@dataclass(frozen=True)
class Begin:
    """
    How the axes begin (axes,): m or rad, m/s or rad/s, and two currents in A.

    `integral` is what integrators make of the output, `current` what was put out before it all.
    """

    position: Array
    velocity: Array
    integral: Array
    current: Array


@dataclass(frozen=True)
class Run:
    """
    Signals of a run without noise.

    seen      (rows, encoders) counts that encoders see at encoder ticks, without steps, not yet
    published speed     (rows, encoders) counts per second, of that current   (ticks, axes) A, what
    drives are told over each tick command   (cycles, axes) A, what controllers computed
    """

    seen: Array
    speed: Array
    current: Array
    command: Array


def run(
    variant: Variant, timing: Timing, commanded: Array, begin: Begin, counting: Counting
) -> Run:
    """
    Run the closed loop of a variant over commanded positions (cycles, axes), m or rad.

    The servo of `timing` is the fastest of the described controllers. Raises `UserError` if the loop is
    unstable.
    """
    description, layout = variant.description, variant.layout
    axes, encoder_places = len(layout.axes), len(layout.encoders)
    controllers = description.controllers
    machine = built(variant, timing)
    parameters = machine.parameters()
    there = {
        axis: float(begin.position[place])
        for place, axis in enumerate(layout.axes)
        if axis in description.axes
    }
    state = machine.initial_state(parameters, there, holding=True)
    _set_off(state, variant, machine.coordinates, begin.velocity)
    amperes = np.array(
        [places.amperes_per_output(variant, a) if a in controllers else 0.0 for a in layout.axes]
    )
    delays = [timing.ticks(controllers[a].delay) if a in controllers else 0 for a in layout.axes]
    laws = law.law_parameters(controllers, layout.axes)
    ticks = len(commanded) * timing.servo_divider
    rows = ticks // timing.encoder_divider
    result = Run(
        np.zeros((rows, encoder_places)),
        np.zeros((rows, encoder_places)),
        np.zeros((ticks, axes)),
        np.zeros(commanded.shape),
    )
    integral = np.divide(begin.integral, amperes, out=np.zeros(axes), where=amperes != 0.0)
    tick, coordinate = _advance(
        state,
        parameters,
        law.initial_state(laws),
        laws,
        np.ascontiguousarray(commanded),
        begin.velocity,
        integral,
        begin.current,
        amperes,
        np.array(delays),
        places.drive_lags(variant),
        timing.tick_s,
        timing.servo_divider,
        timing.encoder_divider,
        places.counts_per_unit(variant),
        np.array(places.encoder_places(variant)),
        description.encoder_delay,
        counting.step,
        counting.down,
        _standing(variant, parameters[0], len(machine.coordinates)),
        np.zeros(3 * axes),
        result.seen,
        result.speed,
        result.current,
        result.command,
    )
    if coordinate >= 0:
        raise UserError(f'{variant.name}: {machine.runaway_message(coordinate, tick)}')
    return result


def _set_off(
    state: np.ndarray, variant: Variant, coordinates: tuple[str, ...], velocity: Array
) -> None:
    """Give all that moves with each axis, as long as nothing gives, the axis' velocity."""
    placing = variant.rigid.placing
    for place, axis in enumerate(variant.layout.axes):
        if axis not in variant.base.description.axes:
            continue
        what, own = placing[places.coordinate(variant, axis)]
        for row, name in enumerate(coordinates):
            if name in placing and placing[name][0] == what:
                state[0]['velocity'][row] += placing[name][1] / own * velocity[place]


def _standing(variant: Variant, p: np.void, coordinates: int) -> NDArray[np.bool_]:
    """Return which coordinates are those of an axis without a controller: it stands where it is."""
    description = variant.description
    standing = np.zeros(coordinates, np.bool_)
    for place, axis in enumerate(description.layout.axes):
        if axis in description.axes and axis not in description.controllers:
            standing[p['axis_coordinate'][place]] = True
            if axis in description.motors:
                standing[p['motor_coordinate'][place]] = True
    return standing


@compiled
def in_steps(seen, step, down):
    """Return counts in whole steps, rounded down or to the nearest; as they are if `step` is 0."""
    if step == 0.0:
        return seen
    return step * np.floor(seen / step + 0.5 * (1.0 - down))


@compiled
def _advance(
    state,
    parameters,
    law_state,
    law_parameters,
    commanded,
    velocity,
    integral,
    current,
    amperes,
    delays,
    lags,
    tick_s,
    divider,
    encoder_divider,
    per_unit,
    feedback,
    common_delay,
    count_step,
    down,
    standing,
    no_voltage,
    seen_out,
    speed_out,
    current_out,
    command_out,
):
    """
    Run the loop; fill the arrays of `Run`. Returns tick and coordinate of a runaway, or the end and -1.

    `velocity`, `integral` (in units of the output) and `current` (axes,) as in `Begin`; `amperes`
    (axes,) per unit of the output; `standing` (n,) coordinates that do not move; `delays` (axes,) ticks;
    `lags` (axes,) s; `per_unit` (axes,) counts of the encoders in `feedback` (axes,); `count_step`,
    `down` (encoders,) as `Counting` has them.
    """
    s = state[0]
    p = parameters[0]
    axes = len(per_unit)
    position = np.zeros(axes)
    output = np.zeros(axes)
    start = s['position'].copy()
    acting = current.copy()
    for motor in range(len(p['winding'])):
        s['terminals_open'][motor] = 1
    for axis in range(axes):
        for tick in range(min(delays[axis], len(current_out))):
            current_out[tick, axis] = current[axis]
    for tick in range(len(current_out)):
        row = tick // encoder_divider
        for encoder in range(seen_out.shape[1]):
            counts = p['counts_per_unit'][encoder]
            if counts != 0.0 and tick % encoder_divider == 0:
                seen_out[row, encoder] = encoders.seen_counts(s, p, encoder)
                speed = s['velocity'][p['encoder_coordinate'][encoder]]
                speed_out[row, encoder] = counts * speed
        if tick % divider == 0:
            cycle = tick // divider
            for axis in range(axes):
                by = feedback[axis]
                later = p['encoder_delay'][by] - common_delay
                own = count_step[by]
                if p['coarseness'][by] > 1.0:
                    own = max(own, p['coarseness'][by])
                seen = in_steps(seen_out[max(row - later, 0), by], own, down[by])
                position[axis] = seen / per_unit[axis]
            if cycle == 0:
                law.prime(law_state, law_parameters, commanded[0], position, velocity, integral)
            law.step(law_state, law_parameters, commanded[cycle], position, output)
            for axis in range(axes):
                command_out[cycle, axis] = output[axis] * amperes[axis]
                first = tick + delays[axis]
                for held in range(first, min(first + divider, len(current_out))):
                    current_out[held, axis] = command_out[cycle, axis]
        for driven in range(len(s['external_force'])):
            s['external_force'][driven] = 0.0
        for motor in range(len(p['winding'])):
            if p['winding'][motor] == motors.NONE:
                continue
            coordinate = p['motor_coordinate'][motor]
            ratio = p['motor_ratio'][motor]
            middle = s['position'][coordinate] + 0.5 * p['step'] * s['velocity'][coordinate]
            angle = p['electrical_gain'][motor] * ratio * middle
            told = current_out[tick, motor]
            mean, acting[motor] = motors.lag_step(told, acting[motor], lags[motor], tick_s)
            force = motors.force_at_angle(p, motor, angle, mean, 0.0)
            s['external_force'][coordinate] += ratio * force
        if tick % LOOK_TICKS == 0:
            coordinate = plant.runaway(state)
            if coordinate >= 0:
                return tick, coordinate
        plant.advance(state, parameters, no_voltage)
        for coordinate in range(len(standing)):
            if standing[coordinate]:
                s['position'][coordinate] = start[coordinate]
                s['velocity'][coordinate] = 0.0
    return len(current_out), -1
