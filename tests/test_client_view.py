# SPDX-License-Identifier: Apache-2.0
"""The running twin as any ROS 2 user meets it: nodes, topics, parameters, services, the action."""

from __future__ import annotations

import numpy as np
import pytest
from harness import Client, Program, start_node
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from rclpy.action import ActionClient
from rclpy.qos import DurabilityPolicy, HistoryPolicy, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger

import waferbot_msgs.msg
from waferbot_msgs.action import RunExperiment

TOPICS = {
    '/encoders': ('Encoders', '/plant'),
    '/phase_currents': ('PhaseCurrents', '/plant'),
    '/current_command': ('CurrentCommand', '/pmac'),
    '/servo_state': ('ServoState', '/pmac'),
    '/phase_voltages': ('PhaseVoltages', '/copley'),
    '/amplifier_state': ('AmplifierState', '/copley'),
}

SHORT_STEP = """
name: short_step
description: A step of 500 counts.
duration_s: 0.25
motion:
  y_linear: {kind: step, start_s: 0.02, amplitude_counts: 500}
"""

pytestmark = pytest.mark.slow


@pytest.fixture(scope='module')
def twin(tmp_path_factory):
    """Three nodes started by hand, and a client in their domain."""
    import sys

    from waferbot_twin.engines.domain import Domain

    domain = Domain()
    folder = tmp_path_factory.mktemp('by_hand')
    programs = []

    def start(module, *arguments, **environment):
        command = [sys.executable, '-m', module, *arguments]
        programs.append(Program(command, folder / f'{module}.log', environment))
        return programs[-1]

    for node in ('copley', 'pmac', 'plant'):
        start_node(start, node, domain.number)
    client = Client(domain.number)
    client.programs = programs
    yield client
    client.end()
    for program in programs:
        program.end()
    domain.release()


@pytest.fixture(autouse=True)
def still_running(twin):
    yield
    for program in twin.programs:
        assert program.process.poll() is None, program.output


def listen(twin, topic, message_type, count=1, until=None):
    """Return `count` messages of a topic, or all up to one for which `until` holds."""
    heard = []
    subscription = twin.node.create_subscription(message_type, topic, heard.append, 50)
    done = (lambda: any(map(until, heard))) if until else (lambda: len(heard) >= count)
    twin.spin_until(done, f'messages on {topic}')
    twin.node.destroy_subscription(subscription)
    return heard


def set_parameter(twin, node, name, value):
    kind = (
        ParameterType.PARAMETER_INTEGER
        if isinstance(value, int)
        else ParameterType.PARAMETER_DOUBLE
    )
    field = {'integer_value': value} if isinstance(value, int) else {'double_value': value}
    parameter = Parameter(name=name, value=ParameterValue(type=kind, **field))
    request = SetParameters.Request(parameters=[parameter])
    return twin.call(SetParameters, f'{node}/set_parameters', request).results[0]


def run_experiment(twin, experiment, feedback=None):
    client = ActionClient(twin.node, RunExperiment, 'run_experiment')
    result = twin.result_of(twin.run_experiment(client, experiment, feedback))
    client.destroy()
    return result


def test_nodes_are_there(twin):
    expected = {('plant', '/'), ('pmac', '/'), ('copley', '/')}
    twin.spin_until(
        lambda: expected <= set(twin.node.get_node_names_and_namespaces()), 'the three nodes'
    )


@pytest.mark.parametrize('topic', TOPICS)
def test_topics_have_their_type_publisher_and_quality_of_service(twin, topic):
    twin.spin_until(lambda: twin.node.get_publishers_info_by_topic(topic), topic)
    (info,) = twin.node.get_publishers_info_by_topic(topic)
    message, publisher = TOPICS[topic]
    assert info.topic_type == f'waferbot_msgs/msg/{message}'
    assert '/' + info.node_name == publisher
    assert info.qos_profile.reliability == ReliabilityPolicy.RELIABLE
    assert info.qos_profile.durability == DurabilityPolicy.VOLATILE
    # DDS does not tell the history of a remote publisher; where it does, it is keep-last.
    assert info.qos_profile.history in (HistoryPolicy.KEEP_LAST, HistoryPolicy.UNKNOWN)


@pytest.mark.parametrize('topic', TOPICS)
def test_topics_can_be_echoed(twin, topic):
    message_type = getattr(waferbot_msgs.msg, TOPICS[topic][0])
    message = listen(twin, topic, message_type)[0]
    assert message.valid == (0b1111 if topic == '/encoders' else 0b111)
    stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
    assert stamp == message.tick * 500000 // 9


def test_standard_topics_for_standard_tools(twin):
    clock = listen(twin, '/clock', Clock, 2)
    assert clock[1].clock.sec + clock[1].clock.nanosec / 1e9 > 0
    joints = listen(twin, '/joint_states', JointState)[0]
    assert list(joints.name) == ['y_linear', 'x_rotate', 'y_rotate']
    assert len(joints.position) == len(joints.velocity) == 3


