"""Compiled code learns what numpy learns, of every block that is not left to numpy."""

from __future__ import annotations

import ctypes
import shutil
from collections.abc import Callable
from functools import cache
from itertools import product
from typing import Any

import numpy as np
import pytest

from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Recording, Simulation
from gray_box_observer.context_nodes import RecursiveEstimator
from gray_box_observer.context_nodes.native import compiled, regular_block
from gray_box_observer.context_nodes.native.regular_block import RegularBlocks
from gray_box_observer.context_nodes.recursive import block_updater
from gray_box_observer.context_nodes.recursive.estimator_settings import RecursiveSettings
from gray_box_observer.context_nodes.recursive.normal_equations import inverted
from gray_box_observer.samples import Sample
from gray_box_observer.samples.replay_buffer import ReplayBuffer
from gray_box_observer.white_box import MotorWhiteBox, forms
from gray_box_observer.white_box.balance import Form
from gray_box_observer.white_box.declaration import TERMS, State, Term
from gray_box_observer.white_box.forms import EFFECTS
from gray_box_observer.white_box.interface import Parameter

START = np.array([[1.5, 3.0, 30.0]])
THESIS = ('inductance', 'resistance', 'hysteresis')
KNOWN = {'back_emf_constant': 0.01}

needs_it = pytest.mark.skipif(regular_block.library() is None, reason='built without a C compiler')


class Count:
    """How many blocks compiled code was given, and how many it has learnt."""

    given = learnt = 0

    def watch(self, nodes: RecursiveEstimator) -> None:
        """Count what these context nodes do."""
        updater = nodes._updater
        within = updater.learn_due
        of_these = updater.learn_regular

        def count(status: np.ndarray) -> None:
            self.given += status.size
            self.learnt += int((status > 0).sum())

        def learn_due(*arguments):  # type: ignore[no-untyped-def]
            state, batch = within(*arguments)
            count(batch.status)
            return state, batch

        def learn(*arguments):  # type: ignore[no-untyped-def]
            state, status = of_these(*arguments)
            count(status)
            return state, status

        updater.learn_due, updater.learn_regular = learn_due, learn  # type: ignore[method-assign]


def both(
    monkeypatch: pytest.MonkeyPatch, box: MotorWhiteBox, start: np.ndarray,
    samples: list[Sample], rules: RecursiveSettings,
) -> tuple[RecursiveEstimator, RecursiveEstimator, Count]:  # fmt: skip
    """Learn samples by compiled code, and by numpy; estimates must agree."""
    count = Count()
    quick = RecursiveEstimator(box, start, rules=rules)
    count.watch(quick)
    monkeypatch.setattr(regular_block, 'library', lambda *_: None)
    by_numpy = RecursiveEstimator(box, start, rules=rules)
    for sample in samples:
        has_changed = quick.learn(sample)
        assert has_changed == by_numpy.learn(sample)
        if has_changed:
            np.testing.assert_array_equal(quick.changed, by_numpy.changed)
            np.testing.assert_allclose(quick.theta, by_numpy.theta, rtol=1e-7)
    np.testing.assert_allclose(quick.theta, by_numpy.theta, rtol=1e-7)
    one = quick.estimate()
    other = by_numpy.estimate()
    np.testing.assert_allclose(one.covariance, other.covariance, rtol=1e-5, atol=1e-30)
    assert quick.counters() == by_numpy.counters()
    return quick, by_numpy, count


@cache
def simulated(
    excitation: str, duration_s: float, *, motors: int = 1, speed: bool = False,
    noise: float = 0.005, **plant: float
) -> list[Sample]:  # fmt: skip
    """Samples at 100 Hz of motors that run alike, each with its own noise."""
    r = Simulation({'m': PlantParameters(**plant)}, excitation, seed=2).record(duration_s)
    random = np.random.default_rng(3)
    torque = r.torque_nm[0]
    std = noise * float(np.abs(torque).max())
    last = r.stamp_ns.size - 1
    drawn = torque[:, None] + random.normal(0.0, std, (torque.size, motors))
    measured = r.speed_rad_s[0] if speed else np.full(torque.size, np.nan)
    return [
        Sample(
            int(r.stamp_ns[k]), np.full(motors, 0.01 if k else 0.0),
            np.full(motors, r.voltage_v[0, max(k - 1, 0)]), drawn[k], np.full(motors, measured[k]),
        )
        for k in range(last)
    ]  # fmt: skip


