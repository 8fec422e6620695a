"""
A mock robot hides something; compare, record, diagnose, add, and watch the error fall.

Opens a page: two arms in two colours do not coincide; find out why by clicking. Options:

  --hidden NAME   hide this: an effect, a cause outside the catalogue, or none (default: drawn)
  --seed N        draws what is hidden, how large it is, and the noise (default: from the clock)
  --reveal        say at the end what was hidden
  --headless      no page: the same story as text; exits with 0 only if it came true
  --postures N    of the tour that is recorded (default: 14)
  --investigate   the arm chooses its postures by itself, until it knows (docs/investigate.md)
  --port N        of the page (default: 8080)
  --robot NAME    in config/robots (default: kato_10_1)
"""

from __future__ import annotations

import argparse
import os
import shlex
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...common.errors import InputError, MissingExtraError, NoEquilibriumError, TendonRobotError
from ...common.words import mm
from ...control.loading import load
from ...effects import Catalogue, load_catalogue
from ...model.model import Model
from ...robot import Robot, dump_robot, load_robot
from ...robot.keep_out import KeepOut
from ...simulation.rehearsal import STIFFNESS_SCATTER, Hidden, Story, draw, refined, reveal, tour
from ..shared.running_arm import RunningArm
from ..shared.runtime import NodeProcess, ros
from . import investigate as investigation
from .director import Director

HELP = 'a mock robot that hides something: watch, diagnose, add, see the error fall'
LOG = 'nodes.log'
WATCHED: dict[str, object] = {
    'path': 'from_straight',
    'force_rate': 5.0,
    'reference_postures': 20.0,
}
INVESTIGATION = ('--add', '--speed', '2', '--output')  # how the mock is investigated, and where
HEADLESS_RATE_HZ = 100.0  # of controller and driver, where nobody looks
TRACKER_NOISE_M = 0.0002  # [m] 1 sd of the mock's tracker


def main(arguments: Sequence[str]) -> int:
    """Run the page, or the story as text."""
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    own, ros_arguments = _split(arguments)
    options = _options(own)
    if not options.headless:
        _require_viser()
    catalogue = load_catalogue()
    robot = refined(load_robot(options.robot))
    seed = int(time.time()) % 100000 if options.seed is None else options.seed
    print('loading the model (the first time it is compiled: a minute)', file=sys.stderr)
    model = load(robot, catalogue)
    hidden = draw(robot, catalogue, options.hidden, seed)
    with ros(ros_arguments) as ending, ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix='tendon_live_')))
        if not options.headless:
            folder = Path('live') / time.strftime('%Y-%m-%d_%H-%M-%S')
        folder.mkdir(parents=True, exist_ok=True)
        space = f'/live_{os.getpid()}'
        director = Director(space, f'{robot.name}_base', ending)
        stack.callback(director.destroy_node)
        _start(stack, director, space, folder, robot, hidden, seed, options)
        try:
            code = _run(director, model, options, Story(hidden), folder)
        except KeyboardInterrupt:
            code = 0
        except TendonRobotError as error:
            print('error:', error, *_last_words(folder), sep='\n  ', file=sys.stderr)
            code = 1
        if options.reveal:
            print(reveal(hidden, _units(catalogue, hidden)))
    return code


def _last_words(folder: Path) -> list[str]:
    """Return what the nodes said last, for a person to see why they do not work."""
    text = (folder / LOG).read_text(encoding='utf-8', errors='replace')
    return text.strip().splitlines()[-12:]


def _run(
    director: Director, model: Model, options: argparse.Namespace, story: Story, folder: Path
) -> int:
    if not options.headless:
        director.wait_until_up()
        print(f'open http://127.0.0.1:{options.port}   (Ctrl-C ends)', flush=True)
        director.print_investigation()
        if options.investigate:
            print(director.triggered('investigate/start'), flush=True)
        tour_forever(director, model, options.postures)
        return 0
    if options.investigate:
        investigate(director, story, folder)
    else:
        play(director, model, story, options.postures)
    print(story.end())
    return 1 if story.problem else 0


def _start(
    stack: ExitStack,
    director: Director,
    space: str,
    folder: Path,
    robot: Robot,
    hidden: Hidden,
    seed: int,
    options: argparse.Namespace,
) -> None:
    """Start the nodes; the stack ends them in the opposite order."""
    described = folder / 'paper.yaml'
    described.write_text(dump_robot(robot), encoding='utf-8')
    model = str(described.resolve())
    log = stack.enter_context((folder / LOG).open('w', encoding='utf-8'))
    rehearsed = {'hidden': hidden.plant, 'scatter': STIFFNESS_SCATTER, 'seed': seed}
    config = {
        'plant': rehearsed,
        'lag': 0.02,
        'tension_noise': 0.002,
        'pull_noise': 2e-5,
        'seed': seed,
        'tracker': {'rate': 30.0, 'noise': TRACKER_NOISE_M, 'seed': seed + 1},
    }
    rate = {'rate': HEADLESS_RATE_HZ} if options.headless else {}
    nodes: list[tuple[str, dict[str, object]]] = [
        ('driver', {'robot': model, 'config': _yaml(config), **rate}),
        ('controller', {'model': model, **rate}),
        ('monitor', {'folder': str(folder.resolve() / 'recordings'), **WATCHED}),
    ]
    if not options.headless:
        nodes.append(('viewer', {'port': options.port}))
    own = {'investigate': ['--wait', *INVESTIGATION, str(folder.resolve() / 'found')]}
    if not options.headless:
        nodes.append(('investigate', {}))
    for name, parameters in nodes:
        process = NodeProcess(name, parameters, space, log, own=own.get(name, ()))
        director.nodes.append(stack.enter_context(process))


