from __future__ import annotations

from pathlib import Path

import pytest

from gray_box_observer.checkpoints.checkpoint_folder import CheckpointFolder, default_folder
from gray_box_observer.errors import ConfigurationError

NAME = 'c.safetensors'


@pytest.fixture
def folder(tmp_path: Path) -> CheckpointFolder:
    (tmp_path / 'kept').mkdir()
    return CheckpointFolder(str(tmp_path / 'kept'), 'c.safetensors', tmp_path / 'default')


@pytest.mark.parametrize(
    'path', ['c.safetensors', 'left/wheel/c.safetensors', './c.safetensors', '~.safetensors']
)
def test_a_relative_path_is_one_in_the_folder(folder: CheckpointFolder, path: str) -> None:
    (folder.folder / 'left' / 'wheel').mkdir(parents=True)
    assert folder.file(path) == folder.folder / path


@pytest.mark.parametrize('path', ['left/c.safetensors', 'left/wheel/c.safetensors'])
def test_a_folder_named_after_the_start_has_to_be_there(
    folder: CheckpointFolder, path: str
) -> None:
    with pytest.raises(ConfigurationError, match=r'names a folder that is not there: make .*left'):
        folder.file(path)
    with pytest.raises(ConfigurationError, match='names a folder that is not there'):
        folder.file(f'{folder.folder}/{path}')


def test_the_folders_given_at_the_start_need_not_be_there(tmp_path: Path) -> None:
    kept = CheckpointFolder(str(tmp_path / 'kept'), 'left/c.safetensors', tmp_path / 'default')
    for path in ('left/c.safetensors', 'left/d.safetensors', 'd.safetensors'):
        assert kept.file(path) == tmp_path / 'kept' / path
    assert not (tmp_path / 'kept').exists()


def test_an_absolute_path_in_the_folder_is_what_it_is(folder: CheckpointFolder) -> None:
    (folder.folder / 'a').mkdir()
    assert folder.file(f'{folder.folder}/a/c.safetensors') == folder.folder / 'a' / 'c.safetensors'


@pytest.mark.parametrize(
    'path', ['../c.safetensors', 'a/../../c.safetensors', 'a/../c.safetensors', '{}/../c']
)
def test_two_dots_are_refused_wherever_they_lead(folder: CheckpointFolder, path: str) -> None:
    with pytest.raises(ConfigurationError, match=r"must not hold '\.\.'"):
        folder.file(path.format(folder.folder))


@pytest.mark.parametrize('path', ['/etc/passwd', '{}x/c.safetensors', '{}'])
def test_an_absolute_path_elsewhere_is_refused_with_the_folder(
    folder: CheckpointFolder, path: str
) -> None:
    elsewhere = path.format(folder.folder) if path != '{}' else str(folder.folder.parent)
    with pytest.raises(
        ConfigurationError, match=r'leads out of .*kept: give a path in there'
    ) as caught:
        folder.file(elsewhere)
    assert '\n' not in str(caught.value)


@pytest.mark.parametrize('path', ['', '.', '/', 'a\0b'])
def test_what_is_no_name_of_a_file_is_refused(folder: CheckpointFolder, path: str) -> None:
    with pytest.raises(ConfigurationError, match=r'must be the name of a file'):
        folder.file(path)


@pytest.mark.parametrize('path', ['a' * 201, 'ä' * 101, 'a/' * 64 + 'b', 'a' * 5000 + '/c'])
def test_what_no_file_system_would_bear_is_refused(folder: CheckpointFolder, path: str) -> None:
    with pytest.raises(
        ConfigurationError,
        match='must not be deeper than 64 folders or hold names of more than 200',
    ):
        folder.file(path)


def test_links_are_followed_and_must_stay_inside(folder: CheckpointFolder) -> None:
    (folder.folder / 'out').symlink_to(folder.folder.parent)
    (folder.folder / 'file').symlink_to('/etc/passwd')
    (folder.folder / 'a').mkdir()
    (folder.folder / 'in').symlink_to(folder.folder / 'a')
    (folder.folder / 'round').symlink_to(folder.folder / 'round')
    for path in ('out/c.safetensors', 'out/new/c.safetensors', 'file'):
        with pytest.raises(ConfigurationError, match='leads out of'):
            folder.file(path)
    assert folder.file('in/c.safetensors') == folder.folder / 'in' / 'c.safetensors'
    with pytest.raises(ConfigurationError, match='cannot be followed'):
        folder.file('round/c')


