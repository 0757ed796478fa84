"""How each verdict looks and what it says."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Look:
    """A verdict's style: its colour's name in the style sheet, a sign, and its meaning."""

    style: str
    sign: str
    meaning: str


_LOOKS = {
    'identified': Look(
        'identified', '✓', 'settled; whether the white box holds is another question'
    ),
    'converging': Look('converging', '→', 'excited, still moving towards its value'),
    'unexcited': Look('unexcited', '○', 'the data say nothing about it'),
    'frozen': Look('frozen', '‖', 'held by command, not learning'),
    'misfit': Look('misfit', '✕', 'the white box does not explain the data: not to be believed'),
    'negligible': Look('negligible', '≈', 'known to be too small to matter'),
    'implausible': Look('implausible', '✕', 'outside what the physics allow'),
}
_OTHER = Look('other', '?', 'not a verdict this report knows')


_BORNE_OUT = Look('identified', '✓', 'settled, and the data bear it out')

_FITS = {
    'ok': Look('identified', '✓', 'the white box explains the data'),
    'warning': Look('doubtful', '!', 'the white box explains the data nearly'),
    'misfit': Look('misfit', '✕', 'the white box does not explain the data'),
    'untested': Look('other', '?', 'not tested'),
}


def look_of(verdict: str, fit: str = 'untested') -> Look:
    """Return the look of a verdict; any other word gets a neutral one.

    Args:
        verdict: of a parameter.
        fit: verdict of the fit test: only where that is `ok` do the data bear out what is
            identified.
    """
    if verdict == 'identified' and fit == 'ok':
        return _BORNE_OUT
    return _LOOKS.get(verdict, _OTHER)


def look_of_fit(fit: str) -> Look:
    """Return the look of a fit test's verdict; other words look like an untested motor."""
    return _FITS.get(fit, _FITS['untested'])
