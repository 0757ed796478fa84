"""The command lines of ``recorder`` and ``player``, beside those of ``ros2 bag``."""

from __future__ import annotations

from typing import Any

import pytest

from gray_box_observer.ros.bags import player_arguments, recorder_arguments


@pytest.mark.parametrize(
    ('words', 'values'),
    [
        (['-l'], {'loop': True}),
        (['--loop'], {'loop': True}),
        (['-p'], {'paused': True}),
        (['--start-paused'], {'paused': True}),
        (['--clock'], {'clock': True}),
        (['--clock', '--rate', '40'], {'clock': True, 'rate': 40.0}),
        ([], {}),
    ],
)
def test_an_option_of_the_player_stands_for_a_parameter(
    words: list[str], values: dict[str, Any]
) -> None:
    parser = player_arguments.make_parser()
    for line in (['bag', *words], [*words, 'bag']):
        options = parser.parse_args(line)
        assert options.bag == 'bag'
        assert player_arguments.by_command_line(options) == values


@pytest.mark.parametrize(
    'words',
    [
        ['--clock', '40', 'bag'],
        ['bag', '--clock', '40'],
        ['bag', '--clock=40'],
        ['bag', '--clock', '1e2'],
    ],
)
def test_a_rate_of_the_clock_is_refused_with_the_word_that_serves(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as end:
        player_arguments.make_parser().parse_args(words)
    assert end.value.code == 2
    last_line = capsys.readouterr().err.splitlines()[-1]
    assert last_line.startswith('player: error: --clock has no rate here; leave it out: ')


LOG_LEVEL = 'say --ros-args --log-level LEVEL'


@pytest.mark.parametrize(
    ('name', 'words', 'remedy'),
    [
        ('player', ['--log-level', 'debug'], LOG_LEVEL),
        ('player', ['--progress-bar', '10'], 'leave it out: a terminal is told'),
        ('player', ['--progress-bar-update-rate', '3'], 'leave it out: a terminal is told'),
        ('player', ['--message-order', 'sent'], 'leave it out: messages come in the order'),
        ('recorder', ['--log-level', 'debug'], LOG_LEVEL),
        ('recorder', ['--topic-types', 'sensor_msgs/msg/Imu'], 'name what is wanted, or --all'),
        ('recorder', ['--exclude-topic-types', 'x/msg/Y'], 'name what is wanted, or --all'),
        ('recorder', ['--ignore-leaf-topics'], 'name what is wanted, or --all'),
        ('recorder', ['--custom-data', 'robot=r1'], 'leave it out: keep notes in a file'),
        ('recorder', ['-p', '100'], 'leave it out: topics that appear later are recorded'),
    ],
)
def test_what_ros2_bag_has_beyond_is_refused_with_the_word_that_serves(
    name: str, words: list[str], remedy: str, capsys: pytest.CaptureFixture[str]
) -> None:
    module = {'player': player_arguments, 'recorder': recorder_arguments}[name]
    with pytest.raises(SystemExit) as end:
        module.make_parser().parse_args(words)
    assert end.value.code == 2
    last_line = capsys.readouterr().err.splitlines()[-1]
    assert last_line.startswith(
        f'{name}: error: {words[0]} of ros2 bag is not known here; {remedy}'
    )
