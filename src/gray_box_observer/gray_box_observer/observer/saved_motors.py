"""The observer of a group of motors from what was saved of each."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from gray_box_observer.errors import CheckpointError, ConfigurationError
from gray_box_observer.observer.motor_forms.motor_form import MEASURED, ROTOR, THESIS, FormKind
from gray_box_observer.observer.motor_group import Group
from gray_box_observer.observer.motor_observer import MotorObserver
from gray_box_observer.safe_io.saved_state import LARGEST, number
from gray_box_observer.safe_io.saved_state import group as group_of
from gray_box_observer.settings.motor_configuration import CURRENT_LAG
from gray_box_observer.settings.sensor_lag import CurrentLag
from gray_box_observer.white_box.declaration import State
from gray_box_observer.white_box.interface import Array
from gray_box_observer.white_box.motor import STORAGES

SavedMotor = tuple[dict[str, Any], dict[str, Array]]
"""What :meth:`MotorObserver.state` gives of a motor: plain values and arrays."""

ObserverMaker = Callable[[Group, bool, FormKind | None], MotorObserver]
"""Makes the observer of a group, by whether its speed is measured and by its form."""


def restored_observer(
    group: Group, saved_motors: Mapping[str, SavedMotor], make: ObserverMaker
) -> MotorObserver:
    """Make the observer of a group from what was saved; what was not saved stays as it is.

    Args:
        group: the motors.
        saved_motors: by name; other motors are passed over.
        make: makes an observer that has learnt nothing.

    Raises:
        ConfigurationError: something was learnt with another white box or other parameters.
        CheckpointError: it is no state that could have been learnt.
    """
    motors = dict(saved_motors)
    for place, name in enumerate(group.names):
        if name not in motors and group.observer is not None:
            motors[name] = group.observer.state(place)
    own_motors = {name: motors[name] for name in group.names if name in motors}
    has_speed = any(_has_speed(plain) for plain, _ in own_motors.values())
    alone = own_motors.get(group.names[0]) if len(group.names) == 1 else None
    observer = make(group, has_speed, None if alone is None else _saved_kind(alone[0]))
    try:
        for place, name in enumerate(group.names):
            if name not in own_motors:
                continue
            plain, arrays = own_motors[name]
            if observer.white_box_of(place).to_dict() != plain['white_box']:
                raise ConfigurationError(
                    f'motor {name}: the checkpoint was learnt with other known constants or terms'
                )
            observer.restore(plain, arrays, place)
    except BaseException:
        observer.close()
        raise
    return observer


def _has_speed(plain: dict[str, Any]) -> bool:
    """Tell whether a saved motor came with a measured speed, used or left out."""
    choice = plain.get('speed', {})
    is_left_out = isinstance(choice, dict) and choice.get('has_reading') is True
    return bool(plain['white_box']['speed_measured']) or is_left_out


def _saved_kind(plain: dict[str, Any]) -> FormKind:
    """Return the form of a saved motor."""
    nodes = plain['white_box'].get('context_nodes')
    choice = plain.get('speed', {})
    effects = choice.get('effects', []) if isinstance(choice, dict) else []
    if isinstance(nodes, list) and STORAGES[State.SPEED] in nodes:
        source = ROTOR
    else:
        source = MEASURED if plain['white_box']['speed_measured'] else THESIS
    is_list = isinstance(effects, list) and all(isinstance(node, str) for node in effects)
    dead_zone_v = 0.0
    if isinstance(choice, dict) and 'dead_zone_v' in choice:  # not in files of early releases
        dead_zone_v = number(choice, 'dead_zone_v', 0.0, LARGEST)
    lag = None
    if isinstance(choice, dict) and choice.get('current_lag') is not None:
        lag = CurrentLag.restored(group_of(choice, 'current_lag'))
    kind = FormKind(source, tuple(effects) if is_list else (), dead_zone_v, lag)
    if (kind.lag is None) != (CURRENT_LAG not in kind.effects):
        raise CheckpointError('speed.current_lag and speed.effects tell different things')
    return kind
