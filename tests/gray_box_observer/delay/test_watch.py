from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Recording, Simulation
from gray_box_observer.checkpoints import checkpoint
from gray_box_observer.delay import DelayEstimate, DelayVerdict, DelayWatch, watch
from gray_box_observer.delay.fine import FineSearch
from gray_box_observer.observer.observer import Observer, Result
from gray_box_observer.predictor import InlineTraining
from gray_box_observer.settings.configuration import Configuration

RATE_HZ = 100.0
START_NS = 1_000_000_000
STEPS = 'R[5,15]D[0.2,2]'
NOISE_NM = 1.1e-4
"""One per cent of the standard deviation of the torque under STEPS."""


def trace(results: list[Result]) -> list[bytes]:
    return [
        b'' if r.estimate is None else r.estimate.value.tobytes() + r.estimate.covariance.tobytes()
        for r in results
    ]


@pytest.mark.slow
@pytest.mark.parametrize('intervals', [1, 5, 30])
@pytest.mark.parametrize(
    ('excitation', 'noise_nm'), [(STEPS, 2.0 * NOISE_NM), ('R[1,2]D[3,3]', 0.0)]
)
def test_a_delay_that_was_not_declared_is_flagged_with_its_remedy(
    record: Callable[..., Recording],
    observer: Any,
    feed: Any,
    intervals: int,
    excitation: str,
    noise_nm: float,
) -> None:
    one = observer()
    recording = record(excitation, 20.0, torque_noise_std=noise_nm)
    feed(one, recording, intervals / RATE_HZ, until=1200)
    found = one.delays()['motor']
    assert found.verdict is DelayVerdict.UNDECLARED
    assert found.applied_s == 0.0
    assert found.value_s == pytest.approx(intervals / RATE_HZ, abs=max(4.0 * found.std_s, 1e-4))
    complaint = found.complaint('left')
    assert complaint is not None
    assert complaint.startswith(
        f'voltage seems to lead torque by {found.value_s * 1e3:.3g} ms: set left.delay to '
    )
    assert complaint.endswith(' or to estimate')


@pytest.mark.slow
@pytest.mark.parametrize(
    ('excitation', 'torque_std_nm'),
    [
        ('R[1,2]D[3,3]', 2.0e-3),
        ('R[5,15]D[1,20]', 1.36e-2),
        ('R[5,15]D[0.001,2]', 1.09e-2),
        ('R[5,15]D[1,20]+v(t)', 1.36e-2),
    ],
)
@pytest.mark.parametrize('noise', [0.0, 0.02])
def test_nothing_is_flagged_where_there_is_no_delay(
    record: Callable[..., Recording],
    observer: Any,
    feed: Any,
    excitation: str,
    torque_std_nm: float,
    noise: float,
) -> None:
    one = observer()
    verdicts = set()
    recording = record(excitation, 46.0, seed=4, torque_noise_std=noise * torque_std_nm)
    for k in range(0, 4600, 50):
        feed(one, recording, first=k, until=k + 50)
        verdicts.add(one.delays()['motor'].verdict)
    assert verdicts <= {DelayVerdict.UNKNOWN, DelayVerdict.CONFIRMED}
    assert DelayVerdict.CONFIRMED in verdicts
    assert one.delays()['motor'].complaint('motor') is None


@pytest.mark.slow
@pytest.mark.parametrize(
    'schedule',
    ['motor.resistance=1.3@12', 'motor.resistance=1.0..1.3@0..25', 'motor.inductance=0.4@12'],
)
def test_a_motor_that_changes_is_not_taken_for_a_delay(
    record: Callable[..., Recording], observer: Any, feed: Any, schedule: str
) -> None:
    one = observer()
    recording = record(STEPS, 25.0, torque_noise_std=NOISE_NM, schedule=(schedule,))
    for k in range(0, 2500, 50):
        feed(one, recording, first=k, until=k + 50)
        assert one.delays()['motor'].verdict is not DelayVerdict.UNDECLARED


@pytest.mark.slow
def test_an_asked_for_delay_is_applied_and_the_motor_identified_as_if_it_had_been_declared(
    record: Callable[..., Recording], observer: Any, feed: Any
) -> None:
    recording = record(STEPS, 20.0, torque_noise_std=NOISE_NM)
    delay_s = 0.0537
    asked = observer(**{'motor.delay': 'estimate'})
    told = observer(**{'motor.delay': delay_s})
    deceived = observer()
    for one in (asked, told, deceived):
        feed(one, recording, delay_s, until=1200)
    found = asked.delays()['motor']
    assert found.verdict is DelayVerdict.ESTIMATED
    assert found.applied_s == pytest.approx(delay_s, abs=4.0 * found.std_s)
    assert found.std_s < 0.05 / RATE_HZ
    assert asked.counts('motor').delay_ns == round(found.applied_s * 1e9)
    truth = np.array([0.5, 1.0, 10.0])
    wrong = np.abs(deceived.estimates()['motor'].value[0] / truth - 1.0)
    right = [np.abs(one.estimates()['motor'].value[0] / truth - 1.0) for one in (asked, told)]
    assert wrong[0] > 0.01
    assert np.all(right[0] < right[1] + 0.002)


