# SPDX-License-Identifier: Apache-2.0
"""Our CDR against rclpy's own serialization."""

import array
import re
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState

import waferbot_msgs.msg
from waferbot_lockstep.contract import CONTRACT_TOPICS, ENCODERS_TOPIC, PHASE_VOLTAGES, PLANT_STATE
from waferbot_lockstep.definitions import field_types
from waferbot_lockstep.definitions_file import definitions_text
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.layout import SHIPPED, Layout
from waferbot_lockstep.package_data import package_data
from waferbot_lockstep.standard_messages import clock_message, joint_state_message, stamp_of
from waferbot_lockstep.wire import WireFormat
from waferbot_lockstep.wire import wire_of as wire_for

TYPES = [getattr(waferbot_msgs.msg, topic.message) for topic in CONTRACT_TOPICS]

RANGES = {
    'uint8': st.integers(0, 2**8 - 1),
    'uint32': st.integers(0, 2**32 - 1),
    'int64': st.integers(-(2**63), 2**63 - 1),
    'double': st.floats(allow_nan=False),
}


def wire_of(message_type):
    return WireFormat(f'waferbot_msgs/msg/{message_type.__name__}')


def fields_behind_valid(message_type):
    return list(message_type.get_fields_and_field_types().items())[3:]


def any_message(message_type):
    """A strategy for messages of a type, as the real class."""

    @st.composite
    def build(draw):
        message = message_type()
        message.header.stamp.sec = draw(st.integers(0, 2**31 - 1))
        message.header.stamp.nanosec = draw(st.integers(0, 10**9 - 1))
        message.tick = draw(st.integers(0, 2**64 - 1))
        message.valid = draw(st.integers(0, 255))
        for name, type_name in fields_behind_valid(message_type):
            scalar, _, count = type_name.partition('[')
            if not count:
                setattr(message, name, draw(RANGES[scalar]))
                continue
            values = draw(
                st.lists(RANGES[scalar], min_size=int(count[:-1]), max_size=int(count[:-1]))
            )
            getattr(message, name)[:] = np.array(values, getattr(message, name).dtype)
        return message

    return build()


def flat_values(message):
    return tuple(
        value
        for name, _ in fields_behind_valid(type(message))
        for value in np.atleast_1d(getattr(message, name)).tolist()
    )


@pytest.mark.parametrize('message_type', TYPES, ids=lambda cls: cls.__name__)
def test_bytes_are_those_of_rclpy(message_type):
    wire = wire_of(message_type)

    @settings(max_examples=30, deadline=None)
    @given(any_message(message_type))
    def check(message):
        stamp_ns = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
        ours = wire.encode(message.tick, stamp_ns, message.valid, flat_values(message))
        theirs = serialize_message(message)
        assert deserialize_message(ours, message_type) == message
        assert wire.decode(theirs) == (message.tick, stamp_ns, message.valid, flat_values(message))
        assert wire.decode(ours) == wire.decode(theirs)

    check()


@pytest.mark.parametrize('message_type', TYPES, ids=lambda cls: cls.__name__)
def test_structured_array_is_the_same_message(message_type):
    wire = wire_of(message_type)
    message = message_type(tick=8, valid=5)
    message.header.stamp.nanosec = 444444
    for index, (name, _) in enumerate(fields_behind_valid(message_type)):
        values = getattr(message, name)
        if isinstance(values, int):
            setattr(message, name, 3)
        else:
            values[:] = np.arange(len(values)) + index + 1
    record = wire.records([serialize_message(message)])
    assert record.shape == (1,)
    assert (record['tick'][0], record['valid'][0]) == (8, 5)
    blank = wire.blank(1)
    for name in ('stamp_nanosec', 'tick', 'valid', *dict(fields_behind_valid(message_type))):
        blank[name] = record[name]
    assert deserialize_message(blank.tobytes(), message_type) == message


def test_message_with_frame_id_is_understood():
    message = waferbot_msgs.msg.Encoders(tick=2, valid=15)
    message.counts[:] = [1, -2, 3, -4]
    message.header.frame_id = 'somebody else'
    wire = WireFormat('waferbot_msgs/msg/Encoders')
    data = serialize_message(message)
    assert not wire.is_plain(data)
    assert wire.decode(data) == (2, 0, 15, (1, -2, 3, -4))
    assert wire.is_plain(wire.normalised(data))


@pytest.mark.parametrize('message_type', TYPES, ids=lambda cls: cls.__name__)
def test_big_endian_messages_of_any_frame_are_understood(message_type):
    """Against a packer of its own, by the rules of CDR: each value aligned to its size."""
    codes = {'uint8': 'B', 'uint32': 'I', 'uint64': 'Q', 'int64': 'q', 'double': 'd'}
    wire = wire_of(message_type)
    for frame in ('', 'a', 'base_link'):
        text = frame.encode() + b'\0'
        body = struct.pack('>iII', 5, 7, len(text)) + text
        values = []
        for index, (_, kind) in enumerate(
            list(message_type.get_fields_and_field_types().items())[1:]
        ):
            scalar, _, count = kind.partition('[')
            size = struct.calcsize(codes[scalar])
            body += bytes(-len(body) % size)
            for place in range(int(count[:-1]) if count else 1):
                values.append(3 * index + place + 1)
                body += struct.pack('>' + codes[scalar], values[-1])
        decoded = wire.decode(b'\0\0\0\0' + body)
        assert decoded == (values[0], 5 * 10**9 + 7, values[1], tuple(values[2:]))
        assert wire.decode(wire.normalised(b'\0\0\0\0' + body)) == decoded


