# SPDX-License-Identifier: Apache-2.0
"""
The PMAC as a ROS 2 node: counts in, current commands out.

Every I-variable is a parameter of the node (`y_linear.Ixx30`, ...), with the manual's meaning and
range; those that the controller lets you change with the loop closed can be changed while it runs
and act from the next servo cycle. The action `run_experiment` runs a motion from wherever the axes
are commanded to be; when it is cancelled, Ixx15 brings the motors to rest. The parameter `experiment`
names the one that begins at tick 0. As the node does not know the machine, `machine_axes` and
`machine_encoders` name what it has, and `units` says in what each axis is measured (`m rad rad`).
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.parameter import Parameter as RosParameter
from rclpy.task import Future

from waferbot_lockstep.contract import (
    CURRENT_COMMAND,
    ENCODERS_TOPIC,
    SERVO_STATE,
    Topic,
)
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.inbox import Inbox
from waferbot_lockstep.newest_input import NewestInput
from waferbot_lockstep.node import LockstepNode, Trouble, run_node
from waferbot_msgs.action import RunExperiment
from waferbot_pmac import compensation, servo
from waferbot_pmac.experiments import check_units, commanded_positions, load_experiment
from waferbot_pmac.i_variables import axis_parameters, change_parameter, servo_parameters
from waferbot_pmac.killed import KilledMotors
from waferbot_pmac.trajectories import brought_to_rest
from waferbot_pmac.user_units import parse_units, units_text, usual_units

CANCELLED = 'cancelled: the motors were brought to rest'
MILLISECONDS = 1000.0  # per second; Ixx15 and Ixx16 are per ms^2 and per ms

FEEDBACK_CYCLES = 225
"""Servo cycles between two feedback messages of a running experiment (0.1 s)."""


class Motion:
    """
    An experiment that is being run.

    `positions` has the commanded position per servo cycle, counts, relative to where it began.
    """

    def __init__(
        self, experiment: str, positions: np.ndarray, start: np.ndarray, first_cycle: int
    ) -> None:
        """Begin at servo cycle `first_cycle` from the commanded positions `start`, in counts."""
        self.experiment = experiment
        self.positions = positions
        self.start = start
        self.first_cycle = first_cycle
        self.offsets = np.zeros_like(positions)
        self.peak_following_error = np.zeros(positions.shape[1])
        moving = np.flatnonzero(np.any(positions != positions[-1], axis=1))
        self._last_change = int(moving[-1]) + 1 if len(moving) else 0

    def commanded(self, cycle: int) -> np.ndarray:
        """Return the commanded positions in counts; behind the end, the last ones."""
        place = min(cycle - self.first_cycle, len(self.positions) - 1)
        return self.start + self.positions[place]

    def offset(self, cycle: int) -> np.ndarray:
        """Return what the servo adds to its output, DAC units; behind the end, the last ones."""
        return self.offsets[min(cycle - self.first_cycle, len(self.offsets) - 1)]

    def at_rest(self, cycle: int) -> bool:
        """Tell whether the commanded positions stay as they are from `cycle` on."""
        return cycle - self.first_cycle >= self._last_change

    def aborted(self, cycle: int, parameters: np.ndarray, servo_hz: float) -> Motion:
        """
        Return the motion that brings the motors to rest from where they are commanded at `cycle`.

        By Ixx15, from the commanded velocity; what is faster than Ixx16 was a jump, and has none.
        """
        now = self.commanded(cycle)
        per_s = (now - self.commanded(max(cycle - 1, self.first_cycle))) * servo_hz
        per_s[np.abs(per_s) > parameters['Ixx16'][0] * MILLISECONDS] = 0.0
        ways = [
            brought_to_rest(velocity, deceleration * MILLISECONDS**2, 1.0 / servo_hz)
            for velocity, deceleration in zip(per_s, parameters['Ixx15'][0], strict=True)
        ]
        longest = max(len(way) for way in ways)
        positions = np.column_stack(
            [np.pad(way, (0, longest - len(way)), mode='edge') for way in ways]
        )
        stopping = Motion(self.experiment, positions, now, cycle)
        stopping.peak_following_error = self.peak_following_error
        return stopping

    def over(self, cycle: int) -> bool:
        """Tell whether `cycle` is the last of the experiment, or behind it."""
        return cycle - self.first_cycle >= len(self.positions) - 1


class PmacNode(LockstepNode):
    """Position controller of all axes."""

    def __init__(self, **node_options: Any) -> None:
        """Declare the I-variables, compile the servo, load the first experiment."""
        super().__init__(
            'pmac',
            (ENCODERS_TOPIC,),
            (CURRENT_COMMAND, SERVO_STATE),
            **node_options,
        )
        axes = self.layout.axes
        settings = {
            axis: self.declare_settings(axis, axis_parameters(axis, self.layout)) for axis in axes
        }
        self._model_parameters = servo_parameters(settings, 'pmac', self.layout)
        self._model_state = servo.initial_state(self._model_parameters)
        self._current = np.zeros(len(axes))
        self._cycle = 0
        self._primed = False
        self._experiment = self.declare_fixed(
            'experiment', 'constant', 'what begins at tick 0: name, file or text of an experiment'
        )
        self._units = parse_units(
            self.declare_fixed(
                'units',
                units_text(usual_units(self.layout)),
                'm or rad of each axis, in which it is commanded',
            ),
            self.layout,
        )
        self._tables = compensation.load_tables(
            self.declare_fixed(
                'compensation', '', 'currents to add by what is commanded: CSV file or its text'
            ),
            self._units,
        )
        self._motion = self._load(self._experiment, np.zeros(len(axes)))
        self._counts_before = np.zeros(len(self.layout.encoders), np.int64)
        self._killed = KilledMotors(self.layout)
        self._warm_up()
        self.add_post_set_parameters_callback(self._apply_parameters)
        self._goal: Any = None
        self._stopping = False  # its motors are being brought to rest, as it was cancelled
        self._goal_done: Future | None = None  # its result: why it failed, '' if it did not
        self._actions = ActionServer(
            self,
            RunExperiment,
            'run_experiment',
            execute_callback=self._execute,
            goal_callback=self._consider,
            cancel_callback=lambda goal: CancelResponse.ACCEPT,
        )

    @property
    def tick(self) -> int:
        """The tick of the next servo cycle."""
        return self._cycle * self.timing.servo_divider

    def on_input(self, topic: Topic) -> None:
        """Run a servo cycle when the counts of its tick are there."""
        inbox = self.inboxes[topic]
        if isinstance(inbox, Inbox):
            if not inbox.complete:
                return
            tick = inbox.due
            inbox.consumed()
            if tick % self.timing.servo_divider == 0:
                self._servo_cycle(tick, inbox.values)
            if self.end_tick and tick + inbox.spacing >= self.end_tick:
                self.finish()
        elif inbox.complete:
            self._follow_newest(inbox)

    def _follow_newest(self, inbox: NewestInput) -> None:
        """In real time, run the servo cycle of the newest counts, and those that were passed over."""
        cycle = inbox.newest_tick // self.timing.servo_divider
        if cycle >= self._cycle:
            if self._primed:
                self._make_up(cycle, inbox.values)
            self._cycle = cycle
            self._counts_before[:] = inbox.values
            self._servo_cycle(self.tick, inbox.values)
        if self.end_tick and inbox.newest_tick + inbox.spacing >= self.end_tick:
            self.finish()

    def _make_up(self, cycle: int, counts: np.ndarray) -> None:
        """
        Run the cycles before `cycle` that had no counts, on a straight line from the last to the newest.

        Otherwise the servo would take the way of several cycles for that of one, and its derivative
        would kick. Their commands go nowhere. After a long silence only the last second is made up.
        """
        missed = cycle - self._cycle
        for behind in range(min(missed, int(self.timing.servo_hz)), 0, -1):
            share = 1.0 - behind / (missed + 1)
            between = self._counts_before + np.rint(share * (counts - self._counts_before))
            self._model_state['offset'][0] = self._motion.offset(cycle - behind)
            servo.step(
                self._model_state,
                self._model_parameters,
                between.astype(np.int64),
                self._motion.commanded(cycle - behind),
                self._current,
            )

    def begin_anew(self) -> None:
        """Close the loops at the counts of the new plant, and begin the first experiment again."""
        if self._goal is not None:
            self._end_goal('the plant has begun anew')
        self._cycle = 0
        self._primed = False
        self._killed = KilledMotors(self.layout)
        self._motion = self._load(self._experiment, np.zeros_like(self._current))

    def _servo_cycle(self, tick: int, counts: np.ndarray) -> None:
        if not self._primed:
            position_encoders = self._model_parameters['Ixx03'][0]
            self._motion.start = counts[position_encoders].astype(np.float64)
            self._motion.first_cycle = (
                self._cycle
            )  # not 0 if the plant was there before, in real time
            self._compensate(self._motion)
            servo.prime(self._model_state, self._model_parameters, counts, self._motion.start)
            self._primed = True
        commanded = self._motion.commanded(self._cycle)
        self._model_state['offset'][0] = self._motion.offset(self._cycle)
        servo.step(self._model_state, self._model_parameters, counts, commanded, self._current)
        state = self._model_state[0]
        self.give(CURRENT_COMMAND, tick, self.layout.all_axes, self._current.tolist())
        self.give(
            SERVO_STATE,
            tick,
            self.layout.all_axes,
            [
                *state['commanded_position'].tolist(),
                *state['following_error'].tolist(),
                *state['output'].tolist(),
                *state['integrator'].tolist(),
                *state['flags'].tolist(),
            ],
        )
        if state['killed'].any():
            self._watch_killed(tick, state['flags'])
        if self._goal is not None:
            self._follow_goal(tick, state['following_error'])
        self._cycle += 1

    def _watch_killed(self, tick: int, flags: np.ndarray) -> None:
        """Say once that a motor was killed; an experiment that is being run has failed by it."""
        if self._killed.note(tick, flags):
            reason = self._killed.reason(self.timing)
            self.get_logger().error(reason)
            if self._goal is not None:
                self._end_goal(reason)

    def diagnostics(self) -> tuple[dict[str, str], list[Trouble]]:
        """Tell which motors are killed."""
        reason = self._killed.reason(self.timing)
        return {}, [(DiagnosticStatus.ERROR, reason)] if reason else []

    # ---- experiments -----------------------------------------------------------------------------

    def _load(self, experiment: str, start: np.ndarray) -> Motion:
        loaded = load_experiment(experiment)
        try:
            check_units(loaded, self._units)
        except UserError as error:
            told = f'so says parameter units, {units_text(self._units)!r}'
            raise UserError(f'{error} ({told}; of another machine, set it)') from error
        positions = commanded_positions(
            loaded, self._model_parameters, self.timing.servo_hz, self._units
        )
        motion = Motion(loaded.name, positions, start, self._cycle)
        self._compensate(motion)
        return motion

    def _compensate(self, motion: Motion) -> None:
        """Find what the servo adds to its output in every cycle, from where the motion begins."""
        motion.offsets = compensation.offsets(
            self._tables,
            motion.experiment,
            motion.start + motion.positions,
            self._model_parameters,
            self.timing.servo_hz,
            self.layout,
        )

    def _consider(self, request: Any) -> GoalResponse:
        return GoalResponse.REJECT if self._goal is not None else GoalResponse.ACCEPT

    async def _execute(self, goal: Any) -> Any:
        result = RunExperiment.Result()
        try:
            if self._killed:
                raise UserError(f'{self._killed.reason(self.timing)}; start the PMAC again')
            if not self._motion.at_rest(self._cycle):
                raise UserError('another experiment still moves the axes; wait for its end')
            self._motion = self._load(
                goal.request.experiment, self._motion.commanded(self._cycle).copy()
            )
        except UserError as error:
            result.message = str(error)
            goal.abort()
            return result
        self._goal, self._goal_done = goal, Future()
        motion = self._motion
        failure = await self._goal_done
        result.success = not failure
        result.first_tick = motion.first_cycle * self.timing.servo_divider
        result.last_tick = max(self.tick - self.timing.servo_divider, 0)
        result.peak_following_error = motion.peak_following_error
        result.message = failure or f'ran {len(motion.positions)} servo cycles'
        if failure == CANCELLED:
            goal.canceled()
        elif failure:
            goal.abort()
        else:
            goal.succeed()
        return result

    def _follow_goal(self, tick: int, following_error: np.ndarray) -> None:
        motion = self._motion
        np.maximum(
            motion.peak_following_error,
            np.abs(following_error),
            out=motion.peak_following_error,
        )
        done = self._cycle - motion.first_cycle
        if done % FEEDBACK_CYCLES == 0:
            feedback = RunExperiment.Feedback(tick=tick)
            feedback.progress = min(1.0, (done + 1) / len(motion.positions))
            self._goal.publish_feedback(feedback)
        if self._goal.is_cancel_requested and not self._stopping:
            self._stopping = True
            self._motion = motion.aborted(
                self._cycle, self._model_parameters, self.timing.servo_hz
            )
            self._compensate(self._motion)
        elif motion.over(self._cycle):
            self._end_goal(CANCELLED if self._stopping else '')

    def _end_goal(self, failure: str) -> None:
        """Let the experiment that is being run end, with why it failed or ''."""
        goal_done, self._goal, self._goal_done = self._goal_done, None, None
        self._stopping = False
        if goal_done is not None:
            goal_done.set_result(failure)

    # ---- parameters ------------------------------------------------------------------------------

    def _apply_parameters(self, parameters: Sequence[RosParameter]) -> None:
        for parameter in parameters:
            axis, _, name = parameter.name.partition('.')
            if axis in self.layout.axes:
                change_parameter(
                    self._model_parameters,
                    axis,
                    name,
                    parameter.value,
                    loop_closed=True,
                    layout=self.layout,
                )

    def _warm_up(self) -> None:
        """Compile before the first message, so that no peer waits for the compiler."""
        state = servo.initial_state(self._model_parameters)
        counts = self.inboxes[ENCODERS_TOPIC].values.copy()
        still = np.zeros_like(self._current)
        servo.prime(state, self._model_parameters, counts, still)
        servo.step(state, self._model_parameters, counts, still, self._current.copy())


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the node: `ros2 run waferbot_pmac pmac --ros-args --params-file FILE`."""
    return run_node(PmacNode, arguments)


if __name__ == '__main__':
    sys.exit(main())
