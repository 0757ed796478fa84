from __future__ import annotations

import errno
import io
import os
import pickle
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dc_motor_sim.simulation import Recording
from gray_box_observer.checkpoints.checkpoint import VERSION, decode, encode, load, save
from gray_box_observer.errors import GrayBoxError
from gray_box_observer.observer.observer import Observer, Result
from gray_box_observer.predictor import InlineTraining
from gray_box_observer.predictor.initial_network import SHIPPED
from gray_box_observer.predictor.linear_part import FEATURES, LinearPart
from gray_box_observer.predictor.network import Weights
from gray_box_observer.predictor.residual_model import BINS, INPUTS, ResidualModel
from gray_box_observer.settings.configuration import Configuration

SMALL: dict[str, Any] = {
    'training.hidden': 3,
    'training.context': 8,
    'training.period': 50,
    'training.steps': 3,
}


def observer(training: Any = None, **given: Any) -> Observer:
    return Observer(Configuration.from_flat({**SMALL, **given}), training)


def feed(one: Observer, recording: Recording, start: int, end: int) -> list[Result]:
    results: list[Result] = []
    for k in range(start, end):
        stamp = int(recording.stamp_ns[k])
        results += one.voltage('motor', stamp, float(recording.voltage_v[0, k]))
        results += one.torque('motor', stamp, float(recording.torque_nm[0, k]))
    return results


@pytest.fixture(scope='module')
def recording(record: Callable[..., Recording]) -> Recording:
    return record('R[5,15]D[0.2,2]', 20.0, torque_noise_std=1.1e-4)


@pytest.fixture(scope='module')
def saved_content(tmp_path_factory: pytest.TempPathFactory, recording: Recording) -> bytes:
    one = observer()
    feed(one, recording, 0, 1000)
    path = tmp_path_factory.mktemp('saved') / 'c.safetensors'
    save(one, path)
    return path.read_bytes()


@pytest.fixture
def saved(tmp_path: Path, saved_content: bytes) -> Path:
    path = tmp_path / 'c.safetensors'
    path.write_bytes(saved_content)
    return path


@pytest.mark.parametrize('rule', ['gradient', 'recursive'])
def test_what_was_saved_stands_where_it_stood_and_goes_on_identically(
    tmp_path: Path, recording: Recording, rule: str
) -> None:
    one = observer(context_update=rule)
    other = observer(context_update=rule, seed=77)
    feed(one, recording, 0, 1010)
    save(one, tmp_path / 'c.safetensors')
    load(other, tmp_path / 'c.safetensors')
    before, after = one.estimates()['motor'], other.estimates()['motor']
    assert (
        before.value.tobytes() + before.covariance.tobytes()
        == after.value.tobytes() + after.covariance.tobytes()
    )
    assert before.stamp_ns == after.stamp_ns
    samples = [r.sample for r in feed(observer(), recording, 0, 2000)][1010:]
    for sample in samples:
        changed = [o.group_of('motor').observer.context_nodes.learn(sample) for o in (one, other)]
        assert changed[0] == changed[1]
    on = one.estimates()['motor']
    again = other.estimates()['motor']
    assert (
        on.value.tobytes() + on.covariance.tobytes()
        == again.value.tobytes() + again.covariance.tobytes()
    )
    assert not np.array_equal(on.value, before.value)


@pytest.mark.slow
@pytest.mark.parametrize('cut', [305, 450, 615, 640, 1000, 1290])
def test_whoever_goes_on_from_a_checkpoint_is_no_less_certain_wherever_it_was_cut(
    tmp_path: Path, record: Callable[..., Recording], cut: int
) -> None:
    for seed in (1, 2):
        recording = record('R[5,15]D[0.1,1]', 16.0, seed=seed, torque_noise_std=1e-4)
        recording = replace(recording, torque_nm=recording.torque_nm.copy())
        recording.torque_nm[0, cut + 20] += (
            3e-4  # the state it goes on from was measured three deviations off
        )
        one = observer()
        other = observer()
        never_ended = observer()
        feed(one, recording, 0, cut)
        save(one, tmp_path / 'c.safetensors')
        load(other, tmp_path / 'c.safetensors')
        before = other.estimates()['motor'].std
        told = [
            r.estimate for r in feed(other, recording, cut + 20, 1600) if r.estimate is not None
        ]
        assert max(float(np.max(estimate.std / before)) for estimate in told) < 1.05
        feed(never_ended, recording, 0, 1600)
        expected = never_ended.estimates()['motor']
        assert np.all(told[-1].std < 1.1 * expected.std)  # 20 samples are missing
        assert np.all(np.abs(told[-1].value - expected.value) < 2.0 * expected.std)


