"""The delay between voltage and torque: found, judged, and applied where the user asks for it."""

from gray_box_observer.delay.watch import DelayEstimate, DelayVerdict, DelayWatch

__all__ = ['DelayEstimate', 'DelayVerdict', 'DelayWatch']
