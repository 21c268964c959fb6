# SPDX-License-Identifier: Apache-2.0
"""
Conformance of one node to docs/contract.md: the kit speaks for all its peers, and looks at what it does.

Each check starts the node anew, as its own process in its own ROS domain, brings it to a running
lock-step, does one thing to it and judges the answer. The kit is an ordinary ROS node and knows no more
of the node under test than a plant or an amplifier would.
"""

from __future__ import annotations

import contextlib
import math
import signal
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

import waferbot_msgs.msg
from waferbot_lockstep.contract import (
    CURRENT_COMMAND,
    ENCODERS_TOPIC,
    PHASE_CURRENTS,
    PHASE_VOLTAGES,
    STOP_TOPIC,
    Topic,
)
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.layout import SHIPPED, Layout
from waferbot_lockstep.node import lockstep_qos, make_executor, message_class
from waferbot_lockstep.ros_logs import ensure_log_folder
from waferbot_lockstep.timing import Timing
from waferbot_lockstep.wire import wire_of
from waferbot_twin.engines.domain import Domain
from waferbot_twin.engines.ros import ros_environment

RIGHT, TOLERATED, WRONG = 'right', 'tolerated', 'wrong'

START_S = 60.0
"""Wall time for the node to start and to answer tick 0; compiling may be part of it."""

ANSWER_S = 5.0
"""Wall time for an answer of a node that runs, for its stop, and for its end."""

REPEAT_S = 0.1
PAUSE_S = 1.2
"""Wall time for which the kit keeps its peer waiting; less than `peer_timeout_s`."""

SILENCE_S = 2.0 + ANSWER_S
"""The node's patience with silent peers, and the time to say so."""

SETTLED_TICK = 160
"""Where a node is taken to run."""

STEADY_TICKS = 1600

# Node: what it needs, in the order in which its peers would speak, and what it answers
ROLES: dict[str, tuple[tuple[Topic, ...], Topic]] = {
    'pmac': ((ENCODERS_TOPIC,), CURRENT_COMMAND),
    'copley': ((ENCODERS_TOPIC, PHASE_CURRENTS, CURRENT_COMMAND), PHASE_VOLTAGES),
}


@dataclass(frozen=True)
class Finding:
    """What a check found: `grade` is RIGHT, TOLERATED or WRONG; `text` says what the node did."""

    check: str
    grade: str
    text: str


class Deviation(Exception):
    """The node did what the contract does not allow."""


@dataclass
class Answer:
    """A message of the node under test, and when it came (monotonic wall time, s)."""

    tick: int
    stamp_ns: int
    valid: int
    values: tuple[float, ...]
    arrived_s: float

    @property
    def content(self) -> tuple[int, int, tuple[float, ...]]:
        """What two messages of one tick must have in common."""
        return self.tick, self.valid, self.values


class Peers(Node):
    """Speaks for all peers of the node under test; `answers` and `stops` have what it said."""

    def __init__(self, role: str, places: int, layout: Layout) -> None:
        """Open the topics of a `ROLES` entry; answers are expected for the `places` of a mask."""
        super().__init__('conformance')
        self.layout = layout
        self.timing = Timing()
        self.inputs, self.output = ROLES[role]
        self.places = places
        self.answers: list[Answer] = []
        self.stops: list[Any] = []
        self.broken = ''
        self._wire = {topic: wire_of(topic, layout) for topic in (*self.inputs, self.output)}
        self._voices = {
            topic: self.create_publisher(message_class(topic, layout), topic.name, lockstep_qos())
            for topic in self.inputs
        }
        self._last: dict[Topic, bytes] = {}
        self.stop_publisher = self.create_publisher(
            waferbot_msgs.msg.Stop, STOP_TOPIC, lockstep_qos(8)
        )
        self.create_subscription(
            message_class(self.output, layout),
            self.output.name,
            self._on_answer,
            lockstep_qos(),
            raw=True,
        )
        self.create_subscription(waferbot_msgs.msg.Stop, STOP_TOPIC, self._on_stop, 8)

    def _on_answer(self, data: bytes) -> None:
        try:
            tick, stamp_ns, valid, values = self._wire[self.output].decode(data)
        except UserError as error:
            self.broken = str(error)
        else:
            self.answers.append(Answer(tick, stamp_ns, valid, values, time.monotonic()))

    def _on_stop(self, stop: Any) -> None:
        if stop.node != self.get_fully_qualified_name():
            self.stops.append(stop)

    def topics_missing(self) -> str:
        """Return the topics that the node under test has not opened yet, for texts; '' if none."""
        missing = [
            f'/{topic.name}' for topic in self.inputs if not self.count_subscribers(topic.name)
        ]
        if not self.count_publishers(self.output.name):
            missing.append(f'/{self.output.name}')
        return ', '.join(missing)

    def due(self, tick: int) -> list[Topic]:
        """Return the inputs that have a message at a tick."""
        return [topic for topic in self.inputs if tick % topic.ticks_between(self.timing) == 0]

    def say(self, topic: Topic, tick: int, shift: float = 0.0, remember: bool = True) -> None:
        """Give a topic its message of a tick; all its values are `shift`."""
        count = len(topic.places(self.layout)) * topic.width
        whole = topic is ENCODERS_TOPIC
        values = [int(shift) if whole else shift] * count
        valid = topic.all_places(self.layout)
        data = self._wire[topic].encode(tick, self.timing.stamp_ns(tick), valid, values)
        if remember:
            self._last[topic] = data
        self._voices[topic].publish(data)

    def repeat(self) -> None:
        """Say the last messages again, as a node that waits does."""
        for topic, data in self._last.items():
            self._voices[topic].publish(data)

    def stop(self, reason: str) -> None:
        """Leave the lock-step as a peer would."""
        self.stop_publisher.publish(
            waferbot_msgs.msg.Stop(
                tick=SETTLED_TICK, node=self.get_fully_qualified_name(), reason=reason
            )
        )


