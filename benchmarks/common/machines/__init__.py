"""Machines as they are built: drawn gear motors with what no form of the observer knows.

Commutators make torque, back-EMF and resistance ripple with the angle, and magnets cog. A gear
gives or has play. Payloads change. Drivers open the winding, or let its current flow one way alone.
Read `drawn_machines.py` first.
"""