def test_where_there_is_a_compiler_there_is_compiled_code() -> None:
    if shutil.which('cc') is None and shutil.which('gcc') is None:
        pytest.skip('no C compiler')
    assert regular_block.library() is not None, 'ros_ws/setup.sh builds it'


@needs_it
def test_every_term_is_compiled_as_it_is_declared() -> None:
    library = regular_block.library()
    assert library is not None
    values = (ctypes.c_double * 2)()
    constant = 0.3
    for code, name in enumerate(TERMS):
        form = EFFECTS.get(name) if TERMS[name].state is State.CURRENT else None
        assert bool(library.term_values(code, 0, 1.0, 1.0, constant, 1.0, values)) == (
            form is not None
        ), name
        if form is None:
            continue
        currents = -3.0, -0.01, 0.0, 0.5
        for current, speed, voltage in product(currents, (-20.0, 0.0, 7.0), (-6.0, 0.0, 0.03)):
            for measured, slope in enumerate((form.total_slope, form.partial[State.CURRENT])):
                signals = current, speed, constant, voltage
                library.term_values(code, measured, *signals, values)
                declared = [function(*signals) for function in (form.value, slope)]
                # the slope of a softened sign is a small difference of large numbers
                np.testing.assert_allclose(list(values), declared, rtol=1e-13, err_msg=name)


@needs_it
def test_what_was_compiled_of_another_motor_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(forms, 'FINGERPRINT', forms.FINGERPRINT + 1)
    assert regular_block.library() is None


@needs_it
def test_a_term_that_is_not_compiled_is_left_to_numpy(monkeypatch: pytest.MonkeyPatch) -> None:
    declared = Parameter(
        'eddy', 'V/A^3', 1e-3, 1e-9, 1e3, 'A term that compiled code has never heard of.'
    )

    def slope(i: Any, w: Any, c: Any) -> Any:
        return 3.0 * i**2

    monkeypatch.setitem(TERMS, 'eddy', Term(declared, 'current**3'))
    monkeypatch.setitem(
        EFFECTS, 'eddy', Form(lambda i, w, c: i**3, (slope, lambda i, w, c: 0.0), slope)
    )
    replay = ReplayBuffer(1, 128)
    assert RegularBlocks(MotorWhiteBox(THESIS, 0.01, KNOWN), RecursiveSettings(), replay).compiled
    for box in (
        MotorWhiteBox((*THESIS, 'eddy'), 0.01, KNOWN),
        MotorWhiteBox(THESIS, 0.01, {'eddy': 1e-3}),
    ):
        assert not RegularBlocks(box, RecursiveSettings(), replay).compiled


@pytest.mark.parametrize('column', [-10_000_000, 0, 10_000_000])
def test_samples_that_are_not_in_memory_are_not_read(
    thesis_box: MotorWhiteBox, column: int
) -> None:
    nodes = RecursiveEstimator(thesis_box, START)
    for sample in simulated('R[5,15]D[0.2,3]', 10.0):
        nodes.learn(sample)
    state = nodes._state
    index = np.zeros(1, dtype=int)
    _, gone, _, _ = nodes.replay.streams
    gone[:] = state.position - column
    _, status = nodes._updater.learn_regular(state, index, nodes._schedule)
    assert status.tolist() == [0]


@pytest.mark.slow
@pytest.mark.parametrize('motors', [1, 11])
def test_regular_blocks_are_learnt_as_numpy_learns_them(
    monkeypatch: pytest.MonkeyPatch, motors: int
) -> None:
    box = MotorWhiteBox(THESIS, np.full(motors, 0.01), {'back_emf_constant': np.full(motors, 0.01)})
    samples = simulated('R[5,15]D[0.2,3]', 30.0, motors=motors)
    nodes, by_numpy, count = both(
        monkeypatch, box, np.tile(START, (motors, 1)), samples, RecursiveSettings()
    )
    assert count.given >= 80 * motors
    assert count.learnt >= 0.98 * count.given
    (_, ours), (_, theirs) = nodes.state(motors - 1), by_numpy.state(motors - 1)
    for name, array in ours.items():
        # between the two lies rounding; what tests for a change have added up is small against what
        # went into it
        scale = float(np.max(np.abs(theirs[name][np.isfinite(theirs[name])]), initial=0.0))
        np.testing.assert_allclose(array, theirs[name], rtol=1e-5, atol=1e-7 * scale, err_msg=name)


