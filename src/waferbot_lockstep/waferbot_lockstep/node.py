# SPDX-License-Identifier: Apache-2.0
"""
The part of a node that keeps the contract: topics, time, signs of life, the end.

A node of the twin derives from `LockstepNode`, names what it needs and what it gives, and says what
to do when an input has come. Everything else is here:

- Messages are checked at the door (`waferbot_lockstep.inbox`).
- A node that waits repeats its last messages ten times a second. Its peers ignore the repetition, but
  know that it lives. So start order does not matter, a paused twin stays together, and silence means
  that a peer is gone.
- A node that finds an error publishes it once on `stop` and ends; the others end with that reason.

Messages go from node to node by their ROS topics, or, where nodes share a process or a channel, by an
`Exchange`; they are published on the topics in any case.

In real time (`timekeeping: realtime`) the inputs are those of `waferbot_lockstep.newest_input`: nobody
ends because of a message that is late, lost, doubled or early, nor because a peer is silent or has
stopped. All of that is counted and told on `/diagnostics`, and a peer that comes back is taken in
again.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    ParameterType,
    SetParametersResult,
)
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.exceptions import InvalidParameterValueException
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import String

import waferbot_msgs.msg
from waferbot_lockstep.channel import Channel
from waferbot_lockstep.contract import (
    HISTORY_DEPTH,
    MACHINE_AXES_TOPIC,
    PHASE_CURRENTS,
    STOP_TOPIC,
    Topic,
)
from waferbot_lockstep.definitions import field_types
from waferbot_lockstep.errors import LockstepError, UserError
from waferbot_lockstep.exchange import Exchange
from waferbot_lockstep.inbox import Inbox
from waferbot_lockstep.interrupt import Interrupt
from waferbot_lockstep.layout import SHIPPED, Layout
from waferbot_lockstep.newest_input import NewestInput
from waferbot_lockstep.node_settings import (
    LOCKSTEP,
    MACHINE_AXES,
    MACHINE_ENCODERS,
    NODE_SETTINGS,
    REALTIME,
)
from waferbot_lockstep.parameters import Parameter, Value, check_value, did_you_mean
from waferbot_lockstep.ros_logs import ensure_log_folder
from waferbot_lockstep.ros_security import refusals_told
from waferbot_lockstep.stops import Stops
from waferbot_lockstep.timing import Timing
from waferbot_lockstep.transport import choose_transport
from waferbot_lockstep.wire import WireFormat, wire_of

SIGN_OF_LIFE_PERIOD_S = 0.1
FAREWELL_S = 0.3
FAREWELL_LIMIT_S = 7.0
"""Two of the 3 s after which Fast DDS asks the readers what they have, and a margin."""
DIAGNOSTICS_PERIOD_S = 1.0
WAITING_NOTICE_PERIOD_S = 5.0
INTERRUPTED = 'interrupted by the user'

Trouble = tuple[bytes, str]
"""Level (of `DiagnosticStatus`) and text of something that is wrong."""


def lockstep_qos(depth: int = HISTORY_DEPTH) -> QoSProfile:
    """Return the quality of service of the contract's topics: reliable, volatile, keep last."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.VOLATILE,
    )


def latched_qos() -> QoSProfile:
    """Return the quality of service of what is said once, for whoever comes later."""
    return QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def message_class(topic: Topic, layout: Layout = SHIPPED) -> Any:
    """
    Return the generated class of a topic's messages for a machine.

    Raises `UserError` if its fields are not those that the bytes are packed by.
    """
    type_name = topic.type_for(layout)
    found = getattr(waferbot_msgs.msg, type_name.rpartition('/')[2])
    generated = {
        name: _as_defined(kind) for name, kind in found.get_fields_and_field_types().items()
    }
    if list(generated.items()) != list(field_types(type_name).items()):
        raise UserError(
            f'{type_name} as installed has other fields than waferbot_lockstep knows: after a '
            'change of a message, build, then run `python -m waferbot_lockstep.definitions_file`'
        )
    return found


