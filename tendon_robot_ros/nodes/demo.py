"""
Move a mock arm to the paper's postures: controller, driver and sender as three processes.

Prints a table and draws demo/postures.png. Exits with 1 when a reachable target is missed by more
than 0.5 mm. The mock arm is the controller's own model here: nothing is hidden.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..control.loading import load
from ..control.postures import Posture, salient
from ..effects import load_catalogue
from ..model.model import Model
from .demo_picture import draw
from .demo_sender import Outcome, Sender
from .processes import NodeProcess
from .runtime import ros
from .shared import read_robot

HELP = "the paper's postures with a mock arm: a table and a picture, in under a minute"
ROBOT = 'kato_10_1'
LARGEST_MISS = 0.5e-3  # [m]
PICTURE = Path('demo/postures.png')


def main(arguments: Sequence[str]) -> int:
    """Run the demo; return 0 when every reachable target was reached."""
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    print(
        'loading the model (the first time it is compiled, about half a minute)', file=sys.stderr
    )
    model = load(read_robot(ROBOT), load_catalogue())
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
                print(_row(model, posture, outcomes[-1]), flush=True)
        finally:
            sender.destroy_node()
    draw(PICTURE, model, postures, outcomes)
    print(f'picture: {PICTURE}')
    missed = [
        posture.name
        for posture, outcome in zip(postures, outcomes, strict=True)
        if outcome.reachable and outcome.miss > LARGEST_MISS
    ]
    if missed or not outcomes[0].reachable:
        print(
            f'error: missed by more than {1e3 * LARGEST_MISS:g} mm: {", ".join(missed)}',
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


def _row(model: Model, posture: Posture, outcome: Outcome) -> str:
    x, _, z = 1e3 * outcome.position
    error = f'{1e3 * outcome.miss:.2f} mm {np.degrees(outcome.turn):.2f}°'
    tensions = ' '.join(f'{value:.2f}' for value in outcome.tensions)
    limits = f'  {", ".join(outcome.at_limit)} at its limit' if outcome.at_limit else ''
    return (
        f'{posture.name:20} {f"({x:7.1f}, {z:7.1f})":>22} {error:>18}   '
        f'{tensions + limits:50} {outcome.status:9} {1e3 * outcome.latency:.1f} ms'
    )