@pytest.mark.slow
@pytest.mark.parametrize(
    ('names', 'constants'),
    [
        (THESIS, {'back_emf_constant': 0.01}),  # the usual one has a variant of its own
        (THESIS, {'back_emf_constant': 0.01, 'brush_drop': 0.1}),  # and not this
        (THESIS[:2], {'back_emf_constant': 0.01, 'brush_drop': 0.1}),
        ((*THESIS, 'back_emf_constant'), {'brush_drop': 0.1}),
        ((*THESIS, 'back_emf_constant', 'brush_drop'), {}),
    ],
)
def test_so_are_those_of_other_physics_with_measured_speed(
    monkeypatch: pytest.MonkeyPatch, names: tuple[str, ...], constants: dict[str, float]
) -> None:
    box = MotorWhiteBox(names, 0.01, constants, speed_measured=True)
    start = np.array([[1.5, 3.0, 30.0, 0.03, 0.2][: len(names)]])
    samples = simulated('R[-15,15]D[0.2,3]', 25.0, speed=True)
    _, _, count = both(monkeypatch, box, start, samples, RecursiveSettings())
    assert count.learnt > 0.5 * count.given > 30


@pytest.mark.slow
@pytest.mark.parametrize('jitter', [0.0, 0.01])
def test_a_hold_settles_when_numpy_says_so_to_the_block(
    monkeypatch: pytest.MonkeyPatch, jitter: float
) -> None:
    box = MotorWhiteBox(THESIS, np.full(9, 0.01), {'back_emf_constant': np.full(9, 0.01)})
    rules = RecursiveSettings(block=4)
    samples = simulated('R[5,15]D[0.5,4]', 15.0, motors=9)
    lengths = np.random.default_rng(2).uniform(1.0 - jitter, 1.0 + jitter, len(samples))
    samples = [
        s._replace(interval_s=s.interval_s * length)
        for s, length in zip(samples, lengths, strict=True)
    ]
    settled: list[list[np.ndarray]] = []
    for library in (True, False):
        with monkeypatch.context() as patch:
            if not library:
                patch.setattr(regular_block, 'library', lambda *_: None)
            nodes = RecursiveEstimator(box, np.tile(START, (9, 1)), rules=rules)
            settled.append([])
            for one in samples:
                nodes.learn(one)
                settled[-1].append(nodes._state.hold.settled.copy())
    np.testing.assert_array_equal(*settled)
    assert 0.2 < np.mean(settled[0]) < 0.9


@pytest.mark.slow
def test_a_quick_motor_is_followed_in_as_many_steps_as_numpy_takes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    box = MotorWhiteBox(THESIS, 0.01, KNOWN)
    samples = simulated('R[5,15]D[0.05,0.3]', 20.0, inductance=0.01)
    nodes, _, count = both(monkeypatch, box, START, samples, RecursiveSettings())
    assert count.learnt > 0.9 * count.given > 40
    np.testing.assert_allclose(nodes.theta, [[0.01, 1.0, 10.0]], rtol=0.05)


@pytest.mark.slow
def test_long_holds_and_drifts_come_out_as_with_numpy(monkeypatch: pytest.MonkeyPatch) -> None:
    box = MotorWhiteBox(THESIS, 0.01, KNOWN)
    rules = RecursiveSettings(long_hold_s=5.0, replay_capacity=512)
    moving = simulated('R[5,15]D[0.2,3]', 15.0)
    held = simulated('C[9]', 15.0)
    _, _, count = both(monkeypatch, box, START, [*moving, held[0].beginning(), *held[1:]], rules)
    assert count.learnt > 0.9 * count.given
    plant = PlantParameters()
    warming = tuple(f'm.resistance={1.0 + 0.001 * k:g}@{0.2 * k:g}' for k in range(1, 300))
    warm = Simulation({'m': plant}, 'R[5,15]D[0.2,3]', seed=4, schedule=warming).record(60.0)
    samples = [
        Sample(
            int(stamp),
            *(np.array([value]) for value in (0.01 if k else 0.0, voltage, torque, np.nan)),
        )
        for k, (stamp, voltage, torque) in enumerate(
            zip(warm.stamp_ns, np.roll(warm.voltage_v[0], 1), warm.torque_nm[0], strict=True)
        )
    ]
    nodes, _, _ = both(monkeypatch, box, START, samples, rules)
    assert nodes.counters()['motors that drift'] + nodes.counters()['motor changes'] > 0


