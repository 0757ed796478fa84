"""Fits a form of the physics to remembered samples, and compares such fits.

A dead zone changes the voltage that the white box takes. The samples are fit with that of the fit
before, until a fit moves it no more (docs/METHOD.md, Which effects).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from gray_box_observer.context_nodes import Estimate, RotorUpdate
from gray_box_observer.context_nodes.pieces import Pieces
from gray_box_observer.context_nodes.rotor.natural_scale import shares_of_scale
from gray_box_observer.context_nodes.rotor.window import Window
from gray_box_observer.fit_test import FitVerdict
from gray_box_observer.fit_test.speed_basis import leaves_much
from gray_box_observer.fit_test.twin_effects import LOST_VOLTAGE, TOLD_APART
from gray_box_observer.observer.motor_forms.motor_form import FormKind, MotorForm
from gray_box_observer.observer.motor_forms.open_forms import OpenForms
from gray_box_observer.observer.motor_forms.standstill import StandstillLine
from gray_box_observer.observer.motor_forms.voltage_path import SETTLED, beyond_start
from gray_box_observer.samples.replay_buffer import VOLTAGE
from gray_box_observer.settings.motor_configuration import COASTING, DEAD_ZONE
from gray_box_observer.white_box.declaration import TERMS
from gray_box_observer.white_box.interface import Array

MOST_ZONES = 4
"""Fits of a form with a dead zone, after the first."""

LARGEST_ZONE = 0.5
"""Largest dead zone, as a share of the root mean square of the command."""

NEAR_ZONE = 0.02
"""Share of a dead zone by which the last fit moves it at most."""

LARGEST_STD = 0.25
"""Relative standard deviation of a parameter up to which it is told. Samples that come more slowly
than L/R say nothing of the inductance, and a rotor shows all the same."""

SMALL = 0.03
"""Share of the largest effect that signals allow, as which one begins that nothing is known of."""


@dataclass(frozen=True, slots=True, eq=False)
class FormFit:
    """What a form has learnt of some samples.

    Attributes:
        kind: of the form.
        form: itself.
        estimate: what it has learnt.
    """

    kind: FormKind
    form: MotorForm
    estimate: Estimate

    @property
    def settle_s(self) -> float:
        """Time in s behind the start of a signal history that tells nothing."""
        lag = self.kind.lag
        return SETTLED * lag.lag_s if lag is not None and lag.settles else 0.0

    @property
    def is_misfit(self) -> bool:
        """Whether it does not explain the samples."""
        return self.form.fit.assessment(0).verdict is FitVerdict.MISFIT

    @property
    def leaves_much(self) -> bool:
        """Whether it does not explain the samples, or warns of more than is believed."""
        assessment = self.form.fit.assessment(0)
        is_warned = assessment.verdict is FitVerdict.WARNING
        return self.is_misfit or (is_warned and leaves_much(assessment))

    def tells(self, name: str) -> bool:
        """Tell whether the samples tell a parameter; one that the form does not have is known."""
        estimate = self.estimate
        return all(
            estimate.std[0, place] < LARGEST_STD * estimate.value[0, place]
            for place, parameter in enumerate(estimate.parameters)
            if parameter.name == name
        )

    @property
    def explains(self) -> bool:
        """Whether it was tested, and nothing is left that counts."""
        is_tested = self.form.fit.assessment(0).verdict is not FitVerdict.UNTESTED
        return is_tested and not self.leaves_much


class FormFitter:
    """Fits forms of one motor to samples.

    Args:
        open_forms: that the motor may take.
        stamp_ns: of the newest sample.
        standstill: what pauses of the motor have told; None: nothing.
    """

    def __init__(
        self, open_forms: OpenForms, stamp_ns: int, standstill: StandstillLine | None = None
    ) -> None:
        self._open = open_forms
        self._stamp_ns = stamp_ns
        self._standstill = standstill

    def first(
        self, kind: FormKind, content: Array, before: MotorForm | None = None
    ) -> Pieces[FormFit]:
        """Fit a form to samples.

        In the short histories of a driver that coasts the recursive rule is led astray by a noisy
        speed.

        Args:
            kind: of the form.
            content: shape (signal, 1, n): the samples.
            before: the form that has learnt fewer of them, where it can go on; None: none has.
        """
        form = self._made(kind) if before is None or not before.can_go_on else before
        asks_speed = COASTING in kind.effects
        estimate = yield from form.learn_remembered(content, self._stamp_ns, asks_speed=asks_speed)
        return FormFit(kind, form, estimate)

    def _made(self, kind: FormKind) -> MotorForm:
        """Make a form; one with a load that varies knows what pauses have told.

        A speed that follows the current looks like pauses, but there no load varies.
        """
        form = self._open.make(kind)
        nodes = form.context_nodes
        if self._standstill is not None and form.white_box.load_varies:
            has_drop = form.white_box.values(nodes.theta[0]).get(LOST_VOLTAGE, 0.0) > 0.0
            if isinstance(nodes, RotorUpdate) and has_drop == self._standstill.has_drop:
                nodes.recall(self._standstill.beliefs)
        return form

    def again(
        self,
        kind: FormKind,
        before: FormFit,
        content: Array,
        *,
        searches_elsewhere: bool = True,
    ) -> Pieces[FormFit]:
        """Fit a form to samples, from where nearly the same one stands.

        Args:
            kind: of the form.
            before: of the other one.
            content: shape (signal, 1, n): the samples.
            searches_elsewhere: whether a rotor is looked for elsewhere, too; else it is a quick
                look.
        """
        form = self._open.make(kind)
        start = _start_of(form, before.estimate, content)
        estimate = yield from form.learn_remembered(
            content, self._stamp_ns, start=start, searches_elsewhere=searches_elsewhere
        )
        return FormFit(kind, form, estimate)

    def with_settled_zone(self, fit: FormFit, content: Array) -> Pieces[FormFit]:
        """Fit a form again, until the commands that its dead zone swallows stay.

        Args:
            fit: of the form; without a dead zone it stays as it is.
            content: shape (signal, 1, n): the samples.
        """
        for _ in range(MOST_ZONES if DEAD_ZONE in fit.kind.effects else 0):
            dead_zone_v = _dead_zone(fit.estimate, content)
            if abs(dead_zone_v - fit.kind.dead_zone_v) <= NEAR_ZONE * dead_zone_v:
                break
            kind = replace(fit.kind, dead_zone_v=dead_zone_v)
            other = yield from self.again(kind, fit, content, searches_elsewhere=False)
            if is_no_better(other, fit, content):
                break  # it is not a dead zone that is left
            fit = other
        return fit


def _start_of(form: MotorForm, before: Estimate, content: Array) -> Array:
    """Return where a form begins, shape (1, parameter).

    Args:
        form: it; a rotor where it has other parameters than are known.
        before: what is known with those of nearly the same form.
        content: shape (signal, 1, n): the samples.
    """
    values = dict(zip((one.name for one in before.parameters), before.value[0], strict=True))
    white_box = form.white_box
    names = white_box.context_nodes
    if names == tuple(values):
        return before.value
    start = np.array(form.context_nodes.theta[0])
    for place, name in enumerate(names):
        start[place] = values.get(name, start[place])
    window = Window.from_samples(white_box, form.driven(content)[:, 0])
    shares = shares_of_scale(white_box, start, window)
    for place, name in enumerate(names):
        is_new = name not in values and not TERMS[name].has_either_sign
        if is_new and 0.0 < shares[place] < math.inf:
            start[place] *= SMALL / shares[place]
    return start[None]


def _dead_zone(estimate: Estimate, content: Array) -> float:
    """Return the dead zone in V that was found, within bounds."""
    place = [parameter.name for parameter in estimate.parameters].index(DEAD_ZONE)
    largest_v = LARGEST_ZONE * float(np.sqrt(np.mean(content[VOLTAGE] ** 2)))
    return min(float(estimate.value[0, place]), largest_v)


def likelihood_gain(fit: FormFit, other: FormFit, content: Array) -> float:
    """Return the log-likelihood by which one form is the better one, by what has settled in both.

    Args:
        fit: of the one.
        other: of the other one.
        content: shape (signal, 1, n): the samples.
    """
    settle_s = max(fit.settle_s, other.settle_s)
    left_a = fit.form.residual(content, settle_s)
    before_a = other.form.residual(content, settle_s)
    return log_likelihood(settled_count(content, settle_s), before_a, left_a)


def is_no_better(fit: FormFit, other: FormFit, content: Array) -> bool:
    """Tell whether a form leaves much, and hardly less than the other one."""
    return fit.leaves_much and likelihood_gain(fit, other, content) < TOLD_APART


def settled_count(content: Array, settle_s: float) -> int:
    """Return how many samples have settled; see :func:`beyond_start`."""
    return int(beyond_start(content, content, settle_s).shape[2])


def log_likelihood(count: int, before_a: float, left_a: float) -> float:
    """Return the log-likelihood that a smaller residual brings; 0 where one is no number.

    Args:
        count: samples that it rests on.
        before_a: root mean square of the one residual.
        left_a: of the other.
    """
    ratio = max(before_a, 1e-300) / max(left_a, 1e-300)
    if ratio == 0.0:  # nothing has settled: the smaller residual is without end
        return -math.inf
    gain = count * math.log(ratio)
    return 0.0 if math.isnan(gain) else float(gain)
