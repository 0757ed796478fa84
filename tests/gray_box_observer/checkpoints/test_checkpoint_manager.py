from __future__ import annotations

import json
import os
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dc_motor_sim.simulation import Recording
from gray_box_observer.checkpoints import checkpoint, checkpoint_manager
from gray_box_observer.checkpoints.background_writer import CheckpointWriter
from gray_box_observer.checkpoints.checkpoint import (
    PARTIAL,
    SCRAP_AGE_S,
    Snapshot,
    capture,
    decode,
    encode,
    save,
)
from gray_box_observer.checkpoints.checkpoint_folder import CheckpointFolder
from gray_box_observer.checkpoints.checkpoint_format import encode_content
from gray_box_observer.checkpoints.checkpoint_manager import CheckpointKeeper
from gray_box_observer.errors import GrayBoxError
from gray_box_observer.observer.observer import Observer
from gray_box_observer.predictor.initial_network import SHIPPED
from gray_box_observer.settings.configuration import Configuration

PATIENCE_S = 20.0


@pytest.fixture(autouse=True)
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a busy machine take its time to write; what hangs for good is tested by itself."""
    monkeypatch.setattr(checkpoint_manager, 'END_PATIENCE_S', 60.0)


@pytest.fixture
def recording(record: Callable[..., Recording]) -> Recording:
    return record('R[5,15]D[0.2,2]', 20.0, torque_noise_relative=0.01)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / 'c.safetensors'


def observer(**given: Any) -> Observer:
    return Observer(Configuration.from_flat({'predictor': False, **given}))


def feed(one: Observer, recording: Recording, start: int, end: int) -> None:
    for k in range(start, end):
        stamp_ns = int(recording.stamp_ns[k])
        one.voltage('motor', stamp_ns, float(recording.voltage_v[0, k]))
        one.torque('motor', stamp_ns, float(recording.torque_nm[0, k]))


def learnt(one: Observer) -> bytes:
    estimate = one.estimates()['motor']
    return estimate.value.tobytes() + estimate.covariance.tobytes()


def keeper(path: Path, automatic: bool = True) -> CheckpointKeeper:
    return CheckpointKeeper(CheckpointFolder('', str(path), path), str(path), automatic=automatic)


def test_a_snapshot_stays_what_it_was_while_learning_goes_on(
    recording: Recording, path: Path
) -> None:
    one = observer()
    other = observer()
    feed(one, recording, 0, 1000)
    snapshot = capture(one)
    before = learnt(one)
    feed(one, recording, 1000, 2000)
    checkpoint.write(snapshot, path)
    checkpoint.load(other, path)
    assert learnt(other) == before
    assert learnt(one) != before


def test_a_restarted_observer_continues_where_the_last_one_was(
    recording: Recording, path: Path
) -> None:
    one = observer()
    other = observer()
    feed(one, recording, 0, 1000)
    assert keeper(path).close(one) is None
    resumed = keeper(path).resume(other)
    assert (resumed.is_found, resumed.refusal) == (True, None)
    assert learnt(other) == learnt(one)
    assert [entry.name for entry in path.parent.iterdir()] == [path.name]


def test_where_there_is_no_checkpoint_it_starts_anew(path: Path) -> None:
    one = observer()
    assert not keeper(path).resume(one).is_found
    assert one.motors == {}
    assert list(path.parent.iterdir()) == []


def not_ours(good: bytes) -> dict[str, bytes]:
    plain, arrays = decode(good)
    without = {name: array for name, array in arrays.items() if 'belief' not in name}
    strange = json.loads(json.dumps(plain))
    strange['motors']['motor'] = ['not', 'a', 'motor']
    reshaped = {
        name: array.ravel() if name.endswith('belief.covariance') else array
        for name, array in arrays.items()
    }
    return {
        'empty': b'',
        'cut': good[: len(good) // 2],
        'flipped': good[:-9] + bytes([good[-9] ^ 1]) + good[-8:],
        'version': encode(plain, arrays, 99),
        'no content': encode({}, arrays),
        'no motors': encode({'context_update': 'recursive', 'motors': 5}, arrays),
        'no belief': encode(plain, without),
        'strange motor': encode(strange, arrays),
        'other shapes': encode(plain, reshaped),
    }


KINDS = (
    'empty',
    'cut',
    'flipped',
    'version',
    'no content',
    'no motors',
    'no belief',
    'strange motor',
    'other shapes',
)


@pytest.mark.parametrize('kind', KINDS)
def test_a_checkpoint_that_cannot_be_used_is_kept_aside_and_the_observer_can_be_used(
    recording: Recording, path: Path, kind: str
) -> None:
    one = observer()
    other = observer()
    fresh = observer()
    feed(one, recording, 0, 500)
    save(one, path)
    bad = not_ours(path.read_bytes())
    assert tuple(bad) == KINDS
    path.write_bytes(bad[kind])
    resumed = keeper(path).resume(other)
    assert resumed.is_found
    assert resumed.refusal is not None
    assert str(path) in resumed.refusal
    assert resumed.refusal.endswith(f'; it is kept as {path}.refused')
    assert '\n' not in resumed.refusal
    assert Path(f'{path}.refused').read_bytes() == bad[kind]
    assert not path.exists()
    for each in (other, fresh):
        feed(each, recording, 0, 500)
    assert learnt(other) == learnt(fresh)


def test_a_checkpoint_of_another_configuration_is_kept_aside_beside_older_ones(
    recording: Recording, path: Path
) -> None:
    one = observer()
    feed(one, recording, 0, 500)
    for number in ('', '-2', '-3'):
        save(one, path)
        refusal = keeper(path).resume(observer(**{'motor.torque_constant': 0.02})).refusal
        assert refusal is not None
        assert 'learnt with other known constants' in refusal
        assert refusal.endswith(f'{path}.refused{number}')


def test_what_stands_in_the_way_and_is_no_file_is_left_there(path: Path) -> None:
    path.mkdir()
    refusal = keeper(path).resume(observer()).refusal
    assert refusal == f'cannot read {path}: Is a directory; it is kept as {path}'
    assert path.is_dir()


def test_the_file_is_kept_up_to_date_only_where_asked_to_and_only_with_news(
    recording: Recording, path: Path
) -> None:
    one = observer()
    automatic = keeper(path)
    manual = keeper(path, automatic=False)
    automatic.keep(None)
    automatic.keep(one)  # nothing learnt yet
    feed(one, recording, 0, 500)
    manual.keep(one)
    assert manual.close(one) is None
    assert not path.exists()
    automatic.keep(one)
    assert automatic.close(one) is None
    first = path.stat().st_ino
    again = keeper(path)
    again.resume(other := observer())
    assert again.close(other) is None
    assert path.stat().st_ino == first, 'nothing was learnt since'
    assert automatic.age_s is not None
    assert again.age_s is None


def test_what_was_forgotten_on_purpose_does_not_come_back(recording: Recording, path: Path) -> None:
    one = observer()
    feed(one, recording, 0, 500)
    kept = keeper(path)
    kept.keep(one)
    assert kept.forget() == f'{path}.reset'
    assert kept.forget() is None
    assert not keeper(path).resume(observer()).is_found
    assert keeper(path, automatic=False).forget() is None


def test_saving_and_loading_by_hand_name_the_file_and_refuse_what_leads_out(
    recording: Recording, path: Path
) -> None:
    one = observer()
    by_hand = keeper(path, automatic=False)
    with pytest.raises(GrayBoxError, match='nothing to save yet'):
        by_hand.save(one)
    feed(one, recording, 0, 500)
    assert by_hand.save(one) == str(path)
    assert by_hand.load(other := observer()) == str(path)
    assert learnt(other) == learnt(one)
    by_hand.path = '../elsewhere'
    for action in (by_hand.save, by_hand.load):
        with pytest.raises(GrayBoxError, match=r"must not hold '\.\.'"):
            action(one)
    assert by_hand.close(one) is None


def test_a_disk_that_refuses_is_told_by_hand_and_automatically_and_tried_again(
    recording: Recording, path: Path
) -> None:
    one = observer()
    feed(one, recording, 0, 500)
    kept = keeper(path / 'below' / 'c.safetensors')
    path.write_text('a file, no folder')
    with pytest.raises(GrayBoxError, match=r'cannot write .*c'):
        kept.save(one)
    failure = kept.close(one)
    assert failure is not None
    assert failure == kept.failure
    path.unlink()
    later = keeper(path / 'below' / 'c.safetensors')
    later.keep(one)
    assert later.close(one) is None
    assert later.failure is None


def snapshot(number: int) -> Snapshot:
    return Snapshot(json.dumps({'number': number}), {'a': np.full(3, number)})


def test_the_newest_snapshot_takes_the_place_of_those_that_wait(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun = threading.Event()
    go_on = threading.Event()
    real = checkpoint.write
    seen = []

    def slow(one: Snapshot, to: Path) -> None:
        seen.append(json.loads(one.content)['number'])
        begun.set()
        assert go_on.wait(PATIENCE_S)
        real(one, to)

    monkeypatch.setattr(checkpoint, 'write', slow)
    writer = CheckpointWriter()
    writer.submit(snapshot(1), path)
    assert begun.wait(PATIENCE_S)
    for number in (2, 3, 4):
        writer.submit(snapshot(number), path)
    assert not writer.flush(0.0), 'the disk has not answered yet'
    go_on.set()
    assert writer.close(PATIENCE_S)
    assert seen == [1, 4]
    assert writer.written_count == 2
    assert decode(path.read_bytes())[0] == {'number': 4}


def test_a_disk_that_hangs_does_not_keep_anybody_from_ending(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    go_on = threading.Event()
    monkeypatch.setattr(checkpoint, 'write', lambda *_: go_on.wait(PATIENCE_S))
    writer = CheckpointWriter()
    writer.submit(snapshot(1), path)
    assert not writer.close(0.01)
    go_on.set()
    assert writer.flush(PATIENCE_S)


def test_a_defect_of_writing_is_told_and_the_next_checkpoint_is_written(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def defect(*_: Any) -> None:
        raise RecursionError('too deep')

    writer = CheckpointWriter()
    with monkeypatch.context() as patch:
        patch.setattr(checkpoint, 'write', defect)
        writer.submit(snapshot(1), path)
        assert writer.flush(PATIENCE_S)
    assert writer.failure == f"{path}: RecursionError('too deep')"
    writer.submit(snapshot(2), path)
    assert writer.close(PATIENCE_S)
    assert writer.failure is None
    assert decode(path.read_bytes())[0] == {'number': 2}


def test_a_writer_that_never_wrote_has_nothing_to_end() -> None:
    assert CheckpointWriter().close(0.0)


def test_what_killed_writers_left_is_swept_up_and_what_others_write_is_not(path: Path) -> None:
    old, young = (path.with_name(f'.{path.name}.{32 * digit}{PARTIAL}') for digit in '01')
    other = path.with_name(f'.other.{32 * "0"}{PARTIAL}')
    named = path.with_name(f'.{path.name}.mine{PARTIAL}')
    for scrap in (old, young, other, named):
        scrap.write_bytes(b'half a che')
    for scrap in (old, other, named):
        age = scrap.stat().st_mtime - SCRAP_AGE_S - 10.0
        os.utime(scrap, (age, age))
    checkpoint.write(snapshot(1), path)
    assert {entry.name for entry in path.parent.iterdir()} == {
        path.name,
        young.name,
        other.name,
        named.name,
    }


def strange(path: Path) -> dict[str, Callable[[], None]]:
    """Ways in which something else may stand where the checkpoint should."""

    def sparse() -> None:
        with path.open('wb') as file:
            file.truncate(1 << 40)

    return {
        'text': lambda: path.write_text('ssh-ed25519 AAAA... operator'),
        'other arrays': lambda: path.write_bytes(SHIPPED.read_bytes()),
        'pipe': lambda: os.mkfifo(path),
        'folder': path.mkdir,
        'link to a checkpoint': lambda: path.symlink_to(path.with_name('other.safetensors')),
        'link to a device': lambda: path.symlink_to('/dev/zero'),
        'link to nothing': lambda: path.symlink_to(path.with_name('none')),
        'sparse': sparse,
    }


STRANGE = tuple(strange(Path()))


@pytest.mark.parametrize('kind', STRANGE)
def test_what_is_no_checkpoint_of_ours_is_told_of_and_never_replaced_renamed_or_removed(
    recording: Recording, path: Path, kind: str
) -> None:
    one = observer()
    feed(one, recording, 0, 500)
    other = path.with_name('other.safetensors')
    save(one, other)
    kept = other.read_bytes()
    before = learnt(one)
    strange(path)[kind]()
    stood = path.lstat()
    kept_by = keeper(path)
    if kind != 'link to nothing':
        resumed = kept_by.resume(fresh := observer())
        assert resumed.is_found
        assert resumed.refusal is not None
        assert resumed.refusal.isprintable()
        assert fresh.motors == {}
    with pytest.raises(GrayBoxError, match=r'cannot read|is not a checkpoint'):
        kept_by.load(one)
    assert learnt(one) == before
    with pytest.raises(
        GrayBoxError,
        match=r'cannot write .*(no checkpoint of this package; move it away|directory)',
    ):
        kept_by.save(one)
    assert kept_by.forget() is None
    assert kept_by.close(one) is not None
    assert (path.lstat().st_ino, path.lstat().st_mtime_ns) == (stood.st_ino, stood.st_mtime_ns)
    assert other.read_bytes() == kept
    assert {entry.name for entry in path.parent.iterdir()} == {path.name, other.name}


def test_a_link_out_of_the_folder_laid_while_it_runs_is_a_failure_until_it_goes(
    recording: Recording, path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    foreign = tmp_path_factory.mktemp('elsewhere') / 'foreign.safetensors'
    foreign.write_text('notes of the operator')
    one = observer()
    kept = CheckpointKeeper(
        CheckpointFolder(str(path.parent), path.name, path), path.name, automatic=True
    )
    path.symlink_to(foreign)
    feed(one, recording, 0, 500)
    kept.keep(one)
    assert kept.failure is not None
    assert 'leads out of' in kept.failure
    assert kept.forget() is None
    refusal = kept.resume(observer()).refusal
    assert refusal is not None
    assert refusal.endswith('it is left as it is')
    assert foreign.read_text() == 'notes of the operator'
    path.unlink()
    kept.keep(one)
    assert kept.close(one) is None, 'it is tried again though nothing was learnt since'
    checkpoint.load(observer(), path)
    path.unlink()
    path.symlink_to(foreign)
    feed(one, recording, 500, 600)
    failure = kept.close(one)
    assert failure is not None
    assert 'leads out of' in failure


def test_ten_are_kept_aside_and_the_oldest_of_ours_go(recording: Recording, path: Path) -> None:
    one = observer()
    feed(one, recording, 0, 500)
    foreign = path.with_name(f'{path.name}.reset-3')
    foreign.write_text('notes of the operator')
    kept = keeper(path)
    for _ in range(23):
        kept.keep(one)
        kept._writer.flush(PATIENCE_S)
        assert kept.forget() is not None
    aside = {entry.name for entry in path.parent.iterdir()}
    assert aside == {foreign.name, *(f'{path.name}.reset-{number}' for number in range(17, 27))}
    assert foreign.read_text() == 'notes of the operator'


def test_a_name_that_stands_twice_is_refused(recording: Recording, path: Path) -> None:
    one = observer()
    feed(one, recording, 0, 500)
    snapshot = capture(one)
    path.write_bytes(encode_content(snapshot.content[:-1] + ', "motors": {}}', snapshot.arrays))
    with pytest.raises(
        GrayBoxError, match='does not hold what this release expects: motors stands there twice'
    ):
        checkpoint.load(observer(), path)


Spoil = Callable[[dict[str, Any], dict[str, Any]], Any]

ABSURD: dict[str, tuple[Spoil, str]] = {
    'next_fit': (lambda plain, _: plain['context_nodes'].update(next_fit=10**30), 'next_fit is 10'),
    'a change of what is unknown': (
        lambda plain, _: plain['context_nodes'].update(started=False, asked=64),
        'nothing is known yet cannot have changed',
    ),
    'a covariance': (
        lambda _, arrays: arrays['belief.covariance'].fill(np.nan),
        'holds what is no number',
    ),
    'noise': (lambda _, arrays: arrays['belief.noise'].fill(0.0), 'belief.noise holds 0'),
    'new': (lambda plain, _: plain['context_nodes'].update(new=-1), 'new is -1'),
    'a flag': (
        lambda plain, _: plain.update(identified=1),
        'identified is 1, expected true or false',
    ),
    'a sample': (lambda _, arrays: arrays['replay'].fill(np.inf), 'replay is not finite'),
    'a verdict': (lambda plain, _: plain['delay'].update(verdict='SURE'), "verdict is 'SURE'"),
}


@pytest.mark.parametrize('what', ABSURD)
def test_absurd_content_under_a_right_checksum_is_refused_by_name_and_nothing_is_lost(
    recording: Recording, path: Path, what: str
) -> None:
    one = observer()
    feed(one, recording, 0, 500)
    snapshot = capture(one)
    before = learnt(one)
    content = json.loads(snapshot.content)
    arrays = {name: array.copy() for name, array in snapshot.arrays.items()}
    spoil, message = ABSURD[what]
    spoil(
        content['motors']['motor'],
        {name.removeprefix('motor/nodes/'): array for name, array in arrays.items()},
    )
    path.write_bytes(encode(content, arrays))
    with pytest.raises(GrayBoxError, match=message):
        keeper(path).load(one)
    assert learnt(one) == before
    resumed = keeper(path).resume(fresh := observer())
    assert resumed.refusal is not None
    assert resumed.refusal.endswith(f'; it is kept as {path}.refused')
    assert fresh.motors == {}
