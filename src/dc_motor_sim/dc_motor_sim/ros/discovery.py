"""How far a node looks for others: this host only, unless the environment says anything about it.

The same rule as that of the observer, which must not be imported here; a test compares the two.
"""

from __future__ import annotations

from collections.abc import Mapping

RANGE = 'ROS_AUTOMATIC_DISCOVERY_RANGE'

SAYS = (
    RANGE,
    'ROS_STATIC_PEERS',
    'ROS_LOCALHOST_ONLY',
    'ROS_DISCOVERY_SERVER',
    'FASTRTPS_DEFAULT_PROFILES_FILE',
    'FASTDDS_DEFAULT_PROFILES_FILE',
    'CYCLONEDDS_URI',
    'ZENOH_SESSION_CONFIG_URI',
)
"""Variables by which a user, or a profile of the middleware, decides; any of them leaves everything
as it is."""

OPENED_BY = f'discovery stays on this host; {RANGE}=SUBNET opens it to others'


def default_range(environment: Mapping[str, str]) -> dict[str, str]:
    """Environment variables that keep discovery on this host; none where the user has decided."""
    return {} if any(environment.get(name) for name in SAYS) else {RANGE: 'LOCALHOST'}
