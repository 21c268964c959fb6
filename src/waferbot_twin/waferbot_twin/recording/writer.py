# SPDX-License-Identifier: Apache-2.0
"""
Writes a recording: a folder with `metadata.yaml` and one `.mcap`, as `ros2 bag` does.

Messages go to the file in chunks of some thousand, which are flushed as they are made, so that a run
that is killed loses only its last moments. A thread of its own makes them: whoever writes a message
only puts it aside, and does not wait for compression or the disk unless they are far behind. What the
run was made from (model, experiment, parameters, seed, versions) is attached at the beginning, before
the first message.
"""

from __future__ import annotations

import contextlib
import json
import os
import queue
import threading
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

import yaml

from waferbot_lockstep import atomic_files
from waferbot_lockstep.contract import HISTORY_DEPTH
from waferbot_lockstep.definitions import full_text, type_hash
from waferbot_lockstep.errors import UserError
from waferbot_twin.output_folder import OutputFolder
from waferbot_twin.recording.mcap_file import McapFile, Message

CHUNK_MESSAGES = 2048
"""About a quarter of a megabyte, and 0.04 s of a run."""

WAITING_CHUNKS = 8
"""How many chunks may wait for the disk; then so does whoever writes."""

_FOREVER = {'sec': 9223372036, 'nsec': 854775807}


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
        self._messages: list[Message] = []
        with self._told():
            self._file = (self._output.folder / self._file_name).open('xb')
            self._mcap = McapFile(self._file, 'ros2', 'waferbot')
            for name, text in attachments.items():
                media_type = 'application/json' if name.endswith('.json') else 'application/yaml'
                self._mcap.add_attachment(name, media_type, text.encode())
            self._file.flush()
            self._begun_bytes = self._file.tell()
            self._write_metadata()
        self._chunks = ChunkThread(self._mcap, self._begun_bytes)

    @property
    def message_count(self) -> int:
        """How many messages are in the file."""
        return self._mcap.message_count

    def add_topic(self, name: str, type_name: str, latched: bool = False) -> None:
        """Declare a topic before its first message; `name` is fully qualified."""
        qos = [_qos_profile(1, 'transient_local') if latched else _qos_profile(HISTORY_DEPTH)]
        digest = type_hash(type_name)
        self._channels[name] = self._mcap.add_channel(
            name,
            type_name,
            full_text(type_name),
            {
                'offered_qos_profiles': yaml.safe_dump(qos, sort_keys=False),
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
        self._messages.append((self._channels[topic], stamp_ns, data))
        if len(self._messages) >= CHUNK_MESSAGES:
            self._hand_over()

    def _hand_over(self) -> None:
        messages, self._messages = self._messages, []
        with self._told():
            self._chunks.add(messages)

    def close(self, summary: Mapping[str, str]) -> None:
        """Write the index, `summary` (what the recorder found at the end) and `metadata.yaml`."""
        if self._file.closed:
            return
        with self._told():
            self._hand_over()
            self._chunks.finish()
            self._mcap.add_metadata('waferbot', dict(summary))
            self._mcap.add_metadata(
                'rosbag2',
                {'serialized_metadata': yaml.safe_dump(self._information(), sort_keys=False)},
            )
            self._mcap.finish()
            atomic_files.flush_to_disk(self._file)
            self._chunks.whole_bytes = self._file.tell()
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
            self.message_count > 0 and self._chunks.whole_bytes > self._begun_bytes
        )
        self._output.__exit__(kind, error, traceback)
        if mine and error is not None:
            raise error

    def _cut_off(self) -> None:
        """Cut the file behind the last whole record that is in it, as the disk is full."""
        self._chunks.abandon()
        with contextlib.suppress(OSError):
            self._file.close()
        with contextlib.suppress(OSError):
            os.truncate(self._output.folder / self._file_name, self._chunks.whole_bytes)

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
        mcap = self._mcap
        span = {
            'starting_time': {'nanoseconds_since_epoch': mcap.first_ns},
            'duration': {'nanoseconds': mcap.last_ns - mcap.first_ns},
            'message_count': self.message_count,
        }
        return {
            'version': 9,
            'storage_identifier': 'mcap',
            **span,
            'topics_with_message_count': [
                {'topic_metadata': topic, 'message_count': mcap.counts[self._channels[name]]}
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


class ChunkThread:
    """
    Writes chunks of messages to a file, one after another, behind the back of whoever has them.

    `whole_bytes` is how long the file is up to the last chunk that is wholly in it.
    """

    def __init__(self, file: McapFile, whole_bytes: int) -> None:
        """Begin with a file of which `whole_bytes` are there."""
        self.whole_bytes = whole_bytes
        self._file = file
        self._trouble: Exception | None = None
        self._waiting: queue.Queue[list[Message] | None] = queue.Queue(WAITING_CHUNKS)
        self._thread = threading.Thread(target=self._work, name='recording', daemon=True)
        self._thread.start()

    def add(self, messages: list[Message]) -> None:
        """Have messages written; raises the error with which those before could not be."""
        self._raise_trouble()
        self._waiting.put(messages)

    def finish(self) -> None:
        """Wait until all is written; raises as `add` does."""
        self.abandon()
        self._raise_trouble()

    def abandon(self) -> None:
        """End the thread."""
        if self._thread.is_alive():
            self._waiting.put(None)
            self._thread.join()

    def _raise_trouble(self) -> None:
        if self._trouble is not None:
            raise self._trouble

    def _work(self) -> None:
        while (messages := self._waiting.get()) is not None:
            if self._trouble is not None:
                continue
            try:
                self.whole_bytes = self._file.add_messages(messages)
            except Exception as error:  # raised in the thread that writes messages
                self._trouble = error


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
