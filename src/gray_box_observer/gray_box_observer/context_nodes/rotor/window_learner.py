"""What windows of samples tell of a motor with a rotor: each joins what those before it have told.

What a window has told is kept as a Gaussian of the parameters' logarithms and joined with what the
next one tells: windows share no sample, so that nothing is counted twice. Where a window
contradicts what was known, the motor has changed, and that is forgotten.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from gray_box_observer.context_nodes.pieces import Pieces
from gray_box_observer.context_nodes.recursive.normal_equations import difference_noise
from gray_box_observer.context_nodes.rotor.breakaway_start import begins_held
from gray_box_observer.context_nodes.rotor.effect_shares import largest_excess, voltage_shares
from gray_box_observer.context_nodes.rotor.history_unknowns import Unknowns
from gray_box_observer.context_nodes.rotor.logarithms import (
    Fit,
    LogPrior,
    symmetric_inverse,
)
from gray_box_observer.context_nodes.rotor.natural_scale import shares_of_scale
from gray_box_observer.context_nodes.rotor.soft_friction import soft_friction_pull
from gray_box_observer.context_nodes.rotor.voltage_noise import NO_NOISE, VoltageNoise
from gray_box_observer.context_nodes.rotor.weak_start import weak_starts
from gray_box_observer.context_nodes.rotor.window import Window
from gray_box_observer.context_nodes.rotor.window_fit import fit_window
from gray_box_observer.errors import ConfigurationError
from gray_box_observer.safe_io.saved_state import ArrayRule, check_arrays, check_covariance
from gray_box_observer.white_box.declaration import TERMS, State
from gray_box_observer.white_box.interface import Array, bounds
from gray_box_observer.white_box.motor import MotorWhiteBox

VAGUE = 5.0
"""Standard deviation of the logarithm of a parameter of which nothing is stated."""

MEMORY = 0.98
"""Share of what is known that a full window leaves: a motor is never quite the same."""

SHARP = 0.3
"""Standard deviation of a logarithm up to which it is near enough to Gaussian to be remembered."""

SHARP_SHARE = 0.1
"""The same of inertia and frictions, which share what is known well of their sum.

Under a ramp the acceleration takes a constant torque, as dry friction does. Where one of them is
off by a quarter, a Gaussian of logarithms is not near enough: windows at other values would turn
the sum that they know, and seem to know the parts.
"""

FEWEST_MOVES = 3
"""Moves of the voltage from which a motor is told: of a step or two a search may end at another
motor that fits as well."""

SEARCHED = 1024
"""Newest samples that a start is looked for in."""

POOR = 1.5
"""Noise of a fit, over that of second differences, from which another start is looked for."""

HOPELESS = 4.5
"""The same from which the motor is called a misfit, and more samples are not asked."""

FRICTIONS = ('viscous_friction', 'coulomb_friction', 'quadratic_friction')

PULLED = 0.02
"""Shift of the inertia's logarithm by softened friction, from which frictions are shifted too."""

REACH_OF_INDUCTANCE = 2.0
"""Move of the inductance's logarithm, at most, with which the others move along."""

LEAST_SHARE = 0.01
"""Information of a window, over that of what is remembered, from which it may contradict that."""


