"""`live --headless` without ROS: the mock arm is measured directly, no node commands it."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from ..common.errors import MissingExtraError
from ..diagnosis.add import add_effect
from ..diagnosis.diagnose import diagnose
from ..effects import load_catalogue
from ..simulation.measurements import simulate
from ..simulation.plant import make_plant
from ..simulation.rehearsal import Story, add_story, cast, reveal
from ..workspace.postures import default_postures
from .options import progress


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add_story(parser)


def run(args: argparse.Namespace, ros_arguments: Sequence[str]) -> int:
    """Measure, diagnose, add, and judge on postures that were never used."""
    if not args.headless or args.investigate:  # a page and a chosen posture need the nodes
        raise MissingExtraError('rclpy', 'ros')
    catalogue = load_catalogue()
    robot, hidden, seed = cast(args, catalogue)
    print('no ROS: the mock arm is measured directly, without driver, controller and monitor')
    plant = make_plant(robot, hidden.plant, seed=seed)
    with progress() as show:
        fit, check = (
            simulate(plant, default_postures(robot, count, which), seed=2 * seed + which)
            for which, count in enumerate((args.postures, args.postures // 2))
        )
        diagnosis = diagnose(fit, None, catalogue, progress=show)
    story = Story(hidden, diagnosis.to_json())
    print(diagnosis.text())
    if diagnosis.adds:
        addition = add_effect(fit, diagnosis.effects, None, catalogue, check)
        story.added = addition.helps
        story.before, story.after = addition.check.before, addition.check.after
    print(story.end())
    if args.reveal:
        print(reveal(hidden, catalogue))
    return 1 if story.problem else 0