def _yaml(content: object) -> str:
    import yaml

    return yaml.safe_dump(_plain(content))


def _plain(content: object) -> object:
    if isinstance(content, dict):
        return {key: _plain(value) for key, value in content.items()}
    return list(content) if isinstance(content, tuple) else content


def _units(catalogue: Catalogue, hidden: Hidden) -> dict[str, str]:
    if not hidden.values:
        return {}
    return {p.name: p.unit for p in catalogue[hidden.name].parameters}


def _split(arguments: Sequence[str]) -> tuple[list[str], list[str]]:
    words = list(arguments)
    at = words.index('--ros-args') if '--ros-args' in words else len(words)
    return words[:at], words[at:]


def _options(arguments: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog='live', add_help=False, exit_on_error=False)
    parser.add_argument('--hidden', default='')
    parser.add_argument('--seed', type=int)
    parser.add_argument('--reveal', action='store_true')
    parser.add_argument('--headless', action='store_true')
    parser.add_argument('--investigate', action='store_true')
    parser.add_argument('--postures', type=int, default=14)
    parser.add_argument('--port', type=int, default=8080)
    parser.add_argument('--robot', default='kato_10_1')
    try:
        options, unknown = parser.parse_known_args(arguments)
    except argparse.ArgumentError as error:
        raise InputError(f'live: {error}; see live --help') from None
    if unknown:
        raise InputError(f'live: unknown argument {shlex.join(unknown)}; see live --help')
    if options.postures < 4:
        raise InputError(f'live: --postures: expected at least 4, got {options.postures}')
    return options


def _require_viser() -> None:
    import importlib.util

    if importlib.util.find_spec('viser') is None:
        raise MissingExtraError('viser', 'viewer')


# -----------------------------------------------------------------------------
# The story of `make live`, told in text, and the tour behind the page.

Array = NDArray[np.float64]
CHECK_POSTURES = 6  # postures that are not recorded
DIAGNOSIS_TIMEOUT_S = 600.0  # [s]


def play(director: Director, model: Model, story: Story, postures: int) -> None:
    """Record, diagnose, add, look again; fill in the story and print it as it happens."""
    director.wait_until_up()
    robot = model.robot
    print(
        f'robot {robot.name}: {robot.cells} cells, {len(robot.tendons)} tendons   model: '
        f'{", ".join(robot.effects)}'
    )
    print(director.triggered('monitor/record'))
    errors = []
    for stop in tour(model, postures, 0):
        if director.record(stop):
            errors.append(director.error())
    shown = f'{mm(_rms(errors))} rms, {mm(max(errors))} at worst' if errors else 'unknown'
    print(f'{director.recorded} postures recorded   tip error {shown}')
    print(director.triggered('monitor/diagnose'), flush=True)
    director.wait(lambda: director.verdict, DIAGNOSIS_TIMEOUT_S, 'the verdict')
    story.verdict = director.verdict
    print(story.verdict['sentence'])
    print(story.verdict['remainder'])
    if not story.verdict['may_add']:
        return
    _add_and_look(director, model, story)


def _add_and_look(director: Director, model: Model, story: Story) -> None:
    """Add what was found and go to postures that were never used."""
    director.triggered('monitor/add')
    director.wait(
        lambda: director.statuses['monitor'].get('added') == '1', DIAGNOSIS_TIMEOUT_S, 'the adding'
    )
    names = [effect['name'] for effect in story.verdict['effects']]
    story.added = director.wait(lambda: director.uses(names), 60.0, 'the reload', strict=False)
    print(f'{director.progress}\ncontroller: {director.status.get("model")}')
    before, after = [], []
    for stop in tour(model, CHECK_POSTURES, 1):
        if not director.go(stop):
            continue
        off = director.tip() - _old_tip(model, director.tensions())
        before.append(float(np.linalg.norm(off)))
        after.append(director.error())
    if after:
        story.before, story.after = _rms(before), _rms(after)


def investigate(director: Director, story: Story, folder: Path) -> None:
    """Let the arm find out by itself; fill in the story."""
    director.wait_until_up()
    parser = argparse.ArgumentParser()
    investigation.add_arguments(parser)
    args = parser.parse_args([*INVESTIGATION, str(folder / 'found')])
    arm = RunningArm('controller', 'monitor', director.ending, director.get_namespace())
    arm.speed = args.speed
    try:
        findings = investigation.Investigator(arm, args, KeepOut()).once(Path(args.output), False)
    finally:
        arm.destroy_node()
    story.verdict = {} if findings.diagnosis is None else findings.diagnosis.to_json()
    if findings.made is not None and findings.diagnosis is not None:
        names = [effect.name for effect in findings.diagnosis.effects]
        story.added = director.wait(lambda: director.uses(names), 60.0, 'the reload', strict=False)
        story.before, story.after = findings.made.check.before, findings.made.check.after


def tour_forever(director: Director, model: Model, postures: int) -> None:
    """Go through the postures again and again, while the page lets it."""
    while True:
        for stop in tour(model, postures, 0):
            director.wait(lambda: director.touring, float('inf'), 'the tour')
            director.go(stop)


def _old_tip(model: Model, tensions: Array) -> Array:
    """Return where the description before the addition has the tip [m]."""
    try:
        return model.shape(np.maximum(tensions, 0.0)).tip_position
    except NoEquilibriumError:
        return np.full(3, np.nan)


def _rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.nanmean(np.square(values))))
