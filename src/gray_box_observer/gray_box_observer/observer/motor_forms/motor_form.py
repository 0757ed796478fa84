"""A form that the physics of one motor may take: its parts, ready to observe the motor by."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from gray_box_observer.context_nodes import (
    ContextUpdate,
    Estimate,
    MeasuredSpeedUpdate,
    RotorUpdate,
)
from gray_box_observer.context_nodes.pieces import Pieces, completed
from gray_box_observer.context_nodes.recursive.trajectory import SampleWindow
from gray_box_observer.context_nodes.update_rule import learn_at_once
from gray_box_observer.delay import DelayRound, DelayWatch
from gray_box_observer.fit_test.effects import HYSTERESIS
from gray_box_observer.fit_test.fitted_residual import fitted_residual_in_pieces
from gray_box_observer.fit_test.monitor import FitMonitor
from gray_box_observer.fit_test.motor_under_test import knows_voltage_noise
from gray_box_observer.fit_test.rotor_free_run import rotor_free_run
from gray_box_observer.fit_test.twin_effects import LOAD_TORQUE, LOST_VOLTAGE, OFFSET
from gray_box_observer.observer.motor_forms.voltage_path import VoltagePath, beyond_start
from gray_box_observer.observer.scale_doubt import ScaleDoubt
from gray_box_observer.samples import Sample
from gray_box_observer.samples.order_statistics import usual_interval
from gray_box_observer.samples.replay_buffer import (
    INTERVAL,
    TORQUE,
    with_moves,
    without_lone,
)
from gray_box_observer.settings.motor_configuration import (
    COASTING,
    CURRENT_LAG,
    DEAD_ZONE,
    VARYING_LOAD,
)
from gray_box_observer.settings.sensor_lag import CurrentLag
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.flow import to_coordinates
from gray_box_observer.white_box.interface import Array

if TYPE_CHECKING:  # loaded where something is predicted
    from gray_box_observer.predictor import Forecasting

THESIS = 'torque_constant'
ROTOR = 'rotor'
MEASURED = 'measured'
"""Sources of a motor's speed."""

OTHER_SOURCE = {THESIS: ROTOR, ROTOR: THESIS, MEASURED: ROTOR}
"""What else the speed may come from; a measured one is left out where its reading stands still."""

QUADRATIC_FRICTION = 'quadratic_friction'

POSSIBLE_EFFECTS = (
    *(LOST_VOLTAGE, OFFSET, DEAD_ZONE, CURRENT_LAG, COASTING),
    *(HYSTERESIS, LOAD_TORQUE, QUADRATIC_FRICTION, VARYING_LOAD),
)
"""Effects of driver, sensor and load that data may add: names of their context nodes, and three
that have none, a lag of the current sensor, a driver that coasts and a load that varies."""

SOURCES_OF = {
    LOAD_TORQUE: (ROTOR,),
    QUADRATIC_FRICTION: (ROTOR,),
    VARYING_LOAD: (ROTOR,),
    CURRENT_LAG: (THESIS, ROTOR),
}
"""Sources of the speed beside which an effect may be added, where not beside all: a measured speed
would have to lag as the current does."""

_IN_WORDS = {
    THESIS: 'a speed of Kt i',
    ROTOR: 'a rotor',
    MEASURED: 'the measured speed',
    LOST_VOLTAGE: 'a lost voltage',
    OFFSET: 'an offset',
    DEAD_ZONE: 'a dead zone',
    CURRENT_LAG: 'a lag of the current',
    COASTING: 'a driver that coasts',
    LOAD_TORQUE: 'a load',
    QUADRATIC_FRICTION: 'a quadratic friction',
    HYSTERESIS: 'hysteresis',
    VARYING_LOAD: 'a load that varies',
}

WORK_A_SAMPLE = 8
"""Work of a fit of the thesis's form, and of a test of the fit, for each of its samples."""


