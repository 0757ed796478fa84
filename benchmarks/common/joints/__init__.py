"""Joints of a robot: drawn gear motors that a controller moves along trapezoids, under a load.

``L di/dt = V - R i - Kb w`` and ``J dw/dt = Kt i - B w - T_f - T_load``, by the midpoint method.
The dry friction ``T_f`` is that of C. Canudas de Wit et al., "A new model for control of systems
with friction", IEEE Trans. Automatic Control 40 (3), 1995. It sticks, gives way by a small angle
before it breaks, and may break at more than it takes to keep moving. The observer's friction does
not. Read `joint_records.py` first.
"""
