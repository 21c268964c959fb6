# SPDX-License-Identifier: Apache-2.0
"""
Chunks of an MCAP file, taken apart topic by topic rather than message by message.

A recording of minutes has tens of millions of messages: an object for each of them takes more memory
than all that is in them, and more time than reading the file. Here a chunk stays one piece of memory,
and the messages of a channel are places in it.

Format: the MCAP specification, https://mcap.dev/spec.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from typing import BinaryIO

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, McapRecord, Message, Schema
from mcap.stream_reader import StreamReader, get_chunk_data_stream
from numpy.typing import NDArray

Places = NDArray[np.int64]

_RECORD = struct.Struct('<BQ')
"""What every record begins with: what it is, and how many bytes follow."""

_MESSAGE = np.dtype(
    {
        'names': ['channel', 'log_time_ns'],
        'formats': ['<u2', '<u8'],
        'offsets': [0, 6],
        'itemsize': 22,
    }
)
"""What a message record begins with; its data are behind that."""


@dataclass(frozen=True)
class Messages:
    """Messages of one channel: `content[starts[i]:ends[i]]` was recorded at `log_times_ns[i]`."""

    content: bytes
    starts: Places
    ends: Places
    log_times_ns: NDArray[np.uint64]

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self.starts)

    def each(self) -> list[bytes]:
        """Return the messages one by one."""
        places = zip(self.starts.tolist(), self.ends.tolist(), strict=True)
        return [self.content[start:end] for start, end in places]

    def rows(self, width: int) -> NDArray[np.uint8] | None:
        """
        Return the first `width` bytes of every message (n, width).

        None if one is shorter, or more than the three bytes longer that DDS may pad it by.
        """
        lengths = self.ends - self.starts
        if np.any((lengths < width) | (lengths >= width + 4)):
            return None
        everything = np.frombuffer(self.content, np.uint8)
        return everything[self.starts[:, None] + np.arange(width)]


class ChunkReader(StreamReader):
    """
    Reads a file's records, chunks whole.

    The index behind each chunk, in which every message has a place, is passed over: nobody here
    looks for a message, and to take it apart took longer than all else.
    """

    def __init__(self, stream: BinaryIO, validate_crcs: bool = False) -> None:
        """Begin at the beginning of `stream`."""
        super().__init__(stream, emit_chunks=True, validate_crcs=validate_crcs)

    def _read_record(self, opcode: int, length: int) -> McapRecord | None:
        if opcode == Opcode.MESSAGE_INDEX:
            self._stream.read(length)
            return None
        return super()._read_record(opcode, length)


def one_message(message: Message) -> Messages:
    """Return a message that stands outside of any chunk."""
    ends = np.array([len(message.data)], np.int64)
    log_time_ns = np.array([message.log_time], np.uint64)
    return Messages(message.data, np.zeros(1, np.int64), ends, log_time_ns)


def parts_of(chunk: Chunk) -> tuple[list[Schema | Channel], dict[int, Messages]]:
    """
    Return what a chunk declares, and its messages by channel, in the file's order.

    Raises what the decompressors, the check sum or `mcap` raise for one that is damaged.
    """
    stream, length = get_chunk_data_stream(chunk, validate_crc=True)
    content = stream.read(length)
    declared: list[Schema | Channel] = []
    starts, lengths = [], []
    for kind, start, size in _records(content):
        if kind == Opcode.MESSAGE:
            starts.append(start)
            lengths.append(size)
        elif kind in (Opcode.SCHEMA, Opcode.CHANNEL):
            one = ReadDataStream(BytesIO(content[start : start + size]))
            declared.append(Schema.read(one) if kind == Opcode.SCHEMA else Channel.read(one))
    return declared, _by_channel(content, np.array(starts, np.int64), np.array(lengths, np.int64))


def _records(content: bytes) -> Iterator[tuple[int, int, int]]:
    """Give what each record is, where it begins behind its head, and how long it is."""
    place, end = 0, len(content)
    unpack, head = _RECORD.unpack_from, _RECORD.size
    while place < end:
        if place + head > end:
            raise EndOfFile
        kind, length = unpack(content, place)
        place += head
        if length > end - place or (kind == Opcode.MESSAGE and length < _MESSAGE.itemsize):
            raise EndOfFile
        yield kind, place, length
        place += length


def _by_channel(content: bytes, starts: Places, lengths: Places) -> dict[int, Messages]:
    if len(starts) == 0:
        return {}
    everything = np.frombuffer(content, np.uint8)
    heads = everything[starts[:, None] + np.arange(_MESSAGE.itemsize)].view(_MESSAGE).ravel()
    ends = starts + lengths
    found = {}
    for channel in np.unique(heads['channel']):
        own = heads['channel'] == channel
        found[int(channel)] = Messages(
            content, starts[own] + _MESSAGE.itemsize, ends[own], heads['log_time_ns'][own]
        )
    return found
