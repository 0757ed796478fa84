"""Quality of service: rclpy's objects, rosbag2's YAML, and the choice of profiles."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from rclpy.duration import Duration
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
)

_NS_PER_S = 1_000_000_000


def to_mapping(profile: QoSProfile) -> dict[str, Any]:
    """A profile in the form that Jazzy's rosbag2 writes; an untold history is ``unknown``."""
    return {
        'history': _word(profile.history),
        'depth': profile.depth,
        'reliability': _word(profile.reliability),
        'durability': _word(profile.durability),
        'deadline': _span(profile.deadline),
        'lifespan': _span(profile.lifespan),
        'liveliness': _word(profile.liveliness),
        'liveliness_lease_duration': _span(profile.liveliness_lease_duration),
        'avoid_ros_namespace_conventions': profile.avoid_ros_namespace_conventions,
    }


def subscription_profile(publisher_profiles: Iterable[QoSProfile], depth: int) -> QoSProfile:
    """The strictest request that every one of the publishers satisfies."""
    profiles = list(publisher_profiles)
    reliable = all(profile.reliability != ReliabilityPolicy.BEST_EFFORT for profile in profiles)
    is_latched = all(profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for profile in profiles)
    return _profile(depth, reliable=reliable, is_latched=is_latched and bool(profiles))


def publisher_profile(recorded_profiles: Sequence[Mapping[str, Any]], depth: int) -> QoSProfile:
    """What to replay with: reliable and latched only where all the recorded publishers were.

    Args:
        recorded_profiles: The profiles that the bag keeps, as numbers or words; may be empty.
        depth: How many messages are kept for slow readers.
    """
    reliable = all(str(p.get('reliability')) not in ('best_effort', '2') for p in recorded_profiles)
    is_latched = bool(recorded_profiles) and all(
        str(p.get('durability')) in ('transient_local', '1') for p in recorded_profiles
    )
    return _profile(depth, reliable=reliable, is_latched=is_latched)


def needs_weaker(current: QoSProfile, target: QoSProfile) -> bool:
    """Whether a subscription asks for too much, so that it misses some publisher."""
    return (
        current.reliability == ReliabilityPolicy.RELIABLE != target.reliability
        or current.durability == DurabilityPolicy.TRANSIENT_LOCAL != target.durability
    )


def _profile(depth: int, *, reliable: bool, is_latched: bool) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if is_latched else DurabilityPolicy.VOLATILE,
    )


def _word(policy: HistoryPolicy | ReliabilityPolicy | DurabilityPolicy | LivelinessPolicy) -> str:
    return str(policy.name).lower()


def _span(duration: Duration) -> dict[str, int]:
    seconds, nanoseconds = divmod(duration.nanoseconds, _NS_PER_S)
    return {'sec': seconds, 'nsec': nanoseconds}
