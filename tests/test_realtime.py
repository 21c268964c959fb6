# SPDX-License-Identifier: Apache-2.0
"""Real time: the plant follows the wall clock, and a peer that comes late or not at all is counted."""

from __future__ import annotations

import math
import re
import time

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from harness import start_node

from waferbot_msgs.msg import PhaseCurrents, PhaseVoltages

FACTOR = 0.02
TICKS_PER_SECOND = FACTOR * 18000

pytestmark = [pytest.mark.slow, pytest.mark.alone]


class FreePeer:
    """A free-running stand-in for the amplifiers: answers each tick with no voltage at all."""

    def __init__(self, client):
        self.client = client
        self.publisher = client.node.create_publisher(PhaseVoltages, 'phase_voltages', 50)
        client.node.create_subscription(PhaseCurrents, 'phase_currents', self.on_currents, 50)
        client.node.create_subscription(DiagnosticArray, '/diagnostics', self.on_diagnostics, 10)
        self.answers = True
        self.tick = -1
        self.told = {}

    def on_currents(self, currents):
        self.tick = max(self.tick, currents.tick)
        if self.answers:
            self.answer(currents.tick)

    def answer(self, tick, **changes):
        message = PhaseVoltages(tick=tick, valid=0b111, open=0, **changes)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(tick * 500000 // 9, 10**9)
        self.publisher.publish(message)

    def on_diagnostics(self, array):
        for status in array.status:
            if 'plant' in status.name:
                self.told = {value.key: value.value for value in status.values}
                self.level = status.level

    def count(self, key):
        return int(self.told.get(f'phase_voltages {key}', -1))


@pytest.fixture
def plant(start, domain):
    return start_node(
        start, 'plant', domain, 'timekeeping:=realtime', f'realtime_factor:={FACTOR}'
    )


@pytest.fixture
def peer(plant, connect, domain):
    return FreePeer(connect(domain))


def test_time_follows_the_wall_clock_and_lateness_is_counted(plant, peer):
    client = peer.client
    client.spin_until(lambda: peer.tick > 50, 'time going on')
    # Loose bounds on purpose: never ahead of the wall clock, and not standing still.
    begun_s, first = time.monotonic(), peer.tick
    client.spin_until(lambda: time.monotonic() - begun_s > 2.0, 'two seconds')
    rate = (peer.tick - first) / (time.monotonic() - begun_s)
    assert 0.2 * TICKS_PER_SECOND < rate < 1.3 * TICKS_PER_SECOND

    client.spin_until(lambda: peer.count('received') > 0, 'diagnostics')
    late, missed = peer.count('late'), peer.count('missed')
    # Silent for a while, then an answer to a tick long past: late, and the ones before it missed.
    peer.answers = False
    silent_from = peer.tick
    client.spin_until(lambda: peer.tick > silent_from + 120, 'ticks without an answer')
    peer.answer(silent_from + 60)
    client.spin_until(lambda: peer.count('late') > late, 'the late one reported', 10)
    client.spin_until(lambda: peer.count('missed') >= missed + 50, 'the missed ones reported', 10)
    assert peer.count('behind') > 0
    assert peer.level == b'\x01'  # WARN


def test_no_finite_number_still_stops_it(plant, peer):
    peer.client.spin_until(lambda: peer.tick > 20, 'time going on')
    peer.answer(peer.tick, voltage=[math.nan] + [0.0] * 8)
    assert plant.wait(10) == 1
    assert re.search(r'topic phase_voltages, tick \d+ from copley: .*finite', plant.output)


def test_a_tick_from_the_future_stops_it(plant, peer):
    """Otherwise all honest messages would count as older than it, and be passed over in silence."""
    peer.client.spin_until(lambda: peer.tick > 20, 'time going on')
    peer.answer(peer.tick + 100_000)
    assert plant.wait(10) == 1
    assert re.search(r'topic phase_voltages, tick \d+ from copley: .*future', plant.output)


def test_silence_still_stops_it(plant, peer):
    peer.client.spin_until(lambda: peer.tick > 20, 'time going on')
    peer.answers = False
    began_s = time.monotonic()
    assert plant.wait(20) == 1
    assert time.monotonic() - began_s < 5.0
    assert re.search(r'copley is gone: topic phase_voltages .*tick \d+ never came', plant.output)
