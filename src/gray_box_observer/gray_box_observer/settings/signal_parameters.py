"""Parameters that say where the measured signals come from."""

from __future__ import annotations

from gray_box_observer.settings.parameter_spec import ParameterSpec

SIGNALS = ('voltage', 'torque', 'speed')
"""What is measured; each has a group of parameters that say where it comes from."""

TORQUE_CONSTANT = 'torque_constant'
"""The name of Kt in an expression: each motor has its own."""

_FIELD = 'such as data, data[0], wrench.torque.z, effort[wheel_joint] or '
_FIELD += 'interface_values.values[effort].'


def signal_parameters(
    name: str, topic: str, field_path: str, quantity_name: str, scale: str
) -> list[ParameterSpec]:
    """Parameters that say where a signal comes from.

    Args:
        name: of the signal.
        topic: default of its topic.
        field_path: default of its field.
        quantity_name: it is, in words.
        scale: its SI unit, and what the factor to it is in a usual case.
    """
    return [
        ParameterSpec(
            f'{name}.topic', topic, f'Topic that carries {quantity_name}; empty: none of its own.'
        ),
        ParameterSpec(
            f'{name}.type', 'sensor_msgs/msg/JointState', f'Message type of {name}.topic.'
        ),
        ParameterSpec(
            f'{name}.field', field_path, f'Field path of {quantity_name} in the message, {_FIELD}'
        ),
        ParameterSpec(
            f'{name}.scale', 1.0, f'Factor from the field to {quantity_name} in {scale}.'
        ),
        ParameterSpec(
            f'{name}.offset',
            0.0,
            f'Added to {quantity_name} after the scale, in SI units.',
            -1e9,
            1e9,
        ),
        ParameterSpec(
            f'{name}.expression',
            '',
            f'{quantity_name.capitalize()} as an expression of inputs, instead of a topic and a '
            'field: such as duty * battery, with duty.topic and battery.topic; scale and offset '
            'follow.',
        ),
    ]


INPUT_PARAMETERS: tuple[ParameterSpec, ...] = (
    ParameterSpec('topic', '', 'Topic that carries the input; must be given.'),
    ParameterSpec('type', 'std_msgs/msg/Float64', 'Message type of the topic.'),
    ParameterSpec('field', 'data', f'Field path of the input in the message, {_FIELD}'),
    ParameterSpec('scale', 1.0, 'Factor from the field to the unit of the expression.'),
    ParameterSpec('offset', 0.0, 'Added after the scale.', -1e9, 1e9),
    ParameterSpec(
        'stale_s',
        10.0,
        'A value older than this, in s, is not held on: what needs it is refused as stale_input.',
        1e-6,
        1e9,
    ),
)
"""Parameters of one input that an expression names, in the group under its name."""
