# SPDX-License-Identifier: Apache-2.0
"""Controllers of ros2_control in place of the PMAC; a stand-in speaks as they and their hardware do."""

from __future__ import annotations

import importlib.util
import signal
import sys
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from harness import PATIENCE_S, Program, start_node
from sensor_msgs.msg import JointState

from waferbot_lockstep.contract import AXES
from waferbot_lockstep.package_data import package_data
from waferbot_msgs.msg import CurrentCommand, Encoders
from waferbot_plant.plant import load_machine
from waferbot_plant.urdf import urdf
from waferbot_twin.ros2_control.joints import JointScales, with_ros2_control

CONTROLLERS = package_data('waferbot_twin', 'config', 'ros2_control', 'controllers.yaml')
STAND_IN = Path(__file__).parent / 'ros2_control_stand_in.py'
TARGET = {'y_linear': 0.002, 'x_rotate': 0.01, 'y_rotate': -0.02}


class Seen:
    """What a client hears of joints, counts, currents and diagnostics."""

    def __init__(self, client):
        self.client = client
        self.tick = -1
        self.counts = np.zeros(4)
        self.position, self.effort, self.current, self.status = {}, {}, np.zeros(3), None
        node = client.node
        node.create_subscription(Encoders, 'encoders', self.on_encoders, 1)
        node.create_subscription(CurrentCommand, 'current_command', self.on_current, 1)
        node.create_subscription(JointState, '/robot_joint_states', self.on_states, 1)
        node.create_subscription(JointState, '/robot_joint_commands', self.on_commands, 1)
        node.create_subscription(DiagnosticArray, '/diagnostics', self.on_diagnostics, 10)

    def on_encoders(self, encoders):
        self.tick, self.counts = encoders.tick, np.array(encoders.counts, float)

    def on_current(self, command):
        self.current = np.array(command.current)

    def on_states(self, states):
        self.position = dict(zip(states.name, states.position, strict=True))

    def on_commands(self, commands):
        self.effort = dict(zip(commands.name, commands.effort, strict=True))

    def on_diagnostics(self, array):
        for status in array.status:
            if status.name.startswith('/joint_bridge'):
                self.status = status

    def wait_for(self, done, what):
        self.client.spin_until(done, what)

    def near(self, target, tolerance):
        """Whether all joints are near a target."""
        return len(self.position) == 3 and all(
            abs(self.position[axis] - target[axis]) < tolerance[axis] for axis in AXES
        )


@pytest.fixture
def twin(start, domain, connect):
    """Plant, amplifiers and bridge, at a tenth of real time so that load does not matter."""
    real_time = 'timekeeping:=realtime'
    start_node(start, 'plant', domain, real_time, 'realtime_factor:=0.1', 'start_paused:=true')
    start_node(start, 'copley', domain, real_time)
    options = ('--ros-args', '-p', real_time)
    start('waferbot_twin.ros2_control.bridge', *options, ROS_DOMAIN_ID=str(domain))
    return Seen(connect(domain))


@pytest.fixture
def controllers(domain, tmp_path):
    environment = {'ROS_DOMAIN_ID': str(domain), 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}
    programs = []

    def begin():
        command = [sys.executable, str(STAND_IN), str(CONTROLLERS)]
        programs.append(Program(command, tmp_path / f'{len(programs)}.log', environment))
        return programs[-1]

    yield begin
    for program in programs:
        program.end()


def torque_of_gravity(axis):
    """Return what MuJoCo says is needed to hold an axis at home, Nm, by the URDF alone."""
    text = urdf(load_machine('rigid').description)
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return data.qfrc_bias[model.joint(axis).dofadr[0]]


