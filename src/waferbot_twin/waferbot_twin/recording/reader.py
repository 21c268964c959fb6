# SPDX-License-Identifier: Apache-2.0
"""
Reads a recording back into arrays, whole or cut off.

The contract's messages become one structured array per topic with one element per tick: messages
that spoke for some of the axes only (several Copley nodes on one topic) are merged. `valid` then
tells which places were given at that tick.
"""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml
import zstandard
from mcap.exceptions import InvalidMagic, McapError
from mcap.records import Attachment, Channel, Chunk, Footer, Message, Metadata, Schema

from waferbot_lockstep.contract import CONTRACT_TOPICS, PLANT_STATE, Topic
from waferbot_lockstep.definitions import type_hash
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.layout import SHIPPED, Layout
from waferbot_lockstep.timing import Timing
from waferbot_lockstep.wire import WireFormat, wire_of
from waferbot_twin.checked_json import TEXT, WHOLE, checked_json
from waferbot_twin.recording.chunks import ChunkReader, Messages, one_message, parts_of

_LATEST_NS = 2**63 - 1

METADATA = 'metadata.yaml'
REINDEX = 'ros2 bag reindex -s sqlite3'
"""What writes the metadata of a rosbag2 database anew."""

Take = Callable[[str, Messages], None]
"""Called with a topic and the next of its messages."""

Progress = Callable[[int, int], None]
"""Called with the bytes that were read and the bytes to read."""

TakeRecords = Callable[[Topic, np.ndarray], None]
"""Called with a contract topic and the next of its messages, as a structured array."""

_RATE = {**WHOLE, 'minimum': 1, 'maximum': 10**9}
_RUN = {
    'type': 'object',
    'properties': {
        'engine': TEXT,
        'model': TEXT,
        'experiment': TEXT,
        'ticks': WHOLE,
        'seed': WHOLE,
        'without': {'type': 'array', 'items': TEXT},
        'axes': {'type': 'array', 'items': TEXT},
        'encoders': {'type': 'array', 'items': TEXT},
        'timing': {
            'type': 'object',
            'properties': dict.fromkeys(
                ('current_loop_hz', 'encoder_divider', 'servo_divider'), _RATE
            ),
            'additionalProperties': False,
        },
        'versions': {'type': 'object'},
        'plant': {'type': 'object', 'additionalProperties': TEXT},
    },
}
"""What `run.json` may say, as a JSON schema."""


@dataclass
class Recording:
    """
    What a recording holds.

    `topics` maps the name of each contract topic (without namespace) to a structured array, one
    element per tick, ascending, with the fields of the message. `counts` has the number of messages
    of every topic in the file by its full name. `closed` is False for a recording that was cut off.
    `attachments` are the texts that the run was made from, by name.
    """

    path: Path
    topics: dict[str, np.ndarray]
    counts: dict[str, int]
    types: dict[str, str]
    closed: bool
    attachments: dict[str, str] = field(default_factory=dict)
    summary: dict[str, str] = field(default_factory=dict)

    def __getitem__(self, topic: Topic | str) -> np.ndarray:
        """Return the array of a contract topic; raises `UserError` if it was not recorded."""
        name = topic if isinstance(topic, str) else topic.name
        if name not in self.topics:
            raise UserError(f'{self.path}: topic {name} was not recorded')
        return self.topics[name]

    @property
    def run(self) -> dict[str, Any]:
        """
        What `run.json` says of how the recording was made; empty if it has none.

        Raises `UserError` if it is damaged.
        """
        text = self.attachments.get('run.json', '{}')
        run: dict[str, Any] = checked_json(text, _RUN, f'{self.path}: run.json')
        return run

    @property
    def layout(self) -> Layout:
        """The axes and encoders of the machine (those of the shipped one if it does not say)."""
        run = self.run
        if 'axes' not in run or 'encoders' not in run:
            return SHIPPED
        return Layout(tuple(run['axes']), tuple(run['encoders']))

    def check_machine(self, layout: Layout) -> None:
        """Raise `UserError` if the recording is of a machine with other axes or encoders than these."""
        own = self.layout
        for what, mine, theirs in (
            ('axes', own.axes, layout.axes),
            ('encoders', own.encoders, layout.encoders),
        ):
            if mine != theirs:
                raise UserError(
                    f'{self.path}: it is of a machine with {what} {", ".join(mine)}; the model has '
                    f'{", ".join(theirs)}'
                )

    @property
    def timing(self) -> Timing:
        """The rates that the recording was made with (the defaults if it does not say)."""
        return Timing(**self.run.get('timing', {}))

    @property
    def ticks(self) -> int:
        """Number of ticks from the first to the last, as far as any lock-step topic goes."""
        last = [int(array['tick'][-1]) for array in self.topics.values() if len(array)]
        return max(last) + 1 if last else 0


