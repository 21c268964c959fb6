# SPDX-License-Identifier: Apache-2.0
"""Fixtures of the tests across packages."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from harness import Client, Program, run_engine


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., Program]]:
    """Start `python -m MODULE ARGUMENTS` as a user would; killed at the end of the test."""
    programs: list[Program] = []

    def start_program(module: str, *arguments: str, **environment: str) -> Program:
        command = [sys.executable, '-m', module, *arguments]
        program = Program(command, tmp_path / f'program{len(programs)}.log', environment)
        programs.append(program)
        return program

    yield start_program
    for program in programs:
        program.end()


@pytest.fixture
def domain() -> Iterator[int]:
    """A ROS domain that no other twin uses."""
    from waferbot_twin.engines.domain import Domain

    claimed = Domain()
    yield claimed.number
    claimed.release()


@pytest.fixture
def connect() -> Iterator[Callable[[int], Client]]:
    """Give a function that joins a ROS domain as a client."""
    clients: list[Client] = []

    def join(number: int) -> Client:
        clients.append(Client(number))
        return clients[-1]

    yield join
    for client in clients:
        client.end()


@pytest.fixture(scope='session')
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Any]:
    """Give the recording of the 0.5 s step by an engine; each is made once for all tests."""
    made: dict[str, Any] = {}

    def recording_of(engine: str) -> Any:
        if engine not in made:
            made[engine] = run_engine(engine, tmp_path_factory.mktemp('runs') / engine)
        return made[engine]

    return recording_of
