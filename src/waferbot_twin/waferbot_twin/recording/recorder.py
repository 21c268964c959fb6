# SPDX-License-Identifier: Apache-2.0
"""
The recorder: a node that listens to the twin and writes every message as it came over the wire.

It takes the messages as bytes and never turns them into objects. Only the plant waits for it, when it
falls too far behind; that nothing was lost is not assumed all the same, but counted, tick by tick.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any
from xml.etree import ElementTree

import numpy as np
from rclpy.clock import Clock as WallClock
from rclpy.clock import ClockType
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import String

import waferbot_msgs.msg
from waferbot_lockstep.contract import (
    AMPLIFIER_STATE,
    CONTRACT_TOPICS,
    CURRENT_COMMAND,
    PLANT_STATE,
    RECORDED_TOPIC,
    RECORDER_WINDOW,
    SERVO_STATE,
    STOP_TOPIC,
    Topic,
)
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.exchange import Exchange
from waferbot_lockstep.layout import SHIPPED, Layout
from waferbot_lockstep.node import (
    INTERRUPTED,
    SIGN_OF_LIFE_PERIOD_S,
    latched_qos,
    lockstep_qos,
    message_class,
)
from waferbot_lockstep.standard_messages import (
    CLOCK,
    FIXED_TRANSFORMS,
    JOINT_STATES,
    ROBOT_DESCRIPTION,
    TRANSFORMS,
    stamp_of,
)
from waferbot_lockstep.stops import Stops
from waferbot_lockstep.timing import Timing
from waferbot_lockstep.wire import WireFormat, wire_of
from waferbot_plant.frames import Frames
from waferbot_twin.failures import Failures
from waferbot_twin.recording.completeness import Account
from waferbot_twin.recording.writer import RecordingWriter
from waferbot_twin.validity import Validity, loads_of

ANNOUNCE_TICKS = RECORDER_WINDOW // 8
"""Ticks between two announcements of how far the recording has come."""

FURTHEST_TICKS = 2 * RECORDER_WINDOW
"""
Ticks beyond the newest heard at which a message is of another twin, if the plant waits for the recorder:
none can then be ahead of what is recorded by more than `RECORDER_WINDOW` and a cycle.
"""


class Recorder(Node):
    """
    Records a twin.

    `account` knows what has been recorded; `tick` is the newest tick seen; `stop_reason` is what a
    node that left the lock-step said, `interrupted` whether because the user had it so; `failures`
    tells which axes are not driven any more.
    """

    def __init__(
        self,
        writer: RecordingWriter | None,
        timing: Timing,
        needed: Mapping[Topic, int] | None = None,
        clock_needed: bool = True,
        loads_needed: bool = True,
        exchange: Exchange | None = None,
        validity: Validity | None = None,
        layout: Layout = SHIPPED,
    ) -> None:
        """
        Be ready to record; with no writer, only keep account.

        `needed` is that of `Account`; `clock_needed` says whether `/clock` and `joint_states` must be
        there too: then the plant is one that waits for the recorder, and a message from far ahead is a
        stranger's, which would make all that is still to come look old. `loads_needed`: `plant_state`
        as well, which an FMU in the place of the plant does not have. What nodes of this process give,
        or a channel, is taken from `exchange`. `validity` watches what the messages tell, if given.
        `layout` names the axes and encoders of the machine.
        """
        super().__init__('recorder')
        self.exchange = exchange or Exchange()
        self.layout = layout
        self.account = Account(timing, needed, layout)
        self._clock_needed = clock_needed
        self._loads_needed = loads_needed
        self._validity = validity
        self._plant_state = wire_of(PLANT_STATE, layout)
        self.tick = -1
        self.stop_reason = ''
        self.interrupted = False
        self.failure = ''
        self.failures = Failures.of(timing, layout)
        self._stops = Stops(self)
        self._writer = writer
        self._timing = timing
        self._recorded_publisher = self.create_publisher(
            waferbot_msgs.msg.Recorded, RECORDED_TOPIC, lockstep_qos()
        )
        self.create_timer(
            SIGN_OF_LIFE_PERIOD_S,
            self._on_sign_of_life,
            clock=WallClock(clock_type=ClockType.STEADY_TIME),
        )
        self._standard_stamps = {CLOCK[0]: -1, JOINT_STATES[0]: -1, PLANT_STATE.name: -1}
        self._described = False
        self._frames: Frames | None = None
        self._not_placed: list[bytes] = []  # joint states from before the description

    def begin(self) -> None:
        """Listen to everything; called once, when all nodes of this process are there."""
        for topic in CONTRACT_TOPICS:
            self._record_contract(topic, wire_of(topic, self.layout))
        for (name, type_name), message_type in (
            (CLOCK, Clock),
            (JOINT_STATES, JointState),
            (
                (PLANT_STATE.name, PLANT_STATE.type_for(self.layout)),
                message_class(PLANT_STATE, self.layout),
            ),
        ):
            self._record(name, type_name, message_type, self._standard_callback(name))
        self._record(*ROBOT_DESCRIPTION, String, self._on_description, latched=True)
        self._declare_topic(*TRANSFORMS)
        self._declare_topic(*FIXED_TRANSFORMS, latched=True)
        self.create_subscription(
            waferbot_msgs.msg.Stop, STOP_TOPIC, self._on_stop, lockstep_qos(8)
        )

    @property
    def begun(self) -> bool:
        """Whether all that is needed has been heard for every axis, so that nothing will be missed."""
        standard_begun = not self._clock_needed or (
            self._described
            and all(
                stamp >= 0
                for name, stamp in self._standard_stamps.items()
                if self._loads_needed or name != PLANT_STATE.name
            )
        )
        return self.account.begun() and standard_begun

    def _record(
        self,
        name: str,
        type_name: str,
        message_type: Any,
        callback: Callable[[bytes], None],
        latched: bool = False,
    ) -> None:
        """Have `callback` called with every message of a standard topic."""
        self._declare_topic(name, type_name, latched)
        full_name = self.resolve_topic_name(name)
        if not latched and self.exchange.takes(full_name):
            self.exchange.listen(full_name, callback)
            return
        qos = latched_qos() if latched else lockstep_qos()
        self.create_subscription(message_type, name, callback, qos, raw=True)

    def _record_contract(self, topic: Topic, wire: WireFormat) -> None:
        """Record a topic of the contract."""
        self._declare_topic(topic.name, topic.type_for(self.layout))
        take = self._contract_callback(topic, wire)

        def on_message(data: bytes) -> None:
            try:
                fields = wire.decode(data)
            except UserError as error:
                self.failure = f'topic {topic.name}: {error}'
            else:
                take(data, *fields)

        name = self.resolve_topic_name(topic.name)
        if self.exchange.takes(name, topic.all_places(self.layout)):
            self.exchange.listen(name, take, wire.decode)
        else:
            self.create_subscription(
                message_class(topic, self.layout),
                topic.name,
                on_message,
                lockstep_qos(),
                raw=True,
            )

    def _declare_topic(self, name: str, type_name: str, latched: bool = False) -> None:
        if self._writer is not None:
            self._writer.add_topic(self.resolve_topic_name(name), type_name, latched)

    def _on_description(self, data: bytes) -> None:
        if self._writer is not None and not self._described:
            self._writer.write(self.resolve_topic_name(ROBOT_DESCRIPTION[0]), 0, data)
            try:
                self._frames = Frames.of(deserialize_message(data, String).data)
            except (ValueError, ElementTree.ParseError) as error:
                self.get_logger().warning(
                    f'no transforms: the robot_description is no URDF: {error}'
                )
            else:
                fixed = self._frames.fixed_message()
                self._writer.write(self.resolve_topic_name(FIXED_TRANSFORMS[0]), 0, fixed)
                for joint_states in self._not_placed:
                    self._place(joint_states)
            self._not_placed.clear()
        self._described = True

    def _place(self, joint_states: bytes) -> None:
        """Write the transforms of the frames that move; they wait until the robot is described."""
        if self._writer is None:
            return
        if self._frames is None:
            if not self._described:
                self._not_placed.append(joint_states)
            return
        told = deserialize_message(joint_states, JointState)
        positions = dict(zip(told.name, told.position, strict=False))
        stamp_ns = stamp_of(joint_states)
        name = self.resolve_topic_name(TRANSFORMS[0])
        self._writer.write(name, stamp_ns, self._frames.message(stamp_ns, positions))

    def _contract_callback(self, topic: Topic, wire: WireFormat) -> Callable[..., None]:
        name = self.resolve_topic_name(topic.name)
        is_new, writer = self.account.topics[topic].is_new, self._writer
        axes = len(self.layout.axes)

        def take(
            data: bytes, tick: int, stamp_ns: int, valid: int, values: Sequence[float]
        ) -> None:
            if self._clock_needed and tick > self.tick + FURTHEST_TICKS:
                self.failure = (
                    f'topic {topic.name}, tick {tick}: the twin is at tick {max(self.tick, 0)}; '
                    'somebody else publishes in its ROS domain'
                )
                return
            if is_new(tick, valid):
                if tick > self.tick:
                    self.tick = tick
                    if tick % ANNOUNCE_TICKS == 0:
                        self._announce()
                if topic is SERVO_STATE:
                    self.failures.killed.note(tick, values[-axes:])
                elif topic is AMPLIFIER_STATE:
                    self.failures.note_faults(tick, valid, values[-axes:])
                    self._note_amplifiers(tick, valid, values)
                elif topic is CURRENT_COMMAND and self._validity is not None:
                    self._validity.note_command(tick, valid, values)
                if writer is not None:
                    writer.write(name, stamp_ns, wire.normalised(data))

        return take

    def _standard_callback(self, short_name: str) -> Callable[[bytes], None]:
        name = self.resolve_topic_name(short_name)
        stamps, writer = self._standard_stamps, self._writer

        def on_message(data: bytes) -> None:
            stamp_ns = stamp_of(data)
            if stamp_ns > stamps[short_name]:
                stamps[short_name] = stamp_ns
                if short_name == PLANT_STATE.name:
                    data = self._note_plant_state(data)
                if writer is not None:
                    writer.write(name, stamp_ns, data)
                if short_name == JOINT_STATES[0]:
                    self._place(data)

        return on_message

    def _note_plant_state(self, data: bytes) -> bytes:
        """Have what the plant tells watched; return the message without padding."""
        if self._validity is not None:
            tick, _, _, values = self._plant_state.decode(data)
            self._validity.note_loads(loads_of(tick, values))
        return self._plant_state.normalised(data)

    def _note_amplifiers(self, tick: int, valid: int, values: Sequence[float]) -> None:
        if self._validity is not None:
            axes = len(self.layout.axes)
            accumulator, setpoint = np.array([values[:axes]]), np.array([values[axes : 2 * axes]])
            self._validity.note_amplifiers(
                np.array([tick]), np.array([valid]), accumulator, setpoint
            )

    def _on_sign_of_life(self) -> None:
        self._note_stop(self._stops.look_around())
        self._announce()

    def _announce(self) -> None:
        """Tell the plant how far the recording has come."""
        tick = self.account.reached()
        message = waferbot_msgs.msg.Recorded(tick=tick)
        stamp_ns = self._timing.stamp_ns(tick)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
        self._recorded_publisher.publish(message)

    def _on_stop(self, stop: Any) -> None:
        self._note_stop(self._stops.heard(stop))

    def _note_stop(self, stop: Any) -> None:
        if stop is not None and not self.stop_reason:
            self.interrupted = stop.reason == INTERRUPTED
            self.stop_reason = f'{stop.node} stopped at tick {stop.tick}: {stop.reason}'
