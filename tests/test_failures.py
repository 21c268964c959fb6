# SPDX-License-Identifier: Apache-2.0
"""Whatever goes wrong is said, nothing hangs, and nothing goes on with stale data."""

from __future__ import annotations

import json
import math
import os
import re
import signal
import time

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from harness import (
    PATIENCE_S,
    called,
    children_of,
    command_line,
    domain_of,
    run_engine,
    start_node,
    waferbot,
    wait_until,
)
from rclpy.qos import QoSProfile
from std_srvs.srv import SetBool

import waferbot_msgs.msg
from waferbot_lockstep.contract import LOCKSTEP_TOPICS, STOP_TOPIC
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.node import FAREWELL_S
from waferbot_lockstep.timing import Timing
from waferbot_twin.recording.reader import read_recording

HANGS_AFTER_S = 60.0
"""Whoever is still there then hangs. How fast nodes stop is measured by `make bench-endurance`."""

pytestmark = [pytest.mark.slow, pytest.mark.long(180)]


def long_run(start, out, *arguments):
    """Start a run far longer than any test, and wait until messages can be read from its file."""
    run = ['run', '--experiment', 'constant', '--duration', '1000', '--out', str(out), *arguments]
    program = start('waferbot_twin', *run)

    def is_recorded():
        # Not by the file's size: a chunk that is half written counts in it, and is lost with its writer.
        try:
            return read_recording(out).topics
        except UserError:
            return False

    if '--engine' not in arguments:
        composed = arguments[arguments.index('--compose') + 1] if '--compose' in arguments else ''
        nodes = 5 if '--copley-per-axis' in arguments else 3
        program.find_children(nodes - len(composed.split(',')) if composed else nodes)
    wait_until(is_recorded, 'ticks recorded', program)
    return program


def alive(pid):
    return bool(command_line(pid))


def wait_until_gone(pids, timeout_s=HANGS_AFTER_S):
    deadline_s = time.monotonic() + timeout_s
    while any(map(alive, pids)):
        assert time.monotonic() < deadline_s, [command_line(pid) for pid in pids if alive(pid)]
        time.sleep(0.02)


def check_readable(out):
    """Check that a recording is readable and has every tick up to its last one."""
    recording = read_recording(out)
    ticks = recording['phase_currents']['tick']
    assert len(ticks) > 100
    np.testing.assert_array_equal(ticks, np.arange(len(ticks)))
    assert json.loads(called('info', out, '--json').stdout)['ticks'] >= len(ticks)
    return recording


# ---- a node is killed ----------------------------------------------------------------------------

MISSED = {
    'plant': ('plant', r'(encoders|phase_currents)'),
    'pmac': ('pmac', 'current_command'),
    'copley': ('copley', 'phase_voltages'),
    'copley_x_rotate': ('copley', r'phase_voltages \(x_rotate\)'),
}
"""What the neighbour of a killed node waits for."""

FIRST_MISSED = {
    'plant': r'(encoders|phase_currents) \(\w+\)',
    'pmac': r'(current_command|servo_state) \(\w+\)',
    'copley': r'(phase_voltages|amplifier_state) \(\w+\)',
    'copley_x_rotate': r'(phase_voltages|amplifier_state) \(x_rotate\)',
}
"""What the recording has not of it: a state that nobody waits for may be the first, too."""


TWO, CHANNEL = ['--compose', 'plant,copley'], ['--delivery', 'channel']
KILLED = [
    *(('plant', []), ('pmac', []), ('copley', []), ('copley_x_rotate', ['--copley-per-axis'])),
    *(('pmac', TWO + CHANNEL), ('plant', CHANNEL)),
]