def test_a_declared_delay_is_confirmed_and_a_wrong_one_is_flagged(
    record: Callable[..., Recording], observer: Any, feed: Any
) -> None:
    recording = record(STEPS, 20.0, torque_noise_std=NOISE_NM)
    right = observer(**{'motor.delay': 0.05})
    wrong = observer(**{'motor.delay': 0.02})
    for one in (right, wrong):
        feed(one, recording, 0.05, until=1200)
    assert right.delays()['motor'].verdict is DelayVerdict.CONFIRMED
    said = wrong.delays()['motor'].complaint('motor')
    assert said is not None
    assert ', not by 20 ms: set motor.delay to 0.05' in said


def test_torque_that_leads_is_found_and_said_too(
    record: Callable[..., Recording], observer: Any, feed: Any
) -> None:
    one = observer()
    feed(one, record(STEPS, 20.0, torque_noise_std=NOISE_NM), -0.03, until=1200)
    said = one.delays()['motor'].complaint('motor')
    assert said is not None
    assert said.startswith('torque seems to lead voltage by ')
    assert 'set motor.delay to -0.0' in said
    assert one.delays()['motor'].value_s == pytest.approx(-0.03, abs=1e-3)


@pytest.mark.slow
def test_constant_voltage_tells_nothing_for_ever(
    record: Callable[..., Recording], observer: Any, feed: Any
) -> None:
    one = observer(**{'motor.delay': 'estimate'})
    recording = record('C[5]', 60.0, torque_noise_std=4e-5)
    feed(one, recording, 0.05, until=600)
    for k in range(600, 6000, 100):
        feed(one, recording, 0.05, first=k, until=k + 100)
        assert one.delays()['motor'].verdict is DelayVerdict.UNKNOWN
    assert one.delays()['motor'].applied_s == 0.0


@pytest.mark.slow
@pytest.mark.parametrize('delay', [0.053, -0.031])
def test_the_delay_is_applied_at_the_same_sample_with_the_same_bytes_whatever_comes_first(
    record: Callable[..., Recording], observer: Any, feed: Any, delay: float
) -> None:
    recording = record(STEPS, 20.0, torque_noise_std=NOISE_NM)
    traces = []
    for torque_late in (0, 1, 2, -1, -2):
        one = observer(**{'motor.delay': 'estimate'})
        results = feed(one, recording, delay, until=800, torque_late=torque_late)
        results += one.flush()
        assert one.delays()['motor'].verdict is DelayVerdict.ESTIMATED
        assert [r.sample.stamp_ns for r in results] == sorted({r.sample.stamp_ns for r in results})
        traces.append(
            (trace(results), one.delays()['motor'].applied_s, one.counts('motor').used_count)
        )
    assert all(t == traces[0] for t in traces[1:])


@pytest.mark.slow
@pytest.mark.parametrize('rule', ['recursive', 'gradient'])
def test_the_search_goes_on_where_nobody_waits_for_an_estimate_and_still_where_somebody_always_does(
    record: Callable[..., Recording],
    observer: Any,
    feed: Any,
    monkeypatch: pytest.MonkeyPatch,
    rule: str,
) -> None:
    worked: list[int] = []
    search = DelayWatch._search

    def counted(self: DelayWatch, *arguments: Any) -> Any:
        pieces = search(self, *arguments)
        while True:
            worked.append(self._progress.count)
            try:
                next(pieces)
            except StopIteration as end:
                return end.value
            yield

    monkeypatch.setattr(DelayWatch, '_search', counted)
    one = observer(context_update=rule, **{'gradient.batch_size': 1})
    results = feed(one, record(STEPS, 20.0, torque_noise_std=NOISE_NM), 0.05, until=1200)
    awaited = {k for k, result in enumerate(results, start=1) if result.estimate is not None}
    assert len(worked) > 20
    if rule == 'recursive':
        assert len(awaited) > 30
        assert not awaited.intersection(worked)
    assert one.delays()['motor'].verdict is DelayVerdict.UNDECLARED