@dataclass(frozen=True, slots=True)
class FormKind:
    """Which form the physics of a motor takes.

    Attributes:
        source: of its speed.
        effects: of driver, sensor and load that were added.
        dead_zone_v: where a dead zone was added, the command up to which nothing drives the motor,
            in V; 0: not yet told.
        lag: where one of the current was added; None: not yet told.
    """

    source: str
    effects: tuple[str, ...] = ()
    dead_zone_v: float = 0.0
    lag: CurrentLag | None = None

    @property
    def in_words(self) -> str:
        """What it is called in a sentence."""
        effects_text = ' and '.join(_IN_WORDS[name] for name in self.effects)
        return _IN_WORDS[self.source] + (f' with {effects_text}' if effects_text else '')

    @property
    def with_other_source(self) -> FormKind | None:
        """The plain form with the other source of the speed; None where there is no other."""
        other = OTHER_SOURCE.get(self.source)
        return None if other is None else FormKind(other)

    def with_effect(self, node: str) -> FormKind:
        """Return the same form with one effect more."""
        return replace(self, effects=(*self.effects, node), lag=self._lag_in_either_order)

    def with_effects(self, nodes: Sequence[str]) -> FormKind:
        """Return the same form with those of some effects that it has not."""
        kind = self
        for node in nodes:
            kind = kind if node in kind.effects else kind.with_effect(node)
        return kind

    @property
    def rivals(self) -> list[FormKind]:
        """The same form with another effect that loses as many volts; none without such."""
        return [
            self.without(node).with_effect(RIVALS[node])
            for node in self.effects
            if node in RIVALS and RIVALS[node] not in self.effects
        ]

    def without(self, *nodes: str) -> FormKind:
        """Return the same form without some effects."""
        effects = tuple(name for name in self.effects if name not in nodes)
        return FormKind(
            self.source,
            effects,
            self.dead_zone_v if DEAD_ZONE in effects else 0.0,
            self._lag_in_either_order if CURRENT_LAG in effects else None,
        )

    def is_same_but_for_lag(self, other: FormKind) -> bool:
        """Tell whether another form is this one but for a lag of the current."""
        return replace(self, lag=None) == replace(other, lag=None)

    def is_like(self, other: FormKind) -> bool:
        """Tell whether another form has the same source of the speed, and the same effects."""
        return self.source == other.source and set(self.effects) == set(other.effects)

    @property
    def _lag_in_either_order(self) -> CurrentLag | None:
        """The lag, without what data tell of its order and kind: that is of this form alone."""
        return None if self.lag is None else self.lag.without_rivals


RIVALS = {LOST_VOLTAGE: DEAD_ZONE, DEAD_ZONE: LOST_VOLTAGE}
"""Effects of which one is mostly suspected for the other: both lose so many volts."""

FormMaker = Callable[[FormKind], 'MotorForm']
"""Makes a form of one motor that has learnt nothing."""


