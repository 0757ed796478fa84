"""Parameters that were given to a node and that it does not have: refused, or passed over.

A name on the command line is meant for this node and has to be one of its own. A parameter file may
serve several nodes: of its names, slips of the node's own are refused. Of others the log warns
where the file's section names this node, or where a name is the node's own but for its group: that
of a motor that is not listed, none, or a range of motors. What else stands below a wildcard is that
of other nodes.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise

from rclpy.node import Node

from gray_box_observer.errors import ConfigurationError
from gray_box_observer.ros.parameter_sections import names_of_node
from gray_box_observer.safe_io.printable import printable
from gray_box_observer.settings.parameter_names import (
    MOST_COMPARED,
    in_words,
    is_of_another_group,
    nearest,
    slip_of,
    without_group,
)

Known = Callable[[str], Iterable[str]]
"""Gives the names that an unknown one may have been meant for."""

_OPTIONS = ('-p', '--param')


def settle(
    node: Node, unknown_names: Sequence[str], valid_names: Known, args: Sequence[str] | None = None
) -> None:
    """Refuse unknown parameters, or warn of them.

    Args:
        node: to which they were given.
        unknown_names: their names.
        valid_names: gives the names that each may have been meant for.
        args: the command line; None for the process's own.

    Raises:
        ConfigurationError: one of them was meant for this node.
    """
    words = sys.argv if args is None else args
    command_line_names = _on_command_line(words)
    slips = {
        name: nearest(name, valid_names(name))
        for place, name in enumerate(unknown_names)
        if name in command_line_names
        or (place < MOST_COMPARED and slip_of(name, valid_names(name)))
    }
    if slips:
        kind = 'parameters' if len(slips) > 1 else 'a parameter'
        raise ConfigurationError(
            printable(f'not {kind} of this node: {in_words(slips)}; --help lists them')
        )
    if not unknown_names:
        return
    own_section_names = names_of_node(words, node.get_name())
    known_names = {name: without_group(name, valid_names(name)) for name in unknown_names}
    dubious_names = [
        name
        for name in unknown_names
        if name in own_section_names
        or known_names[name]
        or is_of_another_group(name, valid_names(name))
    ]
    log = node.get_logger()
    if dubious_names:
        names = in_words({name: known_names[name] for name in dubious_names})
        log.warning(printable(f'not of this node, ignored: {names}; --help lists its parameters'))
    others = sorted(set(unknown_names) - set(dubious_names))
    if others:
        names = in_words(dict.fromkeys(others, ''))
        log.debug(printable(f'of other nodes, by a wildcard in a parameter file: {names}'))


def _on_command_line(args: Sequence[str]) -> set[str]:
    """Names of parameters that a command line gives: of ``-p NODE:NAME:=VALUE`` the name."""
    return {
        text.partition(':=')[0].rpartition(':')[2]
        for option, text in pairwise(args)
        if option in _OPTIONS and ':=' in text
    }
