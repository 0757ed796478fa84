"""Starting from a data sheet: values with the uncertainty they come with."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from dc_motor_sim.simulation import Recording
from gray_box_observer.context_nodes import Estimate, RecursiveEstimator, Verdict
from gray_box_observer.context_nodes.recursive.belief import Prior
from gray_box_observer.errors import ConfigurationError
from gray_box_observer.fit_test.data_sheet import contradiction
from gray_box_observer.observer.observer import Observer
from gray_box_observer.samples import Sample
from gray_box_observer.settings.configuration import Configuration
from gray_box_observer.settings.motor_configuration import MotorConfiguration
from gray_box_observer.white_box import TERMS, MotorWhiteBox
from gray_box_observer.white_box.flow import to_coordinates, to_parameters

NAMES = ('inductance', 'resistance', 'hysteresis')
TRUTH = np.array([0.5, 1.0, 10.0])


def observer(values: Any, relative_std: Any, **given: Any) -> Observer:
    told = {
        f'motor.initial.{name}': float(value) for name, value in zip(NAMES, values, strict=True)
    }
    told |= {
        f'motor.initial_relative_std.{name}': float(s)
        for name, s in zip(NAMES, relative_std, strict=True)
    }
    return Observer(Configuration.from_flat({'predictor': False, **told, **given}))


def feed(one: Observer, recording: Recording, start: int = 0, end: int | None = None) -> Observer:
    for k in range(start, recording.stamp_ns.size if end is None else end):
        stamp_ns = int(recording.stamp_ns[k])
        one.voltage('motor', stamp_ns, float(recording.voltage_v[0, k]))
        one.torque('motor', stamp_ns, float(recording.torque_nm[0, k]))
    return one


def test_the_prior_of_coordinates_is_that_of_independent_parameters() -> None:
    random = np.random.default_rng(3)
    std = np.array([0.1, 0.3, 0.02])
    prior = Prior.of_parameters(to_coordinates(TRUTH[None]), std[None])
    theta = TRUTH * np.exp(std * random.standard_normal((200_000, 3)))
    drawn = np.cov(np.log(to_coordinates(theta)).T)
    np.testing.assert_allclose(prior.covariance[0], drawn, atol=0.01 * std.max() ** 2)
    np.testing.assert_allclose(to_parameters(prior.p)[0], TRUTH)


def test_before_any_sample_what_is_known_is_what_was_told() -> None:
    one = observer([0.002, 2.0, 0.3], [0.1, 0.05, 0.0])
    estimate, identified = one.estimate_of('motor')
    np.testing.assert_allclose(estimate.value[0], [0.002, 2.0, 0.3])
    np.testing.assert_allclose(
        estimate.std[0], [0.0002, 0.1, 0.3 * (np.expm1(2.0) - np.expm1(0.3) + 0.3)]
    )
    assert estimate.verdicts[0] == (Verdict.CONVERGING, Verdict.CONVERGING, Verdict.UNEXCITED)
    assert not identified
    np.testing.assert_allclose(estimate.covariance[0], np.diag(estimate.std[0] ** 2), atol=1e-12)
    certain, identified = observer([0.002, 2.0, 0.3], [0.01, 0.01, 0.01]).estimate_of('motor')
    assert identified, 'a std below 2 % of the value: use it'
    assert certain.identified(0)


@pytest.mark.slow
def test_told_nothing_it_starts_as_vaguely_as_ever(record: Callable[..., Recording]) -> None:
    recording = record('R[5,15]D[0.1,1]', 20.0, torque_noise_std=1e-4)
    told = feed(observer([1.5, 3.0, 1.0], [0.0, 0.0, 0.0]), recording, 0, 500)
    plain = feed(Observer(Configuration.from_flat({'predictor': False})), recording, 0, 500)
    assert told.estimates()['motor'].value.tobytes() == plain.estimates()['motor'].value.tobytes()


@pytest.mark.slow
def test_what_is_well_known_stays_until_the_data_speak_of_it(
    record: Callable[..., Recording],
) -> None:
    settled = record(
        'C[10]', 40.0, torque_noise_std=3e-5
    )  # tells one combination of R and K_HS, nothing of L
    std = np.array([0.01, 0.01, 0.01])
    one = feed(observer(TRUTH * [1.01, 0.99, 1.0], std), settled, 3000, 4000)
    estimate = one.estimates()['motor']
    assert estimate.value[0, 0] == pytest.approx(0.505, rel=0.002)
    assert estimate.std[0, 0] == pytest.approx(0.00505, rel=0.05)
    assert np.all(np.abs(estimate.value[0] / TRUTH - 1.0) < 0.02)
    assert np.all(np.abs(estimate.value[0] - TRUTH) < 3.0 * estimate.std[0])


@pytest.mark.slow
@pytest.mark.parametrize('wrong', [[1.4, 0.7, 1.3], [0.5, 2.0, 0.6], [3.0, 0.4, 0.4]])
def test_a_wrong_data_sheet_with_honest_std_is_corrected(
    record: Callable[..., Recording], wrong: list[float]
) -> None:
    recording = record('R[5,15]D[0.1,1]', 20.0, torque_noise_std=1e-4)
    honest = np.abs(np.log(wrong))
    one = feed(observer(TRUTH * wrong, honest), recording, 0, 1000)
    estimate = one.estimates()['motor']
    assert np.all(np.abs(estimate.value[0] - TRUTH) < 4.0 * estimate.std[0])
    assert np.all(np.abs(estimate.value[0] / TRUTH - 1.0) < 0.01)
    assert estimate.identified(0)


@pytest.mark.slow
def test_a_data_sheet_that_is_too_sure_of_itself_yields_to_plain_data(
    record: Callable[..., Recording],
) -> None:
    recording = record('R[5,15]D[0.1,1]', 20.0, torque_noise_std=1e-4)
    estimate = feed(observer(TRUTH * [1.0, 1.5, 1.0], [0.01, 0.01, 0.01]), recording).estimates()[
        'motor'
    ]
    assert np.all(np.abs(estimate.value[0] / TRUTH - 1.0) < 0.03)


@pytest.mark.slow
def test_what_was_found_far_from_the_data_sheet_is_told(record: Callable[..., Recording]) -> None:
    recording = record('R[5,15]D[0.1,1]', 20.0, torque_noise_std=1e-4)
    told = [0.2, 0.1, 0.0]

    def doubt(**given: Any) -> str | None:
        one = feed(observer(TRUTH, told, **given), recording)
        return contradiction(one.configuration.motors['motor'], one.estimates()['motor'])

    assert doubt() is None
    doubled = doubt(**{'motor.torque_constant': 0.02})  # L and R come out twice as large
    assert doubled is not None
    said = (
        'inductance of 1 H is 3.5 standard deviations from the 0.5 H +- 20 % given, resistance of '
    )
    assert doubled.startswith(said)
    assert 'torque_constant' in doubled
    assert 'hysteresis' not in doubled  # nothing was given of it


@pytest.mark.parametrize(('relative_std', 'doubtful'), [(0.1, True), (0.2, False), (0.0, False)])
def test_only_what_is_identified_contradicts_only_what_was_given(
    relative_std: float, doubtful: bool
) -> None:
    one = observer(TRUTH, [relative_std] * 3)
    motor = one.configuration.motors['motor']
    parameters = one.estimate_of('motor')[0].parameters
    value = np.array([TRUTH * 1.6])
    covariance = np.diag((0.001 * value[0]) ** 2)[None]
    sure = Estimate(0, parameters, value, covariance, ((Verdict.IDENTIFIED,) * 3,))
    unsure = Estimate(0, parameters, value, covariance, ((Verdict.CONVERGING,) * 3,))
    assert (contradiction(motor, sure) is not None) == doubtful
    assert contradiction(motor, unsure) is None


@pytest.mark.slow
@pytest.mark.parametrize('noise_nm', [0.0, 1.4e-4])
@pytest.mark.parametrize('start', [0, 3, 50])
def test_a_data_sheet_that_cannot_be_true_is_dropped(
    record: Callable[..., Recording], start: int, noise_nm: float
) -> None:  # fmt: skip
    """R is stated as twice its value, to 1 %: the search must not end where K_HS makes up."""
    recording = record('R[5,15]D[1,20]', 30.0, torque_noise_std=noise_nm)
    one = observer(TRUTH * [1.0, 2.0, 1.0], [0.2, 0.01, 0.0])
    for begin, end in ((start, 500), (500, 1000), (1000, 1500), (1500, None)):
        estimate = feed(one, recording, begin, end).estimates()['motor']
        known = np.array([verdict is Verdict.IDENTIFIED for verdict in estimate.verdicts[0]])
        assert np.all(np.abs(estimate.value[0] - TRUTH)[known] < 0.04 * TRUTH[known]), (
            begin,
            estimate.value,
        )
    assert estimate.identified(0)
    assert np.all(
        np.abs(estimate.value[0] - TRUTH) < np.maximum(4.0 * estimate.std[0], 1e-4 * TRUTH)
    )


@pytest.mark.slow
def test_it_is_dropped_for_its_motor_alone(record: Callable[..., Recording]) -> None:
    recording = record('R[5,15]D[1,20]', 30.0, torque_noise_std=1.4e-4)
    initial = np.array([TRUTH * [1.0, 2.0, 1.0], TRUTH, TRUTH * [1.0, 2.0, 1.0]])
    told = np.array([[0.2, 0.01, 0.0], [0.2, 0.01, 0.0], [0.0, 0.0, 0.0]])

    def learnt(which: slice) -> np.ndarray:
        count = initial[which].shape[0]
        box = MotorWhiteBox(
            NAMES, np.full(count, 0.01), {'back_emf_constant': np.full(count, 0.01)}
        )
        nodes = RecursiveEstimator(box, initial[which], initial_relative_std=told[which])
        for k in range(50, 1200):
            signals = (
                np.full(count, x)
                for x in (0.01, recording.voltage_v[0, k - 1], recording.torque_nm[0, k])
            )
            nodes.learn(Sample(int(recording.stamp_ns[k]), *signals, np.full(count, np.nan)))
        return nodes.theta

    together = learnt(slice(None))
    for motor in range(3):
        np.testing.assert_array_equal(together[motor], learnt(slice(motor, motor + 1))[0])


@pytest.mark.slow
def test_with_little_data_the_error_is_what_the_covariance_says(
    record: Callable[..., Recording],
) -> None:
    """Data sheets drawn by their own uncertainty: mean squared errors equal the unknowns."""
    std = np.array([0.05, 0.1, 0.2])
    squares = []
    random = np.random.default_rng(11)
    for seed in range(20):
        recording = record('R[1,2]D[3,3]', 4.0, seed=seed, torque_noise_std=1e-4)
        told = TRUTH * np.exp(std * random.standard_normal(3))
        estimate = feed(observer(told, std), recording).estimates()['motor']
        error = np.log(estimate.value[0] / TRUTH)
        relative = estimate.covariance[0] / np.outer(estimate.value[0], estimate.value[0])
        squares.append(error @ np.linalg.solve(relative, error))
    assert 1.5 < np.mean(squares) < 5.0


def test_the_gradient_rule_is_told_nothing_it_could_not_use() -> None:
    with pytest.raises(
        ConfigurationError, match='motor motor: initial_relative_std needs context_update recursive'
    ):
        observer(TRUTH, [0.1, 0.0, 0.0], context_update='gradient')


def test_what_is_certain_is_no_context_node() -> None:
    with pytest.raises(
        ConfigurationError, match=r'initial_relative_std\.resistance must be 0 or at least 1e-06'
    ):
        observer(TRUTH, [0.1, 1e-9, 0.0])


def given_motor(**values: Any) -> MotorConfiguration:
    flat = {f'motor.{name.replace("__", ".")}': value for name, value in values.items()}
    return Configuration.from_flat(
        {'motor.context_nodes': ['inductance', 'resistance'], **flat}
    ).motors['motor']


def sure_estimate(inductance: float, resistance: float) -> Estimate:
    value = np.array([[inductance, resistance]])
    parameters = tuple(TERMS[name].parameter for name in ('inductance', 'resistance'))
    covariance = np.diag((0.001 * value[0]) ** 2)[None]
    return Estimate(0, parameters, value, covariance, ((Verdict.IDENTIFIED,) * 2,))


@pytest.mark.parametrize(
    ('quantity', 'factor', 'other'), [('torque', 0.04, 'current'), ('current', 25.0, 'torque')]
)
def test_a_current_taken_for_a_torque_is_told_by_the_data_sheet(
    quantity: str, factor: float, other: str
) -> None:
    motor = given_motor(torque_constant=0.04, initial__resistance=2.0)
    estimate = sure_estimate(0.002 * factor, 2.1 * factor)
    assert f'set torque.quantity: {other} ' in str(contradiction(motor, estimate, quantity))
    assert contradiction(motor, sure_estimate(0.002, 2.1), quantity) is None
    off = sure_estimate(0.002, 2.1 * factor**2)
    assert 'torque.quantity' not in str(contradiction(motor, off, quantity))


def test_a_value_given_without_a_std_is_contradicted_by_a_factor_of_four() -> None:
    motor = given_motor(initial__resistance=2.0)
    assert contradiction(motor, sure_estimate(0.002, 6.0)) is None
    assert 'resistance of 9 ohm is far from the 2 ohm given' in str(
        contradiction(motor, sure_estimate(0.002, 9.0))
    )
    nothing_given = given_motor(initial__resistance=3.0)
    assert contradiction(nothing_given, sure_estimate(0.002, 90.0)) is None, 'that is the default'
