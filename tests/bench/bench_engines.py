# SPDX-License-Identifier: Apache-2.0
"""
Speed of each engine, layout and delivery beside the raw exchange of the same messages.

One exchange is what a tick of the lock-step has at least: `phase_currents` one way, `phase_voltages`
back, by topics. The raw ping-pong does that and nothing else, with the same bytes and executor, in one
process or two, in the same minute; so the ratio says how the twin does whatever the machine is doing.

Prints a table; writes the same as JSON to bench-results/engines.json.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rich.console import Console
from rich.table import Table

from waferbot_lockstep.node import lockstep_qos, make_executor
from waferbot_lockstep.wire import WireFormat
from waferbot_msgs.msg import PhaseCurrents, PhaseVoltages
from waferbot_twin.cli.console import progress_bar
from waferbot_twin.engines import inprocess, ros
from waferbot_twin.plan import make_plan

PING_PONGS = 20000
WARM_UP = 1000


class Ping(Node):
    """Sends currents, waits for voltages, and so on."""

    def __init__(self, count: int) -> None:
        super().__init__('ping')
        self.count = count
        self.done = 0
        self.begun_s = 0.0
        self.ended_s = 0.0
        self._wire = WireFormat('waferbot_msgs/msg/PhaseCurrents')
        self._decode = WireFormat('waferbot_msgs/msg/PhaseVoltages').decode
        self._publisher = self.create_publisher(PhaseCurrents, 'ping', lockstep_qos())
        self.create_subscription(PhaseVoltages, 'pong', self._on_pong, lockstep_qos(), raw=True)

    def ready(self) -> bool:
        return self._publisher.get_subscription_count() > 0 and self.count_publishers('pong') > 0

    def send(self) -> None:
        self._publisher.publish(self._wire.encode(self.done, 0, 7, (1.0,) * 6))

    def _on_pong(self, data: bytes) -> None:
        if self._decode(data)[0] != self.done:
            return
        self.done += 1
        if self.done == WARM_UP:
            self.begun_s = time.perf_counter()
        if self.done == self.count + WARM_UP:
            self.ended_s = time.perf_counter()
        else:
            self.send()

    def rate(self) -> float:
        return self.count / (self.ended_s - self.begun_s)


class Pong(Node):
    """Answers currents with voltages."""

    def __init__(self) -> None:
        super().__init__('pong')
        self._wire = WireFormat('waferbot_msgs/msg/PhaseVoltages')
        self._decode = WireFormat('waferbot_msgs/msg/PhaseCurrents').decode
        self._publisher = self.create_publisher(PhaseVoltages, 'pong', lockstep_qos())
        self.create_subscription(PhaseCurrents, 'ping', self._on_ping, lockstep_qos(), raw=True)

    def _on_ping(self, data: bytes) -> None:
        tick = self._decode(data)[0]
        self._publisher.publish(self._wire.encode(tick, 0, 7, (*(2.0,) * 9, 0)))


def ping_pong(composed: bool) -> float:
    """Return raw exchanges per second."""
    os.environ['ROS_DOMAIN_ID'] = '41'
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    peer = None
    if not composed:
        peer = subprocess.Popen([sys.executable, __file__, '--pong'])
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    try:
        ping = Ping(PING_PONGS)
        executor = make_executor()
        executor.add_node(ping)
        if composed:
            executor.add_node(Pong())
        deadline_s = time.monotonic() + 30.0
        while not ping.ready():
            executor.spin_once(timeout_sec=0.1)
            if time.monotonic() > deadline_s:
                raise SystemExit('the other end of the ping-pong did not appear')
        time.sleep(1.0)
        ping.send()
        while not ping.ended_s:
            executor.spin_once(timeout_sec=0.1)
        return ping.rate()
    finally:
        rclpy.try_shutdown()
        os.environ.pop('ROS_DOMAIN_ID')
        if peer is not None:
            peer.terminate()
            peer.wait(5)


def pong_forever() -> None:
    """Be the other end, in a process of its own, until told to stop (a minute at most)."""
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    executor = make_executor()
    executor.add_node(Pong())
    end_s = time.monotonic() + 60.0
    while time.monotonic() < end_s:
        executor.spin_once(timeout_sec=0.1)


TWO = ('plant', 'copley')
NOT_RECORDED = 'inprocess, not recorded'
"""The limit of what a recording in one process can reach."""

CASES: dict[str, tuple[str, dict[str, Any], float]] = {
    'three processes, by topics': ('separate', {'delivery': 'topics'}, 0.5),
    'three processes, by channel': ('separate', {'delivery': 'channel'}, 0.5),
    'plant with copley; pmac by topics': ('separate', {'compose': TWO}, 0.5),
    'plant with copley; pmac by channel': (
        'separate',
        {'compose': TWO, 'delivery': 'channel'},
        0.5,
    ),
    'composed, by topics': ('composed', {'composed': True, 'delivery': 'topics'}, 0.5),
    'composed, direct': ('composed', {'composed': True}, 1.0),
    'inprocess': ('', {}, 10.0),
    NOT_RECORDED: ('', {}, 10.0),
}
"""By name: the raw exchange beside it, options of the ROS engine, sim seconds."""


def twin_rates(case: str) -> tuple[float, float]:
    """Return ticks per second of wall time, and per second of this process on all cores."""
    raw, options, seconds = CASES[case]
    plan = make_plan('rigid', 'step', seconds)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / 'run'
        if raw:
            outcome = ros.run(plan, out, False, ignore, ros.RosOptions(**options))
        else:
            begun_s = time.process_time()
            outcome = inprocess.run(plan, None if case == NOT_RECORDED else out, False, ignore)
            return plan.ticks / outcome.loop_s, plan.ticks / (time.process_time() - begun_s)
    return plan.ticks / outcome.loop_s, float('nan')


def ignore(done: int, total: int) -> None:
    """Show no progress."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--pong', action='store_true', help=argparse.SUPPRESS)
    parser.add_argument('--repeat', type=int, default=3, help='rounds; the median is shown')
    options = parser.parse_args()
    if options.pong:
        pong_forever()
        return
    raw: dict[str, list[float]] = {'separate': [], 'composed': []}
    rates: dict[str, list[tuple[float, float]]] = {case: [] for case in CASES}
    done, total = 0, options.repeat * (len(raw) + len(CASES))
    with progress_bar('measuring') as progress:
        for _ in range(options.repeat):
            for kind in raw:
                raw[kind].append(ping_pong(kind == 'composed'))
                done += 1
                progress(done, total)
            for case in CASES:
                rates[case].append(twin_rates(case))
                done += 1
                progress(done, total)
    results = []
    for case, (kind, _, _) in CASES.items():
        rate, of_cpu = map(statistics.median, zip(*rates[case], strict=True))
        row: dict[str, Any] = {
            'case': case,
            'ticks_per_s': rate,
            'realtime_factor': rate / 18000.0,
            'realtime_factors': [one / 18000.0 for one, _ in rates[case]],
        }
        if not kind:
            row['sim_s_per_cpu_s'] = of_cpu / 18000.0
        if kind:
            row['raw_exchanges_per_s'] = statistics.median(raw[kind])
            row['exchange_ratio'] = rate / row['raw_exchanges_per_s']
        results.append(row)
    table = Table(title='Speed, rigid model, every message on its topic (medians)')
    for heading in (
        *('case', 'ticks/s', 'x real time', 'sim s per CPU s', 'raw exchanges/s'),
        'ticks per raw exchange',
    ):
        table.add_column(heading, justify='left' if heading == 'case' else 'right')
    for row in results:
        table.add_row(
            row['case'],
            f'{row["ticks_per_s"]:.0f}',
            f'{row["realtime_factor"]:.2f}',
            f'{row["sim_s_per_cpu_s"]:.1f}' if 'sim_s_per_cpu_s' in row else '',
            f'{row["raw_exchanges_per_s"]:.0f}' if 'raw_exchanges_per_s' in row else '',
            f'{row["exchange_ratio"]:.2f}' if 'exchange_ratio' in row else '',
        )
    Console(markup=False, width=110).print(table)
    folder = Path('bench-results')
    folder.mkdir(exist_ok=True)
    (folder / 'engines.json').write_text(json.dumps(results, indent=2) + '\n', 'utf-8')
    print(f'as JSON: {folder / "engines.json"}')


if __name__ == '__main__':
    main()
