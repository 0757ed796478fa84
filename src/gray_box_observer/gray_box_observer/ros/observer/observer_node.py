"""The observer as a managed ROS node: callbacks convert, call the core and publish."""

from __future__ import annotations

import argparse
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.timer import Timer
from std_srvs.srv import SetBool, Trigger

from gray_box_observer.checkpoints.checkpoint_folder import CheckpointFolder, default_folder
from gray_box_observer.checkpoints.checkpoint_manager import CheckpointKeeper
from gray_box_observer.context_nodes.native import regular_block
from gray_box_observer.errors import ConfigurationError, GrayBoxError
from gray_box_observer.observer.incident import in_words
from gray_box_observer.observer.message_input import MessageInput
from gray_box_observer.observer.motor_group import Group, GroupResult
from gray_box_observer.observer.observer import Observer
from gray_box_observer.predictor import ProcessTraining
from gray_box_observer.ros.life_cycle import survive_impossible_transitions
from gray_box_observer.ros.listed_parameters import help_text
from gray_box_observer.ros.node_parameters import LiveParameters, declare
from gray_box_observer.ros.observer.commentary import Commentary
from gray_box_observer.ros.observer.dashboard_process import DashboardProcess
from gray_box_observer.ros.observer.diagnoser import Diagnoser
from gray_box_observer.ros.observer.topic_inputs import Inputs
from gray_box_observer.ros.observer.topic_outputs import Outputs
from gray_box_observer.ros.observer.traffic import TrafficMeter
from gray_box_observer.ros.periodic_task import PeriodicTask
from gray_box_observer.ros.qos import unused_overrides
from gray_box_observer.ros.running import Stop, make_executor, parse_arguments, run_node
from gray_box_observer.safe_io.printable import printable
from gray_box_observer.samples import Rejection
from gray_box_observer.settings.configuration import Configuration
from gray_box_observer.settings.parameters import MOTOR_PARAMETERS, OBSERVER_PARAMETERS
from gray_box_observer.settings.ros_parameter_file import NODE_NAME
from gray_box_observer.settings.signal_parameters import INPUT_PARAMETERS

DIAGNOSTICS_PERIOD_S = 1.0

MOST_NAMED = 10
"""Motors named in a line of the log."""

ARRIVED = {
    'configure': 'ready to be activated',
    'deactivate': 'listening no more; what was learnt stays',
    'clean up': 'what was learnt is forgotten',
    'shut down': 'the end',
}
"""What a transition has led to, as the log says it; activation says what it listens to."""

OF_EACH_MOTOR = (
    'parameters of each motor, below its name (-p motor.delay:=0.05), or below defaults for all'
)
"""What ``--help`` calls them."""

OF_EACH_INPUT = 'parameters of each input that an expression names, below its name'
"""What ``--help`` calls these."""

Transition = TransitionCallbackReturn


