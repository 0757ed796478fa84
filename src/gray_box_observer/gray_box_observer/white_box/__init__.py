"""The known form of the physics, with unknown parameters (the white box of the gray box)."""

from gray_box_observer.white_box.base import Parameter, WhiteBox
from gray_box_observer.white_box.motor import MotorWhiteBox
from gray_box_observer.white_box.terms import TERMS

__all__ = ['TERMS', 'MotorWhiteBox', 'Parameter', 'WhiteBox']
