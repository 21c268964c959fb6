# SPDX-License-Identifier: Apache-2.0
"""
The plant alone: driven by measured currents, held to measured positions, what is left over.

Double integrators drift, so a plant that is only driven by measured currents soon is nowhere near the
measurement. Here every reading y of an encoder corrects the simulated coordinate x a little, as a
Luenberger observer does,

    e = y - c x        x += l1 e / c        x' += l2 e / c        l1 = 2 z w h, l2 = w^2 h

with c counts per unit, h the time between readings, w and z the observer's frequency and damping. The
innovation e, in counts, is the block's residual. A force F that the model lacks appears in it as
c F / (M (s^2 + 2 z w s + w^2)): below w it is a picture of the force itself, so w is chosen above what
moves the machine. Whitening takes out what w and z were; all models that are compared have the same.

What moves together as long as nothing gives is corrected together, by its first encoder: a carriage with
its counterweight, an axis with its motor. A model in which a stiff connection gives is therefore held as
the rigid one is, and no correction stretches a spring.

Currents make force as the model's motor says, at the simulated electrical angle, and are measured as the
model's sensors say; positions are seen as its encoders see them, without their noise.
"""

from __future__ import annotations

import math

import numpy as np

from waferbot_lockstep.compiled import compiled
from waferbot_lockstep.contract import ENCODERS
from waferbot_lockstep.errors import UserError
from waferbot_plant import current_sensors, encoders, motors, plant
from waferbot_plant.plant import Machine
from waferbot_twin.diagnosis.record import Array, Record
from waferbot_twin.effects.host import compact
from waferbot_twin.effects.variant import Variant

OBSERVER_RAD_S = 2.0 * math.pi * 80.0
OBSERVER_DAMPING = 0.7

FLOOR_COUNTS = 0.2
"""Smallest standard deviation of a reading: whole counts are uniform over one, 0.29."""

SETTLING_S = 0.02
"""What is left out at the beginning of a log: there the observer takes hold."""

LONGEST_DELAY = 32


class PlantBlock:
    """The plant's residual of one log, for any variant of the model."""

    order = 24
    """Forces that shake the machine are coloured."""

    def __init__(self, record: Record, variant: Variant) -> None:
        """Prepare what does not depend on the values of the model."""
        self.record = record
        self._rigid = variant.rigid.placing
        timing = record.timing
        self.averaged = timing.servo_divider // timing.encoder_divider
        self.first_cycle = round(max(SETTLING_S, record.judged_from_s) * timing.servo_hz)
        self._places = [
            place
            for place, name in enumerate(ENCODERS)
            if name in variant.description.encoders
            and np.isfinite(record.reading[:, place]).mean() > 0.5
        ]
        self.channels = [ENCODERS[place] for place in self._places]
        self.floors = [FLOOR_COUNTS / math.sqrt(self.averaged)] * len(self._places)

    def residuals(self, variant: Variant) -> list[Array]:
        """
        Return the innovation of every encoder of the log, counts, at the servo's rate.

        Raises `UserError` if the simulation blows up.
        """
        record = self.record
        machine = compact(variant).build(record.timing)
        parameters = machine.parameters()
        state = machine.resting_state(parameters)
        p = parameters[0]
        step_s = record.timing.encoder_divider * record.timing.tick_s
        together = self._together(machine, p)
        gains = np.zeros((2, *together.shape))
        gains[0] = 2.0 * OBSERVER_DAMPING * OBSERVER_RAD_S * step_s * together
        gains[1] = OBSERVER_RAD_S**2 * step_s * together
        self._stand_where_measured(state, parameters, together, step_s)
        innovation = np.zeros_like(record.reading)
        blown_up = _drive(
            state,
            parameters,
            record.line_current,
            0.5 if record.whole_counts else 0.0,
            record.timing.encoder_divider,
            gains,
            record.reading,
            np.zeros(9),
            innovation,
        )
        if blown_up >= 0:
            raise UserError(
                f'{record.name}: the plant blew up when driven by the measured currents'
            )
        whole = len(innovation) // self.averaged
        averaged = innovation[: whole * self.averaged].reshape(whole, self.averaged, -1)
        return [averaged[self.first_cycle :, :, place].mean(axis=1) for place in self._places]

    def _together(self, machine: Machine, p: np.void) -> Array:
        """
        Return how far each coordinate of a machine goes with each encoder's, (encoders, coordinates).

        As if nothing gave; zero for an encoder whose coordinate goes with that of an earlier one.
        """
        together = np.zeros((len(ENCODERS), len(machine.coordinates)))
        moves: list[tuple[int | str, float]] = [
            self._rigid.get(name, (name, 1.0)) for name in machine.coordinates
        ]
        held = set()
        for encoder in self._places:
            what, own = moves[int(p['encoder_coordinate'][encoder])]
            if what in held:
                continue
            held.add(what)
            for place, (other, ratio) in enumerate(moves):
                if other == what:
                    together[encoder, place] = ratio / own
        return together

    def _stand_where_measured(
        self, state: np.ndarray, parameters: np.ndarray, together: Array, step_s: float
    ) -> None:
        """Begin with the position and speed of the first readings."""
        s, p = state[0], parameters[0]
        reading = self.record.reading
        for place in self._places:
            rows = np.flatnonzero(np.isfinite(reading[:200, place]))
            if len(rows) < 2 or not together[place].any():
                continue
            few = rows[:40]
            slope, start = np.polyfit(few * step_s, reading[few, place], 1)
            per_unit = p['counts_per_unit'][place]
            coordinate = p['encoder_coordinate'][place]
            if abs(slope) * (few[-1] - few[0]) * step_s < 3.0:  # it stands
                slope, start = 0.0, float(np.mean(reading[few, place]))
            s['position'] += together[place] * (start / per_unit - s['position'][coordinate])
            s['velocity'] += together[place] * (slope / per_unit - s['velocity'][coordinate])
        encoders.fill_readings(s, p)


