"""Starts the simulator: ``ros2 launch dc_motor_sim motor_sim.launch.py duration:=60.0``."""

from __future__ import annotations

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from dc_motor_sim.ros import discovery, launch_arguments

ARGUMENTS = {
    'excitation': (
        'R[5,15]D[1,20]',
        'voltage signal, or external to drive the motor by motor/voltage_command',
    ),
    'duration': ('0.0', 'simulated seconds after which the node ends; 0 for never'),
    'seed': ('1', 'seed of everything random'),
    'params_file': ('', 'parameter file (YAML); the arguments above win over it'),
    'namespace': ('', 'namespace of the node and its topics'),
}


def make_nodes(context: LaunchContext) -> list[Node]:
    """Make the simulator's node from the launch arguments."""
    files = launch_arguments.parameter_files(
        'params_file', LaunchConfiguration('params_file').perform(context)
    )
    duration = LaunchConfiguration('duration').perform(context)
    seed = LaunchConfiguration('seed').perform(context)
    parameters = [
        {
            'excitation': ParameterValue(LaunchConfiguration('excitation'), value_type=str),
            'duration_s': launch_arguments.number('duration', duration),
            'seed': launch_arguments.whole_number('seed', seed),
        }
    ]
    return [
        Node(
            package='dc_motor_sim',
            executable='motor_sim',
            name='motor_sim',
            namespace=LaunchConfiguration('namespace'),
            output='screen',
            # of this node alone: the environment of the launch belongs to whoever includes this
            # file
            additional_env=discovery.default_range(context.environment),
            parameters=[*files, *parameters],
        )
    ]


def generate_launch_description() -> LaunchDescription:
    """Describe the launch."""
    declarations = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in ARGUMENTS.items()
    ]
    return LaunchDescription([*declarations, OpaqueFunction(function=make_nodes)])
