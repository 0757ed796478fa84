"""Variant physics as it streams; the thesis's variants stand in test_window_training."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch

from dc_motor_sim.excitation import TABLE_5_1
from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Recording, Simulation
from gray_box_observer.errors import ConfigurationError, GrayBoxError
from gray_box_observer.predictor import Forecasting, Predictor, TrainingSettings, Variant
from gray_box_observer.predictor import predictor as predictor_module
from gray_box_observer.predictor.elementwise import Floats
from gray_box_observer.predictor.initial_network import fresh
from gray_box_observer.predictor.network import Weights
from gray_box_observer.predictor.steady_state import course, flow
from gray_box_observer.samples import ReplayBuffer, Sample
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.torch_ops import TorchOps

TRUTH = np.array([[0.5, 1.0, 10.0]])


def predictor(
    box: MotorWhiteBox, idle: Any, motors: int = 1, rules: TrainingSettings | None = None
) -> Forecasting:
    rules = rules or TrainingSettings()
    one = Predictor(box, motors, TRUTH[0], rules, speed_measured=box.speed_measured)
    return Forecasting(one, rules, idle)


def run(one: Forecasting, samples: list[Sample], theta: np.ndarray = TRUTH) -> np.ndarray:
    """Torque forecast of every sample, shape (motor, sample)."""
    said = []
    for s in samples:
        prediction = one.predict(s.interval_s, s.voltage_v, theta)
        one.learn(s, prediction, theta)
        said.append(prediction.torque_nm)
    return np.array(said).T


def error(said: np.ndarray, true_nm: np.ndarray, skip: int = 100) -> float:
    """Mean absolute error of one motor as a fraction of the torque's standard deviation."""
    return float(np.abs(said - true_nm)[skip:].mean() / true_nm.std())


@pytest.mark.slow
@pytest.mark.parametrize('excitation', TABLE_5_1.values())
def test_a_free_run_from_voltages_alone_is_right_within_a_hundredth_on_every_set_of_the_thesis(
    thesis_box: MotorWhiteBox,
    idle: Any,
    record: Callable[..., Recording],
    samples_of: Callable[..., list[Sample]],
    excitation: str,
) -> None:
    recording = record(excitation, 20.0, 3)
    for start in ('shipped', 'fresh'):
        said = run(
            predictor(thesis_box, idle, rules=TrainingSettings(start=start)), samples_of(recording)
        )
        assert error(said[0], recording.true_torque_nm[0]) < 1e-3


@pytest.mark.parametrize('seed', range(3))
def test_a_motor_never_seen_is_predicted_from_its_parameters(idle: Any, seed: int) -> None:
    unseen = np.random.default_rng(seed).uniform(0.6, 1.4, 3) * TRUTH
    inductance, resistance, hysteresis = unseen[0].tolist()
    plant = PlantParameters(inductance=inductance, resistance=resistance, hysteresis=hysteresis)
    recording = Simulation({'m': plant}, 'R[5,15]D[0.001,2]', seed=seed).record(15.0)
    box = MotorWhiteBox(
        ('inductance', 'resistance', 'hysteresis'), 0.01, {'back_emf_constant': 0.01}
    )
    one = predictor(box, idle)
    said = run(one, samples(recording), unseen)
    assert error(said[0], recording.true_torque_nm[0]) < 1e-3


def samples(recording: Recording, every: int = 1, jitter: bool = False) -> list[Sample]:
    """Samples at every n-th stamp (with jitter one to n apart), with the mean voltage."""
    random = np.random.default_rng(0)
    k = 0
    made = []
    last = 0
    while k < recording.stamp_ns.size:
        held = recording.voltage_v[:, last:k].mean(axis=1) if k else recording.voltage_v[:, 0]
        interval = np.full(
            len(recording.motors), (recording.stamp_ns[k] - recording.stamp_ns[last]) / 1e9
        )
        made.append(
            Sample(
                int(recording.stamp_ns[k]),
                interval,
                held,
                recording.torque_nm[:, k],
                0.0 * held + np.nan,
            )
        )
        last, k = k, k + (int(random.integers(1, every + 1)) if jitter else every)
    return made


