"""
A simulated robot hides something and is investigated, posture by posture, as `investigate` does.

It says what an investigation of a robot like ROBOT will take, before the real one moves: how many
postures, what can be told apart, how narrow the intervals get. The robot that is measured has the
hidden effects and the ordinary imperfections of a robot as it is built (as with `simulate`).
DIR gets the data set, a recording, the diagnosis, the report and, when one effect is found, the
better description. Interrupted, it goes on with --resume.

Exit code: 0 a result; 1 an error.

example: python -m tendon_robot_ros study rehearse config/robots/kato_10_1.yaml --output found
    --hidden hinge_friction
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..cli.options import declare
from ..cli.simulate import hidden_effects, simulated_noise
from ..common.arrays import Floats
from ..common.errors import InputError, NoEquilibriumError, number
from ..common.results import emit, narrate
from ..data import Marker, default_markers
from ..data.dataset import INPUTS, LOADINGS
from ..effects import load_catalogue
from ..investigation.goal import Goal, add_goal, goal_of
from ..investigation.loop import Investigation
from ..investigation.measuring import BrokenMeasurementError, PostureMeasured
from ..report.diagnosis_text import TRIALS_ADVISED
from ..robot import Robot, load_robot
from ..robot.inputs import disturbed
from ..robot.keep_out import KeepOut, load_keep_out
from ..simulation.hidden import Workmanship
from ..simulation.measurements import SimulatedNoise
from ..simulation.plant import Plant, make_plant

HELP = 'investigate a simulated robot that hides something, as the real one will be'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add = parser.add_argument
    add('robot', metavar='ROBOT', help='robot description, as its owner believes it')
    add('--hidden', nargs='+', action='extend', default=[], metavar='EFFECT[:NAME=VALUE,...]')
    add('--level', type=float, default=1.0, metavar='X', help='how badly it is built (default: 1)')
    what = 'another seed: another robot, other noise'
    add('--seed', type=int, default=0, metavar='N', help=what)
    add('--noise', default='', metavar='NAME=VALUE,...', help='as of simulate')
    add('--input', choices=INPUTS, default='tension', help='what the motors set')
    add('--path', choices=LOADINGS, default='from_straight', help='how postures are reached')
    add('--lost', type=float, default=0.0, metavar='SHARE', help='of measurements that break')
    add_goal(parser, Goal().trials)
    declare(parser, '--effect-file')


def run(args: argparse.Namespace) -> None:
    """Investigate, write, print."""
    robot, catalogue = load_robot(args.robot), load_catalogue(args.effect_file)
    goal = goal_of(args, tuple(args.effect_file))
    regions = load_keep_out(args.keep_out) if args.keep_out else KeepOut()
    hidden = hidden_effects(args.hidden)
    work = Workmanship().times(args.level)
    plant = make_plant(robot, hidden, seed=args.seed, catalogue=catalogue, work=work)
    noise = simulated_noise(args.noise)
    lost = number('--lost', args.lost, 0.0, 1.0)
    arm = SimulatedArm(plant, noise, args.seed, args.input, args.path, lost)
    folder = Path(args.output)
    narrate(args, f'hidden:  {", ".join(args.hidden) or "nothing"}')
    investigation = Investigation(
        arm, goal, folder, regions, lambda kind, text, content: narrate(args, text), args.resume
    ).run()
    emit(args, investigation.to_json(), '\n'.join(investigation.write_results()))


@dataclass
class SimulatedArm:
    """A `MeasurableArm` that is simulated, with the noise of a tracker and of load cells."""

    plant: Plant
    noise: SimulatedNoise = field(default_factory=SimulatedNoise)
    seed: int = 0  # of the noise
    input: str = 'tension'  # as of a data set
    path: str = 'from_straight'  # as of a data set
    lost: float = 0.0  # [1] of the measurements that break
    # inputs (m,) of all measurements, broken ones included
    visited: list[Floats] = field(default_factory=list)
    released: int = 0

    def __post_init__(self) -> None:
        """Stand straight."""
        self.robot: Robot = self.plant.robot  # the owner's description
        self.markers: Sequence[Marker] = default_markers(self.robot)
        self.input_noise = self.noise.setting, self.noise.trial
        # a posture of a sequence has as many readings as others have trials
        self.readings = TRIALS_ADVISED if self.path == 'sequence' else 1
        self._random = np.random.default_rng(self.seed)

    @property
    def position_noise(self) -> float:
        """Standard deviation [m] of a coordinate of a trial."""
        return float(self.noise.position / np.sqrt(self.readings))

    def measure(self, inputs: Floats, trials: int) -> PostureMeasured:
        """Measure a posture."""
        self.visited.append(np.array(inputs))
        if self._random.random() < self.lost:
            raise BrokenMeasurementError('the tracker lost the arm')
        setting = self.noise.setting * self._random.normal(size=inputs.shape)
        trial = self.noise.trial * self._random.normal(size=(trials, *inputs.shape))
        try:
            mean = self.markers_after(disturbed(self.robot, inputs, self.input, setting, trial))
        except (NoEquilibriumError, InputError) as error:
            raise BrokenMeasurementError(f'the arm does not stand: {error}') from None
        noise = self._random.normal(0.0, self.position_noise, mean.shape)
        return PostureMeasured(mean + noise, None, trials * self.readings)

    def attend(self) -> None:
        """Serve nothing: nobody stops a simulation."""

    def release(self) -> None:
        """Release the arm: it is straight, without friction memory."""
        self.released += 1
        self.plant.forget()

    def markers_after(self, rows: Floats) -> Floats:
        """Return the markers (r, j, 3) [m] after inputs (r, m)."""
        arcs = np.array([marker.arc_length for marker in self.markers])
        offsets = np.array([marker.offset for marker in self.markers])
        pulls = self.input == 'displacement'
        if self.path == 'from_straight':
            return self.plant.markers(rows, arcs, offsets, displacement=pulls)
        respond = self.plant.respond_to_pulls if pulls else self.plant.respond
        return np.array([respond(row).markers(arcs, offsets) for row in rows])
