# SPDX-License-Identifier: Apache-2.0
"""A recording seen by axis, in SI units: position, command, following error, current, force."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from waferbot_copley.settings import amplifier_parameters
from waferbot_lockstep.contract import (
    AXES,
    CURRENT_COMMAND,
    ENCODERS_TOPIC,
    PHASE_CURRENTS,
    SERVO_STATE,
)
from waferbot_lockstep.timing import Timing
from waferbot_pmac.i_variables import servo_parameters
from waferbot_twin.commutation import driving_part, electrical_angle, three_lines
from waferbot_twin.engines.inprocess import Signals, Twin
from waferbot_twin.metrics import StepMetrics, rms, step_metrics
from waferbot_twin.models import recorded_model
from waferbot_twin.recording.reader import Recording

UNITS = {'y_linear': 'm', 'x_rotate': 'rad', 'y_rotate': 'rad'}


@dataclass(frozen=True)
class AxisResponse:
    """
    One axis of a recording. Arrays over time in s; positions in m or rad, currents in A.

    `position` is what the position encoder counted, shifted by its one phase cycle of delay, so that
    it stands at the time at which the axis was there. `current` is the part of the measured line
    currents that makes force: their projection on the commutation's sine, positive drives forward.
    """

    axis: str
    unit: str
    encoder_time: np.ndarray
    position: np.ndarray
    servo_time: np.ndarray
    commanded: np.ndarray
    following_error: np.ndarray
    command_time: np.ndarray
    current_command: np.ndarray
    tick_time: np.ndarray
    current: np.ndarray

    def moves(self) -> bool:
        """Return whether a motion is commanded."""
        return bool(np.any(np.diff(self.commanded)))

    def step(self) -> tuple[float, float] | None:
        """Return time and height of the first step commanded; None if it is not a single jump."""
        change = np.diff(self.commanded)
        jumps = np.flatnonzero(change)
        if len(jumps) == 0 or (len(jumps) > 1 and jumps[1] == jumps[0] + 1):
            return None
        return float(self.servo_time[jumps[0] + 1]), float(change[jumps[0]])

    def metrics(self, rise: str = 'first', level_shift: float = 0.0) -> StepMetrics | None:
        """
        Return the figures of the first step, up to the next one; None if there is no step.

        `rise` says which arrival at the command ends the rise; `level_shift` moves the levels: see
        `metrics.step_metrics`.
        """
        if self.step() is None:
            return None
        jumps = np.flatnonzero(np.diff(self.commanded))
        end_s = self.servo_time[jumps[1] + 1] if len(jumps) > 1 else np.inf
        return self.one_step(int(jumps[0]), float(end_s), rise, level_shift)

    def one_step(
        self, jump: int, end_s: float, rise: str = 'first', level_shift: float = 0.0
    ) -> StepMetrics:
        """Return the figures of the step behind servo cycle `jump`, up to `end_s`."""
        start_s = float(self.servo_time[jump + 1])
        part = (self.encoder_time >= start_s) & (self.encoder_time < end_s)
        height = float(self.commanded[jump + 1] - self.commanded[jump])
        return step_metrics(
            self.encoder_time[part] - start_s,
            self.position[part] - self.commanded[jump],
            height,
            rise,
            level_shift,
        )

    def since_start(self) -> tuple[np.ndarray, np.ndarray]:
        """
        Return encoder times counted from the start of the motion, and positions from its origin.

        The motion starts where the command changes first; times before that are negative. Without
        commanded positions (a PMAC that is not ours need not report them) nothing is shifted.
        """
        if len(self.commanded) == 0:
            return self.encoder_time, self.position
        moves = np.flatnonzero(np.diff(self.commanded))
        first = int(moves[0]) if len(moves) else 0
        start_s = float(self.servo_time[first + 1]) if len(moves) else float(self.servo_time[0])
        return self.encoder_time - start_s, self.position - self.commanded[first]


def rms_difference(one: AxisResponse, other: AxisResponse) -> float:
    """
    Return the RMS of the difference of two responses in position (4.2), m or rad.

    Both are counted from the start of their motions, over the time that both have from there on;
    `other` is interpolated at the times of `one`.
    """
    time, position = one.since_start()
    other_time, other_position = other.since_start()
    common = (time >= 0.0) & (time <= other_time[-1])
    return rms(position[common] - np.interp(time[common], other_time, other_position))


def axis_responses(recording: Recording) -> list[AxisResponse]:
    """Return the three axes of a recording; raises `UserError` if a contract topic is missing."""
    timing = recording.timing
    model = recorded_model(recording)
    servo = servo_parameters(model.of_axes('pmac'), str(recording.path))[0]
    amplifier = amplifier_parameters(model.of_axes('copley'), timing, str(recording.path))[0]
    encoders, currents = recording[ENCODERS_TOPIC], recording[PHASE_CURRENTS]
    servo_state, command = recording[SERVO_STATE], recording[CURRENT_COMMAND]
    return _responses(
        timing,
        servo,
        amplifier,
        (encoders['tick'], encoders['counts']),
        (currents['tick'], currents['current']),
        (servo_state['tick'], servo_state['commanded_position'], servo_state['following_error']),
        (command['tick'], command['current']),
    )


def simulated_responses(twin: Twin, signals: Signals) -> list[AxisResponse]:
    """Return the three axes of what an in-process twin has just run, without recording it."""
    commanded, following_error = np.split(signals.servo_state, 5, axis=1)[:2]
    return _responses(
        signals.timing,
        twin.servo_parameters[0],
        twin.amplifier_parameters[0],
        (np.array(signals.encoder_ticks), signals.counts),
        (np.arange(signals.first, signals.first + signals.ticks), signals.line_current),
        (np.array(signals.servo_ticks), commanded, following_error),
        (np.array(signals.servo_ticks), signals.current_command),
    )


def _responses(
    timing: Timing,
    servo: np.void,
    amplifier: np.void,
    encoders: tuple[np.ndarray, np.ndarray],
    currents: tuple[np.ndarray, np.ndarray],
    servo_state: tuple[np.ndarray, np.ndarray, np.ndarray],
    current_command: tuple[np.ndarray, np.ndarray],
) -> list[AxisResponse]:
    """Return the three axes from (ticks, values) of each topic and the settings that were used."""
    encoder_tick, counts = encoders
    servo_tick, commanded, following_error = servo_state
    delay_s = timing.encoder_divider * timing.tick_s
    responses = []
    for place, axis in enumerate(AXES):
        per_unit = servo['counts_per_unit'][place]
        encoder = int(servo['Ixx03'][place])
        responses.append(
            AxisResponse(
                axis,
                UNITS[axis],
                encoder_tick / timing.current_loop_hz - delay_s,
                counts[:, encoder] / per_unit,
                servo_tick / timing.current_loop_hz,
                commanded[:, place] / per_unit,
                following_error[:, place] / per_unit,
                current_command[0] / timing.current_loop_hz,
                current_command[1][:, place],
                currents[0] / timing.current_loop_hz,
                _driving_current(currents, place, amplifier, encoders),
            )
        )
    return responses


def _driving_current(
    currents: tuple[np.ndarray, np.ndarray],
    axis: int,
    amplifier: np.void,
    encoders: tuple[np.ndarray, np.ndarray],
) -> np.ndarray:
    """
    Return 2/3 sum_k i_k sin(theta - 2 pi (k - 1) / 3) in A, from the two measured lines of an axis.

    theta is the electrical angle that the amplifier uses: newest counts, held between messages.
    """
    theta = electrical_angle(currents[0], axis, amplifier, encoders)
    return driving_part(three_lines(currents[1], axis), theta)