def test_sampled_slowly_and_unevenly_it_is_still_right(
    thesis_box: MotorWhiteBox, idle: Any
) -> None:
    plant = PlantParameters()
    recording = Simulation({'m': plant}, 'R[0,33]D[0.8,0.8]', seed=2).record(40.0)
    slow = samples(recording, 20)  # 0.2 s: a good part of a time constant
    said = run(predictor(thesis_box, idle), slow)
    true = np.array([s.torque_nm[0] for s in slow])
    untaught = run(predictor(thesis_box, idle, rules=TrainingSettings(start='fresh')), slow)
    assert error(said[0], true, 5) < 0.01
    assert error(said[0], true, 5) < error(untaught[0], true, 5)
    uneven = samples(recording, 4, jitter=True)
    mixed = run(predictor(thesis_box, idle), uneven)
    # where the voltage changed inside an interval its mean stands for it; nearly all the error is
    # from there
    assert error(mixed[0], np.array([s.torque_nm[0] for s in uneven]), 5) < 0.01


def test_after_a_step_of_the_resistance_the_error_is_back_with_the_identified_value(
    thesis_box: MotorWhiteBox, idle: Any
) -> None:
    recording = Simulation(
        {'m': PlantParameters()},
        'R[5,15]D[1,3]',
        seed=1,
        schedule=['m.resistance=1.3@10'],
    ).record(20.0)
    one = predictor(thesis_box, idle)
    said = []
    for k, s in enumerate(samples(recording)):
        theta = TRUTH if k <= 1000 else np.array([[0.5, 1.3, 10.0]])
        prediction = one.predict(s.interval_s, s.voltage_v, theta)
        one.learn(s, prediction, theta)
        said.append(prediction.torque_nm[0])
    assert error(np.array(said), recording.true_torque_nm[0]) < 1e-3


def test_predicting_changes_nothing(
    thesis_box: MotorWhiteBox, idle: Any, record: Callable[..., Recording]
) -> None:
    asked = predictor(thesis_box, idle)
    silent = predictor(thesis_box, idle)
    some = samples(record('R[5,15]D[0.2,2]', 4.0))
    expected = run(silent, some)
    said = []
    for s in some:
        for voltage in (-5.0, 40.0):
            asked.predict(s.interval_s, np.array([voltage]), 2.0 * TRUTH)
            asked.forecast(0.7, np.array([voltage]), 0.5 * TRUTH)
        said.append(run(asked, [s])[0, 0])
    np.testing.assert_array_equal(said, expected[0])


def test_it_predicts_from_the_second_sample_of_a_history_on(
    thesis_box: MotorWhiteBox, idle: Any, record: Callable[..., Recording]
) -> None:
    one = predictor(thesis_box, idle)
    some = samples(record('R[5,15]D[0.2,2]', 4.0))
    for _ in range(2):  # the second time it is a restart
        said = run(one, some)[0]
        assert np.isnan(said[0])
        assert np.isfinite(said[1:]).all()
    assert said[1] == pytest.approx(some[1].torque_nm[0], rel=1e-3)


@pytest.mark.parametrize('horizon_s', [0.01, 0.1, 0.5, 5.0])
def test_a_forecast_holds_the_planned_voltage_over_any_horizon_in_one_step(
    thesis_box: MotorWhiteBox, idle: Any, record: Callable[..., Recording], horizon_s: float
) -> None:
    one = predictor(thesis_box, idle)
    assert np.isnan(one.forecast(horizon_s, np.array([7.0]), TRUTH)[0])
    some = samples(record('R[5,15]D[0.2,2]', 4.0))
    run(one, some)
    now = float(some[-1].torque_nm[0]) / 0.01
    for voltage in (-20.0, 0.0, 3.0, 33.0):
        way = course(Floats, thesis_box, TRUTH[0].tolist(), voltage, 0.0, 0.0)
        exact = 0.01 * flow(Floats, thesis_box, way, now, horizon_s, 0.01)
        reach = abs(0.01 * (way.steady_a - now))
        assert one.forecast(horizon_s, np.array([voltage]), TRUTH)[0] == pytest.approx(
            exact, abs=0.01 * reach
        )


