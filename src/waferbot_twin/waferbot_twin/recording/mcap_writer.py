# SPDX-License-Identifier: Apache-2.0
"""
Writes an MCAP file, many messages at a time.

The library's own writer makes an object of each message and packs it number by number: 20 µs for one,
of which a run has fifty thousand in a second of its time. Here the messages of a topic are rows of an
array, or those of many topics a list, and a chunk is put together out of arrays. Every record but the
message itself is the library's, and so are the bytes of the file: a test compares them.

Format: the MCAP specification, https://mcap.dev/spec. Chunks are compressed by Zstandard and indexed.
"""

from __future__ import annotations

import itertools
import zlib
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import IO, Any

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
from numpy.typing import NDArray

MAGIC = b'\x89MCAP0\r\n'
_COMPRESSION = 'zstd'

_HEAD = np.dtype(
    [
        ('opcode', 'u1'),
        ('length', '<u8'),
        ('channel', '<u2'),
        ('sequence', '<u4'),
        ('log_time_ns', '<u8'),
        ('publish_time_ns', '<u8'),
    ]
)
"""What stands before the data of a message; the length counts from behind itself."""

_UNCOUNTED = 9
"""Bytes of a record before those that its length counts."""

_INDEX_ENTRY = np.dtype([('log_time_ns', '<u8'), ('offset', '<u8')])

Message = tuple[int, int, bytes]
"""Channel, time in ns and bytes of one message."""


@dataclass(frozen=True)
class Batch:
    """Messages of a channel: their bytes, `rows` (n, width), and times, `times_ns` (n,), ascending."""

    channel: int
    times_ns: NDArray[np.int64]
    rows: NDArray[np.uint8]


