# SPDX-License-Identifier: Apache-2.0
"""
The drive alone: amplifier and windings on what was measured at the terminals between them.

    amplifier      command, counts, measured currents   -> voltages, V
    windings       voltages, motion of the motor        -> currents as the sensors show them, A
    current loop   command, counts, motion              -> currents as the sensors show them, A

Where voltages were logged, amplifier and windings are looked at one by one, else both together as the
current loop. The mechanism is in none of them: whatever moves the motor, it moved as the encoders say
(`motor_motion`). So friction or a wrong inertia leave nothing over here, while a wrong resistance, an
offset of a sensor or a dead time can be told from one another and from a force.

The amplifier is deterministic, so with the true settings its residual is zero to the last bit. Its
integrators never forget, so a little of the missing voltage is given to them all the time
(`amplifier.follow_voltage`): an observer of `OBSERVER_S`, as that of the plant. The windings and the
current loop forget by themselves; what they leave over is the noise of the current sensors, white
behind the windings, coloured by the loop where that is closed.

Residuals are measured less computed, lines 1 and 2 of each motor. Of the amplifier and of the current
loop they are means over each servo cycle: means lose little (what the drive does within a cycle shows
in them too), and there are eight times fewer of them. Of the windings they are by ticks: within a cycle
the loop answers the noise of its sensors, so that means of noise and of current go together. By means
the gain of a sensor seems wrong where its line carries little else than that: on axes that stand, 62 to
91 % with deviations of 3 to 4 %, by ticks 1 to 3 % with deviations of 2 %.

Limit: counts of a coarse encoder of the motor still do that, the less the more rows of them are smoothed
over (`motor_motion`).
"""

from __future__ import annotations

import numpy as np

from waferbot_copley import amplifier
from waferbot_copley.settings import amplifier_parameters
from waferbot_lockstep.compiled import compiled
from waferbot_plant import current_sensors, encoders, windings
from waferbot_twin.effects.places import amplified_axes
from waferbot_twin.effects.variant import Variant
from waferbot_twin.engines.inprocess import open_terminals
from waferbot_twin.noise_model.prediction_error import Noise, freedom_of
from waferbot_twin.residuals.motor_motion import MotorMotion
from waferbot_twin.residuals.record import Array, Record, common_step, mean_over_ticks

OBSERVER_S = 0.005
"""Time in which the replayed amplifier takes over a voltage that is missing, s."""

CATCHING_UP = 0.5
"""Share of the missing voltage that it takes over in a tick while it gets hold of a log's beginning."""

FLOOR_V = 1e-3
"""Smallest deviation of a voltage: 325 V in 16 bits have steps of 5 mV, 0.5 mV rms in a mean."""

FLOOR_A = 1e-4
"""Smallest deviation of a current: 40 A in 16 bits have steps of 1.2 mA, 0.12 mA rms in a mean."""

FLOOR_OF_TICKS_A = 3.5e-4
"""The same of a single one."""

SETTLING_S = 0.05
"""What is left out at the beginning of a log: several time constants L/R of usual motors."""

UNREAD = encoders.LONGEST_DELAY
"""
Cycles of the encoders that are left out at the end of a log: an encoder that is late shows only behind
it where the motor was then. As many for every model, so that all are judged by the same samples.
"""

TOO_COARSE = 8
"""
Steps of an encoder, counts, from which on windings are not moved by it: the steps would seem to be
errors of scale and of the current's sensors. Seen with 24 and 64 on X-Rotate, not with 4 and 16; a motor
with more back-EMF k over inductance L needs less.
"""

LINES = current_sensors.LINES