def test_the_thesis_goes_from_sample_to_sample_only(thesis_box: MotorWhiteBox, idle: Any) -> None:
    one = predictor(thesis_box, idle, rules=TrainingSettings(variant=Variant.MAIN))
    with pytest.raises(ConfigurationError, match='variant main forecasts the next sample only'):
        one.forecast(0.5, np.array([7.0]), TRUTH)


def test_motors_together_are_predicted_as_each_alone(idle: Any) -> None:
    plants = {'a': PlantParameters(), 'b': PlantParameters(resistance=2.0)}
    recording = Simulation(plants, 'R[-5,15]D[0.1,1]', seed=4).record(6.0)
    known = {'back_emf_constant': np.array([0.01, 0.01])}
    both = MotorWhiteBox(('inductance', 'resistance', 'hysteresis'), np.array([0.01, 0.01]), known)
    alone = MotorWhiteBox(both.context_nodes, 0.01, {'back_emf_constant': 0.01})
    theta = np.array([[0.5, 1.0, 10.0], [0.5, 2.0, 10.0]])
    together = samples(recording)
    together[200].interval_s[1] = 0.0  # the second motor's history begins anew
    said = run(predictor(both, idle, 2), together, theta)
    for m in range(2):
        own = [
            Sample.of_one_motor(
                s.stamp_ns, float(s.interval_s[m]), float(s.voltage_v[m]), float(s.torque_nm[m])
            )
            for s in together
        ]
        np.testing.assert_allclose(
            said[m], run(predictor(alone, idle), own, theta[m : m + 1])[0], rtol=1e-9, atol=1e-12
        )
    assert np.isnan(said[1, 200])
    assert np.isfinite(said[:, 201:]).all()


def test_every_white_box_is_served_with_measured_speed_too(
    box: MotorWhiteBox, theta: list[float], idle: Any
) -> None:
    one = predictor(box, idle)
    truth = np.array([theta])
    interval_s = 0.01
    random = np.random.default_rng(0)
    current = 0.0
    voltage = 0.0
    speed = 0.0
    said = []
    true = []
    for k in range(240):
        torque = float(box.output(current))  # type: ignore[arg-type]
        sample = Sample.of_one_motor(
            k * 10**7,
            interval_s * (k > 0),
            voltage,
            torque,
            speed if box.speed_measured else np.nan,
        )
        prediction = one.predict(sample.interval_s, sample.voltage_v, truth)
        one.learn(sample, prediction, truth)
        said.append(float(prediction.torque_nm[0]))
        true.append(torque)
        if k % 40 == 0:
            voltage = float(random.uniform(-12.0, 12.0))
            speed = float(random.uniform(-20.0, 20.0))
            if box.speed_measured:  # it holds from here on, so this sample is the one that tells it
                one.predictor.speed_rad_s = np.array([speed])
        way = course(Floats, box, theta, voltage, speed, 0.0)
        current = flow(Floats, box, way, current, interval_s, 0.01)
    assert error(np.array(said), np.array(true), 1) < 2e-3


def test_whatever_comes_what_is_said_is_finite(thesis_box: MotorWhiteBox, idle: Any) -> None:
    one = predictor(thesis_box, idle)
    random = np.random.default_rng(0)
    for k in range(500):
        theta = TRUTH * 10.0 ** random.uniform(-6, 6, (1, 3))
        voltage, torque = (float(random.normal() * 10.0 ** random.uniform(-9, 9)) for _ in range(2))
        sample = Sample.of_one_motor(
            k, float(10.0 ** random.uniform(-6, 3)) * (k > 0), voltage, torque
        )
        prediction = one.predict(sample.interval_s, sample.voltage_v, theta)
        one.learn(sample, prediction, theta)
        if k:
            assert np.isfinite(prediction.torque_nm[0])
            assert np.isfinite(prediction.white_box_torque_nm[0])


