# SPDX-License-Identifier: Apache-2.0
"""The file that is written many messages at a time is the one that the library writes one by one."""

from __future__ import annotations

from io import BytesIO

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer

from waferbot_lockstep.errors import UserError
from waferbot_twin.recording.mcap_writer import Batch, McapWriter
from waferbot_twin.recording.writer import PUT_ASIDE, RecordingWriter

CHUNK_BYTES = 2000
TEXT = 'float64 x\n'

SEED = 33


def begun(text, channels):
    """Return both writers with the same beginning, and what each writes to."""
    ours, theirs = BytesIO(), BytesIO()
    mine = McapWriter(ours, CHUNK_BYTES, 'ros2', 'us')
    library = Writer(theirs, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
    library.start('ros2', 'us')
    mine.add_attachment('run.json', 'application/json', b'{}')
    library.add_attachment(0, 0, 'run.json', 'application/json', b'{}')
    for place in range(channels):
        name = f'/topic{place}'
        for number in (
            mine.add_schema(name, 'ros2msg', text.encode()),
            library.register_schema(name, 'ros2msg', text.encode()),
        ):
            assert number == place + 1
        metadata = {'key': name}
        assert mine.add_channel(name, 'cdr', place + 1, metadata) == library.register_channel(
            name, 'cdr', place + 1, metadata
        )
    return mine, library, ours, theirs


def ended(mine, library, ours, theirs):
    mine.add_metadata('waferbot', {'complete': 'true'})
    library.add_metadata('waferbot', {'complete': 'true'})
    mine.finish()
    library.finish()
    return ours.getvalue(), theirs.getvalue()


@pytest.mark.parametrize('text', [TEXT, 300 * TEXT], ids=['', 'declarations that fill a chunk'])
def test_batches_and_messages_of_any_length_give_the_bytes_of_the_library(random, text) -> None:
    widths = [8, 33, 120, 5000]
    writers = begun(text, len(widths) + 1)
    mine, library = writers[:2]
    counts = dict.fromkeys(range(len(widths) + 1), 0)

    def by_library(channel, time_ns, data):
        library.add_message(channel, time_ns, data, time_ns, counts[channel - 1])
        counts[channel - 1] += 1

    for turn in range(6):
        lengths = random.integers(0, 60, len(widths))
        batches, sent = [], []
        for place in random.permutation(len(widths)).tolist():
            times_ns = np.sort(random.integers(0, 30, lengths[place])) + 1000 * turn
            shape = (lengths[place], widths[place])
            rows = random.integers(0, 256, shape).astype(np.uint8)
            sent += [
                (time_ns, len(batches), row, place + 1, rows[row].tobytes())
                for row, time_ns in enumerate(times_ns.tolist())
            ]
            batches.append(Batch(place + 1, times_ns, rows))
        mine.add_batches(batches)
        for time_ns, _, _, channel, data in sorted(sent):
            by_library(channel, time_ns, data)
        # Messages of any length and channel, also earlier ones.
        messages = [
            (
                int(random.integers(1, len(widths) + 2)),
                int(random.integers(0, 9000)),
                random.bytes(random.integers(0, 300)),
            )
            for _ in range(int(random.integers(0, 40)))
        ]
        mine.add_messages(messages)
        for message in messages:
            by_library(*message)
    ours, theirs = ended(*writers)
    assert ours.count(b'zstd') > 20
    assert ours == theirs


def test_a_file_without_messages_is_that_of_the_library() -> None:
    ours, theirs = ended(*begun(TEXT, 2))
    assert ours == theirs


def test_what_the_disk_did_not_take_is_told_to_the_writer(tmp_path, monkeypatch):
    def full(writer, messages):
        raise OSError(28, 'No space left on device')

    writer = RecordingWriter(tmp_path / 'run', {}, live=True)
    writer.add_topic('/encoders', 'waferbot_msgs/msg/Encoders')
    monkeypatch.setattr(McapWriter, 'add_messages', full)
    ticks = iter(range(100 * PUT_ASIDE))

    def write_all():
        with writer:
            for tick in ticks:
                writer.write('/encoders', tick, b'')

    with pytest.raises(UserError, match='No space left on device'):
        write_all()
    assert next(ticks) < 50 * PUT_ASIDE  # not only at the end
