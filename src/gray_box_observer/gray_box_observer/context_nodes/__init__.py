"""The unknown physical parameters (thesis: parameter context nodes) and their update rules."""

from gray_box_observer.context_nodes.estimate import Estimate, Verdict, VerdictRules
from gray_box_observer.context_nodes.gradient import GradientRules, GradientUpdate
from gray_box_observer.context_nodes.recursive.estimator import RecursiveEstimator
from gray_box_observer.context_nodes.recursive.estimator_settings import RecursiveRules
from gray_box_observer.context_nodes.update_rule import ContextUpdate

__all__ = [
    'ContextUpdate',
    'Estimate',
    'GradientRules',
    'GradientUpdate',
    'RecursiveRules',
    'RecursiveEstimator',
    'Verdict',
    'VerdictRules',
]
