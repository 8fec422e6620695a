"""
The driver of the driver node and its safety rules, from the parameters.

Also the mock arm with the controller's own model, and its tracker.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from ...common.errors import InputError
from ...common.files import named_file
from ...common.rotations import towards
from ...common.yaml_reading import ConfigFields, in_range
from ...drivers.interface import BACKENDS, Driver, make_driver
from ...drivers.mock import MockDriver
from ...drivers.safety import SafetyRules
from ...model.model import Model
from ...robot import Robot
from ..shared import interface, messages
from ..shared.parameters import ParameterNode, Parameters, base_frame, read_config
from ..shared.runtime import repeat


@dataclass(frozen=True)
class TrackerConfig:
    """Configuration of the tracker of the mock arm; by default a camera without faults."""

    rate: Annotated[float, in_range(0.1, 1000.0, 'Hz')] = 30.0
    noise: Annotated[float, in_range(0.0, 10.0, 'm')] = 0.0  # 1 sd
    seed: Annotated[float, in_range(0.0, 2.0**32 - 1.0, '1')] = 0.0
    missing: Annotated[float, in_range(0.0, 1.0, '1')] = 0.0  # fraction of markers not visible
    lost: Annotated[float, in_range(0.0, 1.0, '1')] = 0.0  # fraction of frames that is lost


class MockTracker:
    """
    Publishes the simulated measurements of the mock arm: measured_tip and measured_shape.

    The shape has one marker at the end of every cell.
    """

    def __init__(self, node: ParameterNode, driver: MockDriver, config: Mapping[str, Any]) -> None:
        """Create publishers and timer; DriverError: the configuration is refused."""
        self._node, self._driver = node, driver
        self._config = ConfigFields('config', 'tracker', config).read(TrackerConfig)
        self._random = np.random.default_rng(int(self._config.seed))
        robot = driver.robot
        self._frame = base_frame(node.parameters, robot.name)
        self._arc_lengths = np.cumsum(robot.cell_lengths)
        self._tip = messages.passing_publisher(node, *interface.topic('measured_tip'))
        self._shape = messages.passing_publisher(node, *interface.topic('measured_shape'))
        self._timer = repeat(node, 1.0 / self._config.rate, self._publish)

    def close(self) -> None:
        """Destroy publishers and timer."""
        for publisher in (self._tip, self._shape):
            self._node.destroy_publisher(publisher)
        self._node.destroy_timer(self._timer)

    def _publish(self) -> None:
        arm: Any = self._driver.truth
        tip_subscribed = self._tip.get_subscription_count() > 0
        shape_subscribed = self._shape.get_subscription_count() > 0
        subscribed = tip_subscribed or shape_subscribed
        if arm is None or not subscribed or self._random.random() < self._config.lost:
            return
        header = messages.header_now(self._node, self._frame)
        n = len(self._arc_lengths)
        points = arm.markers(self._arc_lengths, np.zeros((n, 3)))  # in the frame of the tracker
        tip = arm.tip_position
        # the frame of the tracker may be rotated
        seen = arm.tracked(np.stack([tip, tip + arm.tip_direction]))
        along = seen[1] - seen[0]
        positions = points + self._random.normal(0.0, self._config.noise, (n, 3))
        positions[self._random.random(n) < self._config.missing] = np.nan
        if shape_subscribed:
            self._shape.publish(messages.pose_array(header, positions))
        if tip_subscribed and np.isfinite(positions[-1]).all():
            along /= np.linalg.norm(along)
            self._tip.publish(messages.pose_stamped(header, positions[-1], towards(along)))


MOCK_KEYS = {'plant', 'tracker', 'lag'}  # keys of the configuration of the mock alone
PLANT_KEYS = 'hidden', 'refine', 'scatter', 'capstan', 'seed', 'catalogue'  # as of `make_plant`
# [1/N] strain of the wires of a mock arm, because stiff wires pull against each other without
# bound: 1 / (E A) of steel wires of 0.25 mm (E = 200 GPa)
WIRE_COMPLIANCE = 1e-4


def make(robot: Robot, parameters: Parameters, node: Node) -> tuple[Driver, dict[str, Any]]:
    """Return the driver, not open yet, and the configuration of its tracker (backend mock)."""
    text, mode, backend = (parameters[key] for key in ('config', 'command_mode', 'backend'))
    config = read_config(text)
    source = 'config' if named_file(text) is None else text
    if backend == 'mock':
        tracker = config.pop('tracker', None) or {}
        plant = _plant(robot, mode, ConfigFields(source, 'plant', config.pop('plant', None)))
        return make_driver(backend, robot, config, mode=mode, source=source, plant=plant), tracker
    of_mock = bool(MOCK_KEYS & set(config))
    if of_mock or not config:
        got = f'that of the mock arm ({source})' if of_mock else 'none'
        example = BACKENDS[backend].example.format(mode=mode)
        raise InputError(
            f'config: expected the configuration of the motors for backend {backend}, got {got}; '
            f'copy config/{example}.yaml, put in your motors, and give that file as config'
        )
    link = {'link': partial(Ros2ControlLink, node)} if backend == 'ros2_control' else {}
    return make_driver(backend, robot, config, mode=mode, source=source, **link), {}


def _plant(robot: Robot, mode: str, config: ConfigFields) -> Any:
    """Return the mock arm; imports are local, because hardware drivers load no compiler."""
    config.only(*PLANT_KEYS, 'twin')
    twin = config.flag('twin')
    if mode == 'pull' and not {'tendon_elongation', 'wire_spring'} & set(robot.effects):
        # of a twin a tenth, so that its tip is where the controller's model predicts
        compliance = 0.1 * WIRE_COMPLIANCE if twin else WIRE_COMPLIANCE
        robot = robot.with_effect('tendon_elongation', {'compliance': compliance})
    from ...simulation.hidden import Damage
    from ...simulation.plant import Plant, make_plant

    if twin:  # an arm that equals the model, with its memory (`make demo`)
        return Plant(robot, Model(robot, config.content.get('catalogue')), 1, Damage(robot, 0))
    return make_plant(robot, **{key: config.content[key] for key in PLANT_KEYS if config.has(key)})


def rules(driver: Driver, parameters: Parameters) -> SafetyRules:
    """Return the safety rules: the narrowest limits of robot, driver and parameters."""
    robot, limits = driver.robot, np.array(driver.limits, dtype=float)
    if driver.mode == 'tension':
        low, high = robot.tension_limits
        rate, release = parameters['rate_limit'], parameters['release_rate']
    else:
        high = parameters['pull_limit'] or np.inf
        low, rate, release = -high, parameters['pull_rate_limit'], parameters['pull_release_rate']
    limits = np.column_stack([np.maximum(limits[:, 0], low), np.minimum(limits[:, 1], high)])
    rest, stop_tension, pretension = np.zeros(len(limits)), None, parameters['pretension']
    if driver.mode == 'tension':
        rest = limits[:, 0].copy() if pretension < 0.0 else np.full(len(limits), pretension)
    elif driver.limits_current:
        stop_tension = robot.tension_limits[0] if pretension < 0.0 else pretension
    soon = driver.mode == 'tension' or driver.limits_current
    return parameters.fill(
        SafetyRules,
        inputs=robot.inputs,
        mode=driver.mode,
        limits=limits,
        rates=np.minimum(driver.rates, rate),
        rest=rest,
        release_rate=release,
        stop_time=parameters['stop_time'] if soon else 0.0,
        tension_limits=robot.tension_limits,
        stop_tension=stop_tension,
    )


State = tuple[float, float, float]


class Ros2ControlLink:
    """Publishes std_msgs/Float64MultiArray, subscribes to sensor_msgs/JointState."""

    def __init__(self, node: Node, command_topic: str, state_topic: str) -> None:
        """Create publisher and subscription."""
        self._node, self._joints = node, dict[str, State]()
        self._commands = messages.passing_publisher(
            node, Float64MultiArray, command_topic, interface.COMMAND
        )
        self._states = messages.passing_subscription(
            node, JointState, state_topic, self._receive, interface.JOINTS
        )

    def send(self, values: list[float]) -> None:
        """Publish one value per joint, in the order of the controller."""
        self._commands.publish(Float64MultiArray(data=values))

    def states(self) -> Mapping[str, State]:
        """Return joint -> (monotonic time [s], position, effort), the newest of each."""
        return self._joints

    def close(self) -> None:
        """Destroy publisher and subscription."""
        self._node.destroy_subscription(self._states)
        self._node.destroy_publisher(self._commands)

    def _receive(self, message: JointState) -> None:
        now, joints = time.monotonic(), dict(self._joints)
        for i, name in enumerate(message.name):
            position = message.position[i] if i < len(message.position) else float('nan')
            effort = message.effort[i] if i < len(message.effort) else float('nan')
            joints[name] = now, position, effort
        self._joints = joints  # replaced as a whole: the motor thread reads it meanwhile
