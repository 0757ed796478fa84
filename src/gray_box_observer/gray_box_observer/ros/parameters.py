"""Declaring the parameters of :mod:`gray_box_observer.configuration` on a node."""

from __future__ import annotations

from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node

from gray_box_observer.configuration import (
    MOTOR_PARAMETERS,
    OBSERVER_PARAMETERS,
    Configuration,
    ParameterSpec,
)


def declare(node: Node) -> Configuration:
    """Declare every parameter on the node, with description, range and read-only flag, and check them as a set.

    Raises:
        ConfigurationError: values that do not fit together.
        rclpy.exceptions.ParameterException: a value of the wrong type or out of its range.
    """
    values: dict[str, Any] = {}
    for spec in OBSERVER_PARAMETERS:
        values[spec.name] = node.declare_parameter(spec.name, spec.default, describe(spec)).value
    for motor in values['motors']:
        for spec in MOTOR_PARAMETERS:
            name = f'{motor}.{spec.name}'
            values[name] = node.declare_parameter(name, spec.default, describe(spec)).value
    return Configuration.from_flat(values)


def describe(spec: ParameterSpec) -> ParameterDescriptor:
    """Turn one declaration into a ROS descriptor."""
    descriptor = ParameterDescriptor(description=spec.description, read_only=not spec.live)
    if spec.choices:
        descriptor.additional_constraints = f'one of: {", ".join(spec.choices)}'
    if isinstance(spec.default, bool) or spec.minimum is None:
        return descriptor
    maximum = spec.minimum if spec.maximum is None else spec.maximum
    if isinstance(spec.default, float):
        descriptor.floating_point_range = [FloatingPointRange(from_value=float(spec.minimum), to_value=float(maximum))]
    elif isinstance(spec.default, int):
        upper = 2**62 if spec.maximum is None else int(spec.maximum)
        descriptor.integer_range = [IntegerRange(from_value=int(spec.minimum), to_value=upper, step=1)]
    return descriptor
