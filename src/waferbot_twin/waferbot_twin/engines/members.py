# SPDX-License-Identifier: Apache-2.0
"""The nodes of a twin, wherever they run: in processes of their own, or in the runner's."""

from __future__ import annotations

import ctypes
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml
from rclpy.parameter import Parameter as RosParameter

from waferbot_lockstep.exchange import Exchange
from waferbot_lockstep.node import LockstepNode
from waferbot_twin.engines.layout import NodeLayout

END_TIMEOUT_S = 5.0
"""Wall time for nodes to end by themselves after the run, or after one of them has gone."""


class Members:
    """The nodes of a twin, wherever they run."""

    names: list[str]

    def begin(self, executor: Any) -> None:
        """Start the nodes."""
        raise NotImplementedError

    def leave(self, executor: Any) -> None:
        """Take composed nodes out of the executor."""

    def running(self) -> list[str]:
        """Return the names of the nodes that have not ended."""
        raise NotImplementedError

    def dismiss(self) -> None:
        """Let nodes go that still stay in case that somebody has missed a message."""

    def failure(self) -> str:
        """Return what went wrong with one of the nodes, or ''."""
        raise NotImplementedError

    def killed(self) -> dict[str, str]:
        """Return how nodes were killed from outside, by their names."""
        return {}

    def state(self) -> str:
        """Return where each node stands, for messages."""
        raise NotImplementedError

    def end(self) -> None:
        """End whatever still runs, and clean up."""
        raise NotImplementedError


class SeparateProcesses(Members):
    """Each node a process of its own, started as `python -m <package>.node`."""

    def __init__(
        self,
        nodes: Mapping[str, NodeLayout],
        on_processes: Callable[[Mapping[str, int]], None] | None = None,
    ) -> None:
        """Take the nodes by name, in the order in which they are to be started."""
        self._folder = tempfile.TemporaryDirectory(prefix='waferbot-')
        self._nodes = nodes
        self.names = list(nodes)
        self._processes: dict[str, subprocess.Popen[bytes]] = {}
        self._on_processes = on_processes

    def begin(self, executor: Any) -> None:
        """Start the nodes."""
        for name, (node, parameters) in self._nodes.items():
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

    def running(self) -> list[str]:
        """Return the names of the nodes that have not ended."""
        return [name for name, process in self._processes.items() if process.poll() is None]

    def dismiss(self) -> None:
        """Let nodes go that still stay in case that somebody has missed a message."""
        for process in self._processes.values():
            if process.poll() is None:
                process.send_signal(signal.SIGINT)

    def failure(self) -> str:
        """Return what went wrong with one of the nodes, or ''."""
        killed = [f'{name} {how}' for name, how in self.killed().items()]
        ended = [
            f'{name} ended with exit code {code}'
            for name, process in self._processes.items()
            if (code := process.poll())
        ]
        return next(iter([*killed, *ended]), '')

    def killed(self) -> dict[str, str]:
        """Return how nodes were killed from outside, by their names."""
        return {
            name: f'was killed by signal {-code}'
            for name, process in self._processes.items()
            if (code := process.poll()) is not None and code < 0
        }

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
    """Nodes in this process, on the recorder's executor, with one exchange or by topics only."""

    def __init__(self, nodes: Mapping[str, NodeLayout], exchange: Exchange | None) -> None:
        """Make the nodes by name, in the order in which they are to be started."""
        from waferbot_copley.node import CopleyNode
        from waferbot_plant.node import PlantNode
        from waferbot_pmac.node import PmacNode

        classes = {'plant': PlantNode, 'pmac': PmacNode, 'copley': CopleyNode}
        self.names = list(nodes)
        self._nodes: dict[str, LockstepNode] = {
            name: classes[node](
                exchange=exchange,
                parameter_overrides=list(ros_parameters(parameters)),
                cli_args=['--ros-args', '--remap', f'__node:={name}'],
            )
            for name, (node, parameters) in nodes.items()
        }

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

    def running(self) -> list[str]:
        """Return the names of the nodes that have not ended."""
        return [name for name, node in self._nodes.items() if node.outcome is None]

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


class Together(Members):
    """Several kinds of members as one."""

    def __init__(self, *parts: Members) -> None:
        """Take them in the order in which they are to be started."""
        self._parts = parts
        self.names = [name for part in parts for name in part.names]

    def begin(self, executor: Any) -> None:
        """Start the nodes."""
        for part in self._parts:
            part.begin(executor)

    def leave(self, executor: Any) -> None:
        """Take composed nodes out of the executor."""
        for part in self._parts:
            part.leave(executor)

    def running(self) -> list[str]:
        """Return the names of the nodes that have not ended."""
        return [name for part in self._parts for name in part.running()]

    def dismiss(self) -> None:
        """Let nodes go that still stay in case that somebody has missed a message."""
        for part in self._parts:
            part.dismiss()

    def failure(self) -> str:
        """Return what went wrong with one of the nodes, or ''."""
        return next((failure for part in self._parts if (failure := part.failure())), '')

    def killed(self) -> dict[str, str]:
        """Return how nodes were killed from outside, by their names."""
        return {name: how for part in self._parts for name, how in part.killed().items()}

    def state(self) -> str:
        """Return where each node stands, for messages."""
        return ', '.join(state for part in self._parts if (state := part.state()))

    def end(self) -> None:
        """End whatever still runs, and clean up."""
        for part in self._parts:
            part.end()


def ros_parameters(parameters: Mapping[str, Any], prefix: str = '') -> Iterator[RosParameter]:
    """Yield nested parameters under their dotted names, as ROS reads them from a file."""
    for name, value in parameters.items():
        if isinstance(value, Mapping):
            yield from ros_parameters(value, f'{prefix}{name}.')
        else:
            yield RosParameter(f'{prefix}{name}', value=value)


def _die_with_parent() -> None:
    """Have the kernel end this child if the runner is killed, so that no node is left behind."""
    if sys.platform == 'linux':
        set_death_signal = 1  # PR_SET_PDEATHSIG of <sys/prctl.h>
        ctypes.CDLL(None).prctl(set_death_signal, signal.SIGKILL)
