# SPDX-License-Identifier: Apache-2.0
"""Twins in namespaces of one domain: each has its own topics and its own time."""

from __future__ import annotations

import pytest
from harness import parameter_files
from rosgraph_msgs.msg import Clock

pytestmark = pytest.mark.slow


def test_twins_in_two_namespaces_have_a_clock_each(start, connect, domain):
    for name in ('left', 'right'):
        for node in ('plant', 'pmac', 'copley') if name == 'left' else ('plant',):
            start(
                f'waferbot_{node}.node', '--ros-args', *parameter_files(node),
                '--remap', f'__ns:=/{name}', ROS_DOMAIN_ID=str(domain),
            )  # fmt: skip
    client = connect(domain)
    seconds = {'/left/clock': [], '/right/clock': [], '/clock': []}
    for topic, heard in seconds.items():
        client.node.create_subscription(
            Clock, topic, lambda m, heard=heard: heard.append(m.clock.nanosec), 10
        )
    client.spin_until(
        lambda: max(seconds['/left/clock'], default=0) > 0 and len(seconds['/right/clock']) > 3,
        'clocks',
    )
    assert seconds['/left/clock'] == sorted(seconds['/left/clock'])
    assert set(seconds['/right/clock']) == {0}, 'it waits for its own Copley'
    assert seconds['/clock'] == []
