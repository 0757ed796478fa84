"""Which trainer teaches a variant of the predictor."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gray_box_observer.predictor.network_inputs import Variant
from gray_box_observer.predictor.training.trainer import Trainer
from gray_box_observer.white_box import MotorWhiteBox


def make_trainer(configuration: Mapping[str, Any]) -> Trainer:
    """Build the trainer of a variant.

    Args:
        configuration: ``white_box`` (its :meth:`~MotorWhiteBox.to_dict`), ``rules`` (of
            :class:`TrainingSettings`), ``theta_reference`` and ``seed``.

    Raises:
        ImportError: no torch, which the thesis's variants need from the first job on.
    """
    if MotorWhiteBox.from_dict(configuration['white_box']).has_rotor:
        from gray_box_observer.predictor.training.rotor_trainer import RotorTrainer

        return RotorTrainer(configuration)
    if configuration['rules']['variant'] == Variant.PHYSICS.value:
        from gray_box_observer.predictor.training.physics_trainer import PhysicsTrainer

        return PhysicsTrainer(configuration)
    from gray_box_observer.predictor.thesis.window_trainer import WindowTrainer

    return WindowTrainer(configuration)
