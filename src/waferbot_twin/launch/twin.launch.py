# SPDX-License-Identifier: Apache-2.0
"""
Launch the twin: plant, PMAC and Copley, each its own node, running until stopped.

    ros2 launch waferbot_twin twin.launch.py
    ros2 launch waferbot_twin twin.launch.py model:=rigid copley_per_axis:=true
    ros2 launch waferbot_twin twin.launch.py without:=pmac      # then start your own controller
    ros2 action send_goal /run_experiment waferbot_msgs/action/RunExperiment "{experiment: step}"
"""

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchDescription
from waferbot_lockstep.contract import AXES
from waferbot_twin.models import load_model

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
        description='three Copley nodes, one for each axis, instead of one for all',
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
    DeclareLaunchArgument('namespace', default_value='', description='namespace of all nodes'),
    DeclareLaunchArgument(
        'state_publisher',
        default_value='true',
        choices=['true', 'false'],
        description='start robot_state_publisher, so that RViz and Foxglove show the machine',
    ),
)


def make_nodes(context):
    """Return the nodes that the arguments ask for."""
    argument = {name.name: LaunchConfiguration(name.name).perform(context) for name in ARGUMENTS}
    parameters = load_model(argument['model']).parameters
    common = {'timekeeping': argument['timekeeping']}
    nodes = {
        'plant': (
            'plant',
            parameters['plant'],
            {'realtime_factor': float(argument['realtime_factor'])},
        ),
        'pmac': ('pmac', parameters['pmac'], {'experiment': argument['experiment']}),
    }
    if argument['copley_per_axis'] == 'true':
        for axis in AXES:
            nodes[f'copley_{axis}'] = ('copley', parameters['copley'], {'axes': [axis]})
    else:
        nodes['copley'] = ('copley', parameters['copley'], {})
    without = [name.strip() for name in argument['without'].split(',') if name.strip()]
    unknown = [name for name in without if name not in nodes]
    if unknown:
        raise RuntimeError(f'without: no node {", ".join(unknown)}; nodes: {", ".join(nodes)}')
    return [
        Node(
            package=f'waferbot_{kind}',
            executable=kind,
            name=name,
            namespace=argument['namespace'],
            output='screen',
            emulate_tty=True,
            parameters=[own, common, extra],
        )
        for name, (kind, own, extra) in nodes.items()
        if name not in without
    ]


def generate_launch_description():
    state_publisher = Node(
        package='robot_state_publisher',
        executable='robot_state_publisher',
        namespace=LaunchConfiguration('namespace'),
        parameters=[{'robot_description': _description(), 'use_sim_time': True}],
        condition=IfCondition(LaunchConfiguration('state_publisher')),
    )
    return LaunchDescription([*ARGUMENTS, OpaqueFunction(function=make_nodes), state_publisher])


def _description():
    from waferbot_plant.plant import load_machine
    from waferbot_plant.urdf import urdf

    return urdf(load_machine('rigid').description)