class Trial:
    """A node under test, started anew, and its peers."""

    def __init__(self, role: str, command: Sequence[str], places: int, layout: Layout) -> None:
        """Start the process and open the topics."""
        self.peers = Peers(role, places, layout)
        self.executor = make_executor()
        self.executor.add_node(self.peers)
        self.process = subprocess.Popen(
            list(command),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )

    def end(self) -> None:
        """Kill the node, if it still runs, and close the topics."""
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()
        self.executor.remove_node(self.peers)
        self.executor.shutdown(0.0)
        self.peers.destroy_node()

    def spin_until(
        self, done: Callable[[], Any], timeout_s: float, repeat_s: float = REPEAT_S
    ) -> bool:
        """
        Serve the topics until `done`; return False if it takes too long.

        Signs of life of the peers come every `repeat_s`.
        """
        end_s = time.monotonic() + timeout_s
        repeated_s = time.monotonic()
        while not done():
            now_s = time.monotonic()
            if now_s > end_s:
                return False
            if now_s - repeated_s > repeat_s:
                repeated_s = now_s
                self.peers.repeat()
            self.executor.spin_once(timeout_sec=0.02)
        return True

    def run(self, ticks: range, timeout_s: float = ANSWER_S) -> None:
        """Go through ticks in lock-step; raises `Deviation` at the first that is not answered well."""
        peers = self.peers
        for tick in ticks:
            for topic in peers.due(tick):
                peers.say(topic, tick)
            if tick % peers.output.ticks_between(peers.timing) == 0:
                self.expect(tick, timeout_s)

    def expect(self, tick: int, timeout_s: float = ANSWER_S) -> None:
        """Wait for the answer of a tick and check all that has come."""
        peers = self.peers
        if not self.spin_until(
            lambda: self.covered(tick) == peers.places or self.over(), timeout_s
        ):
            raise Deviation(f'no answer for tick {tick} within {timeout_s:g} s')
        if self.covered(tick) != peers.places:
            raise Deviation(self.how_it_ended() + f', with tick {tick} to be answered')
        self.check_all(tick)

    def covered(self, tick: int) -> int:
        """Return the mask of the places that have been given for a tick."""
        mask = 0
        for answer in self.peers.answers:
            mask |= answer.valid if answer.tick == tick else 0
        return mask & self.peers.places

    def check_all(self, newest: int) -> None:
        """Check every message so far; none may be of a tick beyond `newest`."""
        peers = self.peers
        if peers.broken:
            raise Deviation(peers.broken)
        spacing = peers.output.ticks_between(peers.timing)
        said: dict[tuple[int, int], Answer] = {}
        for answer in peers.answers:
            where = f'tick {answer.tick}'
            if answer.tick > newest:
                raise Deviation(f'spoke of {where} when only {newest} had all its inputs')
            if answer.tick % spacing:
                raise Deviation(f'{where} is none of this topic, which has every {spacing}th')
            if answer.stamp_ns != peers.timing.stamp_ns(answer.tick):
                raise Deviation(
                    f'{where} has the stamp {answer.stamp_ns} ns; it must be '
                    f'{peers.timing.stamp_ns(answer.tick)} ns, tick * 500000 // 9'
                )
            if answer.valid == 0 or answer.valid & ~peers.output.all_places(peers.layout):
                raise Deviation(f'{where} speaks for axes that do not exist: {answer.valid:#x}')
            if not all(map(math.isfinite, answer.values)):
                raise Deviation(f'{where} holds a value that is no finite number: {answer.values}')
            before = said.setdefault((answer.tick, answer.valid), answer)
            if before.content != answer.content:
                raise Deviation(f'{where} came twice, and not the same')
        peers.answers = [answer for answer in peers.answers if answer.tick >= newest - spacing]

    def over(self) -> bool:
        """Tell whether the node has ended or said why it stops."""
        return bool(self.peers.stops) or self.process.poll() is not None

    def how_it_ended(self) -> str:
        """Return how the node ended, for texts."""
        if self.peers.stops:
            return f'stopped: {self.peers.stops[0].reason}'
        return f'ended with exit code {self.process.poll()}'