def test_a_second_save_of_the_same_gives_the_same_arrays(tmp_path: Path, saved: Path) -> None:
    other = observer()
    load(other, saved)
    save(other, tmp_path / 'again.safetensors')
    (plain, arrays), (again, second) = (
        decode(p.read_bytes()) for p in (saved, tmp_path / 'again.safetensors')
    )
    assert again == plain
    assert second.keys() == arrays.keys()
    for name, array in arrays.items():
        assert (second[name].dtype, second[name].shape) == (array.dtype, array.shape)
        assert second[name].tobytes() == array.tobytes(), name


@pytest.mark.slow
def test_a_correction_that_speaks_goes_on_identically_though_a_sample_was_still_to_be_studied(
    tmp_path: Path, recording: Recording
) -> None:
    loud = replace(Weights.initial(INPUTS, 8, 3), output_bias=np.zeros(1))
    linear = LinearPart(np.full(FEATURES, 1e-3), np.full(FEATURES, 20.0))
    support = np.full((BINS, BINS), 100.0)
    learnt = ResidualModel(loud, linear, np.array([10.0, 3.0, 1.0]), 0.3, 1.0, support, 0.01)
    one, other = (Observer(Configuration.from_flat({}), InlineTraining) for _ in range(2))

    def take(which: Observer, start: int, end: int) -> list[bytes]:
        told = []
        for k in range(start, end):
            stamp = int(recording.stamp_ns[k])
            which.ingest('voltage', ('motor',), stamp, [float(recording.voltage_v[0, k])])
            for result in which.ingest(
                'torque', ('motor',), stamp, [float(recording.torque_nm[0, k])]
            ):
                assert result.prediction is not None
                told.append(result.prediction.torque_nm.tobytes())
        return told

    take(one, 0, 1010)
    forecasting = one.group_of('motor').observer.forecasting
    assert forecasting is not None
    forecasting.predictor.residual.adopt(learnt.arrays())
    take(
        one, 1010, 1039
    )  # in the middle of a block and of a period of training; nobody has asked for the last alarm
    save(one, tmp_path / 'c.safetensors')
    load(other, tmp_path / 'c.safetensors')
    one.group_of('motor').pairing.restart()  # as loading does
    size_nm = forecasting.predictor.residual.size_nm[0]
    assert take(one, 1039, 1900) == take(other, 1039, 1900)
    assert forecasting.predictor.residual.size_nm[0] > size_nm > 0.0, 'it spoke'
    (plain, arrays), (again, second) = (which.motors['motor'].state() for which in (one, other))
    assert again == plain
    for name, array in arrays.items():
        assert second[name].tobytes() == array.tobytes(), name


@pytest.mark.slow
@pytest.mark.parametrize('training', [None, InlineTraining])
def test_what_was_identified_is_so_after_loading_though_learning_is_frozen(
    tmp_path: Path, recording: Recording, training: Any
) -> None:
    one = observer(training)
    other = observer(training, freeze=True)
    feed(one, recording, 0, 1500)
    assert one.estimate_of('motor')[1]
    save(one, tmp_path / 'c.safetensors')
    load(other, tmp_path / 'c.safetensors')
    assert other.estimate_of('motor')[1]


@pytest.mark.slow
def test_the_network_is_saved_too_and_forecasts_after_its_warm_up(
    tmp_path: Path, recording: Recording
) -> None:
    one, other = (observer(InlineTraining, variant='main') for _ in range(2))
    feed(one, recording, 0, 500)
    save(one, tmp_path / 'c.safetensors')
    load(other, tmp_path / 'c.safetensors')
    said = [
        float(r.prediction.torque_nm[0])
        for r in feed(other, recording, 500, 530)
        if r.prediction is not None
    ]
    assert np.isnan(said[:8]).all()
    assert np.isfinite(said[12:]).all()


@pytest.mark.slow
def test_the_network_of_another_variant_is_refused(tmp_path: Path, recording: Recording) -> None:
    for variant, wanted in (
        ('main', 'expected variant physics'),
        ('physics', 'expected one of the thesis'),
    ):
        one = observer(InlineTraining, variant=variant)
        feed(one, recording, 0, 500)
        save(one, tmp_path / f'{variant}.safetensors')
        other = observer(InlineTraining, variant='physics' if variant == 'main' else 'main')
        with pytest.raises(GrayBoxError, match=wanted):
            load(other, tmp_path / f'{variant}.safetensors')


