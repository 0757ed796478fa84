"""Which motors are computed together: what every message settles, and what of it is whose.

A motor is alone until a message speaks of it beside enough others of its kind (``group_from``).
Groups are settled for good with their first sample: until then a message that speaks of some only,
or brings speed for some only, parts them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.observer.builder import kind, pairing_rules
from gray_box_observer.observer.motor_group import Group
from gray_box_observer.safe_io.bounded_cache import BoundedCache, size_of_names, worth_remembering
from gray_box_observer.samples import Pairing, Sample
from gray_box_observer.settings.configuration import Configuration
from gray_box_observer.white_box.interface import Array

MAX_PLANS = 256
"""Lists of names of which it is remembered whom they mean; a publisher keeps its list, so few are
enough."""

MAX_PLAN_BYTES = 8_000_000
"""What these lists may take together: somebody who sends ever other lists would fill the memory."""

Values = Sequence[float] | Array
"""Values of a message, one a name."""


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """What a message says of a group.

    Attributes:
        group: the motors.
        source: where their values stand in the message; one place for a motor by itself.
        target: which motors of the group they are of; None: all of them, in order.
    """

    group: Group
    source: int | NDArray[np.intp]
    target: NDArray[np.intp] | None = None

    def ingest(
        self, signal: str, stamp_ns: int, values: Values, speeds: Values | None
    ) -> list[Sample]:
        """Let the group have its part of a message; return the samples that it completes."""
        pairing = self.group.pairing
        source = self.source
        if isinstance(source, int):
            value = float(values[source])
            if speeds is not None and signal == 'torque':
                return pairing.torque(stamp_ns, value, float(speeds[source]))
            return pairing.ingest_signal[signal](stamp_ns, value)
        if speeds is not None and signal == 'torque':
            return pairing.torque(
                stamp_ns, self._spread(values), self._spread(speeds), self._absent_motors
            )
        return pairing.ingest_signal[signal](
            stamp_ns, self._spread(values), absent=self._absent_motors
        )

    @property
    def _absent_motors(self) -> NDArray[np.bool_] | None:
        """Which motors of the group the message does not speak of; None: it speaks of all."""
        if self.target is None:
            return None
        absent = np.ones(len(self.group.names), dtype=bool)
        absent[self.target] = False
        return absent

    def _spread(self, values: Values) -> Array:
        """Values of the group's motors; NaN where the message has none."""
        source_values: Array = np.asarray(values, dtype=float)[self.source]
        if self.target is None:
            return source_values
        spread = np.full(len(self.group.names), np.nan)
        spread[self.target] = source_values
        return spread


