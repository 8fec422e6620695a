"""
Mistakes that everybody makes, on two arms as they are built: what `diagnose` says.

With `--hidden` the arms lack effects as well, with `--frames found` the tracker's frame was laid
onto the model as it is described. Right is the sentence that names the mistake; a wrong story is
an effect that is named, or another mistake. `no mistake` is right where what is hidden is said.
Plants are of another discretisation than the model (studies/cases.py).
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
from machine import machine
from planned import PLANS

from tendon_robot_ros.data import DataSet
from tendon_robot_ros.diagnosis.diagnose import diagnose
from tendon_robot_ros.diagnosis.setup_hypotheses import in_frame
from tendon_robot_ros.effects import load_catalogue
from tendon_robot_ros.inference.predict import Predictor
from tendon_robot_ros.robot.estimates import natural_sizes
from tendon_robot_ros.studies.cases import Case
from tendon_robot_ros.studies.judge import NAMING
from tendon_robot_ros.studies.plan import read_plan

Make = Callable[[DataSet], DataSet]


@dataclass(frozen=True)
class Outcome:
    """What was said of one mistake on one arm."""

    robot: str
    mistake: str
    hidden: str
    frame: str
    said: str
    right: bool
    wrong_story: bool
    seconds: float  # of the processor


def moved(dataset: DataSet, turn: np.ndarray, shift: tuple[float, float, float]) -> DataSet:
    """Return the data set in another frame of the tracker."""
    return replace(dataset, positions=dataset.positions @ turn.T + np.array(shift))


def about(axis: str, degrees: float) -> np.ndarray:
    """Return a rotation (3, 3) about x, y or z."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    i, j = {'x': (1, 2), 'y': (2, 0), 'z': (0, 1)}[axis]
    turn = np.eye(3)
    turn[[i, i, j, j], [i, j, i, j]] = c, -s, s, c
    return turn


def sections_of(dataset: DataSet, **changes) -> DataSet:
    """Return the data set with another last section in its description."""
    robot = dataset.robot
    section = robot.sections[-1]
    cells = changes.get('cells', section.cells)
    filled = {
        key: (getattr(section, key) + (getattr(section, key)[-1],) * 3)[:cells]
        for key in ('bending_stiffness', 'mass_profile')
    }
    other = replace(robot, sections=(*robot.sections[:-1], replace(section, **filled, **changes)))
    share = other.length / robot.length
    markers = tuple(replace(m, arc_length=m.arc_length * share) for m in dataset.markers)
    return replace(dataset, robot=other, markers=markers)


def slipped(dataset: DataSet) -> DataSet:
    """Return the data set with one trial of another posture."""
    positions = dataset.positions.copy()
    positions[5, 2] = dataset.positions[6, 0]
    return replace(dataset, positions=positions)


def frozen(dataset: DataSet) -> DataSet:
    """Return the data set with a marker that stands still."""
    positions = dataset.positions.copy()
    positions[:, :, -3] = positions[0, 0, -3]
    return replace(dataset, positions=positions)


def exchanged(dataset: DataSet) -> DataSet:
    """Return the data set with two markers taken for each other."""
    order = np.arange(len(dataset.markers))
    order[[4, 12]] = order[[12, 4]]
    return replace(dataset, positions=dataset.positions[:, :, order])


def exchanged_midway(dataset: DataSet) -> DataSet:
    """Return the data set with two markers taken for each other in the second half of it."""
    positions, half = dataset.positions.copy(), len(dataset.postures) // 2
    positions[half:, :, [4, 6]] = positions[half:, :, [6, 4]]
    return replace(dataset, positions=positions)


def misplaced(dataset: DataSet) -> DataSet:
    """Return the data set whose last marker is said to sit 5 % of the arm below the tip."""
    last = dataset.markers[-1]
    low = replace(last, arc_length=last.arc_length - 0.05 * dataset.robot.length)
    return replace(dataset, markers=(*dataset.markers[:-1], low))


def dead(dataset: DataSet) -> DataSet:
    """Return the data set of an arm whose second load cell tells nothing."""
    inputs = dataset.inputs.copy()
    inputs[:, 1] = 0.05 * inputs.max()
    return replace(dataset, inputs=inputs, trial_inputs=None)


def loose(dataset: DataSet) -> DataSet:
    """Return the data set of an arm whose first wire came off: its commands go on."""
    inputs = dataset.inputs.copy()
    inputs[:, 0] = np.roll(inputs[:, 0], 5) + 0.3 * inputs[:, 0].max()
    return replace(dataset, inputs=np.where(dataset.inputs[:, :1] > 0.0, dataset.inputs, inputs))


def hung(dataset: DataSet, vector: tuple[float, float, float]) -> DataSet:
    """Return the data set with another gravity."""
    return replace(dataset, gravity=vector, robot=replace(dataset.robot, gravity=vector))