class WindowLearner:
    """Context nodes of one motor with a rotor, and what is known of them.

    Args:
        white_box: the physics, with the inertia among its context nodes.
        initial: shape (1, parameter): where to start, SI units.
        initial_relative_std: shape (1, parameter): how well the initial values are known; 0:
            nothing is stated. None: of none of them.
        drift_threshold: chi-square from which a window contradicts what was known.

    Attributes:
        logarithms: shape (parameter,): where the motor stands.
        covariance: shape (parameter, parameter): of these.
        share, reach: shape (parameter,): voltage shares, and their 3-sigma bound.
        noise_a: standard deviation of the current's noise; 0 before the first fit.
        noise_memory: of the current (:mod:`~gray_box_observer.context_nodes.rotor.noise_memory`).
        voltage_noise: of a measured voltage, as the newest fit has found it.
        memory: what full windows have told; None before the first one.
        is_settled: whether the motor is explained.
        has_rivals: whether other ends explain the samples as well.
        is_new_motor: whether the newest window is another motor's than the one before.
        is_in_doubt: whether what explained the motor so far does not explain the window under way,
            and another explanation is searched; beside a measured speed nothing is believed then.
        counts: of what was met, by a name for diagnostics.
        speed_measured: whether windows hold a speed that is fitted too.
    """

    speed_measured = False

    def __init__(
        self,
        white_box: MotorWhiteBox,
        initial: Array,
        initial_relative_std: Array | None,
        drift_threshold: float,
    ) -> None:
        if not white_box.has_rotor or initial.shape[0] != 1:
            raise ConfigurationError('the rotor rule is for one motor whose inertia is unknown')
        self._white_box = white_box
        self._drift_threshold = drift_threshold
        self.noise_memory = 0.0
        self._lower, self._upper = bounds(white_box.parameters)
        theta = np.clip(np.asarray(initial, dtype=float)[0], self._lower, self._upper)
        nothing = np.zeros_like(theta)
        stated_std = nothing if initial_relative_std is None else initial_relative_std[0]
        self._is_stated = stated_std > 0.0
        is_share = [TERMS[name].state is State.SPEED for name in white_box.context_nodes]
        self._sharp_std = np.where(is_share, SHARP_SHARE, SHARP)
        std = np.where(self._is_stated, stated_std, VAGUE)
        self._data_sheet = LogPrior(np.log(theta), np.diag(std**-2.0))
        self.memory: LogPrior | None = None
        self.logarithms = np.log(theta)
        self.covariance = np.diag(std**2)
        self.share = np.zeros_like(theta)
        self.reach = np.zeros_like(theta)
        self.noise_a = 0.0
        self.voltage_noise = NO_NOISE
        self._soft_shift = np.zeros(self.logarithms.size)  # of what is remembered
        self.is_settled = False
        self._searches_elsewhere = True
        self.has_rivals = True
        self.is_new_motor = False
        self.is_in_doubt = False
        self.counts = {'motor changes': 0, 'fits': 0, 'windows without fit': 0}

    @property
    def theta(self) -> Array:
        """Present values, shape (parameter,)."""
        result: Array = np.exp(self.logarithms).clip(self._lower, self._upper)
        return result

    def begin_at(self, theta: Array, *, searches_elsewhere: bool = True) -> None:
        """Begin where nearly the same white box has explained the same samples.

        Args:
            theta: shape (parameter,): there.
            searches_elsewhere: whether the first fit looks for other ends, too.
        """
        self.logarithms = np.log(np.clip(theta, self._lower, self._upper))
        self.is_settled = True
        self._searches_elsewhere = searches_elsewhere

    def learn(self, window: Window, *, is_full: bool) -> Pieces[bool]:
        """Fit a window; tell whether a fit was found. Before that nothing changes.

        Args:
            window: the samples.
            is_full: whether what it tells is kept where the motor is explained.
        """
        self.is_new_motor = False
        fit = (yield from self._solvable(window)) if window.spread_a > 0.0 else None
        self.is_in_doubt = False
        if fit is None:
            self.counts['windows without fit'] += 1
            return False
        self.counts['fits'] += 1
        information = fit.information
        if self.memory is not None:
            information = information + self.memory.precision
        shares = shares_of_scale(self._white_box, fit.theta, window)
        weak_precision = np.minimum(VAGUE**-2.0, shares**2)
        self.logarithms = fit.logarithms
        prior = np.where(self._is_stated, np.diagonal(self._data_sheet.precision), weak_precision)
        covariance = symmetric_inverse(information + np.diag(prior))
        shift = covariance @ self._soft_pull(fit)
        pull = self._counted(shift)
        spread = fit.spread + np.outer(pull, pull)
        self.covariance = self._within_reach(covariance) + spread
        self.share = voltage_shares(self._white_box, fit.theta, fit.runs)
        excess = largest_excess(fit.theta, information, symmetric_inverse(information), fit.spread)
        self.reach = np.where(self.share > 0.0, excess, 0.0) * self.share
        if self._is_ambiguous(window):
            self.covariance += SHARP**2 * np.eye(prior.size)
            self.share = np.zeros_like(prior)
            self.reach = np.zeros_like(prior)
        self.noise_a = math.hypot(fit.noise_a, fit.voltage_noise_a)
        self.voltage_noise = fit.voltage_noise
        self.has_rivals = bool(fit.spread.any())
        if self.is_settled and is_full:
            self._remember(symmetric_inverse(information + np.diag(weak_precision)) + fit.spread)
            self._soft_shift = shift
        return True

    def _counted(self, shift: Array) -> Array:
        """Return what counts of a shift by softened friction, shape (parameter,).

        Frictions are those of the softened law, but where it pulls the inertia: there it shares
        with them what it takes.
        """
        is_friction = [name in FRICTIONS for name in self._white_box.context_nodes]
        place = self._white_box.context_nodes.index('inertia')
        if abs(shift[place]) > PULLED:
            return shift
        return np.where(is_friction, 0.0, shift)

    def _soft_pull(self, fit: Fit) -> Array:
        """Return how softened friction pulls the logarithms, by a fit and by what was known."""
        pull = soft_friction_pull(fit.runs, fit.noise_a)
        return pull if self.memory is None else pull + self.memory.precision @ self._soft_shift

    def window(self, samples: Array) -> Window:
        """Cut samples, shape (signal, n), into signal histories."""
        unknowns = Unknowns(noise_memory=self.noise_memory)
        return Window.from_samples(self._white_box, samples, unknowns)

    def _fitted(
        self, window: Window, prior: LogPrior, starts: Sequence[Array]
    ) -> Pieces[Fit | None]:
        """Search from some starts for what explains a window."""
        return fit_window(self._white_box, window, prior, starts)

    def _fitted_again(self, window: Window) -> Pieces[Fit | None]:
        """Search from where the motor stands, and elsewhere where that was not the only end."""
        box = self._white_box
        starts = [self.theta]
        return fit_window(box, window, self._prior(), starts, tries_others=self.has_rivals)

    def _is_ambiguous(self, window: Window) -> bool:
        """Tell whether other motors than the one found might explain the samples.

        The voltage has hardly moved, or no rotor shows, so that its back-EMF may hide in any
        resistance.
        """
        if self.memory is None and window.moves < FEWEST_MOVES:
            return True
        place = self._white_box.context_nodes.index('inertia')
        return bool(self.covariance[place, place] > SHARP**2)

    def _within_reach(self, covariance: Array) -> Array:
        """Return a covariance in which an inductance moves the others no further than it can.

        An inductance of which the samples tell nothing may be far smaller. But what it does goes
        with itself: where it is next to nothing the others move as by a factor of e.
        """
        nodes = self._white_box.context_nodes
        if 'inductance' not in nodes:
            return covariance
        place = nodes.index('inductance')
        variance = float(covariance[place, place])
        if not variance > REACH_OF_INDUCTANCE**2:
            return covariance
        slopes = covariance[place] / variance
        result = covariance - (variance - REACH_OF_INDUCTANCE**2) * np.outer(slopes, slopes)
        result[place, place] = variance
        return np.asarray(0.5 * (result + result.T))

    def _remember(self, covariance: Array) -> None:
        """Keep what is known of those parameters that the samples have told of."""
        sharp = np.flatnonzero(np.diagonal(covariance) < self._sharp_std**2)
        precision = np.zeros_like(covariance)
        precision[np.ix_(sharp, sharp)] = MEMORY * symmetric_inverse(
            covariance[np.ix_(sharp, sharp)]
        )
        self.memory = LogPrior(self.logarithms, precision)

    def _solvable(self, window: Window) -> Pieces[Fit | None]:
        """Fit a window; None too where samples are so absurd that nothing can be solved."""
        try:
            return (yield from self._searched(window))
        except np.linalg.LinAlgError:
            return None

    def _searched(self, window: Window) -> Pieces[Fit | None]:
        """Fit a window from where the motor stands, or from anywhere where that does not fit."""
        fit = None
        if not self._searches_elsewhere:
            fit = yield from fit_window(
                self._white_box, window, self._prior(), [self.theta], tries_others=False
            )
            self._searches_elsewhere = True
            self.is_settled = fit is not None and not self._is_poor(fit)
            return fit
        if self.is_settled:
            fit = yield from self._fitted_again(window)
            if fit is not None and not self._is_poor(fit) and not self._contradicts(fit):
                return fit
            self.is_in_doubt = True
        other = yield from self._searched_anywhere(window)
        if self.is_settled and self.memory is not None and other is not None:
            self.counts['motor changes'] += 1
            self.memory = None
            self.is_new_motor = True
        self.is_settled = other is not None and not self._is_poor(other)
        return other

    def _searched_anywhere(self, window: Window) -> Pieces[Fit | None]:
        """Fit without regard to what was known, from every start there is."""
        newest = window.tail(SEARCHED) if window.current_a.size > SEARCHED else window
        starts = [self.theta, *weak_starts(self._white_box, newest)]
        fit = yield from self._fitted(newest, self._prior_anywhere(), starts)
        if fit is None or newest is window or self._is_hopeless(fit):
            return fit
        return (yield from self._fitted_whole(window, fit))

    def _fitted_whole(self, window: Window, newest: Fit) -> Pieces[Fit | None]:
        """Fit a window whose newest samples are explained by a fit.

        Where friction holds the rotor first these tell little of what the oldest show.
        """
        starts = [newest.theta]
        if begins_held(self._white_box, window):
            starts += weak_starts(self._white_box, newest.runs.window)
        return (yield from self._fitted(window, self._prior_anywhere(), starts))

    def _prior_anywhere(self) -> LogPrior:
        """Return what is believed of a motor of which windows have told nothing."""
        return self._data_sheet

    def _is_poor(self, fit: Fit) -> bool:
        """Tell whether the residual is larger than the noise."""
        return fit.noise_a > POOR * _sharp_noise(fit)

    def _is_hopeless(self, fit: Fit) -> bool:
        """Tell whether the newest samples alone are so badly explained that more are no help."""
        return fit.noise_a > HOPELESS * _sharp_noise(fit)

    def _contradicts(self, fit: Fit) -> bool:
        """Tell whether a window says other than what was known before it.

        The fit knows both. By how much the window alone would move it follows from its own
        information, and where that is a small share of the memory's nothing does: there the
        tolerance of the fit would be taken for a move.
        """
        if self.memory is None:
            return False
        sharp = np.flatnonzero(np.diagonal(self.memory.precision) > 0.0)
        precisions, axes = np.linalg.eigh(self.memory.precision[np.ix_(sharp, sharp)])
        root = axes * np.sqrt(np.maximum(precisions, 0.0))
        pull = root.T @ (fit.logarithms - self.memory.mean)[sharp]
        spread = root.T @ symmetric_inverse(fit.information)[np.ix_(sharp, sharp)] @ root
        variances, directions = np.linalg.eigh(spread)
        pulls = directions.T @ pull
        chi_square = float((1.0 + np.minimum(variances, 1.0 / LEAST_SHARE)) @ pulls**2)
        return not chi_square < self._drift_threshold

    def _prior(self) -> LogPrior:
        return self._data_sheet if self.memory is None else self._data_sheet.joined(self.memory)

    def arrays(self) -> dict[str, Array]:
        """Return what a checkpoint holds of it, beside flags."""
        memory = self.memory or self._data_sheet
        return {
            'logarithms': self.logarithms.copy(),
            'covariance': self.covariance.copy(),
            'noise': np.array([self.noise_a]),
            'voltage_noise': np.array(
                [self.voltage_noise.variance_v2, self.voltage_noise.held_share]
            ),
            'soft_shift': self._soft_shift.copy(),
            'memory_mean': memory.mean.copy(),
            'memory_precision': memory.precision.copy(),
            'share': self.share.copy(),
            'reach': self.reach.copy(),
        }

    def restore(self, plain: Mapping[str, Any], arrays: dict[str, Array]) -> None:
        """Take back arrays that :meth:`check` lets pass, and flags."""
        self.is_settled = plain['settled']
        self.is_in_doubt = False
        self.logarithms = arrays['logarithms']
        self.covariance = arrays['covariance']
        self.noise_a = float(arrays['noise'][0])
        self.voltage_noise = NO_NOISE
        if 'voltage_noise' in arrays and arrays['voltage_noise'][0] > 0.0:  # not of early releases
            self.voltage_noise = VoltageNoise(*arrays['voltage_noise'].tolist())
        self._soft_shift = np.zeros(self.logarithms.size)
        if 'soft_shift' in arrays:  # not in files of early releases
            self._soft_shift = arrays['soft_shift']
        self.share = arrays['share']
        self.reach = arrays['reach']
        self.memory = None
        if plain['remembers']:
            self.memory = LogPrior(arrays['memory_mean'], arrays['memory_precision'])
        self.has_rivals = plain.get('rivals', True)

    def check(self, arrays: Mapping[str, Array]) -> None:
        """Refuse arrays that could not have been learnt.

        Raises:
            CheckpointError: one is missing, or none of this rule.
        """
        n = self.logarithms.size
        rules = {
            'logarithms': ArrayRule((n,), -100.0, 100.0),
            'covariance': ArrayRule((n, n)),
            'noise': ArrayRule((1,), 0.0),
            'memory_mean': ArrayRule((n,), -100.0, 100.0),
            'memory_precision': ArrayRule((n, n)),
            'share': ArrayRule((n,), 0.0),
            'reach': ArrayRule((n,), 0.0, endless=True),
        }
        if 'voltage_noise' in arrays:  # not in files of early releases
            rules['voltage_noise'] = ArrayRule((2,), 0.0)
        if 'soft_shift' in arrays:
            rules['soft_shift'] = ArrayRule((n,))
        check_arrays(arrays, rules)
        check_covariance('covariance', arrays['covariance'])
        check_covariance('memory_precision', arrays['memory_precision'])


def _sharp_noise(fit: Fit) -> float:
    """Return the noise of a fit by second differences."""
    return max(difference_noise(fit.runs.residual_a), fit.least_noise_a)