@pytest.mark.parametrize(
    ('victim', 'layout'), KILLED, ids=[' '.join([name, *layout]) for name, layout in KILLED]
)
def test_a_killed_node_stops_the_others_with_peer_topic_and_tick(start, tmp_path, victim, layout):
    out = tmp_path / 'run'
    program = long_run(start, out, *layout)
    nodes = dict(program.children)
    os.kill(nodes[victim], signal.SIGKILL)
    wait_until_gone(nodes.values())
    assert program.wait() == 1
    never_came = rf'topic {FIRST_MISSED[victim]}, tick \d+ never came'
    assert re.search(
        rf'waferbot: error: {victim} was killed by signal 9: {never_came}; .* is gone: topic',
        program.output,
    ), program.output
    peer, topic = MISSED[victim]
    assert re.search(rf'{peer} is gone: topic {topic}.* tick \d+ never came', program.output)
    recording = check_readable(out)
    assert recording.closed
    assert recording.summary['complete'] == 'false'
    assert 'is gone' in recording.summary['reason']


def test_an_answer_of_the_plant_that_is_lost_is_asked_for_again(monkeypatch, tmp_path):
    """As by rmw_fastrtps, where a server has not yet discovered who is to have its answer."""
    from harness import run_engine
    from rclpy.client import Client
    from rclpy.task import Future

    asked, call = [], Client.call_async

    def first_is_lost(client, request):
        asked.append(client.srv_name)
        answer = call(client, request)
        return Future() if len(asked) == 1 else answer

    monkeypatch.setattr(Client, 'call_async', first_is_lost)
    recording = run_engine('composed', tmp_path / 'run', duration_s=0.05)
    assert asked == ['plant/pause'] * 2 or asked == ['/plant/pause'] * 2
    assert recording.summary['complete'] == 'true'


def test_nodes_started_by_hand_end_with_an_error_when_a_peer_is_killed(start, domain):
    nodes = {name: start_node(start, name, domain) for name in ('plant', 'pmac', 'copley')}
    subscription_seen(nodes, domain)
    nodes['plant'].signal(signal.SIGKILL)
    for name in ('pmac', 'copley'):
        assert nodes[name].wait(HANGS_AFTER_S) == 1, nodes[name].output
        assert re.search(r'plant is gone: topic \w+ .*tick \d+ never came', nodes[name].output)


def subscription_seen(nodes, domain):
    """Wait until time goes on, as a client sees it."""
    from harness import Client

    client = Client(domain)
    heard = []
    client.node.create_subscription(waferbot_msgs.msg.Encoders, 'encoders', heard.append, 10)
    client.spin_until(lambda: heard and heard[-1].tick > 200, 'ticks')
    client.end()


# ---- messages that do not fit --------------------------------------------------------------------


def message_of(topic, seen, **changes):
    """Return a message like `seen`, with other fields and the stamp of its tick."""
    kind = getattr(waferbot_msgs.msg, topic.message)
    fields = {name: getattr(seen, name) for name in kind.get_fields_and_field_types()}
    fields.update(changes)
    header = fields.pop('header')
    message = kind(**fields)
    stamp_ns = changes.get('stamp_ns', Timing().stamp_ns(message.tick))
    message.header.frame_id = header.frame_id
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
    return message


def field_of(topic):
    return {'Encoders': 'counts', 'PhaseVoltages': 'voltage'}.get(topic.message, 'current')


def injected(topic, kind, seen):
    """Return the rogue message of a kind, made from the newest one seen on the topic."""
    spacing = topic.ticks_between(Timing())
    name = field_of(topic)
    values = list(getattr(seen, name))
    if kind == 'duplicate':
        return message_of(topic, seen)
    if kind == 'reordered':
        return message_of(topic, seen, tick=seen.tick - spacing, **{name: values[::-1]})
    if kind == 'stale':
        return message_of(topic, seen, tick=seen.tick - 50 * spacing)
    if kind == 'future':
        return message_of(topic, seen, tick=seen.tick + 50 * spacing)
    if kind == 'wrong axis':
        return message_of(topic, seen, valid=0x80)
    if kind == 'no axis':
        return message_of(topic, seen, valid=0)
    if kind == 'second voice':
        values[0] += 1
        return message_of(topic, seen, **{name: values})
    if kind == 'wrong stamp':
        message = message_of(topic, seen)
        message.header.stamp.nanosec += 1
        return message
    number = {'NaN': math.nan, 'infinite': math.inf}[kind]
    values[-1] = number
    return message_of(topic, seen, tick=seen.tick + spacing, **{name: values})