def test_everything_received_is_still_used_or_rejected_or_waits_after_a_delay_was_applied(
    record: Callable[..., Recording], observer: Any, feed: Any
) -> None:
    for delay in (0.053, -0.031):
        one = observer(**{'motor.delay': 'estimate'})
        recording = record(STEPS, 20.0, torque_noise_std=NOISE_NM)
        results = feed(one, recording, delay, until=800)
        pairing = one.counts('motor')
        assert one.delays()['motor'].applied_s != 0.0
        assert (
            pairing.received_torque
            == pairing.used_count + pairing.rejected.total() + pairing.waiting_count
        )
        assert len(results) == pairing.used_count


def test_a_delay_that_grows_sharper_after_a_restart_costs_no_certainty_learnt_before_it(
    record: Callable[..., Recording], observer: Any, feed: Any, tmp_path: Path
) -> None:
    """A sharper delay relearns everything from the history that a restart has left behind."""
    recording = record('R[5,15]D[0.1,1]', 15.0, seed=3, torque_noise_std=5e-4)
    one, other = (observer(**{'motor.delay': 'estimate'}) for _ in range(2))
    feed(one, recording, 0.04, until=500)
    checkpoint.save(one, tmp_path / 'c')
    checkpoint.load(other, tmp_path / 'c')
    before = one.estimates()['motor']
    assert one.delays()['motor'].applied_s == pytest.approx(0.04, abs=0.003)
    results = feed(other, recording, 0.04, first=500, until=1500)
    told = [r.estimate for r in results if r.estimate is not None]
    assert max(float(np.max(estimate.std / before.std)) for estimate in told) < 1.1
    assert np.all(told[-1].std < before.std)


def test_a_clock_that_is_set_back_begins_a_new_history_and_keeps_the_delay(
    record: Callable[..., Recording], observer: Any, feed: Any
) -> None:
    one = observer(**{'motor.delay': 'estimate'})
    recording = record(STEPS, 20.0, torque_noise_std=NOISE_NM)
    feed(one, recording, 0.053, until=1200)
    before = one.delays()['motor'].applied_s
    assert before == pytest.approx(0.053, abs=0.002)
    results = feed(one, recording, 0.053, until=1200)
    assert len(results) == pytest.approx(1200, abs=15)
    assert one.delays()['motor'].applied_s == pytest.approx(before, abs=0.001)
    assert one.counts('motor').restarts == 1


@pytest.mark.slow
def test_gaps_duplicates_and_junk_do_not_hide_the_delay(
    record: Callable[..., Recording], observer: Any
) -> None:
    random = np.random.default_rng(5)
    one = observer()
    recording = record(STEPS, 20.0, torque_noise_std=NOISE_NM)
    for k, stamp_ns in enumerate(recording.stamp_ns.tolist()):
        if 1000 <= k < 1100 or random.random() < 0.03:
            continue
        volt = float(recording.voltage_v[0, k])
        torque = float(recording.torque_nm[0, k])
        stamps = [stamp_ns, stamp_ns] if random.random() < 0.05 else [stamp_ns]
        for stamp in stamps:
            one.voltage('motor', START_NS + stamp - 40_000_000, volt)
            one.torque('motor', START_NS + stamp, np.nan if random.random() < 0.01 else torque)
    found = one.delays()['motor']
    assert found.verdict is DelayVerdict.UNDECLARED
    assert found.value_s == pytest.approx(0.04, abs=max(4.0 * found.std_s, 2e-3))


def test_memory_is_bounded_whatever_comes_or_stays_away(observer: Callable[..., Observer]) -> None:
    one = observer()
    history = one.group_of('motor').pairing.history
    for k in range(24_000):
        one.voltage('motor', k * 1_000_000, 1.0)
    assert len(history) < 20_000
    for k in range(24_000, 34_000):
        one.torque('motor', k * 1_000_000, 0.1)
    assert len(history) < 30_000


def test_a_frozen_observer_applies_nothing(
    record: Callable[..., Recording], observer: Any, feed: Any
) -> None:
    one = observer(**{'motor.delay': 'estimate', 'freeze': True})
    feed(one, record(STEPS, 20.0, torque_noise_std=NOISE_NM), 0.05, until=1200)
    assert one.delays()['motor'].applied_s == 0.0


@pytest.mark.slow
def test_the_gradient_rule_goes_on_with_what_was_paired_anew(
    record: Callable[..., Recording], observer: Any, feed: Any
) -> None:
    one = observer(**{'motor.delay': 'estimate', 'context_update': 'gradient'})
    feed(one, record(STEPS, 40.0), 0.05)
    assert one.delays()['motor'].applied_s == pytest.approx(0.05, abs=1e-4)
    np.testing.assert_allclose(one.estimates()['motor'].value, [[0.5, 1.0, 10.0]], rtol=0.05)


