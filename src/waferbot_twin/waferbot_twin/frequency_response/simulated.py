# SPDX-License-Identifier: Apache-2.0
"""What a logger would have written had the model been commanded as the machine was."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from waferbot_lockstep.contract import CURRENT_COMMAND, ENCODERS_TOPIC, PHASE_CURRENTS, SERVO_STATE
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.timing import Timing
from waferbot_pmac.i_variables import servo_parameters
from waferbot_twin.effects.variant import Variant
from waferbot_twin.engines.inprocess import Signals
from waferbot_twin.logs.contract_signals import ContractSignals
from waferbot_twin.logs.machine import controls_of
from waferbot_twin.logs.measured import MeasuredLog
from waferbot_twin.logs.pauses import with_short_pauses
from waferbot_twin.logs.timebase import median_step_s
from waferbot_twin.recording.reader import Recording
from waferbot_twin.recording.writer import as_json
from waferbot_twin.residuals.closed_loop_record import run_commanded


def simulated_log(variant: Variant, log: MeasuredLog, timing: Timing) -> MeasuredLog:
    """
    Return the log of the closed loop of `variant` for the commanded positions of `log`.

    It begins at rest where the first commands are; an axis without commands is held at zero, and so are
    the last commands in a pause, of which no more than its beginning is simulated. Times count from the
    first command. Raises `UserError` if nothing was commanded, the model has no
    controller, or the loop is unstable.
    """
    if variant.is_machine_alone:
        raise UserError(
            f'{variant.name} is a machine alone: without its controller the loop cannot be run'
        )
    there = [
        one for axis in log.axes() if (one := log.get(axis, 'commanded_position')) is not None
    ]
    if not there:
        raise UserError(f'{log.name}: without commanded positions the model cannot do the same')
    short, clock = with_short_pauses(there, 1.0 / timing.servo_hz)
    known = {signal.axis: signal for signal in short}
    begin_s = min(signal.time_s[0] for signal in known.values())
    end_s = max(signal.time_s[-1] + median_step_s(signal.time_s) for signal in known.values())
    cycles = round((end_s - begin_s) * timing.servo_hz)
    times_s = begin_s + np.arange(cycles) / timing.servo_hz
    per_unit = servo_parameters(variant.pmac, variant.name, variant.layout)[0]['counts_per_unit']
    commanded = np.zeros((cycles, len(variant.layout.axes)))
    for place, axis in enumerate(variant.layout.axes):
        if axis in known:
            commanded[:, place] = _without_gaps(known[axis].at(times_s)[0]) * per_unit[place]
    signals = run_commanded(variant, timing, commanded, cycles * timing.servo_divider)
    controls = controls_of(variant.model(), timing, variant.name)
    taken = ContractSignals(_recording_of(signals, variant.name), controls)
    simulated = [
        replace(one, time_s=clock.logged_s(one.time_s + begin_s) - begin_s)
        for one in taken.signals
    ]
    return MeasuredLog(f'{log.name} by {variant.name}', tuple(simulated))


def _without_gaps(value: np.ndarray) -> np.ndarray:
    """Return values with those that are not known (NaN) replaced by the one before, or the first."""
    known = np.flatnonzero(np.isfinite(value))
    if len(known) == 0:
        return np.zeros_like(value)
    newest = np.searchsorted(known, np.arange(len(value)), side='right') - 1
    return value[known[np.maximum(newest, 0)]]


def _recording_of(signals: Signals, name: str) -> Recording:
    """Return the recording that a run in one process would have made, as far as a log needs it."""
    servo = dict(zip(
        ('commanded_position', 'following_error', 'output'),
        np.split(signals.servo_state, 5, axis=1), strict=False,
    ))  # fmt: skip
    layout = signals.layout
    every = range(signals.first, signals.first + signals.ticks)
    tables = {
        ENCODERS_TOPIC.name: (signals.encoder_ticks, layout.all_encoders, {'counts': signals.counts}),
        PHASE_CURRENTS.name: (every, layout.all_axes, {'current': signals.line_current}),
        CURRENT_COMMAND.name: (
            signals.servo_ticks, layout.all_axes, {'current': signals.current_command}
        ),
        SERVO_STATE.name: (signals.servo_ticks, layout.all_axes, servo),
    }  # fmt: skip
    topics = {}
    for topic, (ticks, valid, columns) in tables.items():
        fields: list[Any] = [('tick', np.uint64), ('valid', np.uint16)]
        fields += [(field, values.dtype, values.shape[1:]) for field, values in columns.items()]
        table = np.zeros(len(ticks), fields)
        table['tick'], table['valid'] = ticks, valid
        for field, values in columns.items():
            table[field] = values
        topics[topic] = table
    run = {
        'timing': asdict(signals.timing),
        'axes': list(layout.axes),
        'encoders': list(layout.encoders),
    }
    return Recording(Path(name), topics, {}, {}, True, {'run.json': as_json(run)})
