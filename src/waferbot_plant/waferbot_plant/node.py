# SPDX-License-Identifier: Apache-2.0
"""
The plant as a ROS 2 node: terminal voltages in, encoder counts and measured currents out.

The plant keeps the time of the twin. In lock-step it goes to the next tick when the voltages of this
one are there. In real time it follows the wall clock: it waits for the voltages of a tick too, but no
longer than `patience_s`, then it takes that tick with the newest. So amplifiers that are alive but slow
make sim time slow, which is told; those that are silent for `peer_timeout_s` are not waited for.

Service `~/pause` stops and continues time; a twin that is paused at tick 0 (parameter `start_paused`)
waits there with all its nodes connected, so that nobody misses the beginning. Where ROS has the package
`simulation_interfaces`, its services step and, in real time, reset the twin as well; see
`waferbot_plant.simulation_services`.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from rosgraph_msgs.msg import Clock as ClockMessage
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import SetBool

from waferbot_lockstep.contract import (
    ENCODERS_TOPIC,
    PHASE_CURRENTS,
    PHASE_VOLTAGES,
    PLANT_STATE,
    RECORDED_TOPIC,
    SLOW_DIVIDER,
    Topic,
)
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.interrupt import Interrupt
from waferbot_lockstep.layout import Layout
from waferbot_lockstep.node import (
    LOCKSTEP,
    REALTIME,
    LockstepNode,
    Outlet,
    Trouble,
    latched_qos,
    lockstep_qos,
    message_class,
    run_node,
)
from waferbot_lockstep.node_settings import MACHINE_AXES, MACHINE_ENCODERS
from waferbot_lockstep.standard_messages import (
    CLOCK,
    JOINT_STATES,
    ROBOT_DESCRIPTION,
    clock_message,
    joint_state_message,
    string_message,
)
from waferbot_lockstep.wire import wire_of
from waferbot_msgs.msg import Recorded
from waferbot_plant import loads, plant
from waferbot_plant.mechanisms import mechanism
from waferbot_plant.motors import check_windings
from waferbot_plant.node_settings import PLANT_SETTINGS
from waferbot_plant.pace import LONGEST_LAG_S, Pace
from waferbot_plant.simulation_services import offer_simulation_services
from waferbot_plant.urdf import urdf
from waferbot_plant.validity import Watch

UNWATCHED_TICKS = 8
"""In real time, ticks that may be taken at once when there are no voltages to wait for."""

SLOW = 0.97
"""In real time, the part of the rate asked for below which the machine is said to be too slow."""


class PlantNode(LockstepNode):
    """Mechanism, motors and encoders of all axes."""

    def __init__(self, **node_options: Any) -> None:
        """Load the description and compile the model."""
        super().__init__(
            'plant', (PHASE_VOLTAGES,), (ENCODERS_TOPIC, PHASE_CURRENTS), **node_options
        )
        machine = self._machine
        self._paused = bool(
            self.declare_fixed(
                'start_paused', False, 'wait at tick 0 until ~/pause lets time go on'
            )
        )
        self._steps_left = 0  # ticks to take while time is paused
        self._stepped: Callable[[str], None] | None = None
        settings = self.declare_settings('', PLANT_SETTINGS)
        self._pace = Pace(float(settings['realtime_factor']), self.timing.tick_s)
        self._recorder_window = int(settings['recorder_window'])
        self._recorded = 0
        self._recorder_heard_s = 0.0
        self._mechanism = mechanism(
            machine,
            str(
                self.declare_fixed(
                    'fmu', '', 'file of an FMU in the place of the model; empty: none'
                )
            ),
            str(self.declare_fixed('fmu_map', '', 'YAML file: what the FMU calls its variables')),
            self.timing,
        )
        self._tick = 0
        axes = len(self.layout.axes)
        self._counts = np.zeros(len(self.layout.encoders), np.int64)
        self._line_currents = np.zeros(2 * axes)
        self._position = np.zeros(axes)
        self._velocity = np.zeros(axes)
        self._borne = np.zeros(loads.width(axes))
        self._watch = Watch(machine)
        self._plant_state = wire_of(PLANT_STATE, self.layout)
        self._due = False
        self._measured_s = 0.0
        self._clock_outlet = self._slow_outlet(ClockMessage, CLOCK[0])
        self._joint_outlet = self._slow_outlet(JointState, JOINT_STATES[0])
        self._plant_state_outlet = self._slow_outlet(
            message_class(PLANT_STATE, self.layout), PLANT_STATE.name
        )
        self._description_publisher = self.create_publisher(
            String, ROBOT_DESCRIPTION[0], latched_qos()
        )
        self._description_publisher.publish(string_message(urdf(machine.description)))
        self.create_service(SetBool, '~/pause', self._on_pause)
        offer_simulation_services(self)
        if self._recorder_window:
            self.create_subscription(Recorded, RECORDED_TOPIC, self._on_recorded, lockstep_qos())

    def find_layout(self) -> Layout:
        """Load the machine, which has the axes and encoders; raises `UserError`."""
        description = self.declare_fixed(
            'description', 'rigid', 'mechanism: name of a shipped description, or a YAML file'
        )
        damping = self.declare_choice(
            'damping', 'improved', ('calculated', 'improved'), 'damping of the connections'
        )
        self._machine = plant.load_machine(description, damping=damping, timing=self.timing)
        check_windings(self._machine.description)
        return self._machine.layout

    def parameters_of_others(self) -> Iterable[str]:
        """Return what other nodes are told of the machine, and the plant has from its description."""
        return (MACHINE_AXES, MACHINE_ENCODERS)

    def _slow_outlet(self, message_type: Any, name: str) -> Outlet:
        return Outlet(self.create_publisher(message_type, name, lockstep_qos()), self.exchange)

    @property
    def tick(self) -> int:
        """The tick at which the plant stands."""
        return self._tick

    @property
    def paused(self) -> bool:
        """Whether time stands, but for the steps that are asked for."""
        return self._paused

    def begin(self) -> None:
        """Send the feedback of tick 0."""
        super().begin()
        self._measure()

    def on_input(self, topic: Topic) -> None:
        """Go on to the next tick when the voltages of this one are there."""
        inbox = self.inboxes[topic]
        if not inbox.complete:
            return
        if self.timekeeping == LOCKSTEP:
            inbox.consumed()
            self._due = True
            self._advance_if_free()
        elif self._pace.running:
            self._follow_wall_clock()
        elif self._may_go():
            self._pace.start(self._tick, time.monotonic())

    def _may_go(self) -> bool:
        return not self._paused or self._steps_left > 0

    def _advance_if_free(self) -> None:
        """Take the tick that is due, unless time is paused or the recorder too far behind."""
        behind = self._tick - self._recorded >= self._recorder_window > 0
        if self._due and self._may_go() and not behind and self.outcome is None:
            self._advance()

    def _on_recorded(self, recorded: Any) -> None:
        self._recorder_heard_s = time.monotonic()
        self._recorded = max(self._recorded, recorded.tick)
        self._advance_if_free()

    def sleep_time_s(self) -> float | None:
        """Return the wall time until the next tick is due, or until its voltages have taken too long."""
        if not self._pace.running:
            return None
        due_s = self._pace.due_s(self._tick + 1)
        if self._waits_for_voltages():
            due_s = max(due_s, self._measured_s + self.patience_s)
        return due_s - time.monotonic()

    def on_time(self) -> None:
        """Follow the wall clock; with nobody to wait for, several ticks at once."""
        for _ in range(UNWATCHED_TICKS if self.patience_s > 0.0 else 1):
            self._follow_wall_clock()

    def _waits_for_voltages(self) -> bool:
        inbox = self.inboxes[PHASE_VOLTAGES]
        return self.patience_s > 0.0 and inbox.waits_for(self._tick)

    def _follow_wall_clock(self) -> None:
        """Take the next tick if it is due, and its voltages are in or have been waited for in vain."""
        wait_s = self.sleep_time_s()
        if wait_s is None or wait_s > 0.0 or self.outcome is not None:
            return
        in_vain = self._waits_for_voltages()
        if in_vain:
            self.give_up(self.inboxes[PHASE_VOLTAGES], self._tick)
        longest_s = 0.0 if in_vain else LONGEST_LAG_S
        self._pace.come_to(self._tick + 1, time.monotonic(), longest_s)
        self._advance()

    def _advance(self) -> None:
        """Integrate over this tick with the voltages held, then measure at the next one."""
        self._due = False
        inbox = self.inboxes[PHASE_VOLTAGES]
        try:
            self._mechanism.advance(self._tick, inbox.values, inbox.mask)
        except UserError as error:
            self.fail(str(error))
            return
        self._tick += 1
        if self.end_tick and self._tick >= self.end_tick:
            self.finish()
        else:
            self._measure()
        if self._steps_left:
            self._steps_left -= 1
            if not self._steps_left:
                self._pace.stop()
                self._end_stepping('')

    def _measure(self) -> None:
        tick = self._tick
        if self.timekeeping == REALTIME:
            self._measured_s = time.monotonic()
            self.inboxes[PHASE_VOLTAGES].reach(tick, self._measured_s)
        if tick % SLOW_DIVIDER == 0:
            runaway = self._mechanism.runaway(tick)
            if runaway:
                self.fail(runaway)
                return
        try:
            self._mechanism.measure(tick, self._counts, self._line_currents)
        except UserError as error:
            self.fail(str(error))
            return
        if tick % SLOW_DIVIDER == 0:
            self._publish_slow_topics(tick)
        if tick % self.timing.servo_divider == 0:
            self._mechanism.note_loads()
        if tick % self.timing.encoder_divider == 0:
            self.give(ENCODERS_TOPIC, tick, self.layout.all_encoders, self._counts.tolist())
        self.give(PHASE_CURRENTS, tick, self.layout.all_axes, self._line_currents.tolist())

    def _publish_slow_topics(self, tick: int) -> None:
        stamp_ns = self.timing.stamp_ns(tick)
        self.publish(self._clock_outlet, clock_message(stamp_ns))
        self._mechanism.joints(self._position, self._velocity)
        self.publish(
            self._joint_outlet,
            joint_state_message(
                stamp_ns,
                self.layout.axes,
                self._position.tolist(),
                self._velocity.tolist(),
            ),
        )
        if not self._mechanism.take_loads(self._borne):
            return
        self._watch.note(loads.Loads.of_rows(np.array([tick]), self._borne[np.newaxis]))
        self.publish(
            self._plant_state_outlet,
            self._plant_state.encode(tick, stamp_ns, self.layout.all_axes, self._borne.tolist()),
        )

    # ---- who has time go on ----------------------------------------------------------------------

    def _on_pause(self, request: Any, response: Any) -> Any:
        self.pause(request.data)
        response.success = True
        response.message = f'{"paused" if request.data else "running"} at tick {self._tick}'
        return response

    def pause(self, paused: bool) -> None:
        """Let time stand, or go on. Either ends the steps that are being taken."""
        self._paused = paused
        if self._steps_left:
            self._end_stepping(f'{"paused" if paused else "let go"} by somebody else')
        self._pace.stop()
        self._go_on()

    def step(self, ticks: int, done: Callable[[str], None]) -> None:
        """
        Take some ticks of paused time; then call `done` with '', or else with why not all were taken.

        In real time they take their wall time, as any other.
        """
        if not self._paused:
            done('time is not paused')
        elif self._steps_left:
            done('the steps asked for before are still to be taken')
        elif not ticks:
            done('')
        else:
            self._steps_left, self._stepped = ticks, done
            self._go_on()

    def reset(self) -> str:
        """
        Begin anew at tick 0, with the machine at rest; return '' or why that cannot be.

        The others see it by tick 0 coming again, as from a plant that was started again, and begin
        anew with it. In lock-step every tick is given once, and to them the tick would be stale.
        """
        if self.timekeeping == LOCKSTEP:
            return 'in lock-step no tick is given twice: start all nodes again'
        if self._steps_left:
            self._end_stepping('reset by somebody else')
        self._pace.stop()
        self._tick = 0
        self._mechanism.reset()
        self._watch.forget()
        self.inboxes[PHASE_VOLTAGES].forget()
        self._measure()
        return ''

    def _go_on(self) -> None:
        if self.timekeeping == LOCKSTEP:
            self._advance_if_free()
        else:
            self.on_input(PHASE_VOLTAGES)

    def _end_stepping(self, failure: str) -> None:
        done, self._steps_left, self._stepped = self._stepped, 0, None
        if done is not None:
            done(failure)

    def take_leave(self, interrupt: Interrupt) -> None:
        """Tell who waits for steps that they do not come any more; then as every node."""
        self._end_stepping(f'the twin has ended at tick {self._tick}')
        super().take_leave(interrupt)

    def watch(self, now_s: float) -> None:
        """Stop if a recorder that was there has fallen silent."""
        silence_s = now_s - self._recorder_heard_s
        timeout_s = self.get_parameter('peer_timeout_s').value
        if self._recorder_heard_s and silence_s > timeout_s:
            self.fail(
                f'the recorder is gone: topic {RECORDED_TOPIC} is silent for {silence_s:.1f} s, '
                f'everything before tick {self._recorded} was recorded'
            )

    def diagnostics(self) -> tuple[dict[str, str], list[Trouble]]:
        """Tell how sim time goes against the wall clock, and where the model's range was left."""
        values = {'paused': str(self._paused)}
        departures = [
            (DiagnosticStatus.WARN, found.text(self.timing)) for found in self._watch.departures()
        ]
        if self.timekeeping != REALTIME:
            return values, departures
        rate = self._pace.rate(time.monotonic())
        values['realtime factor'] = '' if rate is None else f'{rate:.3f}'
        values['realtime factor asked for'] = f'{self._pace.factor:g}'
        values['worst lag [ms]'] = f'{1e3 * self._pace.worst_lag_s:.3g}'
        values['wall time written off [s]'] = f'{self._pace.written_off_s:.3f}'
        if rate is None or rate >= SLOW * self._pace.factor:
            return values, departures
        return values, [
            *departures,
            (
                DiagnosticStatus.WARN,
                f'{rate:.2g} x real time, {self._pace.factor:g} x asked for: the machine is too slow '
                f'for {self.timing.current_loop_hz / 1000:g} kHz over these processes',
            ),
        ]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the node: `ros2 run waferbot_plant plant --ros-args --params-file FILE`."""
    return run_node(PlantNode, arguments)


if __name__ == '__main__':
    sys.exit(main())