@dataclass(frozen=True, slots=True, eq=False)
class MotorForm:
    """What a motor is observed by; nothing in it has learnt anything when it is made.

    Attributes:
        white_box: the physics.
        context_nodes: the rule that learns the parameters.
        delay: asks whether voltage and torque are shifted against each other.
        fit: asks whether the white box explains the data.
        make_forecasting: makes what predicts torque, and has a trainer: only of a form that is
            used; None where nothing predicts.
        scales: what is not known of the scales of the signals; None where nothing is said of it.
        voltage_path: makes of commands the voltages that the white box takes; None: they are the
            same.
    """

    white_box: MotorWhiteBox
    context_nodes: ContextUpdate
    delay: DelayWatch | DelayRound
    fit: FitMonitor
    make_forecasting: Callable[[], Forecasting | None]
    scales: ScaleDoubt | None = None
    voltage_path: VoltagePath | None = None

    @property
    def can_go_on(self) -> bool:
        """Whether :meth:`learn_remembered` goes on from what it has found in fewer samples."""
        return isinstance(self.context_nodes, RotorUpdate)

    def learn_remembered(
        self,
        content: Array,
        stamp_ns: int,
        *,
        start: Array | None = None,
        searches_elsewhere: bool = True,
        asks_speed: bool = False,
    ) -> Pieces[Estimate]:
        """Learn the samples that another form remembers, all at once, and test the fit.

        Args:
            content: shape (signal, 1, n), as a replay buffer gives it.
            stamp_ns: of the newest of them.
            start: shape (1, parameter): where nearly the same form has explained them; None:
                nowhere.
            searches_elsewhere: whether a rotor is looked for elsewhere, too.
            asks_speed: whether to ask if a measured speed is noisy or late.
        """
        nodes = self.context_nodes
        if self.voltage_path is not None:
            content = self.voltage_path.follow_content(content)
        work = WORK_A_SAMPLE * content.shape[2]
        newest = _sample(content[:, 0, -1], stamp_ns)
        if isinstance(nodes, RotorUpdate):
            if start is not None:
                nodes.begin_at(start, searches_elsewhere=searches_elsewhere)
            yield from nodes.learn_remembered(content, stamp_ns)
        elif isinstance(nodes, MeasuredSpeedUpdate):
            yield from nodes.learn_remembered(content, newest, asks_speed=asks_speed)
            yield work
        else:
            learn_at_once(nodes, content, newest)
            yield work
        estimate = nodes.estimate()
        assert isinstance(self.delay, DelayWatch)  # of one motor
        self.fit.test(nodes, estimate, 0, self.delay.estimate)
        yield work
        return estimate

    def catch_up(self, content: Array, stamp_ns: int) -> None:
        """Take samples that have come since those that were learnt all at once.

        Args:
            content: shape (signal, 1, n).
            stamp_ns: of the newest of them.
        """
        nodes = self.context_nodes
        take = nodes.remember if isinstance(nodes, RotorUpdate) else nodes.learn
        path = self.voltage_path
        for column in content[:, 0].T:
            sample = _sample(column, stamp_ns)
            take(sample if path is None else path.follow(sample, is_kept=True))

    def residual(self, content: Array, settle_s: float = 0.0) -> float:
        """Return the root mean square of the free run's residual in A, over given samples.

        Args:
            content: shape (signal, 1, n): the samples, as they were measured.
            settle_s: time in s behind each start of a signal history that does not count.
        """
        path = self.voltage_path
        open_a = np.empty(0)
        if path is not None:  # where the winding is open no current is foretold
            open_a = self.white_box.state(content[TORQUE, 0][path.is_open(content)[0]])
        part = without_lone(beyond_start(content, self.driven(content), settle_s))
        if part.shape[2] == 0:
            return math.inf
        left_a = residual_a(self.white_box, self.context_nodes, part)
        if path is not None:  # what is new in a reading
            left_a *= path.newest_share(usual_interval(content[INTERVAL]))
        count = part.shape[2] + open_a.size
        return math.sqrt((part.shape[2] * left_a**2 + float(open_a @ open_a)) / count)

    def driven(self, content: Array) -> Array:
        """Return samples, shape (signal, 1, n), with the voltages that the white box takes."""
        return content if self.voltage_path is None else self.voltage_path.driven(content)


def _sample(column: Array, stamp_ns: int) -> Sample:
    """Return a sample by its signals, shape (signal,)."""
    interval_s, voltage_v, torque_nm, speed_rad_s, held_v, moment_v = with_moves(column).tolist()
    return Sample.of_one_motor(
        stamp_ns, interval_s, voltage_v, torque_nm, speed_rad_s, held_v, moment_v
    )


def residual_a(white_box: MotorWhiteBox, context_nodes: ContextUpdate, content: Array) -> float:
    """Return the root mean square of the residual in A of one motor's free run.

    Args:
        white_box: its physics.
        context_nodes: which hold the values to run at.
        content: shape (signal, 1, n): samples, as a replay buffer gives them.
    """
    stretch = SampleWindow.of_content(white_box, np.ascontiguousarray(content))
    p = to_coordinates(context_nodes.theta)
    noise_memory = 0.0
    if isinstance(context_nodes, RotorUpdate):
        noise_memory = context_nodes.noise_memory
    if white_box.load_varies:  # its projection costs too much to be done at once
        run = rotor_free_run(white_box, p, stretch, noise_memory)
        return float(np.sqrt(np.mean(run.residual_a**2)))
    pieces = fitted_residual_in_pieces(
        white_box,
        p,
        stretch,
        is_drifting=False,
        knows_voltage_noise=knows_voltage_noise(context_nodes),
        noise_memory=noise_memory,
    )
    residual = completed(pieces)
    return residual.ratio * residual.floor_a
