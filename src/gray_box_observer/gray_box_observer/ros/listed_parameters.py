"""Parameters in a list: declared on the node, read-only, and in the text of ``--help``."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

from rclpy.node import Node

from gray_box_observer.ros.node_parameters import describe
from gray_box_observer.ros.unknown_parameters import settle
from gray_box_observer.settings.parameters import ParameterSpec


def declare(
    node: Node, specs: Sequence[ParameterSpec], priority_values: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Declare every parameter and return the values by name.

    Args:
        node: Where they are declared.
        specs: The parameters.
        priority_values: Values that precede the given ones, such as those of the command line.

    Raises:
        ConfigurationError: a value of the wrong type or out of its range, or a name that nobody
            declared.
    """
    overrides = {
        name: parameter.value
        for name, parameter in getattr(node, '_parameter_overrides', {}).items()
    }
    overrides.update(priority_values or {})
    values = {spec.name: spec.check(overrides.get(spec.name, spec.default)) for spec in specs}
    for spec in specs:  # rclpy refuses 1 for 1.0, so what was checked is declared
        node.declare_parameter(spec.name, values[spec.name], describe(spec), ignore_override=True)
    unknown_names = sorted(name for name in overrides if not node.has_parameter(name))
    settle(node, unknown_names, lambda _: values)
    return values


def help_text(
    specs: Sequence[ParameterSpec], heading: str = 'parameters (--ros-args -p NAME:=VALUE)'
) -> str:
    """What ``--help`` says of the parameters, their defaults as YAML takes them."""
    width = max(len(spec.name) for spec in specs) + 4
    lines = [
        textwrap.fill(
            f'{spec.description} Default: {json.dumps(spec.default)}',
            110,
            initial_indent=f'  {spec.name}'.ljust(width),
            subsequent_indent=' ' * width,
        )
        for spec in specs
    ]
    return '\n'.join([f'{heading}:', *lines])
