# SPDX-License-Identifier: Apache-2.0
"""
An MCAP file that takes messages many at a time.

The records are those of the library `mcap`; its own writer takes messages one by one, which costs
about 12 us each in Python, five times as much as all else that a recorder does with one. Here a chunk
is made of a whole batch: the heads of its messages are one NumPy array, and so is each index.

Layout (https://mcap.dev/spec): magic, header, attachments, chunks (zstd; new schemas and channels lie
before the first message that needs them) each with an index per channel, metadata, then the summary.
"""

from __future__ import annotations

import itertools
import struct
import zlib
from collections.abc import Mapping, Sequence
from typing import IO

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC

Message = tuple[int, int, bytes]
"""Channel, time in nanoseconds and the bytes of one message."""

_HEAD = np.dtype(
    [
        ('opcode', 'u1'),
        ('length', '<u8'),
        ('channel', '<u2'),
        ('sequence', '<u4'),
        ('log_time', '<u8'),
        ('publish_time', '<u8'),
    ]
)
"""What stands before the bytes of a message in its record; `length` counts from behind itself."""

_LENGTH_BEGINS_BEHIND = 9  # bytes of opcode and length
_INDEX_ENTRY = np.dtype([('log_time', '<u8'), ('offset', '<u8')])


class McapFile:
    """
    An MCAP file that is being written to `stream`.

    `message_count`, `counts` (by channel), `first_ns` and `last_ns` speak of what was written.
    """

    def __init__(self, stream: IO[bytes], profile: str, library: str) -> None:
        """Write magic and header."""
        self._stream = stream
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._unwritten: list[McapRecord] = []  # schemas and channels for the next chunk
        self._chunk_indices: list[ChunkIndex] = []
        self._attachment_indices: list[AttachmentIndex] = []
        self._metadata_indices: list[MetadataIndex] = []
        self._compressor = zstandard.ZstdCompressor()
        self.counts: dict[int, int] = {}
        self.message_count = 0
        self.first_ns = 0
        self.last_ns = 0
        stream.write(MCAP0_MAGIC + _bytes_of(Header(profile, library)))

    def add_attachment(self, name: str, media_type: str, data: bytes) -> None:
        """Attach a file."""
        record = _bytes_of(Attachment(0, 0, name, media_type, data))
        self._attachment_indices.append(
            AttachmentIndex(
                offset=self._stream.tell(),
                length=len(record),
                log_time=0,
                create_time=0,
                data_size=len(data),
                name=name,
                media_type=media_type,
            )
        )
        self._stream.write(record)

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Add values by name."""
        record = _bytes_of(Metadata(name, dict(values)))
        self._metadata_indices.append(
            MetadataIndex(offset=self._stream.tell(), length=len(record), name=name)
        )
        self._stream.write(record)

    def add_channel(
        self, topic: str, type_name: str, definition: str, metadata: Mapping[str, str]
    ) -> int:
        """Declare a topic of CDR messages with its `ros2msg` definition; return its channel."""
        schema = Schema(
            id=len(self._schemas) + 1,
            data=definition.encode(),
            encoding='ros2msg',
            name=type_name,
        )
        channel = Channel(
            id=len(self._channels) + 1,
            topic=topic,
            message_encoding='cdr',
            metadata=dict(metadata),
            schema_id=schema.id,
        )
        self._schemas.append(schema)
        self._channels.append(channel)
        self._unwritten += [schema, channel]
        self.counts[channel.id] = 0
        return channel.id

    def add_messages(self, messages: Sequence[Message]) -> int:
        """Write a batch of messages as one chunk with its index, flush, return the file's length."""
        if not messages:
            return self._stream.tell()
        channels, times, contents = zip(*messages, strict=True)
        count = len(messages)
        sizes = np.fromiter(map(len, contents), np.int64, count)
        heads = np.zeros(count, _HEAD)
        heads['opcode'] = Opcode.MESSAGE
        heads['length'] = sizes + (_HEAD.itemsize - _LENGTH_BEGINS_BEHIND)
        heads['channel'] = channels
        heads['log_time'] = heads['publish_time'] = times
        declared, self._unwritten = b''.join(map(_bytes_of, self._unwritten)), []
        ends = len(declared) + np.cumsum(sizes + _HEAD.itemsize)
        entries = np.empty(count, _INDEX_ENTRY)
        entries['log_time'] = times
        entries['offset'] = ends - sizes - _HEAD.itemsize
        indices: dict[int, bytes] = {}
        for channel in dict.fromkeys(channels):
            own = np.flatnonzero(heads['channel'] == channel)
            before = self.counts[channel]
            heads['sequence'][own] = np.arange(before, before + len(own))
            self.counts[channel] = before + len(own)
            indices[channel] = _message_index(channel, entries[own])
        packed = heads.tobytes()
        size = _HEAD.itemsize
        parts = [packed[at : at + size] for at in range(0, len(packed), size)]
        body = declared + b''.join(
            itertools.chain.from_iterable(zip(parts, contents, strict=True))
        )
        self._write_chunk(body, int(min(times)), int(max(times)), indices)
        self.first_ns = min(self.first_ns, min(times)) if self.message_count else min(times)
        self.last_ns = max(self.last_ns, max(times))
        self.message_count += count
        return self._stream.tell()

    def _write_chunk(
        self, body: bytes, first_ns: int, last_ns: int, indices: Mapping[int, bytes]
    ) -> None:
        compressed = self._compressor.compress(body)
        record = _bytes_of(
            Chunk('zstd', compressed, last_ns, first_ns, zlib.crc32(body), len(body))
        )
        start = self._stream.tell()
        offsets, position = {}, start + len(record)
        for channel, index in indices.items():
            offsets[channel] = position
            position += len(index)
        self._stream.write(record + b''.join(indices.values()))
        self._stream.flush()
        self._chunk_indices.append(
            ChunkIndex(
                chunk_length=len(record),
                chunk_start_offset=start,
                compression='zstd',
                compressed_size=len(compressed),
                message_end_time=last_ns,
                message_index_length=position - start - len(record),
                message_index_offsets=offsets,
                message_start_time=first_ns,
                uncompressed_size=len(body),
            )
        )

    def finish(self) -> None:
        """Write the summary; nothing may follow."""
        self._stream.write(b''.join(map(_bytes_of, [*self._unwritten, DataEnd(0)])))
        start = self._stream.tell()
        groups: list[tuple[Opcode, Sequence[McapRecord]]] = [
            (Opcode.SCHEMA, self._schemas),
            (Opcode.CHANNEL, self._channels),
            (Opcode.STATISTICS, [self._statistics()]),
            (Opcode.CHUNK_INDEX, self._chunk_indices),
            (Opcode.ATTACHMENT_INDEX, self._attachment_indices),
            (Opcode.METADATA_INDEX, self._metadata_indices),
        ]
        summary = b''
        offsets = []
        for opcode, records in groups:
            group = b''.join(map(_bytes_of, records))
            if group:
                offsets.append(
                    SummaryOffset(
                        group_opcode=opcode,
                        group_start=start + len(summary),
                        group_length=len(group),
                    )
                )
            summary += group
        offsets_start = start + len(summary)
        summary += b''.join(map(_bytes_of, offsets))
        crc = zlib.crc32(
            struct.pack('<BQQQ', Opcode.FOOTER, 8 + 8 + 4, start, offsets_start),
            zlib.crc32(summary),
        )
        footer = Footer(summary_start=start, summary_offset_start=offsets_start, summary_crc=crc)
        self._stream.write(summary + _bytes_of(footer) + MCAP0_MAGIC)

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=len(self._attachment_indices),
            channel_count=len(self._channels),
            channel_message_counts={id: count for id, count in self.counts.items() if count},
            chunk_count=len(self._chunk_indices),
            message_count=self.message_count,
            message_end_time=self.last_ns,
            message_start_time=self.first_ns,
            metadata_count=len(self._metadata_indices),
            schema_count=len(self._schemas),
        )


def _message_index(channel: int, entries: np.ndarray) -> bytes:
    """Return the record that says when and where in its chunk the messages of a channel are."""
    data = entries.tobytes()
    return struct.pack('<BQHI', Opcode.MESSAGE_INDEX, 2 + 4 + len(data), channel, len(data)) + data


def _bytes_of(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()