@pytest.mark.slow
def test_the_predictor_goes_on_and_is_trained_on_what_was_paired_anew(
    record: Callable[..., Recording], feed: Any
) -> None:
    small = {
        'training.hidden': 3,
        'training.context': 8,
        'training.period': 50,
        'training.steps': 3,
    }
    one = Observer(Configuration.from_flat({**small, 'motor.delay': 'estimate'}), InlineTraining)
    recording = record(STEPS, 40.0)
    results = feed(one, recording, 0.05, until=1200)
    one.close()
    assert one.delays()['motor'].applied_s == pytest.approx(0.05, abs=1e-4)
    said = [r.prediction.torque_nm[0] for r in results[-200:] if r.prediction is not None]
    assert np.isfinite(said).all()
    assert len(said) == 200
    forecasting = one.group_of('motor').observer.forecasting
    assert forecasting is not None
    last = (
        results[-1].sample.stamp_ns - START_NS
    ) // 10_000_000  # the very last torque may wait for its voltage
    expected = recording.voltage_v[0, last - 1000 : last]
    np.testing.assert_allclose(
        forecasting.training.replay.voltage_v(1000)[0], expected, rtol=0.0, atol=0.05
    )


@pytest.mark.parametrize(
    ('known', 'said'),
    [
        (DelayEstimate(0.0, False), None),
        (DelayEstimate(0.0, False, 0.05, 0.001, DelayVerdict.SUSPECTED), None),
        (DelayEstimate(0.05, True, 0.05, 0.001, DelayVerdict.ESTIMATED), None),
        (
            DelayEstimate(0.0, False, 0.0531, 0.001, DelayVerdict.UNDECLARED),
            'voltage seems to lead torque by 53.1 ms: set m.delay to 0.0531 or to estimate',
        ),
    ],
)
def test_only_a_delay_that_was_not_declared_is_complained_of(
    known: DelayEstimate, said: str | None
) -> None:
    assert known.complaint('m') == said


@pytest.mark.slow
def test_fine_searches_in_vain_come_ever_rarer(
    observer: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A driver that loses voltage looks late at every search, and no delay is found."""
    begun_at: list[int] = []

    class Counted(watch.FineSearch):
        """Notes when it begins."""

        def __init__(self, *arguments: Any) -> None:
            begun_at.append(one.counts('motor').used_count)
            super().__init__(*arguments)

    monkeypatch.setattr(watch, 'FineSearch', Counted)
    constants = {'torque_constant': 0.03, 'back_emf_constant': 0.03}
    known = {f'motor.{name}': value for name, value in constants.items()}
    one = observer(**known, **{'motor.effects': 'none'})
    plant = PlantParameters(
        resistance=2.0, inductance=4e-3, hysteresis=1e-6, inertia=2e-5, viscous_friction=1e-5,
        coulomb_friction=1e-3, **constants,
    )  # fmt: skip
    recording = Simulation(
        {'motor': plant}, 'R[-12,12]D[0.05,0.5]', seed=1, start_ns=START_NS, speed_mode='rotor',
        torque_noise_std=1.9e-4, sample_rate_hz=500.0,
    ).record(2.6)  # fmt: skip
    commanded_v = recording.voltage_v[0] + 0.5 * np.sign(recording.torque_nm[0])
    for k, stamp_ns in enumerate(recording.stamp_ns.tolist()):
        one.voltage('motor', stamp_ns, float(commanded_v[k]))
        speed_rad_s = float(recording.speed_rad_s[0, k])
        one.torque('motor', stamp_ns, float(recording.torque_nm[0, k]), speed_rad_s)
    assert len(begun_at) >= 2
    assert all(later >= 1.9 * earlier for earlier, later in pairwise(begun_at)), begun_at


@pytest.mark.slow
def test_evidence_is_asked_for_only_against_a_delay_that_disagrees(
    record: Callable[..., Recording],
    observer: Any,
    feed: Any,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A fit at the delay in force is half of a fine search."""
    fits: dict[bool, int] = {}
    fit = FineSearch.fit

    def counted(search: FineSearch, delay_s: float, *, free: bool) -> Any:
        fits[free] = fits.get(free, 0) + 1
        return fit(search, delay_s, free=free)

    monkeypatch.setattr(FineSearch, 'fit', counted)
    kept = record(STEPS, 20.0, torque_noise_std=2.0 * NOISE_NM)
    agreeing = observer(**{'motor.delay': 'estimate'})
    feed(agreeing, kept, 0.0, until=1200)
    assert fits.get(True, 0) >= 1
    assert fits.get(False, 0) < fits[True]
    fits.clear()
    late = observer()
    feed(late, kept, 5 / RATE_HZ, until=1200)
    assert late.delays()['motor'].verdict is DelayVerdict.UNDECLARED
    assert fits[False] >= 2, 'two searches must agree'
