# SPDX-License-Identifier: Apache-2.0
"""Our MCAP files against those of the library `mcap`, as its readers see both."""

from __future__ import annotations

import io
import random

import pytest
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from mcap.writer import Writer

from waferbot_lockstep.errors import UserError
from waferbot_twin.recording.mcap_file import McapFile
from waferbot_twin.recording.writer import CHUNK_MESSAGES, RecordingWriter

TOPICS = ('/first', '/second', '/never')


def messages(count, seed=3):
    """Return messages on the first two topics, in the order of time, of any length."""
    random_numbers = random.Random(seed)
    return [
        (
            1 + random_numbers.randrange(2),
            1000 * (tick // 2),
            random_numbers.randbytes(random_numbers.randrange(200)),
        )
        for tick in range(count)
    ]


def ours(batches):
    stream = io.BytesIO()
    file = McapFile(stream, 'ros2', 'test')
    file.add_attachment('run.json', 'application/json', b'{}')
    for topic in TOPICS:
        file.add_channel(topic, f'test{topic}', 'float64 x', {'key': topic})
    for batch in batches:
        file.add_messages(batch)
    file.add_metadata('waferbot', {'complete': 'true'})
    file.finish()
    return stream.getvalue()


def library_s(batches):
    stream = io.BytesIO()
    writer = Writer(stream)
    writer.start('ros2', 'test')
    writer.add_attachment(0, 0, 'run.json', 'application/json', b'{}')
    for topic in TOPICS:
        schema = writer.register_schema(f'test{topic}', 'ros2msg', b'float64 x')
        writer.register_channel(topic, 'cdr', schema, {'key': topic})
    counts = {1: 0, 2: 0}
    for batch in batches:
        for channel, time, data in batch:
            writer.add_message(channel, time, data, time, counts[channel])
            counts[channel] += 1
        writer.flush()
    writer.add_metadata('waferbot', {'complete': 'true'})
    writer.finish()
    return stream.getvalue()


def read(data, **selection):
    """Return messages by the index, in the order of time, with checked sums."""
    reader = make_reader(io.BytesIO(data), validate_crcs=True)
    return [
        (schema.name, channel.topic, channel.metadata, message)
        for schema, channel, message in reader.iter_messages(**selection)
    ]


BATCHES = [messages(900, 1), [], messages(1, 2), messages(400, 3)]


def test_readers_find_the_same_in_both():
    one, other = ours(BATCHES), library_s(BATCHES)
    for selection in ({}, {'topics': ['/second']}, {'start_time': 40_000, 'end_time': 90_000}):
        assert read(one, **selection) == read(other, **selection) != []
    summaries = [make_reader(io.BytesIO(data)).get_summary() for data in (one, other)]
    assert summaries[0].statistics == summaries[1].statistics
    assert summaries[0].channels == summaries[1].channels
    assert summaries[0].schemas == summaries[1].schemas
    assert len(summaries[0].chunk_indexes) == len(summaries[1].chunk_indexes) == 3
    readers = [make_reader(io.BytesIO(data)) for data in (one, other)]
    assert list(readers[0].iter_attachments()) == list(readers[1].iter_attachments())
    assert list(readers[0].iter_metadata()) == list(readers[1].iter_metadata())


def test_the_records_are_those_of_the_library_one_by_one():
    kinds = [
        [type(record).__name__ for record in StreamReader(io.BytesIO(data)).records]
        for data in (ours(BATCHES), library_s(BATCHES))
    ]
    assert sorted(kinds[0]) == sorted(kinds[1])


def test_what_the_disk_did_not_take_is_told_to_the_writer(tmp_path, monkeypatch):
    def full(file, batch):
        raise OSError(28, 'No space left on device')

    writer = RecordingWriter(tmp_path / 'run', {}, live=True)
    writer.add_topic('/encoders', 'waferbot_msgs/msg/Encoders')
    monkeypatch.setattr(McapFile, 'add_messages', full)
    ticks = iter(range(100 * CHUNK_MESSAGES))

    def write_all():
        with writer:
            for tick in ticks:
                writer.write('/encoders', tick, b'')

    with pytest.raises(UserError, match='No space left on device'):
        write_all()
    assert next(ticks) < 50 * CHUNK_MESSAGES  # not only at the end
