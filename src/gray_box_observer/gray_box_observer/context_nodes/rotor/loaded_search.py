"""Gauss-Newton on the free run of a current whose motor has a load that varies.

The load at given parameters is a search of its own: dry friction is not linear in it, nor is what
brushes drop, and where a rotor or a current is held the load has no derivative. Without both the
run is nearly linear. So the load takes them for its own first; then they are taken off again, and
the load is looked for once more.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from gray_box_observer.context_nodes.pieces import Pieces
from gray_box_observer.context_nodes.recursive.normal_equations import difference_noise
from gray_box_observer.context_nodes.rotor.breakaway_start import DRY_FRICTION
from gray_box_observer.context_nodes.rotor.free_runs import FreeRuns, guessed_starts
from gray_box_observer.context_nodes.rotor.history_unknowns import LoadWalk, knot_places
from gray_box_observer.context_nodes.rotor.logarithms import LogPrior
from gray_box_observer.context_nodes.rotor.weak_start import BRUSHES
from gray_box_observer.context_nodes.rotor.window import Window
from gray_box_observer.context_nodes.rotor.window_equations import robust_cost
from gray_box_observer.context_nodes.rotor.window_search import LEAST_START_GAIN, Search
from gray_box_observer.white_box.declaration import State
from gray_box_observer.white_box.interface import Array
from gray_box_observer.white_box.motor import MotorWhiteBox

HOLDERS = (DRY_FRICTION, BRUSHES)
"""Effects that may hold a state."""

MOST_ROUNDS = 8
"""Linearisations in which a load is moved by itself, at most."""

SHARES = (1.0, 0.3, 0.1)
"""Shares of such a step that are tried."""

LOAD_ATTEMPTS = 2
"""Of the steps tried from one place the first for which the load is looked for anew."""

WORTH = 1.0
"""Gain of chi-square that is worth that."""

KEPT_PROMISE = 0.5
"""Share of the gain that a step promises from which its load is good enough."""


class LoadedSearch(Search):
    """Damped Gauss-Newton from one start, of a window with a load that varies.

    Args:
        white_box: of one motor with a rotor.
        window: the samples, without speed.
        prior: decides what the samples leave open.
        logarithms: shape (parameter,): where it begins.
        starts: shape (history, unknown): first states and load there, where they were found before;
            None: they are looked for.
    """

    looks_for_noise = False

    def __init__(
        self,
        white_box: MotorWhiteBox,
        window: Window,
        prior: LogPrior,
        logarithms: Array,
        starts: Array | None = None,
    ) -> None:
        super().__init__(white_box, window, prior, logarithms)
        nodes = white_box.context_nodes
        self._holders = [nodes.index(name) for name in HOLDERS if name in nodes]
        self._inertia = nodes.index('inertia')
        self._has_load = starts is not None
        if starts is not None:
            self.starts = starts.copy()

    @property
    def load(self) -> LoadWalk:
        """The load that is laid over the window."""
        load = self.window.unknowns.load
        assert load is not None
        return load

    def with_walk(self, walk: float) -> LoadedSearch:
        """Return a search that begins where this one stands, with another walk of the load.

        Args:
            walk: variance that the load gains in a second, in (rad/s2)^2/s.
        """
        unknowns = replace(self.window.unknowns, load=replace(self.load, walk=walk))
        window = replace(self.window, unknowns=unknowns)
        return LoadedSearch(self.white_box, window, self.prior, self.logarithms, self.starts)

    def settle(self) -> Pieces[None]:
        """Run where the search begins; a load that is not known is moved to where it fits best."""
        if not self._has_load:
            for row in range(self.starts.shape[0]):
                yield from self._settle_history(row)
        self._runs = yield from self._run(self.logarithms, self.starts)
        if self._runs is not None:
            self.scale_a = self._scale(self._at.residual_a)

    def _settle_history(self, row: int) -> Pieces[None]:
        """Move first states and load of a history by themselves: none waits for another one."""
        alone = self._alone(row, None)
        values = self.white_box.values(np.exp(self.logarithms))
        has_holders = any(values.get(name, 0.0) > 0.0 for name in HOLDERS)
        if has_holders:
            known_values = {n: v for n, v in self.white_box.known.items() if n not in HOLDERS}
            smooth = self._alone(row, None, replace(self.white_box, known=known_values))
            logarithms = self.logarithms.copy()
            logarithms[self._holders] = self._lower[self._holders]
            if (yield from smooth._descend_load(logarithms)):
                smooth._take_holders_off(values)
            alone.starts = smooth.starts
        has_run = yield from alone._descend_load(self.logarithms)
        if not has_run and has_holders:
            alone.starts = guessed_starts(self.white_box, np.exp(self.logarithms), alone.window)
            has_run = yield from alone._descend_load(self.logarithms)
        if has_run:
            self.starts[row] = alone.starts[0]

    def _alone(
        self, row: int, starts: Array | None, white_box: MotorWhiteBox | None = None
    ) -> LoadedSearch:
        """Return a search of one history at the same values: what all of them tell stays known.

        Args:
            row: of the history.
            starts: first states and load there, where they were found before.
            white_box: with the same context nodes; None: that of this search.
        """
        window = replace(
            self.window,
            histories=(self.window.histories[row],),
            voltage_elsewhere_v=self.window.largest_voltage_v,
        )
        box = self.white_box if white_box is None else white_box
        alone = LoadedSearch(box, window, self.prior, self.logarithms, starts)
        alone._floor_a = self._floor_a
        alone._start_std = self._start_std[row : row + 1]
        alone._start_precision = self._start_precision[row : row + 1]
        return alone

    def _take_holders_off(self, values: Mapping[str, float]) -> None:
        """Take off a load what it has taken for its own.

        Without what brushes drop, the speed was higher by as many volts of back-EMF.

        Args:
            values: of every term, friction and brushes among them.
        """
        inertia = values['inertia']
        interval_s = self.window.histories[0].interval_s
        loads = self.starts[0, self.window.unknowns.loads]
        current, speed = self._at.runs[0].states.T
        noise = max(difference_noise(self.window.histories[0].current_a), self._floor_a)
        drop_v = values.get(BRUSHES, 0.0) * np.tanh(current / noise)
        excess = drop_v / values['back_emf_constant']
        torque = values.get('viscous_friction', 0.0) * _middle(excess)
        torque -= values.get(DRY_FRICTION, 0.0) * np.sign(_middle(speed - excess))
        shift = torque / inertia + np.diff(excess) / interval_s
        knot = np.round(knot_places(interval_s, loads.size)).astype(int)
        count = np.maximum(np.bincount(knot, minlength=loads.size), 1)
        loads += np.bincount(knot, shift, minlength=loads.size) / count
        self.starts[0, State.SPEED] -= excess[0]

    def _descend_load(self, logarithms: Array) -> Pieces[bool]:
        """Step until no load moves, at held parameters; tell whether these can be run.

        A load is free to take what the readings do not call noise, however large that is at first.

        Args:
            logarithms: shape (parameter,).
        """
        self._runs = yield from self._run(logarithms, self.starts)
        if self._runs is None:
            return False
        noise = max(difference_noise(self.window.histories[0].current_a), self._floor_a)
        for _ in range(MOST_ROUNDS):
            scale = self._scale(self._at.residual_a)
            noise = min(noise, scale)
            equations = self._equations(self._weights(scale), noise)
            steps = equations.start_steps(np.zeros(logarithms.size))
            gain = yield from self._move_load(logarithms, steps, scale, noise)
            if gain < LEAST_START_GAIN:
                break
        return True

    def _move_load(
        self, logarithms: Array, steps: Array, scale: float, noise: float
    ) -> Pieces[float]:
        """Move first states and load as far as that leads down; return what it gains.

        Args:
            logarithms: shape (parameter,).
            steps: shape (history, unknown).
            scale: of the residual, from which its outliers are told.
            noise: of the readings, in whose unit the residual counts.
        """

        def cost(runs: FreeRuns, starts: Array) -> float:
            of_samples = robust_cost(runs.residual_a, scale, leaves_out=False)
            excess = ((scale / noise) ** 2 - 1.0) * of_samples
            return self._total(runs.residual_a, scale, logarithms, starts) + excess

        before = cost(self._at, self.starts)
        for share in SHARES:
            starts = self.starts + share * steps
            runs = yield from self._run(logarithms, starts)
            gain = -np.inf if runs is None else before - cost(runs, starts)
            if runs is not None and gain > 0.0:
                self.starts = starts
                self._runs = runs
                return gain
        return 0.0

    def _run_after(
        self, logarithms: Array, starts: Array, promised_gain: float, attempt: int
    ) -> Pieces[tuple[FreeRuns | None, Array]]:
        """Run where a step leads; where it does not keep its promise, look for the load anew."""
        runs = yield from self._run(logarithms, starts)
        before = self._total(self._at.residual_a, self.scale_a, self.logarithms, self.starts)
        most = before - KEPT_PROMISE * promised_gain
        total = np.inf
        if runs is not None:
            total = self._total(runs.residual_a, self.scale_a, logarithms, starts)
        if attempt >= LOAD_ATTEMPTS or promised_gain < WORTH:
            return runs, starts
        for known_starts in (starts, None):
            if total <= most:
                break
            other = LoadedSearch(self.white_box, self.window, self.prior, logarithms, known_starts)
            yield from other._settle_anew() if known_starts is not None else other.settle()
            if other.runs is None:
                continue
            other_total = self._total(other.runs.residual_a, self.scale_a, logarithms, other.starts)
            if other_total < total:
                runs = other.runs
                starts = other.starts
                total = other_total
        return runs, starts

    def _settle_anew(self) -> Pieces[None]:
        """Move a load that was found before to where it fits best now."""
        for row in range(self.starts.shape[0]):
            alone = self._alone(row, self.starts[row : row + 1])
            if (yield from alone._descend_load(self.logarithms)):
                self.starts[row] = alone.starts[0]
        self._runs = yield from self._run(self.logarithms, self.starts)


def _middle(signal: Array) -> Array:
    """Return the middle of every interval, shape (k,), of a signal at its ends."""
    return np.asarray(0.5 * (signal[1:] + signal[:-1]))