@pytest.mark.slow
@pytest.mark.alone  # controllers keep wall time
def test_a_controller_lets_time_go_holds_the_weight_and_moves_the_axes(
    twin, controllers, connect, domain
):
    twin.wait_for(lambda: twin.status is not None and len(twin.position) == 3, 'the bridge')
    assert 'no controller yet' in twin.status.message
    assert twin.tick <= 0, 'time goes on though nobody holds the axes'

    controllers()
    tolerance = {'y_linear': 5e-5, 'x_rotate': 5e-4, 'y_rotate': 5e-4}
    home = dict.fromkeys(AXES, 0.0)
    twin.wait_for(lambda: twin.tick > 9000 and twin.near(home, tolerance), 'the axes held')
    assert twin.status.level != DiagnosticStatus.ERROR

    scales = JointScales.of(load_machine('rigid').description)
    efforts, currents = [], []
    begun = twin.tick
    while twin.tick < begun + 3600:
        twin.client.executor.spin_once(timeout_sec=0.05)
        efforts.append(twin.effort['x_rotate'])
        currents.append(twin.current[1])
    weight = torque_of_gravity('x_rotate')
    assert abs(weight) > 10.0
    assert np.mean(efforts) == pytest.approx(weight, rel=0.01)
    assert np.mean(currents) * scales.effort_per_ampere[1] == pytest.approx(weight, rel=0.01)

    publisher = twin.client.node.create_publisher(JointState, '/target', 1)
    twin.wait_for(lambda: publisher.get_subscription_count() > 0, 'the stand-in to listen')
    publisher.publish(JointState(name=list(TARGET), position=list(TARGET.values())))
    twin.wait_for(lambda: twin.near(TARGET, tolerance), 'the axes moved')
    # What is told is what was counted.
    counted = twin.counts[:3] / scales.counts_per_unit
    assert counted == pytest.approx([twin.position[axis] for axis in AXES], abs=1e-3)


@pytest.mark.slow
@pytest.mark.alone  # controllers keep wall time
def test_without_commands_the_currents_are_zero_and_that_is_said(twin, controllers):
    program = controllers()
    twin.wait_for(lambda: twin.tick > 900 and np.any(twin.current != 0.0), 'time going on')
    program.signal(signal.SIGKILL)
    program.process.wait(PATIENCE_S)
    twin.wait_for(
        lambda: twin.status is not None and 'the currents are zero' in twin.status.message,
        'silence told',
    )
    assert twin.status.level == DiagnosticStatus.ERROR
    twin.wait_for(lambda: not np.any(twin.current), 'no current')

    controllers()
    twin.wait_for(lambda: np.any(twin.current != 0.0), 'commands taken again')


@pytest.mark.slow
@pytest.mark.alone  # controllers keep wall time
def test_in_lockstep_it_says_what_it_needs(start, domain):
    bridge = start('waferbot_twin.ros2_control.bridge', ROS_DOMAIN_ID=str(domain))
    assert bridge.wait() == 1
    assert 'with timekeeping:=realtime' in bridge.output
    assert 'Traceback' not in bridge.output


def test_counts_and_currents_are_those_of_the_machine():
    """A turn of X-Rotate is 2^20 counts; y_linear has 0.1 um a count."""
    scales = JointScales.of(load_machine('rigid').description)
    assert scales.positions(np.array([10_000_000, 1 << 20, 1 << 20, 0])) == pytest.approx(
        [1.0, 2.0 * np.pi, 2.0 * np.pi], rel=1e-9
    )
    efforts = dict(zip(AXES, scales.effort_per_ampere, strict=True))
    assert scales.currents(efforts) == pytest.approx([1.0, 1.0, 1.0])
    assert scales.currents({'x_rotate': float('nan'), 'elbow': 3.0}) == [0.0, 0.0, 0.0]


def test_the_tag_names_the_joints_of_the_robot_and_of_the_controllers():
    robot = ElementTree.fromstring(with_ros2_control(urdf(load_machine('rigid').description)))
    moving = {
        joint.get('name') for joint in robot.findall('joint') if joint.get('type') != 'fixed'
    }
    (system,) = robot.findall('ros2_control')
    joints = [joint.get('name') for joint in system.findall('joint')]
    assert set(joints) <= moving
    assert system.find('hardware/plugin').text.endswith('/JointStateTopicSystem')
    told = yaml.safe_load(CONTROLLERS.read_text('utf-8'))
    manager = told['controller_manager']['ros__parameters']
    for name in ('joint_trajectory_controller', 'forward_effort_controller'):
        own = told[name]['ros__parameters']
        assert own['joints'] == joints
        assert name in manager
        asked = own.get('command_interfaces', [own.get('interface_name')])
        given = {i.get('name') for i in system.findall('joint/command_interface')}
        assert set(asked) <= given
    states = {one.get('name') for one in system.findall('joint/state_interface')}
    trajectory = told['joint_trajectory_controller']['ros__parameters']
    assert set(trajectory['state_interfaces']) <= states
    assert set(trajectory['gains']) == set(joints)


@pytest.mark.skipif(
    importlib.util.find_spec('launch_ros') is None, reason='launch_ros is not installed'
)
def test_the_launch_file_is_one():
    file = (
        Path(__file__).parents[1] / 'src' / 'waferbot_twin' / 'launch' / 'ros2_control.launch.py'
    )
    spec = importlib.util.spec_from_file_location('ros2_control_launch', file)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert module.generate_launch_description().entities
