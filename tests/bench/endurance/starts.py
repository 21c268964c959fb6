# SPDX-License-Identifier: Apache-2.0
"""Starts in real time: plant, PMAC and Copley in any order, each up to 2 s behind the one before."""

from __future__ import annotations

import random
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from harness import Program, start_node

from endurance.watching import Onlooker, ended, interrupted
from waferbot_twin.engines.domain import Domain

NODES = ('plant', 'pmac', 'copley')
LONGEST_DELAY_S = 2.0
FAR_ENOUGH = 1500
"""Ticks: nobody who has missed something at the start comes that far."""
WITHIN_S = 60.0


def starter(folder: Path) -> Callable[..., Program]:
    """Return what starts `python -m MODULE ARGUMENTS` with its output in a folder."""

    def start(module: str, *arguments: str, **environment: str) -> Program:
        command = [sys.executable, '-m', module, *arguments]
        return Program(command, folder / f'{module}.log', environment)

    return start


def one_start(rng: random.Random, folder: Path) -> dict[str, Any]:
    """
    Start all three, wait until every topic is beyond `FAR_ENOUGH`, end them by SIGINT.

    `ok`: they came that far, none had ended by then, and all ended with exit code 0.
    """
    order = rng.sample(NODES, len(NODES))
    delays_s = [0.0, rng.uniform(0.0, LONGEST_DELAY_S), rng.uniform(0.0, LONGEST_DELAY_S)]
    domain = Domain()
    nodes: dict[str, Program] = {}
    seen = Onlooker(domain.number)
    try:
        for name, delay_s in zip(order, delays_s, strict=True):
            time.sleep(delay_s)
            nodes[name] = start_node(starter(folder), name, domain.number, 'timekeeping:=realtime')
        begun_s = time.monotonic()
        came = seen.wait(lambda: min(seen.tick.values()) > FAR_ENOUGH, WITHIN_S)
        took_s = time.monotonic() - begun_s
        troubles = ended(nodes)
        codes = interrupted(nodes)
    finally:
        seen.end()
        for program in nodes.values():
            program.end()
        domain.release()
    return {
        'ok': came and not troubles and not any(codes.values()),
        'order': order,
        'delays [s]': [round(delay_s, 3) for delay_s in delays_s],
        'ticks': seen.tick,
        'wall time behind the last start [s]': round(took_s, 2),
        'exit codes': codes,
        'ended': troubles,
    }
