# SPDX-License-Identifier: Apache-2.0
"""Recordings, read with the eyes of others: `mcap` with its ROS 2 decoder, and `rosbags`."""

from __future__ import annotations

import json
import os
import shutil
import signal

import numpy as np
import pytest
import yaml
from ament_index_python.packages import PackageNotFoundError, get_package_share_directory
from harness import called, waferbot
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from waferbot_lockstep.contract import AMPLIFIER_STATE, CONTRACT_TOPICS, PHASE_VOLTAGES
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.layout import SHIPPED
from waferbot_lockstep.timing import Timing
from waferbot_lockstep.wire import WireFormat
from waferbot_twin.cli.info import describe
from waferbot_twin.recording.completeness import Account, close_complete
from waferbot_twin.recording.reader import read_recording, recording_file
from waferbot_twin.recording.writer import RecordingWriter

TICKS = 9000
DIVIDERS = {
    '/phase_currents': 1,
    '/phase_voltages': 1,
    '/encoders': 2,
    '/current_command': 8,
    '/servo_state': 8,
}

pytestmark = pytest.mark.slow


@pytest.fixture(params=['ros', 'inprocess'])
def recording(request, recorded):
    return recorded(request.param)


def typestore_of(recording):
    """Return a Jazzy type store that knows our messages from the recording's own text only."""
    store = get_typestore(Stores.ROS2_JAZZY)
    with recording_file(recording.path).open('rb') as stream:
        for schema in make_reader(stream).get_summary().schemas.values():
            if schema.name not in store.fielddefs:
                types = get_types_from_msg(schema.data.decode(), schema.name)
                store.register({k: v for k, v in types.items() if k not in store.fielddefs})
    return store


def test_mcap_decodes_every_tick_once_and_in_order(recording):
    ticks = {name: [] for name in DIVIDERS}
    with recording_file(recording.path).open('rb') as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages(log_time_order=False):
            if channel.topic in ticks:
                ticks[channel.topic].append(decoded.tick)
                stamp = decoded.header.stamp.sec * 10**9 + decoded.header.stamp.nanosec
                assert stamp == decoded.tick * 500000 // 9 == message.log_time
                assert message.publish_time == message.log_time
    for name, divider in DIVIDERS.items():
        assert ticks[name] == list(range(0, TICKS, divider)), name


def test_mcap_profile_and_encodings(recording):
    with recording_file(recording.path).open('rb') as stream:
        reader = make_reader(stream)
        assert reader.get_header().profile == 'ros2'
        summary = reader.get_summary()
    assert {channel.message_encoding for channel in summary.channels.values()} == {'cdr'}
    assert {schema.encoding for schema in summary.schemas.values()} == {'ros2msg'}


def test_schemas_hold_the_full_text(recording):
    with recording_file(recording.path).open('rb') as stream:
        schemas = {
            s.name: s.data.decode() for s in make_reader(stream).get_summary().schemas.values()
        }
    share = get_package_share_directory('waferbot_msgs')
    for topic in CONTRACT_TOPICS:
        text = schemas[topic.type_name]
        with open(f'{share}/msg/{topic.message}.msg', encoding='utf-8') as installed:
            assert text.startswith(installed.read().rstrip('\n'))
        assert 'MSG: std_msgs/Header' in text
        assert 'MSG: builtin_interfaces/Time' in text


def test_rosbags_reads_it_with_the_same_values(recording):
    store = typestore_of(recording)
    counts = {}
    with AnyReader([recording.path], default_typestore=store) as reader:
        for connection, stamp, data in reader.messages():
            name = connection.topic
            counts[name] = counts.get(name, 0) + 1
            if name == '/phase_currents':
                message = store.deserialize_cdr(data, connection.msgtype)
                assert message.tick * 500000 // 9 == stamp
                np.testing.assert_array_equal(
                    message.current, recording['phase_currents']['current'][message.tick]
                )
    assert counts == recording.counts
    assert counts['/clock'] == 50


