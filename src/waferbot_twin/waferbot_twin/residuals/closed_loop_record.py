# SPDX-License-Identifier: Apache-2.0
"""
The log that a model would have given for the same commanded positions, without any noise.

It serves twice. As a prediction it shows what a correction gains. As an instrument it protects the
decision: in a loop, noise moves the axis and the controller answers, so that currents and noise go
together and a force constant seems wrong that is not. What the *command* causes knows nothing of the
noise, and the signature of an effect in this log is free of it.

Source: instrumental variables in closed loop, L. Ljung, System Identification, 2nd ed., section 13.4.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from waferbot_lockstep.timing import Timing
from waferbot_plant.encoders import find_positions
from waferbot_twin.controllers.closed_loop import Begin, Counting, run
from waferbot_twin.effects.places import counts_per_unit, described_axes, encoder_places
from waferbot_twin.effects.variant import Variant, built
from waferbot_twin.engines.inprocess import Signals, Twin
from waferbot_twin.residuals.described_controller_block import DescribedControllerBlock
from waferbot_twin.residuals.from_recording import record_of_signals
from waferbot_twin.residuals.record import Array, Record

BEGIN_S = 0.02
"""Time over which the position and speed of an imported log are taken as those at its beginning, s."""


def simulate(variant: Variant, record: Record) -> Record:
    """
    Return what the closed loop of `variant` logs for the commanded positions of `record`.

    It has only the signals that `record` has, so that the same blocks can be replayed, and begins at
    rest where the log begins; of an imported log with the first positions and speeds, and with readings
    at the times at which the log has them. Raises `UserError` if the loop is unstable.
    """
    assert record.commanded is not None
    if described_axes(variant):
        return _described(variant, record)
    commanded = np.nan_to_num(record.commanded)
    signals = run_commanded(variant, record.timing, commanded, record.ticks)
    simulated = record_of_signals(record.name, signals)
    if not record.is_imported:
        return _with_signals_of(record, simulated)
    rows = np.minimum(np.arange(len(record.reading)), len(simulated.reading) - 1)
    seen = simulated.reading[rows] + 0.5  # the twin's encoders round down
    speed = np.gradient(seen, axis=0) * record.timing.encoder_hz
    return replace(
        _with_signals_of(record, simulated),
        reading=np.where(np.isfinite(record.reading), seen + _late_s(record) * speed, np.nan),
        whole_counts=False,
        **_how_read(record),
    )


def _described(variant: Variant, record: Record) -> Record:
    """Return what the loop of described controllers logs, by the measured log's own times."""
    assert record.commanded is not None
    per_unit = counts_per_unit(variant)
    counting = Counting(
        np.where(record.counted, record.resolution, 0.0),
        (np.array(record.half_step) != 0.0).astype(float),
    )
    begin = _begin(variant, record, per_unit)
    commanded = np.where(
        np.isfinite(record.commanded), record.commanded / per_unit, begin.position
    )
    done = run(variant, record.timing, commanded, begin, counting)
    published = built(variant, record.timing).parameters()[0]
    rows = np.arange(len(record.reading))
    seen = np.zeros_like(record.reading)
    for place in range(seen.shape[1]):
        taken = np.maximum(rows - published['encoder_delay'][place], 0)
        seen[:, place] = done.seen[taken, place]
        seen[:, place] += _late_s(record)[:, place] * done.speed[taken, place]
    command = record.command
    if command is not None:
        command = np.where(np.isfinite(command), done.command, np.nan)
    return Record(
        record.name,
        record.timing,
        np.full((record.ticks, 2 * len(record.layout.axes)), np.nan),
        _read_as(record, seen, published['coarseness']),
        record.commanded,
        command,
        whole_counts=False,
        judged_from_s=record.judged_from_s,
        current=done.current[: record.ticks],
        **_how_read(record),
    )


def _how_read(record: Record) -> dict[str, Any]:
    """Return what a simulated log has in common with the measured one: how and when it was read."""
    return {
        'late_s': record.late_s,
        'resolution': record.resolution,
        'half_step': record.half_step,
        'counted': record.counted,
        'controlled': record.controlled,
        'observer_hz': record.observer_hz,
        'layout': record.layout,
    }


