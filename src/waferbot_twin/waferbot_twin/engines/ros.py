# SPDX-License-Identifier: Apache-2.0
"""
The twin over ROS 2: separate processes, or some or all nodes composed into the runner's.

In all of them the nodes, topics and messages are the same, and every message is published on its topic.
How they reach the other nodes of the twin is one of `DELIVERIES`; see `waferbot_lockstep.exchange`. The
runner is one more participant: it records, lets the plant go as soon as every topic has been heard at
tick 0, and watches over the end.
"""

from __future__ import annotations

import contextlib
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import rclpy
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import SetBool

from waferbot_copley.node_settings import RAMP
from waferbot_lockstep.channel import Channel
from waferbot_lockstep.contract import CURRENT_COMMAND, Topic
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.exchange import Exchange
from waferbot_lockstep.interrupt import Interrupt
from waferbot_lockstep.node import FAREWELL_S, SIGN_OF_LIFE_PERIOD_S, make_executor
from waferbot_lockstep.parameters import did_you_mean
from waferbot_lockstep.ros_logs import ensure_log_folder
from waferbot_lockstep.transport import (
    BUILTIN_TRANSPORTS,
    DISCOVERY,
    PROFILES,
    choose_transport,
)
from waferbot_twin.engines.domain import Domain, check_loopback
from waferbot_twin.engines.layout import (
    CHANNEL,
    TOPICS,
    NodeLayout,
    RosOptions,
    check_names,
    given_by,
    layout,
    on_channel,
)
from waferbot_twin.engines.members import (
    END_TIMEOUT_S,
    ComposedNodes,
    Members,
    SeparateProcesses,
    Together,
)
from waferbot_twin.plan import Outcome, Plan
from waferbot_twin.recording.completeness import close_complete, reported
from waferbot_twin.recording.recorder import Recorder
from waferbot_twin.recording.writer import RecordingWriter
from waferbot_twin.validity import Validity

ASK_AGAIN_S = 1.0
"""Wall time after which the plant is asked again to go on."""

LAST_WORDS_S = 1.0
"""Wall time for the reason of a stop to arrive once every node has ended."""

DRAIN_TIMEOUT_S = 5.0

Progress = Callable[[int, int], None]


def run(
    plan: Plan,
    out: Path | None,
    force: bool,
    progress: Progress,
    options: RosOptions | None = None,
) -> Outcome:
    """
    Run a plan over ROS, recording to `out` if given.

    Raises `UserError` with the reason of the node that stopped, if one did, and with that of an axis
    that is not driven any more; the recording up to there is closed and readable.
    """
    options = options or RosOptions()
    layout = plan.model.layout
    check_names(options, layout.axes)
    if not options.composed:
        check_loopback()
    with contextlib.ExitStack() as stack:
        domain = Domain(options.domain)
        stack.callback(domain.release)
        stack.enter_context(ros_environment(domain.number, options.any_host))
        if options.on_domain:
            options.on_domain(domain.number)
        interrupt = stack.enter_context(Interrupt())
        ensure_log_folder()
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        stack.callback(rclpy.try_shutdown)
        engine = 'composed' if options.composed else 'ros'
        writer = None
        if out is not None:
            writer = stack.enter_context(
                RecordingWriter(out, plan.attachments(engine, options.without), force, live=True)
            )
        inside, outside = _split(plan, options)
        channel = None
        if options.delivery == CHANNEL and outside:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix='waferbot-')))
            outside = on_channel(outside, folder, options.without)
            channel = Channel(folder, 'runner')
            stack.callback(channel.close)
        exchange = Exchange(channel, [f'/{name}' for name in given_by(options.without)])
        validity = Validity(plan.model, plan.timing)
        recorder = Recorder(
            writer,
            plan.timing,
            {**reported(options.without, layout), **_commands_needed(options)},
            clock_needed='plant' not in options.without,
            loads_needed=plan.foreign_plant is None,
            exchange=None if options.delivery == TOPICS else exchange,
            validity=validity,
            layout=layout,
        )
        stack.callback(recorder.destroy_node)
        members = Together(
            ComposedNodes(inside, None if options.delivery == TOPICS else exchange),
            SeparateProcesses(outside, options.on_processes),
        )
        stack.callback(members.end)
        recorder.begin()
        try:
            loop_s = _Conductor(
                plan, recorder, members, interrupt, progress, options.startup_timeout_s
            ).run()
        except UserError as error:
            raise recorder.failures.with_this(error) from None
        failure = validity.after(recorder.failures.reason())
        line = close_complete(writer, recorder.account, plan.ticks, failure, validity.told())
        return Outcome(line, loop_s, validity.departures())


def _commands_needed(options: RosOptions) -> dict[Topic, int]:
    """Return that no command is missed where current goes to zero without any."""
    return {CURRENT_COMMAND: 0} if options.device_clock == RAMP else {}


def _split(plan: Plan, options: RosOptions) -> tuple[dict[str, NodeLayout], dict[str, NodeLayout]]:
    """Return the nodes of the runner's own process and those of others, in the order of starting."""
    nodes = dict(layout(plan, options))
    order = list(options.start_order) or list(nodes)
    if sorted(order) != sorted(nodes):
        raise UserError(f'start order {order} does not name {list(nodes)}')
    compose = order if options.composed else options.compose
    for name in compose:
        if name not in nodes:
            raise UserError(
                f'--compose {name}: this run starts {", ".join(nodes) or "no node"}'
                f'{did_you_mean(name, nodes)}'
            )
    inside = {name: nodes[name] for name in order if name in compose}
    return inside, {name: nodes[name] for name in order if name not in compose}