@compiled
def _drive(
    state, parameters, line_current, half_count, divider, gains, reading, no_voltage, innovation
):
    """
    Drive the plant by measured line currents (n, 6); fill `innovation` (n / divider, 4), counts.

    `reading` likewise: published counts, NaN where missing; `half_count` is added to them, because
    counts are rounded down; `gains` (2, encoders, coordinates) are those of the observer, for position
    and velocity. Returns the coordinate for which the simulation blew up, or -1.
    """
    s = state[0]
    p = parameters[0]
    seen = np.zeros((LONGEST_DELAY, reading.shape[1]))
    for encoder in range(reading.shape[1]):
        if p['counts_per_unit'][encoder] != 0.0:
            now = encoders.seen_counts(s, p, encoder)
            for row in range(LONGEST_DELAY):
                seen[row, encoder] = now
    for motor in range(motors.MOTORS):
        s['terminals_open'][motor] = 1
    for tick in range(line_current.shape[0]):
        if tick % divider == 0 and tick // divider < reading.shape[0]:
            row = tick // divider
            for encoder in range(reading.shape[1]):
                per_unit = p['counts_per_unit'][encoder]
                if per_unit == 0.0:
                    continue
                coarseness = p['coarseness'][encoder]
                now = encoders.seen_counts(s, p, encoder)
                if coarseness > 1.0:
                    now = coarseness * np.floor(now / coarseness) + half_count
                seen[row % LONGEST_DELAY, encoder] = now
                late = (row - p['encoder_delay'][encoder]) % LONGEST_DELAY
                error = reading[row, encoder] + half_count - seen[late, encoder]
                if error != error:
                    continue
                innovation[row, encoder] = error
                for coordinate in range(gains.shape[2]):
                    s['position'][coordinate] += gains[0, encoder, coordinate] * error / per_unit
                    s['velocity'][coordinate] += gains[1, encoder, coordinate] * error / per_unit
        for row in range(len(s['external_force'])):
            s['external_force'][row] = 0.0
        for motor in range(motors.MOTORS):
            first = line_current[tick, 2 * motor]
            if p['winding'][motor] == motors.NONE or first != first:
                continue
            first = current_sensors.true_current(p, motor, 0, first)
            second = current_sensors.true_current(p, motor, 1, line_current[tick, 2 * motor + 1])
            coordinate = p['motor_coordinate'][motor]
            ratio = p['motor_ratio'][motor]
            middle = s['position'][coordinate] + 0.5 * p['step'] * s['velocity'][coordinate]
            angle = p['electrical_gain'][motor] * ratio * middle
            force = motors.force_of_line_currents(p, motor, angle, first, second)
            s['external_force'][coordinate] += ratio * force
        if tick % 180 == 0:
            coordinate = plant.runaway(state)
            if coordinate >= 0:
                return coordinate
        plant.advance(state, parameters, no_voltage)
    return -1