def _as_defined(kind: str) -> str:
    """Return a type as a definition has it: `float64[<=8]` for rclpy's `sequence<double, 8>`."""
    kind = kind.replace('double', 'float64')
    bounded = re.fullmatch(r'sequence<(\w+), (\d+)>', kind)
    return kind if bounded is None else f'{bounded[1]}[<={bounded[2]}]'


class Outlet:
    """Where the messages of one topic go, as bytes: to the exchange, and to its ROS topic."""

    def __init__(self, publisher: Any, exchange: Exchange, mask: int = 1) -> None:
        """Speak for the places in `mask` of the topic of a publisher."""
        self.name: str = publisher.topic_name
        self.publisher = publisher
        self._exchange = exchange
        exchange.offer(self.name, mask)

    def send(self, message: bytes) -> None:
        """Send a message in CDR."""
        self._exchange.put(self.name, message)
        self.publisher.publish(message)


class LockstepNode(Node):
    """
    A node of the twin.

    `needs` lists the topics that the node waits for, `gives` those that it publishes, for all places of
    the machine's `layout`. `exchange` is that of the process, if it holds several nodes. `outcome` is
    None while it runs, '' after an ordinary end, otherwise the reason for which it stopped, as one line.
    """

    def __init__(
        self,
        name: str,
        needs: Sequence[Topic],
        gives: Sequence[Topic],
        exchange: Exchange | None = None,
        **node_options: Any,
    ) -> None:
        """Declare the common parameters and open the topics; nothing is sent before `begin`."""
        super().__init__(name, **node_options)
        self.outcome: str | None = None
        self._checks: dict[str, Parameter] = {}
        self.add_on_set_parameters_callback(self._check_parameters)
        settings = self.declare_settings('', NODE_SETTINGS)
        self.timing = Timing(
            int(settings['current_loop_hz']),
            int(settings['encoder_divider']),
            int(settings['servo_divider']),
        )
        self.end_tick = int(settings['end_tick'])
        self.patience_s = float(settings['patience_s'])
        self.timekeeping = self.declare_choice(
            'timekeeping', LOCKSTEP, (LOCKSTEP, REALTIME), 'who waits for whom'
        )
        self.layout = self.find_layout()
        self.exchange = exchange or self._own_exchange()
        self.inboxes: dict[Topic, Any] = {}
        self._wire: dict[Topic, WireFormat] = {}
        self._outlets: dict[Topic, Outlet] = {}
        self._inlets: dict[Topic, tuple[WireFormat, Callable[..., bool]]] = {}
        self._last_messages: dict[Outlet, bytes] = {}
        self._stop: Any = None  # the last word on `stop`
        for topic in gives:
            self.offer(topic, topic.all_places(self.layout))
        for topic in needs:
            self.need(topic, topic.all_places(self.layout))
        self._stop_publisher = self.create_publisher(
            waferbot_msgs.msg.Stop, STOP_TOPIC, lockstep_qos(8)
        )
        self.create_subscription(
            waferbot_msgs.msg.Stop, STOP_TOPIC, self._on_stop, lockstep_qos(8)
        )
        self._stops = Stops(self)
        self._diagnostics = self.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self._begun_s = 0.0
        self._noticed_s = 0.0
        self._last_heard_s: dict[tuple[Topic, int], float] = {}
        self._progress = 0
        self._seen_progress = -1
        self._silent: set[Topic] = set()
        self._told: dict[Topic, tuple[int, int]] = {}  # (received, trouble) when last told
        self._told_s = 0.0

    # ---- what a node says of itself -------------------------------------------------------------

    def find_layout(self) -> Layout:
        """Return the axes and encoders of the machine, from parameters; raises `UserError`."""
        axes, encoders = (
            self.declare_fixed(
                name, list(names), f'{what} of the machine, in order of their places'
            )
            for name, names, what in (
                (MACHINE_AXES, SHIPPED.axes, 'axes'),
                (MACHINE_ENCODERS, SHIPPED.encoders, 'encoders'),
            )
        )
        return Layout(tuple(axes), tuple(encoders))

    def on_input(self, topic: Topic) -> None:
        """Act on new values in `self.inboxes[topic]`; every node says how."""
        raise NotImplementedError

    @property
    def tick(self) -> int:
        """The tick at which this node stands, for stamps and messages."""
        raise NotImplementedError

    def begin_anew(self) -> None:
        """Start from the beginning, as the plant has (only in real time)."""

    def sleep_time_s(self) -> float | None:
        """Return the wall time until `on_time` is due; None if this node never needs to be woken."""
        return None

    def on_time(self) -> None:
        """Act on the passing of wall time (only nodes that keep real time)."""

    def watch(self, now_s: float) -> None:
        """Watch, ten times a second, for whatever else could be missing; `now_s` is monotonic."""

    # ---- life ------------------------------------------------------------------------------------

    def begin(self) -> None:
        """
        Open the inputs and start the signs of life; called once, when the process has all its nodes.

        Raises `UserError` if the node was given a parameter that it does not have.
        """
        self._refuse_unknown_parameters()
        for topic in self._inlets:
            self._open_inlet(topic)
        self._compare_machines()
        self._begun_s = self._noticed_s = time.monotonic()
        wall = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(SIGN_OF_LIFE_PERIOD_S, self._on_sign_of_life, clock=wall)
        self.create_timer(DIAGNOSTICS_PERIOD_S, self._on_diagnostics, clock=wall)

    def _compare_machines(self) -> None:
        """
        Have the plant say for which machine it is; who is for another one ends with that.

        Among machines with axes of their own: the shipped one has messages of another type.
        """
        if self.layout == SHIPPED:
            return
        if PHASE_CURRENTS in self._outlets:
            publisher = self.create_publisher(String, MACHINE_AXES_TOPIC, latched_qos())
            publisher.publish(String(data=str(self.layout)))
        else:
            self.create_subscription(
                String, MACHINE_AXES_TOPIC, self._on_machine_axes, latched_qos()
            )

    def _on_machine_axes(self, told: Any) -> None:
        if self.outcome is None and told.data != str(self.layout):
            self.fail(
                f'the plant is a machine with {told.data}; {self.get_name()} was started for '
                f'{self.layout}: give it {MACHINE_AXES} and {MACHINE_ENCODERS} of the plant'
            )

    def give(self, topic: Topic, tick: int, valid: int, values: Sequence[float]) -> None:
        """Publish `values` of the places in `valid` as the message of `tick`."""
        message = self._wire[topic].encode(tick, self.timing.stamp_ns(tick), valid, values)
        self.publish(self._outlets[topic], message)

    def publish(self, outlet: Outlet, message: bytes) -> None:
        """Publish a message in CDR, and keep it for the signs of life."""
        self._last_messages[outlet] = message
        self._progress += 1
        outlet.send(message)

    def finish(self) -> None:
        """End ordinarily."""
        if self.outcome is None:
            self.outcome = ''

    def fail(self, reason: str) -> None:
        """Stop for `reason` and let the other nodes know it."""
        if self.outcome is not None:
            return
        self.outcome = reason
        if reason != INTERRUPTED:
            self.get_logger().error(reason)
        stop = waferbot_msgs.msg.Stop(
            tick=max(self.tick, 0), node=self.get_fully_qualified_name(), reason=reason
        )
        stamp_ns = self.timing.stamp_ns(max(self.tick, 0))
        stop.header.stamp.sec, stop.header.stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
        self._last_messages = {}
        self._stop = stop
        self._stop_publisher.publish(stop)
        self._on_diagnostics()

    def interrupt(self) -> None:
        """Stop because the user said so."""
        if self.outcome is None:
            self.fail(INTERRUPTED)
            self.outcome = ''

    def take_leave(self, interrupt: Interrupt) -> None:
        """
        Stay after the end, repeating the last messages, so that nobody misses one.

        A message that is lost on the way is sent again when its reader finds out, and only while its
        writer lives. Readers find out when Fast DDS asks them what they have (see `transport`: every
        3 s where the user's own settings hold); repetitions do not make it ask. So after an ordinary
        end the node stays until all it said is acknowledged, or until an interrupt says that it is not
        needed any more, but not shorter than `FAREWELL_S` nor longer than `FAREWELL_LIMIT_S`. After any
        other end it stays `FAREWELL_S`: whoever does not answer then may be dead.
        """
        begun_s = time.monotonic()
        while True:
            self._repeat()
            time.sleep(SIGN_OF_LIFE_PERIOD_S / 2)
            stayed_s = time.monotonic() - begun_s
            if stayed_s < FAREWELL_S:
                continue
            if self._stop is not None or interrupt.raised or stayed_s > FAREWELL_LIMIT_S:
                return
            if self._all_acknowledged():
                return

    def _all_acknowledged(self) -> bool:
        at_once = Duration()
        return all(outlet.publisher.wait_for_all_acked(at_once) for outlet in self._last_messages)

    def _repeat(self) -> None:
        for outlet, message in self._last_messages.items():
            outlet.send(message)
        if self._stop is not None:
            self._stop_publisher.publish(self._stop)

    def offer(self, topic: Topic, mask: int) -> None:
        """Speak for the places in `mask` of a topic; call it before `begin`."""
        self._wire[topic] = wire_of(topic, self.layout)
        message = message_class(topic, self.layout)
        publisher = self.create_publisher(message, topic.name, lockstep_qos())
        self._outlets[topic] = Outlet(publisher, self.exchange, mask)

    def need(self, topic: Topic, mask: int) -> None:
        """Wait for the places in `mask` of a topic; call it before `begin`."""
        if self.timekeeping == REALTIME:
            push = self._real_time_input(topic, mask)
        else:
            inbox = self.inboxes[topic] = self.lockstep_input(topic, mask)
            push = inbox.push
        self._inlets[topic] = wire_of(topic, self.layout), push

    def lockstep_input(self, topic: Topic, mask: int) -> Any:
        """Return the input of a topic in lock-step."""
        return Inbox(topic, self.timing, mask, self.layout)

    def _open_inlet(self, topic: Topic) -> None:
        wire, push = self._inlets[topic]
        decode = wire.decode

        def take(
            data: bytes, tick: int, stamp_ns: int, valid: int, values: Sequence[float]
        ) -> None:
            if self.outcome is not None:
                return
            try:
                if push(tick, stamp_ns, valid, values):
                    self.on_input(topic)
            except UserError as error:
                self.fail(str(error))

        def on_message(data: bytes) -> None:
            try:
                fields = decode(data)
            except UserError as error:
                self.fail(str(error))
            else:
                take(data, *fields)

        name = self.resolve_topic_name(topic.name)
        if self.exchange.takes(name, self.inboxes[topic].needed):
            self.exchange.listen(name, take, decode)
        else:
            # In real time what the plant says counts only while it is new. Who worked off all that came
            # while it was away would answer ticks long past, and fall further behind meanwhile.
            newest = self.timekeeping == REALTIME and self.inboxes[topic].gives_time
            qos = lockstep_qos(1) if newest else lockstep_qos()
            message = message_class(topic, self.layout)
            self.create_subscription(message, topic.name, on_message, qos, raw=True)

    def _own_exchange(self) -> Exchange:
        """Return the exchange of a node that has a process to itself."""
        folder = self.declare_fixed(
            'channel',
            '',
            'folder of the Unix sockets by which nodes exchange messages; empty: by ROS topics',
        )
        from_topics = self.declare_fixed(
            'from_topics',
            [''],
            'with a channel, the topics that come from nodes that have none',
        )
        if not folder:
            return Exchange()
        if self.timekeeping == REALTIME:
            raise UserError('a channel is for lock-step; in real time nodes exchange by topics')
        names = [self.resolve_topic_name(name) for name in from_topics if name]
        return Exchange(Channel(Path(folder), self.get_name()), names)

    def _real_time_input(self, topic: Topic, mask: int) -> Callable[..., bool]:
        """Add the input of a topic in real time; return the function that takes its messages."""
        inbox = self.inboxes[topic] = NewestInput(topic, self.timing, mask, self.layout)

        def push(tick: int, stamp_ns: int, valid: int, values: Sequence[float]) -> bool:
            new = inbox.push(tick, stamp_ns, valid, values, time.monotonic())
            if inbox.began_anew:
                inbox.began_anew = False
                for other in self.inboxes.values():
                    if other is not inbox:
                        other.forget()
                self.get_logger().warning('the plant has begun anew; so does this node')
                self.begin_anew()
            return new

        return push

    def _on_stop(self, stop: Any) -> None:
        if self.outcome is None and stop.node != self.get_fully_qualified_name():
            self._follow(self._stops.heard(stop))

    def _follow(self, stop: Any) -> None:
        """End with a peer that has stopped, if there is one."""
        if stop is None or self.outcome is not None:
            return
        if self.timekeeping == REALTIME:
            self.get_logger().warning(
                f'{stop.node} stopped at tick {stop.tick}: {stop.reason}; going on without it'
            )
            return
        if stop.reason == INTERRUPTED:
            self.outcome = ''
            self.get_logger().info(f'{stop.node} was {INTERRUPTED} at tick {stop.tick}')
        else:
            self.outcome = f'{stop.node} stopped at tick {stop.tick}: {stop.reason}'
            self.get_logger().error(self.outcome)
        # Passed on in the farewell: a node that has just started may know this one, but not yet that.
        self._stop = stop

    def _on_sign_of_life(self) -> None:
        if self.outcome is not None:
            return
        if self._progress == self._seen_progress:
            self._repeat()
        self._seen_progress = self._progress
        self._follow(self._stops.look_around())
        now_s = time.monotonic()
        self._watch_peers(now_s)
        self.watch(now_s)

    def _watch_peers(self, now_s: float) -> None:
        for topic, inbox in self.inboxes.items():
            heard, inbox.heard = inbox.heard, 0
            for place, _ in enumerate(inbox.places):
                if not inbox.needed >> place & 1:
                    continue
                key = (topic, place)
                if heard >> place & 1:
                    self._last_heard_s[key] = now_s
                elif key not in self._last_heard_s:
                    self._check_startup(inbox, now_s)
                elif isinstance(inbox, Inbox):
                    self._check_silence(inbox, place, now_s - self._last_heard_s[key])
                if self.outcome is not None:
                    return
            if self.timekeeping == REALTIME:
                self._tell_silence(inbox, now_s)

    def _tell_silence(self, inbox: NewestInput, now_s: float) -> None:
        """In real time, say once that a peer has fallen silent, and that it is back."""
        topic = inbox.topic
        silence = self._silence(topic, now_s)
        if silence and topic not in self._silent:
            self._silent.add(topic)
            self.get_logger().error(silence)
        elif not silence and topic in self._silent:
            self._silent.remove(topic)
            self.get_logger().warning(f'{topic.publisher} is back: topic {topic.name} goes on')

    def _silence(self, topic: Topic, now_s: float) -> str:
        """Return which places of a topic have been silent for too long, and for how long; or ''."""
        timeout_s = self.get_parameter('peer_timeout_s').value
        silence_s = {
            topic.places(self.layout)[place]: now_s - heard_s
            for (heard_topic, place), heard_s in self._last_heard_s.items()
            if heard_topic is topic and now_s - heard_s > timeout_s
        }
        if not silence_s:
            return ''
        return (
            f'{topic.publisher} is gone: topic {topic.name} ({", ".join(silence_s)}) is silent for '
            f'{max(silence_s.values()):.1f} s; its last values are held'
        )

    def give_up(self, inbox: NewestInput, tick: int) -> None:
        """In real time, wait no longer for what is due by `tick`, nor ever for peers that are gone."""
        timeout_s = self.get_parameter('peer_timeout_s').value
        now_s, gone = time.monotonic(), 0
        for (topic, place), heard_s in self._last_heard_s.items():
            if topic is inbox.topic and now_s - heard_s > timeout_s:
                gone |= 1 << place
        inbox.give_up(tick, gone)

    def _check_silence(self, inbox: Any, place: int, silence_s: float) -> None:
        timeout_s = self.get_parameter('peer_timeout_s').value
        if silence_s <= timeout_s:
            return
        topic = inbox.topic
        self.fail(
            f'{topic.publisher} is gone: topic {topic.name} ({inbox.places[place]}) is silent for '
            f'{silence_s:.1f} s, tick {inbox.due} never came; look at the end of the log of '
            f'{topic.publisher}'
        )

    def _check_startup(self, inbox: Any, now_s: float) -> None:
        waited_s = now_s - self._begun_s
        timeout_s = self.get_parameter('startup_timeout_s').value
        what = f'{inbox.topic.publisher} ({inbox.topic.name}: {inbox.missing})'
        if timeout_s and waited_s > timeout_s:
            self.fail(
                f'{what} did not appear within {timeout_s:g} s, tick {max(self.tick, 0)} cannot '
                'begin; is it started, with the same domain, namespace and axes?'
            )
        elif now_s - self._noticed_s > WAITING_NOTICE_PERIOD_S:
            self._noticed_s = now_s
            self.get_logger().info(f'waiting for {what}')

    def _on_diagnostics(self) -> None:
        now_s = time.monotonic()
        period_s, self._told_s = now_s - (self._told_s or self._begun_s), now_s
        own_values, troubles = self.diagnostics()
        values = {'tick': str(self.tick)}
        for topic, inbox in self.inboxes.items():
            if isinstance(inbox, NewestInput):
                values.update(self._arrival_values(topic, inbox, period_s))
                troubles.extend(self._arrival_troubles(topic, inbox, now_s))
                self._told[topic] = inbox.arrivals.received, inbox.arrivals.trouble
        values.update(own_values)
        if self._stops.ignored:
            values['stops of strangers'] = str(self._stops.ignored)
            troubles.append((DiagnosticStatus.WARN, 'strangers have asked the twin to stop'))
        if self.outcome:
            troubles.insert(0, (DiagnosticStatus.ERROR, self.outcome))
        status = DiagnosticStatus(
            level=max((level for level, _ in troubles), default=DiagnosticStatus.OK),
            name=f'{self.get_fully_qualified_name()}: timekeeping',
            message='; '.join(text for _, text in troubles) or self.timekeeping,
            hardware_id='waferbot',
            values=[KeyValue(key=key, value=value) for key, value in values.items()],
        )
        array = DiagnosticArray(status=[status])
        array.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(array)

    def _arrival_values(self, topic: Topic, inbox: NewestInput, period_s: float) -> dict[str, str]:
        """Return how the messages of a topic came, in real time."""
        arrivals = inbox.arrivals
        received_before = self._told.get(topic, (0, 0))[0]
        rate_hz = (arrivals.received - received_before) / period_s if period_s > 0.0 else 0.0
        figures = {
            'rate [1/s of wall time]': f'{rate_hz:.0f}',
            'received': str(arrivals.received),
            'late': str(arrivals.late),
            'missed': str(arrivals.missed),
            'early': str(arrivals.early),
            'doubled': str(arrivals.doubled),
            'contradicting': str(arrivals.contradicting),
            'behind [ticks]': str(inbox.behind),
            'longest silence [ms]': f'{1e3 * arrivals.longest_silence_s:.3g}',
        }
        if not inbox.gives_time:
            figures['lateness, 99th percentile [ms]'] = f'{1e3 * arrivals.percentile_s(99):.3g}'
            figures['lateness, worst [ms]'] = f'{1e3 * arrivals.worst_s:.3g}'
        return {f'{topic.name} {key}': value for key, value in figures.items()}

    def _arrival_troubles(
        self, topic: Topic, inbox: NewestInput, now_s: float
    ) -> Iterator[Trouble]:
        """Yield what went wrong on a topic since it was last told."""
        silence = self._silence(topic, now_s)
        if silence:
            yield DiagnosticStatus.ERROR, silence
        elif inbox.arrivals.trouble != self._told.get(topic, (0, 0))[1]:
            yield DiagnosticStatus.WARN, f'{topic.name}: messages came late, early or not at all'

    def diagnostics(self) -> tuple[dict[str, str], list[Trouble]]:
        """Return what a node adds to its diagnostics: values, and what is wrong with it now."""
        return {}, []

    # ---- parameters ------------------------------------------------------------------------------

    def declare_settings(
        self,
        prefix: str,
        parameters: Iterable[Parameter],
        defaults: Mapping[str, Value] | None = None,
    ) -> dict[str, Value]:
        """
        Declare each `Parameter` as the ROS parameter `<prefix>.<name>` and return the values.

        Description, unit and range go into the descriptor; a whole number given for a real one is
        accepted. Raises `UserError` for a value of the wrong type or out of range.
        """
        values: dict[str, Value] = {}
        for parameter in parameters:
            name = f'{prefix}.{parameter.name}' if prefix else parameter.name
            default = (defaults or {}).get(parameter.name, parameter.default)
            self._checks[name] = parameter
            value = self._declare(name, default, _descriptor(parameter))
            values[parameter.name] = check_value(parameter, value, prefix)
        return values

    def declare_choice(
        self, name: str, default: str, choices: Sequence[str], description: str
    ) -> str:
        """Declare a read-only text parameter that must be one of `choices`; return its value."""
        descriptor = ParameterDescriptor(
            description=description,
            additional_constraints='one of: ' + ', '.join(choices),
            read_only=True,
        )
        value = self._declare(name, default, descriptor)
        if value not in choices:
            raise UserError(f'{name} is {value!r}; it must be one of {", ".join(choices)}')
        return value

    def declare_fixed(self, name: str, default: Any, description: str) -> Any:
        """Declare a parameter that counts at the start of the node only; return its value."""
        descriptor = ParameterDescriptor(description=description, read_only=True)
        return self._declare(name, default, descriptor)

    def _declare(self, name: str, default: Any, descriptor: ParameterDescriptor) -> Any:
        try:
            return self.declare_parameter(name, default, descriptor).value
        except InvalidParameterValueException as error:
            raise UserError(f'parameter {name}: {error}') from error

    def parameters_of_others(self) -> Iterable[str]:
        """Return names that a file may give to this node though only a node of its kind has them."""
        return ()

    def _refuse_unknown_parameters(self) -> None:
        """ROS passes over parameters that nobody declares; a misspelt one would have no effect."""
        declared = set(self.list_parameters([], 0).names)
        known = declared.union(self.parameters_of_others())
        for name in self._parameter_overrides:
            if name not in known and not name.startswith('qos_overrides.'):
                raise UserError(
                    f'{self.get_name()} has no parameter {name!r}{did_you_mean(name, known)}'
                )

    def _check_parameters(self, parameters: list[RosParameter]) -> SetParametersResult:
        for parameter in parameters:
            declared = self._checks.get(parameter.name)
            if declared is None:
                continue
            try:
                check_value(declared, parameter.value, '')
            except UserError as error:
                return SetParametersResult(successful=False, reason=str(error))
        try:
            self.check_change({parameter.name: parameter.value for parameter in parameters})
        except UserError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def check_change(self, changes: Mapping[str, Any]) -> None:
        """Raise `UserError` if values that are each in range contradict one another."""


