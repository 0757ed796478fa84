from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from dc_motor_sim.simulation import Recording
from gray_box_observer.context_nodes import Verdict
from gray_box_observer.observer.builder import motor_observer
from gray_box_observer.observer.motor_observer import MotorObserver
from gray_box_observer.observer.observer import Observer, Result
from gray_box_observer.predictor import InlineTraining, Predictor
from gray_box_observer.predictor.elementwise import Floats
from gray_box_observer.predictor.steady_state import course, flow
from gray_box_observer.samples import Rejection
from gray_box_observer.settings.configuration import Configuration
from gray_box_observer.white_box import MotorWhiteBox

FAST: dict[str, Any] = {
    'training.hidden': 3,
    'training.context': 8,
    'training.period': 50,
    'training.steps': 3,
    'training.minibatch': 4,
}


def observer(training: Any = None, **given: Any) -> Observer:
    return Observer(Configuration.from_flat({**FAST, **given}), training)


def feed(
    one: Observer, recording: Recording, count: int | None = None, ask: bool = False
) -> list[Result]:
    results: list[Result] = []
    for k in range(count or recording.stamp_ns.size):
        stamp = int(recording.stamp_ns[k])
        for m, motor in enumerate(recording.motors):
            results += one.voltage(motor, stamp, float(recording.voltage_v[m, k]))
            if ask:
                one.forecast(motor, stamp)
            results += one.torque(motor, stamp, float(recording.torque_nm[m, k]))
    return results


def trace(results: list[Result]) -> list[bytes]:
    lines = []
    for r in results:
        said = b'' if r.prediction is None else r.prediction.torque_nm.tobytes()
        found = (
            b''
            if r.estimate is None
            else r.estimate.value.tobytes() + r.estimate.covariance.tobytes()
        )
        lines.append(r.motor.encode() + said + found)
    return lines


@pytest.mark.slow
def test_it_identifies_the_motor_of_the_thesis(record: Callable[..., Recording]) -> None:
    one = observer()
    results = feed(one, record())
    assert len(results) == 6000
    estimate = one.estimates()['motor']
    np.testing.assert_allclose(estimate.value, [[0.5, 1.0, 10.0]], rtol=0.02)
    assert estimate.identified(0)


@pytest.mark.slow
@pytest.mark.parametrize('variant', ['physics', 'main'])
def test_the_same_samples_give_the_same_bytes(
    record: Callable[..., Recording], variant: str
) -> None:
    recording = record(duration_s=6.0)
    first, second = (
        trace(feed(observer(InlineTraining, variant=variant), recording, 400)) for _ in range(2)
    )
    assert first == second


@pytest.mark.slow
def test_it_does_not_matter_when_a_result_is_asked_for_what_was_left_to_be_done(
    record: Callable[..., Recording],
) -> None:
    recording = record('R[5,15]D[0.2,3]', 12.0, torque_noise_std=1.2e-4)
    torque_nm = np.where(np.arange(1200) < 1000, 1.0, 0.6) * recording.torque_nm[0]
    told = []
    states = []
    for at_once, foretold in ((True, False), (False, True), (False, False)):
        one = observer(InlineTraining, **{'alarm.learn': 400})
        results = []
        for k, stamp in enumerate(recording.stamp_ns.tolist()):
            taken = one.ingest('voltage', ('motor',), stamp, [float(recording.voltage_v[0, k])])
            if (
                foretold
            ):  # predicted before the last sample is settled, as a node does after an update
                one.forecast('motor', stamp)
            taken += one.ingest('torque', ('motor',), stamp, [float(torque_nm[k])])
            if at_once:
                assert all(result.alarm.size == 1 for result in taken)
            results += taken
        told.append([(trace(list(result))[0], bool(result.alarm[0])) for result in results])
        states.append(one.motors['motor'].state())
        one.close()
    assert told[0] == told[1] == told[2]
    assert any(alarm for _, alarm in told[0])
    for plain, arrays in states[1:]:
        assert plain == states[0][0]
        for name, array in arrays.items():
            np.testing.assert_array_equal(array, states[0][1][name], err_msg=name)


