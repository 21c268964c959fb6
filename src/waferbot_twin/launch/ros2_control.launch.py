# SPDX-License-Identifier: Apache-2.0
"""
Launch plant and amplifiers in real time with ros2_control in place of the PMAC.

    ros2 launch waferbot_twin ros2_control.launch.py
    ros2 launch waferbot_twin ros2_control.launch.py controller:=forward_effort_controller

Time stands until the controller is active. Then a trajectory moves the axes (m, rad):

    ros2 topic pub --once /joint_trajectory_controller/joint_trajectory \
      trajectory_msgs/msg/JointTrajectory "{joint_names: [y_linear, x_rotate, y_rotate],
      points: [{positions: [0.01, 0.02, 0.05], time_from_start: {sec: 1}}]}"

The joint states are those of the encoders, on /joint_states; those of the plant itself are on
/plant/joint_states.
"""

from pathlib import Path

from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchDescription
from waferbot_lockstep.node_settings import MACHINE_AXES, MACHINE_ENCODERS
from waferbot_lockstep.package_data import package_data
from waferbot_plant.plant import load_machine
from waferbot_plant.urdf import urdf
from waferbot_twin.models import load_model
from waferbot_twin.ros2_control.joints import with_ros2_control

NEEDED = {
    'controller_manager': 'ros-jazzy-ros2-control',
    'joint_state_broadcaster': 'ros-jazzy-ros2-controllers',
    'joint_state_topic_hardware_interface': 'ros-jazzy-joint-state-topic-hardware-interface',
    'robot_state_publisher': 'ros-jazzy-robot-state-publisher',
}
"""Packages, and the Debian package that brings each."""

ARGUMENTS = (
    DeclareLaunchArgument('model', default_value='rigid', description='name or file of the model'),
    DeclareLaunchArgument(
        'controllers',
        default_value='',
        description='parameters of controllers; empty: those shipped',
    ),
    DeclareLaunchArgument(
        'controller',
        default_value='joint_trajectory_controller',
        description='the one that is started beside joint_state_broadcaster',
    ),
    DeclareLaunchArgument(
        'realtime_factor', default_value='1.0', description='sim seconds per wall second'
    ),
)


def make_nodes(context):
    """Return the nodes; raises for a package that lacks, before anything is started."""
    argument = {name.name: LaunchConfiguration(name.name).perform(context) for name in ARGUMENTS}
    lacking = [package for package in NEEDED if not installed(package)]
    if lacking:
        packages = ' '.join(sorted({NEEDED[package] for package in lacking}))
        raise RuntimeError(f'{", ".join(lacking)} not installed: sudo apt install {packages}')
    parameters = load_model(argument['model']).parameters
    machine = parameters['plant'].get('description', 'rigid')
    description = load_machine(machine).description
    layout = description.layout
    named = {MACHINE_AXES: list(layout.axes), MACHINE_ENCODERS: list(layout.encoders)}
    robot = {'robot_description': with_ros2_control(urdf(description), layout.axes)}
    shipped = package_data('waferbot_twin', 'config', 'ros2_control', 'controllers.yaml')
    controllers = str(Path(argument['controllers'] or shipped))
    real_time = {'timekeeping': 'realtime'}
    plant = {'start_paused': True, 'realtime_factor': float(argument['realtime_factor'])}
    aside = [(name, f'plant/{name}') for name in ('robot_description', 'joint_states')]
    return [
        Node(
            package='waferbot_plant',
            executable='plant',
            name='plant',
            output='screen',
            parameters=[parameters['plant'], real_time, plant],
            remappings=aside,
        ),
        Node(
            package='waferbot_copley',
            executable='copley',
            name='copley',
            output='screen',
            parameters=[parameters['copley'], real_time, named],
        ),
        Node(
            package='waferbot_twin',
            executable='joint_bridge',
            name='joint_bridge',
            output='screen',
            parameters=[real_time, {'description': machine}],
        ),
        Node(
            package='robot_state_publisher',
            executable='robot_state_publisher',
            parameters=[robot],
        ),
        Node(
            package='controller_manager',
            executable='ros2_control_node',
            output='screen',
            parameters=[controllers],
        ),
        Node(
            package='controller_manager',
            executable='spawner',
            output='screen',
            arguments=[
                'joint_state_broadcaster',
                argument['controller'],
                '--param-file',
                controllers,
            ],
        ),
    ]


def installed(package):
    """Return whether a package is there."""
    try:
        get_package_prefix(package)
    except PackageNotFoundError:
        return False
    return True


def generate_launch_description():
    return LaunchDescription([*ARGUMENTS, OpaqueFunction(function=make_nodes)])