KINDS = (
    'duplicate', 'reordered', 'stale', 'future', 'wrong axis', 'no axis', 'second voice',
    'wrong stamp', 'NaN', 'infinite',
)  # fmt: skip
CASES = [
    (topic, kind)
    for topic in LOCKSTEP_TOPICS
    for kind in KINDS
    if not (topic.message == 'Encoders' and ('infinite' in kind or kind == 'NaN'))
]


class ComposedTwin:
    """The three nodes of the twin and a rogue with a publisher on one topic, in one process."""

    def __init__(self, topic):
        import rclpy
        from rclpy.node import Node

        from waferbot_copley.node import CopleyNode
        from waferbot_lockstep.node import make_executor
        from waferbot_plant.node import PlantNode
        from waferbot_pmac.node import PmacNode
        from waferbot_twin.engines.members import ros_parameters
        from waferbot_twin.models import load_model

        rclpy.init()
        model = load_model('rigid')
        self.nodes = [
            kind(parameter_overrides=list(ros_parameters(model.parameters[name])))
            for name, kind in (('plant', PlantNode), ('pmac', PmacNode), ('copley', CopleyNode))
        ]
        self.rogue = Node('rogue')
        self.seen = []
        kind = getattr(waferbot_msgs.msg, topic.message)
        qos = QoSProfile(depth=64)
        self.rogue.create_subscription(kind, topic.name, self.seen.append, qos)
        self.publisher = self.rogue.create_publisher(kind, topic.name, qos)
        self.pause = self.rogue.create_client(SetBool, 'plant/pause')
        self.executor = make_executor()
        for node in (*self.nodes, self.rogue):
            self.executor.add_node(node)
        for node in self.nodes:
            node.begin()

    def spin_until(self, done, what, timeout_s=PATIENCE_S):
        deadline_s = time.monotonic() + timeout_s
        while not done():
            assert time.monotonic() < deadline_s, what
            self.executor.spin_once(timeout_sec=0.05)

    def set_paused(self, paused):
        self.spin_until(self.pause.service_is_ready, 'pause service')
        future = self.pause.call_async(SetBool.Request(data=paused))
        self.spin_until(future.done, 'pause')

    @property
    def outcomes(self):
        return {node.get_name(): node.outcome for node in self.nodes}

    def end(self):
        import rclpy

        for node in (*self.nodes, self.rogue):
            self.executor.remove_node(node)
        self.executor.shutdown(0.0)
        for node in self.nodes:
            node.interrupt()
        for node in (*self.nodes, self.rogue):
            node.destroy_node()
        rclpy.try_shutdown()


@pytest.fixture
def environment(domain, monkeypatch):
    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain))
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')


@pytest.mark.parametrize(
    ('topic', 'kind'), CASES, ids=[f'{topic.name}-{kind}' for topic, kind in CASES]
)
def test_a_message_that_does_not_fit_is_refused_with_peer_topic_and_tick(environment, topic, kind):
    twin = ComposedTwin(topic)
    try:
        twin.spin_until(
            lambda: (
                twin.publisher.get_subscription_count() >= 2
                and twin.seen
                and twin.seen[-1].tick > 800
            ),
            'ticks',
        )
        # While time stands, everybody has the same tick in hand: it is certain what is injected.
        twin.set_paused(True)
        settled = len(twin.seen) + 4
        twin.spin_until(lambda: len(twin.seen) >= settled, 'signs of life')
        newest = twin.seen[-1]
        twin.publisher.publish(injected(topic, kind, newest))
        if kind == 'duplicate':
            twin.set_paused(False)
            twin.spin_until(lambda: twin.seen[-1].tick > newest.tick + 400, 'time going on')
            assert set(twin.outcomes.values()) == {None}
            return
        twin.spin_until(lambda: None not in twin.outcomes.values(), 'all stopped', HANGS_AFTER_S)
        for reason in twin.outcomes.values():
            assert f'topic {topic.name}, tick ' in reason
            assert f'from {topic.publisher}' in reason
    finally:
        twin.end()