Check = Callable[[Trial], tuple[str, str]]


def begins(trial: Trial) -> tuple[str, str]:
    """Answer tick 0, however late the inputs come, and nothing before."""
    peers = trial.peers
    # Its silence tells nothing before it can be heard: a busy computer takes seconds to start it.
    if not trial.spin_until(
        lambda: peers.answers or trial.over() or not peers.topics_missing(), START_S
    ):
        raise Deviation(f'did not open {peers.topics_missing()} within {START_S:g} s')
    trial.spin_until(lambda: peers.answers or trial.over(), PAUSE_S)
    if peers.answers:
        raise Deviation(f'spoke of tick {peers.answers[0].tick} before it had any input')
    trial.run(range(1), START_S)
    return RIGHT, 'said nothing without inputs, and answered tick 0'


def runs(trial: Trial) -> tuple[str, str]:
    """Answer each tick of its topic once, with tick, stamp, axes and finite values."""
    trial.run(range(1), START_S)
    trial.run(range(1, STEADY_TICKS))
    return RIGHT, f'answered every message up to tick {STEADY_TICKS - 1}'


def lives(trial: Trial) -> tuple[str, str]:
    """While it waits, repeat the last message about ten times a second, and go on after it."""
    settle(trial)
    trial.peers.answers.clear()
    # Its peers wait, too, and what they repeat wakes it more often than it has to speak.
    trial.spin_until(trial.over, PAUSE_S, 0.5 * REPEAT_S)
    trial.check_all(SETTLED_TICK)
    repeated = len({answer.arrived_s for answer in trial.peers.answers})
    trial.run(range(SETTLED_TICK + 1, 2 * SETTLED_TICK))
    if repeated < 3:
        raise Deviation(
            f'repeated its last message {repeated} times in {PAUSE_S:g} s; its peers take it for '
            'gone after 2 s, and who starts later never hears it'
        )
    return RIGHT, f'repeated its last message {repeated} times in {PAUSE_S:g} s, and went on'


def doubled(trial: Trial) -> tuple[str, str]:
    """Pass over a message that comes twice."""
    settle(trial)
    peers = trial.peers
    for tick in range(SETTLED_TICK + 1, 2 * SETTLED_TICK):
        for topic in peers.due(tick):
            peers.say(topic, tick)
            peers.say(topic, tick)
        if tick % peers.output.ticks_between(peers.timing) == 0:
            trial.expect(tick)
    return RIGHT, 'passed over the second of each'


def waits(trial: Trial) -> tuple[str, str]:
    """Answer only when all inputs of the tick are there, in whatever order they come."""
    settle(trial)
    peers = trial.peers
    first, end = SETTLED_TICK + 1, SETTLED_TICK + 65
    for tick in range(first, end):
        for topic in reversed(peers.due(tick)):
            if tick % 8 == 0 and topic is peers.due(tick)[0]:
                trial.spin_until(trial.over, 0.05, math.inf)
                trial.check_all(tick - 1)
            peers.say(topic, tick)
        if tick % peers.output.ticks_between(peers.timing) == 0:
            trial.expect(tick)
    return RIGHT, 'waited for all inputs of a tick, in any order'


def stale(trial: Trial) -> tuple[str, str]:
    """Refuse a message of long ago that says something new."""
    settle(trial)
    return judge_refusal(trial, [(topic, -80, 7.0) for topic in trial.peers.inputs[:1]])


def missing(trial: Trial) -> tuple[str, str]:
    """Refuse a message behind one that never came."""
    settle(trial)
    return judge_refusal(trial, [(topic, 16, 0.0) for topic in trial.peers.inputs[:1]])


