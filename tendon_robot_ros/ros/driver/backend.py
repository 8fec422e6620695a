"""The driver behind the driver node: made as the parameters say, with the rules that they set."""

from __future__ import annotations

import time
from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from ...common.errors import InputError
from ...drivers import Driver, make_driver
from ...drivers.interface import BACKENDS
from ...drivers.safety import SafetyRules
from ...robot import Robot
from ..shared.files import read_mapping
from ..shared.messages import COMMAND, JOINTS
from ..shared.parameters import Parameters

MOCK_KEYS = {'plant', 'tracker', 'lag'}  # what no other backend has in its configuration
TWIN_COMPLIANCE, WIRE_COMPLIANCE = 1e-5, 1e-4  # [1/N] strain of a mock arm's wires


def make(robot: Robot, parameters: Parameters, node: Node) -> tuple[Driver, dict[str, Any]]:
    """Make the driver, not open yet; also return what its tracker is told (backend mock)."""
    config = read_mapping(parameters['config'], 'config')
    mode, backend = parameters['command_mode'], parameters['backend']
    text = parameters['config']
    source = text if text and '\n' not in text and ':' not in text else 'config'
    if backend != 'mock':
        _check_whose(backend, mode, config, source)
    if backend == 'ros2_control':
        link = partial(Ros2ControlLink, node)
        return make_driver(backend, robot, config, mode=mode, source=source, link=link), {}
    if backend != 'mock':
        return make_driver(backend, robot, config, mode=mode, source=source), {}
    tracker = config.pop('tracker', None) or {}
    plant = _plant(robot, mode, config.pop('plant', None) or {}, f'{source}: plant')
    return make_driver(backend, robot, config, mode=mode, source=source, plant=plant), tracker


def _check_whose(backend: str, mode: str, config: dict[str, Any], source: str) -> None:
    """Refuse no configuration, and that of the mock arm, for motors."""
    of_mock = bool(MOCK_KEYS & set(config))
    if config and not of_mock:
        return
    got = f'that of the mock arm ({source})' if of_mock else 'none'
    example = BACKENDS[backend].example.format(mode=mode)
    raise InputError(
        f'config: expected the configuration of the motors for backend {backend}, got {got}; copy '
        f'config/{example}.yaml, put in your motors, and give that file as config'
    )


def _plant(robot: Robot, mode: str, config: dict[str, Any], source: str) -> Any:
    """Make the mock arm; imported here because drivers of hardware load no compiler."""
    twin = config.pop('twin', False)
    if mode == 'pull' and not {'tendon_elongation', 'wire_spring'} & set(robot.effects):
        # stiff wires pull against each other without bound; theirs give a little
        compliance = TWIN_COMPLIANCE if twin else WIRE_COMPLIANCE
        robot = robot.with_effect('tendon_elongation', {'compliance': compliance})
    if twin:
        from .mock_arm import Twin

        return Twin(robot)
    from ...simulation.plant import make_plant

    try:
        return make_plant(robot, **config)
    except TypeError as error:
        raise InputError(f'{source}: {error}') from None


def rules(robot: Robot, driver: Driver, parameters: Parameters) -> SafetyRules:
    """Combine the limits of robot, driver and parameters; the narrowest holds."""
    m = len(robot.inputs)
    limits = np.array(driver.limits, dtype=float)
    if driver.mode == 'tension':
        low, high = robot.tension_limits
        rate, release = parameters['rate_limit'], parameters['release_rate']
    else:
        high = parameters['pull_limit'] or np.inf
        low, rate, release = -high, parameters['pull_rate_limit'], parameters['pull_release_rate']
    limits = np.column_stack([np.maximum(limits[:, 0], low), np.minimum(limits[:, 1], high)])
    rest, give_way, wanted = np.zeros(m), None, parameters['pretension']
    if driver.mode == 'tension':
        rest = limits[:, 0].copy() if wanted < 0.0 else np.full(m, wanted)
    elif driver.gives_way:
        give_way = robot.tension_limits[0] if wanted < 0.0 else wanted
    soon = driver.mode == 'tension' or driver.gives_way
    return SafetyRules(
        inputs=robot.inputs,
        mode=driver.mode,
        limits=limits,
        rates=np.minimum(driver.rates, rate),
        rest=rest,
        release_rate=release,
        command_timeout=parameters['command_timeout'],
        release_to=parameters['release_to'],
        stop_time=parameters['stop_time'] if soon else 0.0,
        tension_limits=robot.tension_limits,
        give_way=give_way,
    )


# -----------------------------------------------------------------------------
# Topics of ros2_control: commands of a group controller, states of the joints.

State = tuple[float, float, float]


class Ros2ControlLink:
    """Publishes std_msgs/Float64MultiArray, hears sensor_msgs/JointState."""

    def __init__(self, node: Node, command_topic: str, state_topic: str) -> None:
        """Begin to listen."""
        self._node, self._heard = node, dict[str, State]()
        self._commands = node.create_publisher(Float64MultiArray, command_topic, COMMAND)
        self._states = node.create_subscription(JointState, state_topic, self._hear, JOINTS)

    def send(self, values: list[float]) -> None:
        """Send one value per joint, in the order of the controller."""
        self._commands.publish(Float64MultiArray(data=values))

    def states(self) -> Mapping[str, State]:
        """Return joint -> (monotonic time [s], position, effort), the newest of each."""
        return self._heard

    def close(self) -> None:
        """Stop to listen."""
        self._node.destroy_subscription(self._states)
        self._node.destroy_publisher(self._commands)

    def _hear(self, message: JointState) -> None:
        now, heard = time.monotonic(), dict(self._heard)
        for i, name in enumerate(message.name):
            position = message.position[i] if i < len(message.position) else float('nan')
            effort = message.effort[i] if i < len(message.effort) else float('nan')
            heard[name] = now, position, effort
        self._heard = heard  # the motor thread reads the old one or the new one, never half
