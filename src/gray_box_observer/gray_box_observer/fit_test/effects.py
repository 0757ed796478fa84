"""Effects that a white box may leave out, each declared once as further voltages of known shape.

Whatever spoils the voltage balance can be written as a voltage that is missing from it: the
back-EMF of a rotor that nobody measures, a drop of the brushes, an offset of the current times R,
the part of the voltage that comes later. The shape follows from the samples; how much of it there
is, the tests ask (:mod:`residual_analysis`, :mod:`suspects`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from gray_box_observer.context_nodes.recursive.trajectory import recurrence
from gray_box_observer.settings.motor_configuration import COASTING
from gray_box_observer.white_box.interface import Array, WhiteBox
from gray_box_observer.white_box.motor import MotorWhiteBox

KNEE = 0.01
"""Share of the largest current at which a drop that follows its sign has half of its value."""

ROTOR_SAMPLES = ((16.0, 128.0), (64.0, 512.0), (256.0, 4096.0))
"""Pairs of time constants, in samples: a rotor's back-EMF is near a sum of two leaky integrals of
the current."""

DELAY_SAMPLES = (((1,), (4,)), ((1,), (1, 2), (2, 3), (3, 4), (5, 6), (8, 9)))
LAG_SAMPLES = ((1.0, 3.0), (0.5, 1.0, 2.0, 4.0, 8.0))
WAVES = 8
"""Half waves of cosine over the stretch that make a voltage which wanders."""

LATE = ('delay', 'current_lag')
"""Effects that the balance, summed over some samples, hardly tells apart: the free run does."""

LATER = (0.0, 1.5)
"""Amounts of a delay or a lag: voltage that acts before it is stamped is none."""

CHANGE_AT = ((0.5,), (0.25, 0.5, 0.75))
"""Delays, time constants, and shares of the stretch after which the motor is another one: few to
find that something is wrong, more to say what (:attr:`Scene.fine`)."""


@dataclass(frozen=True, eq=False)
class Scene:
    """Basis of the shapes; every array has shape (k,), one entry per interval.

    Attributes:
        voltage_v: held over the interval.
        current_a: mean over it, measured or of a free run.
        speed_rad_s: likewise; None where speed is not measured.
        fine: whether effects are told from each other, which takes more shapes than finding that
            there is one.
        has_rotor: whether the speed is a state of the white box.
        turning_rad_s: the speed at which hysteresis would act, wherever it comes from; None where
            hysteresis is identified.
    """

    voltage_v: Array
    current_a: Array
    speed_rad_s: Array | None
    fine: bool = False
    has_rotor: bool = False
    turning_rad_s: Array | None = None

    @property
    def progress(self) -> Array:
        """From -1 at the first interval to 1 at the last."""
        return np.linspace(-1.0, 1.0, self.voltage_v.size)

    @property
    def direction(self) -> Array:
        """Sign of the current, softened where there is hardly any."""
        size = np.abs(self.current_a)
        soft_sign: Array = self.current_a / (size + KNEE * float(size.max()) + 1e-300)
        return soft_sign


Shapes = tuple[Array, ...]
"""Voltages that only come together, shape (k,) each."""


@dataclass(frozen=True)
class Effect:
    """One effect.

    Attributes:
        name: what it is called everywhere.
        alternatives: yields the shapes that it may have.
        remedy: what to do about it; ``{motor}`` stands for the motor's name. Where parameters
            help, it is a line of a parameter file, with the reason as its comment.
        needs_speed: whether it is about a measured speed.
        without_speed: whether it can only be where speed is not measured.
        credible: lowest and highest amount of all its shapes together that such an effect can have.
        hides_resistance: whether the resistance may come out as anything beside it.
        largest_share: largest amount, over the root mean square of the voltage, that such an effect
            can have.
        negative_remedy: what to do about less than none of it, which no parameter takes; empty: the
            same.
    """

    name: str
    alternatives: Callable[[Scene], Iterator[Shapes]]
    remedy: str
    needs_speed: bool = False
    without_speed: bool = False
    credible: tuple[float, float] = (-math.inf, math.inf)
    hides_resistance: bool = False
    largest_share: float = math.inf
    negative_remedy: str = ''


def interval_means(signal: Array) -> Array:
    """Return the mean of a signal over each interval, shape (k,), from its k + 1 samples."""
    means: Array = 0.5 * (signal[1:] + signal[:-1])
    return means


def leaky_mean(signal: Array, samples: tuple[float, ...]) -> Array:
    """Return leaky means of a signal, shape (time constant, k), for time constants in samples."""
    decay = np.exp(-1.0 / np.array(samples))[:, None]
    factor = np.broadcast_to(decay, (len(samples), signal.size))
    inputs = (1.0 - decay) * signal
    means: Array = recurrence(factor, inputs[None], np.full((1, len(samples)), signal[0]))[0, :, 1:]
    return means


def _delayed(signal: Array, samples: int) -> Array:
    if samples >= signal.size:
        return np.full_like(signal, signal[0])
    return np.concatenate([np.full(samples, signal[0]), signal[:-samples]])


def _rotor(scene: Scene) -> Iterator[Shapes]:
    times = tuple(time for pair in ROTOR_SAMPLES for time in pair)
    means = leaky_mean(scene.current_a, times)
    for place in range(0, len(times), 2):
        yield -means[place], -means[place + 1]
        if scene.fine:  # a load on the shaft
            yield -means[place], -means[place + 1], -np.ones_like(scene.voltage_v)


def _current_offset(scene: Scene) -> Iterator[Shapes]:
    yield (-np.ones_like(scene.voltage_v),)


def _lost_voltage(scene: Scene) -> Iterator[Shapes]:
    yield (-scene.direction,)


def _dead_zone(scene: Scene) -> Iterator[Shapes]:
    yield (-np.sign(scene.voltage_v),)


def _sag(scene: Scene) -> Iterator[Shapes]:
    voltage_v = scene.voltage_v
    progress = scene.progress
    yield -voltage_v * progress, -voltage_v * progress**2
    if scene.fine:
        angle = 0.5 * math.pi * (progress + 1.0)
        yield tuple(-voltage_v * np.cos(wave * angle) for wave in range(1, WAVES + 1))
    yield (-voltage_v * np.abs(scene.current_a),)


def _delay(scene: Scene) -> Iterator[Shapes]:
    for neighbours in DELAY_SAMPLES[
        scene.fine
    ]:  # between two of them lie the delays that are no whole samples
        yield tuple(_delayed(scene.voltage_v, samples) - scene.voltage_v for samples in neighbours)


def _current_lag(scene: Scene) -> Iterator[Shapes]:
    for mean in leaky_mean(scene.voltage_v, LAG_SAMPLES[scene.fine]):
        yield (mean - scene.voltage_v,)


def _change(scene: Scene) -> Iterator[Shapes]:
    count = scene.current_a.size
    for share in CHANGE_AT[scene.fine]:
        yield (np.where(np.arange(count) >= share * count, -scene.current_a, 0.0),)


def _back_emf(scene: Scene) -> Iterator[Shapes]:
    if scene.speed_rad_s is not None:
        yield (-scene.speed_rad_s,)


def _hysteresis(scene: Scene) -> Iterator[Shapes]:
    if scene.turning_rad_s is not None:
        yield (-np.abs(scene.turning_rad_s) * scene.current_a,)


def _speed_delay(scene: Scene) -> Iterator[Shapes]:
    speed = scene.speed_rad_s
    if speed is not None:
        for samples in (1, 4):
            yield (_delayed(speed, samples) - speed,)


COLOURED_NOISE = 'coloured_noise'
HYSTERESIS = 'hysteresis'
CHANGE = 'change'
LOAD = 'load'

EFFECTS: dict[str, Effect] = {
    effect.name: effect
    for effect in (
        Effect(
            'rotor',
            _rotor,
            '{motor}.speed_source: rotor  # a rotor turns whose speed is not measured; or publish '
            "it in motor/torque's velocity",
            without_speed=True,
            hides_resistance=True,
        ),
        Effect(
            'current_offset',
            _current_offset,
            'torque.offset: {offset_nm:.3g}  # the current, or the voltage, has an offset',
        ),
        Effect(
            'lost_voltage',
            _lost_voltage,
            '{motor}.brush_drop: {amount:.3g}  # brushes or driver take that many volts; while the '
            'current keeps its sign an offset of the current looks the same',
            negative_remedy='look for an offset, or a gain, of voltage and current: more voltage '
            'seems to reach the winding than is stated',
        ),
        Effect(
            'dead_zone',
            _dead_zone,
            'publish the voltage at the terminals instead of the command, or add dead_zone to '
            '{motor}.context_nodes: the driver takes {amount:.3g} V off its command',
            credible=(0.0, math.inf),
            largest_share=0.5,
        ),
        Effect(
            'sag',
            _sag,
            'publish the measured voltage instead of the command: the supply sags or wanders',
        ),
        Effect(
            'delay',
            _delay,
            '{motor}.delay: estimate  # voltage acts later than it is stamped',
            credible=LATER,
        ),
        Effect(
            'current_lag',
            _current_lag,
            'take the filter off the current, or delay the voltage alike ({motor}.delay: '
            'estimate): the sensor lags',
            credible=LATER,
        ),
        Effect(CHANGE, _change, 'call ~/reset: the motor has become another one'),
        Effect(
            'back_emf_constant',
            _back_emf,
            '{motor}.back_emf_constant: {kb:.4g}  # Kb differs by {amount:.3g} V s/rad, or the '
            'voltage by its scale; beside a speed without noise {motor}.context_nodes may hold it',
            needs_speed=True,
        ),
        Effect(
            HYSTERESIS,
            _hysteresis,
            'add hysteresis to {motor}.context_nodes: the resistance grows with the speed, by '
            '{amount:.3g} V s/(rad A)',
            credible=(0.0, math.inf),
        ),
        Effect(
            'speed_delay',
            _speed_delay,
            'stamp the speed when it was measured: it comes later than the current',
            needs_speed=True,
        ),
    )
}
"""Every effect by its name."""

LOADS = {
    'load_torque': 'load_torque for a load that does not vary',
    'quadratic_friction': 'quadratic_friction for a fan',
}
"""Context nodes that a load on the shaft may be, with what each is for."""


def load_remedy(*nodes: str) -> str:
    """Return what to do about a load on the shaft of a rotor.

    Args:
        nodes: context nodes or stated values among those that a load may be.
    """
    always = "publish the speed in motor/torque's velocity: a load that varies is followed then"
    others = [words for node, words in LOADS.items() if node not in nodes]
    if not others:
        return always
    return (
        f'{always}; or add to {{motor}}.context_nodes {", or ".join(others)}: more acts on the '
        'shaft than inertia and friction, or the current has an offset'
    )


REMEDIES: dict[str, str] = {name: effect.remedy for name, effect in EFFECTS.items()} | {
    COLOURED_NOISE: 'take the filter off the torque signal, undo a moving average by '
    "torque.expression: unsmoothed(raw, WEIGHT), or sample more slowly: the sensor's noise has a "
    'memory',
    COASTING: '{motor}.coasting: true  # the driver opens the winding at 0 V; or let it brake',
    LOAD: load_remedy(),
}
"""What to do about every suspect, by its name; ``{motor}`` stands for the motor's name."""