def recording_file(path: Path) -> Path:
    """Return the `.mcap` file of a recording given as folder or file; raises `UserError`."""
    if path.is_file() and path.suffix != '.mcap':
        raise UserError(
            f'{path} is no recording; bring it in first: '
            f'waferbot import {path} --map MAP.yaml --out DIR (docs/logs.md)'
        )
    files = recording_files(path)
    if len(files) > 1:
        raise UserError(
            f'{path} is split into {len(files)} files; merge it with `ros2 bag convert`'
        )
    return files[0]


def recording_files(path: Path) -> list[Path]:
    """Return the files of a recording given as folder or file, in their order."""
    if not path.exists():
        raise UserError(f'{path} does not exist')
    if path.is_file():
        return [path]
    metadata = path / METADATA
    names: list[str] = []
    if metadata.exists():
        names = _named_files(metadata)
    files = [path / name for name in names] or sorted(path.glob('*.mcap'))
    if not files:
        databases = sorted(path.glob('*.db3*'))
        if databases:
            raise without_metadata(databases[0])
        raise UserError(f'{path} holds no recording (no metadata.yaml, no .mcap file)')
    for file in files:
        if not file.exists():
            raise UserError(f'{file} is named in {metadata} but does not exist')
    return files


def without_metadata(database: Path) -> UserError:
    """Return what to say of a database whose folder has no metadata.yaml, as after a crash."""
    folder = database.parent.absolute()
    return UserError(
        f'{database}: {METADATA} is missing beside it, as after a recording that was broken off; have '
        f'it written by: {REINDEX} {folder} (a folder with nothing but the files of this recording)'
    )


def _named_files(metadata: Path) -> list[str]:
    """Return the names of a recording's files that are in its metadata; raises `UserError`."""
    try:
        content = yaml.safe_load(metadata.read_text('utf-8'))
        names = content['rosbag2_bagfile_information']['relative_file_paths']
    # ValueError: no UTF-8, or a date such as 2000-99-99
    except (yaml.YAMLError, KeyError, TypeError, ValueError, RecursionError) as error:
        raise UserError(
            f'{metadata}: not a rosbag2 metadata file ({error!r}); delete it, and have it written '
            f'anew by: ros2 bag reindex {metadata.parent.absolute()}'
        ) from None
    if not isinstance(names, list) or not all(
        isinstance(name, str) and name and '\0' not in name for name in names
    ):
        raise UserError(f'{metadata}: relative_file_paths is no list of file names')
    return names


def read_recording(
    path: Path | str, take_plant_state: Callable[[np.ndarray], None] | None = None
) -> Recording:
    """
    Read a recording whole; a cut-off file is read as far as it goes.

    Messages of `plant_state` go to `take_plant_state` if it is given, some thousand at a time.
    Raises `UserError` if there is none, if the file is no MCAP, or if a contract topic has another
    definition than the installed messages (type hash).
    """
    parts: dict[Topic, list[np.ndarray]] = {}
    recording = stream_recording(
        Path(path),
        lambda topic, records: parts.setdefault(topic, []).append(records),
        take_plant_state=take_plant_state,
    )
    for topic in list(parts):
        recording.topics[topic.name] = merge_by_tick(np.concatenate(parts.pop(topic)), topic)
    return recording


def header_of(path: Path) -> Recording:
    """
    Return a recording without its messages: what is attached, wherever it is in the file.

    Chunks are passed over, so that this is quick. Raises `UserError` if there is no such file.
    """
    file = recording_file(path)
    attachments = {}
    # What is damaged is told by whoever reads the messages.
    with file.open('rb') as stream, contextlib.suppress(*_DAMAGE):
        for record in ChunkReader(stream).records:
            if isinstance(record, Attachment):
                attachments[record.name] = record.data.decode('utf-8', 'replace')
    return Recording(path, {}, {}, {}, False, attachments)


