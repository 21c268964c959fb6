# SPDX-License-Identifier: Apache-2.0
"""
An identification from beginning to end: logs and names in, values, doubts and gain out.

The gain is measured in logs with another motion if there are any, else in those of the fit, and then
it says little.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.signal import lfilter

from waferbot_lockstep.errors import UserError
from waferbot_twin.effects.variant import Variant
from waferbot_twin.estimation.known_values import Known
from waferbot_twin.estimation.noise_of_currents import without_noise_of_currents
from waferbot_twin.identification.estimation import Estimate, Progress, estimate, with_known
from waferbot_twin.identification.named_parameters import NamedParameter
from waferbot_twin.identification.whiteness import LAGS, Whiteness, whiteness
from waferbot_twin.noise_model.prediction_error import autoregression
from waferbot_twin.residuals.observer_bandwidth import with_observers
from waferbot_twin.residuals.problem import BlockOfLog, Problem
from waferbot_twin.residuals.record import Array, Record
from waferbot_twin.residuals.shown import shown_residual
from waferbot_twin.residuals.windows import Windows
from waferbot_twin.validation.gain import AxisGain, gains

AT_BOUND = 0.01
"""Distance from its bound, in half ranges, at which a parameter is said to be there."""


@dataclass(frozen=True)
class Channel:
    """
    What is left over in one channel of a block: RMS before and after, and if it is white.

    `step_s` is the time from sample to sample, the unit of the lags of `whiteness`.
    """

    block: str
    log: str
    name: str
    unit: str
    rms_before: float
    rms_after: float
    step_s: float
    whiteness: Whiteness | None


@dataclass(frozen=True)
class Identification:
    """The result of an identification; `independent` tells whether other logs judged it."""

    nominal: Variant
    identified: Variant
    estimate: Estimate
    channels: tuple[Channel, ...]
    gains: list[AxisGain]
    fitted: tuple[str, ...]
    judging: tuple[str, ...]
    independent: bool
    runtime_s: float
    notes: list[str] = field(default_factory=list)


def identify(
    nominal: Variant,
    records: Sequence[Record],
    judging: Sequence[Record],
    parameters: Sequence[NamedParameter],
    progress: Progress,
    known: Mapping[str, Known] | None = None,
    workers: int = 1,
) -> Identification:
    """
    Identify parameters of a model from logs.

    `known` are values from other logs of this machine, by path: they take part as readings do.
    So many `workers` simulate side by side; the result is the same to the last bit with any number.
    Raises `UserError` if the logs show none of them or the model cannot be simulated.
    """
    begun_s = time.perf_counter()
    logs = [Windows(record) for record in (*records, *judging)]
    logs, quiet = without_noise_of_currents(nominal, logs, logs[: len(records)], workers)
    whole = [one.record for one in logs]
    records, judging = whole[: len(records)], whole[len(records) :]
    problem = Problem(nominal, with_observers(records, nominal, nominal))
    fitted = estimate(problem, parameters, progress, workers)
    found, told = with_known(problem, fitted, known or {})
    identified = found.variant(nominal)
    notes = [*_notes(found), *quiet, *told]
    judges = list(judging or records)
    try:
        measured = gains(nominal, identified, judges)
    except UserError as error:
        measured = []
        notes.append(f'the gain could not be measured: {error}')
    if not judging:
        notes.append('no other logs (--validate): the gain is that in the logs of the fit')
    return Identification(
        nominal,
        identified,
        found,
        tuple(_channels(problem, found)),
        measured,
        tuple(record.name for record in records),
        tuple(record.name for record in judges),
        bool(judging),
        time.perf_counter() - begun_s,
        notes,
    )


def _notes(found: Estimate) -> list[str]:
    """Return what the reader of the values must know."""
    notes = []
    if not found.settled:
        notes.append('the fit has not settled: begin closer, or with fewer parameters')
    for parameter, scaled, left_open in zip(
        found.parameters, found.scaled, found.conditioning.open, strict=True
    ):
        low, high = parameter.scaled_range
        if not left_open and min(scaled - low, high - scaled) < AT_BOUND * parameter.half_range:
            notes.append(
                f'{parameter.path} ended at the end of its range ({parameter.low:.4g} to '
                f'{parameter.high:.4g} {parameter.unit}): give a wider one, or doubt the model'
            )
    return notes


def _channels(problem: Problem, found: Estimate) -> list[Channel]:
    """Return what is left over in every channel of the blocks in which parameters show."""
    result = []
    for block in found.blocks:
        place = 0
        for part in problem.blocks[block]:
            for name in part.channels:
                before, after = (
                    hypothesis.residuals[block][place]
                    for hypothesis in (found.before, found.after)
                )
                fitted = found.after.fits[block]
                factor, unit = shown_residual(part.record, problem.nominal, block, name)
                result.append(
                    Channel(
                        block,
                        part.record.name,
                        name,
                        unit,
                        factor * float(np.sqrt(np.mean(before**2))),
                        factor * float(np.sqrt(np.mean(after**2))),
                        float(np.median(np.diff(part.times_s(name)))),
                        _whiteness(
                            part, name, fitted.whitened[place], fitted.colours[place].error.order
                        ),
                    )
                )
                place += 1
    return result


def _whiteness(part: BlockOfLog, name: str, white: Array, order: int) -> Whiteness | None:
    """Return how white a channel is; None where it is rounding that is left over, or it is short."""
    if order == 0 or len(white) <= 2 * LAGS:
        return None
    layout = part.record.layout
    known = name in layout.encoders
    commanded = part.record.path_commanded(layout.axis_of(name)) if known else None
    if commanded is None:
        return whiteness(white, order)
    # What was commanded when each sample was taken; the first ones are left out by the whitening.
    cycle = (part.times_s(name) * part.record.timing.servo_hz).astype(np.intp)
    tail = commanded[np.minimum(cycle, len(commanded) - 1)][-len(white) - order :]
    if not np.ptp(tail) > 0.0:
        return whiteness(white, order)
    return whiteness(white, order, lfilter(autoregression(tail, order), 1.0, tail)[order:])
