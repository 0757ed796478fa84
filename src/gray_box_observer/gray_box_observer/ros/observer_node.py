"""The observer as a managed ROS node: callbacks convert, call the core and publish."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import SetParametersResult
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.subscription import Subscription
from std_srvs.srv import SetBool, Trigger

from gray_box_observer import checkpoint
from gray_box_observer.configuration import NODE_NAME
from gray_box_observer.errors import ConfigurationError, GrayBoxError
from gray_box_observer.intake import Intake
from gray_box_observer.observer import Observer
from gray_box_observer.parameters import SIGNALS
from gray_box_observer.predictor import ProcessTraining
from gray_box_observer.ros import topics
from gray_box_observer.ros.diagnostics import Traffic, status_of
from gray_box_observer.ros.message_types import message_class
from gray_box_observer.ros.outputs import Outputs
from gray_box_observer.ros.parameters import declare
from gray_box_observer.ros.running import Stop, make_executor, parse_arguments, run_node

DIAGNOSTICS_PERIOD_S = 1.0

Transition = TransitionCallbackReturn


class ObserverNode(LifecycleNode):
    """Listens to voltage and torque, publishes estimates, predictions and diagnostics.

    Args:
        stop: ends the process with a reason.
    """

    def __init__(self, stop: Stop) -> None:
        super().__init__(NODE_NAME)
        self._stop = stop
        self._configuration = declare(self)
        self._types = {name: self._message_type(name) for name in SIGNALS}
        self._observer: Observer | None = None
        self._intake: Intake | None = None
        self._outputs: Outputs | None = None
        self._signal_subscriptions: list[Subscription] = []
        self._active = False
        self._has_warned_of_strangers = False
        self._counted = dict.fromkeys(self._configuration.motors, (0, 0))
        self._diagnostics = self.create_publisher(DiagnosticArray, topics.DIAGNOSTICS.name, topics.DIAGNOSTICS.qos)
        self.create_timer(DIAGNOSTICS_PERIOD_S, self._diagnose)
        self.create_service(Trigger, '~/reset', self._reset)
        self.create_service(Trigger, '~/save', self._save)
        self.create_service(Trigger, '~/load', self._load)
        self.create_service(SetBool, '~/freeze', self._freeze)
        self.add_on_set_parameters_callback(self._parameters_set)
        if self._configuration['autostart']:
            for transition in (self.trigger_configure, self.trigger_activate):
                if transition() != Transition.SUCCESS:
                    raise ConfigurationError('the node could not start itself: see the log for the reason')

    def on_configure(self, state: LifecycleState) -> Transition:
        """Build the observer; nothing is received yet."""
        self._begin()
        if self._outputs is None:
            self._outputs = Outputs(self, self._configuration)
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> Transition:
        """Listen and publish."""
        result = super().on_activate(state)
        for name in SIGNALS:
            topic = self._configuration[f'{name}.topic']
            if not topic:
                continue
            if not self._has_header(name):
                self.get_logger().info(
                    f'{self._configuration[f"{name}.type"]} has no header: {name} is stamped by the middleware'
                )
            callback = partial(self._receive if self._has_header(name) else self._receive_bare, name)
            self._signal_subscriptions.append(
                self.create_subscription(self._types[name], topic, callback, topics.SIGNAL_QOS)
            )
        self._active = True
        self._announce()
        names = ', '.join(self._configuration.motors)
        self.get_logger().info(f'active: listening for {names} on {self._topics_in_words()}')
        return result

    def on_deactivate(self, state: LifecycleState) -> Transition:
        """Stop listening; what was learnt stays."""
        self._stop_listening()
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> Transition:
        """Forget everything."""
        self._drop_observer()
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> Transition:
        """Stop for good."""
        self._stop_listening()
        self._drop_observer()
        return super().on_shutdown(state)

    def on_error(self, state: LifecycleState) -> Transition:
        """Go back to where configuring is possible again."""
        self._stop_listening()
        self._drop_observer()
        return Transition.SUCCESS

    def close(self) -> None:
        """End the training processes before the node goes."""
        self._stop_listening()
        if self._observer is not None:
            self._observer.close()

    @property
    def needs_source_time(self) -> bool:
        """Whether a signal's messages have no header, so that the middleware's source time has to stamp them."""
        return not all(self._has_header(name) for name in SIGNALS if self._configuration[f'{name}.topic'])

    def _has_header(self, name: str) -> bool:
        return 'header' in self._types[name].get_fields_and_field_types()

    def _receive(self, name: str, message: Any) -> None:
        self._take(name, message, 0)

    def _receive_bare(self, name: str, message: Any, info: dict[str, Any]) -> None:
        self._take(name, message, info['source_timestamp'])

    def _take(self, name: str, message: Any, arrival_ns: int) -> None:
        if self._observer is None or self._intake is None or self._outputs is None:
            return
        try:
            taken = self._intake.take(name, message, arrival_ns)
        except ConfigurationError as error:
            self._stop(error)
            return
        self._outputs.results(taken.results)
        if name == 'voltage':
            for motor, _ in taken.values:
                self._foretell(self._observer, self._outputs, motor, taken.stamp_ns)

    def _foretell(self, observer: Observer, outputs: Outputs, motor: str, stamp_ns: int) -> None:
        """Publish what a new voltage leads to: at its stamp, and at the horizon if one is asked for."""
        forecast = observer.forecast(motor, stamp_ns)
        if forecast is not None:
            outputs.prediction(forecast.motor, forecast.stamp_ns, forecast.torque_nm)
        horizon_s = self._configuration['horizon_s']
        held = observer.forecast_held(motor, horizon_s) if horizon_s > 0.0 else None
        if held is not None:
            outputs.forecast(held.motor, held.stamp_ns, held.torque_nm)

    def _diagnose(self) -> None:
        if self._observer is None or self._intake is None:
            return
        self._warn_of_strangers(self._observer, self._intake)
        traffic = self._traffic(self._observer)
        array = DiagnosticArray()
        array.header.stamp = self.get_clock().now().to_msg()
        array.status = [
            status_of(motor, self._observer, self._intake, traffic, self._active)
            for motor in self._configuration.motors
        ]
        self._diagnostics.publish(array)

    def _warn_of_strangers(self, observer: Observer, intake: Intake) -> None:
        """Say once where messages speak of other motors while a configured one is never spoken of."""
        for name in ('voltage', 'torque'):
            strangers = sorted(intake.signals[name].unknown)
            silent = [motor for motor, pairing in observer.pairing.items() if not getattr(pairing, f'received_{name}')]
            if strangers and silent and not self._has_warned_of_strangers:
                self._has_warned_of_strangers = True
                self.get_logger().warning(
                    f'{intake.signals[name].topic} speaks of {", ".join(strangers[:5])} and not of '
                    f'{", ".join(silent)}: give the parameter motors the names in the messages'
                )

    def _traffic(self, observer: Observer) -> Traffic:
        used, rejected = {}, {}
        for motor, pairing in observer.pairing.items():
            before_used, before_rejected = self._counted[motor]
            refused = pairing.rejected.total()
            used[motor], rejected[motor] = pairing.used - before_used, refused - before_rejected
            self._counted[motor] = pairing.used, refused
        return Traffic(DIAGNOSTICS_PERIOD_S, used, rejected)

    def _reset(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._observer is None:
            response.success, response.message = False, 'the node is not configured: nothing to reset'
            return response
        self._drop_observer()
        self._begin()
        self._announce()
        response.success, response.message = True, 'everything learnt is forgotten; starting from the initial values'
        return response

    def _save(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._with_checkpoint(response, checkpoint.save, 'saved to')

    def _load(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._with_checkpoint(response, checkpoint.load, 'loaded from')

    def _with_checkpoint(
        self, response: Trigger.Response, action: Callable[[Observer, Path], None], words: str
    ) -> Trigger.Response:
        path = Path(self.get_parameter('checkpoint.path').value)
        if self._observer is None:
            response.success, response.message = False, 'the node is not configured: nothing to save or load'
            return response
        try:
            action(self._observer, path)
        except GrayBoxError as error:
            response.success, response.message = False, str(error)
            return response
        self._announce()
        response.success, response.message = True, f'{words} {path.absolute()}'
        return response

    def _freeze(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        results = self.set_parameters([Parameter('freeze', value=bool(request.data))])
        response.success = results[0].successful
        response.message = results[0].reason or ('frozen' if request.data else 'learning')
        return response

    def _parameters_set(self, parameters: list[Parameter]) -> SetParametersResult:
        for parameter in parameters:
            if parameter.name == 'freeze' and self._observer is not None:
                self._observer.freeze(bool(parameter.value))
        return SetParametersResult(successful=True)

    def _stop_listening(self) -> None:
        for subscription in self._signal_subscriptions:
            self.destroy_subscription(subscription)
        self._signal_subscriptions.clear()
        self._active = False

    def _begin(self) -> None:
        """Make an observer that knows nothing yet."""
        self._observer = Observer(self._configuration, ProcessTraining)
        self._observer.freeze(bool(self.get_parameter('freeze').value))  # it may have been set since the start
        self._intake = Intake(self._observer, self._configuration)
        self._counted = dict.fromkeys(self._configuration.motors, (0, 0))

    def _announce(self) -> None:
        """Publish what is known now: latched topics must not go on telling what was forgotten."""
        if self._observer is None or self._outputs is None or not self._active:
            return
        estimates = self._observer.estimates()
        for motor in self._configuration.motors:
            self._outputs.alarm(motor, self._observer.alarm(motor))
            if motor in estimates:
                self._outputs.estimate(motor, estimates[motor])
            else:
                self._outputs.not_identified(motor)

    def _drop_observer(self) -> None:
        if self._observer is not None:
            self._observer.close()
        self._observer = self._intake = None

    def _message_type(self, name: str) -> Any:
        type_name = self._configuration[f'{name}.type']
        found = message_class(type_name)
        if found is None:
            raise ConfigurationError(
                f'{name}.type {type_name!r} is not a message this environment knows: source the workspace that has it'
            )
        return found

    def _topics_in_words(self) -> str:
        used = [self._configuration[f'{name}.topic'] for name in SIGNALS]
        return ', '.join(self.resolve_topic_name(topic) for topic in used if topic)


def main(args: Sequence[str] | None = None) -> int:
    """Run the observer; the result is the exit code."""
    parser = argparse.ArgumentParser(
        prog='observer',
        description='Identifies inductance, resistance and magnetic hysteresis of DC motors while they run, and '
        'predicts their torque. Parameters: --ros-args --params-file FILE.yaml, or -p NAME:=VALUE.',
        epilog='share/gray_box_observer/config/observer.yaml lists every parameter with its default and meaning.',
    )
    parse_arguments(parser, args)
    nodes: list[ObserverNode] = []

    def make_node(stop: Stop) -> ObserverNode:
        nodes.append(ObserverNode(stop))
        return nodes[0]

    def executor() -> Executor:
        # The events executor carries twice the rate, but in rclpy 7.1 it cannot pass a message's source time along.
        return SingleThreadedExecutor() if nodes[0].needs_source_time else make_executor()

    return run_node(make_node, args, name='observer', executor_factory=executor)


if __name__ == '__main__':
    raise SystemExit(main())
