# SPDX-License-Identifier: Apache-2.0
"""Twins on one machine do not hear each other, and nobody else hears them unless asked."""

from __future__ import annotations

import os
import socket
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from harness import domain_of, user_environment, waferbot, wait_until

from waferbot_twin.engines.domain import Domain
from waferbot_twin.recording.compare import differing_signals
from waferbot_twin.recording.reader import read_recording

pytestmark = [pytest.mark.slow, pytest.mark.alone]


def test_without_loopback_it_is_said_before_anybody_waits(tmp_path):
    """In a network of its own, in which every interface is down."""
    apart = ('unshare', '--net', '--map-root-user')
    if subprocess.run([*apart, 'true'], capture_output=True).returncode:
        pytest.skip('no network namespaces here')
    command = [
        *apart,
        sys.executable,
        '-m',
        'waferbot_twin',
        'run',
        '--out',
        str(tmp_path / 'run'),
    ]
    result = subprocess.run(
        command, capture_output=True, text=True, timeout=120.0, env=user_environment()
    )
    assert result.returncode == 1
    assert 'ip link set lo up' in result.stderr
    assert len(result.stderr.splitlines()) == 1
    assert not (tmp_path / 'run').exists()


def test_two_twins_at_once_do_not_disturb_each_other(start, recorded, tmp_path):
    programs = [
        start('waferbot_twin', 'run', '--duration', '0.2', '--out', str(tmp_path / name))
        for name in ('one', 'other')
    ]
    assert domain_of(programs[0]) != domain_of(programs[1])
    for program in programs:
        assert program.wait() == 0, program.output
    one, other = (read_recording(tmp_path / name) for name in ('one', 'other'))
    assert differing_signals(one, other) == []
    alone = recorded('inprocess')
    for name, array in one.topics.items():
        np.testing.assert_array_equal(array, alone[name][: len(array)])


def test_a_domain_in_use_is_refused_with_what_to_do():
    taken = Domain()
    try:
        by_option = waferbot('run', '--domain', str(taken.number), '--duration', '0.01')
        by_environment = waferbot('run', '--duration', '0.01', ROS_DOMAIN_ID=str(taken.number))
    finally:
        taken.release()
    for result in (by_option, by_environment):
        assert result.returncode == 1
        assert f'ROS domain {taken.number} is in use by another twin' in result.stderr
        assert result.stderr.count('\n') == 1


def test_a_domain_that_a_node_is_in_is_taken_only_if_it_is_asked_for(connect):
    """As of a foreign node that stays after its twin, and would speak of its last tick."""
    claims = [Domain()]
    number = claims[0].number
    connect(number)
    claims.pop().release()
    try:
        claims.append(Domain())
        assert claims[0].number != number
        claims.append(Domain(number))
        assert claims[1].number == number
    finally:
        for claim in claims:
            claim.release()


def test_a_domain_asked_for_is_taken_and_free_again_afterwards():
    free = Domain()
    number = free.number
    free.release()
    for _ in range(2):
        result = waferbot(
            'run', '--engine', 'composed', '--domain', str(number), '--duration', '0.01'
        )
        assert result.returncode == 0, result.stderr
        assert f'ROS_DOMAIN_ID={number}' in result.stderr


def udp_sockets_of(pid):
    """Return the local addresses of a process's UDP sockets."""
    inodes = set()
    for link in (Path('/proc') / str(pid) / 'fd').iterdir():
        try:
            target = os.readlink(link)
        except OSError:
            continue
        if target.startswith('socket:['):
            inodes.add(target[8:-1])
    found = []
    for line in (Path('/proc') / str(pid) / 'net' / 'udp').read_text().splitlines()[1:]:
        fields = line.split()
        if fields[9] in inodes:
            address, port = fields[1].split(':')
            found.append((socket.inet_ntoa(struct.pack('<I', int(address, 16))), int(port, 16)))
    return found


def environment_of(pid):
    data = (Path('/proc') / str(pid) / 'environ').read_bytes().decode()
    return dict(entry.split('=', 1) for entry in data.split('\0') if '=' in entry)


@pytest.mark.parametrize('option', [[], ['--any-host']])
def test_sockets_are_open_to_this_machine_only_unless_asked(start, option):
    program = start('waferbot_twin', 'run', '--duration', '1000', *option)
    nodes = program.find_children(3)
    domain = domain_of(program)
    for pid in nodes.values():
        environment = environment_of(pid)
        assert environment['ROS_DOMAIN_ID'] == str(domain)
        if option:
            assert environment['ROS_AUTOMATIC_DISCOVERY_RANGE'] == 'SUBNET'
        wait_until(lambda pid=pid: len(udp_sockets_of(pid)) >= 2, 'sockets', program)
        addresses = {address for address, _ in udp_sockets_of(pid)}
        assert (addresses == {'127.0.0.1'}) == (not option), addresses


@pytest.mark.parametrize('asked', [{}, {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SUBNET'}])
def test_a_node_started_by_hand_announces_itself_on_localhost_only(start, domain, asked):
    """Discovery over the network listens on the domain's multicast port; on localhost nobody does."""
    node = start('waferbot_pmac.node', ROS_DOMAIN_ID=str(domain), **asked)
    multicast = 7400 + 250 * domain  # RTPS: port base and domain gain

    def ports():
        return {port for _, port in udp_sockets_of(node.process.pid)}

    wait_until(lambda: ports() & set(range(multicast + 10, multicast + 250)), 'unicast port', node)
    assert (multicast in ports()) == bool(asked)
