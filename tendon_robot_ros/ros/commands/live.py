"""
A mock robot hides something; compare, record, diagnose, add, and watch the error fall.

Opens a page: two arms in two colours do not coincide; find out why by clicking.

example: python -m tendon_robot_ros live --headless --hidden hinge_friction
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import sys
import tempfile
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from geometry_msgs.msg import Vector3Stamped

from ...common.arrays import Floats
from ...common.errors import MissingExtraError, NoEquilibriumError, TendonRobotError
from ...common.words import mm
from ...control.loading import load
from ...effects import load_catalogue
from ...inference.statistics import rms
from ...model.compile import say_where_it_compiles
from ...model.model import Model
from ...robot import Robot, dump_robot
from ...robot.keep_out import KeepOut
from ...simulation.hidden import STIFFNESS_SCATTER
from ...simulation.rehearsal import Hidden, Story, add_story, cast, reveal, tour
from ..shared import interface
from ..shared.messages import seconds, time_now, xyz
from ..shared.robot_client import MESSAGES_MAX, TIP_AVERAGE_S, Pilot
from ..shared.runtime import Ending, NodeProcess, ros
from ..shared.timing import MOVE_TIMEOUT_S, REACTION_TIMEOUT_S, WORK_TIMEOUT_S
from . import investigate as investigation

HELP = 'a mock robot that hides something: watch, diagnose, add, see the error fall'
LOG = 'nodes.log'
INVESTIGATION = ('--add', '--speed', '2', '--output')  # how the mock is investigated, and where
# [1] tip errors in a mean, so that the noise of a tracker falls to a quarter: 0.5 s at
# 30 Hz
MESSAGES_MIN = 15
STARTING_CODES = (None, 'loading', 'compiling', 'building', 'not_ready')


def nodes_of(
    options: argparse.Namespace, robot: Robot, hidden: Hidden, seed: int, folder: Path
) -> Iterator[tuple[str, dict[str, object], list[str]]]:
    """Yield the commands of the nodes, with their parameters and arguments; files in a folder."""
    described = folder / 'paper.yaml'
    described.write_text(dump_robot(robot), encoding='utf-8')
    config = {
        'plant': {'hidden': hidden.plant, 'scatter': STIFFNESS_SCATTER, 'seed': seed},
        'lag': 0.02,
        'tension_noise': 0.002,
        'pull_noise': 2e-5,
        'seed': seed,
        'tracker': {'rate': 30.0, 'noise': 2e-4, 'seed': seed + 1},
    }
    plain = yaml.safe_dump(json.loads(json.dumps(config)))  # lists in place of tuples
    # [Hz] so that a busy machine has time for the other nodes
    rate = {'rate': 100.0} if options.headless else {}
    watched = {'path': 'from_straight', 'force_rate': 5.0, 'reference_postures': 20.0}
    yield 'driver', {'robot': str(described), 'config': plain, **rate}, []
    yield 'controller', {'model': str(described), **rate}, []
    yield 'monitor', {'folder': str(folder / 'recordings'), **watched}, []
    if not options.headless:
        yield 'viewer', {'port': options.port}, []
        yield 'investigate', {}, ['--wait', *INVESTIGATION, str(folder / 'found')]


def play(
    director: Director, model: Model, story: Story, options: argparse.Namespace, folder: Path
) -> int:
    """Serve the page until a signal comes, or run as text; return the exit code."""
    director.wait_until_up()
    if not options.headless:
        print(f'open http://127.0.0.1:{options.port}   (Ctrl-C ends)', flush=True)
        if options.investigate:
            print(director.triggered('investigate/start'), flush=True)
        while True:  # the postures for ever, while the page has the tour switched on
            for stop in tour(model, options.postures, 0):
                director.wait(lambda: director.touring, float('inf'), 'the tour')
                director.go(*stop)
    if options.investigate:
        investigate(director, story, folder)
    else:
        play_as_text(director, model, story, options.postures)
    print(story.end())
    return 1 if story.problem else 0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add_story(parser)


def run(options: argparse.Namespace, ros_arguments: Sequence[str]) -> int:
    """Run the page, or the story as text."""
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    if not options.headless and importlib.util.find_spec('viser') is None:
        raise MissingExtraError('viser', 'viewer')
    catalogue = load_catalogue()
    say_where_it_compiles(catalogue)
    robot, hidden, seed = cast(options, catalogue)
    model = load(robot, catalogue)
    with ros(ros_arguments) as ending, ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix='tendon_live_')))
        if not options.headless:
            folder = Path('live') / time.strftime('%Y-%m-%d_%H-%M-%S')
        folder.mkdir(parents=True, exist_ok=True)
        director = stack.enter_context(Director(f'/live_{os.getpid()}', ending))
        log = stack.enter_context((folder / LOG).open('w', encoding='utf-8'))
        for name, values, own in nodes_of(options, robot, hidden, seed, folder.resolve()):
            process = NodeProcess(name, values, director.get_namespace(), log, own)
            director.nodes.append(stack.enter_context(process))
        try:
            code = play(director, model, Story(hidden), options, folder)
        except KeyboardInterrupt:
            code = 0
        except TendonRobotError as error:
            text = (folder / LOG).read_text(encoding='utf-8', errors='replace')
            last_lines = text.strip().splitlines()[-12:]  # of the nodes: why they failed
            print('error:', error, *last_lines, sep='\n  ', file=sys.stderr)
            code = 1
        if options.reveal:
            print(reveal(hidden, catalogue))
    return code


class Director(Pilot):
    """A client of controller, driver and monitor."""

    def __init__(self, namespace: str, ending: Ending) -> None:
        """Create the subscriptions."""
        super().__init__('tour', ending, namespace=namespace, watched=('monitor',))
        self.progress, self.verdict = '', dict[str, Any]()
        self.touring = True  # switched by the page
        self._standing_since = np.inf  # [s] by the stamps of messages
        self.nodes: list[NodeProcess] = []  # started for this run
        # (3,) [m] of the tip, with their stamps [s]
        self._errors: deque[tuple[float, Floats]] = deque(maxlen=MESSAGES_MAX)

        def keep(name: str, read: Callable[[Any], Any]) -> Callable[[Any], None]:
            return lambda message: setattr(self, name, read(message.data))

        def error(message: Vector3Stamped) -> None:
            self._errors.append((seconds(message.header.stamp), np.array(xyz(message.vector))))

        interface.subscribe(self, 'monitor/error', error, 'monitor')
        progress, verdict = keep('progress', str), keep('verdict', json.loads)
        interface.subscribe(self, 'monitor/progress', progress, 'monitor', interface.STATE)
        interface.subscribe(self, 'monitor/verdict', verdict, 'monitor')
        interface.subscribe(self, 'tour', keep('touring', bool))

    def wait_until_up(self) -> None:
        """Wait until all nodes work; TendonRobotError: one has ended."""

        def up() -> bool:
            for node in self.nodes:
                if (code := node.process.poll()) is not None:
                    raise TendonRobotError(f'the {node.name} has ended with code {code}')
            starting = self.status.get('code') in STARTING_CODES
            compares = self.statuses['monitor'].get('code') == 'comparing'
            ready = self.has_listener and self.base and self._errors
            return not starting and compares and bool(ready)

        self.wait(up, WORK_TIMEOUT_S, 'controller, driver and monitor to start')

    def go(self, position: Floats, direction: Floats | None) -> bool:
        """
        Send a target (3,) [m], (3,) and wait until the arm was measured at rest there.

        Returns
        -------
        bool
            Whether it was; `tip`, `error` and `commands` are then of this posture.

        """
        self.clear()
        self._standing_since, stamp = np.inf, self.send(position, direction)

        def standing() -> bool:
            soon = time_now(self) + TIP_AVERAGE_S
            settled = self.settled(stamp)
            self._standing_since = min(self._standing_since, soon) if settled else np.inf
            return len(self._standing()) >= MESSAGES_MIN or not self.touring

        at_rest = self.wait(standing, REACTION_TIMEOUT_S, 'the arm to stand', strict=False)
        return at_rest and self.touring

    def record(self, position: Floats, direction: Floats | None) -> bool:
        """Go to a posture and wait until the monitor has recorded it; return whether it did."""
        before, what = self.recorded, 'a recording'
        return self.go(position, direction) and self.wait(
            lambda: self.recorded > before, REACTION_TIMEOUT_S, what, strict=False
        )

    @property
    def recorded(self) -> int:
        """Number of postures that the monitor has recorded."""
        return int(self.statuses['monitor'].get('postures', '0'))

    def takes(self, effects: Sequence[str]) -> bool:
        """Wait until controller and monitor have these effects in their model, if they ever do."""

        def uses() -> bool:
            models = [values.get('model', '') for values in self.statuses.values()]
            return all(name in model for name in effects for model in models)

        return self.wait(uses, MOVE_TIMEOUT_S, 'the reload', strict=False)

    def error(self) -> Floats:
        """Return the mean tip error (3,) [m] since the arm is at rest; nan: there is none."""
        return np.array(np.mean(self._standing() or [np.full(3, np.nan)], axis=0))

    def _standing(self) -> list[Floats]:
        """Return the finite tip errors since the arm is at rest, by their stamps."""
        since = self._standing_since
        return [error for at, error in self._errors if at > since and np.isfinite(error).all()]


def play_as_text(director: Director, model: Model, story: Story, postures: int) -> None:
    """Record, diagnose, add, measure again; fill in the story and print progress."""
    robot = model.robot
    print(
        f'robot {robot.name}: {robot.cells} cells, {len(robot.tendons)} tendons   model: '
        f'{", ".join(robot.effects)}'
    )
    print(director.triggered('monitor/record'))
    errors = [director.error() for stop in tour(model, postures, 0) if director.record(*stop)]
    worst = mm(max(map(np.linalg.norm, errors), default=np.nan))
    shown = f'{mm(rms(np.array(errors)))} rms, {worst} at worst' if errors else 'unknown'
    print(f'{director.recorded} postures recorded   tip error {shown}')
    print(director.triggered('monitor/diagnose'), flush=True)
    director.wait(lambda: director.verdict, WORK_TIMEOUT_S, 'the verdict')
    story.verdict = director.verdict
    print(story.verdict['sentence'])
    print(story.verdict['remainder'])
    if not story.verdict['may_add']:
        return
    # add what was found, and go to postures that were never used
    director.triggered('monitor/add')
    director.wait(
        lambda: director.statuses['monitor'].get('added') == '1', WORK_TIMEOUT_S, 'the adding'
    )
    story.added = director.takes([effect['name'] for effect in story.verdict['effects']])
    print(f'{director.progress}\ncontroller: {director.status.get("model")}')
    before, after = [], []
    for stop in tour(model, postures // 2, 1):
        if not director.go(*stop):
            continue
        try:  # where the description before the addition has the tip
            old = model.shape(director.commands()[1][-1]).tip_position
        except NoEquilibriumError:
            old = np.full(3, np.nan)
        before.append(director.tip()[0] - old)
        after.append(director.error())
    if after:
        story.before, story.after = rms(np.array(before)), rms(np.array(after))


def investigate(director: Director, story: Story, folder: Path) -> None:
    """Run an investigation; fill in the story."""
    parser = argparse.ArgumentParser()
    investigation.add_arguments(parser)
    args = parser.parse_args([*INVESTIGATION, str(folder / 'found')])
    with investigation.RunningArm(args, director.ending, director.get_namespace()) as arm:
        found = investigation.Investigator(arm, args, KeepOut()).once(Path(args.output), False)
    story.verdict = {} if found.diagnosis is None else found.diagnosis.to_json()
    if found.addition is not None and found.diagnosis is not None:
        story.added = director.takes([effect.name for effect in found.diagnosis.effects])
        story.before, story.after = found.addition.check.before, found.addition.check.after
