"""The parameters of `settings.parameters` on a node: declared, checked, changed."""

from __future__ import annotations

from collections.abc import Callable

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter

from gray_box_observer.errors import ConfigurationError
from gray_box_observer.ros.unknown_parameters import settle
from gray_box_observer.settings.configuration import Configuration
from gray_box_observer.settings.parameters import (
    MOTOR_PARAMETERS,
    OBSERVER_PARAMETERS,
    ParameterSpec,
)

DECLARED_AT_ONCE = 500
"""Parameters between two looks at whether to go on: a tenth of a second."""


def declare(node: Node, require_going_on: Callable[[], None]) -> Configuration:
    """Declare every parameter with description, range and read-only flag; check the set.

    Args:
        node: the node.
        require_going_on: called now and then; what it raises ends the work.

    Raises:
        ConfigurationError: a value of the wrong type or out of its range, values that do not fit
            together, or a name that nobody declared.
    """
    flat_values = {
        name: parameter.value
        for name, parameter in getattr(node, '_parameter_overrides', {}).items()
    }
    configuration = Configuration.from_flat(flat_values)
    declarations = [
        (spec.name, configuration[spec.name], describe(spec)) for spec in OBSERVER_PARAMETERS
    ]
    declarations += [
        (name, configuration[name], describe(spec)) for name, spec in configuration.input_specs()
    ]
    descriptors = {spec.name: describe(spec) for spec in MOTOR_PARAMETERS}
    for name, motor in configuration.motors.items():
        declarations += [
            (f'{name}.{own}', motor.values[own], descriptor)
            for own, descriptor in descriptors.items()
        ]
    # rclpy refuses 1 for 1.0, so what was given is read and checked as identify does, and declared
    # as it was understood
    for start in range(0, len(declarations), DECLARED_AT_ONCE):
        require_going_on()
        some = declarations[start : start + DECLARED_AT_ONCE]
        node.declare_parameters('', list(some), ignore_override=True)
    settle(node, configuration.unknown, configuration.alike)
    return configuration


def describe(spec: ParameterSpec) -> ParameterDescriptor:
    """Turn one declaration into a ROS descriptor."""
    descriptor = ParameterDescriptor(description=spec.description, read_only=not spec.live)
    if spec.choices:
        descriptor.additional_constraints = f'one of: {", ".join(spec.choices)}'
    if spec.words:  # a number or a word: configuration.py checks it, for a range refuses words
        descriptor.dynamic_typing = True
        words = ' or '.join(spec.words)
        descriptor.additional_constraints = (
            f'a number from {spec.minimum:g} to {spec.maximum:g}, or {words}'
        )
        return descriptor
    if isinstance(spec.default, bool) or spec.minimum is None:
        return descriptor
    maximum = spec.minimum if spec.maximum is None else spec.maximum
    if isinstance(spec.default, float):
        descriptor.floating_point_range = [
            FloatingPointRange(from_value=float(spec.minimum), to_value=float(maximum))
        ]
    elif isinstance(spec.default, int):
        upper = 2**62 if spec.maximum is None else int(spec.maximum)
        descriptor.integer_range = [
            IntegerRange(from_value=int(spec.minimum), to_value=upper, step=1)
        ]
    return descriptor


class LiveParameters:
    """Lets parameters change while the node runs: a set is checked, then takes effect.

    Args:
        node: the node.
        configuration: as it stands.
        check: refuses what only the node can judge, by a ConfigurationError; must change nothing.
        apply: takes the new configuration over.
    """

    def __init__(
        self,
        node: Node,
        configuration: Configuration,
        check: Callable[[Configuration], None],
        apply: Callable[[Configuration], None],
    ) -> None:
        self._configuration = configuration
        self._check = check
        self._apply = apply
        node.add_on_set_parameters_callback(self._judge)
        node.add_post_set_parameters_callback(self._take_over)

    def _judge(self, parameters: list[Parameter]) -> SetParametersResult:
        try:
            self._check(self._merged_configuration(parameters))
        except ConfigurationError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _take_over(self, parameters: list[Parameter]) -> None:
        configuration = self._merged_configuration(parameters)
        if configuration != self._configuration:
            self._configuration = configuration
            self._apply(configuration)

    def _merged_configuration(self, parameters: list[Parameter]) -> Configuration:
        return self._configuration.with_values(
            {parameter.name: parameter.value for parameter in parameters}
        )