ROTOR_REMEDIES: dict[str, str] = dict.fromkeys(
    LATE,
    'set {motor}.delay to estimate, or declare it in s, where the voltage acts later than it is '
    'stamped; where the current sensor lags, take its filter off: a delay does not make up for '
    'that',
) | {
    CHANGE: 'call ~/reset where the motor has become another one; what is missing in '
    '{motor}.context_nodes looks alike, such as load_torque, or quadratic_friction of a fan'
}
"""The same for a rotor whose speed nobody measures."""

ESTIMATED_REMEDIES: dict[str, str] = dict.fromkeys(
    LATE,
    'take the filter off the current: {motor}.delay is estimated, and explains only a part',
)
"""The same where the delay is estimated."""


def scene_along(
    white_box: WhiteBox,
    voltage_v: Array,
    current_a: Array,
    speed_rad_s: Array | None,
    turning_rad_s: Array | None,
    *,
    fine: bool = False,
) -> Scene:
    """Return what effects are made of.

    Args:
        white_box: of one motor.
        voltage_v: shape (k,): held over every interval.
        current_a: shape (k,): mean over it.
        speed_rad_s: shape (k + 1,): measured; None where it is not.
        turning_rad_s: shape (k + 1,): at which the motor turns; None: as the current says.
        fine: as of the scene.
    """
    assert isinstance(white_box, MotorWhiteBox)
    mean_rad_s = current_a * white_box.torque_constant
    if turning_rad_s is not None:
        mean_rad_s = interval_means(turning_rad_s)
    return Scene(
        voltage_v,
        current_a,
        None if speed_rad_s is None else interval_means(speed_rad_s),
        fine=fine,
        has_rotor=white_box.has_rotor,
        turning_rad_s=None if HYSTERESIS in white_box.context_nodes else mean_rad_s,
    )


def possible_effects(scene: Scene) -> Iterator[tuple[Effect, list[Shapes]]]:
    """Yield every effect that this motor can have, with the shapes that it may take."""
    has_speed = scene.speed_rad_s is not None
    turns = has_speed or scene.has_rotor
    for effect in EFFECTS.values():
        if not (effect.needs_speed and not has_speed) and not (effect.without_speed and turns):
            yield effect, list(effect.alternatives(scene))