def has_package(name):
    """Return whether a ROS package is installed."""
    try:
        get_package_share_directory(name)
    except PackageNotFoundError:
        return False
    return True


def test_type_hashes_are_those_that_rosbags_computes(recording):
    store = typestore_of(recording)
    with Reader(recording.path) as reader:
        hashes = {c.msgtype: c.digest for c in reader.connections}
    assert set(hashes) >= {topic.type_name for topic in CONTRACT_TOPICS}
    for name, digest in hashes.items():
        assert digest == store.hash_rihs01(name), name
        package, kind, short = name.split('/')
        if package == 'tf2_msgs' and not has_package(package):
            continue  # PyPI has no wheel of it
        with open(f'{get_package_share_directory(package)}/{kind}/{short}.json') as stream:
            installed = {
                h['type_name']: h['hash_string'] for h in json.load(stream)['type_hashes']
            }
        assert digest == installed[name]


def test_metadata_is_what_rosbags_expects(recording):
    with Reader(recording.path) as reader:
        assert reader.message_count == sum(recording.counts.values())
        assert reader.start_time == 0
        assert reader.end_time - 1 == (TICKS - 1) * 500000 // 9
        assert {c.topic: c.msgcount for c in reader.connections} == recording.counts


def test_channel_offers_the_contract_quality_of_service(recording):
    with recording_file(recording.path).open('rb') as stream:
        for channel in make_reader(stream).get_summary().channels.values():
            (qos,) = yaml.safe_load(channel.metadata['offered_qos_profiles'])
            latched = channel.topic in ('/robot_description', '/tf_static')
            assert (qos['reliability'], qos['durability'], qos['history']) == (
                'reliable',
                'transient_local' if latched else 'volatile',
                'keep_last',
            )


def test_what_the_run_was_made_from_is_attached(recording):
    run = json.loads(recording.attachments['run.json'])
    assert run['seed'] == 0
    assert run['experiment'] == 'step'
    assert run['versions']['numpy'] == np.__version__
    assert 'git' in run['versions']
    model = yaml.safe_load(recording.attachments['model.yaml'])
    assert model['/**/plant']['ros__parameters']['description'] == 'rigid'
    assert model['/**/pmac']['ros__parameters']['y_linear']['Ixx30']
    assert yaml.safe_load(recording.attachments['experiment.yaml'])['name'] == 'step'


def test_the_recording_says_that_nothing_is_missing(recording):
    assert recording.summary['complete'] == 'true'
    assert recording.summary['missing'] == '0'
    expected = sum(
        len(range(0, TICKS, d)) * (4 if n == '/encoders' else 3) for n, d in DIVIDERS.items()
    )
    assert recording.summary['expected'] == str(expected + 50 * 3)


# ---- gaps ----------------------------------------------------------------------------------------


def write_with_hole(folder, topic, hole, ticks=400):
    """Write a recording in which `topic` lacks the tick `hole`; return the writer and account."""
    timing = Timing()
    account = Account(timing)
    writer = RecordingWriter(folder, {'run.json': '{}'}, live=True)
    for one in CONTRACT_TOPICS:
        wire = WireFormat(one.type_name)
        writer.add_topic(f'/{one.name}', one.type_name)
        width = len(wire.encode.__self__._struct.unpack(bytes(wire.size))) - 7
        for tick in range(0, ticks, account.topics[one].spacing):
            if one is topic and tick == hole:
                continue
            data = wire.encode(tick, timing.stamp_ns(tick), one.all_places(SHIPPED), [0] * width)
            account.topics[one].is_new(tick, one.all_places(SHIPPED))
            writer.write(f'/{one.name}', timing.stamp_ns(tick), data)
    return writer, account


def test_what_lacks_of_a_tick_that_was_broken_off_is_not_missing(tmp_path):
    writer, account = write_with_hole(tmp_path / 'run', PHASE_VOLTAGES, 399)
    assert close_complete(writer, account, account.reached()).startswith('0 missing of')
    assert describe(tmp_path / 'run')['missing'] == 0
    writer, account = write_with_hole(tmp_path / 'lost', PHASE_VOLTAGES, 399)
    with pytest.raises(UserError, match='phase_voltages: 3'):
        close_complete(writer, account, 400)
    assert describe(tmp_path / 'lost')['missing'] == 3


