# SPDX-License-Identifier: Apache-2.0
"""
Writes a recording: a folder with `metadata.yaml` and one `.mcap`, as `ros2 bag` does.

Messages go to the file in chunks of a quarter of a megabyte, which are flushed as they are made, so
that a run that is killed loses only its last moments. What the run was made from (model, experiment,
parameters, seed, versions) is attached at the beginning, before the first message.
"""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from waferbot_lockstep import atomic_files
from waferbot_lockstep.contract import HISTORY_DEPTH
from waferbot_lockstep.definitions import full_text, type_hash
from waferbot_lockstep.errors import UserError
from waferbot_twin.output_folder import OutputFolder
from waferbot_twin.recording.mcap_writer import Batch, McapWriter

CHUNK_BYTES = 1 << 18
_FOREVER = {'sec': 9223372036, 'nsec': 854775807}


@dataclass(frozen=True)
class Table:
    """Messages of a topic: their stamps (n,), ascending, and their bytes, `rows` (n, width), in CDR."""

    topic: str
    stamps_ns: NDArray[np.int64]
    rows: NDArray[np.uint8]

    @classmethod
    def of(cls, topic: str, stamps_ns: NDArray[np.int64], records: np.ndarray) -> Table:
        """Return the table of a structured array (n,) whose elements are the messages byte by byte."""
        rows = np.frombuffer(records.tobytes(), np.uint8)
        return cls(topic, stamps_ns, rows.reshape(len(records), records.dtype.itemsize))

    @classmethod
    def of_messages(
        cls, topic: str, stamps_ns: NDArray[np.int64], messages: Sequence[bytes]
    ) -> Table:
        """Return the table of messages that are equally long."""
        content = np.frombuffer(b''.join(messages), np.uint8)
        return cls(topic, stamps_ns, content.reshape(len(messages), -1))


