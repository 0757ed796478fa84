"""Simulator, observer and recorder together: ``ros2 launch gray_box_observer demo.launch.py duration:=60.0``.

Ends when the simulator does. The observer's first guess is three times off.
"""

from __future__ import annotations

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode, Node
from launch_ros.parameter_descriptions import ParameterValue

from gray_box_observer.ros import discovery

ARGUMENTS = {
    'excitation': ('R[5,15]D[1,20]', 'voltage signal of the simulator'),
    'duration': ('60.0', 'seconds'),
    'output': ('demo_bag', 'folder of the bag; must not exist yet'),
}
TRUTH = {'inductance': 0.5, 'resistance': 1.0, 'hysteresis': 10.0}
FIRST_GUESS_FACTOR = 3.0
READERS_OF_TORQUE = 2


def make_nodes(context: LaunchContext) -> list[Node]:
    """Make the three nodes from the launch arguments."""
    # of these nodes alone: the environment of the launch belongs to whoever includes this file
    kept_here = discovery.default_range(context.environment)
    observer = LifecycleNode(
        package='gray_box_observer',
        executable='observer',
        name='gray_box_observer',
        namespace='',
        output='screen',
        additional_env=kept_here,
        parameters=[{f'motor.initial.{name}': FIRST_GUESS_FACTOR * value for name, value in TRUTH.items()}],
    )
    recorder = Node(
        package='gray_box_observer',
        executable='recorder',
        name='bag_recorder',
        output='screen',
        additional_env=kept_here,
        parameters=[{'output': ParameterValue(LaunchConfiguration('output'), value_type=str)}],
    )
    simulator = Node(
        package='dc_motor_sim',
        executable='motor_sim',
        name='motor_sim',
        output='screen',
        additional_env=kept_here,
        parameters=[
            {
                'excitation': ParameterValue(LaunchConfiguration('excitation'), value_type=str),
                'duration_s': ParameterValue(LaunchConfiguration('duration'), value_type=float),
                'wait_for_subscribers': READERS_OF_TORQUE,
                **{f'motor.{name}': value for name, value in TRUTH.items()},
            }
        ],
        on_exit=Shutdown(reason='the simulator has ended'),
    )
    return [observer, recorder, simulator]


def generate_launch_description() -> LaunchDescription:
    """Describe the launch."""
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in ARGUMENTS.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=make_nodes)])
