# SPDX-License-Identifier: Apache-2.0
"""Plant and Copley in real time with a foreign controller that loses and delays its commands."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

from harness import Program, start_node

from endurance.starts import starter
from endurance.watching import Onlooker, ended, interrupted
from waferbot_copley.faults import NAMES
from waferbot_twin.engines.domain import Domain

CONTROLLER = Path(__file__).resolve().parents[2] / 'lossy_pmac.py'
COUNTS = ('received', 'missed', 'late', 'early', 'doubled', 'contradicting', 'behind [ticks]')
CAUSES = tuple(NAMES.values())
FURTHEST_COUNTS = 20_000
START_S = 60.0
SETTLE_S = 5.0
"""Wall time for the last command to arrive and to be told: diagnostics come once a second."""


def losses(seconds: float, seed: int, folder: Path) -> dict[str, Any]:
    """
    Run for `seconds` of wall time; compare what Copley has counted with what was done to it.

    With D servo cycles to which no command was sent, S commands sent, and V of those sent after a
    later one, the amplifiers must say, to the message,

        missed = D        received = S        late >= V - early        contradicting = 0

    A command may come early, by a busy network or receiver, and is held back: then it may be
    overtaken without anybody's noticing.
    `ok`: they do, all three processes still run, no amplifier has found a fault, and no axis has gone
    further than `FURTHEST_COUNTS` from where it is held.
    """
    domain = Domain()
    start = starter(folder)
    nodes: dict[str, Program] = {}
    seen = Onlooker(domain.number, ('encoders',))
    try:
        for name in ('plant', 'copley'):
            nodes[name] = start_node(start, name, domain.number, 'timekeeping:=realtime')
        nodes['pmac'] = Program(
            [sys.executable, str(CONTROLLER), '--seconds', str(seconds), '--seed', str(seed)],
            folder / 'pmac.log',
            {'ROS_DOMAIN_ID': str(domain.number), 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'},
        )
        controller = nodes['pmac']
        begun = seen.wait(lambda: seen.tick['encoders'] > 0, START_S)
        begun_s = time.monotonic()
        first_fault: dict[str, Any] = {}

        def over() -> bool:
            status = seen.statuses.get('copley')
            if not first_fault and status and any(one in status.message for one in CAUSES):
                first_fault['wall time [s]'] = round(time.monotonic() - begun_s, 1)
                first_fault['tick'], first_fault['said'] = seen.tick['encoders'], status.message
            return '\n' in controller.output or bool(ended(nodes))

        heard = seen.wait(over, seconds + START_S)
        took_s = time.monotonic() - begun_s
        troubles = ended(nodes)
        seen.wait(lambda: False, SETTLE_S)
        told = {name: seen.told('copley', f'current_command {name}') for name in COUNTS}
        said = seen.statuses['copley'].message if 'copley' in seen.statuses else ''
        done = json.loads(controller.output.splitlines()[0]) if heard and not troubles else {}
        codes = interrupted(nodes)
    finally:
        seen.end()
        for program in nodes.values():
            program.end()
        domain.release()
    ticks = done.get('last tick', 0)
    return {
        'ok': begun
        and bool(done)
        and not troubles
        and _agree(done, told)
        and not any(cause in said for cause in CAUSES)
        and done['largest deviation'] < FURTHEST_COUNTS,
        'done': done,
        'told': told,
        'said': said,
        'first fault': first_fault,
        'wall time [s]': round(took_s, 1),
        'x real time': round(ticks / 18000.0 / took_s, 3),
        'exit codes': codes,
        'ended': troubles,
    }


def _agree(done: dict[str, float], told: dict[str, float | None]) -> bool:
    """Compare to the message."""
    late, early = told['late'], told['early']
    return (
        told['missed'] == done['dropped'] + done['unanswered']
        and told['received'] == done['sent']
        and late is not None
        and early is not None
        and late >= done['overtaken'] - early
        and told['contradicting'] == 0
    )
