"""
What targets within reach, and beyond it, cost in tension, error and time.

Every shipped robot, in tension and in pull mode, with a load at its tip and gravity, ten times as
large, and a stream of targets that leaves what the arm reaches and comes back.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from machine import machine, tell

from tendon_robot_ros.model.inverse import reach
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.model.tip_task import COLD, STREAM, TipTask
from tendon_robot_ros.robot import Robot, load_robot

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / 'test'))
from arms import scaled

ROBOTS = sorted((Path(__file__).parent.parent / 'config' / 'robots').glob('*.yaml'))
LARGER = 10.0  # times as long; stiffness by its cube, so that tensions are its square
DRAWN_SHARE = 0.3  # [1] of the tensions' range, of postures whose tips are targets within reach
BEYOND = 1.05, 1.4  # [1] of the length from the base: no arm is that long
BESIDE = 0.1, 0.3  # [1] of the length that a target beside a tip of the workspace is off
STREAM_STEPS, STREAM_OUT = 40, 0.5  # targets of a stream; [1] of the length it goes beyond a tip
FOUND_M = 1e-5  # [m] of an arm of 0.1 m to be found, and as a share of others
AT_LIMIT = 0.999  # [1] of the range


def cases() -> Iterator[tuple[str, Robot, bool]]:
    """Yield a name, a robot and whether wires are driven by their lengths."""
    for file in ROBOTS:
        robot = load_robot(file)
        yield f'{robot.name}, tension', robot, False
        yield f'{robot.name}, pull', robot, True
        yield f'{robot.name}, loaded', loaded(robot), False
        yield f'{robot.name}, x{LARGER:g}', scaled(robot, LARGER, LARGER**3), False


def loaded(robot: Robot) -> Robot:
    """Hang a tenth of what bends the arm by a radian at its tip, and give it a weight."""
    force = 0.1 * robot.sections[-1].bending_stiffness[0] / robot.length
    robot = robot.with_effect('tip_load', {'force_x': force})
    return robot.with_effect('gravity', {'linear_density': 0.1 * force / robot.length})


def targets(model: Model, kind: str, count: int) -> np.ndarray:
    """Return places (count, 3) [m] for the tip."""
    random, length = np.random.default_rng(7), model.robot.length
    low, high = model.limits.T
    drawn = low + DRAWN_SHARE * random.random((4 * count, len(low))) * (high - low)
    shapes, changes = model.solve(drawn)
    tips = shapes.tip_position[np.flatnonzero(changes < 1e-10)[:count]]
    along = random.normal(size=tips.shape)
    if not np.any(np.abs(tips[:, 1]) > 1e-6 * length):  # a planar arm
        along[:, 1] = 0.0
    along /= np.linalg.norm(along, axis=1)[:, None]
    if kind == 'within':
        return tips
    if kind == 'beside':
        return tips + random.uniform(*BESIDE, (len(tips), 1)) * length * along
    along[:, 2] = np.abs(along[:, 2])
    return random.uniform(*BEYOND, (len(tips), 1)) * length * along


def searched(robot: Robot, by_pulls: bool, kind: str, count: int) -> dict[str, np.ndarray]:
    """Return errors [1] of the length, shares of the tensions' range, times [s], statuses."""
    model = Model(robot)
    _ = model.library
    low, high = model.limits.T
    made = []
    for place in targets(model, kind, count):
        start = time.thread_time()
        reach = model.reach(place, by_pulls=by_pulls)
        spent = time.thread_time() - start
        share = (reach.tensions - low) / (high - low)
        made.append((reach.position_error / robot.length, share.max(), share.mean(), spent))
    return dict(zip(('error', 'largest', 'mean', 'time'), np.array(made).T, strict=True))


def told(found: dict[str, np.ndarray], robot: Robot, kind: str) -> dict[str, float]:
    """Return medians, and shares of the targets."""
    figures = {
        'largest tension [% of range]': 100.0 * float(np.mean(found['largest'])),
        'mean tension [% of range]': 100.0 * float(np.mean(found['mean'])),
        'targets with a tendon at its limit [%]': 100.0
        * float(np.mean(found['largest'] > AT_LIMIT)),
        'milliseconds': 1e3 * float(np.median(found['time'])),
    }
    if kind == 'within':
        enough = FOUND_M / 0.1 if robot.length > 1.0 else FOUND_M / robot.length
        figures['found to 10 um [%]'] = 100.0 * float(np.mean(found['error'] < enough))
    else:
        figures['error [% of length]'] = 100.0 * float(np.mean(found['error']))
    return {key: round(value, 2) for key, value in figures.items()}


def stream(robot: Robot, by_pulls: bool) -> dict[str, float]:
    """Follow a line from a tip straight out of reach and back, as the controller does."""
    model = Model(robot)
    low, high = model.limits.T
    start = low + 0.1 * (high - low) * np.linspace(0.3, 1.0, len(low))
    here = model.reach(model.shape(start).tip_position, by_pulls=by_pulls).shape
    out = here.tip_position / np.linalg.norm(here.tip_position) * STREAM_OUT * robot.length
    begin, shares, steps = here.tip_position, [], []
    half = np.linspace(0.0, 1.0, STREAM_STEPS)
    for share in (*half, *half[::-1]):
        before = here.inputs
        place = begin + share * out
        task = replace(TipTask.at(model, place), guess=here, by_pulls=by_pulls)
        here = reach(task, replace(STREAM, starts=COLD.starts)).shape
        steps.append(np.abs((here.inputs - before) / (high - low)).max())
        shares.append(((here.inputs - low) / (high - low)).max())
    back = float(np.linalg.norm(here.tip_position - begin)) / robot.length
    return {
        'largest tension [% of range]': round(100.0 * max(shares), 2),
        'largest step of a tension [% of range]': round(100.0 * max(steps), 2),
        'error at its end [% of length]': round(100.0 * back, 4),
    }


def main() -> int:
    """Measure all of it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--targets', type=int, default=40, help='of each kind; default 40')
    parser.add_argument('--only', default='', help='cases whose name holds this text')
    parser.add_argument('--json', type=Path)
    options = parser.parse_args()
    figures: dict[str, dict[str, dict[str, float]]] = {}
    for name, robot, by_pulls in cases():
        if options.only not in name:
            continue
        figures[name] = {
            kind: told(searched(robot, by_pulls, kind, options.targets), robot, kind)
            for kind in ('within', 'beside', 'beyond')
        }
        figures[name]['stream'] = stream(robot, by_pulls)
        print(name, figures[name], file=sys.stderr, flush=True)
    tell({'machine': machine(), 'figures': figures}, options.json)
    return 0


if __name__ == '__main__':
    sys.exit(main())