def test_saving_replaces_the_old_file_and_leaves_no_scraps(
    saved: Path, recording: Recording
) -> None:
    old = saved.read_bytes()
    one = observer()
    feed(one, recording, 0, 1500)
    save(one, saved)
    assert saved.read_bytes() != old
    assert [p.name for p in saved.parent.iterdir()] == [saved.name]


def test_saving_makes_the_folder(tmp_path: Path, recording: Recording) -> None:
    one = observer()
    feed(one, recording, 0, 100)
    save(one, tmp_path / 'a' / 'b' / 'c.safetensors')
    load(observer(), tmp_path / 'a' / 'b' / 'c.safetensors')


def test_there_is_nothing_to_save_before_the_first_sample(tmp_path: Path) -> None:
    with pytest.raises(GrayBoxError, match='nothing to save yet'):
        save(observer(), tmp_path / 'c.safetensors')
    assert not (tmp_path / 'c.safetensors').exists()


def test_a_place_that_cannot_be_written_is_named(tmp_path: Path, recording: Recording) -> None:
    one = observer()
    feed(one, recording, 0, 100)
    (tmp_path / 'file').write_text('')
    with pytest.raises(GrayBoxError, match='cannot write'):
        save(one, tmp_path / 'file' / 'c.safetensors')


def no_space(*_: Any) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.mark.parametrize('fails', ['os.fsync', 'pathlib.Path.replace'])
def test_a_save_that_fails_keeps_the_old_file_and_leaves_no_scraps(
    saved: Path, recording: Recording, fails: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    old = saved.read_bytes()
    one = observer()
    feed(one, recording, 0, 100)
    monkeypatch.setattr(fails, no_space)
    with pytest.raises(
        GrayBoxError, match=r'cannot write .*c\.safetensors: No space left on device'
    ):
        save(one, saved)
    assert [p.name for p in saved.parent.iterdir()] == [saved.name]
    assert saved.read_bytes() == old


def test_a_folder_is_not_replaced_by_a_checkpoint(tmp_path: Path, recording: Recording) -> None:
    one = observer()
    feed(one, recording, 0, 100)
    (tmp_path / 'c.safetensors').mkdir()
    with pytest.raises(GrayBoxError, match=r'cannot write .*: Is a directory'):
        save(one, tmp_path / 'c.safetensors')
    assert [p.name for p in tmp_path.iterdir()] == ['c.safetensors']


def refuse(path: Path, message: str, **given: Any) -> None:
    one = observer(**given)
    with pytest.raises(GrayBoxError, match=message) as caught:
        load(one, path)
    assert '\n' not in str(caught.value)


def test_a_file_that_is_not_there_is_refused(tmp_path: Path) -> None:
    refuse(tmp_path / 'none.safetensors', 'cannot read .*none.safetensors')


def garbage() -> dict[str, bytes]:
    array = io.BytesIO()
    archive = io.BytesIO()
    np.save(array, np.zeros(3))
    np.savez(archive, a=np.zeros(3))
    return {
        'empty': b'',
        'text': b'this is no checkpoint',
        'pickle': pickle.dumps({'version': VERSION}),
        'npy': array.getvalue(),
        'npz': archive.getvalue(),
        'network': SHIPPED.read_bytes(),
        'header beyond the end': b'\xff' * 64,
    }


@pytest.mark.parametrize('kind', list(garbage()))
def test_a_file_that_is_no_checkpoint_is_refused(tmp_path: Path, kind: str) -> None:
    path = tmp_path / 'c.safetensors'
    path.write_bytes(garbage()[kind])
    refuse(path, 'is not a checkpoint of this package')


@pytest.mark.parametrize('share', [0.2, 0.9, 0.999])
def test_a_file_that_was_cut_is_refused(saved: Path, share: float) -> None:
    data = saved.read_bytes()
    saved.write_bytes(data[: int(share * len(data))])
    refuse(saved, 'is not a checkpoint of this package')


def test_a_damaged_file_is_refused(saved: Path) -> None:
    data = bytearray(saved.read_bytes())
    data[len(data) // 2] ^= 0xFF
    saved.write_bytes(bytes(data))
    refuse(saved, 'is damaged: its content does not match its checksum')


@pytest.mark.parametrize('version', [VERSION - 1, VERSION + 1])
def test_another_version_is_refused(saved: Path, version: int) -> None:
    saved.write_bytes(encode(*decode(saved.read_bytes()), version))
    refuse(saved, f'is of version {version}, expected {VERSION}: it was saved by another release')


def test_another_motor_is_refused(saved: Path) -> None:
    refuse(saved, 'holds motor motor, which is not among the configured ones', motors=['left'])


@pytest.mark.parametrize(
    'given',
    [
        {'motor.torque_constant': 0.02},
        {'motor.back_emf_constant': 0.5},
        {'motor.context_nodes': ['inductance', 'resistance']},
        {'motor.context_nodes': ['inductance', 'hysteresis', 'resistance']},
    ],
)
def test_another_white_box_is_refused_and_changes_nothing(
    saved: Path, recording: Recording, given: dict[str, Any]
) -> None:
    refuse(
        saved, 'motor motor: the checkpoint was learnt with other known constants or terms', **given
    )
    one = observer(**given)
    feed(one, recording, 0, 500)
    before = one.estimates()['motor'].value.copy()
    with pytest.raises(GrayBoxError):
        load(one, saved)
    np.testing.assert_array_equal(one.estimates()['motor'].value, before)


def test_the_checkpoint_of_another_rule_is_refused(tmp_path: Path, recording: Recording) -> None:
    one = observer(context_update='gradient')
    feed(one, recording, 0, 500)
    save(one, tmp_path / 'c.safetensors')
    refuse(
        tmp_path / 'c.safetensors',
        'is a checkpoint of the rule gradient, expected recursive',
        context_update='recursive',
    )


def feed_early(
    one: Observer, recording: Recording, start: int, end: int, delay_ns: int
) -> list[Result]:
    results: list[Result] = []
    for k in range(start, end):
        stamp = int(recording.stamp_ns[k]) + 1_000_000_000
        results += one.voltage('motor', stamp - delay_ns, float(recording.voltage_v[0, k]))
        results += one.torque('motor', stamp, float(recording.torque_nm[0, k]))
    return results


def test_an_estimated_delay_stays_in_force_after_loading(
    tmp_path: Path, recording: Recording
) -> None:
    one = observer(**{'motor.delay': 'estimate'})
    other = observer(**{'motor.delay': 'estimate'})
    feed_early(one, recording, 0, 1500, 53_000_000)
    applied_s = one.delays()['motor'].applied_s
    assert applied_s == pytest.approx(0.053, abs=1e-3)
    save(one, tmp_path / 'c.safetensors')
    load(other, tmp_path / 'c.safetensors')
    assert other.delays()['motor'] == one.delays()['motor']
    assert other.counts('motor').delay_ns == round(applied_s * 1e9)
    on = feed_early(other, recording, 1500, 2000, 53_000_000)
    assert other.delays()['motor'].applied_s == pytest.approx(applied_s, abs=1e-3)
    np.testing.assert_allclose(
        on[-1].sample.voltage_v,
        feed_early(one, recording, 1500, 2000, 53_000_000)[-1].sample.voltage_v,
    )
    np.testing.assert_allclose(other.estimates()['motor'].value, [[0.5, 1.0, 10.0]], rtol=0.02)


def test_a_delay_that_is_declared_stands_whatever_was_saved(
    tmp_path: Path, recording: Recording
) -> None:
    one = observer(**{'motor.delay': 'estimate'})
    other = observer(**{'motor.delay': 0.02})
    feed_early(one, recording, 0, 1500, 53_000_000)
    save(one, tmp_path / 'c.safetensors')
    load(other, tmp_path / 'c.safetensors')
    assert other.delays()['motor'].applied_s == 0.02
    assert other.counts('motor').delay_ns == 20_000_000


@pytest.mark.parametrize('dtype', ['f8', 'f4', 'i8', 'i4', 'u8', 'u1', '?'])
@pytest.mark.parametrize('shape', [(), (0,), (3,), (2, 3)])
def test_arrays_of_any_numeric_type_and_shape_come_back_as_they_were(
    dtype: str, shape: tuple[int, ...]
) -> None:
    array = np.random.default_rng(1).integers(0, 2, shape).astype(dtype)
    plain, arrays = decode(
        encode({'large': 2**127 + 1, 'none': None}, {'a/b': array, 'view': array.T})
    )
    assert plain == {'large': 2**127 + 1, 'none': None}
    for name, expected in (('a/b', array), ('view', array.T)):
        assert arrays[name].dtype == expected.dtype
        np.testing.assert_array_equal(arrays[name], expected)


HARD: dict[str, Any] = {
    'training.start': 'fresh',
    'training.hidden': 6,
    'training.learning_rate': 0.05,
    'training.period': 150,
    'training.minibatch': 4,
    'horizon_s': 0.4,
    'motor.voltage_limits': [-33.0, 33.0],
}
"""Far forecasts in all quadrants from a fresh network: training always has something to learn."""


@pytest.mark.slow
@pytest.mark.parametrize(
    ('at', 'variant'),
    [(430, 'physics'), (449, 'physics'), (450, 'physics'), (710, 'physics'), (430, 'main')],
)
def test_inline_training_goes_on_bit_for_bit(
    tmp_path: Path, recording: Recording, at: int, variant: str
) -> None:
    options = HARD if variant == 'physics' else {**SMALL, 'variant': variant}
    one = observer(InlineTraining, **options)
    other = observer(InlineTraining, **options)
    feed(one, recording, 0, at)
    save(one, tmp_path / 'c')
    load(other, tmp_path / 'c')
    for name, array in one.motors['motor'].state()[1].items():
        assert array.tobytes() == other.motors['motor'].state()[1][name].tobytes(), name
    one.group_of('motor').pairing.restart()  # loading begins the signal history anew
    first, second = (feed(o, recording, at, at + 350) for o in (one, other))
    for r, s in zip(first, second, strict=True):
        assert r.prediction is not None
        assert s.prediction is not None
        assert r.prediction.torque_nm.tobytes() == s.prediction.torque_nm.tobytes()
    on, again = (o.motors['motor'].state()[1] for o in (one, other))
    assert on.keys() == again.keys()
    for name, array in on.items():
        assert array.tobytes() == again[name].tobytes(), name
    assert any(
        name.startswith(('network/learning_pupil_adam_', 'network/learning_adam_')) for name in on
    )
    saved = decode((tmp_path / 'c').read_bytes())[1]
    assert saved['motor/network/input'].tobytes() != on['network/input'].tobytes(), (
        'it has learnt on'
    )


@pytest.mark.slow
def test_the_residual_is_learnt_on_bit_for_bit_too(
    tmp_path: Path, record: Callable[..., Recording]
) -> None:
    lagging = record('R[5,15]D[0.2,2]', 30.0, torque_noise_std=1e-5, speed_mode='rotor')
    stored = {'training.replay_capacity': 1024, 'training.segments': 2}
    options = {**HARD, 'training.period': 375, **stored}
    one = observer(InlineTraining, **options)
    other = observer(InlineTraining, **options)
    feed(one, lagging, 0, 2210)
    save(one, tmp_path / 'c')
    load(other, tmp_path / 'c')
    one.group_of('motor').pairing.restart()
    for o in (one, other):
        feed(o, lagging, 2210, 2900)
    on, again = (o.motors['motor'].state()[1] for o in (one, other))
    assert 'network/learning_residual_size' in on, 'there was something to learn'
    assert 'network/schedule_segments' in on, 'and older samples to learn it from'
    assert on.keys() == again.keys()
    for name, array in on.items():
        assert array.tobytes() == again[name].tobytes(), name


class LosingTraining(InlineTraining):
    """Fails in its fifth job, as an optimiser with gradients beyond single precision does."""

    jobs = 0

    def collect(self) -> dict[str, Any] | None:
        """Return the result, spoilt in the fifth job."""
        result = super().collect()
        type(self).jobs += result is not None
        if result is not None and 'input' in result and type(self).jobs == 5:
            result['input'] = np.full_like(result['input'], np.nan)
        return result


def test_a_network_that_training_has_lost_does_not_run_and_training_goes_on(
    recording: Recording,
) -> None:
    LosingTraining.jobs = 0
    one = observer(LosingTraining, variant='main')
    results = feed(one, recording, 0, 1000)
    assert LosingTraining.jobs > 10
    said = [float(r.prediction.torque_nm[0]) for r in results[150:] if r.prediction is not None]
    assert np.isfinite(said).all()
    assert all(
        np.isfinite(array).all()
        for name, array in one.motors['motor'].state()[1].items()
        if 'bias' in name
    )


@pytest.mark.slow
def test_a_network_of_another_size_is_refused(tmp_path: Path, recording: Recording) -> None:
    one = observer(InlineTraining, **HARD)
    feed(one, recording, 0, 300)
    save(one, tmp_path / 'c')
    with pytest.raises(
        GrayBoxError, match='holds a network of 6 hidden units and 5 inputs, expected 4 and 5'
    ):
        load(observer(InlineTraining, **{**HARD, 'training.hidden': 4}), tmp_path / 'c')


@pytest.mark.slow
@pytest.mark.parametrize('predictor', [True, False])
def test_a_motor_that_was_identified_is_so_where_learning_is_frozen_from_the_start(
    record: Callable[..., Recording], tmp_path: Path, predictor: bool
) -> None:
    one = observer(InlineTraining, predictor=predictor)
    feed(one, record(duration_s=20.0), 0, 2000)
    assert one.estimate_of('motor')[1]
    save(one, tmp_path / 'c')
    other = observer(InlineTraining, predictor=predictor, freeze=True)
    load(other, tmp_path / 'c')
    assert other.estimate_of('motor')[1]
