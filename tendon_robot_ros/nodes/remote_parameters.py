"""Reading and setting the parameters of another node without waiting for it."""

from __future__ import annotations

import time
from collections.abc import Callable

from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParametersAtomically
from rclpy.client import Client
from rclpy.node import Node
from rclpy.task import Future

PATIENCE = 3.0  # [s] for an answer; one may get lost while nodes come and go


class RemoteText:
    """A text parameter of another node; that node may come and go."""

    def __init__(self, node: Node, other: str, name: str) -> None:
        """Make the clients."""
        self._name, self._other = name, other
        get = node.create_client(GetParameters, f'{other}/get_parameters')
        put = node.create_client(SetParametersAtomically, f'{other}/set_parameters_atomically')
        self._get, self._set = Question(get), Question(put)

    def ask(self, answer: Callable[[str], None]) -> None:
        """Ask for the value; call it now and then: what was never answered is said again."""
        self._set.repeat()

        def done(response: GetParameters.Response) -> None:
            values = response.values
            if values and values[0].type == ParameterType.PARAMETER_STRING:
                answer(values[0].string_value)

        if not self._get.waiting:
            self._get.ask(GetParameters.Request(names=[self._name]), done)
        self._get.repeat()

    def put(self, value: str, answer: Callable[[bool, str], None]) -> None:
        """Set the value; the answer is whether it was taken, and why not."""
        given = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=value)
        request = SetParametersAtomically.Request(
            parameters=[Parameter(name=self._name, value=given)]
        )

        def done(response: SetParametersAtomically.Response) -> None:
            answer(response.result.successful, response.result.reason)

        if not self._set.ask(request, done):
            answer(False, f'{self._other} does not answer: is it running?')


class Question:
    """A request that is made again until it is answered; a new one takes its place."""

    def __init__(self, client: Client) -> None:
        """Take the client."""
        self._client = client
        self._future: Future | None = None
        self._request: object = None
        self._answer: Callable[..., None] | None = None
        self._asked = 0.0

    @property
    def waiting(self) -> bool:
        """Whether an answer is still to come."""
        return self._future is not None

    def ask(self, request: object, answer: Callable[..., None]) -> bool:
        """Make a request; return whether the server is there."""
        self._drop()
        if not self._client.service_is_ready():
            return False
        self._request, self._answer = request, answer
        self._send()
        return True

    def repeat(self) -> None:
        """Make it again if the answer is overdue."""
        if self._future is not None and time.monotonic() - self._asked > PATIENCE:
            self._client.remove_pending_request(self._future)
            self._send()

    def _send(self) -> None:
        self._asked = time.monotonic()
        future = self._future = self._client.call_async(self._request)
        future.add_done_callback(self._done)

    def _done(self, future: Future) -> None:
        if future is not self._future or self._answer is None:
            return
        answer, self._future = self._answer, None
        answer(future.result())

    def _drop(self) -> None:
        if self._future is not None:
            self._client.remove_pending_request(self._future)
        self._future = None
