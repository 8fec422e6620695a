"""Parameters with description, unit, range and read-only flag; refused with a reason."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from rcl_interfaces.msg import (
    FloatingPointRange,
    ParameterDescriptor,
    ParameterType,
    ParameterValue,
    SetParametersResult,
)
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.srv import GetParameters, SetParametersAtomically
from rclpy.client import Client
from rclpy.exceptions import ParameterException
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.task import Future

from ...common.errors import InputError, TendonRobotError
from .overrides import check_files, check_overrides
from .runtime import given

TYPES = {
    bool: ParameterType.PARAMETER_BOOL,
    float: ParameterType.PARAMETER_DOUBLE,
    str: ParameterType.PARAMETER_STRING,
    list: ParameterType.PARAMETER_STRING_ARRAY,
}


@dataclass(frozen=True)
class Spec:
    """A parameter of a node; a list is a list of strings."""

    name: str
    default: bool | float | str | list[str]
    text: str
    unit: str = ''
    low: float = -math.inf
    high: float = math.inf
    read_only: bool = False
    choices: tuple[str, ...] = ()

    def checked(self, value: Any) -> Any:
        """Return the value in its type; InputError says what was expected."""
        kind = type(self.default)
        if kind is float and isinstance(value, int) and not isinstance(value, bool):
            value = float(value)  # a person writes 10 and means 10.0
        if kind is list and isinstance(value, (list, tuple)):
            value = [str(item) for item in value if str(item)]
        if not isinstance(value, kind):
            names = {bool: 'true or false', float: 'a number', str: 'text', list: 'a list of text'}
            raise InputError(f'{self.name}: expected {names[kind]}, got {value!r}')
        if isinstance(value, float) and not self.low <= value <= self.high:
            raise InputError(
                f'{self.name}: expected {self.low:g} to {self.high:g} {self.unit}, got {value:g}'
            )
        if self.choices and value not in self.choices:
            raise InputError(
                f'{self.name}: expected one of {", ".join(self.choices)}, got {value!r}'
            )
        return value

    def descriptor(self) -> ParameterDescriptor:
        """Describe the parameter to ROS."""
        unit = f' [{self.unit}]' if self.unit else ''
        made = ParameterDescriptor(
            name=self.name,
            description=self.text + unit,
            read_only=self.read_only,
            type=TYPES[type(self.default)],
            dynamic_typing=True,  # `checked` takes 10 for 10.0
            additional_constraints=' | '.join(self.choices),
        )
        if math.isfinite(self.low) and math.isfinite(self.high):
            made.floating_point_range = [
                FloatingPointRange(from_value=self.low, to_value=self.high)
            ]
        return made


COMMAND_MODE = Spec(
    'command_mode',
    'tension',
    'what is commanded: tension [N] (effort) or wire pull [m] (position)',
    read_only=True,
    choices=('tension', 'pull'),
)


class Parameters:
    """The parameters of a node, by name; always valid."""

    def __init__(self, node: Node, specs: Sequence[Spec]) -> None:
        """Declare them; InputError when the node was started with an impossible one."""
        self._node = node
        self._specs = {spec.name: spec for spec in specs}
        self._values: dict[str, Any] = {}
        self._hooks: dict[str, Callable[[Any], object]] = {}
        self._changed: Callable[[], None] | None = None
        for spec in specs:
            try:
                value = node.declare_parameter(spec.name, spec.default, spec.descriptor()).value
            except ParameterException as error:
                raise InputError(f'{spec.name}: {error}') from None
            self._values[spec.name] = spec.checked(value)
        check_overrides(node._parameter_overrides, self._specs, node.get_name(), given)
        for passed_over in check_files(given, node.get_fully_qualified_name()):
            node.get_logger().warning(passed_over)
        node.add_on_set_parameters_callback(self._set)

    def __getitem__(self, name: str) -> Any:
        """Return the value."""
        return self._values[name]

    def watch(
        self, hooks: Mapping[str, Callable[[Any], object]], changed: Callable[[], None]
    ) -> None:
        """
        Hear of changes at run time.

        Parameters
        ----------
        hooks : dict
            Name -> called with the new value; a TendonRobotError refuses it with its text.
        changed : callable
            Called after any accepted change.

        """
        self._hooks, self._changed = dict(hooks), changed

    def put_back(self, name: str, value: Any) -> None:
        """Set a parameter to a value it had, without asking the hooks."""
        hook = self._hooks.pop(name, None)
        self._node.set_parameters([Parameter(name, value=value)])
        if hook is not None:
            self._hooks[name] = hook

    def _set(self, parameters: Sequence[Parameter]) -> SetParametersResult:
        accepted = {}
        try:
            for parameter in parameters:
                if parameter.name in self._specs:
                    value = self._specs[parameter.name].checked(parameter.value)
                    accepted[parameter.name] = value
            for name, value in accepted.items():
                if name in self._hooks:
                    self._hooks[name](value)
        except TendonRobotError as error:
            return SetParametersResult(successful=False, reason=' '.join(str(error).split()))
        self._values.update(accepted)
        if self._changed is not None:
            self._changed()
        return SetParametersResult(successful=True)


# -----------------------------------------------------------------------------
# Reading and setting the parameters of another node without waiting for it.

ANSWER_TIMEOUT_S = 3.0  # [s] for an answer; one may get lost while nodes come and go


class RemoteText:
    """A parameter of another node, a text or a list of them; that node may come and go."""

    def __init__(self, node: Node, other: str, name: str) -> None:
        """Make the clients."""
        self._name, self._other = name, other
        get = node.create_client(GetParameters, f'{other}/get_parameters')
        put = node.create_client(SetParametersAtomically, f'{other}/set_parameters_atomically')
        self._get, self._set = Question(get), Question(put)

    def ask(self, answer: Callable[[str], None]) -> None:
        """Ask for the value; call it now and then: what was never answered is said again."""
        self._ask(ParameterType.PARAMETER_STRING, lambda reply: answer(reply.string_value))

    def ask_list(self, answer: Callable[[list[str]], None]) -> None:
        """Ask for a list of texts, in the same way."""
        self._ask(
            ParameterType.PARAMETER_STRING_ARRAY,
            lambda reply: answer([text for text in reply.string_array_value if text]),
        )

    def _ask(self, kind: int, answer: Callable[[ParameterValue], None]) -> None:
        self._set.repeat()

        def done(response: GetParameters.Response) -> None:
            values = response.values
            if values and values[0].type == kind:
                answer(values[0])

        if not self._get.waiting:
            self._get.ask(GetParameters.Request(names=[self._name]), done)
        self._get.repeat()

    def put(self, value: str, answer: Callable[[bool, str], None]) -> None:
        """Set the value; the answer is whether it was taken, and why not."""
        parameter = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=value)
        request = SetParametersAtomically.Request(
            parameters=[ParameterMessage(name=self._name, value=parameter)]
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
        if self._future is not None and time.monotonic() - self._asked > ANSWER_TIMEOUT_S:
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
