"""How a bag is written: compression, flushing, splitting."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from gray_box_observer.bag.mcap.mcap_file import COMPRESSIONS
from gray_box_observer.errors import BagError

FLUSH_PERIOD_S = 0.5
"""Half of the second that a killed recorder may lose: the rest is for what waits in queues."""

_LEVELS = {'none': (0, 0), 'lz4': (0, 16), 'zstd': (-7, 22)}

PRESETS: Mapping[str, Mapping[str, Any]] = {
    'none': {},
    'fastwrite': {},
    'zstd_fast': {'compression': 'zstd', 'compression_level': -5},
    'zstd_small': {'compression': 'zstd', 'compression_level': 19, 'chunk_bytes': 4 << 20},
}
"""Options by the names that rosbag2's MCAP storage gives them.

Chunks and their checksums stay: without them a damaged or killed bag could not be read. So
``fastwrite``, which leaves them out in rosbag2, is the same as ``none`` here.
"""


@dataclass(frozen=True)
class BagOptions:
    """How a bag is written.

    Attributes:
        compression: ``none``, ``lz4`` or ``zstd``, for the chunks; readers need no hint.
        compression_level: In the compression's own numbers (zstd -7 to 22, lz4 0 to 16); None for
            its default.
        chunk_bytes: A chunk ends when it has grown this large.
        flush_period_s: And at the latest after this time, so that a killed writer loses no more
            than this.
        max_file_bytes: A new file is begun when one has grown this large, without its index; 0 for
            never.
        max_file_duration_s: And when one spans this much log time; 0 for never.
        ros_distro: What ``metadata.yaml`` names.
        custom_data: Free texts kept in ``metadata.yaml``.
        library: Who writes it, for the header of each file; None for this package with its version.
    """

    compression: str = 'none'
    compression_level: int | None = None
    chunk_bytes: int = 768 * 1024
    flush_period_s: float = FLUSH_PERIOD_S
    max_file_bytes: int = 0
    max_file_duration_s: float = 0.0
    ros_distro: str = 'jazzy'
    custom_data: Mapping[str, str] = field(default_factory=dict)
    library: str | None = None

    def __post_init__(self) -> None:
        """Refuse what cannot work.

        Raises:
            BagError: An option is out of its range.
        """
        if self.compression not in COMPRESSIONS:
            raise BagError(
                f'compression is {self.compression!r}, expected one of {", ".join(COMPRESSIONS)}'
            )
        lowest, highest = _LEVELS[self.compression]
        if self.compression_level is not None and not lowest <= self.compression_level <= highest:
            raise BagError(
                f'compression_level is {self.compression_level}, expected {lowest} to {highest} '
                f'for {self.compression}'
            )
        if self.chunk_bytes < 1:
            raise BagError(f'chunk_bytes is {self.chunk_bytes}, expected at least 1')
        for name in ('flush_period_s', 'max_file_bytes', 'max_file_duration_s'):
            if not getattr(self, name) >= 0:
                raise BagError(f'{name} is {getattr(self, name)}, expected 0 or more')
