"""The batch fit beside the EMPS axis, and what is told where its record is not there."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from common.rotor.axis_figures import FORCE_PER_VOLT, STATED, axis_figures, batch_fit
from scipy.integrate import solve_ivp


def test_a_batch_fit_finds_mass_and_frictions_of_an_axis_that_stops_and_turns() -> None:
    mass, viscous, dry = STATED * [0.9, 1.2, 1.3]
    step_s = 0.005
    random = np.random.default_rng(1)
    volt = np.repeat(random.uniform(-3.0, 3.0, 60), 20)
    volt[400:520] = 0.2  # too little for the friction: the axis stands

    def rate(time_s: float, speed: np.ndarray) -> np.ndarray:
        push = FORCE_PER_VOLT * volt[min(int(time_s / step_s + 1e-9), volt.size - 1)]
        return (push - viscous * speed - dry * np.tanh(speed / 1e-5)) / mass

    speed = [0.0]
    for k in range(volt.size - 1):
        span = (k * step_s, (k + 1) * step_s)
        speed.append(solve_ivp(rate, span, [speed[-1]], 'LSODA', max_step=step_s).y[0, -1])
    assert np.ptp(speed[480:520]) < 1e-4, 'it stands'
    noise = 1e-4 * random.standard_normal(volt.size)
    found = batch_fit(step_s * np.arange(volt.size), volt, np.array(speed) + noise)
    np.testing.assert_allclose(found, [mass, viscous, dry], rtol=0.01)


def test_without_its_record_the_axis_has_no_figure(tmp_path: Path) -> None:
    (figure,) = axis_figures(tmp_path)
    assert figure.value is None
    assert figure.met is None
