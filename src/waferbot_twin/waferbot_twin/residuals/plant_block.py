# SPDX-License-Identifier: Apache-2.0
"""
The plant alone: driven by measured currents, held to measured positions, what is left over.

Double integrators drift, so a plant that is only driven by measured currents soon is nowhere near the
measurement. Here every reading y of an encoder corrects the simulated coordinate x a little, as a
Luenberger observer does,

    e = y - c x        x += l1 e / c        x' += l2 e / c
    l1 = 1 - q^2       l2 = (1 + q^2 - 2 q cos(sqrt(1 - z^2) w h)) / h       q = exp(-z w h)

with c counts shown per unit (with the error of an encoder's scale, which changed w else), h the time
since the correction before, w and z the observer's frequency and damping: the error of a double
integrator then dies out as exp(-z w t) at whatever times readings come
(for small w h, l1 = 2 z w h and l2 = w^2 h). The innovation e, in steps of the model's encoder, which
are counts if it is not coarse, is the block's residual. A force F that the model lacks appears in it
as c F / (M (s^2 + 2 z w s + w^2)): below w it is a picture of the force itself, so w is chosen above
what moves the machine, 80 Hz, but no more than a sixth of the rate at which readings come: what a slow
log cannot show is not looked for in it. Of noisy readings a slower one makes more
(`observer_bandwidth`). Whitening takes out what w and z were; all models that are compared have the
same. Where several readings make a sample of the residual, their mean corrects the
plant when the sample ends: a sample is what was predicted from those before it, whatever an observer
follows.

A reading that is late by T is compared with where the plant was by then, as corrected since. What
corrected the speed then has moved the plant since, and all of its path between,

    x += (l1 + l2 T) e / c,        x(s) by (l1 + l2 (s - t + T)) e / c,      t - T <= s <= t.

So a late encoder and a log that is as late leave nearly the same over, whatever noise there is: else
the observer, and with it the spread of e, would depend on the delay. Nearly, as friction on that path
would have been another one. So T is what readings are late of one another, and by as much as the model
has the published ones late in any case (`delay_cycles`); by what all of a log are later still, the
currents are taken from earlier in the log, which is exact. A reading that was taken between two
rows is compared with the parabola through the three nearest, straight beyond these; if it is published
at once, with the line along the speed.

What moves together as long as nothing gives is corrected together, a carriage with its counterweight,
an axis with its motor, by the finest of its encoders: the steps of a coarse one would push a machine
that creeps, of which every friction law makes something else. A model in which a connection gives is
held by the Kalman filter of which that is the limit (`flexible_observer`): a ring that noise of the
currents makes in the simulation alone is taken out of it again. Where a spring joins two coordinates
that both have an encoder, a motor and its load, the coarser one holds its own coordinate by what the
finer leaves of its error: held by the load alone, a motor in the gap of its gears bounces for ever, as
each correction gives back to it what an impact took. With k the slope of the spring's force now, zero
in the gap, and J = J1 J2 / (J1 + J2) the inertia with which its ends ring, that correction is

    1 / (1 + (k / (J (5 w)^2))^n),        n = 3, with play 2,

of the full one, so that a spring without any compliance is what is held rigid. Noise of readings
sets a stiff one ringing, and if little damps that it goes on for hundreds of cycles: with n = 2 the
true model of a gearbox that rings at 1.2 kHz explained logs less than the rigid one. Between the
flanks of a play impacts end any ring, and the motor has to be followed. Such a model follows two
encoders where a rigid one follows one; so their innovations are whitened as a pair
(`prediction_error`), which takes out which readings an observer followed, and leaves what the
machine does.
Currents make force as the model's motor says, at the simulated electrical angle, and are measured as the
model's sensors say; where only the part that makes force is known, it is taken to be in phase.
Positions are seen as the model's encoders see them, without their noise. Axes of which no position was
logged stand still.

A drive whose output is locked could not move if nothing gave, and no observer has anything to hold: what
it is corrected by would turn the table that it is bolted to. It does not drift either. So it is driven
by its currents alone, from the middle of its springs, and

    e = y - c x - mean(y - c x),

as nobody knows where the encoder has its zero. Friction and play keep it where it came from: the log up
to the first time that it is pushed against either flank is predicted from somewhere else.
"""

