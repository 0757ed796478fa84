"""What a bag says about itself: its topics, and what of it could not be read."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

_MOST_NAMES = 30
_LONGEST_NAME = 100


@dataclass(frozen=True)
class TopicInfo:
    """One topic of a bag.

    Attributes:
        type_name: Such as ``sensor_msgs/msg/JointState``.
        message_count: Messages in the bag, as far as they can be read.
        schema_text: The ros2msg definition with all dependencies; empty if the bag has none.
        encoding: ``cdr`` for everything that ROS 2 records.
        qos_profiles: The publishers' QoS as rosbag2's YAML text; empty if unknown.
        type_hash: Such as ``RIHS01_...``; empty if unknown.
    """

    type_name: str
    message_count: int
    schema_text: str
    encoding: str
    qos_profiles: str
    type_hash: str


@dataclass(frozen=True)
class Loss:
    """What of a bag could not be read; ``str(loss)`` is one line for the user."""

    reasons: tuple[str, ...]
    byte_count: int

    def __str__(self) -> str:
        reasons_text = ' '.join('; '.join(self.reasons[:3]).split())
        if len(self.reasons) > 3:
            reasons_text += f'; and {len(self.reasons) - 3} more'
        return (
            f'{reasons_text}; {self.byte_count} bytes could not be read'
            if self.byte_count
            else reasons_text
        )


def name_list(names: Iterable[str]) -> str:
    """Say names in order, in one bounded line: a bag may have tens of thousands of long ones."""
    sorted_names = sorted(names)
    name_texts = [
        name if len(name) <= _LONGEST_NAME else f'{name[:_LONGEST_NAME]}...'
        for name in sorted_names[:_MOST_NAMES]
    ]
    more = f' and {len(sorted_names) - _MOST_NAMES} more' if len(sorted_names) > _MOST_NAMES else ''
    return (', '.join(name_texts) or 'none') + more
