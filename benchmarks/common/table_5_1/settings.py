"""The two settings of the experiment: the thesis's own, and the package's defaults."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from common.table_5_1.thesis import FOUR
from gray_box_observer.settings.configuration import Configuration


@dataclass(frozen=True, slots=True)
class Setting:
    """How every variant is trained alike.

    Attributes:
        name: short.
        title: for tables.
        every: of the 0.01 s data one record in so many is kept.
        identification: parameters of the observer for theta, where they are not its defaults.
        network: the same for the network of the thesis's four variants; further variants keep their
            defaults.
        online: whether the observer itself trains, fed pass after pass; else epochs over the fixed
            training set.
    """

    name: str
    title: str
    every: int
    identification: Mapping[str, Any] = field(default_factory=dict)
    network: Mapping[str, Any] = field(default_factory=dict)
    online: bool = True

    def configuration(self, variant: str, **given: Any) -> Configuration:
        """Parameters of an observer of this variant; ``given`` come first.

        Raises:
            ConfigurationError: there is no such variant.
        """
        network = self.network if variant in FOUR else {}
        return Configuration.from_flat(
            {**self.identification, **network, 'variant': variant, **given}
        )


FAITHFUL = Setting(
    'faithful',
    'faithful: 2 hidden units, 64 voltages in and one torque out, every 10th record, Adam 0.001 / '
    '0.01',
    10,
    {'context_update': 'gradient', 'gradient.learning_rate': 0.01, 'gradient.window': 1},
    {'training.hidden': 2, 'training.context': 64, 'training.learning_rate': 0.001},
    online=False,
)
"""The thesis (5.1.2, 4.3.2). It does not say which records were kept, only that a window covers a
transition (4.1.2); 64 records 0.1 s apart span 13 electrical time constants."""

OURS = Setting('ours', 'ours: the observer as it comes, its training.* defaults, 100 Hz', 1)
"""Every default, so theta by the recursive rule: on some recordings the gradient rule stops too
early at 100 Hz, and all that leans on theta would tell of that instead. A white box row with the
gradient rule's theta stands beside."""

SETTINGS = (FAITHFUL, OURS)
