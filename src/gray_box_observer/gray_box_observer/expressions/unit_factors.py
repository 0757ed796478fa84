"""Units that a quantity may be written in, and their factors to SI units."""

from __future__ import annotations

from collections.abc import Mapping

SI: Mapping[str, str] = {
    'time': 's',
    'voltage': 'V',
    'current': 'A',
    'torque': 'N m',
    'speed': 'rad/s',
    'position': 'rad',
}
"""The SI unit of every kind of quantity."""

OTHER_UNITS: Mapping[str, Mapping[str, str]] = {
    'time': {
        'ms': '1e-3',
        'msec': '1e-3',
        'us': '1e-6',
        'usec': '1e-6',
        'µs': '1e-6',
        'ns': '1e-9',
        'min': '60',
    },
    'voltage': {'mV': '1e-3', 'kV': '1e3'},
    'current': {'mA': '1e-3', 'uA': '1e-6', 'µA': '1e-6'},
    'torque': {'mNm': '1e-3', 'Nmm': '1e-3', 'uNm': '1e-6', 'Ncm': '1e-2'},
    'speed': {
        'rpm': '0.104719755',
        'RPM': '0.104719755',
        'dps': '0.0174532925',
        'Hz': '6.28318531',
    },
}
"""Units other than SI that a name may end with, and their factors as one writes them."""

_EXACT: Mapping[str, tuple[str, float]] = {
    's': ('time', 1.0),
    'V': ('voltage', 1.0),
    'A': ('current', 1.0),
    'Nm': ('torque', 1.0),
    'rad/s': ('speed', 1.0),
    'rpm': ('speed', 0.10471975511965977),
    'RPM': ('speed', 0.10471975511965977),
    'deg/s': ('speed', 0.017453292519943295),
    'dps': ('speed', 0.017453292519943295),
    'Hz': ('speed', 6.283185307179586),
    'rad': ('position', 1.0),
    'deg': ('position', 0.017453292519943295),
    'rev': ('position', 6.283185307179586),
}


def unit_factors() -> dict[str, tuple[str, float]]:
    """Return the kind of quantity and the factor to SI units of every unit, by its name."""
    factors = {
        unit: (kind, float(factor))
        for kind, units in OTHER_UNITS.items()
        for unit, factor in units.items()
    }
    return factors | dict(_EXACT)