class RecordingWriter:
    """
    An open recording; use it in a `with` statement.

    On an ordinary end the file gets its index and the folder its final `metadata.yaml`. After an
    exception a recording of a run (`live`) is closed all the same, so what was recorded up to there can
    be read; any other is removed. What it was to replace is replaced on an ordinary end only.
    """

    def __init__(
        self, path: Path, attachments: Mapping[str, str], force: bool = False, live: bool = False
    ) -> None:
        """Create the folder and the file; raises `UserError` as `OutputFolder` does."""
        self.path = path
        self._file_name = f'{path.name}_0.mcap'
        self._output = OutputFolder(path, force, live, (self._file_name, 'metadata.yaml'))
        self._output.__enter__()
        try:
            self._begin(attachments)
        except BaseException as error:
            self._output.__exit__(type(error), error, None)
            raise

    def _begin(self, attachments: Mapping[str, str]) -> None:
        """Open the file and write all that comes before the first message."""
        self.message_count = 0
        self._first_ns = 2**63 - 1
        self._last_ns = 0
        self._topics: dict[str, dict[str, Any]] = {}
        self._channels: dict[str, int] = {}
        self._counts: dict[str, int] = {}
        with self._told():
            self._file = (self._output.folder / self._file_name).open('xb')
            self._writer = McapWriter(self._file, CHUNK_BYTES, 'ros2', 'waferbot')
            for name, text in attachments.items():
                media_type = 'application/json' if name.endswith('.json') else 'application/yaml'
                self._writer.add_attachment(name, media_type, text.encode())
            self._writer.flush()
            self._begun_bytes = self._writer.whole_bytes
            self._write_metadata()

    @property
    def folder(self) -> Path:
        """Where files that belong to the recording are to be written before it is closed."""
        return self._output.folder

    def add_topic(self, name: str, type_name: str, latched: bool = False) -> None:
        """Declare a topic before its first message; `name` is fully qualified."""
        qos = [_qos_profile(1, 'transient_local') if latched else _qos_profile(HISTORY_DEPTH)]
        definition = full_text(type_name)
        digest = type_hash(type_name)
        schema = self._writer.add_schema(type_name, 'ros2msg', definition.encode())
        self._channels[name] = self._writer.add_channel(
            name,
            'cdr',
            schema,
            {
                'offered_qos_profiles': yaml.safe_dump(qos, sort_keys=False),
                'topic_type_hash': digest,
            },
        )
        self._counts[name] = 0
        self._topics[name] = {
            'name': name,
            'type': type_name,
            'serialization_format': 'cdr',
            'offered_qos_profiles': qos,
            'type_description_hash': digest,
        }

    def write(self, topic: str, stamp_ns: int, data: bytes) -> None:
        """Append one message, in CDR, at a sim time; messages of one topic come in order."""
        try:
            self._writer.add_message(self._channels[topic], stamp_ns, data)
            self._note(topic, 1, stamp_ns, stamp_ns)
        except OSError as error:
            raise self._trouble(error) from error

    def write_tables(self, tables: Sequence[Table]) -> None:
        """Append messages of several topics by time, at equal times in the order of the tables."""
        there = [table for table in tables if len(table.stamps_ns)]
        if not there:
            return
        with self._told():
            for one in there:
                first_ns, last_ns = one.stamps_ns[[0, -1]].tolist()
                self._note(one.topic, len(one.stamps_ns), first_ns, last_ns)
            self._writer.add_batches(
                [Batch(self._channels[one.topic], one.stamps_ns, one.rows) for one in there]
            )

    def _note(self, topic: str, count: int, first_ns: int, last_ns: int) -> None:
        self._counts[topic] += count
        self.message_count += count
        self._first_ns = min(self._first_ns, first_ns)
        self._last_ns = max(self._last_ns, last_ns)

    def close(self, summary: Mapping[str, str]) -> None:
        """Write the index, `summary` (what the recorder found at the end) and `metadata.yaml`."""
        if self._file.closed:
            return
        with self._told():
            self._writer.add_metadata('waferbot', dict(summary))
            self._writer.add_metadata(
                'rosbag2',
                {'serialized_metadata': yaml.safe_dump(self._information(), sort_keys=False)},
            )
            self._writer.finish()
            atomic_files.flush_to_disk(self._file)
            self._file.close()
            self._write_metadata()

    def __enter__(self) -> RecordingWriter:
        """Return the open recording."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Close the file, whatever happened; keep what the disk had room for."""
        try:
            self.close({'complete': 'false', 'reason': _reason(error)})
        except UserError as trouble:
            self._cut_off()
            kind, error, mine = type(trouble), error or trouble, error is None
        else:
            mine = False
        self._output.worth_keeping = (
            self.message_count > 0 and self._writer.whole_bytes > self._begun_bytes
        )
        self._output.__exit__(kind, error, traceback)
        if mine and error is not None:
            raise error

    def _cut_off(self) -> None:
        """Cut the file behind the last whole record that is in it, as the disk is full."""
        with contextlib.suppress(OSError):
            self._file.close()
        with contextlib.suppress(OSError):
            os.truncate(self._output.folder / self._file_name, self._writer.whole_bytes)

    @contextlib.contextmanager
    def _told(self) -> Iterator[None]:
        """Turn what the system says of the disk into the one line for the user."""
        try:
            yield
        except OSError as error:
            raise self._trouble(error) from error

    def _trouble(self, error: OSError) -> UserError:
        return UserError(f'{self.path} cannot be written: {error.strerror or error}')

    def _information(self) -> dict[str, Any]:
        start = self._first_ns if self.message_count else 0
        span = {
            'starting_time': {'nanoseconds_since_epoch': start},
            'duration': {'nanoseconds': max(0, self._last_ns - start)},
            'message_count': self.message_count,
        }
        return {
            'version': 9,
            'storage_identifier': 'mcap',
            **span,
            'topics_with_message_count': [
                {'topic_metadata': topic, 'message_count': self._counts[name]}
                for name, topic in self._topics.items()
            ],
            'compression_format': '',
            'compression_mode': '',
            'relative_file_paths': [self._file_name],
            'files': [{'path': self._file_name, **span}],
            'custom_data': {},
            'ros_distro': 'jazzy',
        }

    def _write_metadata(self) -> None:
        """Replace `metadata.yaml` in one step, so that it is never half written."""
        text = yaml.safe_dump(
            {'rosbag2_bagfile_information': self._information()}, sort_keys=False
        )
        atomic_files.write_text(self._output.folder / 'metadata.yaml', text)


def _reason(error: BaseException | None) -> str:
    """Return why a recording was closed before its completeness was verified, as one line."""
    if isinstance(error, KeyboardInterrupt):
        return 'interrupted by the user'
    return str(error) or repr(error) if error else 'not verified'


def as_json(value: Any) -> str:
    """Return a value as the text of an attachment."""
    return json.dumps(value, indent=2, sort_keys=True) + '\n'


def _qos_profile(depth: int, durability: str = 'volatile') -> dict[str, Any]:
    """Return the contract's quality of service in rosbag2's form: reliable, volatile, keep last."""
    return {
        'history': 'keep_last',
        'depth': depth,
        'reliability': 'reliable',
        'durability': durability,
        'deadline': dict(_FOREVER),
        'lifespan': dict(_FOREVER),
        'liveliness': 'automatic',
        'liveliness_lease_duration': dict(_FOREVER),
        'avoid_ros_namespace_conventions': False,
    }
