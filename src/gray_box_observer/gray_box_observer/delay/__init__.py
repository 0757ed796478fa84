"""The delay between voltage and torque: found, judged, and applied where the user asks for it."""

from gray_box_observer.delay.round import DelayRound
from gray_box_observer.delay.watch import DelayEstimate, DelayVerdict, DelayWatch

__all__ = ['DelayEstimate', 'DelayRound', 'DelayVerdict', 'DelayWatch']