def test_a_folder_that_is_a_link_itself_is_no_way_out(tmp_path: Path) -> None:
    (tmp_path / 'real' / 'a').mkdir(parents=True)
    (tmp_path / 'link').symlink_to(tmp_path / 'real')
    linked = CheckpointFolder(str(tmp_path / 'link'), 'c.safetensors', tmp_path)
    assert linked.file('a/c.safetensors') == tmp_path / 'link' / 'a' / 'c.safetensors'
    assert linked.file(f'{tmp_path}/real/c.safetensors') == tmp_path / 'real' / 'c.safetensors'


def test_an_absolute_path_at_the_start_declares_its_own_folder(tmp_path: Path) -> None:
    start = str(tmp_path / 'mine' / 'c.safetensors')
    own = CheckpointFolder('', start, Path('/default'))
    assert own.folder == tmp_path / 'mine'
    assert own.file(start) == Path(start)
    assert own.file('other.safetensors') == tmp_path / 'mine' / 'other.safetensors'
    with pytest.raises(ConfigurationError, match='leads out of'):
        own.file(str(tmp_path / 'c.safetensors'))


def test_a_folder_that_is_a_link_and_named_at_the_start_is_trusted(tmp_path: Path) -> None:
    (tmp_path / 'b').mkdir()
    (tmp_path / 'a').symlink_to(tmp_path / 'b')
    start = tmp_path / 'a' / 'c.safetensors'
    assert CheckpointFolder('', str(start), tmp_path).file(str(start)) == start


def test_a_folder_and_a_path_that_contradict_each_other_are_refused_at_the_start(
    tmp_path: Path,
) -> None:
    with pytest.raises(ConfigurationError, match='leads out of'):
        CheckpointFolder(str(tmp_path / 'a'), str(tmp_path / 'b' / 'c'), tmp_path)


def test_without_a_word_the_folder_is_that_of_the_node_below_ros_home(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv('ROS_HOME', str(tmp_path))
    assert default_folder('/left/gray_box_observer') == tmp_path / 'left' / 'gray_box_observer'
    assert CheckpointFolder('', NAME, default_folder('/n')).file(NAME) == tmp_path / 'n' / NAME
    monkeypatch.delenv('ROS_HOME')
    monkeypatch.setenv('HOME', str(tmp_path / 'home'))
    assert default_folder('/n') == tmp_path / 'home' / '.ros' / 'n'
    assert CheckpointFolder('~/x', NAME, Path('/')).folder == tmp_path / 'home' / 'x'


OBEYED = (
    '.bashrc',
    '.ssh/authorized_keys',
    '.config/c.safetensors',
    '.safetensors',
    'a/.c.safetensors',
    '..hidden',
)


@pytest.mark.parametrize('path', OBEYED)
def test_no_name_that_begins_with_a_dot_is_a_checkpoint_wherever_it_lies(
    tmp_path: Path, path: str
) -> None:
    home = CheckpointFolder('', str(tmp_path / NAME), Path('/default'))
    for way in (path, str(tmp_path / path)):
        with pytest.raises(ConfigurationError, match=r"must hold no name that begins with '\.'"):
            home.file(way)


@pytest.mark.parametrize(
    'path', ['crontab', 'c.safetensors.reset', 'c.safetensors~', 'a/id_rsa', 'C.SAFETENSORS']
)
def test_no_other_ending_is_a_checkpoint(folder: CheckpointFolder, path: str) -> None:
    with pytest.raises(
        ConfigurationError, match=r'must end in \.safetensors, got .*: no other file is written'
    ):
        folder.file(path)


@pytest.mark.parametrize('name', ['.bashrc', 'crontab', '.c.safetensors'])
def test_nor_is_one_that_is_named_at_the_start(tmp_path: Path, name: str) -> None:
    for given, path in (('', str(tmp_path / name)), (str(tmp_path), name)):
        with pytest.raises(ConfigurationError, match=r'must (end in|hold no name that begins)'):
            CheckpointFolder(given, path, Path('/default'))


def test_a_link_inside_to_a_name_that_is_obeyed_is_refused(folder: CheckpointFolder) -> None:
    (folder.folder / 'c.safetensors').symlink_to(folder.folder / '.bashrc')
    with pytest.raises(ConfigurationError, match='must hold no name that begins with'):
        folder.file('c.safetensors')


@pytest.mark.parametrize('path', ['c\n.safetensors', 'c\x1b[2J.safetensors', 'c\u202e.safetensors'])
def test_a_name_with_what_a_terminal_would_obey_is_refused_and_shown(
    folder: CheckpointFolder, path: str
) -> None:
    with pytest.raises(ConfigurationError, match='must be the name of a file') as caught:
        folder.file(path)
    assert str(caught.value).isprintable()