class _Lines:
    """
    Lines 1 and 2 of those motors of which both currents were measured without a gap.

    Residuals are means over so many `ticks`.
    """

    def __init__(self, record: Record, places: list[int], ticks: int) -> None:
        """Choose among the axes at `places`."""
        self._ticks = ticks
        self._axes = record.layout.axes
        assert record.terminals is not None
        current = record.terminals.current
        self.current = np.nan_to_num(current)
        self._timing = record.timing
        first = max(SETTLING_S, record.judged_from_s) / (ticks * self._timing.tick_s)
        unread = UNREAD * self._timing.encoder_divider
        self._judged = slice(round(first), (len(current) - unread) // ticks)
        self._columns = [
            LINES * place + line
            for place in places
            if np.isfinite(current[:, LINES * place : LINES * (place + 1)]).all()
            for line in range(LINES)
        ]

    @property
    def channels(self) -> list[str]:
        """Names of the lines."""
        return [
            f'{self._axes[place // LINES]} line {place % LINES + 1}' for place in self._columns
        ]

    def times_s(self) -> Array:
        """Return the time of every mean, s from the log's beginning."""
        means = np.arange(len(self.current) // self._ticks)
        return np.asarray((means[self._judged] + 0.5) * self._ticks * self._timing.tick_s)

    def means(self, left: Array) -> list[Array]:
        """Return the means of what is left over (ticks, 2 axes), where it is judged."""
        count = len(left) // self._ticks
        means = left[: count * self._ticks].reshape(count, self._ticks, -1).mean(axis=1)
        return [means[self._judged, column] for column in self._columns]


class _OfLines:
    """What all blocks have whose channels are lines."""

    _lines: _Lines

    def times_s(self, channel: str) -> Array:
        """Return the time of every sample of a channel's residual, s from the log's beginning."""
        return self._lines.times_s()


class AmplifierBlock(_OfLines):
    """The amplifier's residual of one log, V, for any variant of the model."""

    order = 0
    """It is rounding that is left over, not noise: nothing to whiten, and nothing to hide in."""

    def __init__(self, record: Record, variant: Variant) -> None:
        """Prepare what does not depend on the values of the model."""
        self.record = record
        self._lines = _Lines(
            record, _commanded_places(record, variant), record.timing.servo_divider
        )
        self.channels = self._lines.channels
        noise = Noise(FLOOR_V, self.order, freedom=freedom_of(record.duration_s))
        self.noises = [noise] * len(self.channels)

    def residuals(self, variant: Variant) -> list[Array]:
        """Return the voltages of lines 1 and 2 against the mean of the three, logged less computed."""
        record, terminals = self.record, self.record.terminals
        assert terminals is not None
        assert terminals.voltage is not None
        settings = amplifier_parameters(
            variant.copley, record.timing, variant.name, variant.layout
        )
        axes = len(record.layout.axes)
        missing = np.zeros((record.ticks, 3 * axes))
        _follow_amplifier(
            amplifier.initial_state(settings),
            settings,
            *_amplifier_inputs(record),
            self._lines.current,
            np.nan_to_num(terminals.voltage),
            terminals.off,
            record.timing.ticks(SETTLING_S),
            record.timing.tick_s / OBSERVER_S,
            missing,
        )
        by_axis = missing.reshape(record.ticks, axes, 3)
        against_mean = (by_axis - by_axis.mean(axis=2, keepdims=True))[:, :, :LINES]
        return self._lines.means(against_mean.reshape(record.ticks, -1))


class WindingsBlock(_OfLines):
    """The windings' residual of one log with voltages, A, for any variant of the model."""

    order = 4
    """White noise of the sensors, coloured a little by counts that are taken for motion."""

    def __init__(self, record: Record, variant: Variant) -> None:
        """Prepare what does not depend on the values of the model."""
        self.record = record
        self._lines = _Lines(record, _finely_moved_places(record, variant), 1)
        self._motion = MotorMotion(record)
        self.channels = self._lines.channels
        noise = Noise(FLOOR_OF_TICKS_A, self.order, freedom=freedom_of(record.duration_s))
        self.noises = [noise] * len(self.channels)

    def residuals(self, variant: Variant) -> list[Array]:
        """Return the currents of lines 1 and 2, measured less computed, A."""
        terminals, measured = self.record.terminals, self._lines.current
        assert terminals is not None
        assert terminals.voltage is not None
        computed = np.zeros_like(measured)
        _drive_windings(
            *_windings(self.record, variant, self._motion, measured[0]),
            np.nan_to_num(terminals.voltage),
            terminals.off,
            computed,
        )
        return self._lines.means(measured - computed)


class CurrentLoopBlock(_OfLines):
    """Residual of amplifier and windings together, of a log without voltages, A."""

    order = 8
    """Noise of the sensors as the loop answers it."""

    def __init__(self, record: Record, variant: Variant) -> None:
        """Prepare what does not depend on the values of the model."""
        self.record = record
        moved = _finely_moved_places(record, variant)
        places = [place for place in _commanded_places(record, variant) if place in moved]
        self._lines = _Lines(record, places, record.timing.servo_divider)
        self._motion = MotorMotion(record)
        self.channels = self._lines.channels
        noise = Noise(FLOOR_A, self.order, freedom=freedom_of(record.duration_s))
        self.noises = [noise] * len(self.channels)

    def residuals(self, variant: Variant) -> list[Array]:
        """Return the currents of lines 1 and 2, measured less computed, A."""
        measured = self._lines.current
        settings = amplifier_parameters(
            variant.copley, self.record.timing, variant.name, variant.layout
        )
        computed = np.zeros_like(measured)
        _run_current_loop(
            *_windings(self.record, variant, self._motion, measured[0]),
            amplifier.initial_state(settings),
            settings,
            *_amplifier_inputs(self.record),
            computed,
        )
        return self._lines.means(measured - computed)


def driven_currents(record: Record, variant: Variant) -> Array:
    """
    Return line currents (ticks, 2 axes) for a log without any, A: what the model's drive makes of
    commands.

    Amplifiers and windings are those of the model, and move as the encoders say. Where amplifier,
    command or motion of an axis is not known, the record's own currents stay.
    """
    known = set(_commanded_places(record, variant)) & _motor_encoders(record, variant).keys()
    settings = amplifier_parameters(variant.copley, record.timing, variant.name, variant.layout)
    computed = np.zeros_like(record.line_current)
    _run_current_loop(
        *_windings(record, variant, MotorMotion(record), np.nan_to_num(record.line_current[0])),
        amplifier.initial_state(settings),
        settings,
        *_amplifier_inputs(record),
        computed,
    )
    computed = mean_over_ticks(computed)
    columns = [LINES * place + line for place in sorted(known) for line in range(LINES)]
    currents = record.line_current.copy()
    currents[:, columns] = computed[:, columns]
    return currents


def _commanded_places(record: Record, variant: Variant) -> list[int]:
    """Return the axes whose amplifier is known, with its command and its electrical angle."""
    assert record.command is not None
    settings = amplifier_parameters(variant.copley, record.timing, variant.name, variant.layout)
    encoder = settings[0]['commutation_encoder']
    return [
        place
        for place, axis in enumerate(record.layout.axes)
        if axis in amplified_axes(variant)
        and np.isfinite(record.command[:, place]).all()
        and np.isfinite(record.reading[:, encoder[place]]).all()
    ]


def _motor_encoders(record: Record, variant: Variant) -> dict[int, int]:
    """Return the axes whose motor has an encoder with its counts, and which encoder that is."""
    encoders = {
        place: windings.motor_encoder(variant.description, axis)
        for place, axis in enumerate(record.layout.axes)
    }
    return {
        place: encoder
        for place, encoder in encoders.items()
        if encoder is not None and np.isfinite(record.reading[:, encoder]).all()
    }


def _finely_moved_places(record: Record, variant: Variant) -> list[int]:
    """Return those of the axes whose motor has an encoder of which the steps are not too large."""
    return [
        place
        for place, encoder in _motor_encoders(record, variant).items()
        if common_step(record.reading[:, encoder]) < TOO_COARSE
    ]


def _amplifier_inputs(record: Record) -> tuple[Array, np.ndarray, int, int]:
    """Return commands, counts (zero where unknown), and how many ticks each of them holds."""
    assert record.command is not None
    counts = np.nan_to_num(record.reading).astype(np.int64)
    timing = record.timing
    return np.nan_to_num(record.command), counts, timing.servo_divider, timing.encoder_divider


def _windings(
    record: Record, variant: Variant, motion: MotorMotion, line_current: Array
) -> tuple[np.ndarray, np.ndarray, Array, float, int]:
    """Return state, parameters and motion of the windings, and length and number of their steps."""
    parameters = windings.winding_parameters(variant.description)
    substeps = variant.description.substeps
    return (
        windings.initial_state(parameters, line_current),
        parameters,
        motion.positions(parameters),
        record.timing.tick_s / substeps,
        substeps,
    )


@compiled
def _follow_amplifier(
    state,
    parameters,
    command,
    counts,
    command_ticks,
    count_ticks,
    line_current,
    voltage,
    off,
    settling,
    share,
    missing,
):
    """
    Drive the amplifiers by commands (n / command_ticks, axes), counts (n / count_ticks, encoders)
    and line currents (n, 2 axes); fill `missing` (n, 3 axes), logged less computed voltages, V.

    `off` (n,) has the bits of bridges that were off. The share of the missing voltage that goes into
    the integrators is `CATCHING_UP` for the first `settling` ticks, then `share`.
    """
    computed = np.zeros(voltage.shape[1])
    all_axes = (1 << command.shape[1]) - 1
    for tick in range(line_current.shape[0]):
        now = counts[tick // count_ticks]
        for axis in range(line_current.shape[1] // LINES):
            state[0]['safe_torque_off'][axis] = off[tick] >> axis & 1
        amplifier.step(
            state,
            parameters,
            all_axes,
            command[tick // command_ticks],
            line_current[tick],
            now,
            computed,
        )
        for terminal in range(voltage.shape[1]):
            missing[tick, terminal] = voltage[tick, terminal] - computed[terminal]
        amplifier.follow_voltage(
            state, parameters, now, missing[tick], CATCHING_UP if tick < settling else share
        )


@compiled
def _drive_windings(state, parameters, position, step_s, substeps, voltage, off, computed):
    """
    Drive the windings of motors at `position` (n + 1, 3) by voltages (n, 9); fill `computed` (n, 6),
    line currents as the sensors show them, A.
    """
    for tick in range(computed.shape[0]):
        windings.show(state, parameters, computed[tick])
        open_terminals(state, off[tick])
        windings.advance(
            state, parameters, position[tick], position[tick + 1], voltage[tick], step_s, substeps
        )


@compiled
def _run_current_loop(
    state,
    parameters,
    position,
    step_s,
    substeps,
    amplifier_state,
    settings,
    command,
    counts,
    command_ticks,
    count_ticks,
    computed,
):
    """Close the loop of amplifiers and windings; arguments as in the two functions above."""
    axes = command.shape[1]
    all_axes = (1 << axes) - 1
    voltage = np.zeros(3 * axes)
    for tick in range(computed.shape[0]):
        windings.show(state, parameters, computed[tick])
        amplifier.step(
            amplifier_state,
            settings,
            all_axes,
            command[tick // command_ticks],
            computed[tick],
            counts[tick // count_ticks],
            voltage,
        )
        open_terminals(state, amplifier.open_bridges(amplifier_state))
        windings.advance(
            state, parameters, position[tick], position[tick + 1], voltage, step_s, substeps
        )
