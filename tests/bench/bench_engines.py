# SPDX-License-Identifier: Apache-2.0
"""
Speed of each engine beside the raw exchange of the same messages on the same executor.

One exchange is what a tick of the lock-step has at least: `phase_currents` one way, `phase_voltages`
back. The raw ping-pong does that and nothing else, with the same bytes, executor and deployment, in
the same minute; so the ratio says what the twin adds to the messages, whatever the machine is doing.
A tick of the twin also has encoders to two nodes (every 2nd), current commands and servo state (every
8th) and, if it is recorded, a third receiver for everything; `deliveries` counts all of them.

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

import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rich.console import Console
from rich.table import Table

from waferbot_lockstep.node import lockstep_qos, make_executor
from waferbot_lockstep.wire import WireFormat
from waferbot_msgs.msg import PhaseCurrents, PhaseVoltages
from waferbot_twin.engines import inprocess, ros
from waferbot_twin.plan import make_plan

PING_PONGS = 20000
WARM_UP = 1000
# Deliveries per tick: currents and voltages to 1, encoders to 2 at half rate, command to 1 at an
# eighth; the recorder adds one of each, and servo_state.
DELIVERIES_PER_TICK = {
    False: 1 + 1 + 2 / 2 + 1 / 8,
    True: (2 + 2 / 2 + 1 / 8) + (2 + 1 / 2 + 2 / 8),
}


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


def twin_rate(engine: str, recorded: bool, seconds: float) -> float:
    """Return ticks per second of wall time."""
    plan = make_plan('rigid', 'step', seconds)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / 'run' if recorded else None
        if engine == 'inprocess':
            outcome = inprocess.run(plan, out, False, lambda done, total: None)
        else:
            options = ros.RosOptions(composed=engine == 'composed')
            outcome = ros.run(plan, out, False, lambda done, total: None, options)
    return plan.ticks / outcome.loop_s


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--pong', action='store_true', help=argparse.SUPPRESS)
    parser.add_argument('--repeat', type=int, default=3, help='rounds; the median is shown')
    options = parser.parse_args()
    if options.pong:
        pong_forever()
        return
    cases = [
        ('ros', False, 0.5),
        ('ros', True, 0.5),
        ('composed', False, 0.5),
        ('composed', True, 0.5),
        ('inprocess', False, 20.0),
        ('inprocess', True, 2.0),
    ]
    raw: dict[str, list[float]] = {'ros': [], 'composed': []}
    rates: dict[tuple[str, bool], list[float]] = {case[:2]: [] for case in cases}
    for _ in range(options.repeat):
        for engine in raw:
            raw[engine].append(ping_pong(engine == 'composed'))
        for engine, recorded, seconds in cases:
            rates[engine, recorded].append(twin_rate(engine, recorded, seconds))
    results = []
    for engine, recorded, _ in cases:
        rate = statistics.median(rates[engine, recorded])
        row = {
            'engine': engine,
            'written_to_disk': recorded,
            'ticks_per_s': rate,
            'realtime_factor': rate / 18000.0,
        }
        if engine in raw:
            limit = statistics.median(raw[engine])
            # The recorder listens in every ROS run, to count; --out only adds the file.
            row['raw_exchanges_per_s'] = limit
            row['exchange_ratio'] = rate / limit
            row['delivery_ratio'] = rate * DELIVERIES_PER_TICK[True] / (2 * limit)
        results.append(row)
    table = Table(title='Speed of the engines, rigid model (median of rounds)')
    for heading in ('engine', 'to disk', 'ticks/s', 'x real time', 'raw exchanges/s',
                    'ticks per raw exchange', 'deliveries per raw delivery'):  # fmt: skip
        table.add_column(heading, justify='right')
    for row in results:
        table.add_row(
            row['engine'],
            'yes' if row['written_to_disk'] else 'no',
            f'{row["ticks_per_s"]:.0f}',
            f'{row["realtime_factor"]:.2f}',
            f'{row["raw_exchanges_per_s"]:.0f}' if 'raw_exchanges_per_s' in row else '',
            f'{row["exchange_ratio"]:.2f}' if 'exchange_ratio' in row else '',
            f'{row["delivery_ratio"]:.2f}' if 'delivery_ratio' in row else '',
        )
    Console(markup=False, width=110).print(table)
    folder = Path('bench-results')
    folder.mkdir(exist_ok=True)
    (folder / 'engines.json').write_text(json.dumps(results, indent=2) + '\n', 'utf-8')
    print(f'as JSON: {folder / "engines.json"}')


if __name__ == '__main__':
    main()