def _descriptor(parameter: Parameter) -> ParameterDescriptor:
    unit = f' [{parameter.unit}]' if parameter.unit else ''
    descriptor = ParameterDescriptor(
        description=f'{parameter.description}{unit}',
        read_only=parameter.fixed,
        additional_constraints=f'{parameter.range_text()}',
    )
    if parameter.integer:
        descriptor.type = ParameterType.PARAMETER_INTEGER
        descriptor.integer_range = [
            IntegerRange(from_value=int(parameter.low), to_value=int(parameter.high), step=1)
        ]
    else:
        descriptor.type = ParameterType.PARAMETER_DOUBLE
        descriptor.dynamic_typing = True  # a YAML file may say 40 where 40.0 is meant
        descriptor.floating_point_range = [
            FloatingPointRange(from_value=float(parameter.low), to_value=float(parameter.high))
        ]
    return descriptor


def make_executor() -> Any:
    """Return the events executor where rclpy has it (Jazzy), else the single-threaded one."""
    try:
        from rclpy.experimental.events_executor import EventsExecutor
    except ImportError:
        from rclpy.executors import SingleThreadedExecutor

        return SingleThreadedExecutor()
    return EventsExecutor()


def spin_until_done(
    nodes: Sequence[LockstepNode], interrupt: Interrupt, executor: Any | None = None
) -> None:
    """
    Serve the nodes, which share an exchange, until each has an outcome.

    One node stopping with an error ends all of them; an interrupt ends all of them ordinarily.
    """
    executor = executor or make_executor()
    exchange = nodes[0].exchange
    for node in nodes:
        executor.add_node(node)
    timed = [node for node in nodes if node.timekeeping == REALTIME]
    for node in nodes:
        node.begin()
    try:
        while any(node.outcome is None for node in nodes):
            timeout_s = SIGN_OF_LIFE_PERIOD_S
            for node in timed:
                due_s = node.sleep_time_s()
                if due_s is not None:
                    timeout_s = min(timeout_s, due_s)
            exchange.serve(executor, max(timeout_s, 0.0))
            for node in timed:
                if node.outcome is None:
                    node.on_time()
            if interrupt.raised:
                for node in nodes:
                    node.interrupt()
    except ExternalShutdownException:
        pass
    except Exception as error:
        for node in nodes:
            node.fail(f'internal error, please report it: {error!r}')
        raise
    finally:
        for node in nodes:
            executor.remove_node(node)
        executor.shutdown(0.0)


