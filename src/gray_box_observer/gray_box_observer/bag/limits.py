"""Limits on the memory that a bag may take: a few kilobytes may claim any size."""

from __future__ import annotations

import math
from dataclasses import dataclass

from gray_box_observer.errors import BagError

DEFAULT_CHUNK_MB = 80
"""rosbag2 ends a chunk at 768 kB, its presets at 4 MB; whoever sets 64 MiB is still served."""
LARGEST_GENERAL_MESSAGE_BYTES = 1 << 18
"""Of a message that is no JointState, which the general decoder makes an object of
Python a part: up to 200 bytes for one."""
LARGEST_DEFINITION_BYTES = 1 << 18
"""Of the text of a type that is parsed; ROS's own are of some kilobytes, the longest known of some
tens."""
MOST_MESSAGE_VALUES = 1 << 19
"""Objects and fields of a message that the general decoder makes: two for each of its bytes, where
those of ROS take some bytes for each."""
MOST_NESTING = 64
"""Types in types of a definition; those of ROS go ten deep."""
LARGEST_DECLARATION_BYTES = 4 << 20
MOST_DECLARED_BYTES = 32 << 20
"""What schemas and channels of one file may hold together; those of ROS are some kilobytes each."""
DECLARATION_OVERHEAD_BYTES = 256
MESSAGE_OVERHEAD_BYTES = 256
"""What a message in memory takes beside its bytes: the objects of Python that hold it."""

_EXPANSION = 1000
"""Bytes that a compressed one may stand for: logs come to some tens, and only a bomb to more."""


@dataclass(frozen=True)
class ReadLimits:
    """Memory that reading a bag may hold at one time; what needs more is left out and reported.

    Attributes:
        chunk_bytes: The largest chunk, unpacked, and the largest message outside chunks.
        expansion: Bytes of a chunk for each of its bytes in the file.
        option: How the user sets the limit, with ``{}`` for the number of MB.
    """

    chunk_bytes: int = DEFAULT_CHUNK_MB * 1_000_000
    expansion: float = _EXPANSION
    option: str = 'ReadLimits.from_mb({})'

    @classmethod
    def from_mb(cls, chunk_mb: int | None, option: str = 'ReadLimits.from_mb({})') -> ReadLimits:
        """Return the limits of a user's request; whoever sets one trusts the bag to respect it.

        Args:
            chunk_mb: The largest chunk in MB; None for the default.
            option: How the user sets it, with ``{}`` for the number.

        Raises:
            BagError: The number is not positive.
        """
        if chunk_mb is None:
            return cls(option=option)
        if chunk_mb < 1:
            raise BagError(f'{option.format(chunk_mb)} is out of range; expected at least 1 MB')
        return cls(chunk_mb * 1_000_000, math.inf, option)

    @property
    def message_bytes(self) -> int:
        """What the messages of overlapping chunks may hold together, objects of Python included."""
        return 2 * self.chunk_bytes

    def remedy(self, byte_count: float) -> str:
        """Say what makes a chunk of so many bytes readable."""
        return f'{self.option.format(math.ceil(byte_count / 1_000_000))} reads it'
