# SPDX-License-Identifier: Apache-2.0
"""What the tests across packages work with: the command, nodes as processes, a client."""

from __future__ import annotations

import contextlib
import ctypes
import io
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest

from waferbot_lockstep.transport import (
    BUILTIN_TRANSPORTS,
    DISCOVERY,
    PROFILES,
    choose_transport,
)

PATIENCE_S = 120.0
"""Wall time after which a test gives up; compiling the model for the first time is part of it."""


ASK_AGAIN_S = 5.0
"""Wall time after which a client sends its request again."""

LONG_PATIENCE_S = 3000.0
"""The same for a command that works for long, as a diagnosis does; 800 s were too few beside others."""


ROS2 = [sys.executable, '-c', 'import sys; from ros2cli.cli import main; sys.exit(main())']
"""`ros2` of this Python: another one may be on the path."""

_LIBC = ctypes.CDLL(None)
_PR_SET_PDEATHSIG = 1  # linux/prctl.h


def _end_with_the_tests() -> None:
    """In a child: be killed when the tests are, which cannot end it any more then."""
    _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


class Program:
    """A process of the twin with its output in a file; whatever it started ends with it."""

    def __init__(self, command: Sequence[str], log: Path, environment: dict[str, str]) -> None:
        self.log = log
        with log.open('wb') as stream:
            self.process = subprocess.Popen(
                list(command),
                stdin=subprocess.DEVNULL,
                stdout=stream,
                stderr=subprocess.STDOUT,
                env={**user_environment(), **environment},
                start_new_session=True,
                preexec_fn=_end_with_the_tests,
            )
        self.children: dict[str, int] = {}

    @property
    def output(self) -> str:
        return self.log.read_text('utf-8', 'replace')

    def find_children(self, count: int) -> dict[str, int]:
        """Wait until `count` nodes have been started; return their process ids by node name."""
        wait_until(lambda: len(self._nodes()) >= count, f'{count} nodes started', self)
        self.children = self._nodes()
        return self.children

    def _nodes(self) -> dict[str, int]:
        nodes = {}
        for pid in children_of(self.process.pid):
            arguments = command_line(pid)
            if '-m' in arguments and '--ros-args' in arguments:
                name = arguments[arguments.index('-m') + 1].removeprefix('waferbot_').split('.')[0]
                for argument in arguments:
                    if argument.startswith('__node:='):
                        name = argument.removeprefix('__node:=')
                nodes[name] = pid
        return nodes

    def wait_for(self, text: str) -> None:
        wait_until(lambda: text in self.output, f'{text!r} in the output', self)

    def wait(self, timeout_s: float = PATIENCE_S) -> int:
        try:
            return self.process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            pytest.fail(f'still running after {timeout_s} s\n{self.output}')

    def signal(self, number: int) -> None:
        self.process.send_signal(number)

    def end(self) -> None:
        """Kill the process and the nodes that it started, each by its own id."""
        pids = {self.process.pid, *self.children.values(), *children_of(self.process.pid)}
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()
        else:
            pids.discard(self.process.pid)
        for pid in pids - {self.process.pid}:
            if is_twin_process(pid):
                os.kill(pid, signal.SIGKILL)


def user_environment() -> dict[str, str]:
    """Return the environment without what the tests' own clients and earlier runs may have set."""
    ours = (DISCOVERY, 'ROS_DOMAIN_ID', PROFILES, BUILTIN_TRANSPORTS)
    return {name: value for name, value in os.environ.items() if name not in ours}


def children_of(pid: int) -> list[int]:
    found = []
    for entry in Path('/proc').iterdir():
        if entry.name.isdigit():
            try:
                fields = (entry / 'stat').read_text().rsplit(')', 1)[1].split()
            except OSError:
                continue
            if int(fields[1]) == pid and fields[0] != 'Z':
                found.append(int(entry.name))
    return found


def command_line(pid: int) -> list[str]:
    try:
        return (Path('/proc') / str(pid) / 'cmdline').read_bytes().decode().split('\0')
    except OSError:
        return []


def is_twin_process(pid: int) -> bool:
    """Tell whether a process id still belongs to a node of the twin (ids are reused)."""
    return any(argument.startswith('waferbot_') for argument in command_line(pid))


def wait_until(
    done: Callable[[], Any],
    what: str,
    program: Program | None = None,
    timeout_s: float = PATIENCE_S,
) -> None:
    deadline_s = time.monotonic() + timeout_s
    while not done():
        if program is not None and program.process.poll() is not None and not done():
            pytest.fail(f'ended with {program.process.returncode} before {what}\n{program.output}')
        if time.monotonic() > deadline_s:
            pytest.fail(f'not within {timeout_s} s: {what}\n{program.output if program else ""}')
        time.sleep(0.02)