def test_a_network_gone_wild_stays_between_where_the_motor_is_and_where_it_goes(
    thesis_box: MotorWhiteBox, idle: Any, record: Callable[..., Recording]
) -> None:
    one = predictor(thesis_box, idle)
    some = samples(record('R[5,15]D[0.2,2]', 4.0))
    wild = Weights(
        **{name: 1e3 * np.sign(array) for name, array in Weights.initial(5, 12, 0).arrays().items()}
    )
    one.restore(wild.arrays())
    said = run(one, some)[0]
    assert np.all(said[1:] >= 0.0)
    assert said[1:].max() <= max(s.torque_nm[0] for s in some) * 1.01


@pytest.mark.parametrize('variant', [Variant.PHYSICS, Variant.MAIN])
def test_a_part_of_a_network_is_refused(
    thesis_box: MotorWhiteBox, idle: Any, variant: Variant
) -> None:
    """Without its first array another network ran on, or none, as if there had been none."""
    rules = TrainingSettings(variant=variant)
    is_physics = variant is Variant.PHYSICS
    inputs = 5 if is_physics else 1 + TRUTH.size
    arrays = Weights.initial(inputs, rules.hidden, 0).arrays()
    if not is_physics:
        arrays |= {f'range_{name}': np.array([-1.0, 1.0]) for name in ('voltage', 'torque')}
    whole, parts = (predictor(thesis_box, idle, rules=rules).predictor for _ in range(2))
    whole.restore(arrays)
    assert whole.state().keys() == arrays.keys()
    before = parts.state()
    for missing in arrays:
        with pytest.raises(GrayBoxError):
            parts.restore({name: array for name, array in arrays.items() if name != missing})
        np.testing.assert_equal(parts.state(), before)
    with pytest.raises(GrayBoxError):  # a network of the thesis that has lost all of it
        parts.restore({'range_voltage': np.array([-1.0, 1.0])})


def test_jobs_carry_the_estimate_the_range_and_only_recent_samples(
    thesis_box: MotorWhiteBox, idle: Any, record: Callable[..., Recording]
) -> None:
    one = predictor(thesis_box, idle, rules=TrainingSettings(period=500, residual=False))
    covariance = np.array([np.diag([1e-4, 1e-3, 0.1])])
    for s in samples(record('R[5,15]D[0.2,2]', 15.0)):
        one.learn(s, one.predict(s.interval_s, s.voltage_v, TRUTH), TRUTH, covariance)
    assert len(idle.jobs) == 3
    job = idle.jobs[-1]
    np.testing.assert_array_equal(job['theta'], TRUTH)
    np.testing.assert_array_equal(job['covariance'], covariance)
    assert job['voltage_v'].shape == (1, 500)
    assert job['seen']['interval_s'] == [0.01, 0.01]
    low_v, high_v = job['seen']['voltage_v']
    assert 5.0 <= low_v < 8.0
    assert 12.0 < high_v <= 15.0
    other = predictor(thesis_box, idle)
    other.restore(one.state())
    assert other.state().keys() == one.state().keys()
    for name, array in one.state().items():
        np.testing.assert_array_equal(other.state()[name], array)