def run_node(make_node: Any, arguments: Sequence[str] | None = None) -> int:
    """Run one node as a process, as `run_nodes` does; `make_node` is called without arguments."""
    return run_nodes(lambda: [make_node()], arguments)


def run_nodes(
    make_nodes: Callable[[], Sequence[LockstepNode]], arguments: Sequence[str] | None = None
) -> int:
    """
    Run nodes that share an exchange as a process.

    Return its exit code (0: ended as meant, 1: an error, told on stderr). `make_nodes` is called once
    rclpy is up.
    """
    choose_transport()
    interrupt = Interrupt()
    ensure_log_folder()
    nodes: Sequence[LockstepNode] = []
    try:
        with refusals_told():
            rclpy.init(
                args=None if arguments is None else list(arguments),
                signal_handler_options=SignalHandlerOptions.NO,
            )
            nodes = make_nodes()
        spin_until_done(nodes, interrupt)
        for node in nodes:
            node.take_leave(interrupt)
        return 1 if any(node.outcome for node in nodes) else 0
    except (UserError, LockstepError) as error:
        rclpy.logging.get_logger('waferbot').error(str(error))
        return 1
    finally:
        for node in nodes:
            node.exchange.close()
            node.destroy_node()
        rclpy.try_shutdown()
        interrupt.ignore()
