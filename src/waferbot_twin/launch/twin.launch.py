# SPDX-License-Identifier: Apache-2.0
"""
Launch the twin: plant, PMAC and Copley, each its own node, running until stopped.

    ros2 launch waferbot_twin twin.launch.py
    ros2 launch waferbot_twin twin.launch.py model:=rigid copley_per_axis:=true
    ros2 launch waferbot_twin twin.launch.py without:=pmac      # then start your own controller
    ros2 launch waferbot_twin twin.launch.py experiment:=step record:=runs/first
    ros2 launch waferbot_twin twin.launch.py secure:=keystore    # of `waferbot secure`
    ros2 action send_goal /run_experiment waferbot_msgs/action/RunExperiment "{experiment: step}"

With a namespace everything of the twin is in it, its clock and transforms as well, so that several twins
live beside each other. Tools that follow the time of one need
`--ros-args -r /clock:=/NAMESPACE/clock`.
"""

import os
from pathlib import Path

from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from launch.actions import (
    DeclareLaunchArgument,
    LogInfo,
    OpaqueFunction,
    SetEnvironmentVariable,
    Shutdown,
)
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchDescription
from waferbot_lockstep.contract import RECORDER_WINDOW
from waferbot_lockstep.node_settings import MACHINE_AXES, MACHINE_ENCODERS
from waferbot_plant.plant import load_machine
from waferbot_plant.urdf import urdf
from waferbot_pmac.user_units import units_text
from waferbot_twin.models import load_model
from waferbot_twin.security import enclave_of, environment_of

TO_LEAVE_S = '15'
"""Wall time to leave in after SIGINT: nodes stay until heard, a recorder until all is written."""

ARGUMENTS = (
    DeclareLaunchArgument('model', default_value='rigid', description='name or file of the model'),
    DeclareLaunchArgument(
        'experiment',
        default_value='constant',
        description='name or file of the experiment that begins at tick 0',
    ),
    DeclareLaunchArgument(
        'copley_per_axis',
        default_value='false',
        choices=['true', 'false'],
        description='a Copley node for each axis, instead of one for all',
    ),
    DeclareLaunchArgument(
        'without',
        default_value='',
        description='nodes not to start, separated by commas; yours take their places',
    ),
    DeclareLaunchArgument(
        'timekeeping',
        default_value='lockstep',
        choices=['lockstep', 'realtime'],
        description='lockstep: nobody advances before all messages of a tick are in; '
        'realtime: the plant follows the wall clock',
    ),
    DeclareLaunchArgument(
        'realtime_factor', default_value='1.0', description='sim seconds per wall second'
    ),
    DeclareLaunchArgument(
        'record',
        default_value='',
        description='record to this new folder until the twin is stopped; empty: do not',
    ),
    DeclareLaunchArgument('namespace', default_value='', description='namespace of all nodes'),
    DeclareLaunchArgument(
        'secure',
        default_value='',
        description='keystore that `waferbot secure` made: who has no key there does not take part',
    ),
    DeclareLaunchArgument(
        'state_publisher',
        default_value='auto',
        choices=['auto', 'true', 'false'],
        description='start robot_state_publisher, so that RViz and Foxglove show the machine; '
        'auto: if it is installed',
    ),
)


