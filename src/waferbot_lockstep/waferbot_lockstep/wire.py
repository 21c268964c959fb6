# SPDX-License-Identifier: Apache-2.0
"""
Contract messages as bytes: CDR without the way through Python message objects.

rclpy turns a message into a Python object field by field, which costs more than everything else in
a tick (round trip of one message in one process: 32 us through objects, 13 us as bytes). The
messages of the contract have a fixed size, so their CDR image is one `struct` format, and a column
of recorded messages is one NumPy structured array. So have those for machines with axes of their own,
though their arrays are bounded sequences: how long they are is the same for all messages of a machine.
Publishers and subscriptions stay ordinary rclpy ones; `publish` and `create_subscription(raw=True)` take
such bytes.

Layout (OMG CDR, XCDR1, little endian): 4 bytes of encapsulation, then each value aligned to its own
size, counted from behind the encapsulation; a string is its length with the closing zero, then the
characters and the zero; a sequence is its length, uint32, then its values. `std_msgs/Header` with an
empty `frame_id` is therefore 13 bytes.

A message that another vendor sends differently (big endian, a non-empty `frame_id`) is still
understood: it is then read value by value.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from waferbot_lockstep.contract import Topic
from waferbot_lockstep.definitions import field_types
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.layout import Layout
from waferbot_lockstep.timing import NANOSECONDS_PER_SECOND

LITTLE_ENDIAN = b'\x00\x01\x00\x00'
_PLAIN = LITTLE_ENDIAN[:2]
_FRAME_ID_LENGTH = 1  # of an empty string: only its closing zero
_LENGTH_SIZE = 4  # bytes of the length of a sequence
_PADDING = 4  # bytes that Fast DDS may fill up the end to

# name in a message definition: (struct code, NumPy name)
_SCALARS = {
    'uint8': ('B', 'u1'),
    'uint16': ('H', 'u2'),
    'int32': ('i', 'i4'),
    'uint32': ('I', 'u4'),
    'int64': ('q', 'i8'),
    'uint64': ('Q', 'u8'),
    'float64': ('d', 'f8'),
}
_NUMPY_NAMES = dict(_SCALARS.values())
_ENCAPSULATIONS = {b'\x00\x00': '>', b'\x00\x01': '<'}
"""Of plain CDR, with the order of bytes."""


class WireFormat:
    """
    Codec of one contract message type.

    The type must be a header, `tick`, `valid` and fixed-size numeric fields or bounded sequences, in
    that order. `dtype` describes one message as a NumPy structured array, including the encapsulation,
    so that many of them can be decoded or made at once; `value_fields` names the fields behind `valid`.
    """

    def __init__(self, type_name: str, places: int = 0, room: int = 1) -> None:
        """
        Build the codec of a message type by its full name, `waferbot_msgs/msg/Encoders`.

        A bounded sequence with room for k values for each of `room` places has k for each of `places`.
        """
        self.type_name = type_name
        fields = list(field_types(type_name).items())
        if [name for name, _ in fields[:3]] != ['header', 'tick', 'valid']:
            raise TypeError(f'{type_name} is not a lock-step message')
        self.value_fields = [name for name, _ in fields[3:]]
        self._fields = [_array(kind, places, room) for _, kind in fields[1:]]
        image = _Image()
        for name, code in (
            ('stamp_sec', 'i'),
            ('stamp_nanosec', 'I'),
            ('frame_id_length', 'I'),
            ('frame_id_end', 'B'),
        ):
            image.add(name, _Array(code))
        for (name, _), array in zip(fields[1:], self._fields, strict=True):
            image.add(name, array)
        self._struct = struct.Struct(image.format)
        self._lengths = image.lengths
        self.size = self._struct.size
        self.dtype = np.dtype(
            {
                'names': ['encapsulation', *image.names],
                'formats': ['V4', *image.formats],
                'offsets': [0, *image.offsets],
                'itemsize': self.size,
            }
        )

    def encode(self, tick: int, stamp_ns: int, valid: int, values: Sequence[float]) -> bytes:
        """Return the message; `values` are those of all fields behind `valid`, one after another."""
        message = self._struct.pack(
            LITTLE_ENDIAN,
            stamp_ns // NANOSECONDS_PER_SECOND,
            stamp_ns % NANOSECONDS_PER_SECOND,
            _FRAME_ID_LENGTH,
            0,
            tick,
            valid,
            *values,
        )
        if not self._lengths:
            return message
        with_lengths = bytearray(message)
        for place, length in self._lengths:
            with_lengths[place : place + len(length)] = length
        return bytes(with_lengths)

    def decode(self, data: bytes) -> tuple[int, int, int, tuple[float, ...]]:
        """
        Return tick, stamp in nanoseconds, valid mask and the values of all fields behind it.

        Raises `UserError` if the bytes are no message of this type.
        """
        if not self.size <= len(data) < self.size + _PADDING:
            return self._decode_slowly(data)
        fields = self._struct.unpack_from(data)
        if fields[3] != _FRAME_ID_LENGTH or fields[0][:2] != _PLAIN:
            return self._decode_slowly(data)
        if self._lengths and not self._has_lengths(data):
            return self._decode_slowly(data)
        stamp_ns = fields[1] * NANOSECONDS_PER_SECOND + fields[2]
        return fields[5], stamp_ns, fields[6], fields[7:]

    def is_plain(self, data: bytes) -> bool:
        """Tell whether the bytes have the fixed layout (Fast DDS may pad the end to four bytes)."""
        return (
            self.size <= len(data) < self.size + _PADDING
            and data[:2] == _PLAIN
            and data[12:16] == b'\x01\x00\x00\x00'
            and self._has_lengths(data)
        )

    def _has_lengths(self, data: bytes) -> bool:
        """Tell whether every sequence is as long as this machine asks for."""
        return all(data[place : place + len(length)] == length for place, length in self._lengths)

    def normalised(self, data: bytes) -> bytes:
        """Return the same message in the fixed layout, without trailing padding."""
        if self.is_plain(data):
            return data[: self.size]
        tick, stamp_ns, valid, values = self._decode_slowly(data)
        return self.encode(tick, stamp_ns, valid, values)

    def _decode_slowly(self, data: bytes) -> tuple[int, int, int, tuple[float, ...]]:
        """Decode value by value: any order of bytes, any `frame_id`."""
        order = _ENCAPSULATIONS.get(bytes(data[:2]))
        body = memoryview(data)[len(LITTLE_ENDIAN) :]
        try:
            if order is None:
                raise ValueError(f'encapsulation {bytes(data[:2]).hex()!r} is not plain CDR')
            seconds, nanoseconds, length = struct.unpack_from(f'{order}iII', body)
            position = 12 + length  # behind the frame_id
            values: list[float] = []
            for array in self._fields:
                if array.is_sequence:
                    position += -position % _LENGTH_SIZE
                    (given,) = struct.unpack_from(f'{order}I', body, position)
                    position += _LENGTH_SIZE
                    if given != array.count:
                        raise ValueError(self._wrong_length(given, array))
                position += -position % struct.calcsize(f'={array.code}')
                part = struct.Struct(f'{order}{array.count}{array.code}')
                values.extend(part.unpack_from(body, position))
                position += part.size
        except (ValueError, struct.error) as error:
            raise UserError(f'no valid {self.type_name} message: {error}') from error
        tick, valid, *rest = values
        return int(tick), seconds * NANOSECONDS_PER_SECOND + nanoseconds, int(valid), tuple(rest)

    @staticmethod
    def _wrong_length(given: int, array: _Array) -> str:
        return (
            f'a field has {given} values where this machine has {array.count}; is its sender '
            'started for the same machine?'
        )

    def records(self, messages: Sequence[bytes]) -> np.ndarray:
        """Return many messages as one structured array of shape (len(messages),)."""
        return np.frombuffer(b''.join(map(self.normalised, messages)), self.dtype)

    def records_of_rows(self, rows: np.ndarray) -> np.ndarray | None:
        """
        Return messages that are rows (n, `size`) of bytes as one structured array (n,).

        None if one of them has not the fixed layout; then `records` has to do it.
        """
        little_endian = rows[:, :2] == np.frombuffer(LITTLE_ENDIAN[:2], np.uint8)
        no_frame = rows[:, 12:16] == np.array([_FRAME_ID_LENGTH, 0, 0, 0], np.uint8)
        if not (little_endian.all() and no_frame.all()):
            return None
        for place, length in self._lengths:
            own = rows[:, place : place + len(length)]
            if not (own == np.frombuffer(length, np.uint8)).all():
                return None
        return np.ascontiguousarray(rows).view(self.dtype).ravel()

    def blank(self, count: int) -> np.ndarray:
        """Return `count` messages with all values zero, as a structured array to be filled in."""
        array = np.zeros(count, self.dtype)
        array['encapsulation'] = np.void(LITTLE_ENDIAN)
        array['frame_id_length'] = _FRAME_ID_LENGTH
        rows = array.view(np.uint8).reshape(count, self.size)
        for place, length in self._lengths:
            rows[:, place : place + len(length)] = np.frombuffer(length, np.uint8)
        return array


def wire_of(topic: Topic, layout: Layout) -> WireFormat:
    """Return the codec of a topic's messages for a machine."""
    places = len(topic.places(layout))
    return WireFormat(topic.type_for(layout), places, topic.most_places)


