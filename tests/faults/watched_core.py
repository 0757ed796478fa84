"""An observer's core asked everything that a node asks, with every answer checked."""

from __future__ import annotations

import hashlib
import tempfile
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from gray_box_observer.bag.joint_state import JointStateDecoder
from gray_box_observer.checkpoints import checkpoint
from gray_box_observer.context_nodes import Estimate
from gray_box_observer.errors import ConfigurationError
from gray_box_observer.observer.combined_signal import CombinedSignal, Stamped
from gray_box_observer.observer.message_input import InputResult, MessageInput
from gray_box_observer.observer.motor_group import Group, GroupResult, Result
from gray_box_observer.observer.observer import Observer
from gray_box_observer.settings.configuration import Configuration


class IdleTraining:
    """Training that takes every job and never ends one."""

    is_resting = False
    busy = False
    failure: str | None = None
    share = 1.0

    def __init__(self, configuration: dict[str, Any]) -> None:
        """Nothing is taught, so nothing is asked."""

    def submit(self, job: dict[str, Any]) -> None:
        """Take a job."""

    def collect(self) -> dict[str, Any] | None:
        """Give nothing."""
        return None

    def close(self) -> None:
        """End nothing."""


class WatchedCore:
    """Feeds serialised messages to an observer as a node does, and counts what must not be.

    Args:
        settings: flat parameters of the observer.
        training: makes the trainer of the predictor.
        asks: whether forecasts are asked for between the messages, as a node does; they change
            nothing.

    Attributes:
        observer: the core.
        non_finite: numbers in samples, estimates and predictions that are no numbers.
        unbalanced: messages that were neither used nor refused nor wait.
    """

    def __init__(
        self, settings: dict[str, Any], training: Any = IdleTraining, *, asks: bool = True
    ) -> None:
        self._settings = settings
        self._training = training
        self._asks = asks
        self._decode = {signal: JointStateDecoder() for signal in ('voltage', 'torque', 'speed')}
        self.non_finite = 0
        self.unbalanced = 0
        self._estimates = hashlib.sha256()
        self._forecasts = hashlib.sha256()
        self._begin()

    def _begin(self) -> None:
        configuration = Configuration.from_flat(self._settings)
        self.observer = Observer(configuration, self._training)
        self._message_input = MessageInput(self.observer, configuration)
        self._delivered: Counter[str] = Counter()
        self._begun: Counter[str] = Counter()
        """Values of expressions that only begin a rate of change, by signal."""
        for signal, source in self._message_input.signals.items():
            if isinstance(source, CombinedSignal):
                source.ingest = partial(self._count_begun, signal, source.ingest)
        self._topics = {
            signal: feed.topic for feed in configuration.feeds for signal in feed.signals
        }
        """Of inputs of expressions; one a signal here."""
        self._received_before = self._received()

    @property
    def digest(self) -> str:
        """SHA-256 over every estimate in order, as the offline command reckons it."""
        return self._estimates.hexdigest()

    @property
    def forecast_digest(self) -> str:
        """SHA-256 over every prediction in order."""
        return self._forecasts.hexdigest()

    def feed(self, signal: str, message: bytes) -> None:
        """Take one serialised JointState of a signal."""
        self.feed_view(signal, self._decode[signal](message))

    def feed_view(self, signal: str, message: Any) -> None:
        """Take one message with the fields of a JointState."""
        self._delivered[signal] += 1
        taken = self._message_input.ingest(signal, message, 0, self._topics.get(signal, ''))
        if self._asks:
            self._ask(signal, taken)
        for result in taken.groups:
            self._look_at_result(result)

    def flush(self) -> None:
        """Learn what still waits and finish what is begun, as at the end of a bag."""
        for group_result in self._message_input.flush():
            self._look_at_result(group_result)
        for result in self.observer.flush():
            self._reckon(result)
        for name in self.observer.finish():
            self._reckon_estimate(name, self.observer.motors[name].estimate)

    def _ask(self, signal: str, taken: InputResult) -> None:
        """Ask what a node asks after a message."""
        if signal == 'voltage' and taken.names:
            for group in self.observer.groups(taken.names):
                self._forecast(group, taken.stamp_ns)
        for result in taken.groups:
            self.observer.precompute_forecast(result.group)

    def reset(self) -> None:
        """Throw the observer away and begin anew, as ~/reset does."""
        self.close()
        self._begin()

    def restart(self) -> None:
        """Go on in a new observer from a checkpoint of this one."""
        self.balance()
        if not self.observer.motors:
            return
        before = self.observer.estimates()
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / 'core.safetensors'
            checkpoint.save(self.observer, path)
            self.observer.close()
            self._begin()
            checkpoint.load(self.observer, path)
        self._received_before = self._received()
        after = self.observer.estimates()
        for name, estimate in before.items():
            assert estimate.value.tobytes() == after[name].value.tobytes(), (
                f'{name}: restored to another estimate'
            )

    def freeze(self, frozen: bool) -> None:
        """Stop or resume learning."""
        self.observer.freeze(frozen)

    def reconfigure(self, changes: dict[str, Any]) -> None:
        """Change parameters of a running observer; refuse forbidden ones, as a node does."""
        with suppress(ConfigurationError):
            configuration = Configuration.from_flat({**self._settings, **changes})
            self._settings = {**self._settings, **changes}
            self.observer.reconfigure(configuration)

    def balance(self) -> None:
        """Compare, of every motor and signal, what came with what became of it."""
        for name in self.observer.configuration.motors:
            counts = self.observer.counts(name)
            of_torque = (
                counts.used_count + counts.refusal_counts['torque'].total() + counts.waiting_count
            )
            of_voltage = counts.taken_voltage + counts.refusal_counts['voltage'].total()
            self.unbalanced += abs(counts.received_torque - of_torque)
            self.unbalanced += abs(counts.received_voltage - of_voltage)
        incidents = self.observer.incidents
        assert not incidents, f'a defect has stopped motors: {incidents}'
        for signal, delivered in self._delivered.items():
            self.unbalanced += abs(delivered - self._message_input.message_counts[signal])
        self._balance_topics()
        self._balance_speed()

    def _balance_topics(self) -> None:
        """Compare what came of a motor alone with what its topics brought that could be used."""
        if len(self.observer.configuration.motors) != 1:
            return
        counts = self._message_input
        for signal, received in self._received().items():
            lost = counts.rejection_counts[signal].total() + counts.others[signal]
            known = counts.message_counts[signal] - lost - self._begun[signal]
            self.unbalanced += abs(received - self._received_before[signal] - known)

    def _received(self) -> Counter[str]:
        """Return how many voltages and torques have come of all motors, by signal."""
        every = [self.observer.counts(name) for name in self.observer.configuration.motors]
        return Counter(
            voltage=sum(counts.received_voltage for counts in every),
            torque=sum(counts.received_torque for counts in every),
        )

    def _count_begun(
        self, signal: str, ingest: Callable[..., list[Stamped]], *message: Any
    ) -> list[Stamped]:
        """Let an expression take a message; count the values that there are none of yet."""
        values = ingest(*message)
        self._begun[signal] += sum(one.reading is None and one.reason is None for one in values)
        return values

    def _balance_speed(self) -> None:
        """Compare the refused speeds of a motor alone with what came; none may be more."""
        for name in self.observer.configuration.motors:
            refused = self.observer.counts(name).refusal_counts.get('speed', Counter()).total()
            self.unbalanced += max(0, refused - self._message_input.message_counts['speed'])

    def close(self) -> None:
        """Balance the books and stop."""
        self.balance()
        self.observer.close()

    def _forecast(self, group: Group, stamp_ns: int) -> None:
        torque_nm = self.observer.forecast_group(group, stamp_ns)
        self._look_at_forecast(torque_nm)
        horizon_s = self.observer.configuration['horizon_s']
        if horizon_s > 0.0:
            held = self.observer.forecast_group_held(group, horizon_s)
            self._look_at_forecast(None if held is None else held[1])

    def _look_at_result(self, result: GroupResult) -> None:
        sample = result.sample
        present = slice(None) if sample.present is None else sample.present
        self._look_at(
            sample.interval_s[present], sample.voltage_v[present], sample.torque_nm[present]
        )
        observer = result.group.observer
        if observer is not None and observer.white_box.speed_measured:
            self._look_at(sample.speed_rad_s[present])
        self.non_finite += int(np.isinf(sample.speed_rad_s[present]).sum())
        self._look_at_forecast(None if result.prediction is None else result.prediction.torque_nm)
        for one in result:
            self._reckon(one)

    def _reckon(self, result: Result) -> None:
        """Look at what a sample of one motor has led to, and take it into the digests."""
        if result.prediction is not None:
            torque_nm = result.prediction.torque_nm
            self._forecasts.update(np.where(np.isnan(torque_nm), np.nan, torque_nm).tobytes())
        estimate = result.estimate
        if estimate is not None:
            self._reckon_estimate(result.motor, estimate)

    def _reckon_estimate(self, motor: str, estimate: Estimate) -> None:
        """Look at an estimate, and take it into the digest."""
        self._look_at(estimate.value, estimate.covariance)
        self._estimates.update(motor.encode() + np.int64(estimate.stamp_ns).tobytes())
        self._estimates.update(estimate.value.tobytes() + estimate.covariance.tobytes())

    def _look_at(self, *arrays: Any) -> None:
        for array in arrays:
            self.non_finite += int(np.size(array) - np.isfinite(array).sum())

    def _look_at_forecast(self, torque_nm: Any) -> None:
        """A forecast may be missing (NaN), never infinite."""
        if torque_nm is not None:
            self.non_finite += int(np.isinf(torque_nm).sum())
