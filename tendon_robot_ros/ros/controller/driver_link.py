"""What the driver says to the controller, and the one thing that the controller asks of it."""

from __future__ import annotations

import time
from collections.abc import Callable

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.client import Client
from rclpy.node import Node
from rclpy.task import Future
from std_srvs.srv import Trigger

from ..shared.messages import LATCHED

Answer = Callable[[bool, str], None]
ANSWER_TIMEOUT_S = 1.0  # [s] two hundred cycles of the driver
RETRY_PERIOD_S = 0.2  # [s] between two wishes that nobody waits for
STATUS, RESUME = '/status', '/resume'


class DriverLink:
    """
    Hears the status of the driver; asks it to follow again after a release.

    Parameters
    ----------
    node : Node
    topic : str
        Of the status; empty: nobody is heard or asked. The service is beside it.
    own : str
        Gid of this controller's commands; the driver says whose it follows.
    hear : callable
        Called with the arguments of `ControllerCore.driver_says`.

    """

    def __init__(
        self, node: Node, topic: str, own: str, hear: Callable[[str, str, int, str], None]
    ) -> None:
        """Listen."""
        self.said = '', '', 0, ''
        self._own, self._hear = own, hear
        self._client: Client | None = None
        self._future: Future | None = None
        self._asked = float('-inf')  # [s]
        self._answers: list[Answer] = []
        if topic:
            node.create_subscription(DiagnosticStatus, topic, self._status, LATCHED)
        if topic.endswith(STATUS):
            self._client = node.create_client(Trigger, topic.removesuffix(STATUS) + RESUME)

    @property
    def may_ask(self) -> bool:
        """Whether to ask again without anybody waiting for it."""
        return self._future is None and time.monotonic() - self._asked > RETRY_PERIOD_S

    def resume(self, answer: Answer) -> bool:
        """Ask the driver to follow commands again; False: there is none that could answer."""
        if self._client is None or not self._client.service_is_ready():
            return False
        self._answers.append(answer)
        if self._future is None:
            self._asked = time.monotonic()
            self._future = self._client.call_async(Trigger.Request())
            self._future.add_done_callback(self._done)
        return True

    def poll(self) -> None:
        """Give up on an answer that does not come."""
        if self._future is not None and time.monotonic() - self._asked > ANSWER_TIMEOUT_S:
            assert self._client is not None
            self._client.remove_pending_request(self._future)
            self._tell(False, f'the driver does not answer within {ANSWER_TIMEOUT_S:g} s')

    def _done(self, future: Future) -> None:
        if future is self._future:
            said = future.result()
            self._tell(said.success, said.message)

    def _tell(self, done: bool, why: str) -> None:
        answers, self._answers, self._future = self._answers, [], None
        for answer in answers:
            answer(done, why)

    def _status(self, message: DiagnosticStatus) -> None:
        values = {item.key: item.value for item in message.values}
        stopped = values.get('reasons', message.message) if values.get('stopped') == 'true' else ''
        follows = values.get('follows_gid', '')
        another = '' not in (follows, self._own) and follows != self._own
        other = f'it follows {values.get("follows", follows)}' if another else ''
        releases = values.get('releases', '0')
        count = int(releases) if releases.isdecimal() else 0
        self.said = stopped, values.get('released', ''), count, other
        self._hear(*self.said)
