# SPDX-License-Identifier: Apache-2.0
"""
Two logs laid over one another; and the log that the closed loop of a model gives for the same commands.

Signals of the simulation are taken at the times of the measured ones, as they go between samples
(`Signal.at`); nothing is made up where one of them is not known.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.timing import Timing
from waferbot_twin.comparison.log_time import beginning_s, reading_times_s
from waferbot_twin.comparison.traces import Trace, trace
from waferbot_twin.effects import places
from waferbot_twin.effects.variant import Variant
from waferbot_twin.frequency_response.compare import read_log
from waferbot_twin.frequency_response.simulated import simulated_log
from waferbot_twin.logs.measured import LINEAR, MeasuredLog, Signal
from waferbot_twin.residuals.closed_loop_record import simulate
from waferbot_twin.residuals.from_measured_log import aligned_record, with_short_pauses_of


def traces_of(simulated: MeasuredLog, measured: MeasuredLog, later_s: float = 0.0) -> list[Trace]:
    """Return what both logs have, at the times of the measured one; the other is moved by `later_s`."""
    found = []
    for signal in measured.signals:
        other = simulated.get(signal.axis, signal.kind)
        if other is not None and other.unit == signal.unit:
            value, _ = other.at(signal.time_s - later_s)
            found += trace(
                signal.axis, signal.kind, signal.unit, '', signal.time_s, signal.value, value
            )
    return found


def later_s(simulated: MeasuredLog, measured: MeasuredLog) -> float:
    """
    Return how much later the motion begins in the measured log than in the simulated one, s.

    It begins where a commanded position that both have changes first; 0 if none does.
    """
    begins = [
        [
            float(signal.time_s[changed[0] + 1])
            for axis in simulated.axes()
            if simulated.get(axis, 'commanded_position')
            and (signal := log.get(axis, 'commanded_position')) is not None
            and measured.get(axis, 'commanded_position')
            and len(changed := np.flatnonzero(np.diff(signal.value)))
        ]
        for log in (simulated, measured)
    ]
    return min(begins[1]) - min(begins[0]) if all(begins) else 0.0


def in_closed_loop(path: Path, variant: Variant, model: str) -> tuple[MeasuredLog, MeasuredLog]:
    """
    Return a measured log, and what the closed loop of a model logs for the same commanded positions.

    `model` is what `variant` was loaded from; it gives the settings behind the twin's topics where the
    log does not hold them. Raises `UserError` if nothing was commanded or the controller is not known.
    """
    log = read_log(path, None, model, variant)
    if not any(log.get(axis, 'commanded_position') for axis in log.axes()):
        raise UserError(
            f'{log.name}: without commanded positions the closed loop cannot be run; '
            f'waferbot replay {path} --model {model} drives the plant by what was measured'
        )
    if places.described_axes(variant):
        short, clock = with_short_pauses_of(log, variant)
        simulated = _described(short, variant)
        logged = [replace(one, time_s=clock.logged_s(one.time_s)) for one in simulated.signals]
        return log, replace(simulated, signals=tuple(logged))
    if variant.is_machine_alone:
        raise UserError(
            f'{variant.name} is a machine alone: its controller is not known, so the loop cannot be '
            'closed; describe it in section controllers (docs/controllers.md), or take '
            f'waferbot replay {path} --model {model}'
        )
    simulated = simulated_log(variant, log, Timing())
    begin_s = min(
        float(signal.time_s[0])
        for axis in log.axes()
        if (signal := log.get(axis, 'commanded_position')) is not None
    )
    moved = tuple(replace(one, time_s=one.time_s + begin_s) for one in simulated.signals)
    return log, replace(simulated, signals=moved)


def _described(log: MeasuredLog, variant: Variant) -> MeasuredLog:
    """Return what the loop of described controllers logs, at the times at which the log was read."""
    record = aligned_record(log, variant)
    if not record.closes_loop:
        raise UserError(f'{log.name}: the loop cannot be closed: ' + '; '.join(record.notes))
    simulated = simulate(variant, record)
    begin_s = beginning_s(record, log, variant)
    layout = record.layout
    signals: list[Signal] = []
    for axis in places.described_axes(variant):
        commanded = log.get(axis, 'commanded_position')
        if commanded is None:
            continue
        signals.append(commanded)
        for kind, encoder in zip(
            ('position', 'motor_position'), layout.encoders_of(axis), strict=False
        ):
            signal = log.get(axis, kind)
            if signal is None:
                continue
            place = layout.encoder_place(encoder)
            rows, time_s = reading_times_s(record, variant, place)
            # The line by which the measured values became readings leads back from simulated ones.
            read_s = time_s + begin_s
            at = np.clip(np.searchsorted(signal.time_s, read_s - 1e-7), 0, len(signal.time_s) - 1)
            value, reading = signal.value[at], record.reading[rows, place]
            if np.ptp(reading) == 0.0:
                continue
            slope, offset = np.polyfit(reading, value, 1)
            signals.append(
                replace(
                    signal, time_s=read_s, value=slope * simulated.reading[rows, place] + offset
                )
            )
        current = log.get(axis, 'current')
        if current is not None and simulated.current is not None:
            ticks = np.arange(len(simulated.current)) + 0.5
            middle_s = np.asarray(begin_s + ticks * record.timing.tick_s, np.float64)
            value = simulated.current[:, layout.place(axis)]
            signals.append(
                replace(current, time_s=middle_s, value=value, hold=LINEAR, resolution=0.0)
            )
    return MeasuredLog(f'{log.name} by {variant.name}', tuple(signals))
