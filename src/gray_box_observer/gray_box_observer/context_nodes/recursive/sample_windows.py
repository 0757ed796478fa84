"""Some motors of a group: their physics, their samples, and what is known of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.recursive.belief import Belief
from gray_box_observer.context_nodes.recursive.estimator_state import Learnt, chosen
from gray_box_observer.context_nodes.recursive.trajectory import Stretch
from gray_box_observer.samples.replay_buffer import ReplayBuffer
from gray_box_observer.white_box.interface import WhiteBox


@dataclass(slots=True)
class Motors:
    """What a piece of work is done to.

    Attributes:
        white_box: their physics.
        replay: samples of the whole group.
        which: their places in it.
        learnt: what is known of them.
    """

    white_box: WhiteBox
    replay: ReplayBuffer
    which: Any
    learnt: Learnt

    @classmethod
    def of(
        cls, white_box: WhiteBox, replay: ReplayBuffer, learnt: Learnt, index: NDArray[np.intp]
    ) -> Motors:
        """Return the motors at given places in order; neighbours are not copied."""
        run = bool(index[-1] - index[0] + 1 == index.size)
        which: Any = slice(int(index[0]), int(index[-1]) + 1) if run else index
        return cls(white_box.of_motors(which), replay, which, chosen(learnt, which))

    def part(self, index: NDArray[np.intp]) -> Motors:
        """Return some of these motors, as a copy unless they are all."""
        if index.size == self.learnt.motors:
            return self
        return Motors(
            self.white_box.of_motors(index),
            self.replay,
            self._places[index],
            chosen(self.learnt, index),
        )

    @property
    def _places(self) -> NDArray[np.intp]:
        places: NDArray[np.intp] = np.arange(self.replay.motors)[self.which]
        return places

    def newest(self, samples: int) -> Stretch:
        """Return so many samples up to the last that is learnt."""
        return Stretch.newest(self.white_box, self.replay, samples, self.which, self.learnt.at)

    @property
    def remembered(self) -> NDArray[np.int_]:
        """How many samples are remembered up to the last that is learnt, shape (motor,)."""
        return self.replay.remembered(self.which, self.learnt.at)

    def forget(self, keep: int, which: NDArray[np.bool_]) -> None:
        """Drop all but the newest samples of some of the motors."""
        index = np.flatnonzero(which)
        self.replay.forget(keep, self._places[index], self.learnt.at[index])

    def take(self, found: Belief, which: NDArray[np.bool_]) -> None:
        """Go on from a fit of all that is remembered, for some motors, where it is finite."""
        known = self.learnt
        known.belief = known.belief.overwritten(found, which & found.finite)
        known.noise_count = np.where(which, self.remembered, known.noise_count)
        known.next_fit = np.where(
            which, 2 * (known.at - self.replay.begin(self.which)), known.next_fit
        )
        known.score = np.where(which[:, None, None], 0.0, known.score)
        known.information = np.where(which[:, None, None, None], 0.0, known.information)
