"""ROS parameter files: what one gives to the observer, by dotted names."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gray_box_observer.errors import ConfigurationError, InputError, brief
from gray_box_observer.safe_io.bounded_yaml import read_yaml

NODE_NAME = 'gray_box_observer'


def read_parameter_file(path: Path) -> dict[str, Any]:
    """What a ROS parameter file gives to the observer, by dotted names.

    Raises:
        ConfigurationError: no such file, not YAML, or nothing for the observer in it.
    """
    try:
        document = read_yaml(path)
    except InputError as error:
        raise ConfigurationError(f'parameter file {error}') from None
    flat_values: dict[str, Any] = {}
    for node, content in document.items() if isinstance(document, dict) else ():
        if str(node).strip('/') in ('**', NODE_NAME) or str(node).endswith(f'/{NODE_NAME}'):
            if not isinstance(content, dict) or not isinstance(
                content.get('ros__parameters'), dict
            ):
                raise ConfigurationError(f'{path}: expected ros__parameters below {brief(node)}')
            try:
                flat_values.update(flatten(content['ros__parameters']))
            except ConfigurationError as error:
                raise ConfigurationError(f'parameter file {path}: {error}') from None
    if not flat_values:
        raise ConfigurationError(
            f'{path} holds no parameters for {NODE_NAME}: expected "/**:" with "ros__parameters:"'
        )
    return flat_values


def flatten(tree: Mapping[str, Any], prefix: str = '') -> dict[str, Any]:
    """Turn nested groups into dotted names.

    Raises:
        ConfigurationError: a name is there twice, once with a dot and once as a group.
    """
    flat: dict[str, Any] = {}
    for name, value in tree.items():
        dotted_name = f'{prefix}{name}'
        values = (
            flatten(value, f'{dotted_name}.')
            if isinstance(value, Mapping)
            else {dotted_name: value}
        )
        twice = next((dotted_key for dotted_key in values if dotted_key in flat), None)
        if twice is not None:
            raise ConfigurationError(f'parameter {brief(twice)} stands twice')
        flat.update(values)
    return flat
