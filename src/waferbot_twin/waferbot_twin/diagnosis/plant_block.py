# SPDX-License-Identifier: Apache-2.0
"""
The plant alone: driven by measured currents, held to measured positions, what is left over.

Double integrators drift, so a plant that is only driven by measured currents soon is nowhere near the
measurement. Here every reading y of an encoder corrects the simulated coordinate x a little, as a
Luenberger observer does,

    e = y - c x        x += l1 e / c        x' += l2 e / c        l1 = 2 z w h, l2 = w^2 h

with c counts per unit, h the time between readings, w and z the observer's frequency and damping. The
innovation e, in counts, is the block's residual. A force F that the model lacks appears in it as
F / (M (s^2 + 2 z w s + w^2)): as in the open loop above w, as a constant share below it. Whitening takes
out what w and z were, as long as all models that are compared have the same.

Positions are known beforehand here, so that a reading is compared with the coordinate at the tick at
which it was taken, not at which it arrived.
"""

from __future__ import annotations

import math

import numpy as np

from waferbot_lockstep.compiled import compiled
from waferbot_lockstep.contract import AXES, ENCODERS
from waferbot_lockstep.errors import UserError
from waferbot_plant import motors, plant
from waferbot_twin.diagnosis.record import Array, Record
from waferbot_twin.effects.variant import Variant

OBSERVER_RAD_S = 2.0 * math.pi * 80.0
OBSERVER_DAMPING = 0.7
FLOOR_COUNTS = 0.2
"""Smallest standard deviation of a reading: whole counts are uniform over one, 0.29."""


class PlantBlock:
    """The plant's residual of one log, for any variant of the model."""

    order = 24
    """Forces that shake the machine are coloured."""

    def __init__(self, record: Record) -> None:
        """Prepare what does not depend on the model."""
        self.record = record
        self._averaged = record.timing.servo_divider // record.timing.encoder_divider
        self.floors = [FLOOR_COUNTS / math.sqrt(self._averaged)] * len(ENCODERS)

    def residuals(self, variant: Variant) -> list[Array]:
        """
        Return the innovation of every encoder that the machine has, counts, at the servo's rate.

        Raises `UserError` if the simulation blows up.
        """
        record = self.record
        machine = variant.build(record.timing)
        parameters = machine.parameters()
        state = machine.resting_state(parameters)
        p = parameters[0]
        rows = np.zeros(len(AXES), np.int64)
        force = np.zeros((record.ticks, len(AXES)))
        for place, axis in enumerate(AXES):
            motor = machine.description.motors.get(axis)
            if motor is None:
                continue
            rows[place], ratio = machine.assembly.placing[motor.coordinate]
            force[:, place] = motors.force_constant(motor) * ratio * record.current[:, place]
        p['winding'] = motors.NONE
        state[0]['winding_current'] = 0.0
        delay = int(p['encoder_delay'])
        reading = np.full_like(record.reading, np.nan)
        reading[: len(reading) - delay] = record.reading[delay:] + 0.5  # they are rounded down
        step = record.timing.encoder_divider * record.timing.tick_s
        gains = np.zeros((2, len(ENCODERS)))
        held = set()
        for encoder in range(len(ENCODERS)):
            coordinate = int(p['encoder_coordinate'][encoder])
            if p['counts_per_unit'][encoder] == 0.0 or coordinate in held:
                continue
            held.add(coordinate)
            gains[:, encoder] = (
                2.0 * OBSERVER_DAMPING * OBSERVER_RAD_S * step,
                OBSERVER_RAD_S**2 * step,
            )
        self._stand_where_measured(state, p, reading)
        innovation = np.zeros_like(reading)
        blown_up = _drive(
            state,
            parameters,
            force,
            rows,
            record.timing.encoder_divider,
            gains,
            reading,
            np.zeros(9),
            innovation,
        )
        if blown_up >= 0:
            raise UserError(
                f'{record.name}: the plant blew up when driven by the measured currents'
            )
        whole = len(innovation) // self._averaged
        averaged = innovation[: whole * self._averaged].reshape(whole, self._averaged, -1)
        return [
            averaged[:, :, encoder].mean(axis=1)
            for encoder in range(len(ENCODERS))
            if p['counts_per_unit'][encoder] != 0.0
        ]

    def _stand_where_measured(self, state: np.ndarray, p: np.void, reading: Array) -> None:
        """Begin at the first readings."""
        s = state[0]
        for encoder in range(len(ENCODERS)):
            per_unit = p['counts_per_unit'][encoder]
            if per_unit != 0.0 and np.isfinite(reading[0, encoder]):
                s['position'][p['encoder_coordinate'][encoder]] = reading[0, encoder] / per_unit


@compiled
def _drive(state, parameters, force, rows, divider, gains, reading, no_voltage, innovation):
    """
    Drive the plant by `force` (n, 3) on the coordinates `rows` (3,); fill `innovation`.

    `reading` float64 (n / divider, 4) measured counts at the tick of the reading, NaN where missing;
    `innovation` likewise. Returns the coordinate for which the simulation blew up, or -1.
    """
    s = state[0]
    p = parameters[0]
    for tick in range(force.shape[0]):
        if tick % divider == 0 and tick // divider < reading.shape[0]:
            row = tick // divider
            for encoder in range(reading.shape[1]):
                per_unit = p['counts_per_unit'][encoder]
                if per_unit == 0.0:
                    continue
                coordinate = p['encoder_coordinate'][encoder]
                error = reading[row, encoder] - per_unit * s['position'][coordinate]
                if error != error:
                    continue
                innovation[row, encoder] = error
                s['position'][coordinate] += gains[0, encoder] * error / per_unit
                s['velocity'][coordinate] += gains[1, encoder] * error / per_unit
        for place in range(len(rows)):
            s['external_force'][rows[place]] = 0.0
        for place in range(len(rows)):
            s['external_force'][rows[place]] += force[tick, place]
        if tick % 180 == 0:
            coordinate = plant.runaway(state)
            if coordinate >= 0:
                return coordinate
        plant.advance(state, parameters, no_voltage)
    return -1