@pytest.mark.parametrize(
    ('topic', 'hole'), [(t, 8 * 20 if t is not AMPLIFIER_STATE else 180) for t in CONTRACT_TOPICS]
)
def test_a_gap_is_found_and_said(tmp_path, topic, hole):
    writer, account = write_with_hole(tmp_path / 'run', topic, hole)
    places = len(topic.places(SHIPPED))
    with pytest.raises(UserError, match=f'{places} missing of .*{topic.name}: {places}') as error:
        close_complete(writer, account, 400)
    assert f'everything up to tick {hole} is there' in str(error.value)
    recording = read_recording(tmp_path / 'run')
    assert recording.summary['complete'] == 'false'
    assert recording.summary['missing'] == str(places)
    info = json.loads(called('info', str(tmp_path / 'run'), '--json').stdout)
    assert info['missing'] == places


# ---- cut off -------------------------------------------------------------------------------------


def test_a_killed_run_leaves_a_readable_recording(tmp_path, start):
    out = tmp_path / 'killed'
    program = start(
        'waferbot_twin', 'run', '--engine', 'composed', '--out', str(out), '--duration', '100'
    )

    def file_kilobytes():
        files = list(out.glob('*.mcap'))
        return files[0].stat().st_size / 1024 if files else 0

    from harness import wait_until

    wait_until(lambda: file_kilobytes() > 1000, 'a megabyte recorded', program)
    program.signal(signal.SIGKILL)
    program.wait()
    recording = read_recording(out)
    assert not recording.closed
    ticks = recording['phase_currents']['tick']
    assert len(ticks) > 2000
    np.testing.assert_array_equal(ticks, np.arange(len(ticks)))
    assert 'model.yaml' in recording.attachments
    info = waferbot('info', str(out))
    assert info.returncode == 0
    assert 'cut off' in info.stdout


@pytest.mark.parametrize('share', [0.999, 0.9, 0.5, 0.2])
def test_a_truncated_file_is_read_as_far_as_it_goes(tmp_path, recorded, share):
    whole = recorded('inprocess')
    cut = tmp_path / 'cut.mcap'
    shutil.copy(recording_file(whole.path), cut)
    os.truncate(cut, int(share * cut.stat().st_size))
    recording = read_recording(cut)
    assert not recording.closed
    array = recording['phase_voltages']
    assert len(array) > (share - 0.15) * TICKS
    np.testing.assert_array_equal(array, whole['phase_voltages'][: len(array)])
    assert 'cut off' in called('info', str(cut)).stdout


# ---- what is no recording ------------------------------------------------------------------------


def garbage(path):
    path.write_bytes(bytes(range(256)) * 40)


def empty(path):
    path.write_bytes(b'')


def only_magic(path):
    path.write_bytes(b'\x89MCAP0\r\n')


@pytest.mark.parametrize('content', [garbage, empty, only_magic])
def test_a_file_that_is_no_recording_gives_one_clear_line(tmp_path, content):
    path = tmp_path / 'bad.mcap'
    content(path)
    result = called('info', str(path))
    assert result.returncode == 1
    assert result.stderr.startswith('waferbot: error: ')
    assert str(path) in result.stderr
    assert result.stderr.count('\n') == 1