def test_i_variables_are_described_with_unit_and_range(twin):
    names = twin.call(
        ListParameters, '/pmac/list_parameters', ListParameters.Request(depth=0)
    ).result.names
    described = twin.call(
        DescribeParameters, '/pmac/describe_parameters', DescribeParameters.Request(names=names)
    ).descriptors
    variables = {d.name: d for d in described if '.Ixx' in d.name}
    assert len(variables) > 3 * 30
    for descriptor in variables.values():
        assert descriptor.description
        assert descriptor.integer_range or descriptor.floating_point_range, descriptor.name
    limit = variables['y_linear.Ixx69']
    assert (limit.integer_range[0].from_value, limit.integer_range[0].to_value) == (0, 32767)
    assert 'count' in variables['y_linear.Ixx11'].description
    assert variables['y_linear.Ixx08'].read_only


def test_amplifier_settings_are_described_with_unit(twin):
    described = twin.call(
        DescribeParameters,
        '/copley/describe_parameters',
        DescribeParameters.Request(names=['x_rotate.peak_current', 'x_rotate.bus_voltage']),
    ).descriptors
    assert '[A]' in described[0].description
    assert '[V]' in described[1].description


def test_an_i_variable_can_be_read_and_set_and_acts(twin):
    # The bias holds the weight of y_linear, so the axis stands still until it is changed.
    request = GetParameters.Request(names=['y_linear.Ixx29'])

    def bias() -> int:
        return twin.call(GetParameters, '/pmac/get_parameters', request).values[0].integer_value

    kind = waferbot_msgs.msg.ServoState
    holding = bias()
    assert abs(listen(twin, '/servo_state', kind)[0].following_error[0]) < 20
    assert set_parameter(twin, '/pmac', 'y_linear.Ixx29', holding + 500).successful
    assert bias() == holding + 500
    listen(twin, '/servo_state', kind, until=lambda state: abs(state.following_error[0]) > 20)
    assert set_parameter(twin, '/pmac', 'y_linear.Ixx29', holding).successful


def test_a_value_out_of_range_is_refused_with_the_range(twin):
    result = set_parameter(twin, '/pmac', 'y_linear.Ixx69', 40000)
    assert not result.successful
    assert '32767' in result.reason
    result = set_parameter(twin, '/copley', 'x_rotate.bus_voltage', -5.0)
    assert not result.successful
    assert 'V' in result.reason or 'range' in result.reason


def test_a_fixed_i_variable_is_refused(twin):
    result = set_parameter(twin, '/pmac', 'y_linear.Ixx08', 95)
    assert not result.successful
    assert 'Ixx08' in result.reason


@pytest.mark.parametrize(
    ('node', 'name'),
    [
        ('/plant', 'description'),
        ('/plant', 'start_paused'),
        ('/pmac', 'experiment'),
        ('/copley', 'axes'),
    ],
)
def test_what_only_counts_at_the_start_is_described_as_read_only(twin, node, name):
    request = DescribeParameters.Request(names=[name])
    (descriptor,) = twin.call(
        DescribeParameters, f'{node}/describe_parameters', request
    ).descriptors
    assert descriptor.read_only
    assert descriptor.description


def test_the_action_is_refused_while_another_experiment_runs_and_accepted_after_it(twin):
    """The PMAC begins with the experiment of its parameter: 0.5 s of standing still."""
    kind = waferbot_msgs.msg.ServoState
    listen(twin, '/servo_state', kind, until=lambda state: state.tick > 9000)
    actions = ActionClient(twin.node, RunExperiment, 'run_experiment')
    first = twin.run_experiment(actions, SHORT_STEP)
    assert first.accepted
    assert not twin.run_experiment(actions, SHORT_STEP).accepted
    assert twin.result_of(first).result.success
    actions.destroy()


def test_the_action_runs_an_experiment(twin):
    progress = []
    answer = run_experiment(twin, SHORT_STEP, lambda m: progress.append(m.feedback))
    result = answer.result
    assert result.success, result.message
    assert result.last_tick - result.first_tick == pytest.approx(4500, abs=16)
    # The step itself is the first following error: all of its 500 counts.
    assert 450 <= result.peak_following_error[0] < 2000
    assert len(progress) >= 2
    assert 0 < progress[0].progress < progress[-1].progress <= 1


def test_the_action_begins_where_the_axes_stand(twin):
    """The second step starts from the end of the first: 500 counts further."""
    before = listen(twin, '/servo_state', waferbot_msgs.msg.ServoState)[-1].commanded_position[0]
    assert run_experiment(twin, SHORT_STEP).result.success
    after = listen(twin, '/servo_state', waferbot_msgs.msg.ServoState)[-1].commanded_position[0]
    assert after - before == 500


JOG = """
name: long_jog
duration_s: 3
motion: {y_linear: {kind: jog, distance_m: 0.3, speed_m_per_s: 0.2}}
"""


