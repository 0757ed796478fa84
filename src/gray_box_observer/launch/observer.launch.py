"""Starts the observer: ``ros2 launch gray_box_observer observer.launch.py``.

Motors are configured by ``params_file:=my_motors.yaml``.
"""

from __future__ import annotations

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode
from launch_ros.parameter_descriptions import ParameterValue

from gray_box_observer.ros import discovery, launch_arguments

ARGUMENTS = {
    'params_file': ('', 'parameter file (YAML); without one every parameter has its default'),
    'autostart': ('true', 'false: wait for a lifecycle manager to configure and activate the node'),
    'namespace': ('', 'namespace of the node and its topics'),
}


def make_nodes(context: LaunchContext) -> list[LifecycleNode]:
    """Make the observer's node from the launch arguments."""
    files = launch_arguments.parameter_files(
        'params_file', LaunchConfiguration('params_file').perform(context)
    )
    parameters = [{'autostart': ParameterValue(LaunchConfiguration('autostart'), value_type=bool)}]
    return [
        LifecycleNode(
            package='gray_box_observer',
            executable='observer',
            name='gray_box_observer',
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
