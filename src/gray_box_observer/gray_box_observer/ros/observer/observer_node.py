"""The observer as a managed ROS node: callbacks convert, call the core and publish."""

from __future__ import annotations

import argparse
import time
import traceback
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from std_srvs.srv import SetBool, Trigger

from gray_box_observer.checkpoints.checkpoint_folder import CheckpointFolder, default_folder
from gray_box_observer.checkpoints.checkpoint_manager import CheckpointKeeper
from gray_box_observer.context_nodes.native import regular_block
from gray_box_observer.errors import ConfigurationError, GrayBoxError
from gray_box_observer.observer.observer import Observer
from gray_box_observer.ros.life_cycle import survive_impossible_transitions
from gray_box_observer.ros.listed_parameters import help_text
from gray_box_observer.ros.node_parameters import LiveParameters, declare
from gray_box_observer.ros.observer.commentary import Commentary, motors_in_words
from gray_box_observer.ros.observer.dashboard_process import DashboardProcess
from gray_box_observer.ros.observer.diagnoser import Diagnoser
from gray_box_observer.ros.observer.session import Session
from gray_box_observer.ros.observer.topic_inputs import Inputs
from gray_box_observer.ros.observer.topic_outputs import Outputs
from gray_box_observer.ros.observer.traffic import TrafficMeter
from gray_box_observer.ros.periodic_task import PeriodicTasks
from gray_box_observer.ros.qos import unused_overrides
from gray_box_observer.ros.running import (
    EndRequestedError,
    Stop,
    make_executor,
    parse_arguments,
    run_node,
)
from gray_box_observer.safe_io.command_parser import CommandParser
from gray_box_observer.safe_io.printable import printable
from gray_box_observer.samples import Rejection
from gray_box_observer.settings.configuration import Configuration
from gray_box_observer.settings.parameters import MOTOR_PARAMETERS, OBSERVER_PARAMETERS
from gray_box_observer.settings.ros_parameter_file import NODE_NAME
from gray_box_observer.settings.signal_parameters import INPUT_PARAMETERS