def test_a_recorder_says_that_a_stranger_is_far_ahead(environment, domain, connect):
    import rclpy

    from waferbot_lockstep.node import make_executor
    from waferbot_twin.recording.recorder import FURTHEST_TICKS, Recorder

    rogue = connect(domain)
    topic = LOCKSTEP_TOPICS[3]
    publisher = rogue.node.create_publisher(waferbot_msgs.msg.PhaseVoltages, topic.name, 50)
    rclpy.init()
    recorder = Recorder(None, Timing())
    recorder.begin()
    executor = make_executor()
    executor.add_node(recorder)

    def heard(tick, done):
        voltages = waferbot_msgs.msg.PhaseVoltages(tick=tick, valid=0b111)
        deadline_s = time.monotonic() + PATIENCE_S
        while not done():
            assert time.monotonic() < deadline_s
            publisher.publish(message_of(topic, voltages))
            executor.spin_once(timeout_sec=0.05)

    try:
        heard(0, lambda: recorder.tick == 0)
        heard(FURTHEST_TICKS, lambda: recorder.tick == FURTHEST_TICKS)
        assert not recorder.failure
        heard(7542, lambda: recorder.failure)
        assert recorder.tick == FURTHEST_TICKS
        assert recorder.failure == (
            'topic phase_voltages, tick 7542: the twin is at tick 512; somebody else publishes in its '
            'ROS domain'
        )
    finally:
        executor.remove_node(recorder)
        executor.shutdown(0.0)
        recorder.destroy_node()
        rclpy.try_shutdown()


@pytest.mark.alone  # its stranger is still there when the run has given its domain back
@pytest.mark.parametrize(
    ('topic', 'kind'), [(LOCKSTEP_TOPICS[3], 'NaN'), (LOCKSTEP_TOPICS[0], 'stale')]
)
def test_a_rogue_process_ends_a_run_of_separate_processes(start, connect, tmp_path, topic, kind):
    program = long_run(start, tmp_path / 'run')
    client = connect(domain_of(program))
    seen = []
    message_type = getattr(waferbot_msgs.msg, topic.message)
    client.node.create_subscription(message_type, topic.name, seen.append, 50)
    publisher = client.node.create_publisher(message_type, topic.name, 50)
    client.spin_until(
        lambda: seen and seen[-1].tick > 500 and publisher.get_subscription_count() >= 2, 'ticks'
    )
    # A message may be lost while the two are still finding each other, so it is sent again.
    deadline_s = time.monotonic() + 30
    while program.process.poll() is None and time.monotonic() < deadline_s:
        newest = max(seen, key=lambda message: message.tick)  # it hears itself, too
        publisher.publish(injected(topic, kind, newest))
        client.executor.spin_once(timeout_sec=0.1)
    assert program.wait(1) == 1
    assert re.search(
        rf'waferbot: error: .*topic {topic.name}, tick \d+.* from {topic.publisher}',
        program.output,
    )
    wait_until_gone(program.children.values())
    check_readable(tmp_path / 'run')


# ---- the end asked for ---------------------------------------------------------------------------


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_run_ends_cleanly(start, tmp_path, number):
    out = tmp_path / 'run'
    program = long_run(start, out)
    program.signal(number)
    assert program.wait() == 130
    wait_until_gone(program.children.values(), 0.5)
    assert 'Traceback' not in program.output
    assert program.output.rstrip().endswith('waferbot: interrupted')
    recording = check_readable(out)
    assert recording.closed
    assert recording.summary['reason'] == 'interrupted by the user'