class ObserverNode(LifecycleNode):
    """Listens to voltage and torque, publishes estimates, predictions and diagnostics.

    Args:
        stop: ends the process with a reason.
    """

    def __init__(self, stop: Stop) -> None:
        super().__init__(NODE_NAME)
        self._stop = stop
        self._state = 'unconfigured'
        self._reason = ''
        self._configuration = declare(self)
        keeper = self._keeper = self._make_keeper(self._configuration)
        self._inputs = Inputs(
            self,
            self._configuration,
            self._ingest,
            self._refuse,
            writers=lambda: keeper.thread_numbers,
        )
        self._observer: Observer | None = None
        self._message_input: MessageInput | None = None
        self._outputs: Outputs | None = None
        self._meter = TrafficMeter()
        self._deferred_results: list[GroupResult] = []
        self._incident_names: set[str] = set()
        # operators and disks live by the clock on the wall, also where /clock stands still
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._checkpoint_timer: Timer | None = None
        motors = list(self._configuration.motors)
        self._diagnoser = Diagnoser(self, motors, self._inputs, self._meter, self._keeper)
        self._commentary = Commentary(
            motors,
            lambda line: self.get_logger().info(printable(line)),
            lambda line: self.get_logger().warning(printable(line)),
            self._why_silent,
            speed_has_topic=self._configuration.has_own_speed,
        )
        self._tasks: dict[str, PeriodicTask] = {}
        self._time('diagnostics', DIAGNOSTICS_PERIOD_S, self._tell)
        if self._configuration['estimates_period_s'] > 0.0:
            self._time('estimates', self._configuration['estimates_period_s'], self._tell_estimates)
        survive_impossible_transitions(self)
        self.create_service(Trigger, '~/reset', self._reset)
        self.create_service(Trigger, '~/save', self._save)
        self.create_service(Trigger, '~/load', self._load)
        self.create_service(SetBool, '~/freeze', self._freeze)
        self._dashboard = self._make_dashboard()
        LiveParameters(self, self._configuration, self._check, self._reconfigure)
        if self._configuration['autostart']:
            for transition in (self.trigger_configure, self.trigger_activate):
                if transition() != Transition.SUCCESS:
                    raise ConfigurationError(self._reason)

    def on_configure(self, state: LifecycleState) -> Transition:
        """Build the observer, from its checkpoint where asked to; nothing is received yet."""
        return self._change(
            'configure',
            'inactive',
            self._configure,
            lambda: super(ObserverNode, self).on_configure(state),
        )

    def on_activate(self, state: LifecycleState) -> Transition:
        """Listen and publish."""
        return self._change(
            'activate',
            'active',
            self._inputs.open,
            lambda: super(ObserverNode, self).on_activate(state),
        )

    def on_deactivate(self, state: LifecycleState) -> Transition:
        """Stop listening; what was learnt stays."""
        return self._change(
            'deactivate',
            'inactive',
            self._deactivate,
            lambda: super(ObserverNode, self).on_deactivate(state),
        )

    def on_cleanup(self, state: LifecycleState) -> Transition:
        """Forget everything but the checkpoint."""
        return self._change(
            'clean up',
            'unconfigured',
            self._forget,
            lambda: super(ObserverNode, self).on_cleanup(state),
        )

    def on_shutdown(self, state: LifecycleState) -> Transition:
        """Stop for good."""
        return self._change(
            'shut down',
            'finalized',
            self._end,
            lambda: super(ObserverNode, self).on_shutdown(state),
        )

    def on_error(self, state: LifecycleState) -> Transition:
        """Go back to where configuring is possible again, whatever has failed."""
        for action in (self._inputs.close, self._drop_observer, self._retract):
            try:
                action()
            except Exception:
                self.get_logger().error(traceback.format_exc())
        self._observer = self._message_input = None
        self._state = 'unconfigured'
        super().on_deactivate(state)  # publishers
        return Transition.SUCCESS

    def close(self) -> None:
        """Write the last checkpoint and end the training processes before the node goes."""
        self._inputs.close()
        self._sum_up()
        failure = self._keeper.close(self._observer)
        if failure is not None:
            self.get_logger().error(failure)
        self._drop_observer()
        if self._dashboard is not None:  # last: it may take its time, whoever ends this does not
            self._dashboard.close()

    @property
    def needs_source_time(self) -> bool:
        """Whether the middleware's source time has to stamp messages."""
        return self._inputs.needs_source_time

    def _change(
        self, verb: str, state: str, action: Callable[[], None], entities: Callable[[], Transition]
    ) -> Transition:
        """Carry a transition out; rclpy itself would swallow the reason of one that fails."""
        try:
            action()
            result = entities()
            self._state = state
            self._arrived(verb)
        except GrayBoxError as error:
            self._reason = f'could not {verb}: {error}'
            self.get_logger().error(self._reason)
            return Transition.ERROR
        except Exception:
            self._reason = f'could not {verb}: {traceback.format_exc()}'
            self.get_logger().error(self._reason)
            return Transition.ERROR
        return result

    def _arrived(self, verb: str) -> None:
        """Do what a state of the life cycle begins with."""
        self._time_checkpoints()
        if self._state != 'active':
            if verb != 'configure' or not self._configuration['autostart']:
                self.get_logger().info(f'{self._state}: {ARRIVED[verb]}')
            return
        self._commentary.listen()
        self._announce()
        names = _in_words(list(self._configuration.motors))
        self.get_logger().info(f'active: listening for {names} on {self._inputs.in_words}')
        if unknown_names := unused_overrides(self):
            self.get_logger().warning(
                f'no such topic here, ignored: {", ".join(unknown_names)}; a slip of the pen?'
            )

    def _configure(self) -> None:
        self._begin()
        assert self._observer is not None
        if self._keeper.automatic:
            resumption = self._keeper.resume(self._observer)
            if resumption.refusal is not None:
                self.get_logger().error(f'starting from the initial values: {resumption.refusal}')
            elif resumption.is_found:
                self.get_logger().info(f'continuing from {self._keeper.file}')
            else:
                self.get_logger().info(
                    f'starting from the initial values: no checkpoint yet at {self._keeper.file}'
                )
        if self._configuration['context_update'] == 'recursive' and regular_block.library() is None:
            self.get_logger().info(
                'built without a C compiler: every block is learnt by numpy, at ten times the cost'
            )
        if self._outputs is None:
            self._outputs = Outputs(self, self._configuration)

    def _deactivate(self) -> None:
        self._inputs.close()
        self._keep()

    def _end(self) -> None:
        self._sum_up()
        self._deactivate()
        self._forget()

    def _sum_up(self) -> None:
        """Tell what came of it all, once the end has come."""
        if self._observer is not None:
            self.get_logger().info(printable(self._commentary.summary(self._observer)))

    def _why_silent(self, signals: Iterable[str]) -> str:
        """Say why nothing comes of these signals; empty where the graph does not tell."""
        trouble = self._inputs.trouble(signals)
        return '' if trouble is None else trouble.message

    def _forget(self) -> None:
        self._drop_observer()
        self._retract()

    def _retract(self) -> None:
        """Leave latched what is true of a node that knows nothing."""
        if self._outputs is not None:
            self._outputs.retract()

    def _ingest(self, name: str, message: Any, arrival_ns: int, topic: str = '') -> None:
        if (
            self._observer is None
            or self._message_input is None
            or self._outputs is None
            or self._stop.is_requested
        ):
            return  # the end does not wait for messages that have queued up
        since_s = time.perf_counter()
        try:
            input_result = self._message_input.ingest(name, message, arrival_ns, topic)
            self._outputs.results(input_result.groups)
            if name == 'voltage' and input_result.names:
                for group in self._observer.groups(input_result.names):
                    self._publish_forecast(
                        self._observer, self._outputs, group, input_result.stamp_ns
                    )
            for result in input_result.groups:
                self._observer.precompute_forecast(result.group)
            self._meter.update(input_result.groups)
            self._deferred_results += input_result.groups
            if all(result.estimate is None for result in input_result.groups):
                # else the next prediction comes first: an update has taken its time
                self._run_deferred()
            if len(self._observer.incidents) != len(self._incident_names):
                self._report_incidents()
        except ConfigurationError as error:  # a field that is not there, a device that fails
            self._stop(error)
            return
        self._meter.worked(since_s)
        self._do_due_task(quiet=bool(input_result.groups) and not self._deferred_results)

    def _refuse(self, name: str, reason: Rejection) -> None:
        if self._message_input is None or self._stop.is_requested:
            return
        self._message_input.refuse(name, reason)
        self._do_due_task(quiet=False)

    def _do_due_task(self, *, quiet: bool) -> None:
        """Do one thing that is due, if any; the next one comes behind the other messages."""
        for name, task in self._tasks.items():
            if task.on_message(quiet=quiet):
                self._tasks[name] = self._tasks.pop(name)
                return

    def _run_deferred(self) -> None:
        """Do what samples have left to be done when all has gone out that somebody waits for."""
        results, self._deferred_results = self._deferred_results, []
        outputs, observer = self._outputs, self._observer
        if outputs is None or observer is None:
            return
        queue = deque(results)
        while True:
            try:
                outputs.alarms(_consumed(queue))
                return
            except ConfigurationError:
                raise
            except Exception as error:
                if not queue:
                    raise
                observer.stop(queue.popleft().group, error)

    def _publish_forecast(
        self, observer: Observer, outputs: Outputs, group: Group, stamp_ns: int
    ) -> None:
        """Publish a new voltage's predictions: at its stamp, and at a requested horizon."""
        torque_nm = observer.forecast_group(group, stamp_ns)
        if torque_nm is not None:
            outputs.prediction(group.names, stamp_ns, torque_nm)
        horizon_s = self._configuration['horizon_s']
        group_forecast = observer.forecast_group_held(group, horizon_s) if horizon_s > 0.0 else None
        if group_forecast is not None:
            outputs.forecast(group.names, *group_forecast)

    def _tell(self) -> None:
        """Publish diagnostics, and alarms that no further message has led to."""
        self._run_deferred()
        if self._observer is not None and self._outputs is not None:
            for group in self._observer.every_group:
                self._observer.contain(group, partial(self._outputs.publish_tested, group))
        traffic = self._diagnoser.publish(self._state, self._observer, self._message_input)
        if traffic is not None and self._observer is not None and self._state == 'active':
            self._commentary.look(self._observer, traffic)
        self._report_incidents()

    def _report_incidents(self) -> None:
        """Report motors that have stopped since the last call, and clear their latched topics."""
        if self._observer is None or self._outputs is None:
            return
        incidents = self._observer.incidents
        if incidents.keys() - self._incident_names:
            self._correct_estimates()
        for incident in {
            id(incidents[name]): incidents[name] for name in incidents.keys() - self._incident_names
        }.values():
            for motor in incident.motors:
                self._outputs.retract_motor(motor)
            self.get_logger().error(
                f'{in_words(incident.motors)} stopped by a defect: {incident.reason}; the others '
                'go on, ~/reset starts '
                f'anew\n{incident.trace}'
            )
            self._keeper.report(incident, self.get_logger().warning)
        self._incident_names = set(incidents)

    def _reset(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._observer is None:
            response.success, response.message = (
                False,
                'the node is not configured: nothing to reset',
            )
            return response
        self._drop_observer()
        aside = self._keeper.forget()
        self._begin()
        self._announce(is_new=True)
        checkpoint_note = '' if aside is None else f'; the checkpoint is kept as {aside}'
        response.success = True
        response.message = (
            f'everything learnt is forgotten; starting from the initial values{checkpoint_note}'
        )
        self.get_logger().info(f'~/reset: {response.message}')
        return response

    def _save(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._with_checkpoint(response, self._keeper.save, 'saved to')

    def _load(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._with_checkpoint(response, self._keeper.load, 'loaded from')

    def _with_checkpoint(
        self, response: Trigger.Response, action: Callable[[Observer], str], words: str
    ) -> Trigger.Response:
        if self._observer is None:
            response.success, response.message = (
                False,
                'the node is not configured: nothing to save or load',
            )
            return response
        try:
            # an alarm of what was learnt so far must not go out after what is loaded
            self._run_deferred()
            path = action(self._observer)
        except GrayBoxError as error:
            response.success, response.message = False, str(error)
            self.get_logger().warning(
                f'not {words.partition(" ")[0]}: {printable(response.message)}'
            )
            return response
        self._announce(is_new=action == self._keeper.load)
        response.success, response.message = True, f'{words} {path}'
        self.get_logger().info(response.message)
        return response

    def _freeze(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        results = self.set_parameters([Parameter('freeze', value=bool(request.data))])
        response.success = results[0].successful
        response.message = results[0].reason or ('frozen' if request.data else 'learning')
        return response

    def _check(self, configuration: Configuration) -> None:
        """Refuse what the configuration alone cannot judge."""
        self._keeper.folder.file(configuration['checkpoint.path'])

    def _reconfigure(self, configuration: Configuration) -> None:
        """Let changed parameters take effect; what was learnt stays."""
        if configuration['freeze'] != self._configuration['freeze']:
            self.get_logger().info(
                'frozen: nothing is learnt' if configuration['freeze'] else 'learning again'
            )
        self._configuration = configuration
        self._keeper.path = configuration['checkpoint.path']
        self._time_checkpoints()
        if self._observer is not None:
            self._observer.reconfigure(configuration)
        self._announce()

    def _time_checkpoints(self) -> None:
        """Have a checkpoint taken every so often while there is something to learn."""
        if self._checkpoint_timer is not None:
            self.destroy_timer(self._checkpoint_timer)
            self._checkpoint_timer = None
            del self._tasks['checkpoint']
        period_s = self._configuration['checkpoint.period_s']
        if self._keeper.automatic and self._state == 'active' and period_s > 0.0:
            self._checkpoint_timer = self._time('checkpoint', period_s, self._keep)

    def _time(self, name: str, period_s: float, action: Callable[[], None]) -> Timer:
        """Have something done every so often."""
        task = self._tasks[name] = PeriodicTask(period_s, partial(self._do, action))
        return self.create_timer(period_s, task.on_timer, clock=self._steady)

    def _do(self, action: Callable[[], None]) -> None:
        """Do something that may be the first to find that a device has failed."""
        try:
            action()
        except ConfigurationError as error:
            self._stop(error)

    def _keep(self) -> None:
        self._keeper.keep(self._observer)

    def _begin(self) -> None:
        """Make an observer that knows nothing yet."""
        self._observer = Observer(self._configuration, ProcessTraining)
        self._incident_names = set()
        self._message_input = MessageInput(self._observer, self._configuration)
        self._meter.forget()
        self._commentary.forget()

    def _announce(self, *, is_new: bool = False) -> None:
        """Publish what is known now: latched topics must not go on telling what was forgotten.

        Args:
            is_new: whether what is known does not follow from what was published before.
        """
        if self._observer is None or self._outputs is None:
            return
        if self._state != 'active':  # it is told when the node is activated
            if is_new:
                self._outputs.retract()
            return
        self._tell_estimates()
        self._outputs.forget_published()
        for motor in self._configuration.motors if self._configuration['motor_topics'] else ():
            group = self._observer.group_of(motor)
            self._observer.contain(
                group, partial(self._announce_motor, self._observer, self._outputs, motor)
            )
        self._report_incidents()

    @staticmethod
    def _announce_motor(observer: Observer, outputs: Outputs, motor: str) -> None:
        outputs.alarm(motor, observer.alarm(motor))
        estimate, is_identified = observer.estimate_of(motor)
        outputs.estimate(motor, estimate, is_identified)
        outputs.parameters_identified(
            motor, estimate.parameters, observer.parameters_identified(motor)
        )
        outputs.fit(motor, observer.fit(motor))

    def _tell_estimates(self) -> None:
        """Publish what is known of every motor, in one message."""
        if self._observer is not None and self._outputs is not None and self._state == 'active':
            self._outputs.all_estimates(
                list(self._configuration.motors), self._observer.group_estimates()
            )

    def _correct_estimates(self) -> None:
        """Clear a stopped motor on ``~/estimates``; its periodic reports have ended."""
        if self._observer is None or self._outputs is None:
            return
        if self._state == 'active':
            self._tell_estimates()
        else:
            self._outputs.retract_estimates()

    def _drop_observer(self) -> None:
        self._deferred_results = []
        if self._observer is not None:
            self._observer.close()
        self._observer = self._message_input = None

    def _make_dashboard(self) -> DashboardProcess | None:
        """Start the page that shows the motors, where one is asked for."""
        if not self._configuration['dashboard.port']:
            return None
        log = self.get_logger()
        return DashboardProcess(
            self, self._configuration, lambda line: log.info(line), lambda line: log.warning(line)
        )

    def _make_keeper(self, configuration: Configuration) -> CheckpointKeeper:
        path = configuration['checkpoint.path']
        default = default_folder(self.get_fully_qualified_name())
        folder = CheckpointFolder(configuration['checkpoint.folder'], path, default)
        return CheckpointKeeper(folder, path, automatic=configuration['checkpoint.resume'])


def _consumed(queue: deque[GroupResult]) -> Iterator[GroupResult]:
    """Yield results; each leaves the queue when done, so that one that fails is still first."""
    while queue:
        yield queue[0]
        queue.popleft()


def _in_words(names: list[str]) -> str:
    """Name motors, as far as a line of a log bears it."""
    more = f' and {len(names) - MOST_NAMED} more' if len(names) > MOST_NAMED else ''
    return ', '.join(names[:MOST_NAMED]) + more


def main(args: Sequence[str] | None = None) -> int:
    """Run the observer; the result is the exit code."""
    parser = argparse.ArgumentParser(
        prog='observer',
        description='Identifies inductance, resistance and magnetic hysteresis of DC motors while '
        'they run, and '
        'predicts their torque.\nParameters: --ros-args --params-file FILE.yaml, or -p '
        'NAME:=VALUE.',
        epilog=f'{help_text(OBSERVER_PARAMETERS)}\n\n{help_text(MOTOR_PARAMETERS, OF_EACH_MOTOR)}'
        f'\n\n{help_text(INPUT_PARAMETERS, OF_EACH_INPUT)}\n\n'
        'share/gray_box_observer/config/observer.yaml holds them all, to begin with.',
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parse_arguments(parser, args)
    nodes: list[ObserverNode] = []

    def make_node(stop: Stop) -> ObserverNode:
        nodes.append(ObserverNode(stop))
        return nodes[0]

    def executor() -> Executor:
        # The events executor carries twice the rate, but in rclpy 7.1 it cannot pass a message's
        # source time along.
        return SingleThreadedExecutor() if nodes[0].needs_source_time else make_executor()

    return run_node(make_node, args, name='observer', executor_factory=executor)


if __name__ == '__main__':
    raise SystemExit(main())
