from __future__ import annotations

from pathlib import Path

import pytest

from gray_box_observer.errors import BagError
from gray_box_observer.identify.archive.bag_search import find_bags


def make(folder: Path, *names: str) -> Path:
    for name in names:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    return folder


def test_folders_are_looked_through_and_a_folder_with_metadata_is_one_bag(tmp_path: Path) -> None:
    make(
        tmp_path,
        'b/metadata.yaml',
        'b/b_0.mcap',
        'b/b_1.mcap',
        'a/deep/c.mcap',
        'a/notes.txt',
        'z.mcap',
    )
    assert find_bags([tmp_path]) == [
        tmp_path / 'z.mcap',
        tmp_path / 'a/deep/c.mcap',
        tmp_path / 'b',
    ]


def test_what_a_killed_recorder_left_is_one_bag(tmp_path: Path) -> None:
    make(tmp_path, 'run/run_0.mcap', 'run/run_1.mcap', 'day/run_0.mcap', 'day/run_1.mcap')
    assert find_bags([tmp_path]) == [
        tmp_path / 'day/run_0.mcap',
        tmp_path / 'day/run_1.mcap',
        tmp_path / 'run',
    ]


def test_a_bag_is_itself_and_is_read_once_however_often_it_is_named(tmp_path: Path) -> None:
    make(tmp_path, 'b/metadata.yaml', 'b/b_0.mcap', 'run.bag')
    named = [tmp_path / 'b', tmp_path, tmp_path / 'run.bag', tmp_path / 'x' / '..' / 'b']
    (tmp_path / 'x').mkdir()
    assert find_bags(named) == [tmp_path / 'b', tmp_path / 'run.bag']


def test_a_relative_place_gives_absolute_paths(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make(tmp_path, 'a.mcap')
    monkeypatch.chdir(tmp_path)
    assert find_bags([Path()]) == find_bags([Path('a.mcap')]) == [tmp_path / 'a.mcap']


def test_hidden_places_and_links_to_folders_are_left_out(tmp_path: Path) -> None:
    make(tmp_path, 'a.mcap', '.trash/b.mcap', '.hidden.mcap')
    (tmp_path / 'again').symlink_to(tmp_path)
    assert find_bags([tmp_path]) == [tmp_path / 'a.mcap']


def test_a_place_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BagError, match='gone: no such bag or folder of bags'):
        find_bags([tmp_path / 'gone'])


def test_a_folder_without_bags_is_refused(tmp_path: Path) -> None:
    make(tmp_path, 'a/notes.txt')
    with pytest.raises(BagError, match='no bag in this folder'):
        find_bags([tmp_path])
