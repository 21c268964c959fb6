# SPDX-License-Identifier: Apache-2.0
"""
Recordings of ROS 2 as logs: rosbag2 folders or lone files, with whatever numeric topics they hold.

A column is `TOPIC:FIELD`: `/joint_states:position[elbow]` (an entry by its name in the message's
`name`), `/motor:phases[0]` (an entry by its place, from 0 as in ROS tools), `/wrench:wrench.force.x`.
Its times are the stamps of the messages' headers, or the times of recording where they have none.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.interfaces import MessageDefinitionFormat
from rosbags.serde import SerdeError
from rosbags.typesys import (
    Stores,
    TypesysError,
    get_types_from_idl,
    get_types_from_msg,
    get_typestore,
)
from rosbags.typesys.store import Typestore

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.parameters import did_you_mean
from waferbot_lockstep.timing import NANOSECONDS_PER_SECOND
from waferbot_twin.logs.columns import Column
from waferbot_twin.logs.findings import Finding, names_text
from waferbot_twin.logs.kinds import KINDS, UNITS, is_linear
from waferbot_twin.logs.machine import Machine
from waferbot_twin.logs.mapping import SignalSource
from waferbot_twin.logs.units import UNITS_IN_LOGS
from waferbot_twin.recording.reader import (
    METADATA,
    Content,
    read_content,
    recording_files,
    without_metadata,
)

JOINT_STATE = 'sensor_msgs/msg/JointState'
LATE_NS = 10**6 * NANOSECONDS_PER_SECOND
_KIND_OF_FIELD = {'position': 'position', 'velocity': 'velocity', 'effort': 'force'}
_FIELD = re.compile(r'\.?(\w+)|\[([^\[\]]+)\]')


def is_bag(path: Path) -> bool:
    """Tell whether a path is a recording rather than a file of text or arrays."""
    return path.is_dir() or path.suffix in ('.mcap', '.db3')


def read_bag(path: Path) -> Content:
    """
    Read a recording: MCAP as far as it goes, also split into several files; else through `rosbags`.

    Raises `UserError` if there is none, or nothing in it can be read.
    """
    files = recording_files(path)
    if all(file.suffix == '.mcap' for file in files):
        return read_content(files)
    folder = path if path.is_dir() else path.parent
    if not (folder / METADATA).exists():
        raise without_metadata(files[0])
    content = Content(closed=True)
    try:
        with AnyReader([folder], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
            for connection in reader.connections:
                if not isinstance(connection.topic, str):
                    raise AnyReaderError(f'the name of a topic is {connection.topic!r}')
                if not isinstance(connection.msgtype, str):
                    raise AnyReaderError(
                        f'the type of topic {connection.topic} is {connection.msgtype!r}'
                    )
                content.types[connection.topic] = connection.msgtype
                encoding = {
                    MessageDefinitionFormat.MSG: 'ros2msg',
                    MessageDefinitionFormat.IDL: 'ros2idl',
                }.get(connection.msgdef.format, '')
                content.definitions[connection.topic] = (connection.msgdef.data, encoding)
                content.hashes[connection.topic] = connection.digest or ''
                content.messages[connection.topic] = []
                content.log_times_ns[connection.topic] = []
            for connection, time_ns, data in reader.messages():
                if not isinstance(time_ns, int):  # SQLite keeps anything in a column of numbers
                    raise AnyReaderError(
                        f'the time of a message of {connection.topic} is {time_ns!r}'
                    )
                content.messages[connection.topic].append(bytes(data))
                content.log_times_ns[connection.topic].append(time_ns)
    # rosbags, SQLite and the decompressors raise many kinds of errors on a broken file.
    except Exception as error:
        raise UserError(f'{path}: cannot be read as a rosbag2 recording ({error})') from None
    return content


@dataclass
class BagColumns:
    """The topics of a recording as columns; `origin_ns` is the instant of their time zero."""

    path: Path
    content: Content
    findings: list[Finding] = field(default_factory=list)
    _messages: dict[str, tuple[list[Any], np.ndarray]] = field(default_factory=dict)
    _store: Typestore | None = None

    @property
    def origin_ns(self) -> int:
        """Time zero: the whole second before the first message, 0 on a clock that starts there."""
        times = [times[0] for times in self.content.log_times_ns.values() if times]
        first = min(times, default=0)
        return first - first % NANOSECONDS_PER_SECOND if first > LATE_NS else 0

    def column(self, name: str | int) -> Column:
        """Return the column `TOPIC:FIELD`; raises `UserError`."""
        topic, colon, text = str(name).partition(':')
        if not colon or not text:
            raise UserError(f'{self.path}: a column of a recording is TOPIC:FIELD, not {name!r}')
        topic = self._topic(topic)
        messages, times_ns = self.messages(topic)
        value = np.array([self._value(topic, message, text) for message in messages], float)
        sample = np.arange(len(value))
        time_s = (times_ns - self.origin_ns) / NANOSECONDS_PER_SECOND
        where = f'{self.path}, topic {topic}'
        return Column(value, where, 'message', sample + 1, sample, time_s)

    def messages(self, topic: str) -> tuple[list[Any], np.ndarray]:
        """Return the messages of a topic as objects, with their times in ns."""
        if topic not in self._messages:
            self._messages[topic] = self._decode(topic)
        return self._messages[topic]

    def topics_of_type(self, type_name: str) -> list[str]:
        """Return the topics with a type, sorted."""
        return sorted(topic for topic, name in self.content.types.items() if name == type_name)

    def _topic(self, name: str) -> str:
        for topic in (name, f'/{name}'):
            if topic in self.content.messages:
                return topic
        known = sorted(self.content.messages)
        raise UserError(
            f'{self.path}: has no topic {name!r}{did_you_mean(name, known)} '
            f'(topics: {names_text(known)})'
        )

    def _decode(self, topic: str) -> tuple[list[Any], np.ndarray]:
        type_name = self.content.types[topic]
        store = self._typestore()
        messages, times = [], []
        broken = 0
        for data, time_ns in zip(
            self.content.messages[topic], self.content.log_times_ns[topic], strict=True
        ):
            try:
                message = store.deserialize_cdr(data, type_name)
            except KeyError:
                raise UserError(
                    f'{self.path}: topic {topic}: the recording does not hold the definition of '
                    f'{type_name}'
                ) from None
            # A broken message may end anywhere, and every decoder stumbles in its own way.
            except (SerdeError, ValueError, IndexError, AssertionError, TypeError, RuntimeError):
                broken += 1
                continue
            stamp = getattr(getattr(message, 'header', None), 'stamp', None)
            stamp_ns = stamp.sec * NANOSECONDS_PER_SECOND + stamp.nanosec if stamp else 0
            messages.append(message)
            times.append((stamp_ns, time_ns))
        if broken:
            reason = f'{broken} of {broken + len(messages)} messages are broken'
            self.findings.append(Finding(f'{self.path}, topic {topic}', reason))
        both = np.array(times, np.int64).reshape(-1, 2)
        # A publisher that does not fill in the header stamps every message with zero.
        stamped = bool(both[:, 0].any())
        return messages, both[:, 0] if stamped else both[:, 1]

    def _typestore(self) -> Typestore:
        """Return the types that the recording defines, over those of ROS itself."""
        if self._store is not None:
            return self._store
        store = get_typestore(Stores.ROS2_JAZZY)
        for topic, (text, encoding) in self.content.definitions.items():
            name = self.content.types[topic]
            try:
                types = (
                    get_types_from_idl(text)
                    if encoding == 'ros2idl'
                    else get_types_from_msg(text, name)
                    if encoding == 'ros2msg'
                    else {}
                )
                known = store.fielddefs
                store.register({key: item for key, item in types.items() if key not in known})
            except TypesysError as error:
                reason = f'its definition of {name} cannot be read ({error})'
                self.findings.append(Finding(f'{self.path}, topic {topic}', reason))
        self._store = store
        return store

    def _value(self, topic: str, message: Any, text: str) -> float:
        """Return a field of a message; NaN where a named or numbered entry is not there."""
        value, holder, at = message, message, 0
        while at < len(text):
            match = _FIELD.match(text, at)
            if match is None:
                raise UserError(f'{self.path}: topic {topic}: cannot read field {text[at:]!r}')
            name, entry = match.groups()
            at = match.end()
            if name is not None:
                holder = value
                if not hasattr(value, name):
                    fields = [key for key in vars(value) if not key.startswith('_')]
                    raise UserError(
                        f'{self.path}: topic {topic}: has no field {name!r}'
                        f'{did_you_mean(name, fields)} (fields: {", ".join(fields)})'
                    )
                value = getattr(value, name)
                continue
            place = int(entry) if entry.isdigit() else _place_of(holder, entry)
            if place is None or place >= len(value):
                return float('nan')
            value = value[place]
        try:
            return float(value)
        except (TypeError, ValueError):
            raise UserError(f'{self.path}: topic {topic}: {text} is no number') from None


def _place_of(message: Any, entry: str) -> int | None:
    names = list(getattr(message, 'name', ()))
    return names.index(entry) if entry in names else None


def joint_state_sources(
    bag: BagColumns, joints: Mapping[str, str], machine: Machine | None
) -> tuple[SignalSource, ...]:
    """
    Return what the `JointState` topics of a recording hold of the axes, without a mapping.

    `joints` maps names of joints to axes. Fields that are empty are left alone. Two topics with the
    same joint: the first by name.
    """
    sources: dict[tuple[str, str], SignalSource] = {}
    for topic in bag.topics_of_type(JOINT_STATE):
        messages, _ = bag.messages(topic)
        for joint, axis in joints.items():
            for name, kind in _KIND_OF_FIELD.items():
                if not any(
                    joint in message.name
                    and len(getattr(message, name)) > message.name.index(joint)
                    for message in messages
                ):
                    continue
                linear = is_linear(axis, machine.linear if machine else None)
                unit = _si_unit(kind, linear)
                sources.setdefault(
                    (axis, kind),
                    SignalSource(
                        f'{topic}:{name}[{joint}]', kind, axis, unit, UNITS_IN_LOGS[unit]
                    ),
                )
    return tuple(sources.values())


def _si_unit(kind: str, linear: bool) -> str:
    return UNITS[KINDS[kind].quantity(linear)]
