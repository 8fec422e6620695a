"""
Topics of the nodes: name, type and quality of service as interface.yaml lists them.

No message type is imported before a topic of it is asked for, because that takes 0.9 s.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from ...common.yaml_reading import parse_yaml

TABLE = Path(__file__).parent.parent / 'interface.yaml'
Callback = Callable[[Any], None]  # is called with a message
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


@cache
def declared() -> dict[str, Any]:
    """Return the topics, services and actions by their names, as declared."""
    return dict(parse_yaml(TABLE.read_text(encoding='utf-8')))


def topic(name: str, at: str = '~') -> tuple[Any, str, QoSProfile]:
    """
    Return type, name and quality of service of a topic, as `create_publisher` takes them.

    Parameters
    ----------
    name : str
        As declared: of a topic that belongs to a node it begins with that node.
    at : str
        What the owner is called here; ~: it is the node that creates the topic.

    """
    entry = declared()['topics'][name]
    package, kind = entry['type'].split('/')
    owner, slash, own = name.partition('/')
    return (
        getattr(import_module(f'{package}.msg'), kind),
        f'{at}/{own}' if owner and slash else name,
        globals()[entry['quality'].upper()],
    )


def publishing(node: Node, *names: str) -> dict[str, Callback]:
    """Create publishers of topics; return the functions that publish, by the topics' names."""
    return {name: node.create_publisher(*topic(name)).publish for name in names}


def subscribe(
    node: Node, name: str, callback: Callback, at: str = '~', heard: QoSProfile | None = None
) -> None:
    """Subscribe to a topic; publishers of any reliability are heard unless `heard` says how."""
    kind, full_name, published = topic(name, at)
    latched = published.durability == LATCHED.durability
    heard = heard or (published if latched else LISTEN)
    node.create_subscription(kind, full_name, callback, heard)