def machine_of(axes):
    """A layout with so many axes, of which every other one has two encoders."""
    names = tuple(f'axis_{place}' for place in range(axes))
    encoders = tuple(
        name
        for place, axis in enumerate(names)
        for name in ((f'{axis}_load', f'{axis}_motor') if place % 2 else (axis,))
    )
    return Layout(names, encoders)


def own_message(topic, layout):
    """A message of a machine with axes of its own, as the real class, full of distinct values."""
    message = getattr(waferbot_msgs.msg, topic.type_for(layout).rpartition('/')[2])(
        tick=8, valid=1
    )
    message.header.stamp.nanosec = 444444
    places = len(topic.places(layout))
    for index, (name, kind) in enumerate(fields_behind_valid(type(message))):
        bound = re.search(r', (\d+)>', kind)
        if bound is not None:
            count = int(bound[1]) // topic.most_places * places
        elif '[' in kind:
            count = len(getattr(message, name))
        else:
            setattr(message, name, 1)
            continue
        whole = 'double' not in kind
        values = [index + place + (0 if whole else 0.5) for place in range(count)]
        setattr(message, name, values)
    return message


@pytest.mark.parametrize('topic', [*CONTRACT_TOPICS, PLANT_STATE], ids=lambda topic: topic.name)
@pytest.mark.parametrize('axes', range(1, 9))
def test_bytes_of_machines_with_axes_of_their_own_are_those_of_rclpy(topic, axes):
    """Whatever padding the lengths of sequences and their values need."""
    layout = machine_of(axes)
    wire, message = wire_for(topic, layout), own_message(topic, layout)
    theirs, values = serialize_message(message), flat_values(message)
    ours = wire.encode(8, 444444, 1, values)
    assert deserialize_message(ours, type(message)) == message
    assert wire.decode(theirs) == wire.decode(ours) == (8, 444444, 1, values)
    assert wire.is_plain(theirs)
    assert wire.decode(wire.normalised(theirs)) == wire.decode(ours)
    record = wire.records([theirs])
    blank = wire.blank(2)[1:]
    for name in ('stamp_nanosec', 'tick', 'valid', *wire.value_fields):
        blank[name] = record[name]
    assert deserialize_message(blank.tobytes(), type(message)) == message
    rows = np.frombuffer(ours * 3, np.uint8).reshape(3, wire.size)
    assert (wire.records_of_rows(rows) == np.repeat(record, 3)).all()
    framed = message
    framed.header.frame_id = 'somebody else'
    assert wire.decode(serialize_message(framed)) == (8, 444444, 1, values)


@pytest.mark.parametrize('topic', [ENCODERS_TOPIC, PHASE_VOLTAGES], ids=lambda topic: topic.name)
def test_a_message_of_a_machine_with_more_or_fewer_axes_is_refused(topic):
    wire = wire_for(topic, machine_of(4))
    for axes in (3, 5):
        other = own_message(topic, machine_of(axes))
        with pytest.raises(UserError, match='started for the same machine'):
            wire.decode(serialize_message(other))
        assert not wire.is_plain(serialize_message(other))


def test_the_shipped_machine_has_the_messages_of_old():
    for topic in (*CONTRACT_TOPICS, PLANT_STATE):
        assert wire_for(topic, SHIPPED).type_name == f'waferbot_msgs/msg/{topic.message}'
        assert wire_for(topic, machine_of(3)).type_name == f'waferbot_msgs/msg/Axes{topic.message}'


def test_definitions_are_those_that_rosidl_installs():
    """If this fails, a message was changed: python -m waferbot_lockstep.definitions_file."""
    kept = package_data('waferbot_lockstep', 'definitions.json').read_text('utf-8')
    assert definitions_text() == kept
    for message_type, topic in zip(TYPES, CONTRACT_TOPICS, strict=True):
        fields = message_type.get_fields_and_field_types()
        spelt = {name: kind.replace('double', 'float64') for name, kind in fields.items()}
        assert field_types(topic.type_name) == spelt


def test_bytes_that_are_no_message_are_refused():
    with pytest.raises(UserError, match='Encoders'):
        WireFormat('waferbot_msgs/msg/Encoders').decode(b'\x00\x01\x00\x00\x07')


def test_type_without_fixed_size_is_refused():
    with pytest.raises(TypeError):
        WireFormat('waferbot_msgs/msg/Stop')


def test_joint_state_and_clock_are_those_of_rclpy():
    names = ['y_linear', 'x_rotate', 'y']
    data = joint_state_message(3 * 10**9 + 7, names, [1.0, 2.0, 3.0], [4.0, 5.0, 6.0])
    message = deserialize_message(data, JointState)
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (3, 7)
    assert message.name == names
    assert message.position == array.array('d', [1, 2, 3])
    assert message.velocity == array.array('d', [4, 5, 6])
    assert message.effort == array.array('d')
    assert stamp_of(data) == 3 * 10**9 + 7
    assert stamp_of(clock_message(123456789012)) == 123456789012
