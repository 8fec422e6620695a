"""Parameters with description, unit, range and read-only flag; refused with a reason."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from rcl_interfaces.msg import (
    FloatingPointRange,
    ParameterDescriptor,
    ParameterType,
    SetParametersResult,
)
from rclpy.exceptions import ParameterException
from rclpy.node import Node
from rclpy.parameter import Parameter

from ..exceptions import InputError, TendonRobotError

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


class Parameters:
    """The parameters of a node, by name; always valid."""

    def __init__(self, node: Node, specs: Sequence[Spec]) -> None:
        """Declare them; InputError when the node was started with an impossible one."""
        self._node = node
        self._specs = {spec.name: spec for spec in specs}
        self._values: dict[str, Any] = {}
        self._hooks: dict[str, Callable[[Any], None]] = {}
        self._changed: Callable[[], None] | None = None
        for spec in specs:
            try:
                found = node.declare_parameter(spec.name, spec.default, spec.descriptor()).value
            except ParameterException as error:
                raise InputError(f'{spec.name}: {error}') from None
            self._values[spec.name] = spec.checked(found)
        node.add_on_set_parameters_callback(self._set)

    def __getitem__(self, name: str) -> Any:
        """Return the value."""
        return self._values[name]

    def watch(self, hooks: dict[str, Callable[[Any], None]], changed: Callable[[], None]) -> None:
        """
        Hear of changes at run time.

        Parameters
        ----------
        hooks : dict
            Name -> called with the new value; a TendonRobotError refuses it with its text.
        changed : callable
            Called after any accepted change.

        """
        self._hooks, self._changed = hooks, changed

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
