"""Transitions that are not there, without a node."""

from __future__ import annotations

from unittest.mock import Mock

from lifecycle_msgs.srv import ChangeState
from rclpy.impl.implementation_singleton import rclpy_implementation

from gray_box_observer.ros.life_cycle import survive_impossible_transitions


def test_the_label_that_a_caller_gives_is_shown_in_the_log_and_not_obeyed():
    node = Mock()
    node._service_change_state.callback = Mock(
        side_effect=rclpy_implementation.RCLError('no such\x1b[2J transition')
    )
    survive_impossible_transitions(node)
    request = ChangeState.Request()
    request.transition.label = '\x1b[31mred\nnext entry'
    answer = node._service_change_state.callback(request, ChangeState.Response())
    assert not answer.success
    (line,) = node.get_logger().warning.call_args.args
    assert line.isprintable()
    assert r'no transition \x1b[31mred\nnext entry from here: no such\x1b[2J' in line
