"""
Move a mock arm to the paper's postures: controller, driver and sender as three processes.

Prints a table and draws demo/postures.png. Exits with 1 when a reachable target is not reached,
or missed by more than 0.3 mm. The mock arm is the controller's own model: nothing is hidden.

example: python -m tendon_robot_ros demo
"""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...common.arrays import Floats
from ...common.colours import COLOURS, ERROR
from ...common.errors import TendonRobotError
from ...common.files import write_picture
from ...common.rotations import angle_between
from ...control.loading import load
from ...effects import load_catalogue
from ...model.compile import say_where_it_compiles
from ...model.model import Model
from ...model.shape import plot_arms
from ...robot import load_robot
from ...robot.estimates import TRACKER_NOISE_M
from ...workspace.view_angle import Posture, salient
from ..shared.robot_client import Pilot
from ..shared.runtime import NodeProcess, ros
from ..shared.timing import WORK_TIMEOUT_S

HELP = "the paper's postures with a mock arm: a table and a picture, in under a minute"
ROBOT = 'kato_10_1'
PICTURE = Path('demo/postures.png')


def main(arguments: Sequence[str]) -> int:
    """Run the demo; return 0 when every reachable target was reached."""
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    catalogue = load_catalogue()
    say_where_it_compiles(catalogue)
    model = load(load_robot(ROBOT), catalogue)
    robot, length = model.robot, model.robot.length
    beyond = np.array([0.9 * length, 0.0, 0.9 * length])
    postures = [*salient(model), Posture('out of reach', beyond, np.array([1.0, 0.0, 0.0]))]
    effects = ', '.join(
        name + ' ' + ' '.join(f'{key}={value}' for key, value in values.items())
        for name, values in robot.effects.items()
    )
    print(
        f'robot {robot.name}: {len(robot.sections)} sections, {robot.cells} cells, '
        f'{len(robot.tendons)} tendons   model: FKM ({effects})'
    )
    print(
        f'{"target":20} {"tip of the mock [mm]":>22} {"error":>18}   '
        f'{"tensions [N] " + " ".join(robot.inputs):50} {"status":9} to command'
    )
    namespace = f'/demo_{os.getpid()}'
    driver = {'robot': ROBOT, 'config': 'mock_twin'}
    with (
        ros(arguments) as ending,
        open(os.devnull, 'w', encoding='utf-8') as quiet,
        NodeProcess('driver', driver, namespace, quiet),
        NodeProcess('controller', {'model': ROBOT}, namespace, quiet),
        Pilot('sender', ending, namespace=namespace) as pilot,
    ):
        outcomes = []
        pilot.connect(WORK_TIMEOUT_S)
        for posture in postures:
            outcomes.append(go(pilot, posture))
            print(outcomes[-1].row, flush=True)
    draw(PICTURE, model, outcomes)
    print(f'picture: {PICTURE}')
    missed = [
        one.target.name
        for one in outcomes[:-1]  # the last one is out of reach
        if one.status != 'reached' or one.error > TRACKER_NOISE_M
    ]
    if missed:
        limit = f'{1e3 * TRACKER_NOISE_M:g} mm'
        raise TendonRobotError(f'missed by more than {limit}: {", ".join(missed)}')
    return 0


@dataclass(frozen=True)
class Outcome:
    """The result of a target."""

    target: Posture
    position: Floats  # (3,) [m] of the mock's tip
    error: float  # [m] from the target
    tensions: Floats  # (m,) [N] commanded
    status: str
    row: str  # of the table


def go(pilot: Pilot, posture: Posture) -> Outcome:
    """Send a target and wait until the arm is at rest."""
    sent = time.monotonic()
    pilot.stand_at(posture.position, posture.direction, f'the arm at {posture.name!r}')
    (place, along), (times, commands) = pilot.tip(), pilot.commands()
    changed = times[(commands != commands[0]).any(axis=1)]
    latency = changed[0] - sent if len(changed) else np.inf  # [s] to the first that differs
    status, at_limit = pilot.status['code'], pilot.status['at_limit']
    miss = float(np.linalg.norm(place - posture.position))
    turned = np.degrees(angle_between(along, posture.direction))
    (x, _, z), error = 1e3 * place, f'{1e3 * miss:.2f} mm {turned:.2f}°'
    limits = f'  {at_limit} at its limit' if at_limit else ''
    row = (
        f'{posture.name:20} {f"({x:7.1f}, {z:7.1f})":>22} {error:>18}   '
        f'{" ".join(f"{value:.2f}" for value in commands[-1]) + limits:50} {status:9} '
        f'{1e3 * latency:.1f} ms'
    )
    return Outcome(posture, place, miss, commands[-1], status, row)


def draw(path: Path, model: Model, outcomes: Sequence[Outcome]) -> None:
    """Draw the arm in every posture, and its targets, in the x-z plane [mm]."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 6.0), layout='constrained')
    axes = figure.add_subplot()
    straight = np.outer(np.cumsum(model.robot.cell_lengths), [0.0, 0.0, 1.0])[None]
    plot_arms(straight, axes, linestyle=':', marker='', color=ERROR, label='straight')
    for outcome, color in zip(outcomes, COLOURS, strict=False):
        posture = outcome.target
        label = f'{posture.name}: {1e3 * outcome.error:.2f} mm'
        arm = model.shape(outcome.tensions).positions[None]
        plot_arms(arm, axes, color=color, marker='o', markersize=3, label=label)
        axes.plot(*(1e3 * posture.position[[0, 2]]), 'x', color=color, markersize=10)
        (x, _, z), (u, _, w) = 1e3 * outcome.position, 12.0 * posture.direction
        arrow = {'arrowstyle': '->', 'color': color}
        axes.annotate('', (x + u, z + w), (x, z), arrowprops=arrow)
    axes.set_title(f'{model.robot.name}: targets (x) and where the mock arm went')
    axes.legend(fontsize='small')
    axes.grid(alpha=0.3)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_picture(figure, path, 120)
