# SPDX-License-Identifier: Apache-2.0
"""The promise that holds the architecture together: every engine gives the same bits."""

from __future__ import annotations

import random

import pytest
from harness import parameter_files, run_engine
from mcap.stream_reader import StreamReader
from std_srvs.srv import SetBool

from waferbot_lockstep.contract import ENCODERS_TOPIC, LOCKSTEP_TOPICS, PHASE_VOLTAGES
from waferbot_lockstep.timing import Timing
from waferbot_lockstep.wire import WireFormat
from waferbot_twin.models import model_names
from waferbot_twin.recording.compare import differing_signals
from waferbot_twin.recording.reader import recording_file

pytestmark = [pytest.mark.slow, pytest.mark.long(110)]


def standard_messages(recording):
    """Return the bytes of all messages on the standard topics, in order."""
    topics = ('/clock', '/joint_states', '/plant_state', '/robot_description', '/tf', '/tf_static')
    names, found = {}, {topic: [] for topic in topics}
    with recording_file(recording.path).open('rb') as stream:
        for record in StreamReader(stream).records:
            if type(record).__name__ == 'Channel':
                names[record.id] = record.topic
            elif type(record).__name__ == 'Message' and names[record.channel_id] in found:
                found[names[record.channel_id]].append((record.log_time, bytes(record.data)))
    return found


def shipped_experiments():
    from importlib.resources import files

    folder = files('waferbot_pmac') / 'experiments'
    return sorted(item.name[:-5] for item in folder.iterdir() if item.name.endswith('.yaml'))


@pytest.mark.parametrize('engine', ['ros', 'composed'])
def test_step_over_ros_is_bit_identical_to_the_loop_without_ros(recorded, engine):
    one, other = recorded(engine), recorded('inprocess')
    assert len(one['phase_currents']) == 9000
    assert differing_signals(one, other) == []
    assert one.counts == other.counts


@pytest.mark.parametrize('engine', ['ros', 'composed'])
def test_standard_messages_are_the_same_bytes(recorded, engine):
    one, other = standard_messages(recorded(engine)), standard_messages(recorded('inprocess'))
    for topic in ('/clock', '/joint_states', '/plant_state', '/tf'):
        assert len(one[topic]) == 50
    assert len(one['/tf_static']) == 1
    ((stamp, description),) = one['/robot_description']
    assert stamp == 0
    assert b'<robot name="waferbot">' in description
    assert one == other


LAYOUTS = {
    'composed, all by topics': {'compose': ['plant', 'pmac', 'copley'], 'delivery': 'topics'},
    'plant and copley composed': {'compose': ['plant', 'copley']},
    'pmac composed': {'compose': ['pmac']},
    'plant and copley composed, channel': {
        'compose': ['plant', 'copley'],
        'delivery': 'channel',
    },
    'three processes, channel': {'delivery': 'channel'},
    'two amplifiers composed': {
        'one_copley_per_axis': True,
        'compose': ['copley_x_rotate', 'copley_y_rotate'],
    },
    'plant and one amplifier composed, channel': {
        'one_copley_per_axis': True,
        'compose': ['plant', 'copley_x_rotate'],
        'delivery': 'channel',
    },
}
"""Ways to lay the twin out over processes, and to deliver its messages (options of the ROS engine)."""


SHORT_S = 0.1
"""The step begins at 0.02 s; what differs between layouts is there from the first ticks on."""


@pytest.fixture(scope='module')
def short(tmp_path_factory):
    """The beginning of the step without ROS."""
    return run_engine('inprocess', tmp_path_factory.mktemp('short') / 'run', duration_s=SHORT_S)


@pytest.mark.parametrize('options', LAYOUTS.values(), ids=LAYOUTS)
def test_every_layout_and_delivery_is_bit_identical(short, tmp_path, options):
    one = run_engine('ros', tmp_path / 'run', duration_s=SHORT_S, **options)
    assert len(one['phase_currents']) == Timing().ticks(SHORT_S)
    assert one.summary['complete'] == 'true'
    assert differing_signals(one, short) == []
    assert standard_messages(one) == standard_messages(short)


PROCESSES = {
    'one process': [['plant', 'pmac', 'copley']],
    'plant and copley in one': [['plant', 'copley'], ['pmac']],
    'plant and copley in one, channel': [['plant', 'copley'], ['pmac'], ['channel']],
}


