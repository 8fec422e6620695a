"""
A simulated robot hides something and is investigated, posture by posture, as `investigate` does.

It says what an investigation of a robot like ROBOT will take, before the real one moves: how many
postures, what can be told apart, how narrow the intervals get. The robot that is measured has the
hidden effects and the ordinary imperfections of a robot as it is built (as with `simulate`).
DIR gets the data set, a recording, the diagnosis, the report and, when one effect is found, the
better description. Interrupted, it goes on with --resume.

Exit code: 0 a result; 1 an error.

example: python -m tendon_robot_ros rehearse config/robots/kato_10_1.yaml --output found
    --hidden hinge_friction
"""

from __future__ import annotations

import argparse
from pathlib import Path

from ..data.dataset import INPUTS, LOADINGS
from ..effects import load_catalogue
from ..investigation.goal import add_goal, goal_of
from ..investigation.loop import Investigation
from ..investigation.results import add_folder, write_results
from ..investigation.simulated_arm import SimulatedArm
from ..robot import load_robot
from ..robot.keep_out import KeepOut, load_keep_out
from ..simulation.hidden import Workmanship
from ..simulation.plant import make_plant
from .options import add_effect_files
from .simulate import hidden_effect, simulated_noise

HELP = 'investigate a simulated robot that hides something, as the real one will be'
TRIALS = 3


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add = parser.add_argument
    add('robot', metavar='ROBOT', help='robot description, as its owner believes it')
    add('--hidden', nargs='+', action='extend', default=[], metavar='EFFECT[:NAME=VALUE,...]')
    add('--level', type=float, default=1.0, metavar='X', help='how badly it is built (default: 1)')
    add('--seed', type=int, default=0, help='another seed: another robot, other noise')
    add('--noise', default='', metavar='NAME=VALUE,...', help='as of simulate')
    add('--input', choices=INPUTS, default='tension', help='what the motors set')
    add('--path', choices=LOADINGS, default='from_straight', help='how postures are reached')
    add('--lost', type=float, default=0.0, metavar='SHARE', help='of measurements that break')
    add_goal(parser, TRIALS)
    add_folder(parser)
    add_effect_files(parser)


def run(args: argparse.Namespace) -> int:
    """Investigate, write, print."""
    robot, catalogue = load_robot(args.robot), load_catalogue(args.effect_file)
    goal = goal_of(args, tuple(args.effect_file))
    regions = load_keep_out(args.keep_out) if args.keep_out else KeepOut()
    hidden = dict(map(hidden_effect, args.hidden))
    work = Workmanship().times(args.level)
    plant = make_plant(robot, hidden, seed=args.seed, catalogue=catalogue, work=work)
    arm = SimulatedArm(
        plant, simulated_noise(args.noise), args.seed, args.input, args.path, args.lost
    )
    folder = Path(args.output)
    print(f'hidden:  {", ".join(args.hidden) or "nothing"}')
    investigation = Investigation(
        arm, goal, folder, regions, lambda news: print(news.text, flush=True), args.resume
    )
    findings = investigation.run()
    print(*write_results(findings, folder, investigation.catalogue, goal.add), sep='\n')
    return 0
