"""The contract of a trainer.

A job and its result are plain arrays, so that the same trainer serves inside a process of its own
(live) and inline (offline) with the same numbers out.
"""

from __future__ import annotations

from typing import Any, Protocol

Message = dict[str, Any]
"""Arrays and plain values by name: what passes between the observer and its trainer."""


class Trainer(Protocol):
    """Holds a network under training and its random state."""

    def train(self, job: Message) -> Message:
        """Run one job.

        Args:
            job: ``motor``: which motor of the group it is about, all where it is left out;
                ``voltage_v``, ``interval_s``, ``torque_nm``, ``speed_rad_s``, each of shape (motor,
                n): samples; ``number``, shape (n,): which they are, counted since the beginning;
                where numbers are left out another history begins; ``theta``, shape (motor,
                parameter), and ``covariance``, shape (motor, parameter, parameter): the estimate;
                ``seen``: where the motors have run (:class:`OperatingRange`); ``residual``: whether
                a round of learning the residual is due, and ``residual_anew``, whether it begins
                with nothing; ``start_*``, where training goes on from a saved network;
                ``start_learning_*``, what a result told under ``learning_*``.

        Returns:
            ``windows``: sequences learnt from; ``loss``, unless there were none; ``settled``:
            whether there is nothing to gain before theta or the operating range moves; the
            network's arrays, where a new one shall run; ``learning_*``, arrays from which another
            trainer goes on alike (optimiser and random state), where the variant has them.
        """