@pytest.mark.parametrize('engine', ['composed', 'inprocess'])
def test_an_interrupted_run_of_one_process_ends_cleanly(start, tmp_path, engine):
    program = long_run(start, tmp_path / 'run', '--engine', engine)
    program.signal(signal.SIGINT)
    assert program.wait() == 130
    assert 'Traceback' not in program.output
    assert check_readable(tmp_path / 'run').closed


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_node_ends_the_others_without_error(start, domain, number):
    nodes = {name: start_node(start, name, domain) for name in ('plant', 'pmac', 'copley')}
    subscription_seen(nodes, domain)
    nodes['pmac'].signal(number)
    for program in nodes.values():
        assert program.wait() == 0, program.output
        assert 'Traceback' not in program.output


def test_a_stop_is_passed_on_by_who_heard_it(start, domain, connect):
    """Who was still being discovered when the first one was sent hears it so."""
    client = connect(domain)
    heard = []
    client.node.create_subscription(waferbot_msgs.msg.Stop, STOP_TOPIC, heard.append, 50)
    publisher = client.node.create_publisher(waferbot_msgs.msg.Stop, STOP_TOPIC, 50)
    client.node.create_publisher(waferbot_msgs.msg.CurrentCommand, 'current_command', 50)
    plant = start_node(start, 'plant', domain)
    client.spin_until(
        lambda: (
            publisher.get_subscription_count() >= 2
            and client.node.count_publishers(STOP_TOPIC) >= 2
        ),
        'the plant on the topic of stops',
    )
    time.sleep(0.5)  # the other ends know of each other, too
    publisher.publish(
        waferbot_msgs.msg.Stop(tick=7, node='/test_client', reason='interrupted by the user')
    )
    client.spin_until(lambda: len(heard) >= 3, 'the stop, its own once and those of the plant')
    assert {(stop.node, stop.tick) for stop in heard} == {('/test_client', 7)}
    assert plant.wait() == 0, plant.output


@pytest.mark.alone  # its stranger is still there when the run has given its domain back
def test_a_stop_of_a_stranger_is_passed_over_and_said(start, connect, tmp_path):
    program = long_run(start, tmp_path / 'run')
    client = connect(domain_of(program))
    publisher = client.node.create_publisher(waferbot_msgs.msg.Stop, STOP_TOPIC, 50)
    diagnostics = []
    client.node.create_subscription(
        DiagnosticArray, '/diagnostics', lambda array: diagnostics.extend(array.status), 50
    )
    client.spin_until(lambda: publisher.get_subscription_count() >= 4, 'all who hear stops')
    publisher.publish(waferbot_msgs.msg.Stop(tick=7, node='/stranger', reason='because I say so'))
    told = 'passed over a stop of /stranger, which takes no part in this twin: because I say so'
    client.spin_until(lambda: program.output.count(told) == 4, 'four warnings', 20.0)
    client.spin_until(
        lambda: sum('strangers have asked' in status.message for status in diagnostics) >= 3,
        'diagnostics',
        20.0,
    )
    assert program.process.poll() is None
    program.signal(signal.SIGINT)
    assert program.wait() == 130
    assert check_readable(tmp_path / 'run').summary['reason'] == 'interrupted by the user'


def test_a_killed_runner_leaves_no_node_behind_and_the_next_run_works(start, recorded, tmp_path):
    program = long_run(start, tmp_path / 'killed')
    program.signal(signal.SIGKILL)
    program.wait()
    wait_until_gone(program.children.values())
    assert not read_recording(tmp_path / 'killed').closed
    # Its domain is free again.
    after = run_engine('ros', tmp_path / 'after', duration_s=0.05)
    whole = recorded('inprocess')
    for name, array in after.topics.items():
        np.testing.assert_array_equal(array, whole[name][: len(array)])


