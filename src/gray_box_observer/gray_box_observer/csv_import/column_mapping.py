"""How the columns of a log become voltage, torque and speed of motors."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from gray_box_observer.errors import BagError, InputError, brief
from gray_box_observer.safe_io.bounded_yaml import read_yaml
from gray_box_observer.safe_io.plain_number import parse_float, parse_int

FIRST_STAMP_NS = 1_000_000_000
"""A stamp of zero means 'no stamp' to many ROS programs, so the first row is put at one second."""

LATEST_STAMP_NS = 2**31 * 10**9
"""The first stamp that no message can tell."""


@dataclass(frozen=True)
class MotorColumns:
    """Expressions (see :mod:`column_expressions`) that give one motor's signals in SI units.

    Attributes:
        voltage: In V.
        torque: In N m; or empty, if ``current`` is given.
        current: In A; the torque is then ``torque_constant`` times it.
        torque_constant: In N m / A.
        speed: In rad/s; or empty.
    """

    voltage: str
    torque: str = ''
    current: str = ''
    torque_constant: float | None = None
    speed: str = ''

    def __post_init__(self) -> None:
        """Refuse combinations that say nothing about the torque, or two things.

        Raises:
            BagError: The torque is not given exactly once.
        """
        if not self.voltage:
            raise BagError("no column for the voltage; expected such as 'voltage=u_V'")
        if bool(self.torque) == bool(self.current):
            raise BagError(
                "expected either a torque, such as 'torque=t_Nm', or a current with "
                "'torque_constant=...'"
            )
        constant = self.torque_constant
        if self.current and (constant is None or not (math.isfinite(constant) and constant > 0)):
            raise BagError(
                f'torque_constant is {constant}, expected the positive number of N m / A that a '
                "current needs, such as 'torque_constant=0.05' among --columns"
            )


@dataclass(frozen=True)
class CsvMapping:
    """What the columns of a log mean.

    Attributes:
        motors: Each motor's columns by its name.
        time: Expression for the time in s; or empty, if ``sample_period_s`` is given.
        sample_period_s: Time from row to row, for logs without a time column.
        where: Condition that a row must fulfil, such as ``window_valid==1``; empty for all rows.
        where_drops: What a row that does not fulfil it loses: ``row`` (all of it; the voltage
            before then holds on) or ``torque`` (torque and speed only; its voltage is still true).
        voltage_applies: ``following`` if a row's voltage holds from its time on, ``preceding`` if
            it is that of the interval which ends there; it is then stamped with the time of the row
            before.
        voltage_topic: Topic for the voltages.
        torque_topic: Topic for torques and speeds.
    """

    motors: Mapping[str, MotorColumns]
    time: str = ''
    sample_period_s: float | None = None
    where: str = ''
    where_drops: str = 'row'
    voltage_applies: str = 'following'
    voltage_topic: str = '/motor/voltage'
    torque_topic: str = '/motor/torque'
    first_stamp_ns: int = field(default=FIRST_STAMP_NS)

    def __post_init__(self) -> None:
        """Refuse what cannot be meant.

        Raises:
            BagError: There is no motor, no time or two, or a word that is not known.
        """
        if not self.motors:
            raise BagError('no motor in the mapping; expected at least a voltage and a torque')
        period = self.sample_period_s
        if bool(self.time) == (period is not None):
            raise BagError("expected either 'time=COLUMN' or 'sample_period_s=SECONDS'")
        if period is not None and not (math.isfinite(period) and period > 0):
            raise BagError(f'sample_period_s is {period}, expected a positive number of seconds')
        if not 0 <= self.first_stamp_ns < LATEST_STAMP_NS:
            raise BagError(
                f'first_stamp_ns is {self.first_stamp_ns}, expected 0 to {LATEST_STAMP_NS - 1}'
            )
        _one_of('where_drops', self.where_drops, ('row', 'torque'))
        _one_of('voltage_applies', self.voltage_applies, ('following', 'preceding'))

    @classmethod
    def from_options(cls, options: Iterable[str]) -> CsvMapping:
        """From command-line words: ``time=t_s voltage=u_V current=i_A torque_constant=0.05``.

        A motor's key may carry its name, ``left.voltage=$5``; one without it belongs to the motor
        that ``motor=left`` names, else to one called ``motor``. A column may be given by its
        number, ``$1`` for the first.

        Raises:
            BagError: A word is no ``key=value`` or its key is not known.
        """
        flat: dict[str, Any] = {}
        for option in options:
            key, equals, value = option.partition('=')
            if not equals or not key.strip() or not value.strip():
                raise BagError(
                    f"{brief(option)} is no mapping; expected KEY=VALUE such as 'voltage=u_V'"
                )
            if key.strip() in flat:
                raise BagError(f'{brief(key.strip())[1:-1]} is mapped twice')
            flat[key.strip()] = value.strip()
        return cls._from_flat(flat)

    @classmethod
    def from_yaml(cls, path: str | Path) -> CsvMapping:
        """From a YAML file with the same keys: ``motors``, or one at the top named by ``motor``.

        Raises:
            BagError: The file cannot be read, or a key is not known or stands twice; one line that
                names the file.
        """
        try:
            document = read_yaml(Path(path))
        except InputError as error:
            raise BagError(str(error)) from None
        if not isinstance(document, dict):
            raise BagError(f"{path} holds no keys; expected such as 'voltage: u_V'")
        flat = {str(key): value for key, value in document.items() if key != 'motors'}
        motors = document.get('motors', {})
        if not isinstance(motors, dict) or not all(
            isinstance(group, dict) for group in motors.values()
        ):
            raise BagError(
                f"{path}: 'motors' is no group of motors; expected a name with its columns under it"
            )
        try:
            for name, group in motors.items():
                for key, value in group.items():
                    if f'{name}.{key}' in flat:
                        raise BagError(f'{brief(f"{name}.{key}")[1:-1]} is mapped twice')
                    flat[f'{name}.{key}'] = value
            return cls._from_flat(flat)
        except BagError as error:
            raise BagError(f'{path}: {error}') from None

    @classmethod
    def _from_flat(cls, flat: Mapping[str, Any]) -> CsvMapping:
        motor_keys = {entry.name for entry in fields(MotorColumns)}
        own_keys = {entry.name for entry in fields(cls)} - {'motors'}
        groups: dict[str, dict[str, Any]] = {}
        own: dict[str, Any] = {}
        default_motor = str(flat.get('motor', 'motor'))
        for key, value in flat.items():
            name, dot, last = key.rpartition('.')
            if last in motor_keys:
                group = groups.setdefault(name if dot else default_motor, {})
                if last in group:
                    raise BagError(f'{last} of motor {brief(default_motor)[1:-1]} is mapped twice')
                group[last] = _value(key, last, value)
            elif key in own_keys:
                own[key] = _value(key, key, value)
            elif key != 'motor':
                valid_keys = ', '.join(sorted(motor_keys | own_keys | {'motor'}))
                raise BagError(
                    f'{brief(key)} is no key of a mapping; there are: {valid_keys}. '
                    'Parameters of the motor are given by --params'
                )
        motors = {}
        if 'motor' in flat and default_motor not in groups:
            raise BagError(
                f'motor={brief(default_motor)[1:-1]} names no motor: every column carries the name '
                'of another one'
            )
        for name, group in groups.items():
            try:
                motors[name] = MotorColumns(**{'voltage': '', **group})
            except BagError as error:
                raise BagError(f'motor {brief(name)[1:-1]}: {error}') from None
        return cls(motors=motors, **own)

    def after(self, passed_s: float) -> CsvMapping:
        """Return the mapping of a log that begins so long after the first row of this one.

        Raises:
            BagError: No message can tell so late a stamp.
        """
        return replace(self, first_stamp_ns=self.first_stamp_ns + round(passed_s * 1e9))

    def parameters(self) -> dict[str, Any]:
        """Observer parameters from the mapping: motors, and Kt where torque is from current."""
        parameters: dict[str, Any] = {'motors': list(self.motors)}
        for name, columns in self.motors.items():
            if columns.torque_constant is not None:
                parameters[f'{name}.torque_constant'] = columns.torque_constant
        return parameters


def _value(key: str, kind: str, value: Any) -> Any:
    if kind in ('torque_constant', 'sample_period_s', 'first_stamp_ns'):
        parse = parse_int if kind == 'first_stamp_ns' else parse_float
        try:
            return parse(str(value))
        except ValueError:
            raise BagError(f'{brief(key)[1:-1]} is {brief(value)}, expected a number') from None
    return str(value)


def _one_of(name: str, value: str, allowed_values: tuple[str, ...]) -> None:
    if value not in allowed_values:
        raise BagError(f'{name} is {brief(value)}, expected one of {", ".join(allowed_values)}')