from __future__ import annotations

import copy
import itertools
import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from waferbot_lockstep.compiled import compiled, compiled_without_lock
from waferbot_lockstep.errors import UserError
from waferbot_plant import current_sensors, encoders, motors, multibody, plant, spring_laws
from waferbot_plant.description import Description
from waferbot_plant.plant import Machine
from waferbot_twin.effects import places
from waferbot_twin.effects.variant import Variant, built
from waferbot_twin.noise_model.motion_basis import motion_basis, moves
from waferbot_twin.noise_model.prediction_error import Noise, freedom_of
from waferbot_twin.noise_model.variance_components import COLOURED_HZ, Shapes
from waferbot_twin.residuals.flexible_observer import kalman_gains
from waferbot_twin.residuals.record import Array, Record, common_step

OBSERVER_HZ = 80.0
OBSERVER_DAMPING = 0.7

STIFF = 5.0
"""
A spring that rings so many times as fast as the observer is stiff: the coarser encoder at its ends
corrects half as much, and less and less on stiffer ones, which noise of readings would only set ringing.
"""

FALLS, FALLS_WITH_PLAY = 3, 2
"""With which power of the stiffness: n above."""

READINGS_PER_CYCLE = 6.0
"""Readings that a cycle of the observer has at least."""

SETTLING_CYCLES = 1.6
"""Cycles of the observer that are left out at the beginning of a log and behind a gap."""

FLOOR_STEPS = 0.2
"""Smallest standard deviation of a reading, in its steps: whole counts are uniform over one, 0.29."""

LEAST_READINGS = 40
"""An encoder with fewer readings than this is not looked at."""

SAMPLES_PER_TAP = 20
"""Samples for each coefficient of the autoregression at least."""

GAP = 4.0
"""A time between readings that is so many times the usual one is a gap."""

LONGEST_DELAY = encoders.READINGS


