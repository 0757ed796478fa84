"""A test of the fit goes on behind samples, and its result counts with the next estimate."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from gray_box_observer.checkpoints import checkpoint
from gray_box_observer.context_nodes import Estimate
from gray_box_observer.context_nodes.pieces import Pieces
from gray_box_observer.errors import CheckpointError
from gray_box_observer.fit_test.assessment import FitAssessment, FitVerdict
from gray_box_observer.fit_test.evidence import NO_EVIDENCE
from gray_box_observer.fit_test.fit_result import FitResult
from gray_box_observer.fit_test.motor_under_test import MotorUnderTest
from gray_box_observer.fit_test.policy import Judgement
from gray_box_observer.fit_test.window_test import WindowTest
from gray_box_observer.observer.builder import context_nodes
from gray_box_observer.observer.deferred_fit_test import ALONE, DeferredFitTest
from gray_box_observer.observer.motor_observer import MotorObserver
from gray_box_observer.observer.observer import Observer
from gray_box_observer.samples import Sample
from gray_box_observer.settings.configuration import Configuration

INTERVAL_NS = 1_000_000
TORQUE_CONSTANT = 0.01
BLOCK = 32
OFFSET_FROM = 1500
SAMPLES = 5000
FOLLOWED = 3000

RESULT = FitResult(
    FitAssessment(FitVerdict.OK, 1.0, 1.0, (), 64),
    Judgement(FitVerdict.OK, np.ones(2), np.zeros((2, 2))),
    np.ones(2), 64, 0, 64, 1.0, 0, 0.1, True, NO_EVIDENCE,
)  # fmt: skip


def work(done: list[int]) -> Pieces[FitResult]:
    """Three pieces, which are noted."""
    for piece in range(3):
        done.append(piece)
        yield 1
    return RESULT


def test_it_gets_on_by_a_piece_a_sample_however_often_that_is_asked_for() -> None:
    done: list[int] = []
    test = DeferredFitTest(work(done))
    test.advance()
    assert done == [], 'it begins behind the next sample'
    for count in range(1, 4):
        test.begin_sample()
        test.advance()
        test.advance()
        assert len(done) == count
    assert test.result() is RESULT
    assert test.result() is RESULT
    assert done == [0, 1, 2]


def test_its_result_can_be_had_at_once() -> None:
    done: list[int] = []
    assert DeferredFitTest(work(done)).result() is RESULT
    assert done == [0, 1, 2]
    assert DeferredFitTest(RESULT).result() is RESULT


@pytest.fixture(scope='module')
def signals() -> tuple[np.ndarray, np.ndarray]:
    """Voltage and torque of a motor whose current gets an offset: verdicts change."""
    random = np.random.default_rng(1)
    voltage_v = np.repeat(random.uniform(5.0, 15.0, SAMPLES // 100), 100)
    current_a = np.zeros(SAMPLES)
    for k in range(1, SAMPLES):
        i = current_a[k - 1]
        for _ in range(4):
            balance_v = voltage_v[k - 1] - i - 10.0 * TORQUE_CONSTANT * abs(i) * i
            i += 0.25e-3 * balance_v / 0.5
        current_a[k] = i
    noisy_a = current_a + random.normal(0.0, 0.02, SAMPLES)
    noisy_a[OFFSET_FROM:] += 0.08
    return voltage_v, TORQUE_CONSTANT * noisy_a


def feed(observer: Observer, signals: tuple[np.ndarray, np.ndarray], k: int) -> list[bytes]:
    """Take one sample; return what is told then, verdict of the fit included."""
    stamp_ns = (k + 1) * INTERVAL_NS
    observer.voltage('motor', stamp_ns, float(signals[0][k]))
    results = observer.torque('motor', stamp_ns, float(signals[1][k]))
    told = [digest(one.estimate) for one in results if one.estimate is not None]
    return [*told, observer.fit('motor').verdict.value.encode()]


def digest(estimate: Estimate) -> bytes:
    """Return an estimate as bytes."""
    return (
        estimate.value.tobytes() + estimate.covariance.tobytes() + repr(estimate.verdicts).encode()
    )


@pytest.fixture(scope='module')
def configuration() -> Configuration:
    """Without a predictor."""
    return Configuration.from_flat({'predictor': False})


@pytest.fixture(scope='module')
def undisturbed(
    configuration: Configuration, signals: tuple[np.ndarray, np.ndarray]
) -> list[list[bytes]]:
    """What is told at every sample while nobody asks."""
    observer = Observer(configuration)
    return [feed(observer, signals, k) for k in range(FOLLOWED)]


def observer_of(observer: Observer) -> MotorObserver:
    """Return that of the motor."""
    found = observer.group_of('motor').observer
    assert found is not None
    return found


def has_open_test(observer: Observer) -> bool:
    """Whether a test has begun whose result does not count yet."""
    return 'later' in observer_of(observer).state()[0]['fit']


def until_open(observer: Observer, signals: tuple[np.ndarray, np.ndarray], after: int = 200) -> int:
    """Feed a motor until a test has begun that does not count yet; return the samples."""
    k = 0
    while not (k > after and has_open_test(observer)):
        feed(observer, signals, k)
        k += 1
    return k


def sample_of(signals: tuple[np.ndarray, np.ndarray], k: int) -> Sample:
    """Return a sample as pairing makes it."""
    voltage_v = float(signals[0][k - 1])
    torque_nm = float(signals[1][k])
    return Sample.of_one_motor((k + 1) * INTERVAL_NS, 1e-3, voltage_v, torque_nm)


@pytest.mark.slow
def test_whoever_asks_or_saves_changes_nothing(
    configuration: Configuration,
    signals: tuple[np.ndarray, np.ndarray],
    undisturbed: list[list[bytes]],
) -> None:
    assert {told[-1] for told in undisturbed} >= {b'ok', b'untested'}
    observer = Observer(configuration)
    open_count = 0
    for k in range(FOLLOWED):
        assert feed(observer, signals, k) == undisturbed[k], k
        open_count += has_open_test(observer)
        observer_of(observer).retested()
        observer.estimates()
    assert open_count > BLOCK


@pytest.mark.slow
def test_who_goes_on_from_a_checkpoint_in_the_middle_of_a_test_has_its_result(
    configuration: Configuration, signals: tuple[np.ndarray, np.ndarray], tmp_path: Path
) -> None:
    observer = Observer(configuration)
    resumed: Observer | None = None
    count = 0
    for k in range(FOLLOWED):
        feed(observer, signals, k)
        is_open = has_open_test(observer)
        if is_open and resumed is None:
            path = tmp_path / f'{k}.safetensors'
            checkpoint.save(observer, path)
            resumed = Observer(configuration)
            checkpoint.load(resumed, path)
            assert has_open_test(resumed)
        elif resumed is not None and not is_open:
            assert resumed.fit('motor').samples < observer.fit('motor').samples
            resumed.finish()
            assert resumed.fit('motor') == observer.fit('motor')
            resumed = None
            count += 1
    assert count >= 2


def test_a_checkpoint_with_absurd_results_is_refused(
    configuration: Configuration, signals: tuple[np.ndarray, np.ndarray]
) -> None:
    observer = Observer(configuration)
    until_open(observer, signals)
    plain, arrays = observer_of(observer).state()
    cast(Any, plain['fit']['later'])['wait'] = -1
    with pytest.raises(CheckpointError, match='wait'):
        Observer(configuration).restore({'motor': (plain, arrays)})


@pytest.mark.slow
def test_at_the_end_of_a_recording_it_counts(
    configuration: Configuration, signals: tuple[np.ndarray, np.ndarray]
) -> None:
    observer = Observer(configuration)
    until_open(observer, signals, OFFSET_FROM)
    before = digest(observer.estimates()['motor'])
    assert observer.finish() == ('motor',)
    assert digest(observer.estimates()['motor']) != before
    assert not has_open_test(observer)
    assert observer.finish() == ()


def test_one_that_fails_stops_the_motor_once(
    configuration: Configuration,
    signals: tuple[np.ndarray, np.ndarray],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    observer = Observer(configuration)
    k = until_open(observer, signals)

    def fail(_test: DeferredFitTest) -> None:
        raise ZeroDivisionError('a piece')

    monkeypatch.setattr(DeferredFitTest, 'result', fail)
    while 'motor' not in observer.incidents:
        stamp_ns = (k + 1) * INTERVAL_NS
        observer.voltage('motor', stamp_ns, float(signals[0][k]))
        observer.torque('motor', stamp_ns, float(signals[1][k]))
        k += 1
    assert 'a piece' in observer.incidents['motor'].reason


def test_its_pieces_are_done_behind_samples_and_none_is_left_for_the_next_estimate(
    configuration: Configuration,
    signals: tuple[np.ndarray, np.ndarray],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tests: list[list[int]] = []
    pieces_of = WindowTest.pieces

    def pieces(test: WindowTest, motor: MotorUnderTest, count: int) -> Pieces[FitResult]:
        work = pieces_of(test, motor, count)
        places: list[int] = []
        if has_passed:
            tests.append(places)
        while True:
            places.append(k)
            try:
                size = next(work)
            except StopIteration as end:
                return end.value
            yield size

    monkeypatch.setattr(WindowTest, 'pieces', pieces)
    observer = Observer(configuration)
    has_passed = False
    for k in range(OFFSET_FROM):
        feed(observer, signals, k)
        has_passed = observer.fit('motor').verdict is FitVerdict.OK
        if k > 0:
            observer_of(observer).retested()
    assert len(tests) > 2
    assert max(len(places) for places in tests) > ALONE
    for places in tests:
        first = places[0]
        one_each = [first + turn for turn in range(ALONE)]
        two_each = [first + ALONE + turn // 2 for turn in range(len(places))]
        assert places == (one_each + two_each)[: len(places)]


def test_freezing_lets_it_count(
    configuration: Configuration, signals: tuple[np.ndarray, np.ndarray]
) -> None:
    observer = Observer(configuration)
    until_open(observer, signals)
    before = observer.fit('motor').samples
    observer.freeze(True)
    assert not has_open_test(observer)
    assert observer.fit('motor').samples > before


def test_one_that_is_restored_into_a_frozen_observer_counts(
    configuration: Configuration, signals: tuple[np.ndarray, np.ndarray], tmp_path: Path
) -> None:
    observer = Observer(configuration)
    until_open(observer, signals)
    checkpoint.save(observer, tmp_path / 'state.safetensors')
    frozen = Observer(Configuration.from_flat({'predictor': False, 'freeze': True}))
    checkpoint.load(frozen, tmp_path / 'state.safetensors')
    assert not has_open_test(frozen)
    observer.freeze(True)
    assert frozen.fit('motor') == observer.fit('motor')


def test_samples_that_are_paired_anew_leave_nothing_of_it(
    configuration: Configuration, signals: tuple[np.ndarray, np.ndarray]
) -> None:
    observer = Observer(configuration)
    count = until_open(observer, signals)
    motor = observer_of(observer)
    samples = [sample_of(signals, k) for k in range(1, count)]
    motors = list(configuration.motors.values())
    motor.relearn(context_nodes(configuration, motors, motor.white_box), samples)
    assert not has_open_test(observer)
    assert observer.fit('motor').verdict is FitVerdict.UNTESTED


def test_it_begins_with_its_own_sample_where_samples_are_learnt_again(
    configuration: Configuration, signals: tuple[np.ndarray, np.ndarray]
) -> None:
    fits = []
    for is_asked in (False, True):
        observer = Observer(configuration)
        count = until_open(observer, signals)
        motor = observer_of(observer)
        told = []
        for k in range(count, count + 1000):
            motor.update_parameters(sample_of(signals, k))
            if is_asked:
                motor.retested()
            told.append(observer.fit('motor') if k % 100 == 0 or is_asked else None)
        fits.append(told)
    pairs = [(one, two) for one, two in zip(*fits, strict=True) if one is not None]
    assert len(pairs) == 10
    assert all(one == two for one, two in pairs)