@pytest.fixture
def disturbed(
    record: Callable[..., Recording], samples_of: Callable[..., list[Sample]]
) -> list[Sample]:
    """A changing motor with outliers, wrong voltages and pauses, some at the end of a block."""
    recording = record(
        'R[5,15]D[0.2,3]',
        40.0,
        torque_noise_std=1.2e-4,
        schedule=('motor.resistance=1.5@25',),
        sample_rate_hz=100.0,
    )
    random = np.random.default_rng(5)
    made = []
    for k, sample in enumerate(samples_of(recording)):
        torque = 1.5 if random.random() < 0.01 else 1.0
        voltage = 4.0 if random.random() < 0.01 else 0.0
        taken = Sample(
            sample.stamp_ns, sample.interval_s, sample.voltage_v + voltage,
            sample.torque_nm * torque, sample.speed_rad_s,
        )  # fmt: skip
        made.append(taken.beginning() if k and random.random() < 0.01 else taken)
    return made


@pytest.mark.slow
def test_what_is_out_of_the_ordinary_is_left_to_numpy(
    monkeypatch: pytest.MonkeyPatch,
    thesis_box: MotorWhiteBox,
    disturbed: list[Sample],
) -> None:
    nodes, _, count = both(monkeypatch, thesis_box, START, disturbed, RecursiveSettings())
    assert 0 < count.learnt < count.given
    told = nodes.counters()
    assert told['torque outliers'] > 10
    assert told['state kicks'] > 10
    assert told['motor changes'] > 0


def gone_wrong(seed: int) -> tuple[MotorWhiteBox, np.ndarray, list[Sample]]:
    """A group in which nearly everything goes wrong: its physics, a start, samples."""
    random = np.random.default_rng(seed)
    motors = 9
    box = MotorWhiteBox(
        THESIS, np.full(motors, 0.01), {'back_emf_constant': np.full(motors, 0.01)}, bool(seed % 4)
    )
    current = np.zeros(motors)
    voltage = np.zeros(motors)
    samples = []
    for k in range(700):
        if random.random() < 0.05:
            voltage = random.uniform(-15.0, 15.0, motors)
        speed = 0.01 * current
        current = current + 0.02 * (
            voltage - current - 10.0 * np.abs(speed) * current - 0.01 * speed
        )
        signals = voltage.copy(), 0.01 * current + random.normal(0.0, 1e-4, motors), 0.01 * current
        for signal in signals:
            bad = random.random(motors) < 0.003
            signal[bad] = random.choice(
                [1e-320, 0.0, 1e-30, 5.0, -5.0, 0.5, -0.1, 30.0], int(bad.sum())
            )
        interval = np.where(random.random(motors) < 0.003, random.choice([0.0, 0.02, 0.03]), 0.01)
        present = None if random.random() < 0.9 else random.random(motors) < 0.9
        samples.append(Sample(k * 10_000_000, interval, *signals, present))
    return box, np.tile(START, (motors, 1)), samples


@pytest.mark.slow
@pytest.mark.parametrize('seed', [14, 20])
def test_so_is_a_group_in_which_nearly_everything_goes_wrong(
    monkeypatch: pytest.MonkeyPatch, seed: int
) -> None:
    box, start, samples = gone_wrong(seed)
    _, _, count = both(monkeypatch, box, start, samples, RecursiveSettings())
    assert 0 < count.learnt < count.given


