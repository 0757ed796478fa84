"""The unknown physical parameters (thesis: parameter context nodes). Read `update_rule.py`."""

from gray_box_observer.context_nodes.estimate import Estimate, Verdict, VerdictSettings
from gray_box_observer.context_nodes.gradient import GradientSettings, GradientUpdate
from gray_box_observer.context_nodes.measured_speed.measured_speed_update import (
    MeasuredSpeedUpdate,
    can_be_output,
    published_known_parts,
    speed_readings,
)
from gray_box_observer.context_nodes.measured_speed.mechanics import Mechanics
from gray_box_observer.context_nodes.recursive.estimator import RecursiveEstimator
from gray_box_observer.context_nodes.recursive.estimator_settings import RecursiveSettings
from gray_box_observer.context_nodes.rotor.rotor_estimator import RotorUpdate
from gray_box_observer.context_nodes.rotor.rotor_group import RotorGroup
from gray_box_observer.context_nodes.update_rule import ContextUpdate

__all__ = [
    'ContextUpdate',
    'Estimate',
    'GradientSettings',
    'GradientUpdate',
    'MeasuredSpeedUpdate',
    'Mechanics',
    'RecursiveEstimator',
    'RecursiveSettings',
    'RotorGroup',
    'RotorUpdate',
    'Verdict',
    'VerdictSettings',
    'can_be_output',
    'published_known_parts',
    'speed_readings',
]
