"""Between topics and core: messages go in, and what comes of them goes out."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

from rclpy.impl.rcutils_logger import RcutilsLogger

from gray_box_observer.checkpoints.checkpoint_manager import CheckpointKeeper
from gray_box_observer.errors import ConfigurationError
from gray_box_observer.observer.incident import in_words
from gray_box_observer.observer.message_input import MessageInput
from gray_box_observer.observer.motor_group import Group, GroupResult
from gray_box_observer.observer.observer import Observer
from gray_box_observer.predictor import ProcessTraining, TrainingProcess
from gray_box_observer.ros.observer.topic_outputs import Outputs
from gray_box_observer.ros.observer.traffic import TrafficMeter
from gray_box_observer.safe_io.printable import printable
from gray_box_observer.settings.configuration import Configuration


class Session:
    """An observer that knows nothing at first, what it is fed by, and what publishes for it.

    Args:
        configuration: of the node.
        outputs: publishers; None before the node is configured for the first time.
        meter, keeper, log: of the node.
        is_active: tells whether the node is active.

    Attributes:
        configuration, outputs: as above; set anew where they change.
        deferred_results: of samples which have left something to be done.
    """

    def __init__(
        self,
        configuration: Configuration,
        outputs: Outputs | None,
        meter: TrafficMeter,
        keeper: CheckpointKeeper,
        log: RcutilsLogger,
        is_active: Callable[[], bool],
    ) -> None:
        training = partial(ProcessTraining, process=TrainingProcess())
        self.observer = Observer(configuration, training)
        self.message_input = MessageInput(self.observer, configuration)
        self.outputs = outputs
        self.deferred_results: list[GroupResult] = []
        self.configuration = configuration
        self._meter = meter
        self._keeper = keeper
        self._log = log
        self._is_active = is_active
        self._incident_names: set[str] = set()

    def ingest(self, name: str, message: Any, arrival_ns: int, topic: str) -> bool:
        """Hand a message to the core and publish what comes of it; tell whether anything did.

        Raises:
            ConfigurationError: a field is not there, or a device fails.
        """
        assert self.outputs is not None
        input_result = self.message_input.ingest(name, message, arrival_ns, topic)
        self.outputs.results(input_result.groups)
        if name == 'voltage' and input_result.names:
            for group in self.observer.groups(input_result.names):
                self._publish_forecast(self.outputs, group, input_result.stamp_ns)
        for result in input_result.groups:
            self.observer.precompute_forecast(result.group)
        self._meter.update(input_result.groups)
        self.deferred_results += input_result.groups
        if all(result.estimate is None for result in input_result.groups):
            # else the next prediction comes first: an update has taken its time
            self.run_deferred()
        if len(self.observer.incidents) != len(self._incident_names):
            self.report_incidents()
        return bool(input_result.groups)

    def _publish_forecast(self, outputs: Outputs, group: Group, stamp_ns: int) -> None:
        """Publish a new voltage's predictions: at its stamp, and at a requested horizon."""
        torque_nm = self.observer.forecast_group(group, stamp_ns)
        if torque_nm is not None:
            outputs.prediction(group.names, stamp_ns, torque_nm)
        horizon_s = self.configuration['horizon_s']
        if horizon_s > 0.0:
            group_forecast = self.observer.forecast_group_held(group, horizon_s)
            if group_forecast is not None:
                outputs.forecast(group.names, *group_forecast)

    def run_deferred(self) -> None:
        """Do what samples have left to be done when all has gone out that somebody waits for."""
        queue = deque(self.deferred_results)
        self.deferred_results = []
        if self.outputs is None:
            return
        while True:
            try:
                self.outputs.alarms(_consumed(queue))
                return
            except ConfigurationError:
                raise
            except Exception as error:
                if not queue:
                    raise
                self.observer.stop(queue.popleft().group, error)

    def publish_tested(self) -> None:
        """Publish alarms that no further message has led to, and fits that were tested."""
        self.run_deferred()
        if self.outputs is not None:
            for group in self.observer.every_group:
                self.observer.contain(group, partial(self.outputs.publish_tested, group))

    def report_incidents(self) -> None:
        """Report motors that have stopped since the last call, and clear their latched topics."""
        if self.outputs is None:
            return
        incidents = self.observer.incidents
        if incidents.keys() - self._incident_names:
            self._correct_estimates()
        for incident in {
            id(incidents[name]): incidents[name] for name in incidents.keys() - self._incident_names
        }.values():
            for motor in incident.motors:
                self.outputs.retract_motor(motor)
            text = (
                f'{in_words(incident.motors)} stopped by a defect: {incident.reason}; the others '
                f'go on, ~/reset starts anew\n{incident.trace}'
            )
            self._log.error('\n'.join(printable(line) for line in text.split('\n')))
            self._keeper.report(incident, lambda line: self._log.warning(printable(line)))
        self._incident_names = set(incidents)

    def announce(self, *, is_new: bool = False) -> None:
        """Publish what is known now: latched topics must not go on telling what was forgotten.

        Args:
            is_new: whether what is known does not follow from what was published before.
        """
        if self.outputs is None:
            return
        if not self._is_active():  # it is told when the node is activated
            if is_new:
                self.outputs.retract()
            return
        self.tell_estimates()
        self.outputs.forget_published()
        for motor in self.configuration.motors if self.configuration['motor_topics'] else ():
            action = partial(_announce_motor, self.observer, self.outputs, motor)
            self.observer.contain(self.observer.group_of(motor), action)
        self.report_incidents()

    def tell_estimates(self) -> None:
        """Publish what is known of every motor, in one message."""
        if self.outputs is not None and self._is_active():
            self.outputs.all_estimates(
                list(self.configuration.motors), self.observer.group_estimates()
            )

    def _correct_estimates(self) -> None:
        """Clear a stopped motor on ``~/estimates``; its periodic reports have ended."""
        if self._is_active():
            self.tell_estimates()
        elif self.outputs is not None:
            self.outputs.retract_estimates()

    def reconfigure(self, configuration: Configuration) -> None:
        """Let changed parameters take effect; what was learnt stays."""
        self.configuration = configuration
        self.observer.reconfigure(configuration)


def _announce_motor(observer: Observer, outputs: Outputs, motor: str) -> None:
    outputs.alarm(motor, observer.alarm(motor))
    estimate, is_identified = observer.estimate_of(motor)
    outputs.estimate(motor, estimate, is_identified)
    outputs.parameters_identified(motor, estimate.parameters, observer.parameters_identified(motor))
    outputs.fit(motor, observer.fit(motor))


def _consumed(queue: deque[GroupResult]) -> Iterator[GroupResult]:
    """Yield results; each leaves the queue when done, so that one that fails is still first."""
    while queue:
        yield queue[0]
        queue.popleft()