class Grouping:
    """Knows the group of every motor, and makes groups of motors as messages come.

    Args:
        configuration: names the motors, and from how many on they are computed together.
    """

    def __init__(self, configuration: Configuration) -> None:
        self._configuration = configuration
        self._places: dict[str, tuple[Group, int]] = {}
        self._parts: BoundedCache[tuple[str, tuple[str, ...]], list[Part]]
        self._parts = BoundedCache(MAX_PLANS, MAX_PLAN_BYTES)
        for name in configuration.motors:
            self._settle([name])

    def reconfigure(self, configuration: Configuration) -> None:
        """Take over the values of parameters that may change at any time."""
        self._configuration = configuration
        for group in self.groups:
            group.pairing.reconfigure(pairing_rules(configuration))

    @property
    def groups(self) -> list[Group]:
        """Every group once; a motor that comes alone is a group of its own."""
        return _once(group for group, _ in self._places.values())

    def __contains__(self, motor: str) -> bool:
        return motor in self._places

    def place(self, motor: str) -> tuple[Group, int]:
        """Return the group of a motor and its place on the motor axis."""
        return self._places[motor]

    def spoken_of(self, names: tuple[str, ...]) -> list[Group]:
        """Return the groups of the motors that a message speaks of; changes nothing."""
        parts = self._parts.get(('voltage', names))
        if parts is not None:
            return [part.group for part in parts]
        return _once(self._places[name][0] for name in names if name in self._places)

    def part(self, motor: str) -> Part:
        """What a message speaks of that brings one motor only."""
        group, place = self._places[motor]
        return (
            Part(group, 0)
            if len(group.names) == 1
            else Part(group, np.zeros(1, dtype=int), np.array([place]))
        )

    def parts(self, signal: str, names: tuple[str, ...], speeds: Values | None) -> list[Part]:
        """Settle which groups a message speaks of, and where in it.

        Args:
            signal: what it is of.
            names: motors that it speaks of; those not configured are passed over.
            speeds: of a torque message, in rad/s, where it brings them.
        """
        if signal == 'torque' and speeds is not None:
            self._tell_speeds_apart(names, np.asarray(speeds, dtype=float))
        parts = self._parts.get((signal, names))
        if parts is None:
            self.gather(names)
            self._divide({name for name in names if name in self._places})
            parts = self._find_parts(names)
            if worth_remembering(names):
                self._parts.remember((signal, names), parts, size_of_names(names))
        return parts

    @property
    def places(self) -> Mapping[str, tuple[Group, int]]:
        """The group of every motor and its place on the motor axis, as they are now."""
        return dict(self._places)

    def put_back(self, places: Mapping[str, tuple[Group, int]]) -> None:
        """Compute motors together as they were; nothing may have come since."""
        self._places = dict(places)
        self._parts.clear()

    def gather(self, names: Sequence[str]) -> None:
        """Compute motors together from now on, if they are many, alike and without results."""
        new = [
            name
            for name in dict.fromkeys(names)
            if name in self._places and self._alone_and_new(name)
        ]
        if len(new) < self._configuration['group_from']:
            return
        kinds: dict[Any, list[str]] = {}
        for name in new:
            motor_kind = kind(self._configuration, self._configuration.motors[name])
            if motor_kind is not None:
                kinds.setdefault(motor_kind, []).append(name)
        for alike in kinds.values():
            if len(alike) >= self._configuration['group_from']:
                self._settle(alike)

    def _alone_and_new(self, name: str) -> bool:
        group, _ = self._places[name]
        return len(group.names) == 1 and group.untouched

    def _settle(self, names: Sequence[str], pairing: Pairing | None = None) -> None:
        """Make a group; without pairing one of which nothing has come yet."""
        if pairing is None:
            pairing = self._new_pairing(names)
        group = Group(tuple(names), pairing)
        self._places.update({name: (group, place) for place, name in enumerate(names)})
        self._parts.clear()

    def _new_pairing(self, names: Sequence[str]) -> Pairing:
        own_speed = self._configuration.has_own_speed
        first = self._configuration.motors[names[0]]
        uses_speed = first.values['speed_source'] not in ('torque_constant', 'rotor')
        rules = pairing_rules(self._configuration)
        return Pairing(
            rules,
            len(names),
            own_speed=own_speed,
            uses_speed=uses_speed,
            needs_speed=first.needs_speed,
            delay_s=first.delay_s,
            tells_moves=len(names) == 1 or first.has_rotor,
        )

    def pairing_of(self, group: Group) -> Pairing:
        """Return a pairing that has seen nothing and counts on, for motors that had stopped."""
        pairing = self._new_pairing(group.names)
        pairing.count_as([group.pairing.counts_for(place) for place in range(len(group.names))])
        return pairing

    def _find_parts(self, names: tuple[str, ...]) -> list[Part]:
        """Find where in a message every group stands."""
        places: dict[int, tuple[Group, list[int], list[int]]] = {}
        for at, name in enumerate(names):
            if name in self._places:
                group, place = self._places[name]
                _, source, target = places.setdefault(id(group), (group, [], []))
                source.append(at)
                target.append(place)
        parts: list[Part] = []
        for group, source, target in places.values():
            if len(group.names) == 1:
                parts += [Part(group, at) for at in source]
                continue
            whole = target == list(range(len(group.names)))
            parts.append(Part(group, np.array(source), None if whole else np.array(target)))
        return parts

    def _divide(self, spoken_of: set[str]) -> None:
        """Take motors out of groups that have not begun to learn, where only some are named."""
        for group in self.groups:
            some = spoken_of.intersection(group.names)
            if len(group.names) > 1 and group.is_open and 0 < len(some) < len(group.names):
                self._split(group, some)

    def _tell_speeds_apart(self, names: tuple[str, ...], speeds: Array) -> None:
        """Part motors with speed from those without, before they begin to learn."""
        parts = self._parts.get(('torque', names))
        if parts is None or any(part.group.is_open for part in parts):
            self._divide(
                {
                    name
                    for name, speed in zip(names, speeds.tolist(), strict=True)
                    if math.isfinite(speed)
                }
            )

    def _split(self, group: Group, some: set[str]) -> None:
        """Make two groups of one; what has come for them so far is gone through again."""
        assert isinstance(group.pairing, Pairing)  # it is open
        for names in (
            [n for n in group.names if n in some],
            [n for n in group.names if n not in some],
        ):
            together = len(names) >= self._configuration['group_from']
            for own in [names] if together else [[name] for name in names]:
                self._settle(own, group.pairing.part([group.names.index(name) for name in own]))


def _once(groups: Any) -> list[Group]:
    """Every group once, in order."""
    return list({id(group): group for group in groups}.values())