def stream_recording(
    path: Path,
    take: TakeRecords,
    progress: Progress | None = None,
    take_plant_state: Callable[[np.ndarray], None] | None = None,
) -> Recording:
    """
    Give the messages of the contract's topics to `take`, some thousand at a time, in the file's order.

    Those of `plant_state`, if there are any, go to `take_plant_state` if it is given.
    The result has everything else of the recording: its `topics` are empty arrays. So a recording of
    any length needs no memory but for what the caller keeps. Raises `UserError` as `read_recording`.
    """
    file = recording_file(path)
    content = Content(closed=True)
    counts: dict[str, int] = {}
    known: dict[str, tuple[Topic, WireFormat] | None] = {}
    empty: dict[str, np.ndarray] = {}

    def take_messages(name: str, messages: Messages) -> None:
        counts[name] = counts.get(name, 0) + len(messages)
        if name not in known:
            known[name] = _wire_of(name, content, file)
        found = known[name]
        if found is not None and found[0] is PLANT_STATE:
            if take_plant_state is not None:
                take_plant_state(_records_of(found[1], messages))
            return
        if found is not None:
            topic, wire = found
            take(topic, _records_of(wire, messages))

    _read_file(file, content, take_messages, progress)
    for name in content.types:
        of_name = known[name] if name in known else _wire_of(name, content, file)
        if of_name is not None and of_name[0] is not PLANT_STATE:
            empty[of_name[0].name] = np.zeros(0, of_name[1].dtype)
    return Recording(
        path,
        empty,
        {name: counts.get(name, 0) for name in content.types},
        content.types,
        content.closed,
        content.attachments,
        content.summary,
    )


def _records_of(wire: WireFormat, messages: Messages) -> np.ndarray:
    """Return messages as one structured array; those in another layout take the slow way."""
    rows = messages.rows(wire.size)
    records = None if rows is None else wire.records_of_rows(rows)
    return wire.records(messages.each()) if records is None else records


def _wire_of(name: str, content: Content, file: Path) -> tuple[Topic, WireFormat] | None:
    """Return the contract topic that a recorded one is, and its codec; raises `UserError`."""
    type_name = content.types[name]
    topic = _contract_topic(name, type_name)
    if topic is None:
        return None
    recorded_hash = content.hashes[name]
    if recorded_hash and recorded_hash != type_hash(type_name):
        if topic is PLANT_STATE:
            return None
        raise UserError(
            f'{file}: topic {name} was recorded with another definition of {type_name}; '
            'read it with the waferbot version that made it'
        )
    layout = SHIPPED if type_name == topic.type_name else _layout_of(content, file)
    return topic, wire_of(topic, layout)


def _layout_of(content: Content, file: Path) -> Layout:
    """Return the axes of a machine that has its own, as the recording tells; raises `UserError`."""
    attachments = content.attachments
    if 'run.json' not in attachments:  # it may stand behind the messages
        attachments = header_of(file).attachments
    layout = Recording(file, {}, {}, {}, False, attachments).layout
    if layout == SHIPPED:
        raise UserError(
            f'{file}: it is of a machine with axes of its own, and does not say which; record it with '
            '`waferbot run` or the recorder, which keep them in run.json'
        )
    return layout


def recording_of(path: Path, file: Path, content: Content) -> Recording:
    """Return the recording in what was read of `file`; `path` is what the user gave."""
    messages, types = content.messages, content.types
    topics = {}
    for name, data in messages.items():
        found = _wire_of(name, content, file)
        if found is None or found[0] is PLANT_STATE:
            continue
        topic, wire = found
        topics[topic.name] = merge_by_tick(wire.records(data), topic)
    return Recording(
        path,
        topics,
        {name: len(data) for name, data in messages.items()},
        types,
        content.closed,
        content.attachments,
        content.summary,
    )


def merge_by_tick(records: np.ndarray, topic: Topic) -> np.ndarray:
    """Return one element per tick, ascending, from messages that may speak for some places each."""
    ticks, row = np.unique(records['tick'], return_inverse=True)
    if len(ticks) == len(records) and np.all(np.diff(records['tick'].astype(np.int64)) > 0):
        return records
    merged = np.zeros(len(ticks), records.dtype)
    for name in records.dtype.names or ():
        if not records.dtype[name].shape and name not in ('valid', topic.mask):
            merged[name][row] = records[name]
    fields = [name for name in records.dtype.names or () if records.dtype[name].shape]
    places = sum(records.dtype[name].shape[0] for name in fields) // topic.width
    for place in range(places):
        given = (records['valid'] >> place & 1).astype(bool)
        merged['valid'][row[given]] |= 1 << place
        if topic.mask:
            bit = records[topic.mask][given] & (1 << place)
            merged[topic.mask][row[given]] |= bit
        for name in fields:
            width = records.dtype[name].shape[0] // places
            columns = slice(place * width, (place + 1) * width)
            merged[name][row[given], columns] = records[name][given, columns]
    return merged


