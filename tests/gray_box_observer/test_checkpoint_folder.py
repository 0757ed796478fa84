from __future__ import annotations

from pathlib import Path

import pytest

from gray_box_observer.checkpoint_folder import CheckpointFolder, default_folder
from gray_box_observer.errors import ConfigurationError


@pytest.fixture
def folder(tmp_path: Path) -> CheckpointFolder:
    (tmp_path / 'kept').mkdir()
    return CheckpointFolder(str(tmp_path / 'kept'), 'c.safetensors', tmp_path / 'default')


@pytest.mark.parametrize('path', ['c.safetensors', 'left/wheel/c.safetensors', './c.safetensors', '~', '..hidden'])
def test_a_relative_path_is_one_in_the_folder(folder: CheckpointFolder, path: str) -> None:
    assert folder.file(path) == folder.folder / path


def test_an_absolute_path_in_the_folder_is_what_it_is(folder: CheckpointFolder) -> None:
    assert folder.file(f'{folder.folder}/a/c.safetensors') == folder.folder / 'a' / 'c.safetensors'


@pytest.mark.parametrize('path', ['../c.safetensors', 'a/../../c.safetensors', 'a/../c.safetensors', '{}/../c'])
def test_two_dots_are_refused_wherever_they_lead(folder: CheckpointFolder, path: str) -> None:
    with pytest.raises(ConfigurationError, match=r"must not hold '\.\.'"):
        folder.file(path.format(folder.folder))


@pytest.mark.parametrize('path', ['/etc/passwd', '{}x/c.safetensors', '{}'])
def test_an_absolute_path_elsewhere_is_refused_with_the_folder(folder: CheckpointFolder, path: str) -> None:
    elsewhere = path.format(folder.folder) if path != '{}' else str(folder.folder.parent)
    with pytest.raises(ConfigurationError, match=r'leads out of .*kept: give a path in there') as caught:
        folder.file(elsewhere)
    assert '\n' not in str(caught.value)


@pytest.mark.parametrize('path', ['', '.', '/', 'a\0b'])
def test_what_is_no_name_of_a_file_is_refused(folder: CheckpointFolder, path: str) -> None:
    with pytest.raises(ConfigurationError, match=r'must be the name of a file'):
        folder.file(path)


@pytest.mark.parametrize('path', ['a' * 201, 'ä' * 101, 'a/' * 64 + 'b', 'a' * 5000 + '/c'])
def test_what_no_file_system_would_bear_is_refused(folder: CheckpointFolder, path: str) -> None:
    with pytest.raises(ConfigurationError, match='must not be deeper than 64 folders or hold names of more than 200'):
        folder.file(path)


def test_links_are_followed_and_must_stay_inside(folder: CheckpointFolder) -> None:
    (folder.folder / 'out').symlink_to(folder.folder.parent)
    (folder.folder / 'file').symlink_to('/etc/passwd')
    (folder.folder / 'in').symlink_to(folder.folder / 'a')
    (folder.folder / 'round').symlink_to(folder.folder / 'round')
    for path in ('out/c', 'out/new/c', 'file'):
        with pytest.raises(ConfigurationError, match='leads out of'):
            folder.file(path)
    assert folder.file('in/c') == folder.folder / 'in' / 'c'
    with pytest.raises(ConfigurationError, match='cannot be followed'):
        folder.file('round/c')


def test_a_folder_that_is_a_link_itself_is_no_way_out(tmp_path: Path) -> None:
    (tmp_path / 'real').mkdir()
    (tmp_path / 'link').symlink_to(tmp_path / 'real')
    linked = CheckpointFolder(str(tmp_path / 'link'), 'c', tmp_path)
    assert linked.file('a/c') == tmp_path / 'link' / 'a' / 'c'


def test_an_absolute_path_at_the_start_declares_its_own_folder(tmp_path: Path) -> None:
    start = str(tmp_path / 'mine' / 'c.safetensors')
    own = CheckpointFolder('', start, Path('/default'))
    assert own.folder == tmp_path / 'mine'
    assert own.file(start) == Path(start)
    assert own.file('other') == tmp_path / 'mine' / 'other'
    with pytest.raises(ConfigurationError, match='leads out of'):
        own.file(str(tmp_path / 'c.safetensors'))


def test_a_link_that_is_named_at_the_start_is_trusted_like_its_name(tmp_path: Path) -> None:
    (tmp_path / 'a').mkdir()
    (tmp_path / 'a' / 'c').symlink_to(tmp_path / 'b')
    trusted = CheckpointFolder('', str(tmp_path / 'a' / 'c'), tmp_path)
    assert trusted.file(str(tmp_path / 'a' / 'c')) == tmp_path / 'a' / 'c'
    with pytest.raises(ConfigurationError, match='leads out of'):
        trusted.file('c')


def test_a_folder_and_a_path_that_contradict_each_other_are_refused_at_the_start(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match='leads out of'):
        CheckpointFolder(str(tmp_path / 'a'), str(tmp_path / 'b' / 'c'), tmp_path)


def test_without_a_word_the_folder_is_that_of_the_node_below_ros_home(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv('ROS_HOME', str(tmp_path))
    assert default_folder('/left/gray_box_observer') == tmp_path / 'left' / 'gray_box_observer'
    assert CheckpointFolder('', 'c', default_folder('/n')).file('c') == tmp_path / 'n' / 'c'
    monkeypatch.delenv('ROS_HOME')
    monkeypatch.setenv('HOME', str(tmp_path / 'home'))
    assert default_folder('/n') == tmp_path / 'home' / '.ros' / 'n'
    assert CheckpointFolder('~/x', 'c', Path('/')).folder == tmp_path / 'home' / 'x'
