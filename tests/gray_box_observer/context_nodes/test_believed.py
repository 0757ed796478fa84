"""What may be believed where data say nothing, or where a parameter is truly zero."""

from __future__ import annotations

import numpy as np
import pytest

from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Simulation
from gray_box_observer.context_nodes import Estimate, RecursiveEstimator, Verdict
from gray_box_observer.context_nodes.recursive.change_tracking import (
    FREE_EXAMINATIONS,
    LONGEST_PATIENCE,
    patience,
)
from gray_box_observer.samples import Sample
from gray_box_observer.white_box import MotorWhiteBox

NAMES = ('inductance', 'resistance', 'hysteresis')
START = (1.5, 3.0, 1.0)


def _learnt(
    voltage: np.ndarray,
    current: np.ndarray,
    step_s: float,
    *,
    constant: float = 0.03,
    speed: np.ndarray | None = None,
    names: tuple[str, ...] = NAMES,
    start: tuple[float, ...] = START,
) -> RecursiveEstimator:
    """Context nodes that have learnt currents, one more than the voltages between them."""
    told = {} if 'back_emf_constant' in names else {'back_emf_constant': constant}
    box = MotorWhiteBox(names, constant, told, speed_measured=speed is not None)
    nodes = RecursiveEstimator(box, np.array([start]))
    for k in range(current.size):
        interval, held = (step_s, voltage[k - 1]) if k else (0.0, 0.0)
        turning = np.nan if speed is None else speed[k]
        nodes.learn(
            Sample.of_one_motor(
                round(k * step_s * 1e9), interval, held, constant * current[k], turning
            )
        )
    return nodes


def _blocked(
    voltage: np.ndarray, step_s: float, inductance: float, resistance: float
) -> np.ndarray:
    """Current of a motor without hysteresis that does not turn."""
    decay = np.exp(-step_s * resistance / inductance)
    current = np.zeros(voltage.size + 1)
    for k, volt in enumerate(voltage):
        current[k + 1] = volt / resistance + (current[k] - volt / resistance) * decay
    return current


