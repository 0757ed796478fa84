"""Estimates by compiled code are those of numpy, to the last bit."""

from __future__ import annotations

import numpy as np
import pytest

from gray_box_observer.context_nodes import Estimate, RecursiveEstimator, Verdict, VerdictSettings
from gray_box_observer.context_nodes.native import compiled
from gray_box_observer.context_nodes.native.regular_estimate import RegularEstimates, _Believed
from gray_box_observer.context_nodes.recursive.estimator_state import copied
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.interface import bounds

needs_it = pytest.mark.skipif(
    compiled.library('believed_size', _Believed) is None, reason='built without a C compiler'
)
NODES = ('inductance', 'resistance', 'hysteresis', 'brush_drop')
MOTORS = 200


@pytest.fixture
def nodes() -> RecursiveEstimator:
    """Context nodes of many motors with random beliefs, sharp to vague, some at a bound."""
    random = np.random.default_rng(7)
    count = len(NODES)
    box = MotorWhiteBox(NODES, np.full(MOTORS, 0.01), {'back_emf_constant': np.full(MOTORS, 0.01)})
    lower, upper = bounds(box.parameters)
    theta = np.exp(random.uniform(np.log(lower), np.log(upper), (MOTORS, count)))
    theta[::7, 1] = upper[1]
    theta[3::7, 2] = lower[2]
    theta[5::7, 0] = 2.0 * upper[0]
    made = RecursiveEstimator(box, np.ones((MOTORS, count)))
    belief = made._state.belief
    belief.p[:, 0] = 1.0 / theta[:, 0]
    belief.p[:, 1:] = theta[:, 1:] / theta[:, :1]
    belief.noise[:] = np.exp(random.uniform(-6.0, 0.0, MOTORS))
    shape = random.normal(size=(MOTORS, count + 1, count + 1))
    sharpness = np.exp(random.uniform(-14.0, -3.0, (MOTORS, 1, 1)))
    belief.covariance[:] = (
        sharpness * shape @ shape.swapaxes(1, 2) / belief.noise[:, None, None] ** 2
    )
    made._state.share[::3, 2] = 1e-3 / theta[::3, 2]
    made._state.reach[::3, 2] = 1e-3
    return made


def by_numpy(nodes: RecursiveEstimator, which: object = slice(None)) -> Estimate:
    """The estimate without compiled code."""
    within = nodes._regular._library
    nodes._regular._library = None
    told = nodes.estimate(which)
    nodes._regular._library = within
    return told


def assert_same(one: Estimate, other: Estimate) -> None:
    """Compare two estimates bit by bit."""
    assert one.value.tobytes() == other.value.tobytes()
    assert one.covariance.tobytes() == other.covariance.tobytes()
    assert one.verdicts == other.verdicts


@needs_it
def test_estimates_are_those_of_numpy_to_the_last_bit(nodes: RecursiveEstimator) -> None:
    told = set()
    wide = 0
    for motor in range(MOTORS):
        which = slice(motor, motor + 1)
        alone = nodes._compiled_values(np.array([motor]))
        wide += alone is None
        assert_same(nodes.estimate(which), by_numpy(nodes, which))
        told |= set() if alone is None else set(alone[2][0])
    assert told == set(Verdict) - {
        Verdict.FROZEN,
        Verdict.UNEXCITED,
        Verdict.MISFIT,
    }  # what is vague is left to numpy
    assert 10 < wide < MOTORS - 10


@needs_it
def test_some_motors_are_told_of_as_all_are(nodes: RecursiveEstimator) -> None:
    nodes._state.belief.covariance[:] *= 1e-3
    everyone = nodes.estimate()
    some = np.array([3, 17, 18, 150])
    assert nodes._regular.estimate(nodes._state.belief, None, nodes.verdict_rules) is not None
    assert_same(everyone, by_numpy(nodes))
    chosen = nodes.estimate(some)
    assert_same(chosen, by_numpy(nodes, some))
    assert chosen.value.tobytes() == everyone.value[some].tobytes()


@needs_it
def test_what_was_told_stays_as_it_was_told(nodes: RecursiveEstimator) -> None:
    first = nodes.estimate(slice(0, 1))
    value = first.value.copy()
    covariance = first.covariance.copy()
    nodes._state.belief.p[:] *= 1.5
    nodes.estimate(slice(0, 1))
    np.testing.assert_array_equal(first.value, value)
    np.testing.assert_array_equal(first.covariance, covariance)


@needs_it
def test_rules_and_beliefs_may_be_replaced(nodes: RecursiveEstimator) -> None:
    one = slice(4, 5)
    nodes._state.belief.covariance[:] *= 1e-4
    before = nodes.estimate(one)
    nodes.verdict_rules = VerdictSettings(identified_relative_std=1e-12, excited_relative_std=1e-11)
    assert_same(nodes.estimate(one), by_numpy(nodes, one))
    assert Verdict.UNEXCITED in nodes.estimate(one).verdicts[0]
    nodes._state = copied(nodes._state)
    nodes._state.belief.p[:] *= 1.01
    assert_same(nodes.estimate(one), by_numpy(nodes, one))
    assert nodes.estimate(one).value.tobytes() != before.value.tobytes()
    nodes.freeze(True)
    assert set(nodes.estimate(one).verdicts[0]) == {Verdict.FROZEN}


@needs_it
def test_what_is_not_a_number_is_told_as_numpy_tells_it(nodes: RecursiveEstimator) -> None:
    belief = nodes._state.belief
    belief.p[0, 1] = np.nan
    belief.covariance[1, 2, 2] = np.nan
    belief.p[2, 0] = np.inf
    with np.errstate(invalid='ignore', over='ignore'):
        for motor in range(3):
            one = nodes.estimate(slice(motor, motor + 1))
            other = by_numpy(nodes, slice(motor, motor + 1))
            np.testing.assert_array_equal(one.value, other.value)
            np.testing.assert_array_equal(one.covariance, other.covariance)
            assert one.verdicts == other.verdicts


def test_more_parameters_than_it_has_room_for_are_left_to_numpy(nodes: RecursiveEstimator) -> None:
    parameters = nodes._white_box.parameters
    assert (
        RegularEstimates((*parameters, *parameters), 1).estimate(
            nodes._state.belief, None, VerdictSettings()
        )
        is None
    )