def test_a_speed_that_comes_but_is_no_signal_teaches_nobody(
    thesis_box: MotorWhiteBox, idle: Any, record: Callable[..., Recording]
) -> None:
    some = samples(record('R[5,15]D[0.2,2]', 15.0))
    listening = (idle, type(idle)())
    for one_of, brought in zip(
        listening, (np.nan, 3.0), strict=True
    ):  # where speed_source is torque_constant
        one = predictor(thesis_box, one_of, rules=TrainingSettings(period=500))
        with_speed = [
            s._replace(speed_rad_s=np.array([brought * (k + 1)])) for k, s in enumerate(some)
        ]
        run(one, with_speed)
        one.training.refill(ReplayBuffer.from_samples(with_speed[-1300:]).content())
        run(one, with_speed[1:])
    without, along = (one_of.jobs for one_of in listening)
    assert sum(job['residual'] for job in without) == 2
    for expected, job in zip(without, along, strict=True):
        for name, value in expected.items():
            np.testing.assert_array_equal(value, job[name], err_msg=name)


class Told:
    """Training that answers every job at once with what it was told to say."""

    is_resting = False
    failure = None

    def __init__(self, **answer: Any) -> None:
        self.answer = answer
        self.jobs = 0
        self.busy = False

    def submit(self, job: dict[str, Any]) -> None:
        """Take a job."""
        self.jobs = self.jobs + 1
        self.busy = True

    def collect(self) -> dict[str, Any]:
        """Give the answer."""
        self.busy = False
        return self.answer

    def close(self) -> None:
        """End nothing."""


def test_settled_training_costs_nothing_until_the_motor_or_its_range_moves(
    thesis_box: MotorWhiteBox, record: Callable[..., Recording]
) -> None:
    told = Told(windows=0, settled=True)
    one = predictor(thesis_box, told, rules=TrainingSettings(residual=False))
    some = samples(record('R[5,15]D[0.2,2]', 10.0))
    run(one, some)
    settled = told.jobs
    assert settled < 10
    run(one, some[1:401])
    assert told.jobs == settled
    run(one, some[1:201], np.array([[0.5, 1.1, 10.0]]))
    assert told.jobs == settled + 1
    farther = [
        Sample(s.stamp_ns, s.interval_s, 3.0 * s.voltage_v, s.torque_nm, s.speed_rad_s)
        for s in some[1:301]
    ]
    run(one, farther, np.array([[0.5, 1.1, 10.0]]))
    farthest = told.jobs
    assert farthest >= settled + 2
    run(one, farther, np.array([[0.5, 1.1, 10.0]]))
    assert told.jobs == farthest


def test_what_settles_is_what_the_job_was_of_not_what_came_while_it_ran(
    thesis_box: MotorWhiteBox, record: Callable[..., Recording]
) -> None:
    told = Told(windows=0, settled=True)
    one = predictor(thesis_box, told, rules=TrainingSettings(period=100, residual=False))
    some = samples(record('R[5,15]D[20,20]', 10.0))
    run(one, some[:300])
    assert told.jobs == 1, 'settled at once'
    moved = np.array([[0.5, 1.3, 10.0]])
    run(one, some[300:400], moved)
    assert (told.jobs, told.busy) == (2, True)
    run(one, some[400:500], 1.2 * moved)  # it is done now, but of a motor that is no more
    assert (told.jobs, told.busy) == (3, True)
    run(one, some[500:900], 1.2 * moved)
    assert told.jobs == 3


def test_a_better_network_runs_from_the_next_sample_on_and_a_frozen_predictor_takes_none(
    thesis_box: MotorWhiteBox, record: Callable[..., Recording]
) -> None:
    better = Weights.initial(5, 12, 7)
    told = Told(windows=1, loss=0.5, settled=False, **better.arrays())
    one = predictor(thesis_box, told, rules=TrainingSettings(start='fresh'))
    some = samples(record('R[5,15]D[0.2,2]', 10.0))
    one.training.freeze(True)
    run(one, some[:500])
    assert told.jobs == 0
    np.testing.assert_array_equal(one.state()['output'], fresh(12, 0).output)
    one.training.freeze(False)
    run(one, some[500:])
    np.testing.assert_array_equal(one.state()['output'], better.output)
    assert one.training.loss == 0.5