def short(dataset: DataSet) -> DataSet:
    """Return the data set without the markers of the last third."""
    seen = dataset.arc_lengths < 0.67 * dataset.robot.length
    markers = tuple(m for m, kept in zip(dataset.markers, seen, strict=True) if kept)
    return replace(dataset, positions=dataset.positions[:, :, seen], markers=markers)


def shifted(dataset: DataSet, cells: float) -> DataSet:
    """Return the data set whose markers are said to sit nearer to the tip than they do."""
    way = cells * dataset.robot.sections[0].cell_length
    length = dataset.robot.length
    kept = [j for j, m in enumerate(dataset.markers) if 0.0 <= m.arc_length + way <= length]
    markers = tuple(
        replace(dataset.markers[j], arc_length=dataset.markers[j].arc_length + way) for j in kept
    )
    return replace(dataset, positions=dataset.positions[:, :, kept], markers=markers)


# What is done to a right data set, and what must be said: a mistake's name or a word of the text
MISTAKES: dict[str, tuple[Make, tuple[str, ...]]] = {
    'no mistake': (lambda d: d, ()),
    'two markers exchanged half way': (exchanged_midway, ('markers_exchanged',)),
    'the tip marker lower than it is': (misplaced, ('markers_elsewhere',)),
    'a dead load cell': (dead, ('input_dead',)),
    'gravity of 1 m/s²': (lambda d: hung(d, (1.0, 0.0, 0.0)), ('gravity',)),
    'two inputs swapped': (
        lambda d: replace(d, inputs=d.inputs[:, [1, 0, *range(2, d.inputs.shape[1])]]),
        ('inputs_swapped', 'axes'),
    ),
    'inputs in another order': (
        lambda d: replace(d, inputs=np.roll(d.inputs, 1, axis=1)),
        ('inputs_swapped', 'axes', 'registration'),
    ),
    'x flipped': (
        lambda d: moved(d, np.diag([-1.0, 1.0, 1.0]), (0, 0, 0)),
        ('axes', 'inputs_swapped'),
    ),
    'y and z swapped': (lambda d: replace(d, positions=d.positions[..., [0, 2, 1]]), ('axes',)),
    'frame turned by 90° about z': (
        lambda d: moved(d, about('z', 90.0), (0, 0, 0)),
        ('axes', 'registration', 'inputs_swapped'),
    ),
    'frame turned by 30°, 20 mm off': (
        lambda d: moved(d, about('y', 30.0), (0.02, 0.0, 0.01)),
        ('registration',),
    ),
    'markers numbered from the tip': (
        lambda d: replace(d, positions=d.positions[:, :, ::-1]),
        ('markers_from_the_tip',),
    ),
    'two markers exchanged': (exchanged, ('markers_exchanged',)),
    'a frozen marker': (frozen, ('frozen_marker',)),
    'inputs in kilograms': (lambda d: replace(d, inputs=d.inputs / 9.81), ('unit_of_inputs',)),
    'inputs in millinewtons': (
        lambda d: replace(d, inputs=d.inputs * 1e3),
        ('unit_of_inputs', 'divided by 1000'),
    ),
    'a decimal point in the stiffness': (
        lambda d: sections_stiffness(d, 0.1),
        ('unit_of_inputs',),
    ),
    'diameter for radius': (lambda d: offsets_of(d, 2.0), ('unit_of_inputs', 'moment_arm')),
    'positions in millimetres': (
        lambda d: replace(d, positions=1e3 * d.positions),
        ('unit_of_positions',),
    ),
    'a cell too few': (
        lambda d: sections_of(d, cells=d.robot.sections[-1].cells - 1),
        ('cells', 'markers_elsewhere'),
    ),
    'markers a cell further than said': (
        lambda d: shifted(d, -1.0),
        ('markers_elsewhere', 'registration'),
    ),
    'gravity upside down': (lambda d: hung(d, (-9.81, 0.0, 0.0)), ('gravity',)),
    'gravity along another axis': (lambda d: hung(d, (0.0, 0.0, -9.81)), ('gravity',)),
    'rows of inputs moved by one': (
        lambda d: replace(d, inputs=np.roll(d.inputs, 1, axis=0)),
        ('rows_moved',),
    ),
    'one slipped trial': (slipped, ('trials contradict',)),
    'two postures': (lambda d: d.select(d.postures[:2]), ('measured posture',)),
    'markers short of the tip': (short, ('markers end at',)),
}
WEIGHED = ('gravity upside down', 'gravity along another axis', 'gravity of 1 m/s²')
# what a frame that is laid onto the model takes up: nothing is wrong then
OF_THE_FRAME = ('frame turned by 90° about z', 'frame turned by 30°, 20 mm off')


def sections_stiffness(dataset: DataSet, factor: float) -> DataSet:
    """Return the data set with a description of another stiffness."""
    sections = tuple(
        replace(s, bending_stiffness=tuple(factor * k for k in s.bending_stiffness))
        for s in dataset.robot.sections
    )
    return replace(dataset, robot=replace(dataset.robot, sections=sections))


