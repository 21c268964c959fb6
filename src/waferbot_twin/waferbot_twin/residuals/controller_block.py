# SPDX-License-Identifier: Apache-2.0
"""
The controller alone: given measured counts and commanded positions, what is left of its command.

Residual is the measured current command less the one that the model's servo computes, A. The servo is
deterministic, so with the true settings it is zero to the last bit; the floor is a fraction of a step
of its output. That takes the very counts that the servo saw, at every servo tick: an axis of which an
imported log has others is not looked at. Compensation tables over position and speed are part of the
controller. For controllers of other makes see `described_controller_block`.
"""

from __future__ import annotations

import numpy as np

from waferbot_pmac import compensation, servo
from waferbot_pmac.i_variables import servo_parameters
from waferbot_twin.effects.places import described_axes
from waferbot_twin.effects.variant import Variant
from waferbot_twin.noise_model.prediction_error import Noise
from waferbot_twin.replay import replay_servo
from waferbot_twin.residuals.described_controller_block import DescribedControllerBlock
from waferbot_twin.residuals.record import Array, Record

FLOOR_BITS = 0.05
"""Smallest standard deviation of the residual, in steps of the controller's output."""


def controller_block(
    record: Record, variant: Variant
) -> ControllerBlock | DescribedControllerBlock:
    """Return the controllers of a log that has what they were given and what they made of it."""
    if described_axes(variant):
        return DescribedControllerBlock(record, variant)
    return ControllerBlock(record, variant)


class ControllerBlock:
    """The controller's residual of one log, for any variant of the model."""

    order = 0
    """It is rounding that is left over, not noise: nothing to whiten, and nothing to hide in."""

    def __init__(self, record: Record, variant: Variant) -> None:
        """Prepare what does not depend on the model."""
        assert record.commanded is not None
        assert record.command is not None
        self.record = record
        self._axes = [
            place
            for place, axis in enumerate(record.layout.axes)
            if axis in record.controlled
            and variant.pmac.get(axis)
            and record.whole_counts
            and np.isfinite(record.command[:, place]).all()
        ]
        self.channels = [record.layout.axes[place] for place in self._axes]
        per_bit = (
            servo_parameters(variant.pmac, variant.name, variant.layout)[0][
                'amplifier_peak_current'
            ]
            / 32768.0
        )
        self.noises = [
            Noise(float(FLOOR_BITS * per_bit[place]), self.order) for place in self._axes
        ]
        rows = record.timing.servo_divider // record.timing.encoder_divider
        seen = record.reading[::rows][: len(record.command)]
        self._counts = np.ascontiguousarray(np.nan_to_num(seen)).astype(np.int64)

    def times_s(self, channel: str) -> Array:
        """Return the time of every sample of a channel's residual, s from the log's beginning."""
        assert self.record.command is not None
        timing = self.record.timing
        first = round(self.record.judged_from_s * timing.servo_hz)
        return np.asarray(np.arange(first, len(self.record.command)) / timing.servo_hz)

    def residuals(self, variant: Variant) -> list[Array]:
        """Return measured less computed command of every controlled axis, A."""
        assert self.record.command is not None
        assert self.record.commanded is not None
        parameters = servo_parameters(variant.pmac, variant.name, variant.layout)
        state = servo.initial_state(parameters)
        computed = np.zeros_like(self.record.command)
        # A log does not say which experiment it is of, so tables over time are left out.
        offsets = compensation.offsets(
            variant.compensation,
            '',
            self.record.commanded,
            parameters,
            self.record.timing.servo_hz,
        )
        replay_servo(state, parameters, self._counts, self.record.commanded, offsets, computed)
        left = self.record.command - computed
        first = round(self.record.judged_from_s * self.record.timing.servo_hz)
        return [left[first:, place] for place in self._axes]
