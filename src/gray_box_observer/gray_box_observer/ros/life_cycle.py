"""What rclpy's life cycle lacks in Jazzy."""

from __future__ import annotations

from collections.abc import Callable

from lifecycle_msgs.srv import ChangeState
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode
from rclpy.service import Service

from gray_box_observer.safe_io.printable import printable


def survive_impossible_transitions(node: LifecycleNode) -> None:
    """Answer no to a transition that the present state does not have, as rclcpp does.

    rclpy 7.1 raises instead, in the service's callback: the caller waits for ever and the node
    dies, of nothing worse than ``ros2 lifecycle set`` at the wrong moment.
    """
    service: Service = node._service_change_state
    change: Callable[[ChangeState.Request, ChangeState.Response], ChangeState.Response] = (
        service.callback
    )

    def guarded(
        request: ChangeState.Request, response: ChangeState.Response
    ) -> ChangeState.Response:
        try:
            return change(request, response)
        except rclpy_implementation.RCLError as error:
            transition_name = request.transition.label or request.transition.id
            node.get_logger().warning(
                printable(f'no transition {transition_name} from here: {error}')
            )
            response.success = False
            return response

    service.callback = guarded
