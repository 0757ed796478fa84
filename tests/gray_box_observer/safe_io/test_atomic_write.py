from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

from gray_box_observer.safe_io.atomic_write import atomic_write


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / 'result.html'


def write(path: Path, data: bytes = b'new', **options: bool) -> None:
    with atomic_write(path, **options) as file:
        file.write(data)


@pytest.mark.parametrize('durable', [False, True])
def test_a_file_takes_the_place_of_the_old_one_and_nothing_else_is_left(
    path: Path, durable: bool
) -> None:
    path.write_bytes(b'old')
    write(path, durable=durable)
    assert path.read_bytes() == b'new'
    assert [entry.name for entry in path.parent.iterdir()] == [path.name]


def test_whoever_reads_meanwhile_sees_the_old_file(path: Path) -> None:
    path.write_bytes(b'old')
    with atomic_write(path) as file:
        file.write(b'new')
        file.flush()
        assert path.read_bytes() == b'old'


def test_where_the_work_fails_the_old_file_stays_and_nothing_else(path: Path) -> None:
    path.write_bytes(b'old')
    with pytest.raises(KeyboardInterrupt), atomic_write(path) as file:
        file.write(b'half')
        raise KeyboardInterrupt
    assert path.read_bytes() == b'old'
    assert [entry.name for entry in path.parent.iterdir()] == [path.name]


def test_a_link_in_its_place_is_replaced_and_what_it_names_is_not_touched(
    path: Path, tmp_path: Path
) -> None:
    victim = tmp_path / 'victim'
    victim.write_bytes(b'precious')
    path.symlink_to(victim)
    write(path)
    assert victim.read_bytes() == b'precious'
    assert not path.is_symlink()
    assert path.read_bytes() == b'new'


def test_what_is_not_whole_yet_is_made_exclusively_under_another_name_every_time(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[tuple[str, int]] = []
    real = os.open

    def spy(name: str, flags: int, *rest: int) -> int:
        opened.append((str(name), flags))
        return real(name, flags, *rest)

    monkeypatch.setattr(os, 'open', spy)
    for _ in range(3):
        write(path)
    exclusive = os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW
    assert len({name for name, _ in opened}) == 3
    assert all(flags & exclusive == exclusive for _, flags in opened)
    assert all(len(Path(name).name) > len(path.name) + 32 for name, _ in opened)


def test_a_private_file_is_its_owner_s_and_another_is_as_the_umask_says(path: Path) -> None:
    before = os.umask(0o027)
    try:
        write(path, private=True)
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
        write(path)
        assert stat.S_IMODE(path.stat().st_mode) == 0o640
    finally:
        os.umask(before)
