# SPDX-License-Identifier: Apache-2.0
"""
The contract's topics as signals of the axes, in SI units.

- Positions stand at the time at which the axis was there: the counts are one phase cycle old when
  they are published.
- Currents and voltages are measured at every tick. They are projected on the commutation's sine and
  then averaged over each servo cycle, and stand at its middle: that is what moved the axis in that
  cycle, without delay and without what a servo cannot see.
- Values of an axis for which a message does not speak are not there.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from waferbot_lockstep.contract import (
    CURRENT_COMMAND,
    ENCODERS_TOPIC,
    PHASE_CURRENTS,
    PHASE_VOLTAGES,
    SERVO_STATE,
)
from waferbot_twin.commutation import direct_part, driving_part, electrical_angle, three_lines
from waferbot_twin.logs.build import clean_signal
from waferbot_twin.logs.columns import Column
from waferbot_twin.logs.counting import FLOOR, counted
from waferbot_twin.logs.findings import Finding
from waferbot_twin.logs.kinds import KINDS, UNITS, is_linear
from waferbot_twin.logs.machine import Controls
from waferbot_twin.logs.measured import Signal
from waferbot_twin.recording.reader import Recording

FULL_COMMAND = 32768.0
"""DAC units of a full command."""

Array = NDArray[np.float64]


class ContractSignals:
    """Takes the signals out of a recording; `signals` and `findings` are what came of it."""

    def __init__(self, recording: Recording, controls: Controls) -> None:
        """Take everything that is there."""
        self.signals: list[Signal] = []
        self.findings: list[Finding] = []
        self._path = str(recording.path)
        self._topics = recording.topics
        self._controls = controls
        self._hz = controls.timing.current_loop_hz
        self._layout = controls.machine.layout
        recording.check_machine(self._layout)
        for axis in range(len(self._layout.axes)):
            self._positions(axis)
            self._servo(axis)
            self._currents(axis)
            self._voltages(axis)

    def _positions(self, axis: int) -> None:
        array = self._topics.get(ENCODERS_TOPIC.name)
        if array is None:
            return
        servo, machine = self._controls.servo, self._controls.machine
        first, second = int(servo['Ixx03'][axis]), int(servo['Ixx04'][axis])
        delay_s = self._controls.timing.encoder_divider * self._controls.timing.tick_s
        encoders = {'position': (first, float(servo['counts_per_unit'][axis]))}
        if second != first:
            encoder_name = self._layout.encoders[second]
            per_unit = machine.counts_per_unit.get(encoder_name)
            if per_unit is None:
                reason = f'the machine has no encoder {encoder_name}'
                where = f'{self._layout.axes[axis]}.motor_position'
                self.findings.append(Finding(where, reason))
            else:
                encoders['motor_position'] = (second, per_unit)
        for kind, (encoder, per_unit) in encoders.items():
            given = _given(array, encoder)
            time_s = array['tick'][given] / self._hz - delay_s
            counts = array['counts'][given, encoder]
            value, step = counts / per_unit, 1.0 / abs(per_unit)
            self._add(axis, kind, ENCODERS_TOPIC.name, time_s, value, step, per_unit > 0.0)

    def _servo(self, axis: int) -> None:
        state = self._topics.get(SERVO_STATE.name)
        per_unit = float(self._controls.servo['counts_per_unit'][axis])
        if state is not None:
            given = _given(state, axis)
            time_s = state['tick'][given] / self._hz
            for kind, name, scale in (
                ('commanded_position', 'commanded_position', per_unit),
                ('following_error', 'following_error', per_unit),
                ('drive_command', 'output', FULL_COMMAND),
            ):
                self._add(axis, kind, SERVO_STATE.name, time_s, state[name][given, axis] / scale)
        command = self._topics.get(CURRENT_COMMAND.name)
        if command is not None:
            given = _given(command, axis)
            time_s = command['tick'][given] / self._hz
            current = command['current'][given, axis]
            self._add(axis, 'current_command', CURRENT_COMMAND.name, time_s, current)

    def _currents(self, axis: int) -> None:
        array = self._topics.get(PHASE_CURRENTS.name)
        if array is None:
            return
        array = array[_given(array, axis)]
        theta = self._angle(array['tick'], axis)
        if theta is None or len(array) == 0:
            self._no_angle(axis, PHASE_CURRENTS.name, len(array))
            return
        lines = three_lines(array['current'], axis)
        for kind, part in (('current', driving_part), ('direct_current', direct_part)):
            self._add_average(
                axis, kind, PHASE_CURRENTS.name, array['tick'], part(lines, theta), 0.0
            )

    def _voltages(self, axis: int) -> None:
        array = self._topics.get(PHASE_VOLTAGES.name)
        if array is None:
            return
        # An open bridge leaves its terminals floating, whatever the voltages say.
        array = array[_given(array, axis) & (array['open'] >> axis & 1 == 0)]
        theta = self._angle(array['tick'], axis)
        if theta is None or len(array) == 0:
            self._no_angle(axis, PHASE_VOLTAGES.name, len(array))
            return
        terminals = [array['voltage'][:, 3 * axis + line] for line in range(3)]
        # A voltage stands until the next tick, so its middle is half a tick later.
        value = driving_part(terminals, theta)
        self._add_average(axis, 'voltage_q', PHASE_VOLTAGES.name, array['tick'], value, 0.5)

    def _angle(self, ticks: NDArray[np.uint64], axis: int) -> Array | None:
        """Return the electrical angle at ticks; None without the counts that tell it."""
        encoders = self._topics.get(ENCODERS_TOPIC.name)
        if encoders is None:
            return None
        amplifier = self._controls.amplifier
        known = encoders[_given(encoders, int(amplifier['commutation_encoder'][axis]))]
        if len(known) == 0:
            return None
        return electrical_angle(ticks, axis, amplifier, (known['tick'], known['counts']))

    def _no_angle(self, axis: int, topic: str, count: int) -> None:
        if count:
            reason = (
                'without the counts of its commutation encoder nobody knows which part makes force'
            )
            where = f'{self._path}, topic {topic}, {self._layout.axes[axis]}'
            self.findings.append(Finding(where, reason))

    def _add_average(
        self,
        axis: int,
        kind: str,
        topic: str,
        ticks: NDArray[np.uint64],
        value: Array,
        late: float,
    ) -> None:
        """Add the averages over whole servo cycles, at their middles."""
        divider = self._controls.timing.servo_divider
        cycle, begin, count = np.unique(ticks // divider, return_index=True, return_counts=True)
        whole = count == divider
        if not whole.any():
            return
        mean = np.add.reduceat(value, begin)[whole] / divider
        middle = cycle[whole] * divider + (0.5 * (divider - 1) + late)
        self._add(axis, kind, topic, middle / self._hz, mean)

    def _add(
        self,
        axis: int,
        kind: str,
        topic: str,
        time_s: Array,
        value: Array,
        resolution: float | None = 0.0,
        up: bool | None = None,
    ) -> None:
        """Add a signal; `up`: it is one of counts, which rise as it does, or fall."""
        if len(time_s) == 0:
            return
        name = self._layout.axes[axis]
        linear = is_linear(name, self._controls.machine.linear)
        unit = UNITS[KINDS[kind].quantity(linear)]
        sample = np.arange(len(value))
        column = Column(value, f'{self._path}, topic {topic}', 'message', sample + 1, sample)
        signal = clean_signal(name, kind, unit, column, time_s, self.findings, resolution)
        if signal is not None and up is not None:
            signal = counted(signal, FLOOR, up, self.findings)
        if signal is not None:
            self.signals.append(signal)


def _given(array: np.ndarray, place: int) -> NDArray[np.bool_]:
    """Return which messages speak for a place."""
    return (array['valid'] >> place & 1).astype(bool)
