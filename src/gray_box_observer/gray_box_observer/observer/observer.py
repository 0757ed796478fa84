"""The observer: feeds each group of motors that share messages to a motor observer.

One core, three doors: live topics, a replayed bag and the offline command all feed this object.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from gray_box_observer.context_nodes import Estimate
from gray_box_observer.context_nodes.estimate import COUNTS_AS_KNOWN, NOT_FINITE
from gray_box_observer.delay import DelayEstimate
from gray_box_observer.errors import ConfigurationError
from gray_box_observer.fit_test import FitAssessment
from gray_box_observer.observer.builder import (
    TrainingFactory,
    alarm_rules,
    context_nodes,
    initial_estimate,
    motor_observer,
    verdict_rules,
)
from gray_box_observer.observer.grouping import Grouping, Part, Values
from gray_box_observer.observer.incident import Incident
from gray_box_observer.observer.mixed_signals import COMPARED, MixUp, MixUpSearch
from gray_box_observer.observer.motor_forms.motor_form import FormKind
from gray_box_observer.observer.motor_group import Group, GroupResult, Result
from gray_box_observer.observer.motor_observer import MotorObserver
from gray_box_observer.observer.motor_view import MotorView
from gray_box_observer.observer.saved_motors import SavedMotor, restored_observer
from gray_box_observer.observer.torque_forecast import (
    Forecast,
    precompute,
    torque_after_hold,
    torque_at,
)
from gray_box_observer.samples import Pairing, Sample
from gray_box_observer.samples.counts import PairingCounts
from gray_box_observer.samples.stopped import StoppedPairing
from gray_box_observer.settings.configuration import Configuration
from gray_box_observer.settings.device import torch_device
from gray_box_observer.white_box.interface import Array

if TYPE_CHECKING:  # loaded where something is predicted
    from gray_box_observer.predictor import Skill

__all__ = ['Forecast', 'GroupResult', 'Observer', 'Result']

T = TypeVar('T')


class Observer:
    """Observes the configured motors.

    Args:
        configuration: parameters of the observer and of every motor.
        training: makes the trainer of a motor from its configuration; None: no predictor.

    Whatever escapes inside the observer of a group stops that group, and no other. It learns and
    predicts no more, its motors leave :attr:`motors`, and what comes for them is refused.
    :class:`ConfigurationError` goes through: a device that is gone ends everything.

    Attributes:
        configuration: as above.
        motors: every motor that has been seen and has not stopped.
        incidents: what has stopped motors, by their names; a restored state sets them going again.

    Raises:
        ConfigurationError: there is no such device as the configuration asks for.
    """

    def __init__(
        self, configuration: Configuration, training: TrainingFactory | None = None
    ) -> None:
        torch_device(configuration['device'])  # said before the first sample comes
        self.configuration = configuration
        self._training = training if configuration['predictor'] else None
        self._is_frozen = bool(configuration['freeze'])
        self._grouping = Grouping(configuration)
        self.motors: dict[str, MotorView] = {}
        self.incidents: dict[str, Incident] = {}
        self._mix_ups = MixUpSearch()

    def voltage(self, motor: str, stamp_ns: int, voltage_v: float) -> list[Result]:
        """Take one armature voltage; part of the Python API.

        Args:
            motor: its name, as configured.
            stamp_ns: stamp in ns; the voltage holds from here to the stamp of the next one.
            voltage_v: in V. One that is not finite, or late, is refused and counted
                (:meth:`counts`).

        Returns:
            One result for each sample that it completes; none while torque has still to come.

        Raises:
            KeyError: there is no motor of that name.
            ConfigurationError: the device has failed.
        """
        return self._flat(
            self._ingest([self._grouping.part(motor)], 'voltage', stamp_ns, [voltage_v], None)
        )

    def torque(
        self, motor: str, stamp_ns: int, torque_nm: float, speed_rad_s: float = math.nan
    ) -> list[Result]:
        """Take one torque, with the speed where it is measured; part of the Python API.

        Args:
            motor: its name, as configured.
            stamp_ns: stamp in ns: the torque is that of this instant.
            torque_nm: in N m. One that is not finite, or late, is refused and counted
                (:meth:`counts`).
            speed_rad_s: in rad/s; NaN: not measured.

        Returns:
            One result for each sample that it completes. ``estimate`` in it is None where nothing
            has changed.

        Raises:
            KeyError: there is no motor of that name.
            ConfigurationError: the device has failed, or a speed that must be measured is missing.
        """
        return self._flat(
            self._ingest(
                [self._grouping.part(motor)], 'torque', stamp_ns, [torque_nm], [speed_rad_s]
            )
        )

    def speed(self, motor: str, stamp_ns: int, speed_rad_s: float) -> list[Result]:
        """Take one speed in rad/s, where it is a signal of its own; return what it has led to."""
        return self._flat(
            self._ingest([self._grouping.part(motor)], 'speed', stamp_ns, [speed_rad_s], None)
        )

    def ingest(
        self, signal: str, names: tuple[str, ...], stamp_ns: int, values: Values,
        speeds: Values | None = None
    ) -> list[GroupResult]:  # fmt: skip
        """Take what one message says of a signal.

        Args:
            signal: ``voltage``, ``torque`` or ``speed``.
            names: motors that the message speaks of; those not configured are passed over.
            stamp_ns: its stamp.
            values: one a name, in SI units.
            speeds: of a torque message, in rad/s, where it brings them.

        Returns:
            What the samples that it completes have led to, group by group.
        """
        parts = self._grouping.parts(signal, names, speeds)
        return self._ingest(parts, signal, stamp_ns, values, speeds)

    def groups(self, names: tuple[str, ...]) -> list[Group]:
        """Return the groups that the motors of a message belong to."""
        return self._grouping.spoken_of(names)

    def group_of(self, motor: str) -> Group:
        """Return the group that a motor belongs to; one that comes alone is a group of its own."""
        return self._grouping.place(motor)[0]

    def counts(self, motor: str) -> PairingCounts:
        """Return what became of a motor's messages."""
        group, place = self._grouping.place(motor)
        return group.pairing.counts_for(place)

    def flush(self) -> list[Result]:
        """Learn what still waits for a voltage (end of a bag)."""
        return self._flat([result for group in self.every_group for result in self._flush(group)])

    def finish(self) -> tuple[str, ...]:
        """Do what is left of fits, trials and tests: no samples will come; part of the Python API.

        It is done within bounds.

        Returns:
            Names of the motors whose estimates have changed.
        """
        names: list[str] = []
        for group in self.every_group:
            if group.observer is None or group.is_stopped:
                continue
            if self.contain(group, partial(_finish, group.observer)):
                names += [group.names[motor] for motor in group.observer.changed_motors.tolist()]
        return tuple(names)

    def restart_clock(self) -> None:
        """Begin new signal histories: what comes next has stamps of its own (another recording).

        Whatever waits is to be flushed before; what was learnt stays.
        """
        for group in self.every_group:
            if isinstance(group.pairing, Pairing):  # one that has stopped pairs nothing
                self.contain(group, group.pairing.restart)

    def results(self, result: GroupResult) -> list[Result]:
        """Return a sample's results motor by motor; nothing where the group has stopped since."""
        return self.contain(result.group, result.motor_results) or []

    def contain(
        self, group: Group, action: Callable[[], T], samples: Sequence[Sample] = ()
    ) -> T | None:
        """Do something inside the observer of a group; where that fails, stop the group.

        Args:
            group: the motors.
            action: what to do.
            samples: those that are at hand, for the report.

        Returns:
            What the action gives; None where the group has stopped, now or before.

        Raises:
            ConfigurationError: a device that is gone.
        """
        if group.is_stopped:
            return None
        try:
            return action()
        except ConfigurationError:
            raise
        except Exception as error:
            self.stop(group, error, samples)
            return None

    def stop(self, group: Group, error: Exception, samples: Sequence[Sample] = ()) -> None:
        """Stop a group's motors because of an error; the others go on. The first error counts."""
        if group.is_stopped:
            return
        incident = Incident.from_error(group, error, samples)
        counts = [group.pairing.counts_for(place) for place in range(len(group.names))]
        if group.observer is not None:
            with suppress(Exception):  # it is broken
                group.observer.close()
        group.observer = None
        group.pairing = StoppedPairing(counts)
        for name in group.names:
            self.motors.pop(name, None)
            self.incidents[name] = incident

    def forecast_group(self, group: Group, stamp_ns: int) -> Array | None:
        """Predict the torques of a group at a stamp to come, shape (motor,); NaN: unknown.

        None where the voltage is not known up to the stamp; changes nothing.
        """
        return self.contain(group, partial(torque_at, group, stamp_ns))

    def precompute_forecast(self, group: Group) -> None:
        """Work out a group's next prediction in advance, where its stamp can be foretold.

        Changes nothing but when it is done: for whoever has time now and none when the next voltage
        has come.
        """
        self.contain(group, partial(precompute, group))

    def forecast(self, motor: str, stamp_ns: int) -> Forecast | None:
        """Predict the torque at a stamp with voltage but without torque; changes nothing."""
        group, place = self._grouping.place(motor)
        torque_nm = self.forecast_group(group, stamp_ns)
        if torque_nm is None or not math.isfinite(torque_nm[place]):
            return None
        return Forecast(motor, stamp_ns, float(torque_nm[place]))

    def forecast_held(self, motor: str, horizon_s: float) -> Forecast | None:
        """Predict the torque after the newest voltage has been held for a while; changes nothing.

        The stamp is that of the voltage (shifted by the delay, where there is one) plus the
        horizon. Torque measured at or before the voltage's stamp must not be waited for: what is
        not measured yet is predicted on the way.

        Args:
            motor: its name.
            horizon_s: how long the voltage is held.

        Returns:
            None before the second sample of a signal history, where no predictor runs, or where the
            voltage came so late that torque has been learnt beyond it.

        Raises:
            ConfigurationError: the network is one of the thesis, which goes from sample to sample
                only.
        """
        group, place = self._grouping.place(motor)
        group_forecast = self.forecast_group_held(group, horizon_s)
        if group_forecast is None or not math.isfinite(group_forecast[1][place]):
            return None
        return Forecast(motor, group_forecast[0], float(group_forecast[1][place]))

    def forecast_group_held(self, group: Group, horizon_s: float) -> tuple[int, Array] | None:
        """Return stamp and torques, (motor,), of :meth:`forecast_held` for a whole group."""
        return self.contain(group, partial(torque_after_hold, group, horizon_s))

    def group_estimates(self) -> list[tuple[tuple[str, ...], Estimate]]:
        """Return names and present estimates of every group that has been seen."""
        estimates = []
        for group in self.every_group:
            observer = group.observer
            if observer is None:
                continue
            estimate = self.contain(group, observer.estimate)
            if estimate is not None:
                estimates.append((group.names, estimate))
        return estimates

    def estimates(self) -> dict[str, Estimate]:
        """Return the present estimate of every motor seen, by its name; part of the Python API.

        Each has a motor axis of one: ``value`` and ``std`` have shape (1, parameter),
        ``covariance`` has shape (1, parameter, parameter), all in SI units. ``parameters`` names
        the columns, ``verdicts[0]`` judges them.
        """
        return self._of_every_motor(lambda motor: motor.estimate)

    def estimate_of(self, motor: str) -> tuple[Estimate, bool]:
        """Return a motor's belief, and whether all is identified; the given one at first.

        Of a motor that has stopped it is the given one too, and nothing is identified.
        """
        belief = self._of(motor, lambda view: (view.estimate, view.identified))
        if belief is not None:
            return belief
        initial = initial_estimate(self.configuration, self.configuration.motors[motor])
        return initial, motor not in self.incidents and initial.identified(0)

    def parameters_identified(self, motor: str) -> tuple[bool, ...]:
        """Return a motor's identified parameters; before it is seen, the given ones."""
        flags = self._of(motor, lambda view: view.parameters_identified)
        if flags is not None:
            return flags
        initial = initial_estimate(self.configuration, self.configuration.motors[motor])
        is_stopped = motor in self.incidents
        return tuple(
            not is_stopped and verdict in COUNTS_AS_KNOWN for verdict in initial.verdicts[0]
        )

    def fit(self, motor: str) -> FitAssessment:
        """Return how well the white box explains a motor's data; untested before it is seen."""
        return self._of(motor, lambda view: view.fit) or FitAssessment()

    def mix_up(self, motor: str) -> MixUp | None:
        """Return the motor that one which does not fit is mixed up with; None where none is."""

        def newest_of(name: str) -> Array | None:  # whoever fails stops, not who is asked about
            return self._of(name, lambda view: view.newest(COMPARED))

        return self._of(
            motor, lambda _: self._mix_ups.find(motor, self.motors, self.fit, newest_of)
        )

    def delays(self) -> dict[str, DelayEstimate]:
        """Return the delay between voltage and torque of every motor that has been seen."""
        return self._of_every_motor(lambda motor: motor.delay)

    def _of(self, motor: str, get: Callable[[MotorView], T]) -> T | None:
        """Return something of a motor; None where it is not seen yet, or has stopped."""
        view = self.motors.get(motor)
        return None if view is None else self.contain(self.group_of(motor), partial(get, view))

    def _of_every_motor(self, get: Callable[[MotorView], T]) -> dict[str, T]:
        """Return something of every motor that has been seen; what has stopped is left out."""
        values = {
            name: self.contain(self.group_of(name), partial(get, motor))
            for name, motor in [*self.motors.items()]
        }
        return {name: value for name, value in values.items() if value is not None}

    def alarm(self, motor: str) -> bool:
        """Whether the residual alarm stands; never where the physics predicts nothing."""
        if motor not in self._grouping:
            return False
        group, place = self._grouping.place(motor)
        observer = group.observer
        return observer is not None and bool(self.contain(group, lambda: observer.alarmed[place]))

    def skill(self, motor: str) -> Skill | None:
        """Return the predictor's scores; None where there is no predictor."""
        group, place = self._grouping.place(motor)
        return self.contain(group, lambda: self._skill(group, place))

    @staticmethod
    def _skill(group: Group, place: int) -> Skill | None:
        if group.observer is None or group.observer.forecasting is None:
            return None
        return group.observer.forecasting.scores.skill(place)

    @property
    def frozen(self) -> bool:
        """Whether learning is stopped."""
        return self._is_frozen

    def freeze(self, is_frozen: bool) -> None:
        """Stop or resume learning of every motor; predictions go on."""
        self._is_frozen = is_frozen
        for group in self.every_group:
            if group.observer is not None:
                self.contain(group, partial(group.observer.freeze, is_frozen))

    def reconfigure(self, configuration: Configuration) -> None:
        """Take over the values of parameters that may change at any time; what was learnt stays."""
        self.configuration = configuration
        self._grouping.reconfigure(configuration)
        verdicts = verdict_rules(configuration)
        alarm = alarm_rules(configuration)
        for group in self.every_group:
            if group.observer is not None:
                core_share = configuration['training.core_share']
                self.contain(
                    group, partial(group.observer.reconfigure, verdicts, alarm, core_share)
                )
        if configuration['freeze'] != self._is_frozen:
            self.freeze(configuration['freeze'])

    def restore(
        self,
        states: Mapping[str, SavedMotor],
        together: Sequence[Sequence[str]] = (),
    ) -> None:
        """Take back what :meth:`MotorObserver.state` gave, by motor: all of it or nothing.

        Args:
            states: plain values and arrays, by motor.
            together: motors that were computed together: they came in the same messages, what
                others do nobody knows.

        Raises:
            ConfigurationError: something was learnt with another white box or other parameters.
        """
        places = self._grouping.places
        replacements: list[tuple[Group, MotorObserver]] = []
        try:
            for names in together:
                self._grouping.gather(names)
            groups = [
                group for group in self.every_group if any(name in states for name in group.names)
            ]
            replacements.extend(
                (group, restored_observer(group, states, self._make)) for group in groups
            )
        except BaseException:
            for _, observer in replacements:
                observer.close()
            self._grouping.put_back(places)
            raise
        for group, observer in replacements:  # all good: take over
            self._flush(group)  # what still waited belongs to the old signal history
            if group.observer is not None:
                self.contain(group, group.observer.run_deferred)
            if group.observer is not None:
                group.observer.close()
            if isinstance(group.pairing, StoppedPairing):  # what is restored did not fail
                group.pairing = self._grouping.pairing_of(group)
            group.pairing.restart(observer.delay_of(0).applied_s)
            self._adopt(group, observer)
            for name in group.names:
                self.incidents.pop(name, None)

    def close(self) -> None:
        """Stop whatever trains in the background."""
        for group in self.every_group:
            if group.observer is not None:
                self.contain(group, group.observer.close)

    @property
    def every_group(self) -> list[Group]:
        """Every group once; a motor that comes alone is a group of its own."""
        return self._grouping.groups

    def _ingest(
        self, parts: Sequence[Part], signal: str, stamp_ns: int, values: Values,
        speeds: Values | None
    ) -> list[GroupResult]:  # fmt: skip
        """Let every group have its part of a message."""
        results: list[GroupResult] = []
        for part in parts:
            samples: list[Sample] = []
            observer = part.group.observer
            try:
                if observer is not None:  # the form that it has gone over to may need no speed
                    part.group.pairing.needs_speed = observer.white_box.speed_measured
                samples = part.ingest(signal, stamp_ns, values, speeds)
                if samples:
                    results += self._learn(part.group, samples)
            except ConfigurationError:
                raise
            except Exception as error:
                self.stop(part.group, error, samples)
        return results

    def _flush(self, group: Group) -> list[GroupResult]:
        """Learn what still waits for a voltage."""
        return self.contain(group, lambda: self._learn(group, group.pairing.flush())) or []

    def _learn(self, group: Group, samples: list[Sample]) -> list[GroupResult]:
        results: list[GroupResult] = []
        pairing = group.pairing
        still = samples[::-1]
        assert isinstance(pairing, Pairing)  # one that has stopped makes no samples
        while still:
            sample = still.pop()
            if group.observer is None:
                self._adopt(group, self._make(group, bool(np.isfinite(sample.speed_rad_s).any())))
            observer = group.observer
            assert observer is not None
            if pairing.repeats(sample):  # it was predicted, scored and reported before
                again = observer.learn_again(sample)
                if again is not None and not again.is_finite:
                    raise ArithmeticError(NOT_FINITE)
                if again is not None and results:
                    results[-1] = replace(
                        results[-1], estimate=again, changed_motors=observer.changed_motors
                    )
                continue
            update, estimate = observer.step(sample)
            if estimate is not None and not estimate.is_finite:
                raise ArithmeticError(NOT_FINITE)
            results.append(
                GroupResult(
                    group, sample, update.prediction, observer.changed_motors, estimate, update
                )
            )
            delay_s = None
            if not self._is_frozen:
                delay_s = observer.watch_delay(
                    pairing.history, sample.stamp_ns, is_awaited=estimate is not None
                )
            if delay_s is not None:
                past_samples, later_samples = pairing.redelay(delay_s, sample.stamp_ns)
                motors = [self.configuration.motors[name] for name in group.names]
                if observer.white_box.has_rotor:  # as the form in force has it
                    motors = [observer.configuration_of(0)]
                observer.relearn(
                    context_nodes(self.configuration, motors, observer.white_box), past_samples
                )
                estimate = observer.estimate()
                results[-1] = replace(
                    results[-1], estimate=estimate, changed_motors=np.arange(len(group.names))
                )
                still = later_samples[::-1]
        return results

    def _adopt(self, group: Group, observer: MotorObserver) -> None:
        """Let a group be observed from now on."""
        group.observer = observer
        group.pairing.needs_speed = observer.white_box.speed_measured
        self.motors.update(
            {name: MotorView(observer, place) for place, name in enumerate(group.names)}
        )

    def _make(
        self, group: Group, speed_measured: bool, kind: FormKind | None = None
    ) -> MotorObserver:
        motors = [self.configuration.motors[name] for name in group.names]
        observer = motor_observer(
            self.configuration, motors, self._training, speed_measured=speed_measured,
            kind=kind,
        )  # fmt: skip
        observer.freeze(self._is_frozen)
        return observer

    def _flat(self, results: Iterable[GroupResult]) -> list[Result]:
        """Results of groups, motor by motor."""
        return [one for result in results for one in self.results(result)]


def _finish(observer: MotorObserver) -> bool:
    """Do what is left; tell whether an estimate has changed, which may then be given out.

    Raises:
        ArithmeticError: it is not finite.
    """
    has_changed = observer.finish()
    if has_changed:
        observer.estimate()
    return has_changed
