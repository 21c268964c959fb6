# SPDX-License-Identifier: Apache-2.0
"""
How much of the measured force a model leaves over, by inverse dynamics.

With position q and force F of a log, L the low-pass filter of the least squares beside it, and F_m what
the model's motor must do for a motion (`waferbot_plant.inverse_dynamics`),

    e = L (L F - F_m(L q, (L q)', (L q)'')),        relative error = |e| / |L L F|,               (1)

where the axis moves and the filter has settled. The outer L is there as a model's friction turns at
once where measured force was filtered. Least squares answer the same question, so both errors stand
side by side (`identification.least_squares`): what a simulation explains of a position, in a force. If
a model reads a position late by d, and the drive stands in the log late by T, F is taken at t + T - d.
Of a drive that lags, F is what follows the logged force (`motors.lagged`).

Limit: of a machine with one motor alone, whose inverse dynamics need no other axis.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from waferbot_lockstep.errors import UserError
from waferbot_plant import motors
from waferbot_plant.inverse_dynamics import InverseDynamics
from waferbot_twin.effects import places
from waferbot_twin.effects.variant import Variant
from waferbot_twin.estimation.inverse_dynamics import (
    Array,
    Stretch,
    Terms,
    derivatives,
    filtered,
    low_pass_of,
    relative_error,
)
from waferbot_twin.identification.least_squares import AxisFit, stretches_of
from waferbot_twin.logs.measured import MeasuredLog


def force_error(
    log: MeasuredLog, fit: AxisFit, nominal: Variant, variant: Variant
) -> float | None:
    """
    Return the relative error (1) of a variant in a log, at the cut-off of the least squares `fit`.

    In forces that the nominal model's motor makes of the currents. None where the machine has more than
    one motor, or cannot be told so, or nothing moves.
    """
    axis = fit.axis
    if places.motor_axes(nominal) != (axis,) or fit.force_unit != places.force_unit(nominal, axis):
        return None
    late_s = fit.late_s + variant.skew_s.get(axis, 0.0) + variant.between_s.get(axis, 0.0)
    late_s -= variant.description.encoders[places.position_encoder(nominal, axis)].errors.delay
    try:
        dynamics = InverseDynamics(variant.description)
        lag_s = places.drive_lags(variant)[nominal.base.layout.place(axis)]
        per_ampere = places.force_per_ampere(nominal, axis)
        parts = [
            _forces(_lagged(one, lag_s), fit.cut_off_hz, dynamics, per_ampere)
            for one in stretches_of(log, axis, nominal, late_s)
        ]
    except UserError:
        return None
    measured, left = (np.concatenate(rows) for rows in zip(*parts, strict=True))
    found = relative_error(measured, left)
    return None if math.isnan(found) else found


def _lagged(stretch: Stretch, lag_s: float) -> Stretch:
    """Return a stretch with the force that follows what was logged."""
    force = motors.lagged(stretch.force[:, None], np.array([lag_s]), stretch.step_s)
    return replace(stretch, force=force[:, 0])


def _forces(
    stretch: Stretch, cut_off_hz: float, dynamics: InverseDynamics, per_ampere: float
) -> tuple[Array, Array]:
    """Return measured force and error (1) of the samples of a stretch that move."""
    low_pass, _ = low_pass_of(stretch, cut_off_hz)
    position = low_pass(stretch.position)
    speed, acceleration = derivatives(position, stretch.step_s)
    motion: Sequence[Array] = [one[:, None] for one in (position, speed, acceleration)]
    model = per_ampere * dynamics.currents(*motion)[:, 0]
    measured = low_pass(stretch.force)
    part = filtered(stretch, cut_off_hz, Terms())
    keep = slice(None, None, max(1, round(part.step_s / stretch.step_s)))
    rows = (low_pass(measured)[keep][part.moving], low_pass(measured - model)[keep][part.moving])
    return rows
