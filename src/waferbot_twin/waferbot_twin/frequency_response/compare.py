# SPDX-License-Identifier: Apache-2.0
"""Measured beside simulated: the same commands, the same estimator, the peaks of both."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.timing import Timing
from waferbot_twin.effects.places import motor_axes
from waferbot_twin.effects.variant import Variant
from waferbot_twin.frequency_response.channels import (
    DERIVED,
    Channel,
    run_of,
    unit_of,
)
from waferbot_twin.frequency_response.estimate import (
    ComplexArray,
    FrequencyResponse,
    Run,
    estimate,
)
from waferbot_twin.frequency_response.linear_plant import position_over_force
from waferbot_twin.frequency_response.peaks import Pair, match
from waferbot_twin.frequency_response.simulated import simulated_log
from waferbot_twin.logs.load import load_log
from waferbot_twin.logs.measured import MeasuredLog

HIGHEST_HZ = 500.0
"""Up to where responses are estimated if nobody says otherwise."""


@dataclass(frozen=True)
class Comparison:
    """
    A frequency response by measurement and, if it could be simulated, by the model.

    `linear` is what the linearised plant of the model has at the frequencies of `measured`, None for
    other responses than that of the plant. `pairs` are the peaks. `notes` say what could not be done,
    `titles` what the model calls its axes.
    """

    logs: tuple[str, ...]
    channels: tuple[Channel, Channel]
    unit: str
    model: str
    measured: FrequencyResponse
    simulated: FrequencyResponse | None
    linear: ComplexArray | None
    pairs: tuple[Pair, ...]
    notes: tuple[str, ...]
    titles: Mapping[str, str]


def read_log(
    path: Path, mapping: str | None, model: str, variant: Variant | None = None
) -> MeasuredLog:
    """
    Return a log; `model` gives the settings behind the twin's topics where it does not hold them.

    Of a machine alone, `variant`, there are none; it tells what counts and joints are.
    """
    machine = variant.machine_text if variant is not None else None
    try:
        return load_log(path, mapping, machine=machine)
    except UserError:
        if variant is not None and variant.is_machine_alone:
            raise
        return load_log(path, mapping, model)


def compare(
    logs: Sequence[MeasuredLog],
    channels: tuple[Channel, Channel],
    variant: Variant,
    resolution_hz: float | None = None,
    highest_hz: float | None = None,
    direct: bool = False,
) -> Comparison:
    """
    Return the frequency response in logs, and what a model has in its place.

    `direct` leaves the commanded position out of the estimate. Raises `UserError` if the logs do not
    have the signals; where the model cannot do the same (no commands, unstable) a note tells it.
    """
    highest_hz = highest_hz or HIGHEST_HZ

    def response(of: Sequence[MeasuredLog]) -> FrequencyResponse:
        runs = [run_of(log, channels, variant) for log in of]
        if direct:
            runs = [Run(run.step_s, run.input, run.output) for run in runs]
        raw = estimate(runs, resolution_hz, highest_hz)
        factors = [channel.factor(raw.frequency_hz, runs[0].step_s) for channel in channels]
        return raw.times(factors[1] / factors[0])

    measured = response(logs)
    notes = []
    if measured.method == 'direct' and not direct:
        notes.append(
            'no commanded position that moves: the direct estimate is right in open loop only; in '
            'closed loop noise pulls it towards the controller'
        )
    simulated = None
    try:
        simulated = response([simulated_log(variant, log, Timing()) for log in logs])
    except UserError as error:
        notes.append(f'not simulated: {error}')
    pairs = match(measured, simulated if simulated is not None else None)
    return Comparison(
        tuple(log.name for log in logs), channels, unit_of(channels, variant), variant.name,
        measured, simulated, _linear(channels, variant, measured, logs), tuple(pairs), tuple(notes),
        variant.titles,
    )  # fmt: skip


def _linear(
    channels: tuple[Channel, Channel],
    variant: Variant,
    measured: FrequencyResponse,
    logs: Sequence[MeasuredLog],
) -> ComplexArray | None:
    """Return the response of the linearised plant where the axes stood on average in the first log."""
    source, target = channels
    moved = target.kind in ('position', *DERIVED)
    known = {source.axis, target.axis} <= set(motor_axes(variant))
    if source.kind != 'force' or not moved or not known:
        return None
    positions = {
        axis: float(signal.value.mean())
        for axis in motor_axes(variant)
        if (signal := logs[0].get(axis, 'position')) is not None
    }
    omega = 2j * np.pi * measured.frequency_hz
    power = {'position': 0, 'velocity': 1, 'acceleration': 2}[target.kind]
    axes = (source.axis, target.axis)
    return position_over_force(variant, axes, measured.frequency_hz, positions) * omega**power
