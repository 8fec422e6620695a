"""Reading and setting the parameters of another node without waiting for it."""

from __future__ import annotations

from collections.abc import Callable

from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParametersAtomically
from rclpy.node import Node


class RemoteText:
    """A text parameter of another node; that node may come and go."""

    def __init__(self, node: Node, other: str, name: str) -> None:
        """Make the clients."""
        self._name, self._other = name, other
        self._get = node.create_client(GetParameters, f'{other}/get_parameters')
        self._set = node.create_client(
            SetParametersAtomically, f'{other}/set_parameters_atomically'
        )
        self._asked = False

    def ask(self, answer: Callable[[str], None]) -> None:
        """Ask for the value, unless that is asked already; the answer may never come."""
        if self._asked and self._get.service_is_ready():
            return
        if not self._get.service_is_ready():
            self._asked = False
            return
        self._asked = True

        def done(future: object) -> None:
            self._asked = False
            values = future.result().values  # type: ignore[attr-defined]
            if values and values[0].type == ParameterType.PARAMETER_STRING:
                answer(values[0].string_value)

        self._get.call_async(GetParameters.Request(names=[self._name])).add_done_callback(done)

    def put(self, value: str, answer: Callable[[bool, str], None]) -> None:
        """Set the value; the answer is whether it was taken, and why not."""
        if not self._set.service_is_ready():
            answer(False, f'{self._other} does not answer: is it running?')
            return
        given = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=value)
        request = SetParametersAtomically.Request(
            parameters=[Parameter(name=self._name, value=given)]
        )

        def done(future: object) -> None:
            result = future.result().result  # type: ignore[attr-defined]
            answer(result.successful, result.reason)

        self._set.call_async(request).add_done_callback(done)
