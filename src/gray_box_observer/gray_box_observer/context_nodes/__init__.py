"""The unknown physical parameters, held explicitly (thesis: parameter context nodes), and the rules
that learn them.
"""

from gray_box_observer.context_nodes.estimate import Estimate, Verdict, VerdictRules
from gray_box_observer.context_nodes.gradient import GradientRules, GradientUpdate
from gray_box_observer.context_nodes.recursive.estimator import RecursiveUpdate
from gray_box_observer.context_nodes.recursive.estimator_settings import RecursiveRules
from gray_box_observer.context_nodes.rotor.estimator import RotorUpdate
from gray_box_observer.context_nodes.update_rule import ContextUpdate

__all__ = [
    'ContextUpdate',
    'Estimate',
    'GradientRules',
    'GradientUpdate',
    'RecursiveRules',
    'RecursiveUpdate',
    'RotorUpdate',
    'Verdict',
    'VerdictRules',
]