def _late_s(record: Record) -> Array:
    """Return how much after the tick of its row each reading was taken (rows, encoders), s."""
    return np.zeros_like(record.reading) if record.late_s is None else record.late_s


def _read_as(record: Record, seen: Array, coarseness: Array) -> Array:
    """Return counts that encoders see as a log has them: in its steps, and where it has any."""
    steps = np.where(record.counted, record.resolution, 0.0)
    steps = np.where(coarseness > 1.0, np.maximum(steps, coarseness), steps)
    half_step = np.array(record.half_step)
    down = half_step != 0.0
    with np.errstate(invalid='ignore', divide='ignore'):
        whole = steps * np.floor(seen / steps + np.where(down, 0.0, 0.5))
    reading = np.where(steps > 0.0, whole + half_step, seen)
    return np.where(np.isfinite(record.reading), reading, np.nan)


def _begin(variant: Variant, record: Record, per_unit: Array) -> Begin:
    """Return where the axes of an imported log begin, and what their controllers put out there."""
    axes = len(record.layout.axes)
    position, velocity = np.zeros(axes), np.zeros(axes)
    for place, encoder in enumerate(encoder_places(variant)):
        if np.isfinite(record.reading[:, encoder]).any():
            position[place], velocity[place] = record.first_motion(encoder, BEGIN_S, 2)
    integral: Array = np.zeros(axes)
    current: Array = np.zeros(axes)
    if record.has_controller and record.command is not None:
        integral = DescribedControllerBlock(record, variant).first_integral(variant)
        current = np.nan_to_num(record.command[0])
    return Begin(position / per_unit, velocity / per_unit, integral, current)


def run_commanded(
    variant: Variant, timing: Timing, commanded: NDArray[np.float64], ticks: int
) -> Signals:
    """
    Run the closed loop of `variant` over commanded positions (cycles, axes) in counts of its encoders.

    It begins at rest where its encoders show the first of them. Raises `UserError` if the loop is
    unstable.
    """
    machine = built(variant, timing)
    twin = Twin(machine, variant.pmac, variant.copley, timing, variant.name)
    begin = commanded[0]
    if np.any(np.abs(begin) > 1.0):
        twin.plant_state = twin.machine.initial_state(
            twin.plant_parameters, _axes_that_read(twin, begin), holding=True
        )
    twin.command(commanded - begin, variant.compensation)
    return twin.advance(ticks)


def _axes_that_read(twin: Twin, counts: NDArray[np.float64]) -> dict[str, float]:
    """
    Return the position of each axis, m or rad, at which its encoder shows these counts (axes,).

    In the middle of the count: counts are rounded down.
    """
    read = twin.servo_parameters[0]['Ixx03']
    parameters = twin.plant_parameters.copy()
    parameters['delay_fraction'] = 0.0  # it stands
    encoders = len(twin.layout.encoders)
    others = [place for place in range(encoders) if place not in read]
    parameters['counts_per_unit'][:, others] = (
        0.0  # go with those by which the axes are positioned
    )
    by_coordinate = np.zeros((1, len(twin.machine.coordinates)))
    of_encoders = np.zeros(encoders)
    of_encoders[read] = counts + 0.5
    find_positions(twin.plant_state.copy(), parameters, of_encoders[None, :], by_coordinate)
    p = parameters[0]
    return {
        axis: float(
            by_coordinate[0, p['encoder_coordinate'][place]]
            * p['counts_per_unit'][place]
            / per_unit
        )
        for axis, place, per_unit in zip(
            twin.layout.axes, read, twin.servo_parameters[0]['counts_per_unit'], strict=True
        )
        if axis in twin.machine.description.axes and p['counts_per_unit'][place] != 0.0
    }


def _with_signals_of(record: Record, simulated: Record) -> Record:
    """Return what was simulated without the signals that a log does not have, judged where it is."""
    terminals = None
    if simulated.terminals is not None and record.terminals is not None:
        voltage = None if record.terminals.voltage is None else simulated.terminals.voltage
        terminals = replace(simulated.terminals, voltage=voltage)
    command = None if record.command is None else simulated.command
    return replace(
        simulated,
        command=command,
        terminals=terminals,
        judged_from_s=record.judged_from_s,
        observer_hz=record.observer_hz,
    )
