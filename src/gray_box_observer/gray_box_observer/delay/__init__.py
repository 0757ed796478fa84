"""The delay between voltage and torque: found, judged, applied if asked. Read `watch.py` first."""

from gray_box_observer.delay.declared import DeclaredDelay
from gray_box_observer.delay.round import DelayRound
from gray_box_observer.delay.watch import DelayEstimate, DelayVerdict, DelayWatch, HiddenRotor

__all__ = [
    'DeclaredDelay',
    'DelayEstimate',
    'DelayRound',
    'DelayVerdict',
    'DelayWatch',
    'HiddenRotor',
]
