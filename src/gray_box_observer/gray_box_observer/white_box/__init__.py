"""The known form of the physics, with unknown parameters (the white box of the gray box).

Read ``declaration.py`` first: it declares the motor; everything else here is made of it.
"""

from gray_box_observer.white_box.declaration import TERMS
from gray_box_observer.white_box.interface import Parameter, WhiteBox
from gray_box_observer.white_box.motor import MotorWhiteBox

__all__ = ['TERMS', 'MotorWhiteBox', 'Parameter', 'WhiteBox']
