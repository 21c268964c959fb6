# SPDX-License-Identifier: Apache-2.0
"""
The twin over ROS 2: separate processes, or composed into one.

In both, the nodes, topics and messages are the same; composed, all nodes share one process and one
executor, which saves the way between processes. The runner is one more participant: it records, lets
the plant go as soon as every topic has been heard at tick 0, and watches over the end.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import rclpy
import yaml
from rclpy.parameter import Parameter as RosParameter
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import SetBool

from waferbot_lockstep.contract import (
    AXES,
    RECORDER_WINDOW,
)
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.interrupt import Interrupt
from waferbot_lockstep.node import (
    FAREWELL_S,
    SIGN_OF_LIFE_PERIOD_S,
    LockstepNode,
    make_executor,
)
from waferbot_lockstep.ros_logs import ensure_log_folder
from waferbot_twin.engines.domain import Domain, check_loopback
from waferbot_twin.models import NODES
from waferbot_twin.plan import Outcome, Plan
from waferbot_twin.recording.completeness import close_complete, reported
from waferbot_twin.recording.recorder import Recorder
from waferbot_twin.recording.writer import RecordingWriter

STARTUP_TIMEOUT_S = 60.0
"""
Wall time for nodes to start and find each other, if the user does not say; compiling the model is part
of it, and so is the time that it takes to start one's own node by hand.
"""

END_TIMEOUT_S = 5.0
"""Wall time for nodes to end by themselves after the run, or after one of them has gone."""

LAST_WORDS_S = 1.0
"""Wall time for the reason of a stop to arrive once every node has ended."""

DRAIN_TIMEOUT_S = 5.0

Progress = Callable[[int, int], None]


@dataclass
class RosOptions:
    """How to lay the twin out over ROS."""

    composed: bool = False
    one_copley_per_axis: bool = False
    without: Sequence[str] = ()  # nodes that somebody else provides
    start_order: Sequence[str] = ()  # names of the processes, in the order to start them
    startup_timeout_s: float = STARTUP_TIMEOUT_S
    domain: int | None = None
    any_host: bool = False
    overrides: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    on_domain: Callable[[int], None] | None = None
    on_processes: Callable[[Mapping[str, int]], None] | None = None


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
    _check_names(options)
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
        recorder = Recorder(
            writer,
            plan.timing,
            reported(options.without),
            clock_needed='plant' not in options.without,
        )
        stack.callback(recorder.destroy_node)
        members: Members = (
            ComposedNodes(plan, options) if options.composed else SeparateProcesses(plan, options)
        )
        stack.callback(members.end)
        try:
            loop_s = _Conductor(
                plan, recorder, members, interrupt, progress, options.startup_timeout_s
            ).run()
        except UserError as error:
            raise recorder.failures.with_this(error) from None
        failure = recorder.failures.reason()
        return Outcome(close_complete(writer, recorder.account, plan.ticks, failure), loop_s)


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
            ended_by_s = time.monotonic() + 2 * FAREWELL_S
            self._spin_until(
                lambda: not self._members.alive() or time.monotonic() > ended_by_s, None, 'run'
            )
            self._members.dismiss()
            self._spin_until(lambda: not self._members.alive(), None, 'run')
            return loop_s
        finally:
            self._executor.remove_node(self._recorder)
            self._members.leave(self._executor)
            self._executor.shutdown(0.0)

    def _everything_recorded(self) -> bool:
        return not any(self._recorder.account.missing(self._plan.ticks).values())

    def _let_go(self) -> None:
        """Tell the plant, paused at tick 0, to go on."""
        if 'plant' not in self._members.names:
            return  # somebody else's plant goes when it likes
        if not self._release.service_is_ready():
            self._spin_until(self._release.service_is_ready, self._startup_timeout_s, 'start')
        future = self._release.call_async(SetBool.Request(data=False))
        self._spin_until(future.done, END_TIMEOUT_S, 'start')

    def _spin_until(self, done: Callable[[], bool], timeout_s: float | None, phase: str) -> None:
        deadline_s = time.monotonic() + timeout_s if timeout_s else None
        reported_s = 0.0
        grace_until_s: float | None = None
        all_ended_s: float | None = None
        checks = 0
        while True:
            self._executor.spin_once(timeout_sec=SIGN_OF_LIFE_PERIOD_S)
            checks += 1
            now_s = time.monotonic()
            if checks % 64 and now_s - reported_s < 0.05:
                continue  # looking at everything below after each message would cost more than it
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
            if failure or (not self._members.alive() and phase == 'run'):
                # Give the others the time to find out for themselves and the recorder to drain.
                if grace_until_s is None:
                    grace_until_s = now_s + (END_TIMEOUT_S if failure else DRAIN_TIMEOUT_S)
                if failure and all_ended_s is None and not self._members.alive():
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
        """Return why the twin ends: who was killed, and what the others say."""
        reasons = [self._members.killed(), self._recorder.stop_reason]
        return '; '.join(reason for reason in reasons if reason) or otherwise

    def _state(self) -> str:
        """Return who has not been heard yet, and where each node stands."""
        unheard = [
            f'{publisher} has not published {", ".join(topics)}'
            for publisher, topics in self._recorder.account.unheard().items()
        ]
        return '; '.join([*unheard, self._members.state() or 'no node of this run'])


class Members:
    """The nodes of a twin, wherever they run."""

    names: list[str]

    def begin(self, executor: Any) -> None:
        """Start the nodes."""
        raise NotImplementedError

    def leave(self, executor: Any) -> None:
        """Take composed nodes out of the executor."""

    def alive(self) -> bool:
        """Tell whether any node is still running."""
        raise NotImplementedError

    def dismiss(self) -> None:
        """Let nodes go that still stay in case that somebody has missed a message."""

    def failure(self) -> str:
        """Return what went wrong with one of the nodes, or ''."""
        raise NotImplementedError

    def killed(self) -> str:
        """Return which nodes were killed from outside, or ''."""
        return ''

    def state(self) -> str:
        """Return where each node stands, for messages."""
        raise NotImplementedError

    def end(self) -> None:
        """End whatever still runs, and clean up."""
        raise NotImplementedError


class SeparateProcesses(Members):
    """Each node a process of its own, started as `python -m <package>.node`."""

    def __init__(self, plan: Plan, options: RosOptions) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix='waferbot-')
        self._commands = dict(_layout(plan, options))
        self.names = list(self._commands)
        self._order = list(options.start_order) or self.names
        if sorted(self._order) != sorted(self.names):
            raise UserError(f'start order {self._order} does not name {self.names}')
        self._processes: dict[str, subprocess.Popen[bytes]] = {}
        self._on_processes = options.on_processes

    def begin(self, executor: Any) -> None:
        """Start the nodes."""
        for name in self._order:
            node, parameters = self._commands[name]
            self._processes[name] = self._start(name, node, parameters)
        if self._on_processes:
            self._on_processes({name: process.pid for name, process in self._processes.items()})

    def _start(self, name: str, node: str, parameters: Mapping[str, Any]) -> Any:
        file = Path(self._folder.name) / f'{name}.yaml'
        file.write_text(yaml.safe_dump({'/**': {'ros__parameters': dict(parameters)}}), 'utf-8')
        command = [sys.executable, '-m', f'waferbot_{node}.node', '--ros-args']
        command += ['--params-file', str(file)]
        if name != node:
            command += ['--remap', f'__node:={name}']
        # A session of its own: Ctrl-C reaches the runner only, which ends the nodes in order.
        return subprocess.Popen(
            command, stdin=subprocess.DEVNULL, start_new_session=True, preexec_fn=_die_with_parent
        )

    def alive(self) -> bool:
        """Tell whether any node is still running."""
        return any(process.poll() is None for process in self._processes.values())

    def dismiss(self) -> None:
        """Let nodes go that still stay in case that somebody has missed a message."""
        for process in self._processes.values():
            if process.poll() is None:
                process.send_signal(signal.SIGINT)

    def failure(self) -> str:
        """Return what went wrong with one of the nodes, or ''."""
        for name, process in self._processes.items():
            if process.poll():
                return self.killed() or f'{name} ended with exit code {process.poll()}'
        return ''

    def killed(self) -> str:
        """Return which nodes were killed from outside, or ''."""
        return ', '.join(
            f'{name} was killed by signal {-code}'
            for name, process in self._processes.items()
            if (code := process.poll()) is not None and code < 0
        )

    def state(self) -> str:
        """Return where each node stands, for messages."""
        return ', '.join(
            f'{name} {"runs" if process.poll() is None else "has ended"}'
            for name, process in self._processes.items()
        )

    def end(self) -> None:
        """End whatever still runs, and clean up."""
        self.dismiss()
        deadline_s = time.monotonic() + END_TIMEOUT_S
        for process in self._processes.values():
            try:
                process.wait(max(0.0, deadline_s - time.monotonic()))
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        self._folder.cleanup()


class ComposedNodes(Members):
    """All nodes in this process, on the recorder's executor."""

    def __init__(self, plan: Plan, options: RosOptions) -> None:
        from waferbot_copley.node import CopleyNode
        from waferbot_plant.node import PlantNode
        from waferbot_pmac.node import PmacNode

        classes = {'plant': PlantNode, 'pmac': PmacNode, 'copley': CopleyNode}
        layout = dict(_layout(plan, options))
        self.names = list(layout)
        self._nodes: dict[str, LockstepNode] = {}
        for name in options.start_order or self.names:
            node, parameters = layout[name]
            self._nodes[name] = classes[node](
                parameter_overrides=list(_overrides(parameters)),
                cli_args=['--ros-args', '--remap', f'__node:={name}'],
            )

    def begin(self, executor: Any) -> None:
        """Start the nodes."""
        for node in self._nodes.values():
            executor.add_node(node)
        for node in self._nodes.values():
            node.begin()

    def leave(self, executor: Any) -> None:
        """Take composed nodes out of the executor."""
        for node in self._nodes.values():
            executor.remove_node(node)

    def alive(self) -> bool:
        """Tell whether any node is still running."""
        return any(node.outcome is None for node in self._nodes.values())

    def failure(self) -> str:
        """Return what went wrong with one of the nodes, or ''."""
        for name, node in self._nodes.items():
            if node.outcome:
                return f'{name}: {node.outcome}'
        return ''

    def state(self) -> str:
        """Return where each node stands, for messages."""
        return ', '.join(f'{name} at tick {node.tick}' for name, node in self._nodes.items())

    def end(self) -> None:
        """End whatever still runs, and clean up."""
        for node in self._nodes.values():
            node.interrupt()
            node.destroy_node()