@dataclass(frozen=True)
class _Array:
    """The values of a field: their struct code, how many there are, and how that is written."""

    code: str
    count: int = 1
    is_array: bool = False
    is_sequence: bool = False


def _array(type_name: str, places: int, room: int) -> _Array:
    """Return the values of a field by its type: `float64`, `float64[3]`, or `float64[<=8]`."""
    scalar, _, rest = type_name.partition('[')
    text = rest.removesuffix(']').removeprefix('<=')
    if scalar not in _SCALARS or (rest and not text.isdigit()):
        raise TypeError(f'a field of type {type_name} has no fixed size')
    code = _SCALARS[scalar][0]
    if not rest:
        return _Array(code)
    if not rest.startswith('<='):
        return _Array(code, int(text), True)
    each, left = divmod(int(text), room)
    if left or not 1 <= places <= room:
        raise TypeError(
            f'a field of type {type_name} has no fixed size with {places} of {room} places'
        )
    return _Array(code, each * places, True, True)


class _Image:
    """
    Places fields one after another by the rules of CDR.

    `lengths` are those of the sequences: where in the message, with the encapsulation, and their bytes.
    """

    def __init__(self) -> None:
        self.format = '<4s'
        self.names: list[str] = []
        self.formats: list[Any] = []
        self.offsets: list[int] = []
        self.lengths: list[tuple[int, bytes]] = []
        self._position = 0  # counted from behind the encapsulation

    def add(self, name: str, array: _Array) -> None:
        if array.is_sequence:
            self._pad(_LENGTH_SIZE)
            place = len(LITTLE_ENDIAN) + self._position
            self.lengths.append((place, array.count.to_bytes(_LENGTH_SIZE, 'little')))
            self._skip(_LENGTH_SIZE)
        numpy_name = _NUMPY_NAMES[array.code]
        size = struct.calcsize('<' + array.code)
        self._pad(size)
        self.format += f'{array.count}{array.code}'
        self.names.append(name)
        self.formats.append(
            (f'<{numpy_name}', (array.count,)) if array.is_array else f'<{numpy_name}'
        )
        self.offsets.append(len(LITTLE_ENDIAN) + self._position)
        self._position += array.count * size

    def _pad(self, size: int) -> None:
        self._skip(-self._position % size)

    def _skip(self, count: int) -> None:
        self.format += f'{count}x' * bool(count)
        self._position += count
