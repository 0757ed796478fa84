"""The observer: feeds every group of motors that come in the same messages to a motor observer, sample by sample.

One core, three doors: live topics, a replayed bag and the offline command all feed this object.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.assembly import (
    TrainingFactory,
    alarm_rules,
    context_nodes,
    initial_estimate,
    kind,
    motor_observer,
    pairing_rules,
    verdict_rules,
)
from gray_box_observer.configuration import Configuration
from gray_box_observer.context_nodes import Estimate
from gray_box_observer.delay import DelayEstimate
from gray_box_observer.errors import ConfigurationError
from gray_box_observer.group import Group, GroupResult, OneOfGroup, PairingOfOne, Result
from gray_box_observer.motor_observer import MotorObserver
from gray_box_observer.predictor import Skill
from gray_box_observer.samples import Pairing, Sample
from gray_box_observer.samples.sample import nanoseconds
from gray_box_observer.white_box.base import Array

__all__ = ['Forecast', 'GroupResult', 'Observer', 'Result']

MOST_PLANS = 256
"""Lists of names of which it is remembered whom they mean; a publisher keeps its list, so few are enough."""


@dataclass(frozen=True, slots=True)
class Forecast:
    """Torque expected of one motor at a stamp that is still to come."""

    motor: str
    stamp_ns: int
    torque_nm: float


class Observer:
    """Observes the configured motors.

    Args:
        configuration: parameters of the observer and of every motor.
        training: makes the trainer of a motor from its configuration; None: no predictor.
    """

    def __init__(self, configuration: Configuration, training: TrainingFactory | None = None) -> None:
        self.configuration = configuration
        self._training = training if configuration['predictor'] else None
        self._frozen = bool(configuration['freeze'])
        self._places: dict[str, tuple[Group, int]] = {}
        self._parts: dict[tuple[str, tuple[str, ...]], list[_Part]] = {}
        self.pairing: dict[str, Any] = {}
        self.motors: dict[str, Any] = {}
        for name in configuration.motors:
            self._settle(Group((name,), self._pairing((name,))))

    def voltage(self, motor: str, stamp_ns: int, voltage_v: float) -> list[Result]:
        """Take one armature voltage in V; return what the samples that it completes have led to."""
        return _flat(self._take(self._part(motor), 'voltage', stamp_ns, [voltage_v], None))

    def torque(self, motor: str, stamp_ns: int, torque_nm: float, speed_rad_s: float = math.nan) -> list[Result]:
        """Take one torque in N m, with speed where measured; return what the samples that it completes have led to."""
        return _flat(self._take(self._part(motor), 'torque', stamp_ns, [torque_nm], [speed_rad_s]))

    def speed(self, motor: str, stamp_ns: int, speed_rad_s: float) -> list[Result]:
        """Take one speed in rad/s, where it is a signal of its own; return what it has led to."""
        return _flat(self._take(self._part(motor), 'speed', stamp_ns, [speed_rad_s], None))

    def take(
        self, signal: str, names: tuple[str, ...], stamp_ns: int, values: Sequence[float] | Array,
        speeds: Sequence[float] | Array | None = None,
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
        if signal == 'torque' and speeds is not None:
            self._tell_speeds_apart(names, np.asarray(speeds, dtype=float))
        parts = self._parts.get((signal, names))
        if parts is None:
            parts = self._plan(signal, names)
        results: list[GroupResult] = []
        for part in parts:
            results += self._take(part, signal, stamp_ns, values, speeds)
        return results

    def groups(self, names: tuple[str, ...]) -> list[Group]:
        """Return the groups that the motors of a message belong to."""
        parts = self._parts.get(('voltage', names))
        if parts is None:
            parts = self._plan('voltage', names)
        return [part.group for part in parts]

    def flush(self) -> list[Result]:
        """Learn what still waits for a voltage (end of a bag)."""
        return _flat(result for group in self.every_group for result in self._learn(group, group.pairing.flush()))

    def forecast_group(self, group: Group, stamp_ns: int) -> Array | None:
        """Predict the torque of every motor of a group at a stamp that is still to come, shape (motor,); NaN: unknown.

        None where the voltage is not known up to the stamp; changes nothing.
        """
        ahead = group.pairing.ahead(stamp_ns)
        if group.observer is None or ahead is None:
            return None
        prediction = group.observer.predict(*(np.atleast_1d(value) for value in ahead))
        return None if prediction is None else prediction.torque_nm

    def forecast(self, motor: str, stamp_ns: int) -> Forecast | None:
        """Predict the torque at a stamp whose voltage is known and whose torque is still to come; changes nothing."""
        group, place = self._places[motor]
        torque_nm = self.forecast_group(group, stamp_ns)
        if torque_nm is None or not math.isfinite(torque_nm[place]):
            return None
        return Forecast(motor, stamp_ns, float(torque_nm[place]))

    def forecast_held(self, motor: str, horizon_s: float) -> Forecast | None:
        """Predict the torque after the newest voltage has been held for a while; changes nothing.

        The stamp is that of the voltage (shifted by the delay, where there is one) plus the horizon. Torque measured at
        or before the voltage's stamp must not be waited for: what is not measured yet is predicted on the way.

        Args:
            motor: its name.
            horizon_s: how long the voltage is held.

        Returns:
            None before the second sample of a signal history, where no predictor runs, or where the voltage came so
            late that torque has been learnt beyond it.

        Raises:
            ConfigurationError: the network is one of the thesis, which goes from sample to sample only.
        """
        group, place = self._places[motor]
        found = self.forecast_group_held(group, horizon_s)
        if found is None or not math.isfinite(found[1][place]):
            return None
        return Forecast(motor, found[0], float(found[1][place]))

    def forecast_group_held(self, group: Group, horizon_s: float) -> tuple[int, Array] | None:
        """Return stamp and torques, shape (motor,), of :meth:`forecast_held` for every motor of a group."""
        observer, pairing = group.observer, group.pairing
        newest = pairing.newest_voltage
        if observer is None or newest is None:
            return None
        since_ns, voltage_v = newest
        ahead = pairing.ahead(since_ns)
        if ahead is None and since_ns != pairing.newest_sample_ns:
            return None
        torque_nm = observer.forecast_held(ahead, horizon_s, voltage_v)
        return None if torque_nm is None else (since_ns + nanoseconds(horizon_s), torque_nm)

    def estimates(self) -> dict[str, Estimate]:
        """Return the present estimate of every motor that has been seen."""
        return {name: motor.context_nodes.estimate() for name, motor in self.motors.items()}

    def known(self, motor: str) -> tuple[Estimate, bool]:
        """Return what is known of a motor and whether all of it is identified; of one not seen yet, what was given."""
        seen = self.motors.get(motor)
        if seen is None:
            given = initial_estimate(self.configuration, self.configuration.motors[motor])
            return given, given.identified(0)
        return seen.context_nodes.estimate(), seen.identified

    def delays(self) -> dict[str, DelayEstimate]:
        """Return what is known of the delay between voltage and torque of every motor that has been seen."""
        return {name: motor.delay.estimate for name, motor in self.motors.items()}

    def alarm(self, motor: str) -> bool:
        """Whether the alarm on the prediction's residual stands; never where nothing is predicted by the physics."""
        if motor not in self._places:
            return False
        group, place = self._places[motor]
        return group.observer is not None and bool(group.observer.alarmed[place])

    def skill(self, motor: str) -> Skill | None:
        """Return the predictor's scores; None where there is no predictor."""
        group, place = self._places[motor]
        if group.observer is None or group.observer.predictor is None:
            return None
        return group.observer.predictor.scores.skill(place)

    @property
    def frozen(self) -> bool:
        """Whether learning is stopped."""
        return self._frozen

    def freeze(self, frozen: bool) -> None:
        """Stop or resume learning of every motor; predictions go on."""
        self._frozen = frozen
        for group in self.every_group:
            if group.observer is not None:
                group.observer.freeze(frozen)

    def reconfigure(self, configuration: Configuration) -> None:
        """Take over the values of parameters that may change at any time; what was learnt stays."""
        self.configuration = configuration
        verdicts, alarm = verdict_rules(configuration), alarm_rules(configuration)
        for group in self.every_group:
            group.pairing.reconfigure(pairing_rules(configuration))
            if group.observer is not None:
                group.observer.reconfigure(verdicts, alarm, configuration['training.core_share'])
        if configuration['freeze'] != self._frozen:
            self.freeze(configuration['freeze'])

    def restore(self, saved: Mapping[str, tuple[dict[str, Any], dict[str, Array]]]) -> None:
        """Take back what :meth:`MotorObserver.state` gave, by motor: all of it or nothing.

        Raises:
            ConfigurationError: something was learnt with another white box or other parameters.
        """
        if saved:
            self._gather([name for name in saved if name in self._places])
        made: list[tuple[Group, MotorObserver]] = []
        try:
            affected = [group for group in self.every_group if any(name in saved for name in group.names)]
            made.extend((group, self._restored(group, saved)) for group in affected)
        except BaseException:
            for _, observer in made:
                observer.close()
            raise
        for group, observer in made:  # all good: take over
            self._learn(group, group.pairing.flush())  # what still waited belongs to the old signal history
            group.pairing.restart(observer.delay_of(0).applied_s)
            if group.observer is not None:
                group.observer.settle()
                group.observer.close()
            self._adopt(group, observer)

    def _restored(self, group: Group, saved: Mapping[str, tuple[dict[str, Any], dict[str, Array]]]) -> MotorObserver:
        """Make the observer of a group from what was saved; what was not saved stays as it is."""
        states = dict(saved)
        for motor, name in enumerate(group.names):
            if name not in states and group.observer is not None:
                states[name] = group.observer.state(motor)
        told = {bool(states[name][0]['white_box']['speed_measured']) for name in group.names if name in states}
        made = self._make(group, any(told))
        try:
            for motor, name in enumerate(group.names):
                if name not in states:
                    continue
                plain, arrays = states[name]
                if made.white_box_of(motor).to_dict() != plain['white_box']:
                    raise ConfigurationError(
                        f'motor {name}: the checkpoint was learnt with other known constants or terms'
                    )
                made.restore(plain, arrays, motor)
        except BaseException:
            made.close()
            raise
        return made

    def close(self) -> None:
        """Stop whatever trains in the background."""
        for group in self.every_group:
            if group.observer is not None:
                group.observer.close()

    @property
    def every_group(self) -> list[Group]:
        """Every group once; a motor that comes alone is a group of its own."""
        return list({id(group): group for group, _ in self._places.values()}.values())

    def _pairing(self, names: tuple[str, ...]) -> Pairing:
        own_speed = bool(self.configuration['speed.topic'])
        delay_s = self.configuration.motors[names[0]].delay_s
        return Pairing(pairing_rules(self.configuration), len(names), own_speed=own_speed, delay_s=delay_s)

    def _settle(self, group: Group) -> None:
        """Let a group have its motors."""
        for place, name in enumerate(group.names):
            self._places[name] = group, place
            self.pairing[name] = group.pairing if len(group.names) == 1 else PairingOfOne(group, place)
        self._parts.clear()

    def _part(self, motor: str) -> _Part:
        """What a message speaks of that brings one motor only."""
        group, place = self._places[motor]
        return _Part(group, 0 if len(group.names) == 1 else np.zeros(1, dtype=int), np.array([place]))

    def _plan(self, signal: str, names: tuple[str, ...]) -> list[_Part]:
        """Settle which groups a message speaks of, and where in it; motors that are new to us become groups."""
        self._gather([name for name in names if name in self._places and self._places[name][0].untouched])
        self._divide({name for name in names if name in self._places}, signal)
        found: dict[int, tuple[Group, list[int], list[int]]] = {}
        for at, name in enumerate(names):
            if name in self._places:
                group, place = self._places[name]
                _, source, target = found.setdefault(id(group), (group, [], []))
                source.append(at)
                target.append(place)
        parts = []
        for group, source, target in found.values():
            if len(group.names) == 1:
                parts += [_Part(group, at) for at in source]
                continue
            whole = target == list(range(len(group.names)))
            parts.append(_Part(group, np.array(source), None if whole else np.array(target)))
        if len(self._parts) > MOST_PLANS:
            self._parts.clear()
        self._parts[signal, names] = parts
        return parts

    def _gather(self, names: list[str]) -> None:
        """Compute motors together that come together, where they are many and of one kind."""
        if len(names) < self.configuration['group_from']:
            return
        kinds: dict[Any, list[str]] = {}
        for name in dict.fromkeys(names):
            what = kind(self.configuration, self.configuration.motors[name])
            if what is not None and len(self._places[name][0].names) == 1 and self._places[name][0].untouched:
                kinds.setdefault(what, []).append(name)
        for alike in kinds.values():
            if len(alike) >= self.configuration['group_from']:
                self._settle(Group(tuple(alike), self._pairing(tuple(alike))))

    def _divide(self, spoken_of: set[str], signal: str) -> None:
        """Part motors of a group that has not begun to learn yet, where a message speaks of some of them only."""
        for group in self.every_group:
            some = [name for name in group.names if name in spoken_of]
            if len(group.names) > 1 and group.observer is None and 0 < len(some) < len(group.names):
                self._split(group, set(some))

    def _tell_speeds_apart(self, names: tuple[str, ...], speeds: Array) -> None:
        """Part motors with speed from those without, before they begin to learn."""
        parts = self._parts.get(('torque', names))
        if parts is not None and all(part.group.observer is not None for part in parts):
            return
        told = {name for name, speed in zip(names, speeds.tolist(), strict=True) if math.isfinite(speed)}
        for group in self.every_group:
            some = told.intersection(group.names)
            if len(group.names) > 1 and group.observer is None and 0 < len(some) < len(group.names):
                self._split(group, some)

    def _split(self, group: Group, some: set[str]) -> None:
        """Make two groups of one; what has come for them so far is gone through again."""
        events = list(group.pairing.history.events(group.pairing.delay_ns))
        for names in ([n for n in group.names if n in some], [n for n in group.names if n not in some]):
            places = [group.names.index(name) for name in names]
            parts = [([name], [place]) for name, place in zip(names, places, strict=True)]
            if len(names) >= self.configuration['group_from']:
                parts = [(names, places)]
            for own, index in parts:
                made = Group(tuple(own), self._pairing(tuple(own)))
                self._settle(made)
                for signal, stamp_ns, values in events:
                    picked: list[Any] = [np.asarray(v)[index] if np.ndim(v) else v for v in values]
                    if len(own) == 1:
                        picked = [float(np.atleast_1d(v)[0]) for v in picked]
                    getattr(made.pairing, signal)(stamp_ns, *picked)

    def _take(
        self, part: _Part, signal: str, stamp_ns: int, values: Sequence[float] | Array, speeds: Any
    ) -> list[GroupResult]:
        """Let a group have its part of a message."""
        group, source = part.group, part.source
        pairing = group.pairing
        if isinstance(source, int):
            arguments: list[Any] = [float(values[source])]
            if signal == 'torque':
                arguments.append(math.nan if speeds is None else float(speeds[source]))
            samples = getattr(pairing, signal)(stamp_ns, *arguments)
        else:
            arguments = [part.spread(values)]
            if signal == 'torque':
                arguments.append(math.nan if speeds is None else part.spread(speeds))
            samples = getattr(pairing, signal)(stamp_ns, *arguments, missing=part.missing)
        return self._learn(group, samples) if samples else []

    def _learn(self, group: Group, samples: list[Sample]) -> list[GroupResult]:
        results: list[GroupResult] = []
        waiting, pairing = deque(samples), group.pairing
        while waiting:
            sample = waiting.popleft()
            if group.observer is None:
                self._adopt(group, self._make(group, bool(np.isfinite(sample.speed_rad_s).any())))
            observer = group.observer
            assert observer is not None
            if pairing.repeats(sample):  # it was predicted, scored and reported before
                again = observer.repeat(sample)
                if again is not None and results:
                    results[-1] = replace(results[-1], estimate=again, changed=observer.changed)
                continue
            left, estimate = observer.step(sample)
            results.append(GroupResult(group, sample, left.prediction, observer.changed, estimate, left))
            delay_s = None if self._frozen else observer.delay.take(pairing.history, sample.stamp_ns)
            if delay_s is not None:
                known, rest = pairing.redelay(delay_s, sample.stamp_ns)
                motors = [self.configuration.motors[name] for name in group.names]
                observer.relearn(context_nodes(self.configuration, motors, observer.white_box), known)
                estimate = observer.context_nodes.estimate()
                results[-1] = replace(results[-1], estimate=estimate, changed=np.arange(len(group.names)))
                waiting = deque(rest)
        return results

    def _adopt(self, group: Group, observer: MotorObserver) -> None:
        """Let a group be observed from now on."""
        group.observer = observer
        group.pairing.needs_speed = observer.white_box.speed_measured
        for place, name in enumerate(group.names):
            self.motors[name] = observer if len(group.names) == 1 else OneOfGroup(observer, place)

    def _make(self, group: Group, measured: bool) -> MotorObserver:
        motors = [self.configuration.motors[name] for name in group.names]
        made = motor_observer(self.configuration, motors, self._training, measured=measured)
        made.freeze(self._frozen)
        return made


@dataclass(frozen=True, slots=True)
class _Part:
    """What a message says of a group.

    Attributes:
        group: the motors.
        source: where their values stand in the message.
        target: which motors of the group they are of; None: all of them, in order.
    """

    group: Group
    source: Any
    target: NDArray[np.intp] | None = None

    @property
    def missing(self) -> NDArray[np.bool_] | None:
        """Which motors of the group the message does not speak of; None: it speaks of all."""
        if self.target is None:
            return None
        missing = np.ones(len(self.group.names), dtype=bool)
        missing[self.target] = False
        return missing

    def spread(self, values: Any) -> Array:
        """Values of the group's motors; NaN where the message has none."""
        picked: Array = np.asarray(values, dtype=float)[self.source]
        if self.target is None:
            return picked
        spread = np.full(len(self.group.names), np.nan)
        spread[self.target] = picked
        return spread


def _flat(results: Iterable[GroupResult]) -> list[Result]:
    """Results of groups, motor by motor."""
    return [one for result in results for one in result]
