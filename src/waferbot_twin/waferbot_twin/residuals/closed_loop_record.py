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

import numpy as np
from numpy.typing import NDArray

from waferbot_lockstep.contract import AXES, ENCODERS
from waferbot_lockstep.timing import Timing
from waferbot_plant.encoders import find_positions
from waferbot_twin.effects.variant import Variant, built
from waferbot_twin.engines.inprocess import Signals, Twin
from waferbot_twin.residuals.from_recording import record_of_signals
from waferbot_twin.residuals.record import Record


def simulate(variant: Variant, record: Record) -> Record:
    """
    Return what the closed loop of `variant` logs for the commanded positions of `record`.

    It has only the signals that `record` has, so that the same blocks can be replayed, and begins at
    rest where the log begins. Raises `UserError` if the loop is unstable.
    """
    assert record.commanded is not None
    signals = run_commanded(variant, record.timing, record.commanded, record.ticks)
    return _with_signals_of(record, record_of_signals(record.name, signals))


def run_commanded(
    variant: Variant, timing: Timing, commanded: NDArray[np.float64], ticks: int
) -> Signals:
    """
    Run the closed loop of `variant` over commanded positions (cycles, 3) in counts of its encoders.

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
    twin.commanded = commanded - begin
    return twin.advance(ticks)


def _axes_that_read(twin: Twin, counts: NDArray[np.float64]) -> dict[str, float]:
    """
    Return the position of each axis, m or rad, at which its encoder shows these counts (3,).

    In the middle of the count: counts are rounded down.
    """
    parameters = twin.plant_parameters.copy()
    parameters['delay_fraction'] = 0.0  # it stands
    parameters['counts_per_unit'][:, len(AXES) :] = 0.0  # those of motors go with the others
    by_coordinate = np.zeros((1, len(twin.machine.coordinates)))
    of_encoders = np.concatenate([counts + 0.5, np.zeros(len(ENCODERS) - len(AXES))])
    find_positions(twin.plant_state.copy(), parameters, of_encoders[None, :], by_coordinate)
    p, per_unit = parameters[0], twin.servo_parameters[0]['counts_per_unit']
    return {
        axis: float(
            by_coordinate[0, p['encoder_coordinate'][place]]
            * p['counts_per_unit'][place]
            / per_unit[place]
        )
        for place, axis in enumerate(AXES)
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
        simulated, command=command, terminals=terminals, judged_from_s=record.judged_from_s
    )