class PlantBlock:
    """
    The plant's residual of one log, for any variant of the model.

    A sample of the residual is the mean over a group of readings, so that its rate is about the servo's,
    or that of the log where it is slower. `order` is that of the autoregression: forces that shake the
    machine are coloured.
    """

    order = 24

    def __init__(self, record: Record, variant: Variant, observer_hz: float | None = None) -> None:
        """Prepare what does not depend on the values of the model; that of the record by default."""
        self.record = record
        layout = record.layout
        self._rigid = variant.rigid.placing
        timing = record.timing
        known = np.isfinite(record.reading)
        self._places = [
            place
            for place, name in enumerate(layout.encoders)
            if name in variant.description.encoders and known[:, place].sum() >= LEAST_READINGS
        ]
        self.channels = [layout.encoders[place] for place in self._places]
        self.on_held = [
            self._rigid.get(variant.description.encoders[name].coordinate, (-1, 1.0))[0]
            in variant.rigid.locked
            for name in self.channels
        ]
        # Of the model that is given: which encoder holds an axis is the same for all that are compared.
        self._finest_first = sorted(self._places, key=lambda place: self._step(variant, place))
        self._samples: list[NDArray[np.intp]] = []
        self.rates_hz: list[float] = []
        self._common_steps: list[int] = []
        wanted_hz = record.observer_hz or (OBSERVER_HZ,) * len(layout.encoders)
        if observer_hz is not None:
            wanted_hz = (observer_hz,) * len(layout.encoders)
        self._observer_hz = np.zeros(len(layout.encoders))
        self._usual_rows = np.zeros(len(layout.encoders), np.int64)
        self._ends = np.zeros(record.reading.shape, np.bool_)
        floors = []
        for place in self._places:
            rows = np.flatnonzero(known[:, place])
            usual = float(np.median(np.diff(rows)))
            rate_hz = timing.encoder_hz / usual
            self._observer_hz[place] = min(wanted_hz[place], rate_hz / READINGS_PER_CYCLE)
            settling = SETTLING_CYCLES / self._observer_hz[place] * timing.encoder_hz
            group = max(1, round(rate_hz / timing.servo_hz))
            self._usual_rows[place] = round(group * usual)
            samples, ends = _samples(rows, group, GAP * usual, settling)
            self._ends[ends, place] = True
            judged = samples[:, 0] >= round(record.judged_from_s * timing.encoder_hz)
            self._samples.append(samples[judged])
            self.rates_hz.append(rate_hz / group)
            self._common_steps.append(common_step(record.reading[:, place]))
            floors.append(FLOOR_STEPS * record.resolution[place] / math.sqrt(group))
        self._begins = {
            place: record.first_motion(place, 1.0 / self._observer_hz[place])
            for place in self._places
        }
        shortest = min((len(samples) for samples in self._samples), default=0)
        self.order = min(type(self).order, max(1, shortest // SAMPLES_PER_TAP))
        self.noises = [
            Noise(
                floor,
                self.order,
                beside,
                Shapes(
                    rate_hz,
                    float(self._observer_hz[place]),
                    OBSERVER_DAMPING,
                    motion_basis(self.measured(layout.encoders[place])),
                    moves=moves(self.measured(layout.encoders[place])),
                ),
                freedom=freedom_of(record.duration_s),
            )
            for floor, beside, rate_hz, place in zip(
                floors, self._beside(), self.rates_hz, self._places, strict=True
            )
        ]

    def _step(self, variant: Variant, place: int) -> float:
        """Return the step of an encoder in the motion that its axis makes if nothing gives."""
        encoder = variant.description.encoders[self.record.layout.encoders[place]]
        _, ratio = self._rigid.get(encoder.coordinate, ('', 1.0))
        return self.record.resolution[place] / abs(encoder.counts_per_unit * ratio)

    def _beside(self) -> list[int]:
        """Return how many places further on the other encoder of each one's axis is; 0 without one."""
        axes = [self.record.layout.axis_of(name) for name in self.channels]
        found = [0] * len(axes)
        for first, second in itertools.combinations(range(len(axes)), 2):
            same_times = np.array_equal(self._samples[first], self._samples[second])
            if axes[first] == axes[second] and same_times:
                found[first], found[second] = second - first, first - second
        return found

    def with_coloured_forces(self) -> PlantBlock:
        """Return the block with noise whose forces may have a colour: to compare models."""
        other = copy.copy(self)
        other.noises = [
            noise
            if noise.shapes is None
            else replace(noise, shapes=replace(noise.shapes, corners_hz=COLOURED_HZ))
            for noise in self.noises
        ]
        return other

    def in_encoder_ticks(self) -> PlantBlock:
        """
        Return the block with a step of the simulation for each cycle of the encoders.

        Fewer steps by the encoders' divider of the tick, two of the machine of the thesis. What a cause
        changes differs by less than 5 % of its RMS (test_plant_block: seven causes, one of which rings
        at 75 Hz). What is left over itself is not as exact: a residual is to be compared with others of
        the same block only.
        """
        timing = self.record.timing
        if timing.encoder_divider == 1 or timing.current_loop_hz % timing.encoder_divider:
            return self
        other = copy.copy(self)
        other.record = self.record.with_encoder_ticks()
        return other

    @property
    def observer_hz(self) -> float:
        """Frequency above which missing forces are not seen in the slowest channel, Hz."""
        return float(min((self._observer_hz[place] for place in self._places), default=0.0))

    def times_s(self, channel: str) -> Array:
        """Return the time of every sample of a channel's residual, s from the log's beginning."""
        rows = self._samples[self.channels.index(channel)]
        timing = self.record.timing
        return rows.mean(axis=1) * timing.encoder_divider * timing.tick_s

    def measured(self, channel: str) -> Array:
        """Return the reading at every sample of a channel's residual, counts."""
        rows = self._samples[self.channels.index(channel)]
        return np.asarray(
            self.record.reading[rows, self.record.layout.encoder_place(channel)].mean(axis=1)
        )

    def residuals(self, variant: Variant) -> list[Array]:
        """
        Return the innovation of every encoder of the log, in the steps of the model's encoder.

        So a model says how likely each of the readings is that its encoder can show: one with steps of
        C counts has only every C-th, and is that much likelier to be right for each of n samples if all
        changes of the readings are multiples of C: ln L is n ln C more. If they are not, it has no
        such encoder, and nothing is gained by saying so: then steps are counts.
        """
        scales = self.steps(variant)
        return [
            channel / step for channel, step in zip(self.innovations(variant), scales, strict=True)
        ]

    def steps(self, variant: Variant) -> list[float]:
        """Return the step of every encoder of a model, counts; 1 where readings are no multiples."""
        found = []
        for channel, common in zip(self.channels, self._common_steps, strict=True):
            step = variant.description.encoders[channel].errors.coarseness
            found.append(step if common and common % step == 0.0 else 1.0)
        return found

    def innovations(self, variant: Variant) -> list[Array]:
        """
        Return the innovation of every encoder of the log, counts.

        Raises `UserError` if the simulation blows up.
        """
        record = self.record
        machine = built(variant, record.timing)
        state, parameters = machine.at_rest()
        p = parameters[0]
        together, behind = self._together(machine, p)
        self._stand_where_measured(state, parameters, together, behind)
        measured = np.count_nonzero(together, axis=0) > 0
        measured[p['encoder_coordinate'][self._places]] = True
        standing = _standing(machine.description, p, measured)
        gains = self._gains(machine, state, parameters, together, behind, standing)
        innovation = np.zeros_like(record.reading)
        later = self._later(p, machine.description.encoder_delay) * record.timing.encoder_divider
        lines = record.line_current
        blown_up = _drive(
            state,
            parameters,
            _moved(lines, np.full(lines.shape[1], -later)) if later else lines,
            self._acting_current(variant, later),
            0.5 if record.whole_counts else 0.0,
            record.timing.encoder_divider,
            2.0 * math.pi * self._observer_hz,
            np.array(self._finest_first, np.int64),
            together,
            behind,
            *gains,
            self._usual_rows,
            record.reading,
            np.zeros((0, len(self.record.layout.encoders)))
            if record.late_s is None
            else record.late_s,
            self._ends,
            standing,
            np.zeros(3 * len(record.layout.axes)),
            innovation,
        )
        if blown_up >= 0:
            raise UserError(
                f'{record.name}: the plant blew up when driven by the measured currents'
            )
        means = [
            _means(innovation, rows, place)
            for place, rows in zip(self._places, self._samples, strict=True)
        ]
        return [
            mean - np.mean(mean) if on_held else mean
            for mean, on_held in zip(means, self.on_held, strict=True)
        ]

    def _later(self, p: np.void, usual: int) -> float:
        """
        Return how much later than `usual` all readings of the log are, rows; each is so no more, then.

        Changes the delays in the parameters `p`. Negative if all are earlier.
        """
        late = (p['encoder_delay'] + p['delay_fraction'])[self._places]
        later = float(late.min(initial=np.inf)) - usual
        if later == 0.0 or not self._places:
            return 0.0
        p['delay_fraction'][self._places], whole = np.modf(late - later)
        p['encoder_delay'][self._places] = whole
        return later

    def _acting_current(self, variant: Variant, readings_later: float) -> Array:
        """
        Return the current (n, axes) that makes force, A; (0, axes) where line currents are known.

        That of a skewed axis is what stands in the log so much later, less the ticks that the readings
        are later themselves. What a drive did between its samples is a path there where it goes
        straight (`drive_path`), and a time elsewhere.
        """
        if self.record.current is None:
            return np.zeros((0, len(self.record.layout.axes)))
        current, path, tick_s = self.record.current, self.record.path, self.record.timing.tick_s
        late_s, early_s = (
            np.array([times.get(axis, 0.0) for axis in self.record.layout.axes])
            for times in (variant.skew_s, variant.between_s)
        )
        if early_s.any() and path is not None:
            current = current + path.earlier_by(early_s, tick_s)
            early_s = np.where(path.step_s > 0.0, 0.0, early_s)
        later = (late_s + early_s) / tick_s - readings_later
        if later.any():
            current = _moved(current, later)
        lags = places.drive_lags(variant)
        return np.asarray(motors.lagged(current, lags, tick_s)) if lags.any() else current

    def _gains(
        self,
        machine: Machine,
        state: np.ndarray,
        parameters: np.ndarray,
        together: Array,
        behind: NDArray[np.intp],
        standing: NDArray[np.bool_],
    ) -> tuple[Array, Array]:
        """Return the gains of `flexible_observer`, without rows where there are none."""
        timing = self.record.timing
        found = kalman_gains(
            machine,
            state,
            parameters,
            together,
            behind,
            standing,
            2.0 * math.pi * self._observer_hz,
            np.asarray(self._usual_rows * timing.encoder_divider * timing.tick_s, np.float64),
        )
        return found or (together[:0], together[:0])

    def _together(self, machine: Machine, p: np.void) -> tuple[Array, NDArray[np.intp]]:
        """
        Return how far each coordinate of a machine goes with each encoder's, (encoders, coordinates).

        As if nothing gave. An encoder whose coordinate goes with that of a finer one has that alone
        if a spring joins the two, and nothing if they are one. With it, for each encoder, the spring
        that it is behind and the encoder at the other end, (encoders, 2), or -1.
        """
        behind = np.full((len(self.record.layout.encoders), 2), -1)
        together = np.zeros((len(self.record.layout.encoders), len(machine.coordinates)))
        held = {name for name, on in zip(self.channels, self.on_held, strict=True) if on}
        moves: list[tuple[int | str, float]] = [
            self._rigid.get(name, (name, 1.0)) for name in machine.coordinates
        ]
        first: dict[int | str, tuple[int, int]] = {}
        for encoder in self._finest_first:
            coordinate = int(p['encoder_coordinate'][encoder])
            what, own = moves[coordinate]
            if self.record.layout.encoders[encoder] in held:
                continue
            if what in first:
                before, its_coordinate = first[what]
                joint = _joint(p, coordinate, its_coordinate)
                if joint >= 0:
                    together[encoder, coordinate] = 1.0
                    behind[encoder] = joint, before
                continue
            first[what] = encoder, coordinate
            for place, (other, ratio) in enumerate(moves):
                if other == what:
                    together[encoder, place] = ratio / own
        return together, behind

    def _stand_where_measured(
        self,
        state: np.ndarray,
        parameters: np.ndarray,
        together: Array,
        behind: NDArray[np.intp],
    ) -> None:
        """Begin with the position and speed of the first readings, and no spring stretched by them."""
        s, p = state[0], parameters[0]
        for place in self._places:
            if not together[place].any() or behind[place, 0] >= 0:
                continue
            start, slope = self._begins[place]
            per_unit = p['counts_per_unit'][place] * (1.0 + p['scale_error'][place])
            coordinate = p['encoder_coordinate'][place]
            missing = start / per_unit - s['position'][coordinate]
            s['position'][: together.shape[1]] += together[place] * missing
            missing = slope / per_unit - s['velocity'][coordinate]
            s['velocity'][: together.shape[1]] += together[place] * missing
        encoders.fill_readings(s, p)


def _standing(
    description: Description, p: np.void, measured: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Return which coordinates (n,) are those of an axis of which none is `measured` (n,)."""
    standing = np.zeros(len(measured), np.bool_)
    for place, axis in enumerate(description.layout.axes):
        own = [
            int(p[f'{what}_coordinate'][place])
            for what, having in (
                ('axis', description.axes),
                ('motor', description.motors),
            )
            if axis in having
        ]
        if not measured[own].any():
            standing[own] = True
    return standing


def _joint(p: np.void, one: int, other: int) -> int:
    """Return the spring that joins two coordinates that are not one; -1 if none does."""
    for spring in range(p['springs']):
        ends = {int(p['spring_first'][spring]), int(p['spring_second'][spring])}
        if one != other and ends == {one, other}:
            return spring
    return -1


def _moved(current: Array, late: Array) -> Array:
    """
    Return the means of currents (n, k) over ticks that begin `late` (k,) ticks later, any fraction.

    A current goes on as it is at the ends of a log and in gaps.
    """
    moved = current.copy()
    for place, ticks in enumerate(late.tolist()):
        if ticks == 0.0:
            continue
        whole = math.floor(ticks)
        rows = np.clip(np.arange(len(current) + 1) + whole, 0, len(current) - 1)
        own = current[rows, place]
        shifted = own[:-1] + (ticks - whole) * np.diff(own)
        moved[:, place] = np.where(np.isfinite(shifted), shifted, current[:, place])
    return moved


@compiled
def _means(innovation, rows, place):
    means = np.zeros(len(rows))
    for sample in range(len(rows)):
        for row in rows[sample]:
            means[sample] += innovation[row, place]
    return means / rows.shape[1]


def _samples(
    rows: NDArray[np.intp], group: int, longest: float, settling: float
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """
    Return the rows (samples, group) of the readings that make each sample, and where samples end.

    Left out is what lies within `settling` rows of the first reading, or of the first one behind a
    time of more than `longest` rows without any; there samples end, too.
    """
    parts, ends = [], []
    for stretch in np.split(rows, np.flatnonzero(np.diff(rows) > longest) + 1):
        whole = len(stretch) // group
        samples = stretch[: whole * group].reshape(whole, group)
        parts.append(samples[samples[:, 0] >= stretch[0] + settling])
        ends += [samples[:, -1], stretch[-1:]]
    return np.concatenate(parts), np.concatenate(ends)


@compiled
def _as_corrected(own, row, time_s, since):
    """
    Return what an encoder saw at a row, as corrected since then, counts.

    `own` are its rows of what was seen without any correction, of the turns by then and of their levers
    (turns times time), `since` corrections, turns and levers until now; `time_s` is that of the row.
    """
    seen, turned_by, lever_by = own
    corrected, turned, lever = since
    path = seen[row] + corrected
    path += time_s * (turned - turned_by[row])
    return path - (lever - lever_by[row])


@compiled_without_lock
def _drive(
    state,
    parameters,
    line_current,
    current,
    half_count,
    divider,
    observer,
    finest_first,
    together,
    behind,
    gain_position,
    gain_velocity,
    usual_rows,
    reading,
    late_s,
    ends,
    standing,
    no_voltage,
    innovation,
):
    """
    Drive the plant by measured currents; fill `innovation` (n / divider, encoders), counts.

    `line_current` (n, 2 axes) A; `current` (n, axes) A, the part that makes force, for motors without
    line currents (0, 3 if there is none). `reading` likewise as `innovation`: published counts, NaN
    where missing; `half_count` is added to them, because counts are rounded down (of a coarse encoder
    half of its step); `late_s` says how much after its tick each was taken (0, 4 if never); `ends` (n /
    divider, encoders) where a sample ends. `observer` (encoders,) rad/s; `finest_first` are the encoders
    that are looked at, one before those that are behind it; `together` (encoders, z) says how far one
    moves each coordinate; `behind` (encoders, 2) the spring that it is behind and the encoder at the
    other end. `gain_position` and `gain_velocity` (encoders, z) are those of a plant that gives
    (`flexible_observer`; 0, z if there are none) for readings `usual_rows` (encoders,) apart.
    Coordinates of `standing` (z,) do not move. Returns the coordinate for which the simulation blew up,
    or -1.
    """
    s = state[0]
    p = parameters[0]
    seen = np.zeros((LONGEST_DELAY, reading.shape[1]))
    last_row = np.full(reading.shape[1], -1)
    gains_for = np.zeros(reading.shape[1])
    gains = np.zeros((2, reading.shape[1]))
    corrected = np.zeros(reading.shape[1])
    turned = np.zeros(reading.shape[1])
    lever = np.zeros(reading.shape[1])
    turned_by = np.zeros((LONGEST_DELAY, reading.shape[1]))
    lever_by = np.zeros((LONGEST_DELAY, reading.shape[1]))
    row_s = divider * p['step'] * p['substeps']
    left = np.zeros(reading.shape[1])
    summed = np.zeros(reading.shape[1])
    count = np.zeros(reading.shape[1])
    inertia = np.ones(reading.shape[1])
    multibody.mass_matrix_and_bias(s, p, s['position'], s['velocity'])
    for encoder in range(reading.shape[1]):
        spring = behind[encoder, 0]
        if spring >= 0:
            first, second = p['spring_first'][spring], p['spring_second'][spring]
            inertia[encoder] = 1.0 / (
                p['spring_first_ratio'][spring] ** 2 / s['mass_matrix'][first, first]
                + p['spring_second_ratio'][spring] ** 2 / s['mass_matrix'][second, second]
            )
    for encoder in range(reading.shape[1]):
        if p['counts_per_unit'][encoder] != 0.0:
            now = encoders.seen_counts(s, p, encoder)
            for row in range(LONGEST_DELAY):
                seen[row, encoder] = now
    for motor in range(len(p['winding'])):
        s['terminals_open'][motor] = 1
    start = s['position'].copy()
    for tick in range(line_current.shape[0]):
        if tick % divider == 0 and tick // divider < reading.shape[0]:
            row = tick // divider
            for encoder in finest_first:
                per_unit = p['counts_per_unit'][encoder] * (1.0 + p['scale_error'][encoder])
                if per_unit == 0.0:
                    continue
                coordinate = p['encoder_coordinate'][encoder]
                now = encoders.seen_counts(s, p, encoder)
                seen[row % LONGEST_DELAY, encoder] = now - corrected[encoder]
                turned_by[row % LONGEST_DELAY, encoder] = turned[encoder]
                lever_by[row % LONGEST_DELAY, encoder] = lever[encoder]
                late = (row - p['encoder_delay'][encoder]) % LONGEST_DELAY
                delay_s = row_s * (p['encoder_delay'][encoder] + p['delay_fraction'][encoder])
                then_s = row * row_s - delay_s
                since = corrected[encoder], turned[encoder], lever[encoder]
                own = seen[:, encoder], turned_by[:, encoder], lever_by[:, encoder]
                predicted = _as_corrected(own, late, then_s, since)
                half_step = half_count * max(p['coarseness'][encoder], 1.0)
                error = reading[row, encoder] + half_step - predicted
                if error != error:
                    continue
                if late_s.shape[0]:
                    if p['encoder_delay'][encoder] > 0:
                        next_row = (late + 1) % LONGEST_DELAY
                        after = _as_corrected(own, next_row, then_s + row_s, since) - predicted
                        before = predicted - _as_corrected(own, late - 1, then_s - row_s, since)
                        speed, bend = 0.5 * (after + before), after - before
                    else:
                        speed, bend = row_s * s['velocity'][coordinate] * per_unit, 0.0
                    rows = late_s[row, encoder] / row_s
                    near = min(max(rows, -1.0), 1.0)
                    error -= near * (speed + 0.5 * near * bend)
                    error -= (rows - near) * (speed + near * bend)
                innovation[row, encoder] = error
                summed[encoder] += error
                count[encoder] += 1.0
                if not ends[row, encoder]:
                    continue
                error = summed[encoder] / count[encoder]
                summed[encoder] = 0.0
                count[encoder] = 0.0
                passed = row - last_row[encoder]
                last_row[encoder] = row
                if passed != gains_for[encoder]:
                    gains_for[encoder] = passed
                    time_s = passed * divider * p['step'] * p['substeps']
                    _observer_gains(observer[encoder], time_s, gains[:, encoder])
                error /= per_unit
                spring, before = behind[encoder]
                if gain_position.shape[0] and spring < 0 and passed == usual_rows[encoder]:
                    left[encoder] = (1.0 - gain_position[encoder, coordinate]) * error
                    # Rings have turned since, nobody knows how often: they are corrected as they are.
                    turn = gain_velocity[encoder, coordinate] * error
                    for other in range(together.shape[1]):
                        own = gain_position[encoder, other] * error
                        s['position'][other] += own + delay_s * together[encoder, other] * turn
                        s['velocity'][other] += gain_velocity[encoder, other] * error
                    for other in range(reading.shape[1]):
                        other_coordinate = p['encoder_coordinate'][other]
                        scale = 1.0 + p['scale_error'][other]
                        other_per_unit = p['counts_per_unit'][other] * scale
                        moved = gain_position[encoder, other_coordinate] * error * other_per_unit
                        rate = together[encoder, other_coordinate] * turn * other_per_unit
                        corrected[other] += moved
                        turned[other] += rate
                        lever[other] += rate * then_s
                        s['position_before'][other] += (moved + delay_s * rate) / scale
                    continue
                left[encoder] = (1.0 - gains[0, encoder]) * error
                if spring >= 0:
                    error -= together[before, coordinate] * left[before]
                    stiffness = spring_laws.slope_now(s, p, spring, s['position'])
                    stiff = stiffness / (inertia[encoder] * (STIFF * observer[encoder]) ** 2)
                    power = FALLS if p['spring_gap'][spring] == 0.0 else FALLS_WITH_PLAY
                    error /= 1.0 + stiff**power
                for other in range(together.shape[1]):
                    share = together[encoder, other] * error
                    s['position'][other] += (
                        gains[0, encoder] + delay_s * gains[1, encoder]
                    ) * share
                    s['velocity'][other] += gains[1, encoder] * share
                for other in range(reading.shape[1]):
                    other_coordinate = p['encoder_coordinate'][other]
                    scale = 1.0 + p['scale_error'][other]
                    other_per_unit = p['counts_per_unit'][other] * scale
                    share = together[encoder, other_coordinate] * error * other_per_unit
                    moved, rate = gains[0, encoder] * share, gains[1, encoder] * share
                    corrected[other] += moved
                    turned[other] += rate
                    lever[other] += rate * then_s
                    s['position_before'][other] += (moved + delay_s * rate) / scale
        for row in range(len(s['external_force'])):
            s['external_force'][row] = 0.0
        for motor in range(len(p['winding'])):
            if p['winding'][motor] == motors.NONE:
                continue
            coordinate = p['motor_coordinate'][motor]
            ratio = p['motor_ratio'][motor]
            middle = s['position'][coordinate] + 0.5 * p['step'] * s['velocity'][coordinate]
            angle = p['electrical_gain'][motor] * ratio * middle
            first = line_current[tick, 2 * motor]
            if first == first:
                first = current_sensors.true_current(p, motor, 0, first)
                second = line_current[tick, 2 * motor + 1]
                second = current_sensors.true_current(p, motor, 1, second)
                force = motors.force_of_line_currents(p, motor, angle, first, second)
            elif current.shape[0] and current[tick, motor] == current[tick, motor]:
                force = motors.force_at_angle(p, motor, angle, current[tick, motor], 0.0)
            else:
                continue
            s['external_force'][coordinate] += ratio * force
        if tick % 180 == 0:
            coordinate = plant.runaway(state)
            if coordinate >= 0:
                return coordinate
        plant.advance(state, parameters, no_voltage)
        for coordinate in range(len(standing)):
            if standing[coordinate]:
                s['position'][coordinate] = start[coordinate]
                s['velocity'][coordinate] = 0.0
    return -1


@compiled
def _observer_gains(frequency, time_s, gains):
    """Fill l1 and l2 of an observer of `frequency` rad/s for a reading `time_s` after the last."""
    shrinks = math.exp(-OBSERVER_DAMPING * frequency * time_s)
    turns = math.sqrt(1.0 - OBSERVER_DAMPING**2) * frequency * time_s
    gains[0] = 1.0 - shrinks * shrinks
    gains[1] = (1.0 + shrinks * shrinks - 2.0 * shrinks * math.cos(turns)) / time_s