@pytest.mark.parametrize('processes', PROCESSES.values(), ids=PROCESSES)
def test_every_message_is_on_its_topic_in_any_delivery(
    tmp_path, start, connect, domain, processes
):
    """Somebody who knows only ROS gets all of it, while nodes started by hand deliver otherwise."""
    import waferbot_msgs.msg

    ticks = 800  # fewer messages than the history of a topic holds
    client = connect(domain)
    heard = {topic: {} for topic in LOCKSTEP_TOPICS}
    for topic in LOCKSTEP_TOPICS:
        decode = WireFormat(topic.type_name).decode

        def take(data, own=heard[topic], decode=decode):
            tick, _, _, values = decode(data)
            own[tick] = values

        kind = getattr(waferbot_msgs.msg, topic.message)
        client.node.create_subscription(kind, topic.name, take, 1024, raw=True)
    channel = ['--channel', str(tmp_path / 'channel')] if ['channel'] in processes else []
    for nodes in processes:
        if nodes != ['channel']:
            start(
                'waferbot_twin.composed', *nodes, *channel, '--ros-args', *parameter_files(''),
                '-p', f'end_tick:={ticks}', '-p', 'plant:start_paused:=true',
                '-p', 'pmac:experiment:=step',
                ROS_DOMAIN_ID=str(domain),
            )  # fmt: skip
    client.spin_until(lambda: all(heard.values()), 'every topic at tick 0', 40.0)
    client.call(SetBool, '/plant/pause', SetBool.Request(data=False))
    for topic, own in heard.items():
        count = Timing().messages(ticks, topic.ticks_between(Timing()))
        client.spin_until(lambda own=own, count=count: len(own) >= count, f'all of {topic.name}')
    same = run_engine('inprocess', tmp_path / 'same', duration_s=ticks / 18000)
    counts = same[ENCODERS_TOPIC]['counts'].tolist()
    assert [list(heard[ENCODERS_TOPIC][tick]) for tick in range(0, ticks, 2)] == counts
    volts = [[*row['voltage'].ravel().tolist(), int(row['open'])] for row in same[PHASE_VOLTAGES]]
    assert [list(heard[PHASE_VOLTAGES][tick]) for tick in range(ticks)] == volts


def test_step_moves_every_axis(recorded):
    counts = recorded('inprocess')['encoders']['counts']
    moved = abs(counts - counts[0]).max(axis=0)
    assert (moved > 700).all()


def test_second_run_with_shuffled_start_order_is_bit_identical(short, tmp_path):
    seed = random.randrange(2**32)
    print(f'seed {seed}')
    order = ['plant', 'pmac', 'copley']
    random.Random(seed).shuffle(order)
    second = run_engine('ros', tmp_path / 'second', duration_s=SHORT_S, start_order=order)
    assert differing_signals(short, second) == []


def test_one_copley_node_per_axis_is_bit_identical(short, tmp_path):
    seed = random.randrange(2**32)
    print(f'seed {seed}')
    order = ['plant', 'pmac', 'copley_y_linear', 'copley_x_rotate', 'copley_y_rotate']
    random.Random(seed).shuffle(order)
    split = run_engine(
        'ros',
        tmp_path / 'split',
        duration_s=SHORT_S,
        one_copley_per_axis=True,
        start_order=order,
    )
    assert split.counts['/phase_voltages'] == 3 * Timing().ticks(SHORT_S)
    assert differing_signals(short, split) == []


@pytest.mark.parametrize('experiment', shipped_experiments())
def test_every_shipped_experiment_is_the_same_composed(tmp_path, experiment):
    runs = [
        run_engine(engine, tmp_path / engine, experiment, duration_s=0.05)
        for engine in ('composed', 'inprocess')
    ]
    assert len(runs[0]['phase_voltages']) == Timing().ticks(0.05)
    assert differing_signals(*runs) == []


@pytest.mark.parametrize('model', model_names())
def test_every_shipped_model_is_the_same_composed(tmp_path, model):
    runs = [
        run_engine(engine, tmp_path / engine, model=model, duration_s=0.04)
        for engine in ('composed', 'inprocess')
    ]
    assert differing_signals(*runs) == []


COMPENSATED = """\
/**/pmac:
  ros__parameters:
    compensation: |
      axis,over,at,current_a
      y_linear,position_m,0,0.1
      y_linear,position_m,0.01,0.7
      x_rotate,speed_rad_s,-0.1,-2
      x_rotate,speed_rad_s,0.1,2
      y_rotate,time_s:wafer_exchange,0.01,0.3
      y_rotate,time_s:wafer_exchange,0.05,-0.3
"""


@pytest.mark.parametrize('engine', ['ros', 'composed'])
def test_compensation_tables_act_in_the_same_cycles(tmp_path, engine):
    model = tmp_path / 'compensated.yaml'
    model.write_text(COMPENSATED, 'utf-8')
    runs = [
        run_engine(name, tmp_path / name, 'wafer_exchange', model=str(model), duration_s=0.1)
        for name in (engine, 'inprocess')
    ]
    assert differing_signals(*runs) == []
    assert abs(runs[0]['servo_state']['output'][:, 2]).max() > 200.0


def test_a_difference_is_found(recorded, tmp_path):
    other = run_engine('inprocess', tmp_path / 'other', 'constant')
    assert 'current_command.current' in differing_signals(recorded('inprocess'), other)
