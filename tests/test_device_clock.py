# SPDX-License-Identifier: Apache-2.0
"""A controller that is the clock: one command, one servo cycle; and what becomes of its silence."""

from __future__ import annotations

import re
import time

import numpy as np
import pytest
from harness import domain_of, run_engine

import waferbot_msgs.msg
from waferbot_lockstep.contract import CURRENT_COMMAND, LOCKSTEP_TOPICS
from waferbot_lockstep.timing import Timing
from waferbot_twin.recording.reader import read_recording

pytestmark = pytest.mark.slow

HELD_A = (0.731, -8.111, 0.0)  # what holds the rigid machine's weight


class Device:
    """A controller that gives its commands when it likes, and hears the encoders."""

    def __init__(self, client):
        self.client = client
        self.newest = -1
        node = client.node
        self.publisher = node.create_publisher(
            waferbot_msgs.msg.CurrentCommand, 'current_command', 1024
        )
        node.create_subscription(waferbot_msgs.msg.Encoders, 'encoders', self._on_encoders, 1024)
        client.spin_until(lambda: self.publisher.get_subscription_count() >= 2, 'the twin')
        client.spin_until(lambda: self.newest == 0, 'tick 0')

    def _on_encoders(self, encoders):
        self.newest = max(self.newest, encoders.tick)

    def give(self, cycle):
        command = waferbot_msgs.msg.CurrentCommand(tick=8 * cycle, valid=0b111)
        command.current = HELD_A
        command.header.stamp.nanosec = Timing().stamp_ns(8 * cycle)
        self.publisher.publish(command)

    def wait_for(self, tick):
        self.client.spin_until(lambda: self.newest >= tick, f'encoders of tick {tick}', 30.0)

    def stands(self, tick, wall_s):
        """Check that time stands at a tick for a while."""
        end_s = time.monotonic() + wall_s
        while time.monotonic() < end_s:
            self.client.executor.spin_once(timeout_sec=0.05)
        assert self.newest == tick


def begin(start, connect, out, policy):
    """Start a twin without a controller, and a device that has given its first command."""
    run = ['run', '--without', 'pmac', '--device-clock', policy, '--device-timeout', '3']
    twin = start(
        'waferbot_twin', *run, '--experiment', 'constant', '--duration', '0.2', '--out', str(out)
    )
    device = Device(connect(domain_of(twin)))
    while device.newest < 6:  # a message may be lost while the two are still finding each other
        device.give(0)
        device.client.executor.spin_once(timeout_sec=0.05)
    return twin, device


def end(twin, device, cycle):
    """Give all commands that are still to come, however many at once; return exit code."""
    for number in range(cycle, 450):
        device.give(number)
    device.client.spin_until(lambda: twin.process.poll() is not None, 'the end', 30.0)
    return twin.process.returncode


def test_each_command_is_one_cycle_and_silence_holds_time(start, connect, tmp_path):
    out = tmp_path / 'run'
    twin, device = begin(start, connect, out, 'hold')
    device.stands(8, 0.5)  # encoders of the next servo tick are there, and wait for their command
    for cycle in range(1, 101):
        device.give(cycle)
    device.wait_for(808)
    device.stands(808, 5.0)  # longer than any peer may be silent in lock-step
    assert 'the device is silent: no current_command for ' in twin.output
    assert end(twin, device, 101) == 0, twin.output
    recording = read_recording(out)
    assert recording.summary['complete'] == 'true'
    np.testing.assert_array_equal(recording['current_command']['tick'], np.arange(0, 3600, 8))


def test_silence_ramps_current_to_zero_and_the_device_may_come_back(start, connect, tmp_path):
    twin, device = begin(start, connect, tmp_path / 'run', 'ramp')
    for cycle in range(1, 11):
        device.give(cycle)
    device.wait_for(88 + 1800)  # 0.1 s of simulated time without a command
    device.stands(88 + 1800, 1.0)
    assert end(twin, device, (88 + 1800) // 8) == 0, twin.output
    recording = read_recording(tmp_path / 'run')
    # Straight to zero: 8.111 (1 - n / 225) A at the n-th cycle without a command; peak of the sine.
    one, two = np.moveaxis(recording['phase_currents']['current'], 1, 0)[2:4]
    amplitude = np.sqrt(2 / 3 * (one**2 + two**2 + (one + two) ** 2))
    ticks = np.arange(360, 1800, 180)
    expected = 8.111 * (1.0 - ((ticks - 88) // 8 + 1) / 225)
    np.testing.assert_array_equal(recording['phase_currents']['tick'][ticks], ticks)
    np.testing.assert_allclose(amplitude[ticks], expected, atol=0.03 * 8.111)
    given = [*range(0, 88, 8), *range(88 + 1800, 3600, 8)]
    assert recording['current_command']['tick'].tolist() == given
    assert len(recording['phase_voltages']) == 3600


def test_silence_may_be_an_error(start, connect, tmp_path):
    twin, device = begin(start, connect, tmp_path / 'run', 'fault')
    for cycle in range(1, 11):
        device.give(cycle)
    device.client.spin_until(lambda: twin.process.poll() is not None, 'the end', 30.0)
    assert twin.process.returncode == 1
    assert re.search(
        r'copley stopped at tick 88: the device is silent: no current_command for \d+\.\d s at tick 88',
        twin.output,
    ), twin.output


def test_our_own_pmac_as_the_clock_gives_the_same_bits(tmp_path, recorded):
    one = run_engine(
        'ros', tmp_path / 'run', device_clock='fault', device_timeout_s=60.0,
        compose=['plant', 'copley'],
    )  # fmt: skip
    for topic in LOCKSTEP_TOPICS:
        np.testing.assert_array_equal(one[topic], recorded('inprocess')[topic])
    assert len(one[CURRENT_COMMAND]) == 1125
