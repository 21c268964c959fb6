# SPDX-License-Identifier: Apache-2.0
"""What an onlooker sees of a twin: the newest tick of each topic, and the diagnostics."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from harness import Client, Program

from waferbot_msgs.msg import CurrentCommand, Encoders, PhaseVoltages

TOPICS = {
    'encoders': Encoders,
    'current_command': CurrentCommand,
    'phase_voltages': PhaseVoltages,
}


class Onlooker:
    """Hears the last message of each topic of a domain, and takes part in nothing."""

    def __init__(self, domain: int, topics: tuple[str, ...] = tuple(TOPICS)) -> None:
        self.tick = dict.fromkeys(topics, -1)
        self.statuses: dict[str, DiagnosticStatus] = {}
        self._client = Client(domain)
        for name in topics:
            self._client.node.create_subscription(TOPICS[name], name, self._noting(name), 1)
        self._client.node.create_subscription(
            DiagnosticArray, '/diagnostics', self._on_diagnostics, 10
        )

    def _noting(self, name: str) -> Callable[[Encoders | CurrentCommand | PhaseVoltages], None]:
        return lambda message: self.tick.update({name: message.tick})

    def _on_diagnostics(self, array: DiagnosticArray) -> None:
        for status in array.status:
            self.statuses[status.name.split(':')[0].strip('/')] = status

    def wait(self, done: Callable[[], bool], seconds: float) -> bool:
        """Look until something is so; return whether it was within `seconds` of wall time."""
        deadline_s = time.monotonic() + seconds
        while not done():
            if time.monotonic() > deadline_s:
                return False
            self._client.executor.spin_once(timeout_sec=0.02)
        return True

    def told(self, node: str, key: str) -> float | None:
        """Return a number of a node's diagnostics, or None if it has not told it."""
        status = self.statuses.get(node)
        values = {value.key: value.value for value in status.values} if status else {}
        return float(values[key]) if values.get(key) else None

    def end(self) -> None:
        self._client.end()


def ended(programs: dict[str, Program]) -> dict[str, str]:
    """Return the end of the output of the programs that do not run any more, by their names."""
    return {
        name: f'exit code {program.process.poll()}: {program.output[-500:]}'
        for name, program in programs.items()
        if program.process.poll() is not None
    }


def interrupted(programs: dict[str, Program]) -> dict[str, int]:
    """End programs by SIGINT; return their exit codes, by their names."""
    for program in programs.values():
        program.signal(signal.SIGINT)
    return {name: program.wait(20.0) for name, program in programs.items()}
