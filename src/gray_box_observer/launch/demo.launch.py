"""Simulator, observer, recorder and dashboard: ``ros2 launch gray_box_observer demo.launch.py``.

Ends when one of them does, which the simulator does after its duration. The observer's first guess
is three times off.
"""

from __future__ import annotations

from typing import Any

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from gray_box_observer.ros import discovery, launch_arguments

ARGUMENTS = {
    'excitation': ('R[5,15]D[0.3,3]', 'voltage signal of the simulator'),
    'duration': ('60.0', 'seconds'),
    'torque_noise': ('0.01', 'noise of the torque, as a fraction of its standard deviation'),
    'output': (
        '',
        'folder of the bag, which must not exist yet; empty: demo_bag, or demo_bag_2 and so on',
    ),
    'params_file': (
        '',
        "parameter file (YAML) of all nodes, in place of the demo's motor and first guess",
    ),
    'dashboard_port': (
        '0',
        'port of the page that shows the run, on this host only; 0: a free one; none: no page',
    ),
    'namespace': ('', 'namespace of the nodes and their topics'),
}
TRUTH = {'inductance': 0.5, 'resistance': 1.0, 'hysteresis': 10.0}
FIRST_GUESS_FACTOR = 3.0


def make_nodes(context: LaunchContext) -> list[Node]:
    """Make the nodes from the launch arguments."""
    files = launch_arguments.parameter_files(
        'params_file', LaunchConfiguration('params_file').perform(context)
    )
    duration = LaunchConfiguration('duration').perform(context)
    torque_noise = LaunchConfiguration('torque_noise').perform(context)
    output = LaunchConfiguration('output').perform(context)
    motor = {f'motor.{name}': value for name, value in TRUTH.items()}
    guess = {f'motor.initial.{name}': FIRST_GUESS_FACTOR * value for name, value in TRUTH.items()}
    port = launch_arguments.port(
        'dashboard_port', LaunchConfiguration('dashboard_port').perform(context)
    )
    namespace = LaunchConfiguration('namespace').perform(context)
    bag = launch_arguments.new_folder('output', output, 'demo_bag')
    sim_parameters = {
        'excitation': ParameterValue(LaunchConfiguration('excitation'), value_type=str),
        'duration_s': launch_arguments.number('duration', duration),
        'torque_noise_relative': launch_arguments.number('torque_noise', torque_noise),
        # observer, recorder and page
        'wait_for_subscribers': 2 if port is None else 3,
    }

    # Plain nodes: launch_ros ends with an error where the end is asked for twice and one of the
    # nodes is managed.
    common_arguments: dict[str, Any] = {
        'namespace': namespace,
        'output': 'screen',
        # of these nodes alone: the environment of the launch belongs to whoever includes this file
        'additional_env': discovery.default_range(context.environment),
    }
    page = ['--port', str(port), '--observer', f'{namespace}/gray_box_observer']
    dashboard = Node(
        package='gray_box_observer',
        executable='dashboard',
        name='gray_box_dashboard',
        arguments=[*page, *(word for file in files for word in ('--params', file))],
        on_exit=Shutdown(reason='the dashboard has ended'),
        **common_arguments,
    )
    return [
        *([] if port is None else [dashboard]),
        Node(
            package='gray_box_observer',
            executable='observer',
            name='gray_box_observer',
            parameters=files or [guess],
            on_exit=Shutdown(reason='the observer has ended'),
            **common_arguments,
        ),
        Node(
            package='gray_box_observer',
            executable='recorder',
            name='bag_recorder',
            parameters=[*files, {'output': ParameterValue(bag, value_type=str)}],
            on_exit=Shutdown(reason='the recorder has ended'),
            **common_arguments,
        ),
        Node(
            package='dc_motor_sim',
            executable='motor_sim',
            name='motor_sim',
            parameters=[*files, sim_parameters if files else {**motor, **sim_parameters}],
            on_exit=Shutdown(reason='the simulator has ended'),
            **common_arguments,
        ),
    ]


def generate_launch_description() -> LaunchDescription:
    """Describe the launch."""
    declarations = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in ARGUMENTS.items()
    ]
    return LaunchDescription([*declarations, OpaqueFunction(function=make_nodes)])