def test_the_action_can_be_cancelled_and_brings_the_motors_to_rest(twin):
    """By Ixx15 = 50 counts/ms^2 from 2000 counts/ms: 40 ms and 40,000 counts later."""
    state = waferbot_msgs.msg.ServoState
    heard = []
    subscription = twin.node.create_subscription(state, '/servo_state', heard.append, 1024)
    twin.spin_until(lambda: heard, 'the commanded positions')
    begun = heard[-1].commanded_position[0]
    actions = ActionClient(twin.node, RunExperiment, 'run_experiment')
    goal = twin.run_experiment(actions, JOG)
    assert goal.accepted
    twin.spin_until(lambda: heard[-1].commanded_position[0] > begun + 500_000, 'the move')
    fast = len(heard) - 1
    response = twin.answer(goal.cancel_goal_async, 'answer to the cancelling')
    assert len(response.goals_canceling) == 1
    answer = twin.result_of(goal)
    assert answer.status == 5  # STATUS_CANCELED
    assert not answer.result.success
    assert 'brought to rest' in answer.result.message
    twin.spin_until(lambda: heard and heard[-1].tick > answer.result.last_tick + 800, 'rest')
    twin.node.destroy_subscription(subscription)
    ticks = np.array([message.tick for message in heard[fast - 1 :]])
    place = np.array([message.commanded_position[0] for message in heard[fast - 1 :]])
    whole = np.flatnonzero(np.diff(ticks) == 8)  # between servo cycles that follow one another
    steps, speed = np.diff(place)[whole], 2000 / 2.25
    assert steps[0] == pytest.approx(speed, rel=1e-3)
    rounding = 4 / (
        32 * 96
    )  # of the command's register, 1/(32 Ixx08) counts, in a second difference
    assert np.all(np.diff(steps) >= -(50 / 2.25**2) - rounding), 'as hard as Ixx15, no harder'
    assert steps[-1] == 0.0
    stopping = place[-1] - place[whole][steps > 0.999 * speed].max()
    assert stopping == pytest.approx(2000**2 / (2 * 50), rel=0.05)
    again = run_experiment(twin, SHORT_STEP)
    assert again.result.success, again.result.message
    actions.destroy()


@pytest.mark.parametrize(
    ('experiment', 'hint'),
    [('stepp', 'stepp'), ('name: [', 'line'), ('name: x\n', 'experiment text')],
)
def test_an_unknown_experiment_aborts_with_a_clear_message(twin, experiment, hint):
    answer = run_experiment(twin, experiment)
    assert answer.status == 6  # STATUS_ABORTED
    assert not answer.result.success
    assert hint in answer.result.message


def test_time_is_paused_and_continued_by_the_plants_service(twin):
    response = twin.call(SetBool, '/plant/pause', SetBool.Request(data=True))
    assert response.success
    heard = []
    kind = waferbot_msgs.msg.PhaseCurrents
    subscription = twin.node.create_subscription(kind, '/phase_currents', heard.append, 50)
    # Repeated as a sign of life while time stands: longer than the timeout of silent peers (2 s).
    twin.spin_until(lambda: len(heard) >= 25, 'signs of life', 30)
    assert len({message.tick for message in heard[5:]}) == 1
    stands = heard[-1].tick
    assert twin.call(SetBool, '/plant/pause', SetBool.Request(data=False)).success
    twin.spin_until(lambda: heard[-1].tick > stands + 100, 'time going on')
    twin.node.destroy_subscription(subscription)


def test_safe_torque_off_opens_the_terminals_and_is_given_back(twin):
    kind = waferbot_msgs.msg.PhaseVoltages
    assert twin.call(SetBool, '/copley/safe_torque_off', SetBool.Request(data=True)).success
    tick = listen(twin, '/phase_voltages', kind, until=lambda m: m.open == 0b111)[-1].tick
    currents = listen(
        twin,
        '/phase_currents',
        waferbot_msgs.msg.PhaseCurrents,
        until=lambda m: m.tick > tick + 400,
    )[-1].current
    assert max(map(abs, currents)) < 1e-9
    # Nothing holds the load of x_rotate any more: it falls.
    encoders = listen(
        twin, '/encoders', waferbot_msgs.msg.Encoders, until=lambda m: m.tick > tick + 600
    )
    assert abs(encoders[-1].counts[1]) > 100
    state = listen(twin, '/amplifier_state', waferbot_msgs.msg.AmplifierState)[-1]
    assert all(fault & kind_of_fault() for fault in state.faults)
    assert twin.call(SetBool, '/copley/safe_torque_off', SetBool.Request(data=False)).success
    assert twin.call(Trigger, '/copley/reset_faults', Trigger.Request()).success
    listen(twin, '/phase_voltages', kind, until=lambda m: m.open == 0)


def kind_of_fault():
    return waferbot_msgs.msg.AmplifierState.SAFE_TORQUE_OFF