def offsets_of(dataset: DataSet, factor: float) -> DataSet:
    """Return the data set with tendons described further from the centre."""
    tendons = tuple(
        replace(
            t,
            base=(factor * t.base[0], factor * t.base[1]),
            end=(factor * t.end[0], factor * t.end[1]),
        )
        for t in dataset.robot.tendons
    )
    return replace(dataset, robot=replace(dataset.robot, tendons=tendons))


def arm(name: str, weighed: bool, level: float, seed: int, hidden: str) -> DataSet:
    """Return measurements of an arm that lacks an effect, or none; with its weight described."""
    setup = read_plan(PLANS / 'diagnosis.yaml').setup
    planned, catalogue = setup.arm(name), load_catalogue()
    if weighed:
        heavy = catalogue['gravity'].sized(natural_sizes(planned.robot)).parameters[0]
        robot = planned.robot.with_effect('gravity', {heavy.name: 3.0 * heavy.typical})
        planned = replace(planned, robot=replace(robot, gravity=planned.down))
    case = Case(name, hidden, 1.0, seed, level=level)
    return replace(setup, arms=(planned,), seed=0).simulated(case).fit


def laid_onto_the_model(dataset: DataSet) -> DataSet:
    """Return the data set in the frame in which the model as described suits it best."""
    level = bool(np.any(dataset.gravity_for(dataset.robot)))
    tolerances = {'rotation': 0.035 if level else 0.06, 'position': 5e-3}
    robot = replace(dataset.robot, tolerances=tolerances)
    found = Predictor(dataset, robot, load_catalogue())
    markers = found.markers({})
    return dataset if markers is None else in_frame(found, replace(dataset, robot=robot), markers)


def judge(robot: str, name: str, hidden: str, frame: str, level: float, seed: int) -> Outcome:
    """Make a mistake and hold what is said against it."""
    from tendon_robot_ros.report.diagnosis_text import lines

    dataset = MISTAKES[name][0](arm(robot, name in WEIGHED, level, seed, hidden))
    if frame == 'found':
        dataset = laid_onto_the_model(dataset)
    start = time.process_time()
    found = diagnose(dataset)
    seconds = time.process_time() - start
    mistake = found.details.get('mistake', {}).get('name', '')
    text = ' '.join(lines(found))
    words, effects = MISTAKES[name][1], [effect.name for effect in found.effects]
    if not words or (frame == 'found' and name in OF_THE_FRAME):
        right_one = not mistake and (hidden in [*effects, *found.cannot_tell_apart] or (
            hidden == 'none' and found.verdict not in NAMING))  # fmt: skip
    else:
        right_one = any(word == mistake or (' ' in word and word in text) for word in words)
    wrong = not right_one and (bool(mistake) or found.verdict in NAMING)
    said = mistake or f'{found.verdict} {" ".join(effects)}'.strip()
    return Outcome(robot, name, hidden, frame, said, right_one, wrong, seconds)


def main() -> int:
    """Try all of them on both arms."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--level', type=float, default=1.0)
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--robots', nargs='*', default=['hinged', 'arcs'])
    parser.add_argument('--mistakes', nargs='*', default=list(MISTAKES))
    parser.add_argument('--hidden', nargs='*', default=['none'])
    parser.add_argument('--frames', nargs='*', default=['known'], choices=['known', 'found'])
    parser.add_argument('--json', type=Path)
    options = parser.parse_args()
    outcomes = []
    print(f'{"":34s} {"arm":7s} {"hidden":20s} {"frame":6s} {"said":26s} {"right":6s} {"CPU":>6s}')
    for case in product(options.mistakes, options.robots, options.hidden, options.frames):
        name, robot, hidden, frame = case
        one = judge(robot, name, hidden, frame, options.level, options.seed)
        outcomes.append(one)
        mark = 'right' if one.right else 'WRONG' if one.wrong_story else 'unsaid'
        print(
            f'{name:34s} {robot:7s} {hidden:20s} {frame:6s} {one.said:26s} {mark:6s} '
            f'{one.seconds:5.1f}s',
            flush=True,
        )
    for robot, frame in product(options.robots, options.frames):
        own = [o for o in outcomes if (o.robot, o.frame) == (robot, frame)]
        print(
            f'{robot}, frame {frame}: {sum(o.right for o in own)} of {len(own)} right, '
            f'{sum(o.wrong_story for o in own)} wrong stories, '
            f'longest {max(o.seconds for o in own):.1f} s'
        )
    if options.json:
        rows = [asdict(o) for o in outcomes]
        options.json.write_text(json.dumps({'machine': machine(), 'outcomes': rows}, indent=1))
    return 0


if __name__ == '__main__':
    sys.exit(main())
