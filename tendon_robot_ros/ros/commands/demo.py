"""
Move a mock arm to the paper's postures: controller, driver and sender as three processes.

Prints a table and draws demo/postures.png. Exits with 1 when a reachable target is missed by more
than 0.5 mm. The mock arm is the controller's own model here: nothing is hidden.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from geometry_msgs.msg import PoseStamped
from numpy.typing import NDArray
from sensor_msgs.msg import JointState

from ...common.colours import COLOURS, ERROR
from ...common.files import new_file
from ...control.checks import direction
from ...control.loading import load
from ...effects import load_catalogue
from ...model.model import Model
from ...robot import load_robot
from ...workspace.view_angle import Posture, salient
from ..shared.messages import COMMAND, LISTEN
from ..shared.robot_client import RobotClient
from ..shared.runtime import Ending, NodeProcess, ros

HELP = "the paper's postures with a mock arm: a table and a picture, in under a minute"
ROBOT = 'kato_10_1'
MISS_MAX_M = 0.5e-3  # [m]
PICTURE = Path('demo/postures.png')


def main(arguments: Sequence[str]) -> int:
    """Run the demo; return 0 when every reachable target was reached."""
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    print(
        'loading the model (the first time it is compiled, about half a minute)', file=sys.stderr
    )
    model = load(load_robot(ROBOT), load_catalogue())
    postures = [*salient(model), _out_of_reach(model)]
    _introduce(model)
    namespace = f'/demo_{os.getpid()}'
    driver = {'robot': ROBOT, 'config': 'mock_twin'}
    with (
        ros(arguments) as ending,
        open(os.devnull, 'w', encoding='utf-8') as quiet,
        NodeProcess('driver', driver, namespace, quiet),
        NodeProcess('controller', {'model': ROBOT}, namespace, quiet),
    ):
        sender = Sender(namespace, model, ending)
        outcomes = []
        try:
            sender.wait_until_up()
            for posture in postures:
                outcomes.append(sender.go(posture))
                print(_row(posture, outcomes[-1]), flush=True)
        finally:
            sender.destroy_node()
    draw(PICTURE, model, postures, outcomes)
    print(f'picture: {PICTURE}')
    missed = [
        posture.name
        for posture, outcome in zip(postures, outcomes, strict=True)
        if outcome.reachable and outcome.miss > MISS_MAX_M
    ]
    if missed or not outcomes[0].reachable:
        print(
            f'error: missed by more than {1e3 * MISS_MAX_M:g} mm: {", ".join(missed)}',
            file=sys.stderr,
        )
        return 1
    return 0


def _out_of_reach(model: Model) -> Posture:
    length = model.robot.length
    position = np.array([0.9 * length, 0.0, 0.9 * length])
    return Posture('out of reach', model.limits[:, 0], position, np.array([1.0, 0.0, 0.0]))


def _introduce(model: Model) -> None:
    robot = model.robot
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


def _row(posture: Posture, outcome: Outcome) -> str:
    x, _, z = 1e3 * outcome.position
    error = f'{1e3 * outcome.miss:.2f} mm {np.degrees(outcome.turn):.2f}°'
    tensions = ' '.join(f'{value:.2f}' for value in outcome.tensions)
    limits = f'  {", ".join(outcome.at_limit)} at its limit' if outcome.at_limit else ''
    return (
        f'{posture.name:20} {f"({x:7.1f}, {z:7.1f})":>22} {error:>18}   '
        f'{tensions + limits:50} {outcome.status:9} {1e3 * outcome.latency:.1f} ms'
    )


# -----------------------------------------------------------------------------
# The third process of the demo: sends targets and watches what the arm does.

Array = NDArray[np.float64]
# [m] the tip has arrived when it moves no more than this in a fifth of a second
STILL_WITHIN_M = 1e-6
START_TIMEOUT_S = 120.0  # [s] for nodes to start, on a busy machine


@dataclass(frozen=True)
class Outcome:
    """Where the arm went."""

    position: Array  # (3,) [m] of the mock's tip
    miss: float  # [m]
    turn: float  # [rad] between the directions
    tensions: Array  # (m,) [N] commanded
    status: str
    at_limit: tuple[str, ...]
    latency: float  # [s] from sending the target to the first command that differs

    @property
    def reachable(self) -> bool:
        """Whether the controller said that the target can be reached."""
        return self.status == 'reached'


class Sender(RobotClient):
    """Speaks to controller and driver only over topics."""

    def __init__(self, namespace: str, model: Model, ending: Ending) -> None:
        """Connect."""
        super().__init__('sender', ending, namespace, f'{model.robot.name}_base')
        self._command: Array | None = None
        self._changed = np.inf
        self._tips: list[tuple[float, PoseStamped]] = []
        self.create_subscription(JointState, 'tendon_command', self._hear_command, COMMAND)
        self.create_subscription(PoseStamped, 'measured_tip', self._hear_tip, LISTEN)

    def wait_until_up(self) -> None:
        """Wait for controller and driver."""
        self.wait(
            lambda: bool(self.status.get('code') in ('holding', 'released') and self._tips),
            START_TIMEOUT_S,
            'controller and driver to start',
        )

    def go(self, posture: Posture) -> Outcome:
        """Send a target and wait until the arm is still."""
        self._changed = np.inf
        self._tips.clear()
        sent = time.monotonic()
        stamp = self.send(posture.position, posture.direction)
        self.wait(
            lambda: self.settled(stamp) and self._still(),
            10.0,
            f'the arm at {posture.name!r}',
        )
        last = self._tips[-1][1].pose
        p, q = last.position, last.orientation
        place, along = np.array([p.x, p.y, p.z]), direction([q.x, q.y, q.z, q.w], 'measured_tip')
        assert self._command is not None
        return Outcome(
            position=place,
            miss=float(np.linalg.norm(place - posture.position)),
            turn=float(np.arccos(np.clip(along @ posture.direction, -1.0, 1.0))),
            tensions=self._command,
            status=self.status['code'],
            at_limit=tuple(filter(None, self.status['at_limit'].split(', '))),
            latency=self._changed - sent,
        )

    def _still(self) -> bool:
        now = time.monotonic()
        recent = [tip.pose.position for at, tip in self._tips if now - at < 0.25]
        if len(recent) < 5 or now - self._tips[0][0] < 0.3:
            return False
        places = np.array([[p.x, p.y, p.z] for p in recent])
        return bool(np.ptp(places, axis=0).max() < STILL_WITHIN_M)

    def _hear_command(self, message: JointState) -> None:
        now, command = time.monotonic(), np.array(message.effort)
        if self._command is not None and not np.array_equal(command, self._command):
            self._changed = min(self._changed, now)
        self._command = command

    def _hear_tip(self, message: PoseStamped) -> None:
        self._tips.append((time.monotonic(), message))


# -----------------------------------------------------------------------------
# The picture of the demo.


def draw(
    path: Path, model: Model, postures: Sequence[Posture], outcomes: Sequence[Outcome]
) -> None:
    """Draw the arm in every posture, and its targets, in the x-z plane [mm]."""
    import matplotlib

    matplotlib.use('Agg')
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(7.0, 6.0), layout='constrained')
    straight = np.cumsum(np.full(model.robot.cells, 1e3 * model.robot.length / model.robot.cells))
    axes.plot(np.zeros(len(straight) + 1), [0.0, *straight], ':', color=ERROR, label='straight')
    for posture, outcome, color in zip(postures, outcomes, COLOURS, strict=False):
        arm = 1e3 * np.vstack([np.zeros(3), model.shape(outcome.tensions).positions])
        label = f'{posture.name}: {1e3 * outcome.miss:.2f} mm'
        axes.plot(arm[:, 0], arm[:, 2], 'o-', color=color, markersize=3, label=label)
        axes.plot(*(1e3 * posture.position[[0, 2]]), 'x', color=color, markersize=10)
        (x, _, z), (u, _, w) = 1e3 * outcome.position, 12.0 * posture.direction
        arrow = {'arrowstyle': '->', 'color': color}
        axes.annotate('', (x + u, z + w), (x, z), arrowprops=arrow)
    axes.set(
        xlabel='x [mm]',
        ylabel='z [mm]',
        aspect='equal',
        title=f'{model.robot.name}: targets (x) and where the mock arm went',
    )
    axes.legend(fontsize='small')
    axes.grid(alpha=0.3)
    path.parent.mkdir(parents=True, exist_ok=True)
    with new_file(path) as draft:
        figure.savefig(draft, dpi=120)
    plt.close(figure)