@pytest.mark.slow
@pytest.mark.parametrize('variant', ['physics', 'main'])
def test_what_is_foreseen_is_what_is_predicted_and_nothing_but_its_time_changes(
    record: Callable[..., Recording], variant: str
) -> None:
    recording = record('R[5,15]D[0.05,0.5]', 8.0, torque_noise_std=8.7e-5)
    stamps = recording.stamp_ns.copy()
    draw = np.random.default_rng(1)
    stamps[300:400] += draw.integers(-1_000_000, 1_000_000, 100)  # uneven: nothing can be foreseen
    stamps[550:] += 2_000_000_000  # a gap
    told = []
    states = []
    for foreseen in (False, True):
        one = observer(InlineTraining, variant=variant)
        results = []
        for k, stamp in enumerate(stamps.tolist()):
            results += one.ingest('voltage', ('motor',), stamp, [float(recording.voltage_v[0, k])])
            one.forecast('motor', stamp)
            results += one.ingest('torque', ('motor',), stamp, [float(recording.torque_nm[0, k])])
            if foreseen:
                one.precompute_forecast(one.group_of('motor'))
        told.append([trace(list(result))[0] for result in results])
        states.append(one.motors['motor'].observer.state())
    assert len(told[0]) == len(stamps)
    assert told[0] == told[1]
    plain, arrays = zip(*states, strict=True)
    assert plain[0] == plain[1]
    assert all(
        np.array_equal(array, arrays[1][name], equal_nan=True) for name, array in arrays[0].items()
    )


