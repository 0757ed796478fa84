"""Numbers with units, written the way an instrument writes them."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

_PREFIXES = {-12: 'p', -9: 'n', -6: 'µ', -3: 'm', 0: '', 3: 'k', 6: 'M', 9: 'G'}

MINUS = '\N{MINUS SIGN}'
SIGMA = '\N{GREEK SMALL LETTER SIGMA}'


@dataclass(frozen=True)
class Scale:
    """A prefixed unit: a value in SI units times `factor` is a number of `label`.

    Attributes:
        factor: from the SI unit to the prefixed one, 1000 for `mH`.
        label: the prefixed unit as printed; empty for a bare number.
    """

    factor: float
    label: str


def printed_unit(unit: str) -> str:
    """Write a unit of the code (`V s / (rad A)`, `ohm`) as in print (`V·s/(rad·A)`, `Ω`)."""
    unit = re.sub(r'\bohm\b', 'Ω', unit.strip())
    unit = re.sub(r'\s*/\s*', '/', unit).replace('^2', '²').replace('**2', '²')
    unit = re.sub(r'(?<=[a-z])2\b', '²', unit)
    return re.sub(r'[\s*]+', '·', unit)


def scale_for(magnitude: float, unit: str) -> Scale:
    """Choose the SI prefix that brings `magnitude` between 0.8 and 800.

    Not between 1 and 1000: a resistance that settles at 0.999 ohm reads better as such than as 999
    milliohm. Bare numbers and units that already carry a prefix (`kg`) stay as they are.
    """
    label = printed_unit(unit)
    if (
        not label
        or label.startswith(('kg', '1', '%'))
        or not math.isfinite(magnitude)
        or magnitude == 0.0
    ):
        return Scale(1.0, label)
    exponent = 3 * math.floor(math.log10(abs(magnitude) / 0.8) / 3.0)
    exponent = min(max(exponent, min(_PREFIXES)), max(_PREFIXES))
    return Scale(10.0**-exponent, _PREFIXES[exponent] + label)


def written(value: float, decimals: int) -> str:
    """Write a number with a fixed count of decimals and a true minus sign."""
    text = f'{value:,.{max(decimals, 0)}f}'.replace(',', '\N{NARROW NO-BREAK SPACE}')
    return text.replace('-', MINUS)


def significant(value: float, digits: int = 4) -> str:
    """Write a number with so many significant digits; `not known` if it is not finite."""
    if not math.isfinite(value):
        return 'not known'
    if value != 0.0 and not 1e-4 <= abs(value) < 1e6:
        mantissa, exponent = f'{value:.{digits - 1}e}'.split('e')
        power = str(int(exponent)).translate(str.maketrans('-0123456789', '⁻⁰¹²³⁴⁵⁶⁷⁸⁹'))
        return f'{mantissa}·10{power}'.replace('-', MINUS)
    return written(value, _decimals(value, digits))


def value_and_std(value: float, std: float, scale: Scale) -> tuple[str, str | None]:
    """Write a value and its standard deviation to the same decimal, the deviation to two digits.

    Returns:
        The two numbers without their unit; the second is None where the deviation is not known.
    """
    if not math.isfinite(value):
        return 'none', None
    value, std = value * scale.factor, std * scale.factor
    if not math.isfinite(std) or std < 0.0:
        return written(value, _decimals(value, 5)), None
    if std >= 1e5 * max(abs(value), 1e-300):
        return written(value, _decimals(value, 3)), significant(std, 2)
    decimals = _decimals(value, 5) if std == 0.0 else min(_decimals(std, 2), 9)
    return written(value, decimals), written(std, decimals)


def percent(fraction: float, has_sign: bool = False) -> str:
    """Write a fraction as a percentage with two significant digits."""
    if not math.isfinite(fraction):
        return 'not known'
    text = significant(abs(100.0 * fraction), 2)
    sign = (MINUS if fraction < 0.0 else '+') if has_sign and fraction != 0.0 else ''
    return f'{sign}{text}\N{NO-BREAK SPACE}%'


def _decimals(value: float, digits: int) -> int:
    if value == 0.0:
        return 0
    return max(digits - 1 - math.floor(math.log10(abs(value))), 0)
