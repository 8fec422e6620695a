"""What the driver node is made of: its parameters, the driver behind it, the rules it holds."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from rclpy.node import Node

from ..drivers import Driver, make_driver
from ..drivers.safety import SafetyRules
from ..exceptions import InputError
from ..robot import Robot
from .group_link import GroupLink
from .lifecycle import AUTOSTART
from .parameters import Parameters, Spec
from .shared import read_mapping

TWIN_COMPLIANCE, WIRE_COMPLIANCE = 1e-5, 1e-4  # [1/N] strain of a mock arm's wires

SPECS = (
    Spec(
        'robot',
        '',
        'robot description: a path, the name of a robot in config/robots, or YAML text',
        read_only=True,
    ),
    Spec(
        'backend',
        'mock',
        'what is behind the driver',
        read_only=True,
        choices=('mock', 'dynamixel', 'serial', 'ros2_control'),
    ),
    Spec(
        'config',
        '',
        'configuration of the backend: a path, the name of a file in config, or YAML text',
        read_only=True,
    ),
    Spec(
        'command_mode',
        'tension',
        'what is commanded: tension [N] (effort) or wire pull [m] (position)',
        read_only=True,
        choices=('tension', 'pull'),
    ),
    Spec('rate', 200.0, 'cycles of command and reading', 'Hz', 10.0, 1000.0, read_only=True),
    Spec('command_timeout', 0.1, 'silence after which the arm is released', 's', 0.01, 10.0),
    Spec('rate_limit', 20.0, 'largest change of a commanded tension', 'N/s', 0.01, 1000.0),
    Spec(
        'release_rate', 10.0, 'largest change of a tension during a release', 'N/s', 0.01, 1000.0
    ),
    Spec(
        'release_to',
        'pretension',
        'end of a release: hold pretension, or torque off',
        choices=('pretension', 'limp'),
    ),
    Spec(
        'pretension',
        -1.0,
        'tension held after a release; -1: the lower tension limit',
        'N',
        -1.0,
        100.0,
        read_only=True,
    ),
    Spec(
        'pull_limit',
        0.0,
        'largest wire pull either way; 0: that of the backend',
        'm',
        0.0,
        1.0,
        read_only=True,
    ),
    Spec('pull_rate_limit', 0.05, 'largest change of a commanded wire pull', 'm/s', 1e-5, 10.0),
    Spec(
        'pull_release_rate',
        0.02,
        'largest change of a wire pull during a release',
        'm/s',
        1e-5,
        10.0,
    ),
    Spec(
        'stamp_tolerance',
        0.5,
        'largest age, and largest lead, of a stamped command',
        's',
        0.01,
        60.0,
    ),
    Spec('frame_prefix', '', 'put before frame names (backend mock: its tracker)', read_only=True),
    Spec('base_frame', '', 'frame of the base; empty: <robot>_base', read_only=True),
    Spec('mock_fault', '', 'backend mock: fault to inject, as overload:NAME,NAME; empty: none'),
    AUTOSTART,
)


def make(robot: Robot, parameters: Parameters, node: Node) -> tuple[Driver, dict[str, Any]]:
    """Make the driver, not open yet; also return what its tracker is told (backend mock)."""
    config = read_mapping(parameters['config'], 'config')
    mode, backend = parameters['command_mode'], parameters['backend']
    text = parameters['config']
    source = text if text and '\n' not in text and ':' not in text else 'config'
    if backend == 'ros2_control':
        link = partial(GroupLink, node)
        return make_driver(backend, robot, config, mode=mode, source=source, link=link), {}
    if backend != 'mock':
        return make_driver(backend, robot, config, mode=mode, source=source), {}
    tracker = config.pop('tracker', None) or {}
    plant = _plant(robot, mode, config.pop('plant', None) or {}, f'{source}: plant')
    return make_driver(backend, robot, config, mode=mode, source=source, plant=plant), tracker


def _plant(robot: Robot, mode: str, config: dict[str, Any], source: str) -> Any:
    """Make the mock arm; imported here because drivers of hardware load no compiler."""
    twin = config.pop('twin', False)
    if mode == 'pull' and 'tendon_elongation' not in robot.effects:
        # stiff wires pull against each other without bound; theirs give a little
        compliance = TWIN_COMPLIANCE if twin else WIRE_COMPLIANCE
        robot = robot.with_effect('tendon_elongation', {'compliance': compliance})
    if twin:
        from .twin import Twin

        return Twin(robot)
    from ..model.plant import make_plant

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
    rest = np.zeros(m)
    if driver.mode == 'tension':
        wanted = parameters['pretension']
        rest = limits[:, 0].copy() if wanted < 0.0 else np.full(m, wanted)
    return SafetyRules(
        inputs=robot.inputs,
        mode=driver.mode,
        limits=limits,
        rates=np.minimum(driver.rates, rate),
        rest=rest,
        release_rate=release,
        command_timeout=parameters['command_timeout'],
        release_to=parameters['release_to'],
        tension_limits=robot.tension_limits,
    )
