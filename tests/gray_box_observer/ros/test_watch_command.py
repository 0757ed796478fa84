"""The command line of ``watch``, without ROS."""

from __future__ import annotations

from pathlib import Path

import pytest

from gray_box_observer.ros.watching import watch_command

MODERATE = Path(__file__).resolve().parents[3] / 'bags' / 'moderate'


def test_a_bag_ends_with_its_last_table(capsys: pytest.CaptureFixture[str]) -> None:
    assert watch_command.main(['watch', str(MODERATE), '--once']) == 0
    out, err = capsys.readouterr()
    assert out.count('1 motor, 1 identified') == 1
    assert err == ''


@pytest.mark.parametrize(
    ('words', 'complaint'),
    [
        (['--rate', '2'], '--rate is for a BAG'),
        (['--params', 'x.yaml'], '--params is for a BAG'),
        (['--period', '0'], '--period must be'),
        (['--period', 'soon'], 'is no number'),
        (['--timeout', '0'], '--timeout must be'),
        (['--motors', '0'], '--motors must be'),
        (['bag', '--rate', '-1'], '--rate must be'),
        (['bag', '--ros-args', '-p', 'x:=1'], 'is for live topics'),
        (['--nosuch'], 'unrecognized arguments'),
    ],
)
def test_a_wrong_word_is_refused(
    words: list[str], complaint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as end:
        watch_command.main(['watch', *words])
    assert end.value.code == 2
    assert complaint in capsys.readouterr().err


@pytest.mark.parametrize(
    'words', [('-p', 'nosuch:=1'), ('--param', 'a:=1'), ('--params-file', 'x.yaml')]
)
def test_parameters_are_refused_for_nobody_would_read_them(
    words: tuple[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert watch_command.main(['watch', '--ros-args', *words]) == 2
    said = capsys.readouterr().err
    assert said == (
        f'watch: error: {" ".join(words)}: this node has no parameters; --help lists its options\n'
    )


def test_the_time_of_a_simulation_may_be_given_to_every_node() -> None:
    words = ['--ros-args', '-p', 'use_sim_time:=true', '-p', 'gray_box_watch:use_sim_time:=true']
    watch_command.refuse_parameters(words)


def test_a_bag_that_is_none_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert watch_command.main(['watch', str(tmp_path / 'nothing')]) == 2
    err = capsys.readouterr().err
    assert err.startswith('watch: error: ') and err.count('\n') == 1


def test_a_mistyped_parameter_is_refused_before_the_bag_is_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    params = tmp_path / 'p.yaml'
    params.write_text('/**: {ros__parameters: {gap: 1.0}}')
    assert watch_command.main(['watch', str(MODERATE), '--params', str(params)]) == 2
    err = capsys.readouterr().err
    assert 'gap (did you mean gap_s?)' in err and err.count('\n') == 1


def test_words_of_ros_end_at_two_dashes() -> None:
    words = ['a', '--ros-args', '-r', '__ns:=/r', '--', 'b']
    assert watch_command.part_words(words) == (['a', 'b'], ['--ros-args', '-r', '__ns:=/r', '--'])