def contradicting(trial: Trial) -> tuple[str, str]:
    """Refuse a second message of the same tick that says something else."""
    settle(trial)
    return judge_refusal(trial, [(topic, 0, 9.0) for topic in trial.peers.inputs[:1]])


def not_finite(trial: Trial) -> tuple[str, str]:
    """Refuse a value that is no number, and never pass it on."""
    settle(trial)
    peers = trial.peers
    if peers.inputs == (ENCODERS_TOPIC,):
        return RIGHT, 'counts are whole numbers: there is nothing to refuse'
    return judge_refusal(trial, [(PHASE_CURRENTS, 1, math.nan)])


def judge_refusal(trial: Trial, messages: list[tuple[Topic, int, float]]) -> tuple[str, str]:
    """Send messages that do not fit, by (topic, ticks from now, value), and see what comes of it."""
    peers = trial.peers
    peers.answers.clear()
    for topic, ahead, value in messages:
        peers.say(topic, SETTLED_TICK + ahead, value, remember=False)
    trial.spin_until(trial.over, 1.0)
    trial.check_all(SETTLED_TICK)
    if peers.stops:
        topic = messages[0][0]
        named = topic.name in peers.stops[0].reason
        text = f'stopped with the reason {peers.stops[0].reason!r}'
        return (RIGHT, text) if named else (TOLERATED, f'{text}, which names no topic')
    if trial.process.poll() is not None:
        return TOLERATED, 'ended, but did not say why on `stop`: its peers find out in 2 s'
    return TOLERATED, 'passed over it; a mistake of a peer stays unsaid'


def follows_stop(trial: Trial) -> tuple[str, str]:
    """End when a peer says `stop`."""
    settle(trial)
    trial.peers.stop('the conformance kit says so')
    if not trial.spin_until(lambda: trial.process.poll() is not None, ANSWER_S):
        return WRONG, f'still runs {ANSWER_S:g} s after a peer stopped'
    return RIGHT, 'ended'


def notices_silence(trial: Trial) -> tuple[str, str]:
    """Stop when a peer is silent for `peer_timeout_s`."""
    settle(trial)
    if trial.spin_until(trial.over, SILENCE_S, math.inf):
        return RIGHT, trial.how_it_ended()
    return TOLERATED, f'still waits after {SILENCE_S:g} s without a sign of life'


def ends_on_interrupt(trial: Trial) -> tuple[str, str]:
    """End on SIGINT."""
    settle(trial)
    trial.process.send_signal(signal.SIGINT)
    if not trial.spin_until(lambda: trial.process.poll() is not None, 2 * ANSWER_S):
        return WRONG, f'still runs {2 * ANSWER_S:g} s after SIGINT'
    return RIGHT, f'ended with exit code {trial.process.returncode}'


def settle(trial: Trial) -> None:
    """Bring the node to a running lock-step."""
    trial.run(range(1), START_S)
    trial.run(range(1, SETTLED_TICK + 1))


CHECKS: dict[str, Check] = {
    'begins': begins,
    'runs': runs,
    'signs of life': lives,
    'waits for all inputs': waits,
    'doubled message': doubled,
    'stale message': stale,
    'missing message': missing,
    'contradicting message': contradicting,
    'value not finite': not_finite,
    'stop': follows_stop,
    'silence': notices_silence,
    'interrupt': ends_on_interrupt,
}


def conform(
    role: str,
    command: Sequence[str],
    axes: Sequence[str],
    checks: Sequence[str] = tuple(CHECKS),
    layout: Layout = SHIPPED,
) -> Iterator[Finding]:
    """Yield what each check finds of the node that `command` starts, for these axes of a machine."""
    for name in checks:
        with trial(role, command, layout.mask(axes), layout) as one:
            try:
                grade, text = CHECKS[name](one)
            except Deviation as deviation:
                grade, text = WRONG, str(deviation)
        yield Finding(name, grade, text)


@contextlib.contextmanager
def trial(
    role: str, command: Sequence[str], places: int, layout: Layout = SHIPPED
) -> Iterator[Trial]:
    """Give a trial in a ROS domain of its own."""
    with contextlib.ExitStack() as stack:
        domain = Domain()
        stack.callback(domain.release)
        stack.enter_context(ros_environment(domain.number, any_host=False))
        ensure_log_folder()
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        stack.callback(rclpy.try_shutdown)
        try:
            one = Trial(role, command, places, layout)
        except OSError as error:
            raise UserError(f'{command[0]} cannot be started: {error.strerror}') from error
        stack.callback(one.end)
        yield one