@pytest.mark.slow
@pytest.mark.parametrize('names', [('a',), ('a', 'b', 'c')])
def test_whatever_befalls_the_motors_nothing_is_told_that_was_foreseen_of_something_else(
    record: Callable[..., Recording], names: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    recording = record('R[5,15]D[0.05,0.5]', 10.0, motors=names, torque_noise_std=8e-5)
    told = [_what_befalls(recording, foreseen=True)]
    predict = MotorObserver.predict

    def predict_anew(self: MotorObserver, *question: Any) -> Any:
        self._precomputed = None
        return predict(self, *question)

    monkeypatch.setattr(MotorObserver, 'predict', predict_anew)
    told.append(_what_befalls(recording, foreseen=False))
    assert len(told[0]) > 2500
    assert told[0] == told[1]


def _what_befalls(recording: Recording, *, foreseen: bool) -> list[bytes]:
    """Results of motors whose signals and observer meet everything, at seeded random instants."""
    names = recording.motors
    told = []
    random = np.random.default_rng(5)
    shift_ns = 0
    given: dict[str, Any] = {'motors': list(names), 'group_from': 2}
    one = observer(InlineTraining, **given)
    saved = None
    for k, stamp in enumerate((recording.stamp_ns + 1_000_000_000).tolist()):
        event = int(random.integers(0, 200))
        shift_ns += {0: 700_000_000, 1: -1_500_000_000, 2: 3_000_000}.get(
            event, 0
        )  # a gap, a clock set back, a jerk
        if event in (3, 4):
            one.freeze(event == 3)
        elif event == 5:
            one.reconfigure(
                Configuration.from_flat(
                    {**FAST, **given, 'alarm.memory': 100 + k, 'freeze': one.frozen}
                )
            )
        elif event == 6:
            saved = {name: copy.deepcopy(one.motors[name].state()) for name in names}
        elif event in (7, 8) and saved is not None:
            one.restore(saved, [names])
        values = {
            'voltage': recording.voltage_v[:, k].copy(),
            'torque': recording.torque_nm[:, k].copy(),
        }
        if event in (9, 10):
            values['voltage' if event == 9 else 'torque'][random.integers(0, len(names))] = np.nan
        for signal in ('torque', 'voltage') if event % 20 == 11 else ('voltage', 'torque'):
            if (event, signal) in ((12, 'voltage'), (13, 'torque')):
                continue  # lost
            results = one.ingest(signal, names, stamp + shift_ns, values[signal])
            told += [r.prediction.torque_nm.tobytes() for r in results if r.prediction is not None]
            for group in one.groups(names):
                ahead = one.forecast_group(group, stamp + shift_ns)
                held = one.forecast_group_held(group, 0.05) if event % 10 == 0 else None
                told += [ahead.tobytes()] if ahead is not None else []
                told += [held[1].tobytes()] if held is not None else []
            for result in results if foreseen else ():
                one.precompute_forecast(result.group)
            told += [line for result in results if event % 3 for line in trace(list(result))]
    return told


def test_where_samples_come_evenly_a_forecast_has_been_worked_out_before_its_voltage_comes(
    record: Callable[..., Recording], monkeypatch: pytest.MonkeyPatch
) -> None:
    recording = record('R[5,15]D[0.05,0.5]', 1.0)
    asked = []
    predict = Predictor.predict

    def counted(self: Predictor, *question: Any) -> Any:
        asked.append(question)
        return predict(self, *question)

    monkeypatch.setattr(Predictor, 'predict', counted)
    one = observer(InlineTraining)
    late = []
    for k, stamp in enumerate(recording.stamp_ns.tolist()):
        one.voltage('motor', stamp, float(recording.voltage_v[0, k]))
        before = len(asked)
        one.forecast('motor', stamp)
        one.torque('motor', stamp, float(recording.torque_nm[0, k]))
        late += [k] if len(asked) > before else []
        one.precompute_forecast(one.group_of('motor'))
    assert late == [0, 1, 2], 'the first two intervals have to be seen'


@pytest.mark.slow
def test_another_seed_trains_another_network(record: Callable[..., Recording]) -> None:
    recording = record(duration_s=6.0)
    first, second = (
        trace(feed(observer(InlineTraining, variant='main', seed=k), recording, 400))
        for k in range(2)
    )
    assert first != second


@pytest.mark.slow
def test_forecasting_changes_nothing(record: Callable[..., Recording]) -> None:
    recording = record(duration_s=6.0)
    assert trace(feed(observer(InlineTraining), recording, 400, ask=True)) == trace(
        feed(observer(InlineTraining), recording, 400)
    )


def test_a_forecast_is_the_prediction_that_is_scored_later(
    record: Callable[..., Recording],
) -> None:
    recording = record(duration_s=6.0)
    one = observer(InlineTraining)
    compared = 0
    for k, stamp in enumerate(recording.stamp_ns.tolist()):
        one.voltage('motor', stamp, float(recording.voltage_v[0, k]))
        forecast = one.forecast('motor', stamp)
        (result,) = one.torque('motor', stamp, float(recording.torque_nm[0, k]))
        if forecast is not None:
            compared += 1
            assert result.prediction is not None
            assert (forecast.stamp_ns, forecast.torque_nm) == (
                stamp,
                result.prediction.torque_nm[0],
            )
    assert compared > 300
    skill = one.skill('motor')
    assert skill is not None
    assert skill.samples == compared


@pytest.mark.slow
@pytest.mark.parametrize('torque_first', [False, True])
@pytest.mark.parametrize('horizon_s', [0.005, 0.1, 1.0])
def test_a_voltage_that_is_held_leads_where_the_physics_says(
    record: Callable[..., Recording],
    thesis_box: MotorWhiteBox,
    horizon_s: float,
    torque_first: bool,
) -> None:
    recording = record('R[5,15]D[0.05,1]', 6.5, solver_step_s=0.002)
    one = observer(InlineTraining)
    far = []
    for k, stamp in enumerate(recording.stamp_ns.tolist()):
        voltage_v = float(recording.voltage_v[0, k])
        torque_nm = float(recording.torque_nm[0, k])
        if torque_first:
            one.torque('motor', stamp, torque_nm)
        one.voltage('motor', stamp, voltage_v)
        before = one.forecast('motor', stamp)
        said = one.forecast_held('motor', horizon_s)
        assert one.forecast('motor', stamp) == before, 'nothing has changed'
        if not torque_first:
            one.torque('motor', stamp, torque_nm)
        if k < 500:
            continue
        assert said is not None
        assert said.stamp_ns == stamp + round(horizon_s * 1e9)
        way = course(Floats, thesis_box, [0.5, 1.0, 10.0], voltage_v, 0.0, 0.0)
        far.append(
            said.torque_nm - 0.01 * flow(Floats, thesis_box, way, torque_nm / 0.01, horizon_s, 0.01)
        )
    assert np.abs(far).max() < 0.01 * recording.torque_nm.std()


def test_no_voltage_that_is_held_leads_anywhere_without_predictor_history_or_in_time(
    record: Callable[..., Recording],
) -> None:
    recording = record(duration_s=6.0)
    one = observer(InlineTraining)
    assert one.forecast_held('motor', 0.1) is None
    feed(one, recording, 100)
    assert one.forecast_held('motor', 0.1) is not None
    for stamp in (
        1_100_000_000,
        1_400_000_000,
    ):  # the first of them is learnt by patience, without its voltage
        one.torque('motor', stamp, 0.01)
    assert one.counts('motor').held_count == 1
    assert one.forecast_held('motor', 0.1) is None
    without = observer()
    feed(without, recording, 100)
    assert without.forecast_held('motor', 0.1) is None


def test_a_delayed_voltage_is_held_from_where_it_acts(record: Callable[..., Recording]) -> None:
    recording = record(duration_s=6.0)
    prompt, late = (observer(InlineTraining, **{'motor.delay': delay_s}) for delay_s in (0.0, 0.02))
    feed(prompt, recording, 300)
    for k, stamp in enumerate(recording.stamp_ns[:300].tolist()):
        late.voltage('motor', stamp - 20_000_000, float(recording.voltage_v[0, k]))
        late.torque('motor', stamp, float(recording.torque_nm[0, k]))
    assert late.forecast_held('motor', 0.3) == prompt.forecast_held('motor', 0.3)


def test_nothing_is_forecast_of_a_motor_without_predictor_or_history(
    record: Callable[..., Recording],
) -> None:
    one = observer()
    assert one.forecast('motor', 0) is None
    assert one.skill('motor') is None
    feed(one, record(duration_s=6.0), 200)
    one.voltage('motor', 10**10, 1.0)
    assert one.forecast('motor', 10**10) is None


def test_motors_do_not_disturb_each_other(record: Callable[..., Recording]) -> None:
    recording = record('R[5,15]D[0.2,2]', 6.0, 1, ('a', 'b'))
    both = feed(observer(motors=['a', 'b']), recording)
    only = observer(motors=['b'])
    alone: list[Result] = []
    for k, stamp in enumerate(recording.stamp_ns.tolist()):
        alone += only.voltage('b', stamp, float(recording.voltage_v[1, k]))
        alone += only.torque('b', stamp, float(recording.torque_nm[1, k]))
    assert trace([r for r in both if r.motor == 'b']) == trace(alone)


def test_freezing_reaches_motors_seen_before_and_after(record: Callable[..., Recording]) -> None:
    recording = record('R[5,15]D[0.2,2]', 6.0, 1, ('a', 'b'))
    one = observer(motors=['a', 'b'])
    stamp = 0
    for k in range(200):
        stamp = int(recording.stamp_ns[k])
        one.voltage('a', stamp, float(recording.voltage_v[0, k]))
        one.torque('a', stamp, float(recording.torque_nm[0, k]))
    one.freeze(True)
    before = copy.deepcopy(one.estimates()['a'].value)
    results = feed(one, recording)
    assert one.frozen
    assert all(r.estimate is None for r in results)
    np.testing.assert_array_equal(one.estimates()['a'].value, before)
    assert {v for e in one.estimates().values() for v in e.verdicts[0]} == {Verdict.FROZEN}
    assert observer(freeze=True).frozen


@pytest.mark.slow
def test_freezing_stops_the_training_of_the_predictor_and_thawing_lets_it_go_on(
    record: Callable[..., Recording],
) -> None:
    recording = record(duration_s=12.0)
    one = observer(InlineTraining, variant='main')
    feed(one, recording, 400)
    forecasting = one.group_of('motor').observer.forecasting
    assert forecasting is not None
    one.freeze(True)
    jobs = forecasting.training.jobs_done
    network = forecasting.state()
    results = feed(one, recording, 800)
    assert jobs > 0
    assert forecasting.training.jobs_done == jobs
    for name, array in network.items():
        if not name.startswith('seen_'):
            np.testing.assert_array_equal(forecasting.state()[name], array, err_msg=name)
    assert all(
        r.prediction is not None and np.isfinite(r.prediction.torque_nm[0]) for r in results[-100:]
    )
    one.freeze(False)
    feed(one, recording)
    assert forecasting.training.jobs_done > jobs
    frozen = observer(InlineTraining, freeze=True)
    feed(frozen, recording, 400)
    assert frozen.group_of('motor').observer.forecasting is not None
    assert frozen.group_of('motor').observer.forecasting.training.jobs_done == 0


def test_a_motor_whose_torque_brings_speed_has_measured_speed() -> None:
    for source, expected in (('auto', True), ('measured', True), ('torque_constant', False)):
        one = observer(**{'motor.speed_source': source})
        one.voltage('motor', 0, 5.0)
        one.torque('motor', 0, 0.1, 3.0)
        assert one.motors['motor'].white_box.speed_measured is expected


@pytest.mark.parametrize(
    'given',
    [
        {'motor.speed_source': 'measured'},
        {'motor.context_nodes': ['inductance', 'resistance', 'back_emf_constant']},
    ],
    ids=['measured', 'Kb among the context nodes'],
)
def test_torque_without_the_speed_that_a_motor_needs_is_counted_until_speed_comes(
    given: dict[str, Any],
) -> None:
    one = observer(**given)
    one.voltage('motor', 0, 5.0)
    assert one.torque('motor', 0, 0.1) == []
    assert one.counts('motor').rejected == {Rejection.NO_SPEED: 1}
    one.voltage('motor', 10_000_000, 5.0)
    assert len(one.torque('motor', 10_000_000, 0.1, 3.0)) == 1
    assert one.motors['motor'].white_box.speed_measured


def test_flush_learns_what_still_waits(record: Callable[..., Recording]) -> None:
    one = observer()
    one.voltage('motor', 0, 5.0)
    one.torque('motor', 0, 0.1)
    one.torque('motor', 10_000_000, 0.1)
    assert [r.sample.stamp_ns for r in one.flush()] == [10_000_000]
    assert one.flush() == []


@pytest.mark.slow
def test_a_missing_speed_in_between_does_not_silence_the_predictor_for_good() -> None:
    one = observer(InlineTraining, **{'motor.torque_constant': 0.05})
    random = np.random.default_rng(0)
    said = []
    for k in range(800):
        stamp = k * 10_000_000
        one.voltage('motor', stamp, float(random.uniform(5.0, 10.0)))
        speed = np.nan if k == 320 else 10.0 + float(random.normal())
        for result in one.torque('motor', stamp, 0.1 + 0.01 * float(random.normal()), speed):
            assert result.prediction is not None
            said.append(float(result.prediction.torque_nm[0]))
    one.close()
    assert np.isfinite(said[200:319]).all()
    assert np.isfinite(said[-100:]).all()


@pytest.mark.slow
@pytest.mark.parametrize('signal', ['torque', 'voltage', 'either'])
def test_a_reading_of_zero_in_one_sample_of_fifty_is_left_out_and_is_no_change_of_the_motor(
    record: Callable[..., Recording], signal: str
) -> None:
    recording = record('R[5,15]D[0.1,1]', 40.0, 7, torque_noise_std=1e-4)
    draw = np.random.default_rng(1)
    lost = draw.random((2, recording.stamp_ns.size)) < (0.01 if signal == 'either' else 0.02)
    lost[0] &= signal != 'torque'
    lost[1] &= signal != 'voltage'
    lost[:, :100] = False
    voltage, torque = np.where(lost, 0.0, [recording.voltage_v[0], recording.torque_nm[0]])
    observer = Observer(Configuration.from_flat({'predictor': False}))
    for k, stamp in enumerate(recording.stamp_ns.tolist()):
        observer.voltage('motor', stamp, float(voltage[k]))
        observer.torque('motor', stamp, float(torque[k]))
    estimate = observer.estimates()['motor']
    counters = observer.motors['motor'].counters
    assert np.all(np.abs(estimate.value[0] - [0.5, 1.0, 10.0]) < 4.0 * estimate.std[0])
    assert np.all(estimate.std[0] < 0.005 * estimate.value[0])
    assert counters['motor changes'] == 0
    assert counters['torque outliers'] < 1.5 * lost[1].sum() + 100 * (signal != 'torque')


@pytest.mark.parametrize('rule', ['recursive', 'gradient'])
def test_whoever_says_twice_that_learning_goes_on_begins_a_new_history_all_the_same(
    record: Callable[..., Recording], rule: str
) -> None:
    recording = record(duration_s=6.0)
    one = observer(InlineTraining, context_update=rule)
    feed(one, recording, 100)
    one.freeze(True)
    for k in range(100, 120):
        stamp = int(recording.stamp_ns[k])
        one.voltage('motor', stamp, float(recording.voltage_v[0, k]))
        one.torque('motor', stamp, float(recording.torque_nm[0, k]))
    for _ in range(2):
        one.freeze(False)
    stamp = int(recording.stamp_ns[120])
    one.voltage('motor', stamp, float(recording.voltage_v[0, 120]))
    (result,) = one.torque('motor', stamp, float(recording.torque_nm[0, 120]))
    assert result.sample.interval_s[0] > 0.0
    motor = one.group_of('motor').observer
    for replay in (motor.context_nodes.replay, motor.forecasting.training.replay):
        assert replay.interval_s(3)[0].tolist() == [0.01, 0.01, 0.0]


def test_nothing_is_precomputed_before_the_first_sample() -> None:
    configuration = Configuration.from_flat({})
    motors = list(configuration.motors.values())
    observer = motor_observer(configuration, motors, InlineTraining, speed_measured=False)
    observer.precompute_forecast(5.0)
    observer.close()
