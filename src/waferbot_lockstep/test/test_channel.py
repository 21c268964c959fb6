# SPDX-License-Identifier: Apache-2.0
"""Messages between processes by Unix sockets: all of them, in order, and whoever comes and goes."""

from __future__ import annotations

import os
import signal
import socket
import stat
import subprocess
import sys
import time

import pytest

from waferbot_lockstep.channel import LONGEST_PATH, LOOK_PERIOD_S, Channel
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.exchange import Exchange

PATIENCE_S = 20.0


@pytest.fixture
def channel(tmp_path):
    """Give a function that joins the channel; all leave at the end."""
    joined = []

    def join(name, *wanted):
        joined.append(Channel(tmp_path / 'c', name))
        for topic in wanted:
            joined[-1].want(topic)
        return joined[-1]

    yield join
    for one in joined:
        one.close()


def connect(*channels):
    """Let everybody look around until all connections stand."""
    for _ in range(3):
        time.sleep(1.5 * LOOK_PERIOD_S)
        for one in channels:
            one.look_around()


def received(one, count):
    """Return the next messages, by whatever connection they come."""
    messages = []
    end_s = time.monotonic() + PATIENCE_S
    while len(messages) < count:
        assert time.monotonic() < end_s, messages
        messages.extend(one.receive(0.01))
    return messages


def test_each_listener_gets_what_it_wants_in_order(channel):
    speaker = channel('plant')
    one, other = channel('pmac', '/a', '/b'), channel('copley', '/b')
    connect(speaker, one, other)
    sent = [(f'/{"abc"[k % 3]}', bytes([k]) * (k + 1)) for k in range(90)]
    for name, data in sent:
        speaker.send(name, data)
    assert received(one, 60) == [message for message in sent if message[0] != '/c']
    assert received(other, 30) == [message for message in sent if message[0] == '/b']
    assert not list(one.receive(0.0))


def test_who_comes_later_hears_from_then_on_and_a_name_may_come_again(channel, tmp_path):
    speaker, first = channel('plant'), channel('pmac', '/a')
    connect(speaker, first)
    speaker.send('/a', b'1')
    assert received(first, 1) == [('/a', b'1')]
    first.close()
    speaker.send('/a', b'2')  # to nobody
    speaker.send('/a', b'3')
    second = channel('pmac', '/a')
    connect(speaker, second)
    speaker.send('/a', b'4')
    assert received(second, 1) == [('/a', b'4')]
    speaker.close()
    again = channel('plant')
    connect(again, second)
    again.send('/a', b'5')
    assert received(second, 1) == [('/a', b'5')]


def test_a_killed_process_is_forgotten(channel, tmp_path):
    script = (
        'import sys, time\n'
        'from pathlib import Path\n'
        'from waferbot_lockstep.channel import Channel\n'
        'one = Channel(Path(sys.argv[1]), "plant"); one.want("/a")\n'
        'while True:\n'
        '    one.look_around(); one.send("/b", b"here"); list(one.receive(0.01))\n'
    )
    listener = channel('pmac', '/b')
    process = subprocess.Popen([sys.executable, '-c', script, str(tmp_path / 'c')])
    try:
        end_s = time.monotonic() + PATIENCE_S
        while not list(listener.receive(0.02)):
            listener.look_around()
            assert time.monotonic() < end_s
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait()
    for _ in range(1000):
        listener.send('/a', b'still there?')  # nobody takes it, and nobody waits for that
    assert (tmp_path / 'c' / 'plant').exists()  # its socket lies about, and is in nobody's way
    successor = channel('plant', '/a')
    connect(successor, listener)
    listener.send('/a', b'hello')
    assert received(successor, 1) == [('/a', b'hello')]


def test_a_stranger_who_connects_and_says_nothing_or_nonsense_is_harmless(channel, tmp_path):
    speaker, listener = channel('plant'), channel('pmac', '/a')
    strangers = [socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) for _ in range(3)]
    for stranger in strangers:
        stranger.connect(str(tmp_path / 'c' / 'plant'))
    strangers[0].send(b'\xff\x00\n\n/zzz')
    strangers[1].close()
    connect(speaker, listener)
    speaker.send('/a', b'1')
    assert received(listener, 1) == [('/a', b'1')]
    for stranger in strangers:
        stranger.close()


def test_a_socket_has_its_name_only_when_it_can_be_connected_to(channel, tmp_path, monkeypatch):
    """Whoever connected before was refused, and never tried again."""

    class Slow(socket.socket):
        def listen(self, backlog):
            listener.look_around()
            assert not (tmp_path / 'c' / 'plant').exists()
            super().listen(backlog)

    listener = channel('pmac', '/a')
    monkeypatch.setattr(socket, 'socket', Slow)
    speaker = channel('plant')
    connect(listener, speaker)
    speaker.send('/a', b'1')
    assert received(listener, 1) == [('/a', b'1')]


def test_only_the_owner_may_look_into_the_folder(channel, tmp_path):
    channel('plant')
    assert stat.S_IMODE(os.stat(tmp_path / 'c').st_mode) == 0o700


def test_a_path_that_is_too_long_for_a_socket_is_an_error(tmp_path):
    with pytest.raises(UserError, match='longer than'):
        Channel(tmp_path / ('x' * LONGEST_PATH), 'plant')


def test_a_folder_that_cannot_be_made_is_an_error(tmp_path):
    (tmp_path / 'file').write_text('')
    with pytest.raises(UserError, match='cannot be used'):
        Channel(tmp_path / 'file' / 'c', 'plant')


class NoExecutor:
    """An executor that has nothing to do but its tasks."""

    def __init__(self):
        self.tasks = []

    def create_task(self, function, *arguments):
        self.tasks.append((function, arguments))

    def spin_once(self, timeout_sec):
        function, arguments = self.tasks.pop(0)
        function(*arguments)


def test_inside_a_process_messages_are_taken_in_the_order_in_which_they_were_put():
    exchange, heard = Exchange(), []
    exchange.offer('/a')

    def answer(data, number):
        heard.append(('first', number))
        if number < 3:
            exchange.put('/a', bytes([number + 1]))
            heard.append(('put', number + 1))

    exchange.listen('/a', answer, tuple)
    exchange.listen('/a', lambda data, number: heard.append(('second', number)), tuple)
    exchange.put('/a', b'\x01')
    assert exchange.serve(NoExecutor(), 0.0) == 3
    assert heard == [
        *(('first', 1), ('put', 2), ('second', 1), ('first', 2), ('put', 3), ('second', 2)),
        *(('first', 3), ('second', 3)),
    ]


def test_a_topic_is_taken_inside_only_if_all_of_it_is_given_there(tmp_path):
    exchange = Exchange()
    exchange.offer('/volts', 0b001)
    assert exchange.takes('/volts', 0b001)
    assert not exchange.takes('/volts', 0b011)
    exchange.offer('/volts', 0b010)
    assert exchange.takes('/volts', 0b011)
    assert not exchange.takes('/other')
    channel = Channel(tmp_path / 'c', 'plant')
    with_channel = Exchange(channel, ['/other'])
    assert with_channel.takes('/volts', 0b111)
    assert not with_channel.takes('/other')
    with_channel.close()
