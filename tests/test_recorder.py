# SPDX-License-Identifier: Apache-2.0
"""The recorder by itself, beside nodes that somebody else has started (as the launch file does)."""

from __future__ import annotations

import re
import signal

import numpy as np
import pytest
from harness import called, start_node, wait_until

from waferbot_lockstep.contract import CONTRACT_TOPICS
from waferbot_twin.recording.reader import read_recording

pytestmark = pytest.mark.slow


def test_all_from_tick_0_to_the_interrupt_is_recorded(start, domain, tmp_path, recorded):
    out = tmp_path / 'run'
    nodes = [
        start_node(start, 'plant', domain, 'start_paused:=true', 'recorder_window:=256'),
        start_node(start, 'pmac', domain, 'experiment:=step'),
        start_node(start, 'copley', domain),
    ]
    recorder = start(
        'waferbot_twin.record', str(out), '--experiment', 'step', ROS_DOMAIN_ID=str(domain)
    )

    def kilobytes():
        return sum(file.stat().st_size for file in out.glob('*.mcap')) / 1024

    wait_until(lambda: kilobytes() > 200, 'some of it recorded', recorder)
    for program in (*nodes, recorder):  # as Ctrl-C does in a launch
        program.signal(signal.SIGINT)
    assert recorder.wait() == 0, recorder.output
    assert re.search(r'0 missing of \d+', recorder.output), recorder.output
    recording = read_recording(out)
    assert recording.summary['complete'] == 'true'
    whole = recorded('inprocess')
    for topic in CONTRACT_TOPICS:
        count = min(len(recording[topic]), len(whole[topic]))
        assert count > 5
        np.testing.assert_array_equal(recording[topic][:count], whole[topic][:count])
    assert recording['phase_currents']['tick'][0] == 0
    assert called('info', out).returncode == 0


def test_why_the_twin_stopped_is_said_and_kept(start, domain, tmp_path):
    out = tmp_path / 'run'
    nodes = {
        name: start_node(start, name, domain, *more)
        for name, more in (('plant', ['start_paused:=true']), ('pmac', []), ('copley', []))
    }
    recorder = start('waferbot_twin.record', str(out), ROS_DOMAIN_ID=str(domain))
    wait_until(lambda: any(out.glob('*.mcap')), 'a recording', recorder)
    wait_until(
        lambda: sum(file.stat().st_size for file in out.glob('*.mcap')) > 100_000,
        'some of it recorded',
        recorder,
    )
    nodes['pmac'].signal(signal.SIGKILL)
    assert recorder.wait() == 1, recorder.output
    assert re.search(r'recorder: error: /\w+ stopped at tick \d+: pmac is gone', recorder.output)
    recording = read_recording(out)
    assert recording.closed
    assert 'pmac is gone' in recording.summary['failure']