def _levels(samples: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.repeat(rng.uniform(-12.0, 12.0, samples), rng.integers(20, 200, samples))[:samples]


def _nobody_is_known(estimate: Estimate) -> bool:
    return all(
        verdict not in (Verdict.IDENTIFIED, Verdict.NEGLIGIBLE) for verdict in estimate.verdicts[0]
    )


def test_hysteresis_that_is_truly_zero_becomes_negligible_and_the_motor_identified() -> None:
    rng = np.random.default_rng(0)
    voltage = _levels(4000, 0)
    current = np.zeros(voltage.size + 1)
    turning = 100.0 * np.sin(np.arange(voltage.size) / 300.0)  # somebody else drives the rotor
    decay = np.exp(-0.2)
    for k, volt in enumerate(voltage):
        steady = (volt - 0.03 * turning[k]) / 2.0  # L = 10 mH, R = 2 ohm
        current[k + 1] = steady + (current[k] - steady) * decay
    noisy = current + 0.01 * current.std() * rng.standard_normal(current.size)
    nodes = _learnt(voltage, noisy, 1e-3, speed=np.append(turning, turning[-1]))
    estimate = nodes.estimate()
    assert estimate.verdicts[0] == (Verdict.IDENTIFIED, Verdict.IDENTIFIED, Verdict.NEGLIGIBLE)
    assert estimate.identified(0)
    assert abs(estimate.value[0, 1] - 2.0) < 0.02


def test_hysteresis_that_matters_is_never_negligible() -> None:
    record = Simulation({'m': PlantParameters()}, 'R[5,15]D[0.001,2]', seed=1).record(20.0)
    current = record.torque_nm[0] / 0.01
    nodes = _learnt(record.voltage_v[0][:-1], current, 0.01, constant=0.01)
    assert nodes.estimate().verdicts[0][2] is Verdict.IDENTIFIED


@pytest.mark.parametrize('step_a', [0.02, 0.1, 0.3])
def test_a_quantised_current_does_not_pass_for_one_without_noise(step_a: float) -> None:
    voltage = _levels(4000, 1)
    current = np.round(_blocked(voltage, 1e-3, 5e-3, 2.0) / step_a) * step_a
    nodes = _learnt(voltage, current, 1e-3, names=('inductance', 'resistance'), start=(1.5, 3.0))
    estimate = nodes.estimate()
    assert nodes.noise_std_nm[0] >= 0.03 * step_a / np.sqrt(12.0) * 0.99
    assert estimate.value[0] == pytest.approx([5e-3, 2.0], rel=0.03)


@pytest.mark.parametrize('toggling', [False, True])
def test_rest_teaches_nothing_whatever_the_noise_of_the_converter(toggling: bool) -> None:
    rng = np.random.default_rng(0)
    voltage = 0.008 * rng.standard_normal(3000)
    current = 0.01 * rng.integers(0, 2, 3001) if toggling else np.zeros(3001)
    estimate = _learnt(voltage, current, 1e-3).estimate()
    assert estimate.verdicts[0] == (Verdict.UNEXCITED,) * 3


def test_a_motor_that_has_rested_is_identified_once_it_moves() -> None:
    voltage = np.concatenate([np.zeros(6000), _levels(2000, 2)])
    current = _blocked(voltage, 1e-3, 5e-3, 2.0)
    noisy = np.where(np.arange(current.size) <= 6000, 0.0, np.round(current, 2))
    nodes = _learnt(voltage, noisy, 1e-3, names=('inductance', 'resistance'), start=(1.5, 3.0))
    assert nodes.estimate().identified(0)
    assert nodes.theta[0] == pytest.approx([5e-3, 2.0], rel=0.02)


@pytest.mark.parametrize('noise', [0.0, 0.003])
@pytest.mark.parametrize('begin', [0, 1, 20])
def test_a_rotor_that_gathers_speed_at_one_voltage_is_not_taken_for_an_inductance(
    noise: float, begin: int
) -> None:
    rng = np.random.default_rng(1)
    samples = np.arange(3001)
    current = 0.25 + 0.7 * np.exp(-samples / 350.0) - 0.95 * np.exp(-samples / 0.15)
    voltage = 8.0 * (1.0 + noise * rng.standard_normal(3000))
    measured = (current + 0.005 * rng.standard_normal(3001))[begin:]
    estimate = _learnt(voltage[begin:], measured, 1e-3).estimate()
    assert estimate.verdicts[0][0] is Verdict.UNEXCITED


@pytest.mark.slow
@pytest.mark.parametrize('seed', [3, 4, 5, 6])
@pytest.mark.parametrize(
    'names', [('inductance', 'resistance', 'back_emf_constant'), (*NAMES, 'back_emf_constant')]
)
def test_resistance_and_back_emf_that_no_data_tell_apart_are_not_identified_on_wrong_values(
    names: tuple[str, ...], seed: int
) -> None:
    plant = PlantParameters(**({} if 'hysteresis' in names else {'hysteresis': 0.0}))
    record = Simulation({'m': plant}, 'R[5,15]D[0.001,2]', seed=seed).record(26.0)
    rng = np.random.default_rng(seed)
    current = record.torque_nm[0] / 0.01
    noisy = current + 0.01 * current.std() * rng.standard_normal(current.size)
    start = (*START[: len(names) - 1], 30.0)
    speed = record.speed_rad_s[0]
    nodes = _learnt(
        record.voltage_v[0][:-1], noisy, 0.01, constant=0.01, speed=speed, names=names, start=start
    )
    estimate = nodes.estimate()
    truth = np.array([0.5, 1.0, 10.0, 0.01])[[NAMES.index(n) if n in NAMES else 3 for n in names]]
    for value, std, true, verdict in zip(
        estimate.value[0], estimate.std[0], truth, estimate.verdicts[0], strict=True
    ):
        assert verdict is not Verdict.IDENTIFIED or abs(value - true) < 4.0 * std


def test_examinations_that_settle_nothing_are_put_off_longer_and_longer_up_to_a_limit() -> None:
    waits = patience(np.arange(20), 32)
    assert not waits[: FREE_EXAMINATIONS + 1].any()
    assert (np.diff(waits) >= 0).all()
    assert waits[-1] == 32 * LONGEST_PATIENCE
