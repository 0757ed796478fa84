"""Time constants and feed-forward constants: values by hand, deviations by drawn parameters."""

from __future__ import annotations

import numpy as np
import pytest

from gray_box_observer.context_nodes import Estimate, Verdict
from gray_box_observer.context_nodes.derived_constants import derived_constants
from gray_box_observer.white_box import MotorWhiteBox

NODES = ('inductance', 'resistance', 'inertia', 'viscous_friction', 'coulomb_friction')
KT = 0.02
KB = 0.03
THETA = np.array([4e-3, 2.0, 1e-5, 2e-5, 8e-3])
ROTOR = MotorWhiteBox(NODES, KT, {'back_emf_constant': KB})


def estimate_of(
    box: MotorWhiteBox, theta: np.ndarray, covariance: np.ndarray, *verdicts: Verdict
) -> Estimate:
    """Return an estimate of one motor."""
    judged = verdicts or (Verdict.IDENTIFIED,) * theta.size
    return Estimate(0, box.parameters, theta[None], covariance[None], (judged,))


def by_hand(theta: np.ndarray) -> dict[str, float]:
    """Return the constants by the formulas of the books."""
    inductance, resistance, inertia, viscous, coulomb = theta.tolist()
    return {
        'electrical_time_constant': inductance / resistance,
        'mechanical_time_constant': resistance * inertia / (KB * KT + resistance * viscous),
        'kS': resistance * coulomb / KT,
        'kV': KB * (1.0 + resistance * viscous / (KB * KT)),
        'kA': resistance * inertia / KT,
    }


def test_values_are_those_of_the_formulas_and_deviations_those_of_drawn_parameters() -> None:
    rng = np.random.default_rng(5)
    root = rng.normal(0.0, 0.002, (THETA.size, THETA.size)) * THETA[:, None]
    constants = derived_constants(ROTOR, estimate_of(ROTOR, THETA, root @ root.T))
    draws = THETA + rng.normal(size=(20_000, THETA.size)) @ root.T
    values = [by_hand(draw) for draw in draws]
    assert [one.name for one in constants] == list(by_hand(THETA))
    for one in constants:
        assert one.value == pytest.approx(by_hand(THETA)[one.name], rel=1e-12), one.name
        spread = np.std([value[one.name] for value in values])
        assert one.std == pytest.approx(spread, rel=0.05), one.name


def test_a_constant_is_as_sure_as_the_least_sure_of_its_parameters() -> None:
    verdicts = (
        Verdict.CONVERGING, Verdict.IDENTIFIED, Verdict.IDENTIFIED,
        Verdict.NEGLIGIBLE, Verdict.UNEXCITED,
    )  # fmt: skip
    estimate = estimate_of(ROTOR, THETA, np.diag((0.01 * THETA) ** 2), *verdicts)
    judged = {one.name: one.verdict for one in derived_constants(ROTOR, estimate)}
    assert judged == {
        'electrical_time_constant': Verdict.CONVERGING,
        'mechanical_time_constant': Verdict.IDENTIFIED,
        'kS': Verdict.UNEXCITED,
        'kV': Verdict.IDENTIFIED,
        'kA': Verdict.IDENTIFIED,
    }


def test_of_a_motor_without_rotor_the_electrical_time_constant_is_all() -> None:
    box = MotorWhiteBox(NODES[:2], KT, {'back_emf_constant': KB})
    constants = derived_constants(box, estimate_of(box, THETA[:2], np.diag([1e-10, 1e-6])))
    assert [one.name for one in constants] == ['electrical_time_constant']


def test_friction_that_nobody_knows_of_leaves_its_constant_out() -> None:
    box = MotorWhiteBox(NODES[:3], KT, {'back_emf_constant': KB})
    constants = derived_constants(
        box, estimate_of(box, THETA[:3], np.diag((0.01 * THETA[:3]) ** 2))
    )
    values = {one.name: one.value for one in constants}
    assert set(values) == {'electrical_time_constant', 'mechanical_time_constant', 'kV', 'kA'}
    assert values['kV'] == KB