def _layout(plan: Plan, options: RosOptions) -> Iterator[tuple[str, tuple[str, dict[str, Any]]]]:
    """Yield name, kind and parameters of each node that this run starts."""
    timing = {
        'current_loop_hz': plan.timing.current_loop_hz,
        'encoder_divider': plan.timing.encoder_divider,
        'servo_divider': plan.timing.servo_divider,
        'end_tick': plan.ticks,
        'startup_timeout_s': options.startup_timeout_s,
    }
    extra: dict[str, dict[str, Any]] = {
        'plant': {'start_paused': True, 'recorder_window': RECORDER_WINDOW},
        'pmac': {'experiment': plan.experiment.text},
        'copley': {},
    }
    for node, own in extra.items():
        if node in options.without:
            continue
        parameters = {**timing, **plan.model.parameters[node], **own}
        if node == 'copley' and options.one_copley_per_axis:
            for axis in AXES:
                name = f'copley_{axis}'
                if name in options.without:
                    continue
                mine = {key: value for key, value in parameters.items() if key not in AXES}
                mine[axis] = parameters.get(axis, {})
                yield name, (node, {**mine, 'axes': [axis], **options.overrides.get(name, {})})
        else:
            yield node, (node, {**parameters, **options.overrides.get(node, {})})


def _check_names(options: RosOptions) -> None:
    """Refuse to leave out a node that this twin does not have."""
    copleys = [f'copley_{axis}' for axis in AXES] if options.one_copley_per_axis else []
    known = [*NODES, *copleys]
    for name in options.without:
        if name not in known:
            hint = ' (with --copley-per-axis)' if name.startswith('copley_') else ''
            raise UserError(
                f'--without {name}: the twin has no such node{hint}; it has {", ".join(known)}'
            )


def _overrides(parameters: Mapping[str, Any], prefix: str = '') -> Iterator[RosParameter]:
    """Yield nested parameters under their dotted names, as ROS reads them from a file."""
    for name, value in parameters.items():
        if isinstance(value, Mapping):
            yield from _overrides(value, f'{prefix}{name}.')
        else:
            yield RosParameter(f'{prefix}{name}', value=value)


@contextlib.contextmanager
def ros_environment(domain: int, any_host: bool) -> Iterator[None]:
    """Set what decides whom ROS talks to, for this process and its children; restore it after."""
    # Discovery stays on this machine unless the user asks for more.
    wanted = {
        'ROS_DOMAIN_ID': str(domain),
        'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SUBNET' if any_host else 'LOCALHOST',
    }
    before = {name: os.environ.get(name) for name in wanted}
    os.environ.update(wanted)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _die_with_parent() -> None:
    """Have the kernel end this child if the runner is killed, so that no node is left behind."""
    if sys.platform == 'linux':
        set_death_signal = 1  # PR_SET_PDEATHSIG of <sys/prctl.h>
        ctypes.CDLL(None).prctl(set_death_signal, signal.SIGKILL)
