# SPDX-License-Identifier: Apache-2.0
"""A run or a log seen by axis, in SI units: position, command, following error, current."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from waferbot_lockstep.timing import Timing
from waferbot_twin.commutation import driving_part, electrical_angle, three_lines
from waferbot_twin.engines.inprocess import Signals, Twin
from waferbot_twin.metrics import StepMetrics, rms, step_metrics


@dataclass(frozen=True)
class AxisResponse:
    """
    One axis of a recording. Arrays over time in s; positions in m or rad, currents in A.

    `position` is what the position encoder counted, shifted by its one phase cycle of delay, so that
    it stands at the time at which the axis was there. `current` is the part of the measured line
    currents that makes force: their projection on the commutation's sine, positive drives forward.

    Of an imported log everything is as it was measured, at the log's own times. Arrays of what it does
    not have are empty. `error_time` are the times of `following_error`; those of `servo_time` if None.
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
    error_time: np.ndarray | None = None

    @property
    def following_time(self) -> np.ndarray:
        """Times of `following_error`, s."""
        return self.servo_time if self.error_time is None else self.error_time

    def moves(self) -> bool:
        """Return whether a motion is commanded; where commands are not known, whether it moved."""
        path = self.commanded if len(self.commanded) else self.position
        return bool(np.any(np.diff(path)))

    def step(self) -> tuple[float, float] | None:
        """Return time and height of the first step commanded; None if it is not a single jump."""
        change = np.diff(self.commanded)
        jumps = np.flatnonzero(change)
        if len(jumps) == 0 or (len(jumps) > 1 and jumps[1] == jumps[0] + 1):
            return None
        return float(self.servo_time[jumps[0] + 1]), float(change[jumps[0]])

    def metrics(self, rise: str = 'first', level_shift: float = 0.0) -> StepMetrics | None:
        """
        Return the figures of the first step, up to the next one; None if there is none, or no position.

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
    ) -> StepMetrics | None:
        """Return the figures of the step behind cycle `jump`, up to `end_s`; None without positions."""
        start_s = float(self.servo_time[jump + 1])
        part = (self.encoder_time >= start_s) & (self.encoder_time < end_s)
        if not part.any():
            return None
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


def simulated_responses(twin: Twin, signals: Signals) -> list[AxisResponse]:
    """Return the axes of what an in-process twin has just run, without recording it."""
    commanded, following_error = np.split(signals.servo_state, 5, axis=1)[:2]
    timing = signals.timing
    encoders = (np.array(signals.encoder_ticks), signals.counts)
    ticks = np.arange(signals.first, signals.first + signals.ticks)
    servo_ticks = np.array(signals.servo_ticks)
    currents = [
        driving_current(ticks, signals.line_current, axis, twin.amplifier_parameters[0], encoders)
        for axis in range(len(twin.layout.axes))
    ]
    return responses_of(
        timing,
        twin.machine.description.axis_units,
        twin.servo_parameters[0],
        encoders,
        (servo_ticks, commanded, following_error),
        (servo_ticks, signals.current_command),
        [(ticks / timing.current_loop_hz, current) for current in currents],
    )


def responses_of(
    timing: Timing,
    units: Mapping[str, str],
    servo: np.void,
    encoders: tuple[np.ndarray, np.ndarray],
    servo_state: tuple[np.ndarray, np.ndarray, np.ndarray],
    current_command: tuple[np.ndarray, np.ndarray],
    currents: Sequence[tuple[np.ndarray, np.ndarray]],
) -> list[AxisResponse]:
    """
    Return the axes.

    `encoders`, `servo_state` and `current_command` are ticks and values of those topics, `currents` of
    each axis times in s and the part that makes force, A; `servo` the settings that were used, `units`
    m or rad of each axis, as the machine has it.
    """
    encoder_tick, counts = encoders
    servo_tick, commanded, following_error = servo_state
    delay_s = timing.encoder_divider * timing.tick_s
    responses = []
    for place, axis in enumerate(units):
        per_unit = servo['counts_per_unit'][place]
        encoder = int(servo['Ixx03'][place])
        responses.append(
            AxisResponse(
                axis,
                units[axis],
                encoder_tick / timing.current_loop_hz - delay_s,
                counts[:, encoder] / per_unit,
                servo_tick / timing.current_loop_hz,
                commanded[:, place] / per_unit,
                following_error[:, place] / per_unit,
                current_command[0] / timing.current_loop_hz,
                current_command[1][:, place],
                *currents[place],
            )
        )
    return responses


def driving_current(
    ticks: np.ndarray,
    line_current: np.ndarray,
    axis: int,
    amplifier: np.void,
    encoders: tuple[np.ndarray, np.ndarray],
) -> np.ndarray:
    """
    Return 2/3 sum_k i_k sin(theta - 2 pi (k - 1) / 3) in A, from the two measured lines of an axis.

    `line_current` (n, 2 axes) at `ticks` (n,). theta is the electrical angle that the amplifier uses:
    newest counts of `encoders` (ticks, counts), held between messages.
    """
    theta = electrical_angle(ticks, axis, amplifier, encoders)
    return driving_part(three_lines(line_current, axis), theta)
