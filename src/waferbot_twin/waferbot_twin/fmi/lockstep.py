# SPDX-License-Identifier: Apache-2.0
"""
An FMU in lock-step with PMAC and Copley, in this process.

Within a tick all is as in `engines.inprocess`: what the FMU shows at tick k, PMAC, Copley, and a step
of the FMU by one tick with the voltages held. As a node over ROS: `waferbot_plant.mechanisms`.
"""

from __future__ import annotations

import numpy as np

from waferbot_copley import amplifier
from waferbot_lockstep.contract import SLOW_DIVIDER
from waferbot_plant.foreign_plant import ForeignPlant
from waferbot_pmac import servo
from waferbot_twin.engines.inprocess import Signals, Twin


def advance(twin: Twin, foreign: ForeignPlant, ticks: int) -> Signals:
    """Run the next `ticks` ticks of a twin with a foreign plant in the place of its own."""
    timing = twin.timing
    signals = Signals(twin.tick, ticks, timing, twin.layout)
    axes, all_axes = len(twin.layout.axes), twin.layout.all_axes
    messages = 0
    rows = {'counts': 0, 'servo': 0, 'slow': 0}
    for row in range(ticks):
        tick = twin.tick + row
        counts, lines, position, velocity = foreign.parts(foreign.values())
        line_current = lines.copy()
        signals.line_current[row] = line_current
        if tick % timing.encoder_divider == 0:
            twin._counts[:] = np.rint(counts)
            signals.counts[rows['counts']] = twin._counts
            rows['counts'] += 1
        if tick % SLOW_DIVIDER == 0:
            signals.joint_position[rows['slow']] = position
            signals.joint_velocity[rows['slow']] = velocity
            rows['slow'] += 1
        if tick % timing.servo_divider == 0:
            _servo_cycle(twin, tick // timing.servo_divider, signals, rows['servo'])
            rows['servo'] += 1
        amplifier.step(
            twin.amplifier_state, twin.amplifier_parameters, all_axes, twin._current, line_current,
            twin._counts, signals.voltage[row],
        )  # fmt: skip
        mask = amplifier.open_bridges(twin.amplifier_state)
        signals.open_bridges[row] = mask
        told = all_axes if tick % SLOW_DIVIDER == 0 else amplifier.changed(twin.amplifier_state)
        if told:
            limits, faults = np.zeros(axes, np.uint8), np.zeros(axes, np.uint32)
            i2t = signals.amplifier_i2t[messages]
            if messages:
                i2t[:] = signals.amplifier_i2t[messages - 1]
                limits[:], faults[:] = signals.amplifier_bits[messages - 1]
            amplifier.report(
                twin.amplifier_state,
                twin.amplifier_parameters,
                told,
                i2t[0],
                i2t[1],
                limits,
                faults,
            )
            signals.amplifier_bits[messages] = limits, faults
            signals.amplifier_tick[messages], signals.amplifier_axes[messages] = tick, told
            messages += 1
        foreign.step(tick, signals.voltage[row], mask)
    signals.amplifier_messages[0] = messages
    twin.tick += ticks
    return signals


def _servo_cycle(twin: Twin, cycle: int, signals: Signals, row: int) -> None:
    """Run the PMAC on the counts that are there; fill a row of its signals."""
    if cycle == 0:
        twin._start[:] = twin._counts[twin.servo_parameters['Ixx03'][0]]
        servo.prime(twin.servo_state, twin.servo_parameters, twin._counts, twin._start)
    place = min(cycle, len(twin.commanded) - 1)
    twin.servo_state[0]['offset'] = twin.offsets[min(cycle, len(twin.offsets) - 1)]
    target = twin._start + twin.commanded[place]
    servo.step(twin.servo_state, twin.servo_parameters, twin._counts, target, twin._current)
    signals.current_command[row] = twin._current
    s = twin.servo_state[0]
    names = ('commanded_position', 'following_error', 'output', 'integrator', 'flags')
    signals.servo_state[row] = np.concatenate([s[name] for name in names])
