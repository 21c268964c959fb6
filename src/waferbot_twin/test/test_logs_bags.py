# SPDX-License-Identifier: Apache-2.0
"""Recordings as logs: written by `rosbags`, with values that are known; and what is written back."""

from __future__ import annotations

import json
import shutil
import sqlite3

import numpy as np
import pytest
from ament_index_python.packages import get_package_share_directory
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import Writer as McapWriter
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from waferbot_lockstep.errors import UserError
from waferbot_plant.plant import load_machine
from waferbot_twin.cli.main import main
from waferbot_twin.logs.archive import write_archive
from waferbot_twin.logs.load import load_log
from waferbot_twin.logs.mapping import mapping_text
from waferbot_twin.models import load_model
from waferbot_twin.recording.reader import recording_file

STEP_NS = 2_000_000
EPOCH_NS = 1_700_000_000 * 10**9
COUNT = 200
TIME = np.arange(COUNT) * STEP_NS * 1e-9
PLACE, SPEED, FORCE = np.sin(9.0 * TIME), 9.0 * np.cos(9.0 * TIME), 3.0 * np.sin(9.0 * TIME)

STORE = get_typestore(Stores.ROS2_JAZZY)


def stamp(ns):
    time = STORE.types['builtin_interfaces/msg/Time']
    return time(sec=int(ns // 10**9), nanosec=int(ns % 10**9))


def header(ns):
    return STORE.types['std_msgs/msg/Header'](stamp=stamp(ns), frame_id='')


def joint_states(
    path, names=('spare', 'x_rotate'), plugin=StoragePlugin.MCAP, start=EPOCH_NS, effort=True
):
    """Write a recording of joint states; the first joint stands still."""
    kind = 'sensor_msgs/msg/JointState'
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        connection = writer.add_connection('/joint_states', kind, typestore=STORE)
        for row in range(COUNT):
            ns = start + row * STEP_NS
            message = STORE.types[kind](
                header=header(ns),
                name=list(names),
                position=np.array([0.0, PLACE[row]]),
                velocity=np.array([0.0, SPEED[row]]),
                effort=np.array([0.0, FORCE[row]] if effort else []),
            )
            writer.write(connection, ns + 12345, STORE.serialize_cdr(message, kind))
    return path


def same_bits(one, other) -> bool:
    """Tell whether two logs are equal in everything."""
    signals = zip(one.signals, other.signals, strict=True)
    return (one.name, one.source, one.digest, one.mapping, one.origin_ns, one.findings) == (
        other.name, other.source, other.digest, other.mapping, other.origin_ns, other.findings
    ) and all(
        (a.kind, a.axis, a.unit, a.resolution) == (b.kind, b.axis, b.unit, b.resolution)
        and a.time_s.tobytes() == b.time_s.tobytes()
        and a.value.tobytes() == b.value.tobytes()
        for a, b in signals
    )  # fmt: skip


@pytest.mark.parametrize('plugin', [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_joint_states_need_no_mapping(tmp_path, plugin) -> None:
    log = load_log(joint_states(tmp_path / 'bag', plugin=plugin))
    assert [signal.name for signal in log.signals] == [
        'x_rotate.position', 'x_rotate.velocity', 'x_rotate.force'
    ]  # fmt: skip
    assert log['x_rotate', 'position'].value.tobytes() == PLACE.tobytes()
    assert log['x_rotate', 'force'].value.tobytes() == FORCE.tobytes()
    assert log['x_rotate', 'force'].unit == 'Nm'
    assert log['x_rotate', 'position'].time_s == pytest.approx(TIME, abs=1e-12)
    assert log.origin_ns == EPOCH_NS
    assert not log.findings


@pytest.mark.parametrize('given', ['folder', 'file'])
def test_a_database_without_metadata_is_told_how_to_get_it(tmp_path, given) -> None:
    bag = joint_states(tmp_path / 'bag', plugin=StoragePlugin.SQLITE3)
    (bag / 'metadata.yaml').unlink()
    with pytest.raises(UserError) as told:
        load_log(bag if given == 'folder' else bag / 'bag.db3')
    assert 'bag.db3: metadata.yaml is missing' in str(told.value)
    assert f'ros2 bag reindex -s sqlite3 {bag}' in str(told.value)
    (bag / 'metadata.yaml').write_text('')
    with pytest.raises(UserError, match=f'delete it.*ros2 bag reindex {bag}'):
        load_log(bag)


def test_joints_by_the_names_of_a_description(tmp_path) -> None:
    bag = joint_states(tmp_path / 'bag', ('spare', 'pendulum_angle'))
    with pytest.raises(UserError, match='no joint state of an axis'):
        load_log(bag)
    log = load_log(bag, machine='geared_pendulum')
    assert log['y_rotate', 'force'].value.tobytes() == FORCE.tobytes()


def test_a_mapping_of_any_numeric_topic(tmp_path) -> None:
    text = """
signals:
  - {column: '/joint_states:position[elbow]', kind: position, axis: y_rotate, unit: deg}
  - {column: 'joint_states:effort[1]', kind: current, axis: y_rotate, unit: mA, sign: -1}
"""
    bag = joint_states(tmp_path / 'bag', ('spare', 'elbow'))
    log = load_log(bag, mapping_text(text))
    assert log['y_rotate', 'position'].value == pytest.approx(np.radians(PLACE), rel=1e-12)
    assert log['y_rotate', 'current'].value == pytest.approx(-1e-3 * FORCE, rel=1e-12)
    for old, new, wanted in (
        ('position[elbow]', 'positon[elbow]', "no field 'positon'; did you mean 'position'"),
        ('/joint_states', '/joint_state', "no topic '/joint_state'; did you mean '/joint_states'"),
        (':position[elbow]', '', 'TOPIC:FIELD'),
    ):
        with pytest.raises(UserError, match=wanted.replace('[', r'\[')):
            load_log(bag, mapping_text(text.replace(old, new, 1)))


def test_joint_states_without_effort_are_not_enough(tmp_path) -> None:
    with pytest.raises(UserError, match='not enough to work with'):
        load_log(joint_states(tmp_path / 'bag', effort=False))


def in_small_chunks(bag, path):
    """Copy a recording into one whose chunks hold a few messages each."""
    with recording_file(bag).open('rb') as source, path.open('wb') as target:
        writer = McapWriter(target, chunk_size=1000)
        writer.start('ros2', 'test')
        known = {}
        for schema, channel, message in make_reader(source).iter_messages():
            if channel.topic not in known:
                place = writer.register_schema(schema.name, schema.encoding, schema.data)
                known[channel.topic] = writer.register_channel(channel.topic, 'cdr', place)
            writer.add_message(
                known[channel.topic], message.log_time, message.data, message.log_time
            )
        writer.finish()
    return path.read_bytes()


@settings(deadline=None, max_examples=40)
@given(share=st.floats(0.4, 0.9), damage=st.booleans())
def test_a_recording_cut_off_or_damaged_is_used_up_to_there(
    tmp_path_factory, share, damage
) -> None:
    folder = tmp_path_factory.mktemp('cut')
    data = in_small_chunks(joint_states(folder / 'bag'), folder / 'whole.mcap')
    with (folder / 'whole.mcap').open('rb') as stream:
        last_chunk = make_reader(stream).get_summary().chunk_indexes[-1].chunk_start_offset
    place = int(share * last_chunk)
    path = folder / 'cut.mcap'
    path.write_bytes(data[:place] + (b'\xff' * 40 + data[place + 40 :] if damage else b''))
    log = load_log(path)
    position = log['x_rotate', 'position']
    rows = np.rint(position.time_s / (STEP_NS * 1e-9)).astype(int)
    assert position.value.tobytes() == PLACE[rows].tobytes()
    # Damage may hit what only leads to the messages; cutting off always takes some away.
    assert 16 <= len(rows) <= COUNT - (not damage)
    told = str(log.findings)
    assert len(rows) == COUNT or 'cut off or damaged' in told or 'gaps in time' in told


@pytest.mark.parametrize('time', ["'late'", 'null'])
def test_a_message_of_a_database_whose_time_is_no_number_is_refused(tmp_path, time) -> None:
    (file,) = joint_states(tmp_path / 'bag', plugin=StoragePlugin.SQLITE3).glob('*.db3')
    with sqlite3.connect(file) as database:
        database.execute('CREATE TABLE lax AS SELECT * FROM messages')
        database.execute(f'UPDATE lax SET timestamp = {time} WHERE id = 7')
        database.execute('DROP TABLE messages')
        database.execute('ALTER TABLE lax RENAME TO messages')
    database.close()
    with pytest.raises(UserError, match='the time of a message of /joint_states is'):
        load_log(tmp_path / 'bag')


def test_a_file_that_is_no_recording(tmp_path) -> None:
    text = tmp_path / 'text.mcap'
    text.write_text('no recording')
    with pytest.raises(UserError, match='no MCAP file'):
        load_log(text)


@pytest.mark.parametrize('start', [0, EPOCH_NS])
def test_what_is_written_reads_back_to_the_bit(tmp_path, start) -> None:
    log = load_log(joint_states(tmp_path / 'bag', start=start))
    write_archive(log, tmp_path / 'out')
    assert same_bits(log, load_log(tmp_path / 'out'))
    with pytest.raises(UserError, match='exists already'):
        write_archive(log, tmp_path / 'out')


def test_times_before_a_trigger_survive(tmp_path) -> None:
    path = tmp_path / 'log.csv'
    np.savetxt(path, np.column_stack([TIME - 0.1234, PLACE, FORCE]), '%.17g', ',')
    text = """
time: {column: 1, unit: s}
signals:
  - {column: 2, kind: position, axis: x_rotate, unit: rad}
  - {column: 3, kind: torque, axis: x_rotate, unit: Nm}
"""
    log = load_log(path, mapping_text(text))
    write_archive(log, tmp_path / 'out')
    back = load_log(tmp_path / 'out')
    assert same_bits(log, back)
    assert back.mapping == text
    assert back['x_rotate', 'position'].time_s[0] == -0.1234


def test_others_read_what_is_written(tmp_path) -> None:
    """`mcap` with its ROS 2 decoder and `rosbags`, from the definitions in the file alone."""
    log = load_log(joint_states(tmp_path / 'bag'))
    write_archive(log, tmp_path / 'out')
    seen, last = [], 0
    with recording_file(tmp_path / 'out').open('rb') as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages(log_time_order=False):
            assert message.log_time >= last
            last = message.log_time
            if channel.topic == '/measured/x_rotate/force':
                ns = decoded.header.stamp.sec * 10**9 + decoded.header.stamp.nanosec
                assert ns == message.log_time == EPOCH_NS + len(seen) * STEP_NS
                seen.append(decoded.value)
        attached = {item.name: item.data for item in reader.iter_attachments()}
    assert seen == FORCE.tolist()
    about = json.loads(attached['measured.json'])
    assert [signal['unit'] for signal in about['signals']] == ['rad', 'rad/s', 'Nm']
    with AnyReader([tmp_path / 'out']) as other:
        values = [
            other.deserialize(data, connection.msgtype).value
            for connection, _, data in other.messages()
            if connection.topic == '/measured/x_rotate/position'
        ]
    assert values == PLACE.tolist()


def test_an_imported_log_that_is_cut_off_says_so(tmp_path) -> None:
    log = load_log(joint_states(tmp_path / 'bag'))
    write_archive(log, tmp_path / 'out')
    file = recording_file(tmp_path / 'out')
    with pytest.raises(UserError, match='needs no mapping'):
        load_log(
            tmp_path / 'out',
            mapping_text('signals: [{column: a:b, kind: current, axis: x_rotate, unit: A}]'),
        )
    (tmp_path / 'cut.mcap').write_bytes(file.read_bytes()[:-2000])
    back = load_log(tmp_path / 'cut.mcap')
    assert len(back['x_rotate', 'force'].time_s) <= COUNT


# The contract's topics, with currents whose parts are known.

TICKS = 1800
HZ = 18000
DRIVING, DIRECT = 3.0, -0.75


def contract_types():
    store = get_typestore(Stores.ROS2_JAZZY)
    for name in ('Encoders', 'PhaseCurrents', 'CurrentCommand', 'PhaseVoltages', 'ServoState'):
        text = f'{get_package_share_directory("waferbot_msgs")}/msg/{name}.msg'
        with open(text, encoding='utf-8') as file:
            store.register(get_types_from_msg(file.read(), f'waferbot_msgs/msg/{name}'))
    return store


@pytest.fixture(scope='module')
def contract_bag(tmp_path_factory):
    """A recording of encoders, phase currents and voltages, and commands; axis 1 only, no settings."""
    store = contract_types()
    path = tmp_path_factory.mktemp('contract') / 'bag'
    counts_per_cycle = 2.0**20 / 11
    counts = np.floor(4e5 * np.sin(6.0 * np.arange(TICKS) / HZ)).astype(np.int64)
    held = counts[np.arange(TICKS) // 2 * 2]
    theta = 2.0 * np.pi * held / counts_per_cycle

    def lines(tick):
        angle = theta[tick] - 2.0 * np.pi * np.arange(3) / 3.0
        strength = DRIVING + 0.01 * (tick % 8)
        return strength * np.sin(angle) + DIRECT * np.cos(angle)

    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:

        def write(topic, name, tick, **fields):
            kind = f'waferbot_msgs/msg/{name}'
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            ns = tick * 500000 // 9
            time = store.types['builtin_interfaces/msg/Time'](ns // 10**9, ns % 10**9)
            head = store.types['std_msgs/msg/Header'](stamp=time, frame_id='')
            message = store.types[kind](header=head, tick=tick, valid=2, **fields)
            writer.write(connections[topic], ns, store.serialize_cdr(message, kind))

        connections = {}
        for tick in range(TICKS):
            if tick % 2 == 0:
                write('/encoders', 'Encoders', tick, counts=np.array([0, counts[tick], 0, 0]))
            if tick == 900:
                continue  # one message is lost
            two = lines(tick)[:2]
            write(
                '/phase_currents',
                'PhaseCurrents',
                tick,
                current=np.array([9.0, 9.0, *two, 9.0, 9.0]),
            )
            three = 10.0 * lines(tick) + 55.0  # their common part drives nothing
            write(
                '/phase_voltages', 'PhaseVoltages', tick,
                voltage=np.array([9.0] * 3 + list(three) + [9.0] * 3), open=0b101,
            )  # fmt: skip
            if tick % 8 == 0:
                write(
                    '/current_command', 'CurrentCommand', tick, current=np.array([9.0, tick, 9.0])
                )
                write(
                    '/servo_state', 'ServoState', tick,
                    commanded_position=np.array([9.0, 1e3 * tick, 9.0]),
                    following_error=np.array([9.0, 2.0**20, 9.0]),
                    output=np.array([9.0, 16384.0, 9.0]), integrator=np.zeros(3),
                    flags=np.zeros(3, np.uint8),
                )  # fmt: skip
    return path, counts


def test_contract_topics_of_one_axis(contract_bag) -> None:
    path, counts = contract_bag
    with pytest.raises(UserError, match='give --model'):
        load_log(path)
    log = load_log(path, model='rigid')
    assert log.axes() == ('x_rotate',)
    radian = 2.0 * np.pi / 2**20
    position = log['x_rotate', 'position']
    assert position.value == pytest.approx(counts[::2] * radian, rel=1e-12, abs=1e-15)
    assert position.time_s == pytest.approx(np.arange(0, TICKS, 2) / HZ - 2 / HZ, abs=1e-15)
    assert position.resolution == pytest.approx(radian)
    cycles = np.delete(np.arange(TICKS // 8), 900 // 8)
    current = log['x_rotate', 'current']
    assert current.time_s == pytest.approx((8 * cycles + 3.5) / HZ, abs=1e-15)
    assert current.value == pytest.approx(np.full(len(cycles), DRIVING + 0.035), abs=1e-9)
    assert log['x_rotate', 'direct_current'].value == pytest.approx(
        np.full(len(cycles), DIRECT), abs=1e-9
    )
    voltage = log['x_rotate', 'voltage_q']
    assert voltage.time_s == pytest.approx((8 * cycles + 4.0) / HZ, abs=1e-15)
    assert voltage.value == pytest.approx(np.full(len(cycles), 10 * DRIVING + 0.35), abs=1e-8)
    assert len(current.gaps()) == 1
    servo = np.arange(0, TICKS, 8)
    assert log['x_rotate', 'commanded_position'].value == pytest.approx(1e3 * servo * radian)
    assert log['x_rotate', 'following_error'].value == pytest.approx(
        np.full(len(servo), 2.0 * np.pi)
    )
    assert set(log['x_rotate', 'drive_command'].value) == {0.5}
    assert log['x_rotate', 'current_command'].value.tolist() == servo.tolist()


def test_contract_bag_agrees_with_its_model() -> None:
    """The constants used above are those of the model: 2^20 counts, 11 pole pairs."""
    model = load_model('rigid')
    settings = model.parameters['copley']['x_rotate']
    assert settings['counts_per_electrical_cycle'] == pytest.approx(2.0**20 / 11)
    assert load_machine(model.description).description.encoders['x_rotate'].counts_per_unit == (
        pytest.approx(2.0**20 / (2.0 * np.pi))
    )


def test_our_own_recording_by_command(tmp_path, capsys) -> None:
    """A run, imported: the same positions, and current that follows its command."""
    run = tmp_path / 'run'
    arguments = ['--experiment', 'step_x_rotate', '--duration', '0.1', '--out', str(run)]
    assert main(['run', '--engine', 'inprocess', '--model', 'rigid', *arguments]) == 0
    capsys.readouterr()
    assert main(['import', str(run), '--out', str(tmp_path / 'log'), '--json']) == 0
    told = json.loads(capsys.readouterr().out)
    assert told['usable_axes'] == ['y_linear', 'x_rotate', 'y_rotate']
    assert main(['info', str(tmp_path / 'log'), '--json']) == 0
    again = json.loads(capsys.readouterr().out)
    assert again['signals'] == told['signals']
    assert main(['plot', str(tmp_path / 'log')]) == 0
    assert (tmp_path / 'log' / 'plot.png').read_bytes().startswith(b'\x89PNG')
    log = load_log(tmp_path / 'log')
    moving = log['x_rotate', 'current_command']
    held, known = moving.at(log['x_rotate', 'current'].time_s)
    error = (log['x_rotate', 'current'].value - held)[known]
    assert np.sqrt(np.mean(error**2)) < 0.2 * np.abs(moving.value).max()
    assert log.get('y_rotate', 'motor_position') is not None
    first = recording_file(tmp_path / 'log').read_bytes()
    assert main(['import', str(run), '--out', str(tmp_path / 'log')]) == 1
    assert 'exists already' in capsys.readouterr().err
    assert main(['import', str(run), '--out', str(tmp_path / 'log'), '--force']) == 0
    assert recording_file(tmp_path / 'log').read_bytes() == first
    assert main(['import', str(run), '--out', str(run), '--force']) == 1
    assert 'would replace the log itself' in capsys.readouterr().err
    assert main(['import', str(recording_file(run)), '--out', str(run), '--force']) == 1
    shutil.rmtree(tmp_path / 'log')
    assert main(['import', str(tmp_path / 'nothing'), '--out', str(tmp_path / 'log')]) == 1
    assert 'does not exist' in capsys.readouterr().err
