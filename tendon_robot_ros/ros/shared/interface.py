"""Topics of the nodes: name, type and quality of service as interface.yaml lists them."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription

from ...common.yaml_reading import parse_yaml
from . import quality
from .quality import LISTEN

TABLE = Path(__file__).parent.parent / 'interface.yaml'


@cache
def declared() -> dict[str, Any]:
    """Return the topics, services and actions by their names, as declared."""
    table: dict[str, Any] = parse_yaml(TABLE.read_text(encoding='utf-8'))
    return table


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
        getattr(quality, entry['quality'].upper()),
    )


def subscribe(
    node: Node,
    name: str,
    callback: Callable[[Any], None],
    at: str = '~',
    heard: QoSProfile | None = None,
) -> Subscription:
    """Subscribe to a topic; publishers of any reliability are heard unless `heard` says how."""
    kind, full_name, published = topic(name, at)
    latched = published.durability == quality.LATCHED.durability
    heard = heard or (published if latched else LISTEN)
    return node.create_subscription(kind, full_name, callback, heard)
