"""
Joints of ros2_control behind the driver interface: a group controller commands them.

The robot's limits, rates and releases hold as for every backend; when this process dies, the
hardware component decides the behaviour of the motors (docs/hardware.md).
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from itertools import compress
from typing import Annotated, Any, NamedTuple, Self

import numpy as np

from ..common.arrays import Floats
from ..common.errors import DriverError
from ..common.yaml_reading import ConfigFields, in_range, one_of
from ..robot import Robot
from . import hardware
from .interface import Fault, Reading

PULL_DEFAULT_M = 0.05  # [m] either way without `pull_limits`, else nothing would bound a pull


# here, because a function within an annotation does not see the names of this module
PullLimits = Annotated[tuple[float, float], lambda one, _: hardware.read_pull_limits(one, 10.0)]


class Joint(NamedTuple):
    """The joint of one input, by the keys of the file."""

    joint: str
    spool_radius: float  # [m], 1 for a prismatic joint
    direction: int  # 1: growing positions wind
    zero: float  # [rad] or [m], position of the joint at zero pull


@dataclass(frozen=True, kw_only=True)
class Ros2ControlConfig:
    """Checked configuration of the driver, by the keys of its file."""

    command_topic: str
    state_topic: str
    joints: tuple[str, ...]  # as the group controller lists them
    timeout: Annotated[float, in_range(0.005, 10.0, 's')] = 0.1  # of silence of a joint
    tension_source: Annotated[str, one_of('load_cell', 'current')] = 'current'
    tension_rate: Annotated[float, in_range(0.01, 1000.0, 'N/s')] = 20.0
    pull_rate: Annotated[float, in_range(1e-5, 10.0, 'm/s')] = 0.05
    pull_limits: PullLimits = (-PULL_DEFAULT_M, PULL_DEFAULT_M)  # [m]
    tendons: tuple[Joint, ...]  # of every input

    @classmethod
    def checked(cls, robot: Robot, content: Mapping[str, Any], mode: str, source: str) -> Self:
        """Read a mapping; DriverError says key, what was expected and what came."""
        top = ConfigFields(source, '', dict(content))
        top.only(*(field.name for field in fields(cls)), 'spool_radius')
        tendons = []
        for item in hardware.fields_of_inputs(top, 'tendons', 'a joint', robot).values():
            item.only(*Joint._fields)
            rolled = hardware.nearest(item, top, 'spool_radius').has('spool_radius')
            tendons.append(
                Joint(
                    item.name('joint'),
                    hardware.read_spool_radius(item, top) if rolled else 1.0,
                    hardware.read_direction(item, 'growing positions wind'),
                    item.number('zero', -1e6, 1e6, 'rad or m', 0.0),
                )
            )
        names, joints = [tendon.joint for tendon in tendons], top.content.get('joints')
        top.unique('tendons', names)
        if not isinstance(joints, list) or sorted(map(str, joints)) != sorted(names):
            expected = f'the joints of the tendons, {", ".join(names)}, as the controller has them'
            raise top.error('joints', expected, joints)
        kind = 'effort' if mode == 'tension' else 'position'
        return cls(
            command_topic=str(
                top.content.get('command_topic') or f'{kind}_group_controller/commands'
            ),
            state_topic=str(top.content.get('state_topic') or '/joint_states'),
            joints=tuple(map(str, joints)),
            tendons=tuple(tendons),
            **top.fields(cls),
        )


class Ros2ControlDriver(hardware.HardwareDriver):
    """
    Tension mode: efforts to an effort group controller; pull mode: positions to a position one.

    A group controller has no torque to switch off: what is disabled gets no effort, or in pull
    mode stays where it is.

    Parameters
    ----------
    robot : Robot
    config : Ros2ControlConfig
    mode : str
        `tension` or `pull`.
    link : object
        The topics of commands and states, as `ros.driver.backend.Ros2ControlLink`.

    """

    def __init__(self, robot: Robot, config: Ros2ControlConfig, mode: str, link: Any) -> None:
        """Create a closed driver."""
        low, high = robot.tension_limits if mode == 'tension' else config.pull_limits
        rate = config.tension_rate if mode == 'tension' else config.pull_rate
        m = len(robot.inputs)
        limits, rates = np.tile([low, high], (m, 1)), np.full(m, rate)
        super().__init__(robot, mode, config.command_topic, limits, rates)
        self.config, self.link = config, link
        self._names, *numbers = zip(*config.tendons, strict=True)
        self._order = [self._names.index(joint) for joint in config.joints]
        self._radii, self._directions, self._zeros = np.array(numbers, dtype=float)
        self._on = np.zeros(m, dtype=bool)

    @classmethod
    def from_config(
        cls, robot: Robot, config: Mapping[str, Any], *, mode: str, source: str, link: Any
    ) -> Self:
        """Make the driver from its configuration; `link` makes the link of its two topics."""
        checked = Ros2ControlConfig.checked(robot, config, mode, source)
        return cls(robot, checked, mode, link(checked.command_topic, checked.state_topic))

    def open(self) -> None:
        """Begin to listen; nothing is sent."""
        self._is_open = True

    def close(self) -> None:
        """Close the link; no command is sent after."""
        if self._is_open:
            self.link.close()
        self._is_open = False

    def enable(self) -> None:
        """Begin at the measured state; DriverError while a joint is silent."""
        self._require_open('enable')
        reading = self.read()
        if reading.faults:
            raise DriverError(reading.faults[0].message)
        measured = reading.tensions if self.mode == 'tension' else reading.pulls
        if not np.isfinite(measured).all():
            what = 'effort' if self.mode == 'tension' else 'position'
            raise DriverError(
                f'{self.config.state_topic}: {what} is not there: expected it for every joint in '
                f'{self.mode} mode'
            )
        self._goal = np.maximum(measured, 0.0) if self.mode == 'tension' else measured
        self._on[:], self._written = True, time.monotonic()
        self._send()

    def disable(self, inputs: Sequence[str] = ()) -> None:
        """No effort for the named inputs, or all; in pull mode they stay where they are."""
        which = self._chosen(inputs)
        self._on &= ~which
        if self._is_open and self.mode == 'tension':
            self._goal = np.where(which, 0.0, self._goal)
            self._send()

    def write(self, command: Floats) -> None:
        """Command every input within limits and rates; what is off stays off."""
        self._require_open('write')
        values = self.checked(command)
        lowest = np.column_stack([np.minimum(self._goal, self.limits[:, 0]), self.limits[:, 1]])
        goal = self._towards(values, lowest, self._since_write())
        self._goal = np.where(self._on, goal, self._goal)
        self._send()

    def read(self) -> Reading:
        """Return the newest joint states; joints that are silent are nan."""
        self._require_open('read')
        now, states, config = time.monotonic(), self.link.states(), self.config
        values = np.array([states.get(name, (-np.inf, np.nan, np.nan)) for name in self._names])
        silent = now - values[:, 0] > config.timeout
        values[silent, 1:] = np.nan
        faults: tuple[Fault, ...] = ()
        if silent.any():
            names = ', '.join(compress(self._names, silent))
            text = (
                f'{config.state_topic}: nothing of {names} for {config.timeout:g} s; '
                'is joint_state_broadcaster active?'
            )
            faults = (Fault('silent', text, inputs=tuple(compress(self.inputs, silent))),)
        pulls = (values[:, 1] - self._zeros) * self._directions * self._radii
        tensions = values[:, 2] * self._directions / self._radii
        return Reading(now, pulls, tensions, config.tension_source, faults=faults)

    def describe(self) -> dict[str, str]:
        """Name the topics."""
        return {'commands': self.config.command_topic, 'states': self.config.state_topic}

    def _send(self) -> None:
        if self.mode == 'tension':
            values = self._goal * self._radii * self._directions
        else:
            values = self._goal / self._radii * self._directions + self._zeros
        self.link.send(values[self._order].tolist())