class _Conductor:
    """Spins the recorder (and composed nodes), lets the plant go, and waits for the end."""

    def __init__(
        self,
        plan: Plan,
        recorder: Recorder,
        members: Members,
        interrupt: Interrupt,
        progress: Progress,
        startup_timeout_s: float,
    ) -> None:
        self._plan = plan
        self._startup_timeout_s = startup_timeout_s
        self._recorder = recorder
        self._members = members
        self._interrupt = interrupt
        self._progress = progress
        self._executor = make_executor()
        self._release = recorder.create_client(SetBool, 'plant/pause')

    def run(self) -> float:
        """Run to the end; return the wall time of the loop in seconds."""
        self._executor.add_node(self._recorder)
        self._members.begin(self._executor)
        try:
            self._spin_until(lambda: self._recorder.begun, self._startup_timeout_s, 'start')
            self._let_go()
            begun_s = time.perf_counter()
            self._spin_until(self._everything_recorded, None, 'run')
            loop_s = time.perf_counter() - begun_s
            self._spin_until_ended(2 * FAREWELL_S)
            self._members.dismiss()
            self._spin_until_ended(END_TIMEOUT_S)
            for name in self._members.running():
                self._recorder.get_logger().warning(
                    f'{name} has not ended {END_TIMEOUT_S:g} s after it was asked to, it is killed; '
                    'nothing of the run is lost'
                )
            return loop_s
        finally:
            self._executor.remove_node(self._recorder)
            self._members.leave(self._executor)
            self._executor.shutdown(0.0)

    def _spin_until_ended(self, timeout_s: float) -> None:
        ended_by_s = time.monotonic() + timeout_s
        self._spin_until(
            lambda: not self._members.running() or time.monotonic() > ended_by_s, None, 'run'
        )

    def _everything_recorded(self) -> bool:
        return not any(self._recorder.account.missing(self._plan.ticks).values())

    def _let_go(self) -> None:
        """Tell the plant, paused at tick 0, to go on."""
        if 'plant' not in self._members.names:
            return  # somebody else's plant goes when it likes
        if not self._release.service_is_ready():
            self._spin_until(self._release.service_is_ready, self._startup_timeout_s, 'start')
        request = SetBool.Request(data=False)
        sent = [self._release.call_async(request)]

        def answered() -> bool:
            # An answer is lost if the plant has not yet discovered who is to have it: ask again.
            if time.monotonic() > asked_s + ASK_AGAIN_S * len(sent):
                sent.append(self._release.call_async(request))
            return any(future.done() for future in sent)

        asked_s = time.monotonic()
        self._spin_until(answered, self._startup_timeout_s, 'start')

    def _spin_until(self, done: Callable[[], bool], timeout_s: float | None, phase: str) -> None:
        deadline_s = time.monotonic() + timeout_s if timeout_s else None
        reported_s = 0.0
        grace_until_s: float | None = None
        all_ended_s: float | None = None
        served = 0
        while True:
            served += self._recorder.exchange.serve(self._executor, SIGN_OF_LIFE_PERIOD_S)
            now_s = time.monotonic()
            if served < 64 and now_s - reported_s < 0.05:
                continue  # looking at everything below after each message would cost more than it
            served = 0
            if done():
                return
            if now_s - reported_s >= 0.05:
                reported_s = now_s
                self._progress(max(self._recorder.tick, 0), self._plan.ticks)
            if self._interrupt.raised:
                raise KeyboardInterrupt
            if self._recorder.failure:
                raise UserError(self._recorder.failure)
            failure = self._members.failure()
            if failure or (not self._members.running() and phase == 'run'):
                # Give the others the time to find out for themselves and the recorder to drain.
                if grace_until_s is None:
                    grace_until_s = now_s + (END_TIMEOUT_S if failure else DRAIN_TIMEOUT_S)
                if failure and all_ended_s is None and not self._members.running():
                    all_ended_s = now_s
                if now_s > grace_until_s or (
                    # The reason may still be on its way when the process that sent it has ended.
                    all_ended_s is not None
                    and (self._recorder.stop_reason or now_s > all_ended_s + LAST_WORDS_S)
                ):
                    if failure or self._recorder.stop_reason:
                        raise UserError(self._reason(failure))
                    return  # the completeness check says what is missing
            if deadline_s and now_s > deadline_s:
                what = f'the twin did not {phase} within {timeout_s:g} s: {self._state()}'
                raise UserError(self._reason(what))

    def _reason(self, otherwise: str) -> str:
        """Return why the twin ends: who was killed, what of it never came, what the others say."""
        account = self._recorder.account
        killed = [
            f'{name} {how}: {account.ended(name)}' for name, how in self._members.killed().items()
        ]
        return '; '.join(filter(None, [*killed, self._recorder.stop_reason])) or otherwise

    def _state(self) -> str:
        """Return who has not been heard yet, and where each node stands."""
        unheard = [
            f'{publisher} has not published {", ".join(topics)}'
            for publisher, topics in self._recorder.account.unheard().items()
        ]
        return '; '.join([*unheard, self._members.state() or 'no node of this run'])


@contextlib.contextmanager
def ros_environment(domain: int, any_host: bool) -> Iterator[None]:
    """Set what decides whom ROS talks to, for this process and its children; restore it after."""
    wanted = {'ROS_DOMAIN_ID': str(domain), DISCOVERY: 'SUBNET' if any_host else 'LOCALHOST'}
    before = {name: os.environ.get(name) for name in (*wanted, PROFILES, BUILTIN_TRANSPORTS)}
    os.environ.update(wanted)
    choose_transport()
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