def test_a_damaged_chunk_gives_what_came_before(tmp_path, recorded):
    path = tmp_path / 'damaged.mcap'
    shutil.copy(recording_file(recorded('inprocess').path), path)
    with path.open('r+b') as stream:
        chunks = make_reader(stream).get_summary().chunk_indexes
        chunk = chunks[len(chunks) // 2]
        stream.seek(chunk.chunk_start_offset + chunk.chunk_length // 2)
        stream.write(b'\xff' * 64)
    damaged = read_recording(path)
    array = damaged['phase_voltages']
    assert 0 < len(array) < TICKS
    np.testing.assert_array_equal(array, recorded('inprocess')['phase_voltages'][: len(array)])
    result = called('info', str(path))
    assert result.returncode == 0
    assert 'cut off' in result.stdout


def test_a_single_flipped_bit_is_not_taken_for_a_measurement(tmp_path):
    path = tmp_path / 'flipped.mcap'
    payload = b'\0\1\0\0\x0c\0\0\0hello world\0'
    with path.open('wb') as stream:
        writer = Writer(stream, compression=CompressionType.NONE)
        writer.start('ros2', 'somebody')
        schema = writer.register_schema('std_msgs/msg/String', 'ros2msg', b'string data')
        channel = writer.register_channel('/chatter', 'cdr', schema)
        writer.add_message(channel, 5, payload, 5)
        writer.finish()
    content = path.read_bytes()
    assert called('info', str(path)).returncode == 0
    path.write_bytes(content.replace(b'hello', b'hallo', 1))
    result = called('info', str(path))
    assert result.returncode == 1
    assert result.stderr.startswith('waferbot: error: ')


def test_a_foreign_recording_is_described(tmp_path):
    path = tmp_path / 'foreign.mcap'
    with path.open('wb') as stream:
        writer = Writer(stream)
        writer.start('ros2', 'somebody')
        schema = writer.register_schema('std_msgs/msg/String', 'ros2msg', b'string data')
        channel = writer.register_channel('/chatter', 'cdr', schema)
        writer.add_message(channel, 5, b'\0\1\0\0\2\0\0\0a\0', 5)
        writer.finish()
    result = called('info', str(path))
    assert result.returncode == 0, result.stderr
    assert '/chatter' in result.stdout
    replay = called('replay', str(path), '--node', 'pmac')
    assert replay.returncode == 1
    assert replay.stderr.startswith('waferbot: error: ')


def test_another_definition_of_a_contract_message_is_refused(tmp_path):
    path = tmp_path / 'old.mcap'
    with path.open('wb') as stream:
        writer = Writer(stream)
        writer.start('ros2', 'somebody')
        schema = writer.register_schema('waferbot_msgs/msg/Encoders', 'ros2msg', b'int64 counts')
        channel = writer.register_channel(
            '/encoders', 'cdr', schema, {'topic_type_hash': 'RIHS01_' + '0' * 64}
        )
        writer.add_message(channel, 5, b'\0\1\0\0' + bytes(8), 5)
        writer.finish()
    result = called('info', str(path))
    assert result.returncode == 1
    assert 'another definition' in result.stderr


# ---- never overwriting ---------------------------------------------------------------------------


def test_out_never_overwrites_without_force(tmp_path):
    out = tmp_path / 'run'
    run = ['run', '--engine', 'inprocess', '--duration', '0.01', '--out', str(out)]
    assert called(*run).returncode == 0
    before = recording_file(out).read_bytes()
    again = called(*run)
    assert again.returncode == 1
    assert 'exists already' in again.stderr
    assert recording_file(out).read_bytes() == before
    assert called(*run, '--force').returncode == 0


def test_force_replaces_recordings_only(tmp_path):
    (tmp_path / 'thesis').mkdir()
    (tmp_path / 'thesis' / 'chapter.txt').write_text('years of work')
    out = str(tmp_path / 'thesis')
    result = called('run', '--engine', 'inprocess', '--duration', '0.01', '--out', out, '--force')
    assert result.returncode == 1
    assert 'it holds chapter.txt, which waferbot did not write' in result.stderr
    assert (tmp_path / 'thesis' / 'chapter.txt').read_text() == 'years of work'


def test_out_below_a_file_gives_one_clear_line(tmp_path):
    (tmp_path / 'file').write_text('')
    out = str(tmp_path / 'file' / 'run')
    result = called('run', '--engine', 'inprocess', '--duration', '0.01', '--out', out)
    assert result.returncode == 1
    assert result.stderr.startswith('waferbot: error: ')
    assert 'Traceback' not in result.stderr