def test_what_was_learnt_beside_the_physics_begins_anew_where_the_parameters_move(
    thesis_box: MotorWhiteBox, record: Callable[..., Recording]
) -> None:
    told = Told(windows=0, settled=True)
    one = predictor(thesis_box, told)
    some = samples(record('R[5,15]D[0.2,2]', 30.0))
    rounds = []
    submit = told.submit
    told.submit = lambda job: (rounds.append(job) if job['residual'] else None, submit(job))[1]  # type: ignore[method-assign]
    run(one, some[:1501])
    run(one, some[1501:2901], np.array([[0.5, 1.3, 10.0]]))
    assert [job['residual_anew'] for job in rounds] == [True, True]
    before, after = (job['voltage_v'].shape[1] for job in rounds)
    assert before <= 1200
    assert 1000 <= after <= 1400  # nothing of the motor that it was


@pytest.mark.slow
def test_many_motors_are_predicted_alike_on_a_device(
    monkeypatch: pytest.MonkeyPatch,
    box: MotorWhiteBox,
    theta: list[float],
    idle: Any,
    torch_name: str,
) -> None:
    """Torch against numpy, with pauses, missing values, and voltages that move or are held."""
    monkeypatch.setattr(predictor_module, 'DEVICE_FROM', 2)
    motors = 7
    random = np.random.default_rng(1)
    constant = random.uniform(0.5, 2.0, motors)
    known = {name: value * constant for name, value in box.known.items()}
    many = MotorWhiteBox(
        box.context_nodes, box.torque_constant * constant, known, box.speed_measured
    )
    values = np.array(theta) * random.uniform(0.7, 1.4, (motors, len(theta)))
    both = [
        Forecasting(
            Predictor(
                many,
                motors,
                np.array(theta),
                TrainingSettings(),
                speed_measured=box.speed_measured,
                device=device,
            ),
            TrainingSettings(),
            idle,
        )
        for device in (None, torch_name)
    ]
    assert both[0].predictor._axis.arrays is np
    assert isinstance(both[1].predictor._axis.arrays, TorchOps)
    voltage = random.uniform(-15.0, 15.0, motors)
    for k in range(30):
        voltage = np.where(
            random.random(motors) < 0.2, random.uniform(-15.0, 15.0, motors), voltage
        )
        interval = np.where(random.random(motors) < 0.03, 0.0, 0.01) if k else np.zeros(motors)
        present = None if random.random() < 0.7 else random.random(motors) < 0.9
        torque = random.normal(0.0, 0.05, motors)
        speed = random.normal(0.0, 5.0, motors)
        sample = Sample(k * 10_000_000, interval, voltage, torque, speed, present)
        said = [one.predict(interval, voltage, values) for one in both]
        if said[1].memory is not None:
            assert isinstance(said[1].memory.hidden, torch.Tensor)
            assert said[1].memory.hidden.device.type == torch.device(torch_name).type
        for name in ('torque_nm', 'white_box_torque_nm'):
            by_numpy, on_device = (getattr(prediction, name) for prediction in said)
            assert isinstance(on_device, np.ndarray)
            np.testing.assert_allclose(on_device, by_numpy, rtol=1e-9, atol=1e-15, err_msg=name)
        ahead = [
            one.forecast(0.3, voltage, values, since) for one, since in zip(both, said, strict=True)
        ]
        np.testing.assert_allclose(ahead[1], ahead[0], rtol=1e-9, atol=1e-15)
        for one, prediction in zip(both, said, strict=True):
            one.learn(sample, prediction, values)
    assert np.isfinite(by_numpy).sum() > motors // 2
    other = Weights.initial(5, 12, 3).arrays()
    for one in both:
        one.restore(other)
    said = [one.predict(np.full(motors, 0.01), voltage, values) for one in both]
    np.testing.assert_allclose(said[1].torque_nm, said[0].torque_nm, rtol=1e-9, atol=1e-15)
    np.testing.assert_array_equal(both[1].state()['input'], other['input'])