def test_a_motor_whose_matrix_is_singular_ends_nobody() -> None:
    matrices = np.array(
        [[[2.0, 0.0], [0.0, 4.0]], [[1.0, 1.0], [1.0, 1.0]], [[0.0, 1.0], [1.0, 0.0]]]
    )
    found = inverted(matrices)
    np.testing.assert_array_equal(
        found[[0, 2]], [[[0.5, 0.0], [0.0, 0.25]], [[0.0, 1.0], [1.0, 0.0]]]
    )
    assert np.isnan(found[1]).all()


def test_a_state_that_was_saved_is_not_written_to(
    thesis_box: MotorWhiteBox, disturbed: list[Sample]
) -> None:
    begun, fresh = (RecursiveEstimator(thesis_box, START) for _ in range(2))
    for sample in disturbed[:1000]:
        begun.learn(sample)
    saved = begun.state()
    before = {name: array.tobytes() for name, array in saved[1].items()}
    for sample in disturbed[1000:1500]:
        begun.learn(sample)
    assert {name: array.tobytes() for name, array in saved[1].items()} == before
    for nodes in (begun, fresh):
        nodes.restore(*saved)
        for sample in disturbed[1000:1200]:
            nodes.learn(sample)
    np.testing.assert_array_equal(begun.estimate().covariance, fresh.estimate().covariance)


def test_without_compiled_code_numpy_learns_everything(
    monkeypatch: pytest.MonkeyPatch, thesis_box: MotorWhiteBox
) -> None:  # fmt: skip
    monkeypatch.setattr(compiled, 'EXTENSION_SUFFIXES', ['.is-not-there'])
    assert regular_block.library() is None
    nodes = RecursiveEstimator(thesis_box, START)
    count = Count()
    count.watch(nodes)
    for sample in simulated('R[5,15]D[0.2,3]', 20.0):
        nodes.learn(sample)
    assert count.learnt == 0 < count.given
    np.testing.assert_allclose(nodes.theta, [[0.5, 1.0, 10.0]], rtol=0.05)


@pytest.mark.filterwarnings('error')
def test_blocks_of_nothing_but_restarts_are_met_without_a_warning(
    thesis_box: MotorWhiteBox,
    record: Callable[..., Recording],
    samples_of: Callable[..., list[Sample]],
) -> None:
    samples = samples_of(record('R[5,15]D[0.2,0.4]', 9.0, torque_noise_std=1e-4))
    nodes = RecursiveEstimator(thesis_box, START)
    for k, sample in enumerate(samples):
        nodes.learn(sample if k < 700 else sample.beginning())
    np.testing.assert_allclose(nodes.theta, [[0.5, 1.0, 10.0]], rtol=0.01)


@needs_it
def test_a_fit_that_a_block_makes_due_is_done_at_the_same_sample(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    motors = 40
    monkeypatch.setattr(
        block_updater, 'BLOCKS_PER_STEP', 2
    )  # so that the last ones come to their block when a fit is due too
    box = MotorWhiteBox(THESIS, np.full(motors, 0.01), {'back_emf_constant': np.full(motors, 0.01)})
    nodes = RecursiveEstimator(box, START.repeat(motors, 0))
    late = 0
    within = nodes._updater.learn_due

    def learn_due(state, schedule):  # type: ignore[no-untyped-def]
        nonlocal late
        before = schedule.is_block_update.copy()
        state, batch = within(state, schedule)
        fits = (nodes.replay.received >= schedule.next_update_at) & ~schedule.is_block_update
        late += int((fits & before).sum())
        assert not (batch.wait and fits.any())
        return state, batch

    nodes._updater.learn_due = learn_due  # type: ignore[method-assign]
    for sample in simulated('R[5,15]D[0.2,3]', 12.0, motors=motors):
        nodes.learn(sample)
    assert late > 0


def test_quantised_currents_that_stand_still_teach_the_same_nothing(
    monkeypatch: pytest.MonkeyPatch, thesis_box: MotorWhiteBox
) -> None:
    step_nm = 5e-4
    samples = [
        sample._replace(torque_nm=np.round(sample.torque_nm / step_nm) * step_nm)
        for sample in simulated('R[5,15]D[1,6]', 20.0, noise=0.0)
    ]
    quick, _, count = both(monkeypatch, thesis_box, START, samples, RecursiveSettings())
    assert count.learnt > 20
    assert quick.noise_std_nm[0] >= 0.99 * step_nm / np.sqrt(12.0)
