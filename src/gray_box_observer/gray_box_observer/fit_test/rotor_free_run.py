"""The free run of a motor with a rotor, in the form in which residuals are analysed."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from gray_box_observer.context_nodes.pieces import Pieces, completed
from gray_box_observer.context_nodes.recursive.trajectory import LEAST, SampleWindow, input_reach
from gray_box_observer.context_nodes.rotor.free_runs import FreeRuns
from gray_box_observer.context_nodes.rotor.history_unknowns import Unknowns
from gray_box_observer.context_nodes.rotor.loaded_fit import loaded_runs
from gray_box_observer.context_nodes.rotor.rotor_trajectory import state_response
from gray_box_observer.context_nodes.rotor.window import Window
from gray_box_observer.context_nodes.rotor.window_fit import settled_runs
from gray_box_observer.fit_test.free_run import FreeRun
from gray_box_observer.samples.replay_buffer import HELD_VOLTAGE, MOMENT, SPEED
from gray_box_observer.white_box.declaration import State
from gray_box_observer.white_box.flow import swapped_logarithms, to_parameters
from gray_box_observer.white_box.interface import Array, WhiteBox
from gray_box_observer.white_box.motor import MotorWhiteBox

SHORTEST = 1e-6
"""Electrical time constants that an interval lasts at least, of what one state passes on."""

SEEN = 1e-6
"""Share of a deviation that an interval leaves, of which the integration says how much it is: where
L/R is far below an interval, it leaves nothing."""

HELD = 1e-3
"""Share of its speed that an interval leaves of a shaft that friction holds."""


@dataclass(frozen=True, eq=False)
class RotorFreeRun(FreeRun):
    """Free run of a motor with a rotor over k + 1 samples.

    Attributes:
        transitions: shape (k, state, state): derivatives of every interval's end by its start; zero
            at a restart.
        speed_rad_s: shape (k + 1,): of the run.
        runs: the same history by history.
    """

    transitions: Array = field(kw_only=True)
    speed_rad_s: Array = field(kw_only=True)
    runs: FreeRuns = field(kw_only=True)

    def response(self, voltages_v: Array) -> Array:
        """Return how the current answers small further voltages, the rotor with it.

        Args:
            voltages_v: shape (voltage, k): mean over every interval.

        Returns:
            Shape (voltage, k + 1), in A.
        """
        inverse = 1.0 / self.inductance_h
        by_voltage = np.stack(
            [
                self.reach_s * inverse,
                self._passed_on(State.SPEED, State.CURRENT) * inverse,
            ],
            axis=1,
        )
        inputs = np.where(self.stretch.restart[0], 0.0, voltages_v).T
        return self._current_response(by_voltage, inputs)

    def pulse_response(self, pulses_vs: Array) -> Array:
        """Return how the current answers small pulses of voltage, the rotor with it.

        Args:
            pulses_vs: shape (pulse, k): in V s, at the start of every interval.

        Returns:
            Shape (pulse, k + 1), in A.
        """
        by_pulse = self.transitions[:, :, State.CURRENT] / self.inductance_h
        inputs = np.where(self.stretch.restart[0], 0.0, pulses_vs).T
        return self._current_response(by_pulse, inputs)

    def torque_response(self, torques_nm: Array, inertia: float) -> Array:
        """Return how the current answers small further torques; a held shaft answers none.

        Args:
            torques_nm: shape (torque, k): mean over every interval, that drives the shaft.
            inertia: J of the run in kg m2.

        Returns:
            Shape (torque, k + 1), in A.
        """
        stays = np.clip(self.transitions[:, State.SPEED, State.SPEED], LEAST, 1.0 - LEAST)
        reach_s = input_reach(self.stretch.interval_s[0], stays)
        coupling_s = self._passed_on(State.CURRENT, State.SPEED)
        by_torque = np.stack([coupling_s, reach_s], axis=1) / inertia
        is_free = ~self.stretch.restart[0] & (stays >= HELD)
        inputs = np.where(is_free, torques_nm, 0.0).T
        return self._current_response(by_torque, inputs)

    def _current_response(self, gains: Array, inputs: Array) -> Array:
        """Return by how much further inputs move the current, shape (input, k + 1)."""
        answers_a = state_response(self.transitions, gains, inputs)[:, :, State.CURRENT].T
        return self.beyond_memory(answers_a)

    def _passed_on(self, state: State, by: State) -> Array:
        """Return what a push of one state through an interval does to the other, shape (k,).

        It is the derivative at the end, times the time in s for which a push of that size would
        act. It grows as ``1 - exp(-t R / L)``.
        """
        stays = np.clip(self.decay, LEAST, 1.0 - SHORTEST)
        mean = 1.0 / (1.0 - stays) + 1.0 / np.log(stays)
        coupling: Array = mean * self.stretch.interval_s[0] * self.transitions[:, state, by]
        return coupling


def rotor_free_run(
    white_box: WhiteBox, p: Array, stretch: SampleWindow, noise_memory: float = 0.0
) -> FreeRun:
    """Run a motor with a rotor at once; see :func:`rotor_free_run_in_pieces`."""
    return completed(rotor_free_run_in_pieces(white_box, p, stretch, noise_memory))


def rotor_free_run_in_pieces(
    white_box: WhiteBox, p: Array, stretch: SampleWindow, noise_memory: float = 0.0
) -> Pieces[FreeRun]:
    """Run a motor with a rotor freely through a stretch, its first states where they fit best.

    So does a load that varies. As where the run begins, it explains whatever it can.

    Args:
        white_box: of one motor with a rotor.
        p: shape (1, coordinate): its parameters, as :func:`~.white_box.flow.to_coordinates` has
            them.
        stretch: the samples, with a motor axis of one.
        noise_memory: of the current (:mod:`~gray_box_observer.context_nodes.rotor.noise_memory`).
    """
    assert isinstance(white_box, MotorWhiteBox)
    theta = to_parameters(p)[0]
    unknowns = Unknowns(noise_memory=noise_memory)
    window = Window.from_samples(white_box, _samples(white_box, stretch), unknowns)
    runs = None
    if window.histories and white_box.load_varies:
        runs = yield from loaded_runs(white_box, theta, window)
    elif window.histories:
        with np.errstate(all='ignore'):
            runs = settled_runs(white_box, theta, window)
    whole = _joined(window if runs is None else runs.window) if window.histories else stretch
    if runs is None:
        return _nothing(p, whole)
    transitions = _transitions(runs)
    decay = np.clip(transitions[:, 0, 0], 0.0, 1.0)
    winding_decay = np.exp(-whole.interval_s[0] / runs.winding_s)
    by_start = _by_start(runs)
    states = np.concatenate([path.states for path in runs.runs]).T
    return RotorFreeRun(
        whole,
        float(theta[0]),
        states[State.CURRENT],
        runs.residual_a,
        np.column_stack([by_start[0], swapped_logarithms(runs.by_parameter)]),
        decay,
        input_reach(whole.interval_s[0], np.where(decay > SEEN, decay, winding_decay)),
        np.ones_like(runs.residual_a),
        tuple(by_start[1:]),
        noise_memory=noise_memory,
        transitions=transitions,
        speed_rad_s=states[State.SPEED],
        runs=runs,
    )


def _samples(white_box: MotorWhiteBox, stretch: SampleWindow) -> Array:
    """Samples as a replay buffer has them, shape (signal, k + 1)."""
    interval = np.concatenate([[0.0], np.where(stretch.restart[0], 0.0, stretch.interval_s[0])])
    voltage = np.concatenate([[0.0], stretch.voltage_v[0]])
    torque = np.asarray(white_box.output(stretch.state[0]))
    result = np.zeros((MOMENT + 1, torque.size))
    result[HELD_VOLTAGE] = voltage if stretch.held_v is None else stretch.held_v[0]
    result[MOMENT] = 0.0 if stretch.moment_v is None else stretch.moment_v[0]
    result[:SPEED] = interval, voltage, torque
    return result


def _joined(window: Window) -> SampleWindow:
    """Return the histories of a window, one behind the other."""
    nothing = np.zeros(1)
    voltage = [np.concatenate([nothing, history.voltage_v]) for history in window.histories]
    interval = [np.concatenate([nothing, history.interval_s]) for history in window.histories]
    intervals = np.concatenate(interval)[1:]
    current = window.current_a
    return SampleWindow(
        current[None],
        np.concatenate(voltage)[None, 1:],
        intervals[None],
        np.zeros_like(current)[None],
        (intervals <= 0.0)[None],
    )


def _transitions(runs: FreeRuns) -> Array:
    nothing = np.zeros((1, len(State), len(State)))
    parts = [np.concatenate([nothing, run.transitions]) for run in runs.runs]
    return np.concatenate(parts)[1:]


def _by_start(runs: FreeRuns) -> list[Array]:
    """Derivatives of the current by every unknown of its history, shape (sample,) each."""
    total = runs.residual_a.size
    begin = 0
    columns = []
    for by_start in runs.by_start:
        for unknown in range(by_start.shape[1]):
            column = np.zeros(total)
            column[begin : begin + by_start.shape[0]] = by_start[:, unknown]
            columns.append(column)
        begin += by_start.shape[0]
    return columns


def _nothing(p: Array, stretch: SampleWindow) -> FreeRun:
    """Return a run that explains nothing, where the values cannot be run."""
    current = stretch.state[0]
    return FreeRun(
        stretch,
        1.0 / float(p[0, 0]),
        np.zeros_like(current),
        current,
        np.zeros((current.size, 1 + p.shape[1])),
        np.zeros(current.size - 1),
        np.zeros(current.size - 1),
        np.ones_like(current),
    )
