# SPDX-License-Identifier: Apache-2.0
"""
A way for messages between processes of one machine that is faster than the middleware: Unix sockets.

A channel is a folder. Each process that takes part listens there on a socket of type SOCK_SEQPACKET
with the name of its node. Whoever wants its messages connects and sends one packet, the full names of
the topics it wants, as UTF-8 with a line feed between them. From then on each packet that comes back is
one message: a byte with the place of the topic in that list, then the message in CDR as on the topic. A
connection ends when either side closes it.

Nothing is lost on a socket, nor out of order. A process that does not take its messages makes its
peers wait, `STUCK_S` at most; then it counts as gone and its connection is closed. The folder is open to
its owner only (mode 0700), and so are the messages.
"""

from __future__ import annotations

import contextlib
import os
import select
import socket
import struct
import time
from collections.abc import Iterator
from pathlib import Path

from waferbot_lockstep.errors import UserError

LONGEST_PATH = 100
"""Bytes that the path of a Unix socket may have (Linux: 108 with the closing zero)."""

HIDDEN = '.'
"""How the name of a socket begins that nobody can connect to yet."""

LONGEST_MESSAGE = 1 << 16

STUCK_S = 5
"""Wall time for which a peer may let its messages lie before it counts as gone."""

LOOK_PERIOD_S = 0.05
"""Wall time between two looks for processes that have come or gone."""


_Identity = tuple[int, int]
"""Inode and time of making of a socket: an inode alone is used again when a socket is removed."""


class Channel:
    """One process's end of a channel."""

    def __init__(self, folder: Path, name: str) -> None:
        """Listen as `name` in `folder`, which is made if it is not there; raises `UserError`."""
        self._path = folder / name
        if len(os.fsencode(self._path)) > LONGEST_PATH:
            raise UserError(
                f'channel {folder}: the path of its sockets is longer than {LONGEST_PATH} bytes; '
                'choose a folder nearer to the root'
            )
        self._names: list[str] = []  # that this process wants, in the order asked for
        self._tried: dict[str, _Identity] = {}  # sockets that were connected to, by name
        self._sources: dict[int, socket.socket] = {}  # by file number
        self._poll = select.poll()
        self._unasked: list[socket.socket] = []  # connected to us, and silent so far
        self._listeners: dict[str, list[tuple[socket.socket, bytes]]] = {}
        self._looked_s = 0.0
        try:
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            # It has its name from the moment on at which it can be connected to.
            hidden = folder / f'{HIDDEN}{name}'
            hidden.unlink(missing_ok=True)
            self._door = _new_socket()
            self._door.bind(os.fspath(hidden))
            self._door.listen(64)
            self._door.setblocking(False)
            hidden.rename(self._path)
            self._mine = _identity(self._path.stat())
        except OSError as error:
            raise UserError(f'channel {folder} cannot be used: {error.strerror}') from error

    def want(self, name: str) -> None:
        """Ask for a topic; before the first `look_around`."""
        if name not in self._names:
            self._names.append(name)

    def send(self, name: str, data: bytes) -> None:
        """Send a message to every process that has asked for its topic."""
        for peer, place in self._listeners.get(name, ()):
            try:
                peer.send(place + data)
            except OSError:  # closed, or stuck
                self._forget_listener(peer)

    def receive(self, timeout_s: float) -> Iterator[tuple[str, bytes]]:
        """Yield the messages that are there, one of each peer; wait `timeout_s` for the first."""
        for number, _ in self._poll.poll(1000.0 * timeout_s):
            source = self._sources[number]
            try:
                packet = source.recv(LONGEST_MESSAGE)
            except OSError:
                packet = b''
            if packet:
                yield self._names[packet[0]], packet[1:]
            else:
                self._poll.unregister(source)
                del self._sources[number]
                source.close()

    def look_around(self) -> None:
        """Connect with processes that have come; to be called again and again."""
        now_s = time.monotonic()
        if now_s - self._looked_s < LOOK_PERIOD_S:
            return
        self._looked_s = now_s
        self._open_the_door()
        if self._names:
            for entry in os.scandir(self._path.parent):
                if entry.name.startswith(HIDDEN):
                    continue
                with contextlib.suppress(FileNotFoundError):
                    identity = _identity(entry.stat())
                    if identity not in (self._mine, self._tried.get(entry.name)):
                        self._tried[entry.name] = identity
                        self._connect(entry.path)

    def _open_the_door(self) -> None:
        """Let in who has come, and note what they want."""
        with contextlib.suppress(BlockingIOError):
            while True:
                peer, _ = self._door.accept()
                peer.setblocking(False)
                self._unasked.append(peer)
        for peer in self._unasked[:]:
            with contextlib.suppress(BlockingIOError):
                wanted = _receive_or_nothing(peer)
                self._unasked.remove(peer)
                _be_patient(peer)
                for place, name in enumerate(wanted.decode('utf-8', 'replace').splitlines()):
                    self._listeners.setdefault(name, []).append((peer, bytes([place])))

    def _connect(self, path: str) -> None:
        source = _new_socket()
        try:
            _be_patient(source)
            source.connect(path)
            source.send('\n'.join(self._names).encode())
        except OSError:  # left behind by a process that was killed
            source.close()
            return
        self._sources[source.fileno()] = source
        self._poll.register(source, select.POLLIN)

    def _forget_listener(self, gone: socket.socket) -> None:
        for name, listeners in self._listeners.items():
            self._listeners[name] = [entry for entry in listeners if entry[0] is not gone]
        gone.close()

    def close(self) -> None:
        """End all connections, and take the socket out of the folder."""
        with contextlib.suppress(OSError):
            if _identity(self._path.stat()) == self._mine:
                self._path.unlink()
        listeners = {peer for entries in self._listeners.values() for peer, _ in entries}
        for one in (self._door, *self._unasked, *self._sources.values(), *listeners):
            one.close()


def _identity(status: os.stat_result) -> _Identity:
    return status.st_ino, status.st_mtime_ns


def _new_socket() -> socket.socket:
    return socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)


def _be_patient(peer: socket.socket) -> None:
    """Wait in the kernel, which costs nothing where there is no need to, and not for ever."""
    peer.setblocking(True)
    peer.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, struct.pack('ll', int(STUCK_S), 0))


def _receive_or_nothing(peer: socket.socket) -> bytes:
    """Return a packet, b'' if the peer has closed; raises `BlockingIOError` if there is none yet."""
    try:
        return peer.recv(LONGEST_MESSAGE)
    except BlockingIOError:
        raise
    except OSError:
        return b''
