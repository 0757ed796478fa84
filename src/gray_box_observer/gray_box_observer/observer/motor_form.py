"""A form that the physics of one motor may take: its parts, ready to observe the motor by."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from gray_box_observer.context_nodes import (
    ContextUpdate,
    Estimate,
    MeasuredSpeedUpdate,
    RotorUpdate,
)
from gray_box_observer.context_nodes.pieces import Pieces
from gray_box_observer.context_nodes.recursive.trajectory import SampleWindow
from gray_box_observer.context_nodes.update_rule import learn_at_once
from gray_box_observer.delay import DelayRound, DelayWatch
from gray_box_observer.fit_test.monitor import FitMonitor
from gray_box_observer.fit_test.residual_analysis import analyse
from gray_box_observer.fit_test.twin_effects import LOAD_TORQUE, LOST_VOLTAGE, OFFSET
from gray_box_observer.observer.scale_doubt import ScaleDoubt
from gray_box_observer.samples import Sample
from gray_box_observer.samples.replay_buffer import INTERVAL, SPEED, TORQUE, VOLTAGE
from gray_box_observer.settings.motor_configuration import DEAD_ZONE
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.flow import to_coordinates
from gray_box_observer.white_box.interface import Array

if TYPE_CHECKING:  # loaded where something is predicted
    from gray_box_observer.predictor import Forecasting

THESIS = 'torque_constant'
ROTOR = 'rotor'
MEASURED = 'measured'
"""Sources of a motor's speed."""

OTHER_SOURCE = {THESIS: ROTOR, ROTOR: THESIS}

EFFECT_NODES = (LOST_VOLTAGE, OFFSET, DEAD_ZONE, LOAD_TORQUE)
"""Context nodes of the effects of driver, sensor and load that data may add."""

OF_A_ROTOR = (LOAD_TORQUE,)
"""Of these, what only a motor with a rotor may have."""

_IN_WORDS = {
    THESIS: 'a speed of Kt i',
    ROTOR: 'a rotor',
    MEASURED: 'the measured speed',
    LOST_VOLTAGE: 'a lost voltage',
    OFFSET: 'an offset',
    DEAD_ZONE: 'a dead zone',
    LOAD_TORQUE: 'a load',
}

WORK_A_SAMPLE = 8
"""Work of a fit of the thesis's form, and of a test of the fit, for each of its samples."""


@dataclass(frozen=True, slots=True)
class FormKind:
    """Which form the physics of a motor takes.

    Attributes:
        source: of its speed.
        effects: of driver, sensor and load that were added, by their context nodes.
        dead_zone_v: where a dead zone was added, the command up to which nothing drives the motor,
            in V; 0: not yet told.
    """

    source: str
    effects: tuple[str, ...] = ()
    dead_zone_v: float = 0.0

    @property
    def in_words(self) -> str:
        """What it is called in a sentence."""
        effects_text = ' and '.join(_IN_WORDS[name] for name in self.effects)
        return _IN_WORDS[self.source] + (f' with {effects_text}' if effects_text else '')

    @property
    def with_other_source(self) -> FormKind | None:
        """The plain form with the other source of the speed; None where it is measured."""
        other = OTHER_SOURCE.get(self.source)
        return None if other is None else FormKind(other)

    def with_effect(self, node: str) -> FormKind:
        """Return the same form with one effect more."""
        return replace(self, effects=(*self.effects, node))

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
        return FormKind(self.source, effects, self.dead_zone_v if DEAD_ZONE in effects else 0.0)


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
        make_forecasting: makes what predicts torque, and costs a process: only of a form that is
            used; None where nothing predicts.
        scales: what is not known of the scales of the signals; None where nothing is said of it.
        dead_zone_v: shape (motor,): commands up to which nothing drives a motor; None: there are
            none.
    """

    white_box: MotorWhiteBox
    context_nodes: ContextUpdate
    delay: DelayWatch | DelayRound
    fit: FitMonitor
    make_forecasting: Callable[[], Forecasting | None]
    scales: ScaleDoubt | None = None
    dead_zone_v: Array | None = None

    @property
    def can_go_on(self) -> bool:
        """Whether :meth:`learn_remembered` goes on from what it has found in fewer samples."""
        return isinstance(self.context_nodes, RotorUpdate)

    def learn_remembered(
        self, content: Array, stamp_ns: int, *, asks_speed: bool = False
    ) -> Pieces[Estimate]:
        """Learn the samples that another form remembers, all at once, and test the fit.

        Args:
            content: shape (signal, 1, n), as a replay buffer gives it.
            stamp_ns: of the newest of them.
            asks_speed: whether to ask if a measured speed is noisy or late.
        """
        nodes = self.context_nodes
        content = self._driving(content)
        work = WORK_A_SAMPLE * content.shape[2]
        newest = _sample(content[:, 0, -1], stamp_ns)
        if isinstance(nodes, RotorUpdate):
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
        for column in self._driving(content)[:, 0].T:
            take(_sample(column, stamp_ns))

    def residual(self, content: Array) -> float:
        """Return the root mean square of the free run's residual in A, over given samples."""
        return residual_a(self.white_box, self.context_nodes, self._driving(content))

    def _driving(self, content: Array) -> Array:
        """Return samples, shape (signal, 1, n), with the voltage that drives."""
        if self.dead_zone_v is None:
            return content
        content = content.copy()
        content[VOLTAGE] = driving_voltage(content[VOLTAGE], self.dead_zone_v[:, None])
        return content


def driving_voltage(command_v: Array, dead_zone_v: Array) -> Array:
    """Return a command as the white box takes it: within the dead zone it drives nothing.

    What the dead zone takes off a larger one is an effect of the white box.

    Args:
        command_v: in V, any shape.
        dead_zone_v: of each motor, to be broadcast against it.
    """
    driving_v: Array = np.where(np.abs(command_v) > dead_zone_v, command_v, 0.0)
    return driving_v


def _sample(column: Array, stamp_ns: int) -> Sample:
    """Return a sample by its signals, shape (signal,)."""
    signals = (float(column[row]) for row in (INTERVAL, VOLTAGE, TORQUE, SPEED))
    return Sample.of_one_motor(stamp_ns, *signals)


def residual_a(white_box: MotorWhiteBox, context_nodes: ContextUpdate, content: Array) -> float:
    """Return the root mean square of the residual in A of one motor's free run.

    Args:
        white_box: its physics.
        context_nodes: which hold the values to run at.
        content: shape (signal, 1, n): samples, as a replay buffer gives them.
    """
    stretch = SampleWindow.of_content(white_box, np.ascontiguousarray(content))
    analysis = analyse(white_box, to_coordinates(context_nodes.theta), stretch)
    return analysis.ratio * analysis.floor_a
