"""The status of a node: latched on ~/status, and part of /diagnostics."""

from __future__ import annotations

import time
from collections.abc import Mapping

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from .qos import LATCHED, STATE

OK, WARN, ERROR, STALE = (
    DiagnosticStatus.OK,
    DiagnosticStatus.WARN,
    DiagnosticStatus.ERROR,
    DiagnosticStatus.STALE,
)
LEVELS = {'ok': OK, 'warn': WARN, 'error': ERROR}
PERIOD = 1.0  # [s] at least so often
SHORTEST_NEWS = 0.02  # [s] news may come and go with every message
LOG_PERIOD = 2.0  # [s] the same news is logged no more often than this
SHORTEST = 0.1  # [s] values that change all the time are sent no more often than this


class Status:
    """
    Publishes a level, a sentence, a code and values.

    A new level or code goes out at once and into the log; changed values go out at most ten
    times a second, and everything at least once a second.
    """

    def __init__(self, node: Node) -> None:
        """Make the publishers."""
        self._node = node
        self._name = node.get_fully_qualified_name()
        self._latched = node.create_publisher(DiagnosticStatus, '~/status', LATCHED)
        self._diagnostics = node.create_publisher(DiagnosticArray, '/diagnostics', STATE)
        self._sent: DiagnosticStatus | None = None
        self._sent_at = 0.0
        self._key: tuple[bytes, str] | None = None
        self._logged: dict[str, float] = {}

    def say(
        self, level: bytes, code: str, message: str, values: Mapping[str, str] | None = None
    ) -> None:
        """
        Say how the node is.

        Parameters
        ----------
        level : bytes
            OK, WARN, ERROR or STALE.
        code : str
            Short and stable, for programs; also under the key `code`.
        message : str
            One sentence for a person.
        values : mapping, optional
            More, as text with units.

        """
        now = time.monotonic()
        news = (level, code) != self._key
        if now - self._sent_at < (SHORTEST_NEWS if news else SHORTEST):
            return
        status = DiagnosticStatus(
            level=level,
            name=self._name,
            message=message,
            hardware_id=self._node.get_name(),
            values=[
                KeyValue(key=key, value=value)
                for key, value in {'code': code, **(values or {})}.items()
            ],
        )
        if not news and status == self._sent and now - self._sent_at < PERIOD:
            return
        if news and now - self._logged.get(code, -LOG_PERIOD) >= LOG_PERIOD:
            self._logged[code] = now
            self._log(level, f'{code}: {message}')
        self._key, self._sent, self._sent_at = (level, code), status, now
        self._latched.publish(status)
        array = DiagnosticArray(status=[status])
        array.header.stamp = self._node.get_clock().now().to_msg()
        self._diagnostics.publish(array)

    def _log(self, level: bytes, text: str) -> None:
        logger = self._node.get_logger()
        if level == OK:
            logger.info(text)
        elif level == WARN:
            logger.warning(text)
        else:
            logger.error(text)
