"""Quality of service; importing no message type, because that takes 0.9 s."""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

# [1] queued messages of a topic, so that a subscriber that is late by two cycles of the fastest
# node, or receives joints in a message each, loses none
DEPTH = 10
# [1] where every message of several publishers counts: as many for each of five, else those of
# the first would be lost
DEPTH_ALL = 5 * DEPTH


def quality(depth: int = 1, *, reliable: bool = True, latched: bool = False) -> QoSProfile:
    """Keep the last `depth` messages; a latched topic keeps them for later subscribers."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


# commands and setpoints: none may be lost, only the newest counts
COMMAND = quality()
# states, shapes and markers as published: suits reliable and best-effort subscribers
STATE = quality(DEPTH)
# states of joints that may come in several messages: from reliable publishers, too
JOINTS = quality(DEPTH, reliable=False)
# states, trackers and velocities as subscribed: matches reliable and best-effort publishers
LISTEN = quality(reliable=False)
# statuses: a later subscriber gets the last one
LATCHED = quality(latched=True)
# every message of several publishers counts
COMMAND_ALL = quality(DEPTH_ALL)
LISTEN_ALL = quality(DEPTH_ALL, reliable=False)
# the last messages of several publishers, for later subscribers
LATCHED_BY_MANY = quality(DEPTH_ALL, latched=True)