class McapWriter:
    """
    An MCAP file on its way to `stream`. A chunk ends with the message that fills `chunk_bytes`.

    Numbers of schemas and channels begin with 1; messages of a channel are numbered from 0. `counts` has
    how many there are by channel, `first_ns` and `last_ns` are the times of the earliest and the latest.
    Whatever happens, the first `whole_bytes` of the file are whole records that the system has.
    """

    def __init__(self, stream: IO[bytes], chunk_bytes: int, profile: str, library: str) -> None:
        """Write what a file begins with."""
        self._stream = stream
        self._chunk_bytes = chunk_bytes
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._chunks: list[ChunkIndex] = []
        self.counts: dict[int, int] = defaultdict(int)
        self.first_ns, self.last_ns = 2**64 - 1, 0
        self._content = bytearray()
        self._index: dict[int, bytearray] = {}
        self._chunk_first_ns, self._chunk_last_ns = 2**64 - 1, 0
        stream.write(MAGIC)
        stream.write(_bytes_of(Header(profile, library)))
        self.flush()

    def add_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Declare a type; return its number."""
        schema = Schema(id=len(self._schemas) + 1, name=name, encoding=encoding, data=data)
        self._schemas.append(schema)
        self._declare(schema)
        return schema.id

    def add_channel(
        self, topic: str, encoding: str, schema: int, metadata: Mapping[str, str]
    ) -> int:
        """Declare a topic; return the number of its channel."""
        channel = Channel(
            id=len(self._channels) + 1,
            topic=topic,
            message_encoding=encoding,
            schema_id=schema,
            metadata=dict(metadata),
        )
        self._channels.append(channel)
        self._declare(channel)
        return channel.id

    def add_attachment(self, name: str, media_type: str, data: bytes) -> None:
        """Write an attachment, of time 0."""
        attachment = Attachment(
            create_time=0, log_time=0, name=name, media_type=media_type, data=data
        )
        offset, record = self._stream.tell(), _bytes_of(attachment)
        self._stream.write(record)
        index = AttachmentIndex(
            offset=offset,
            length=len(record),
            create_time=0,
            log_time=0,
            data_size=len(data),
            name=name,
            media_type=media_type,
        )
        self._attachments.append(index)

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write names with texts."""
        metadata = Metadata(name=name, metadata=dict(values))
        offset, record = self._stream.tell(), _bytes_of(metadata)
        self._stream.write(record)
        self._metadata.append(MetadataIndex(offset=offset, length=len(record), name=name))

    def add_messages(self, messages: Sequence[Message]) -> None:
        """Write messages of any channels and lengths, in this order."""
        if not messages:
            return
        channels, times_ns, contents = zip(*messages, strict=True)
        sizes = np.fromiter(map(len, contents), np.int64, len(contents)) + _HEAD.itemsize
        ends = np.cumsum(sizes)
        heads = _heads(np.array(channels), sizes, np.array(times_ns))
        for channel in set(channels):
            own = np.flatnonzero(heads['channel'] == channel)
            heads['sequence'][own] = self.counts[channel] + np.arange(len(own))
        packed, width = heads.tobytes(), _HEAD.itemsize
        parts = [packed[at : at + width] for at in range(0, len(packed), width)]
        content = b''.join(itertools.chain.from_iterable(zip(parts, contents, strict=True)))
        self._add(content, heads['log_time_ns'], heads['channel'], ends - sizes, ends)

    def add_batches(self, batches: Sequence[Batch]) -> None:
        """Write batches in the order of time; at equal times in the order of the batches."""
        times_ns = np.concatenate([batch.times_ns for batch in batches])
        batch_of = np.repeat(np.arange(len(batches)), [len(batch.rows) for batch in batches])
        order = np.lexsort((batch_of, times_ns))
        sizes = np.array([_HEAD.itemsize + batch.rows.shape[1] for batch in batches], np.int64)
        ends = np.cumsum(sizes[batch_of[order]])
        starts = np.empty(len(order), np.int64)
        starts[order] = ends - sizes[batch_of[order]]
        content = np.empty(int(ends[-1]) if len(ends) else 0, np.uint8)
        first = 0
        for batch in batches:
            own = starts[first : first + len(batch.rows)]
            records = self._records(batch)
            content[own[:, None] + np.arange(records.shape[1])] = records
            first += len(batch.rows)
        channels = np.array([batch.channel for batch in batches], np.int64)[batch_of[order]]
        self._add(content.tobytes(), times_ns[order], channels, starts[order], ends)

    def _records(self, batch: Batch) -> NDArray[np.uint8]:
        """Return the messages of a batch as records (n, bytes)."""
        count, width = batch.rows.shape
        head = _heads(batch.channel, width + _HEAD.itemsize, batch.times_ns)
        head['sequence'] = self.counts.get(batch.channel, 0) + np.arange(count)
        return np.hstack([head.view(np.uint8).reshape(count, _HEAD.itemsize), batch.rows])

    def _add(
        self,
        content: bytes,
        times_ns: NDArray[np.int64],
        channels: NDArray[np.int64],
        starts: NDArray[np.int64],
        ends: NDArray[np.int64],
    ) -> None:
        """Add records that begin and end at places of `content` to chunks."""
        first, count = 0, len(ends)
        while first < count:
            room = self._chunk_bytes - len(self._content)
            filling = int(np.searchsorted(ends, starts[first] + room, side='right'))
            behind = min(max(filling, first) + 1, count)
            part = slice(first, behind)
            entries = np.empty(behind - first, _INDEX_ENTRY)
            entries['log_time_ns'] = times_ns[part]
            entries['offset'] = starts[part] - starts[first] + len(self._content)
            self._content += content[starts[first] : ends[behind - 1]]
            numbers, begins = np.unique(channels[part], return_index=True)
            for number in numbers[np.argsort(begins)].tolist():
                own = entries[channels[part] == number]
                self._note(number, own)
            self._end_full_chunk()
            first = behind

    def _note(self, channel: int, entries: np.ndarray) -> None:
        """Count messages of a channel that are in the chunk, and add them to its index."""
        first_ns, last_ns = int(entries['log_time_ns'].min()), int(entries['log_time_ns'].max())
        self.counts[channel] += len(entries)
        self._index.setdefault(channel, bytearray()).extend(entries.tobytes())
        self._chunk_first_ns = min(self._chunk_first_ns, first_ns)
        self._chunk_last_ns = max(self._chunk_last_ns, last_ns)
        self.first_ns = min(self.first_ns, first_ns)
        self.last_ns = max(self.last_ns, last_ns)

    def _declare(self, record: Schema | Channel) -> None:
        self._content += _bytes_of(record)
        self._end_full_chunk()

    def _end_full_chunk(self) -> None:
        if len(self._content) > self._chunk_bytes and self._index:
            self._end_chunk()

    def _end_chunk(self) -> None:
        """Write the chunk, if there is a message in it, and the index of each of its channels."""
        if not self._index:
            return
        content = bytes(self._content)
        data = zstandard.compress(content)
        chunk = Chunk(
            compression=_COMPRESSION,
            data=data,
            message_start_time=self._chunk_first_ns,
            message_end_time=self._chunk_last_ns,
            uncompressed_crc=zlib.crc32(content),
            uncompressed_size=len(content),
        )
        offset, record = self._stream.tell(), _bytes_of(chunk)
        self._stream.write(record)
        begin = self._stream.tell()
        indexes = RecordBuilder()
        offsets = {}
        for channel, entries in self._index.items():
            offsets[channel] = begin + indexes.count
            indexes.start_record(Opcode.MESSAGE_INDEX)
            indexes.write2(channel)
            indexes.write4(len(entries))
            indexes.write(entries)
            indexes.finish_record()
        length = indexes.count
        self._stream.write(indexes.end())
        self._chunks.append(
            ChunkIndex(
                chunk_length=len(record),
                chunk_start_offset=offset,
                compression=_COMPRESSION,
                compressed_size=len(data),
                message_end_time=self._chunk_last_ns,
                message_index_length=length,
                message_index_offsets=offsets,
                message_start_time=self._chunk_first_ns,
                uncompressed_size=len(content),
            )
        )
        self.flush()
        self._content.clear()
        self._index.clear()
        self._chunk_first_ns, self._chunk_last_ns = 2**64 - 1, 0

    def flush(self) -> None:
        """Give to the system what is written; chunks do so by themselves."""
        self._stream.flush()
        self.whole_bytes = self._stream.tell()

    def finish(self) -> None:
        """Write the last chunk and the summary: declarations, statistics, indexes."""
        self._end_chunk()
        self._stream.write(_bytes_of(DataEnd(0)))
        begin = self._stream.tell()
        summary = RecordBuilder()
        groups: tuple[tuple[Opcode, Iterable[McapRecord]], ...] = (
            (Opcode.SCHEMA, self._schemas),
            (Opcode.CHANNEL, self._channels),
            (Opcode.STATISTICS, [self._statistics()]),
            (Opcode.CHUNK_INDEX, self._chunks),
            (Opcode.ATTACHMENT_INDEX, self._attachments),
            (Opcode.METADATA_INDEX, self._metadata),
        )
        offsets = []
        for opcode, records in groups:
            start = summary.count
            for record in records:
                record.write(summary)
            offsets.append(SummaryOffset(opcode, begin + start, summary.count - start))
        offsets_begin = begin + summary.count
        for offset in offsets:
            offset.write(summary)
        content = summary.end()
        # The sum goes over the summary and over the footer up to where it stands itself.
        unsigned = _bytes_of(Footer(begin, offsets_begin, 0))[:-4]
        self._stream.write(content)
        self._stream.write(
            _bytes_of(Footer(begin, offsets_begin, zlib.crc32(unsigned, zlib.crc32(content))))
        )
        self._stream.write(MAGIC)
        self.flush()

    def _statistics(self) -> Statistics:
        count = sum(self.counts.values())
        return Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts=self.counts,
            chunk_count=len(self._chunks),
            message_count=count,
            message_end_time=self.last_ns,
            message_start_time=self.first_ns if count else 0,
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )


def _heads(
    channels: NDArray[Any] | int, sizes: NDArray[np.int64] | int, times_ns: NDArray[np.int64]
) -> NDArray[Any]:
    """Return the heads of messages whose records have `sizes` bytes, all numbered 0."""
    heads = np.zeros(len(times_ns), _HEAD)
    heads['opcode'] = Opcode.MESSAGE
    heads['length'] = sizes - _UNCOUNTED
    heads['channel'] = channels
    heads['log_time_ns'] = heads['publish_time_ns'] = times_ns
    return heads


def _bytes_of(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()