def waferbot(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run one command of waferbot to its end, as a user would."""
    return _run(arguments, environment, PATIENCE_S)


def output_of(*arguments: Any) -> str:
    """Return what one command of waferbot prints, which must succeed; it may take its time."""
    done = patiently(*arguments)
    assert done.returncode == 0, done.stderr
    return done.stdout


def patiently(*arguments: Any) -> subprocess.CompletedProcess[str]:
    """Run one command of waferbot that may take its time."""
    return _run([str(word) for word in arguments], {}, LONG_PATIENCE_S)


def called(*arguments: Any) -> subprocess.CompletedProcess[str]:
    """
    Run one command of waferbot in this process, and return what a process of its own would give.

    It saves the start of a Python. Where the process is the point (signals, the environment, nodes
    over ROS, what is printed before the command is known), use `waferbot`.
    """
    from waferbot_twin.cli.main import main

    words = [str(word) for word in arguments]
    told, said = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(told), contextlib.redirect_stderr(said):
        try:
            code = main(words)
        except SystemExit as ended:  # of argparse
            code = int(ended.code or 0)
    return subprocess.CompletedProcess(words, code, told.getvalue(), said.getvalue())


def _run(
    arguments: Sequence[str], environment: dict[str, str], patience_s: float
) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, '-m', 'waferbot_twin', *arguments],
        capture_output=True,
        text=True,
        timeout=patience_s,
        env={**user_environment(), **environment},
        stdin=subprocess.DEVNULL,
    )


def parameter_files(node: str) -> list[str]:
    """Return the options of a node started by hand: package settings first, the model second."""
    from waferbot_twin.models import base_files, models_folder

    files = [*base_files(), models_folder() / 'rigid.yaml']
    return [word for file in files for word in ('--params-file', str(file))]


def start_node(
    start: Callable[..., Program], node: str, domain: int, *arguments: str, name: str = ''
) -> Program:
    """Start one node by hand in a ROS domain, with parameters as `key:=value`."""
    options = ['--ros-args', *parameter_files(node)]
    if name:
        options += ['--remap', f'__node:={name}']
    for argument in arguments:
        options += ['-p', argument]
    return start(f'waferbot_{node}.node', *options, ROS_DOMAIN_ID=str(domain))


class Client:
    """A ROS 2 node that knows rclpy and the messages, and nothing else of waferbot."""

    def __init__(self, domain: int, name: str = 'test_client') -> None:
        import rclpy
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.node import Node

        choose_transport()
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = Node(name, context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)

    def spin_until(
        self, done: Callable[[], Any], what: str, timeout_s: float = PATIENCE_S
    ) -> None:
        deadline_s = time.monotonic() + timeout_s
        while not done():
            if time.monotonic() > deadline_s:
                pytest.fail(f'not within {timeout_s} s: {what}')
            self.executor.spin_once(timeout_sec=0.05)

    def answer(self, ask: Callable[[], Any], what: str) -> Any:
        """
        Ask until there is an answer, and return it.

        A client sees a server before the server has discovered who is to have the answer, and then
        the answer is lost (rmw_fastrtps: "client will not receive response").
        """
        futures: list[Any] = []
        begun_s = time.monotonic()

        def answered() -> bool:
            if time.monotonic() >= begun_s + ASK_AGAIN_S * len(futures):
                futures.append(ask())
            return any(future.done() for future in futures)

        self.spin_until(answered, what)
        return next(future.result() for future in futures if future.done())

    def run_experiment(self, actions: Any, experiment: str, feedback: Any = None) -> Any:
        """Have an experiment run by the action, and return the handle of its accepted goal."""
        from waferbot_msgs.action import RunExperiment

        self.spin_until(actions.server_is_ready, 'action server')
        goal = RunExperiment.Goal(experiment=experiment)
        return self.answer(
            lambda: actions.send_goal_async(goal, feedback_callback=feedback),
            f'answer to the goal {experiment[:40]}',
        )

    def result_of(self, handle: Any) -> Any:
        """Wait for the result of an accepted goal."""
        assert handle.accepted
        return self.answer(handle.get_result_async, 'result')

    def call(self, service_type: Any, name: str, request: Any) -> Any:
        """Call a service and return its response."""
        client = self.node.create_client(service_type, name)
        self.spin_until(client.service_is_ready, f'service {name}')
        response = self.answer(lambda: client.call_async(request), f'response of {name}')
        self.node.destroy_client(client)
        return response

    def end(self) -> None:
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()


def domain_of(program: Program) -> int:
    """Return the ROS domain that `waferbot run` tells the user at its start."""
    program.wait_for('ROS_DOMAIN_ID=')
    return int(program.output.split('ROS_DOMAIN_ID=')[1].split()[0])


def run_engine(engine: str, out: Path, experiment: str = 'step', **options: Any) -> Any:
    """Run an experiment for `duration_s` and return what was recorded."""
    from waferbot_twin.engines import inprocess, ros
    from waferbot_twin.plan import make_plan
    from waferbot_twin.recording.reader import read_recording

    model = options.pop('model', 'rigid')
    plan = make_plan(model, experiment, options.pop('duration_s', None))
    if engine == 'inprocess':
        inprocess.run(plan, out, False, lambda done, total: None)
    else:
        settings = ros.RosOptions(composed=engine == 'composed', **options)
        ros.run(plan, out, False, lambda done, total: None, settings)
    return read_recording(out)