DIAGNOSTICS_PERIOD_S = 1.0

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
        self._configuration = declare(self, partial(stop.require_going_on, self))
        keeper = self._keeper = self._make_keeper(self._configuration)
        self._inputs = Inputs(
            self,
            self._configuration,
            self._ingest,
            self._refuse,
            writers=lambda: keeper.thread_numbers,
        )
        self._session: Session | None = None
        self._outputs: Outputs | None = None
        self._meter = TrafficMeter()
        # operators and disks live by the clock on the wall, also where /clock stands still
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        start = partial(self.create_timer, clock=steady)
        self._tasks = PeriodicTasks(start, self.destroy_timer, stop)
        motors = list(self._configuration.motors)
        self._diagnoser = Diagnoser(self, motors, self._inputs, self._meter, self._keeper)
        self._commentary = Commentary(
            motors,
            lambda line: self.get_logger().info(printable(line)),
            lambda line: self.get_logger().warning(printable(line)),
            self._why_silent,
            speed_has_topic=self._configuration.has_own_speed,
        )
        self._tasks.add('diagnostics', DIAGNOSTICS_PERIOD_S, self._tell)
        period_s = self._configuration['estimates_period_s']
        if period_s > 0.0:
            self._tasks.add('estimates', period_s, self._tell_estimates)
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
                    stop.require_going_on(self)
                    raise ConfigurationError(self._reason)

    def on_configure(self, state: LifecycleState) -> Transition:
        """Build the observer, from its checkpoint where asked to; nothing is received yet."""
        return self._change('configure', 'inactive', self._configure, super().on_configure, state)

    def on_activate(self, state: LifecycleState) -> Transition:
        """Listen and publish."""
        return self._change('activate', 'active', self._inputs.open, super().on_activate, state)

    def on_deactivate(self, state: LifecycleState) -> Transition:
        """Stop listening; what was learnt stays."""
        return self._change(
            'deactivate', 'inactive', self._deactivate, super().on_deactivate, state
        )

    def on_cleanup(self, state: LifecycleState) -> Transition:
        """Forget everything but the checkpoint."""
        return self._change('clean up', 'unconfigured', self._forget, super().on_cleanup, state)

    def on_shutdown(self, state: LifecycleState) -> Transition:
        """Stop for good."""
        return self._change('shut down', 'finalized', self._end, super().on_shutdown, state)

    def on_error(self, state: LifecycleState) -> Transition:
        """Go back to where configuring is possible again, whatever has failed."""
        for action in (self._inputs.close, self._drop_observer, self._retract):
            try:
                action()
            except Exception:
                self.get_logger().error(traceback.format_exc())
        self._session = None
        self._state = 'unconfigured'
        super().on_deactivate(state)  # publishers
        return Transition.SUCCESS

    def close(self) -> None:
        """Write the last checkpoint and end the training processes before the node goes."""
        self._inputs.close()
        self._sum_up()
        session = self._session
        failure = self._keeper.close(None if session is None else session.observer)
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
        self,
        verb: str,
        goal: str,
        action: Callable[[], None],
        entities: Callable[[LifecycleState], Transition],
        state: LifecycleState,
    ) -> Transition:
        """Carry a transition out; rclpy itself would swallow the reason of one that fails."""
        try:
            action()
            result = entities(state)
            self._state = goal
            self._arrived(verb)
        except EndRequestedError:
            return Transition.ERROR
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
        names = motors_in_words(list(self._configuration.motors))
        self.get_logger().info(f'active: listening for {names} on {self._inputs.in_words}')
        if unknown_names := unused_overrides(self):
            self.get_logger().warning(
                f'no such topic here, ignored: {", ".join(unknown_names)}; a slip of the pen?'
            )

    def _configure(self) -> None:
        self._begin()
        assert self._session is not None
        if self._keeper.automatic:
            resumption = self._keeper.resume(self._session.observer)
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
            require_going_on = partial(self._stop.require_going_on, self)
            self._outputs = Outputs(self, self._configuration, require_going_on)
        self._session.outputs = self._outputs

    def _deactivate(self) -> None:
        self._inputs.close()
        self._keep()

    def _end(self) -> None:
        self._sum_up()
        self._deactivate()
        self._forget()

    def _sum_up(self) -> None:
        """Tell what came of it all, once the end has come."""
        if self._session is not None:
            summary = self._commentary.summary(self._session.observer, self._meter.missing_count)
            self.get_logger().info(printable(summary))

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
        session = self._session
        if session is None or session.outputs is None or self._stop.is_requested:
            return  # the end does not wait for messages that have queued up
        since_s = time.perf_counter()
        try:
            has_samples = session.ingest(name, message, arrival_ns, topic)
        except ConfigurationError as error:  # a field that is not there, a device that fails
            self._stop(error)
            return
        self._meter.worked(since_s)
        self._tasks.do_due(quiet=has_samples and not session.deferred_results)

    def _refuse(self, name: str, reason: Rejection) -> None:
        if self._session is None or self._stop.is_requested:
            return
        self._session.message_input.refuse(name, reason)
        self._tasks.do_due(quiet=False)

    def _tell(self) -> None:
        """Publish diagnostics, and alarms that no further message has led to."""
        session = self._session
        if session is None:
            self._diagnoser.publish(self._state, None, None)
            return
        session.publish_tested()
        traffic = self._diagnoser.publish(self._state, session.observer, session.message_input)
        if traffic is not None and self._state == 'active':
            self._commentary.look(session.observer, traffic)
        session.report_incidents()

    def _tell_estimates(self) -> None:
        """Publish what is known of every motor, in one message."""
        if self._session is not None:
            self._session.tell_estimates()

    def _announce(self, *, is_new: bool = False) -> None:
        """Publish what is known now, where anything is."""
        if self._session is not None:
            self._session.announce(is_new=is_new)

    def _reset(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._session is None:
            response.success = False
            response.message = 'the node is not configured: nothing to reset'
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
        if self._session is None:
            response.success = False
            response.message = 'the node is not configured: nothing to save or load'
            return response
        try:
            # an alarm of what was learnt so far must not go out after what is loaded
            self._session.run_deferred()
            path = action(self._session.observer)
        except GrayBoxError as error:
            response.success = False
            response.message = str(error)
            self.get_logger().warning(
                f'not {words.partition(" ")[0]}: {printable(response.message)}'
            )
            return response
        self._announce(is_new=action == self._keeper.load)
        response.success = True
        response.message = f'{words} {path}'
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
        if self._session is not None:
            self._session.reconfigure(configuration)
        self._announce()

    def _time_checkpoints(self) -> None:
        """Have a checkpoint taken every so often while there is something to learn."""
        self._tasks.remove('checkpoint')
        period_s = self._configuration['checkpoint.period_s']
        if self._keeper.automatic and self._state == 'active' and period_s > 0.0:
            self._tasks.add('checkpoint', period_s, self._keep)

    def _keep(self) -> None:
        self._keeper.keep(None if self._session is None else self._session.observer)

    def _begin(self) -> None:
        """Make an observer that knows nothing yet."""
        self._session = Session(
            self._configuration,
            self._outputs,
            self._meter,
            self._keeper,
            self.get_logger(),
            lambda: self._state == 'active',
        )
        self._meter.forget()
        self._commentary.forget()

    def _drop_observer(self) -> None:
        if self._session is not None:
            self._session.observer.close()
        self._session = None

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


def main(args: Sequence[str] | None = None) -> int:
    """Run the observer; the result is the exit code."""
    parser = CommandParser(
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