def make_nodes(context):
    """Return the nodes that the arguments ask for."""
    argument = {name.name: LaunchConfiguration(name.name).perform(context) for name in ARGUMENTS}
    parameters = load_model(argument['model']).parameters
    common = {'timekeeping': argument['timekeeping']}
    machine = load_machine(parameters['plant'].get('description', 'rigid'))
    layout = machine.layout
    named = {MACHINE_AXES: list(layout.axes), MACHINE_ENCODERS: list(layout.encoders)}
    nodes = {
        'plant': (
            'plant',
            parameters['plant'],
            {'realtime_factor': float(argument['realtime_factor'])},
        ),
        'pmac': (
            'pmac',
            parameters['pmac'],
            {
                'experiment': argument['experiment'],
                'units': units_text(machine.description.axis_units),
                **named,
            },
        ),
    }
    if argument['copley_per_axis'] == 'true':
        for axis in layout.axes:
            nodes[f'copley_{axis}'] = ('copley', parameters['copley'], {'axes': [axis], **named})
    else:
        nodes['copley'] = ('copley', parameters['copley'], named)
    if argument['record']:
        nodes['plant'][2]['start_paused'] = True  # the recorder lets time go
    if argument['record'] and argument['timekeeping'] == 'lockstep':
        nodes['plant'][2]['recorder_window'] = RECORDER_WINDOW
    without = [name.strip() for name in argument['without'].split(',') if name.strip()]
    unknown = [name for name in without if name not in nodes]
    if unknown:
        raise RuntimeError(f'without: no node {", ".join(unknown)}; nodes: {", ".join(nodes)}')
    return [
        *security(argument['secure']),
        *state_publisher(argument, machine),
        *recorder(argument),
        *(
            twin_node(kind, name, argument, [own, common, extra])
            for name, (kind, own, extra) in nodes.items()
            if name not in without
        ),
    ]


def security(keystore):
    """Return what lets only those take part who have a key in a keystore, if there is one."""
    if not keystore:
        return []
    environment = environment_of(Path(keystore), int(os.environ.get('ROS_DOMAIN_ID') or 0))
    return [SetEnvironmentVariable(*one) for one in environment.items()]


def enclave(argument, kind):
    """Return the arguments of ROS by which a node has its key."""
    return ['--enclave', enclave_of(kind)] if argument['secure'] else []


def twin_node(kind, name, argument, parameters):
    """Return a node of the twin."""
    return Node(
        package=f'waferbot_{kind}',
        executable=kind,
        name=name,
        namespace=argument['namespace'],
        ros_arguments=enclave(argument, kind),
        output='screen',
        emulate_tty=True,
        sigterm_timeout=TO_LEAVE_S,
        parameters=parameters,
    )


def recorder(argument):
    """
    Return the node that records, if it is wanted.

    Where it cannot record, the plant would wait for it at tick 0: then everything ends.
    """
    if not argument['record']:
        return []
    told = ('model', 'experiment', 'without', 'timekeeping')
    return [
        Node(
            package='waferbot_twin',
            executable='recorder',
            namespace=argument['namespace'],
            ros_arguments=enclave(argument, 'recorder'),
            output='screen',
            sigterm_timeout=TO_LEAVE_S,
            on_exit=Shutdown(reason='the recorder has ended'),
            arguments=[
                argument['record'],
                *(f'--{name}={argument[name]}' for name in told),
            ],
        )
    ]


def state_publisher(argument, machine):
    """
    Return robot_state_publisher for the machine, or what to say where it lacks.

    It is looked for before anything is started: a launch that fails halfway leaves its nodes behind.
    """
    wanted = argument['state_publisher']
    if wanted == 'false':
        return []
    try:
        get_package_prefix('robot_state_publisher')
    except PackageNotFoundError:
        lacks = 'robot_state_publisher is not installed'
        if wanted == 'true':
            raise RuntimeError(f'{lacks}; install it, or leave state_publisher:=auto') from None
        return [LogInfo(msg=f'{lacks}: nobody publishes /tf')]
    return [
        Node(
            package='robot_state_publisher',
            executable='robot_state_publisher',
            namespace=argument['namespace'],
            ros_arguments=enclave(argument, 'robot_state_publisher'),
            parameters=[{'robot_description': urdf(machine.description), 'use_sim_time': True}],
            remappings=[('/clock', 'clock'), ('/tf', 'tf'), ('/tf_static', 'tf_static')],
        )
    ]


def generate_launch_description():
    return LaunchDescription([*ARGUMENTS, OpaqueFunction(function=make_nodes)])
