"""Sections of parameter files: which names were given to one node, and which to many.

rclpy hands over the sections of a file that fit a node as one. A section whose name ends in a
wildcard (``/**``, ``/*``) serves every node: that a node lacks a name of it says nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from gray_box_observer.errors import InputError
from gray_box_observer.safe_io.bounded_yaml import read_yaml

PARAMETERS = 'ros__parameters'

FILE_OPTION = '--params-file'


def names_of_node(args: Sequence[str], node_name: str) -> set[str]:
    """Return the parameters that the files of a command line give to a node by its name.

    Args:
        args: the command line.
        node_name: without its namespace.

    Returns:
        Names with dots; what stands below a wildcard alone is not among them.
    """
    return {
        name
        for option, path in pairwise(args)
        if option == FILE_OPTION
        for section, parameters in sections(_document(path))
        if section.rpartition('/')[2] == node_name
        for name in _dotted_names(parameters)
    }


def _document(path: str) -> Any:
    """Return what a file holds; nothing where it cannot be read, which rcl has to say."""
    try:
        return read_yaml(Path(path))
    except InputError:
        return None


def sections(tree: Any, above: str = '') -> Iterator[tuple[str, Any]]:
    """Yield the sections of a file, nested namespaces joined by slashes, with their parameters."""
    for key, value in tree.items() if isinstance(tree, Mapping) else ():
        if key == PARAMETERS:
            yield above, value
        else:
            yield from sections(value, f'{above}/{key}')


def _dotted_names(tree: Any, above: str = '') -> Iterator[str]:
    """Yield the names of parameters in nested groups."""
    for key, value in tree.items() if isinstance(tree, Mapping) else ():
        name = f'{above}{key}'
        if isinstance(value, Mapping):
            yield from _dotted_names(value, f'{name}.')
        else:
            yield name
