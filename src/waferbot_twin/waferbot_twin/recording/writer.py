# SPDX-License-Identifier: Apache-2.0
"""
Writes a recording: a folder with `metadata.yaml` and one `.mcap`, as `ros2 bag` does.

Messages go to the file in chunks of a quarter of a megabyte, which are flushed as they are made, so
that a run that is killed loses only its last moments. A thread of its own makes them: whoever writes a
message only puts it aside, and does not wait for compression or the disk unless they are far behind.
What the run was made from (model, experiment, parameters, seed, versions) is attached at the
beginning, before the first message.
"""

from __future__ import annotations

import contextlib
import json
import os
import queue
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
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
from waferbot_lockstep.marked_yaml import SAFE_DUMPER
from waferbot_twin.output_folder import OutputFolder
from waferbot_twin.recording.mcap_writer import Batch, McapWriter, Message

CHUNK_BYTES = 1 << 18

PUT_ASIDE = 1024
"""How many messages are put aside before they are handed over; 0.02 s of a run."""

WAITING = 16
"""How much of what was handed over may wait for the disk; then so does whoever writes."""

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
        self._topics: dict[str, dict[str, Any]] = {}
        self._channels: dict[str, int] = {}
        self._aside: list[Message] = []
        with self._told():
            self._file = (self._output.folder / self._file_name).open('xb')
            self._writer = McapWriter(self._file, CHUNK_BYTES, 'ros2', 'waferbot')
            for name, text in attachments.items():
                media_type = 'application/json' if name.endswith('.json') else 'application/yaml'
                self._writer.add_attachment(name, media_type, text.encode())
            self._writer.flush()
            self._begun_bytes = self._writer.whole_bytes
            self._write_metadata()
        self._behind = _Behind()

    @property
    def message_count(self) -> int:
        """How many messages have come so far."""
        self._hand_over()
        self._behind.wait()
        return sum(self._writer.counts.values())

    @property
    def folder(self) -> Path:
        """Where files that belong to the recording are to be written before it is closed."""
        return self._output.folder

    def add_topic(self, name: str, type_name: str, latched: bool = False) -> None:
        """Declare a topic before its first message; `name` is fully qualified."""
        qos = _qos_profiles(latched)
        definition = full_text(type_name)
        digest = type_hash(type_name)
        self._hand_over()
        self._behind.wait()
        schema = self._writer.add_schema(type_name, 'ros2msg', definition.encode())
        self._channels[name] = self._writer.add_channel(
            name,
            'cdr',
            schema,
            {
                'offered_qos_profiles': _qos_text(latched),
                'topic_type_hash': digest,
            },
        )
        self._topics[name] = {
            'name': name,
            'type': type_name,
            'serialization_format': 'cdr',
            'offered_qos_profiles': qos,
            'type_description_hash': digest,
        }

    def write(self, topic: str, stamp_ns: int, data: bytes) -> None:
        """
        Append one message, in CDR, at a sim time; messages of one topic come in order.

        Raises `UserError` if one of those before could not be written.
        """
        self._aside.append((self._channels[topic], stamp_ns, data))
        if len(self._aside) >= PUT_ASIDE:
            self._hand_over()

    def write_tables(self, tables: Sequence[Table]) -> None:
        """
        Append messages of several topics by time, at equal times in the order of the tables.

        Raises as `write` does.
        """
        batches = [
            Batch(self._channels[one.topic], one.stamps_ns, one.rows)
            for one in tables
            if len(one.stamps_ns)
        ]
        if batches:
            self._hand_over()
            with self._told():
                self._behind.do(lambda: self._writer.add_batches(batches))

    def _hand_over(self) -> None:
        """Have the messages written that were put aside."""
        messages, self._aside = self._aside, []
        if messages:
            with self._told():
                self._behind.do(lambda: self._writer.add_messages(messages))

    def close(self, summary: Mapping[str, str]) -> None:
        """Write the index, `summary` (what the recorder found at the end) and `metadata.yaml`."""
        if self._file.closed:
            return
        self._hand_over()
        with self._told():
            self._behind.finish()
            self._writer.add_metadata('waferbot', dict(summary))
            self._writer.add_metadata(
                'rosbag2',
                {'serialized_metadata': _yaml(self._information())},
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
            any(self._writer.counts.values()) and self._writer.whole_bytes > self._begun_bytes
        )
        self._output.__exit__(kind, error, traceback)
        if mine and error is not None:
            raise error

    def _cut_off(self) -> None:
        """Cut the file behind the last whole record that is in it, as the disk is full."""
        self._behind.end()
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
        counts, last_ns = self._writer.counts, self._writer.last_ns
        count = sum(counts.values())
        start_ns = self._writer.first_ns if count else 0
        span = {
            'starting_time': {'nanoseconds_since_epoch': start_ns},
            'duration': {'nanoseconds': max(0, last_ns - start_ns)},
            'message_count': count,
        }
        return {
            'version': 9,
            'storage_identifier': 'mcap',
            **span,
            'topics_with_message_count': [
                {'topic_metadata': topic, 'message_count': counts.get(self._channels[name], 0)}
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
        text = _yaml({'rosbag2_bagfile_information': self._information()})
        atomic_files.write_text(self._output.folder / 'metadata.yaml', text)


class _Behind:
    """
    Does one thing after another in a thread of its own.

    After one that could not be done nothing more is; its error is raised to whoever asks next.
    """

    def __init__(self) -> None:
        """Begin with nothing to do."""
        self._trouble: Exception | None = None
        self._waiting: queue.Queue[Callable[[], None] | None] = queue.Queue(WAITING)
        self._thread = threading.Thread(target=self._work, name='recording', daemon=True)
        self._thread.start()

    def do(self, action: Callable[[], None]) -> None:
        """Have something done; waits while too much is still to do."""
        self._raise_trouble()
        self._waiting.put(action)

    def wait(self) -> None:
        """Wait until all is done."""
        self._waiting.join()

    def finish(self) -> None:
        """Wait until all is done, end, and raise what could not be done."""
        self.end()
        self._raise_trouble()

    def end(self) -> None:
        """End behind what is still to do; may be called again."""
        if self._thread.is_alive():
            self._waiting.put(None)
            self._thread.join()

    def _raise_trouble(self) -> None:
        if self._trouble is not None:
            raise self._trouble

    def _work(self) -> None:
        more = True
        while more:
            action = self._waiting.get()
            more = action is not None
            try:
                if action is not None and self._trouble is None:
                    action()
            except Exception as error:  # raised to whoever asks next
                self._trouble = error
            finally:
                self._waiting.task_done()


def _reason(error: BaseException | None) -> str:
    """Return why a recording was closed before its completeness was verified, as one line."""
    if isinstance(error, KeyboardInterrupt):
        return 'interrupted by the user'
    return str(error) or repr(error) if error else 'not verified'


def as_json(value: Any) -> str:
    """Return a value as the text of an attachment."""
    return json.dumps(value, indent=2, sort_keys=True) + '\n'


def _qos_profiles(latched: bool) -> list[dict[str, Any]]:
    """Return the profiles that a topic is offered with; new ones, as YAML would say `*alias` else."""
    return [_qos_profile(1, 'transient_local') if latched else _qos_profile(HISTORY_DEPTH)]


def _yaml(data: Any) -> str:
    return str(yaml.dump(data, Dumper=SAFE_DUMPER, sort_keys=False))


@lru_cache
def _qos_text(latched: bool) -> str:
    return _yaml(_qos_profiles(latched))


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
