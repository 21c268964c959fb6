# SPDX-License-Identifier: Apache-2.0
"""
The Copley amplifiers as a ROS 2 node: current commands and measured currents in, voltages out.

One node drives the axes named by its parameter `axes`: all of the machine (`machine_axes`), or one each
in as many nodes. Every setting of an amplifier is a parameter (`y_linear.peak_current`, ...). Service
`~/reset_faults` clears the latched faults, `~/safe_torque_off` takes the gate drive away and gives it
back.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.parameter import Parameter as RosParameter
from std_srvs.srv import SetBool, Trigger

from waferbot_copley import amplifier
from waferbot_copley.faults import describe
from waferbot_copley.node_settings import DEVICE_SETTINGS, FAULT, POLICIES, RAMP, TWIN
from waferbot_copley.settings import amplifier_parameters, settings_of
from waferbot_lockstep.contract import (
    AMPLIFIER_STATE,
    CURRENT_COMMAND,
    ENCODERS_TOPIC,
    PHASE_CURRENTS,
    PHASE_VOLTAGES,
    SLOW_DIVIDER,
    Topic,
)
from waferbot_lockstep.device_input import DeviceInput
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.layout import Layout
from waferbot_lockstep.node import LOCKSTEP, LockstepNode, Trouble, run_node

SHARE_OF_PATIENCE = 0.5
"""
Of the time that the plant waits for voltages, the share that may be spent waiting for a command: the
current loop must not stand still because the position loop does.
"""


class CopleyNode(LockstepNode):
    """Current controller of the axes that it is told to drive."""

    def __init__(self, **node_options: Any) -> None:
        """Declare the settings of the driven axes and compile the current loop."""
        self._settings: dict[str, dict[str, Any]] = {}
        super().__init__('copley', (), (), **node_options)
        machine = self.layout
        names = self.declare_fixed('axes', list(machine.axes), 'the axes that this node drives')
        self._axes = _mask(names, machine)
        self.offer(PHASE_VOLTAGES, self._axes)
        self.offer(AMPLIFIER_STATE, self._axes)
        self._device_policy = self.declare_choice(
            'device_clock',
            TWIN,
            (TWIN, *POLICIES),
            'whose current commands come when they like, each letting one servo cycle pass, and what '
            f'becomes of a time-out; {TWIN}: nobody, commands are in lock-step',
        )
        device = self.declare_settings('', DEVICE_SETTINGS)
        self._device_timeout_s = float(device['device_timeout_s'])
        self._ramp_cycles = max(1, round(float(device['device_ramp_s']) * self.timing.servo_hz))
        self._device_waited = -1, 0.0, False  # for which tick, since when, and whether told
        self.need(PHASE_CURRENTS, self._axes)
        self.need(CURRENT_COMMAND, self._axes)
        self.need(ENCODERS_TOPIC, machine.all_encoders)
        self._inputs = tuple(self.inboxes.values())
        self._settings = {
            axis: self.declare_settings(axis, settings_of(axis, machine)) for axis in names
        }
        self._model_parameters = self._parameters_of(self._settings)
        self._model_state = amplifier.initial_state(self._model_parameters)
        self._tick = 0
        self._waiting_tick: int | None = None  # in real time, the tick that lacks an input
        self._waiting_since_s = 0.0
        axes = len(machine.axes)
        self._voltage = np.zeros(3 * axes)
        self._accumulator = np.zeros(axes)
        self._setpoint = np.zeros(axes)
        self._limits = np.zeros(axes, np.uint8)
        self._faults = np.zeros(axes, np.uint32)
        self._faults_told = [0] * axes
        self._warm_up()
        self.add_post_set_parameters_callback(self._apply_parameters)
        self.create_service(Trigger, '~/reset_faults', self._on_reset_faults)
        self.create_service(SetBool, '~/safe_torque_off', self._on_safe_torque_off)

    def lockstep_input(self, topic: Topic, mask: int) -> Any:
        """Return the input of a topic in lock-step, or of one whose messages are the clock."""
        if topic is CURRENT_COMMAND and self._device_policy != TWIN:
            return DeviceInput(topic, self.timing, mask, self.layout)
        return super().lockstep_input(topic, mask)

    def watch(self, now_s: float) -> None:
        """Act if the device that is the clock lets a tick wait for too long."""
        command = self.inboxes[CURRENT_COMMAND]
        if not isinstance(command, DeviceInput):
            return
        tick, since_s, told = self._device_waited
        waits = command.due == self._tick > 0 and not command.complete
        if not waits or self._tick != tick:
            self._device_waited = self._tick, now_s, False
        elif now_s - since_s > self._device_timeout_s and not told:
            self._device_waited = tick, since_s, True
            waited = f'no current_command for {now_s - since_s:.1f} s at tick {tick}'
            silence = f'the device is silent: {waited}'
            if self._device_policy == FAULT:
                self.fail(silence)
                return
            self.get_logger().warning(f'{silence}: {self._device_policy}')
            if self._device_policy == RAMP and command.ramp(self._ramp_cycles):
                self.on_input(CURRENT_COMMAND)

    def parameters_of_others(self) -> list[str]:
        """Return the settings of axes that other nodes drive; a file may hold those of all."""
        return [
            f'{axis}.{setting.name}'
            for axis in self.layout.axes
            for setting in settings_of(axis, self.layout)
        ]

    @property
    def tick(self) -> int:
        """The tick whose voltages come next."""
        return self._tick

    def on_input(self, topic: Topic) -> None:
        """Close the current loop of a tick as soon as all its inputs are there."""
        if self.timekeeping == LOCKSTEP:
            while self._inputs_complete() and self.outcome is None:
                self._close_loop()
                if self.end_tick and self._tick >= self.end_tick:
                    self.finish()
        else:
            self._answer_newest(topic)

    def _answer_newest(self, topic: Topic) -> None:
        """
        In real time, close the loop of the newest tick that has not been answered.

        Commands and counts of that tick are waited for, but not so long that the plant would go on
        without our voltages (see `on_time`), nor beyond the tick at which the plant is.
        """
        currents = self.inboxes[PHASE_CURRENTS]
        tick = currents.newest_tick
        if topic is PHASE_CURRENTS:
            now_s = time.monotonic()
            for box in self._inputs:
                if self._waiting_tick is not None and self._waiting_tick < tick:
                    self.give_up(box, self._waiting_tick)
                if not box.gives_time:
                    box.reach(tick, now_s)
            self._waiting_tick = None
        if tick < self._tick or not all(box.complete for box in self._inputs):
            return
        if self.patience_s > 0.0 and any(box.waits_for(tick) for box in self._inputs):
            if self._waiting_tick != tick:
                self._waiting_tick, self._waiting_since_s = tick, time.monotonic()
            return
        self._answer(tick)

    def _answer(self, tick: int) -> None:
        """In real time, close the loop of a tick with what is held."""
        self._waiting_tick = None
        self._tick = tick
        self._close_loop()
        if self.end_tick and self._tick >= self.end_tick:
            self.finish()

    def sleep_time_s(self) -> float | None:
        """Return the wall time until a command or counts have been waited for in vain."""
        if self._waiting_tick is None:
            return None
        due_s = self._waiting_since_s + SHARE_OF_PATIENCE * self.patience_s
        return due_s - time.monotonic()

    def on_time(self) -> None:
        """Wait no longer for what does not come, and answer the plant."""
        wait_s = self.sleep_time_s()
        if self._waiting_tick is None or wait_s is None or wait_s > 0.0:
            return
        for box in self._inputs:
            self.give_up(box, self._waiting_tick)
        self._answer(self._waiting_tick)

    def begin_anew(self) -> None:
        """Forget currents and integrators of the plant that was there before."""
        self._model_state[:] = amplifier.initial_state(self._model_parameters)
        self._tick = 0
        self._waiting_tick = None

    def _inputs_complete(self) -> bool:
        """Whether every input that has a message at this tick has it."""
        for inbox in self._inputs:  # noqa: SIM110  a generator costs more than the loop
            if inbox.due == self._tick and not inbox.complete:
                return False
        return True

    def _close_loop(self) -> None:
        amplifier.step(
            self._model_state,
            self._model_parameters,
            self._axes,
            self.inboxes[CURRENT_COMMAND].values,
            self.inboxes[PHASE_CURRENTS].values,
            self.inboxes[ENCODERS_TOPIC].values,
            self._voltage,
        )
        if self.timekeeping == LOCKSTEP:
            for inbox in self._inputs:
                if inbox.due == self._tick:
                    inbox.consumed()
        tick = self._tick
        self._tick += 1
        open_bridges = amplifier.open_bridges(self._model_state) & self._axes
        self.give(PHASE_VOLTAGES, tick, self._axes, [*self._voltage.tolist(), open_bridges])
        axes = self._axes if tick % SLOW_DIVIDER == 0 else amplifier.changed(self._model_state)
        if axes:
            self._report(tick, axes)

    def _report(self, tick: int, axes: int) -> None:
        amplifier.report(
            self._model_state,
            self._model_parameters,
            axes,
            self._accumulator,
            self._setpoint,
            self._limits,
            self._faults,
        )
        self._tell_faults(tick)
        self.give(
            AMPLIFIER_STATE,
            tick,
            axes,
            [
                *self._accumulator.tolist(),
                *self._setpoint.tolist(),
                *self._limits.tolist(),
                *self._faults.tolist(),
            ],
        )

    def _tell_faults(self, tick: int) -> None:
        """Say once that an amplifier has found a fault."""
        for place, axis in enumerate(self.layout.axes):
            found = int(self._faults[place])
            if self._axes >> place & 1 and found & ~self._faults_told[place]:
                self.get_logger().error(
                    f'{axis}: {describe(found)} at tick {tick} ({self.timing.seconds(tick):.4f} s)'
                )
            self._faults_told[place] = found

    def diagnostics(self) -> tuple[dict[str, str], list[Trouble]]:
        """Tell which faults there are, and how the device comes that is the clock."""
        command, values = self.inboxes[CURRENT_COMMAND], {}
        if isinstance(command, DeviceInput):
            counts = {'missed': command.missed, 'late': command.late, 'ramped': command.ramped}
            values = {f'device {name}': str(count) for name, count in counts.items()}
        return values, [
            (DiagnosticStatus.ERROR, f'{axis}: {describe(found)}')
            for axis, found in zip(self.layout.axes, self._faults_told, strict=True)
            if found
        ]

    # ---- what a user changes ---------------------------------------------------------------------

    def check_change(self, changes: Mapping[str, Any]) -> None:
        """Refuse limits that contradict each other and impossible filters."""
        if self._settings:
            self._parameters_of(self._changed_settings(changes))

    def _apply_parameters(self, parameters: Sequence[RosParameter]) -> None:
        changes = {parameter.name: parameter.value for parameter in parameters}
        self._settings = self._changed_settings(changes)
        self._model_parameters = self._parameters_of(self._settings)

    def _parameters_of(self, settings: Mapping[str, Mapping[str, Any]]) -> np.ndarray:
        return amplifier_parameters(settings, self.timing, 'copley', self.layout)

    def _changed_settings(self, changes: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
        settings = {axis: dict(values) for axis, values in self._settings.items()}
        for name, value in changes.items():
            axis, _, setting = name.partition('.')
            if axis in settings and setting in settings[axis]:
                settings[axis][setting] = value
        return settings

    def _on_reset_faults(self, request: Any, response: Any) -> Any:
        amplifier.reset_faults(self._model_state, self._axes)
        response.success = True
        response.message = 'latched faults cleared; those whose cause persists come back at once'
        return response

    def _on_safe_torque_off(self, request: Any, response: Any) -> Any:
        for axis in range(len(self.layout.axes)):
            if self._axes >> axis & 1:
                self._model_state['safe_torque_off'][0, axis] = request.data
        response.success = True
        response.message = 'gate drive ' + ('removed' if request.data else 'given back')
        return response

    def _warm_up(self) -> None:
        """Compile before the first message, so that no peer waits for the compiler."""
        state = amplifier.initial_state(self._model_parameters)
        amplifier.step(
            state,
            self._model_parameters,
            self._axes,
            self.inboxes[CURRENT_COMMAND].values,
            self.inboxes[PHASE_CURRENTS].values,
            self.inboxes[ENCODERS_TOPIC].values,
            self._voltage.copy(),
        )
        amplifier.open_bridges(state)
        amplifier.changed(state)
        amplifier.report(
            state,
            self._model_parameters,
            0,
            self._accumulator,
            self._setpoint,
            self._limits,
            self._faults,
        )


def _mask(names: Sequence[str], layout: Layout) -> int:
    unknown = [name for name in names if name not in layout.axes]
    if unknown or not names:
        raise UserError(
            f'copley: parameter axes is {list(names)}; give one or more of {", ".join(layout.axes)}'
        )
    return layout.mask(names)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the node: `ros2 run waferbot_copley copley --ros-args --params-file FILE`."""
    return run_node(CopleyNode, arguments)


if __name__ == '__main__':
    sys.exit(main())
