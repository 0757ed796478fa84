"""What a command line says of arguments that it does not know, without a terminal obeying them."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from gray_box_observer.identify import command
from gray_box_observer.ros.bags import player_node, recorder_node
from gray_box_observer.ros.observer import observer_node
from gray_box_observer.ros.watching import dashboard_command, watch_command

MAINS = {
    'observer': observer_node.main,
    'recorder': recorder_node.main,
    'player': player_node.main,
    'watch': watch_command.main,
    'dashboard': dashboard_command.main,
    'identify': command.main,
}


@pytest.mark.parametrize('name', MAINS)
def test_a_wrong_argument_is_shown_and_not_obeyed(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    main: Callable[[list[str]], int] = MAINS[name]
    with pytest.raises(SystemExit) as end:
        main([name, 'bag', '--no\x1b[31mred\x9b2J'])
    assert end.value.code == 2
    last_line = capsys.readouterr().err.splitlines()[-1]
    assert last_line.isprintable()
    assert r'--no\x1b[31mred\x9b2J' in last_line
