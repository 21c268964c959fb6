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
from waferbot_pmac.i_variables import servo_parameters
from waferbot_twin.metrics import StepMetrics, step_metrics
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
    current_command: np.ndarray
    tick_time: np.ndarray
    current: np.ndarray

    def step(self) -> tuple[float, float] | None:
        """Return time and height of the first step commanded; None if it is not a single jump."""
        change = np.diff(self.commanded)
        jumps = np.flatnonzero(change)
        if len(jumps) == 0 or (len(jumps) > 1 and jumps[1] == jumps[0] + 1):
            return None
        return float(self.servo_time[jumps[0] + 1]), float(change[jumps[0]])

    def metrics(self) -> StepMetrics | None:
        """Return the figures of the first step, up to the next one; None if there is no step."""
        step = self.step()
        if step is None:
            return None
        start_s, height = step
        later = np.flatnonzero(np.diff(self.commanded))[1:]
        end_s = self.servo_time[later[0] + 1] if len(later) else np.inf
        part = (self.encoder_time >= start_s) & (self.encoder_time < end_s)
        before = self.commanded[self.servo_time < start_s]
        origin = before[-1] if len(before) else 0.0
        return step_metrics(
            self.encoder_time[part] - start_s, self.position[part] - origin, height
        )


def axis_responses(recording: Recording) -> list[AxisResponse]:
    """Return the three axes of a recording; raises `UserError` if a contract topic is missing."""
    timing = recording.timing
    model = recorded_model(recording)
    servo = servo_parameters(model.of_axes('pmac'), str(recording.path))[0]
    amplifier = amplifier_parameters(model.of_axes('copley'), timing, str(recording.path))[0]
    encoders, currents = recording[ENCODERS_TOPIC], recording[PHASE_CURRENTS]
    servo_state, command = recording[SERVO_STATE], recording[CURRENT_COMMAND]
    delay_s = timing.encoder_divider * timing.tick_s
    responses = []
    for place, axis in enumerate(AXES):
        per_unit = servo['counts_per_unit'][place]
        encoder = int(servo['Ixx03'][place])
        responses.append(
            AxisResponse(
                axis,
                UNITS[axis],
                encoders['tick'] / timing.current_loop_hz - delay_s,
                encoders['counts'][:, encoder] / per_unit,
                servo_state['tick'] / timing.current_loop_hz,
                servo_state['commanded_position'][:, place] / per_unit,
                servo_state['following_error'][:, place] / per_unit,
                command['current'][:, place],
                currents['tick'] / timing.current_loop_hz,
                _driving_current(currents, place, amplifier, encoders),
            )
        )
    return responses


def _driving_current(
    currents: np.ndarray, axis: int, amplifier: np.void, encoders: np.ndarray
) -> np.ndarray:
    """
    Return 2/3 sum_k i_k sin(theta - 2 pi (k - 1) / 3) in A, from the two measured lines of an axis.

    theta is the electrical angle that the amplifier uses: newest counts, held between messages.
    """
    encoder = amplifier['commutation_encoder'][axis]
    rows = np.searchsorted(encoders['tick'], currents['tick'], side='right') - 1
    counts = encoders['counts'][np.maximum(rows, 0), encoder]
    cycle = amplifier['counts_per_electrical_cycle'][axis]
    turn = counts / cycle + amplifier['commutation_offset_turn'][axis]
    theta = 2.0 * np.pi * (turn % 1.0)
    one, two = currents['current'][:, 2 * axis], currents['current'][:, 2 * axis + 1]
    projected = sum(
        current * np.sin(theta - 2.0 * np.pi * phase / 3.0)
        for phase, current in enumerate((one, two, -(one + two)))
    )
    return 2.0 / 3.0 * projected