def _contract_topic(name: str, type_name: str) -> Topic | None:
    """Return the contract topic that a recorded topic is, in whatever namespace."""
    plain = type_name.replace('/msg/Axes', '/msg/')  # of a machine with axes of its own
    for topic in (*CONTRACT_TOPICS, PLANT_STATE):
        if plain == topic.type_name and name.rsplit('/', 1)[-1] == topic.name:
            return topic
    return None


# A length that is garbage overflows, or asks for more memory than there is.
_DAMAGE = (
    McapError,
    EOFError,
    ValueError,
    OverflowError,
    MemoryError,
    struct.error,
    zstandard.ZstdError,
)


@dataclass
class Content:
    """
    What one pass through the file or files of a recording brought, by topic.

    `log_times_ns` are when the messages were recorded. `definitions` are the texts of their types
    with their encoding (`ros2msg`, `ros2idl`). `closed` is False if a file was cut off, `trouble`
    then says how.
    """

    messages: dict[str, list[bytes]] = field(default_factory=dict)
    log_times_ns: dict[str, list[int]] = field(default_factory=dict)
    types: dict[str, str] = field(default_factory=dict)
    definitions: dict[str, tuple[str, str]] = field(default_factory=dict)
    hashes: dict[str, str] = field(default_factory=dict)
    attachments: dict[str, str] = field(default_factory=dict)
    summary: dict[str, str] = field(default_factory=dict)
    closed: bool = False
    trouble: str = ''


def read_content(files: Iterable[Path]) -> Content:
    """Read MCAP files from the start, as far as each goes; raises `UserError`."""
    content = Content(closed=True)

    def take(topic: str, messages: Messages) -> None:
        content.messages[topic] += messages.each()
        content.log_times_ns[topic] += messages.log_times_ns.tolist()

    for file in files:
        _read_file(file, content, take)
    return content


def _read_file(file: Path, content: Content, take: Take, progress: Progress | None = None) -> None:
    """Add what is in a file to `content`, and give its messages to `take`."""
    schemas: dict[int, Schema] = {}
    topics: dict[int, str] = {}
    size = file.stat().st_size
    closed, given = False, any(content.messages.values())

    def declare(record: Schema | Channel) -> None:
        if isinstance(record, Schema):
            schemas[record.id] = record
        elif record.id not in topics:
            topics[record.id] = record.topic
            _add_topic(content, record, schemas.get(record.schema_id))

    def give(channel: int, messages: Messages) -> None:
        nonlocal given
        if channel not in topics:
            raise McapError(f'a message of channel {channel}, which is none')
        latest_ns = int(messages.log_times_ns.max())
        if latest_ns > _LATEST_NS:
            raise McapError(f'a message of the time {latest_ns} ns')
        take(topics[channel], messages)
        given = True

    with file.open('rb') as stream:
        try:
            reader = ChunkReader(stream, validate_crcs=True)
            for record in reader.records:
                if isinstance(record, Chunk):
                    declared, by_channel = parts_of(record)
                    for one in declared:
                        declare(one)
                    for channel, messages in by_channel.items():
                        give(channel, messages)
                    if progress is not None:
                        progress(stream.tell(), size)
                elif isinstance(record, Message):
                    give(record.channel_id, one_message(record))
                elif isinstance(record, (Schema, Channel)):
                    declare(record)
                elif isinstance(record, Attachment):
                    content.attachments[record.name] = record.data.decode('utf-8', 'replace')
                elif isinstance(record, Metadata) and record.name == 'waferbot':
                    content.summary = dict(record.metadata)
                elif isinstance(record, Footer):
                    closed = True
        except InvalidMagic as error:
            if not topics:
                raise UserError(f'{file} is no MCAP file') from error
            content.trouble = content.trouble or f'{file.name}: {error!r}'
        except _DAMAGE as error:
            if not given:
                raise UserError(f'{file} holds no readable message ({error!r})') from error
            content.trouble = content.trouble or f'{file.name}: {error!r}'
    content.closed = content.closed and closed


def _add_topic(content: Content, channel: Channel, schema: Schema | None) -> None:
    """Note a topic that a file declares."""
    content.messages.setdefault(channel.topic, [])
    content.log_times_ns.setdefault(channel.topic, [])
    content.types[channel.topic] = schema.name if schema else ''
    content.definitions[channel.topic] = (
        (schema.data.decode('utf-8', 'replace'), schema.encoding) if schema else ('', '')
    )
    content.hashes[channel.topic] = channel.metadata.get('topic_type_hash', '')