def test_a_recorder_that_stands_still_while_the_others_end_misses_nothing(
    start, connect, tmp_path
):
    out = tmp_path / 'run'
    ticks = 900
    run = ['run', '--experiment', 'constant', '--duration', f'{ticks / 18000}', '--out', str(out)]
    program = start('waferbot_twin', *run, '--without', 'plant')
    program.find_children(2)
    domain = domain_of(program)
    plant = start_node(start, 'plant', domain, 'start_paused:=true', f'end_tick:={ticks}')
    client = connect(domain)
    heard = []
    kind = waferbot_msgs.msg.PhaseVoltages
    client.node.create_subscription(kind, 'phase_voltages', heard.append, 50)
    client.spin_until(lambda: heard, 'tick 0')
    reached = []
    client.node.create_subscription(waferbot_msgs.msg.Recorded, 'recorded', reached.append, 50)
    # Who has been heard by the recorder knows of it.
    client.spin_until(lambda: reached and reached[-1].tick > 0, 'tick 0 recorded')
    program.signal(signal.SIGSTOP)
    client.call(SetBool, 'plant/pause', SetBool.Request(data=False))
    client.spin_until(lambda: heard[-1].tick == ticks - 1, 'the end')
    time.sleep(4 * FAREWELL_S)
    assert plant.process.poll() is None, 'the plant has left though it was not heard'
    program.signal(signal.SIGCONT)
    assert program.wait() == 0, program.output
    assert read_recording(out).summary['complete'] == 'true'
    assert plant.wait() == 0, plant.output


def test_a_node_that_cannot_start_ends_the_run_with_its_reason(start, tmp_path):
    model = tmp_path / 'bad.yaml'
    model.write_text('/**/copley: {ros__parameters: {x_rotate: {bus_voltage: -1.0}}}\n')
    program = start('waferbot_twin', 'run', '--model', str(model), '--duration', '0.1')
    assert program.wait() == 1
    assert 'Traceback' not in program.output
    assert 'bus_voltage' in program.output
    assert children_of(program.process.pid) == []


NEVER_ENDS = """
import atexit, signal, sys, time
if 'waferbot_copley.node' in sys.orig_argv:
    atexit.register(time.sleep, 1e6)
    atexit.register(signal.signal, signal.SIGINT, signal.SIG_IGN)
"""


def test_a_node_that_never_ends_is_killed_once_all_is_recorded(start, tmp_path):
    """As foreign code in an FMU may do."""
    (tmp_path / 'sitecustomize.py').write_text(NEVER_ENDS, 'utf-8')
    path = os.pathsep.join([str(tmp_path), *filter(None, [os.environ.get('PYTHONPATH')])])
    run = ['run', '--duration', '0.01', '--out', str(tmp_path / 'run')]
    program = start('waferbot_twin', *run, PYTHONPATH=path)
    assert program.wait() == 0, program.output
    assert 'copley has not ended 5 s after it was asked to, it is killed' in program.output
    assert read_recording(tmp_path / 'run').summary['complete'] == 'true'
    assert children_of(program.process.pid) == []


@pytest.mark.parametrize(
    ('node', 'given', 'meant'),
    [
        ('pmac', 'y_linear.Ixx3O:=5', 'y_linear.Ixx3'),
        ('plant', 'descripton:=flexible', 'description'),
        ('copley', 'x_rotate.bus_volts:=24.0', 'x_rotate.bus_voltage'),
    ],
)
def test_a_parameter_that_a_node_does_not_have_is_an_error(start, domain, node, given, meant):
    program = start_node(start, node, domain, given)
    assert program.wait(PATIENCE_S) == 1
    assert 'Traceback' not in program.output
    name = given.split(':')[0]
    assert f"{node} has no parameter '{name}'; did you mean '{meant}" in program.output


def test_a_run_that_waits_in_vain_says_for_whom():
    result = waferbot('run', '--without', 'pmac', '--startup-timeout', '8', '--duration', '0.1')
    assert result.returncode == 1
    assert re.search(r'pmac .*current_command: .*did not appear within 8 s|did not start within 8 s: '
                     r'pmac has not published current_command', result.stderr)  # fmt: skip


def test_a_run_without_a_peer_gives_up_with_its_name(start, domain):
    node = start_node(start, 'copley', domain, 'startup_timeout_s:=1.5')
    assert node.wait(PATIENCE_S) == 1
    assert re.search(r'plant \(phase_currents: .*did not appear within 1.5 s, tick 0', node.output)
