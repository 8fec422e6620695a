"""One simulated robot: hidden effect, imperfections, and measurements."""

from __future__ import annotations

import itertools
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from ..common.arrays import Floats
from ..data import DataSet, Marker, even_markers
from ..effects import Catalogue
from ..inference.imperfections import BuiltPredictor, imperfections
from ..inference.marginal import RandomEffects
from ..inference.noise import Whitener, estimate_noise, input_slopes
from ..inference.predict import Predictor
from ..robot import Robot
from ..robot.estimates import natural_sizes
from ..simulation.hidden import CAUSES, Built, chosen
from ..workspace.postures import SEQUENCE_FACTOR, default_postures

HiddenSizes = dict[str, float | list[float]]
NOTHING = 'none'
# [1] whitened squared change of the markers that stands out of the noise: as chi² of three
# parameters it comes about once in a million by chance
VISIBLE_FROM_CHI2 = 30.0
# [1] of the stiffness that a soft cell of size 1 lacks: nearly half, so that a person would see it
SOFT_CELL_LOSS = 0.45
# [1] of a typical size, each member of a vector, whose signs are drawn: so that it points anywhere
VECTOR_FRACTIONS = (0.4, 1.0)
# [1] of the typical size, section by section: they differ, or else it would be another effect
SECTION_FACTORS = (1.5, -1.0)
# what a tracker does to readings besides noise, as in a laboratory
LOST_FRACTION = 0.03  # [1] of the readings, because markers hide one another
WILD_FRACTION = 0.005  # [1] of the readings: about one in a data set, so that all are tried
WILD_SD = 5e-3  # [m] a cell or so, because one marker is taken for the next


@dataclass(frozen=True)
class Design:
    """
    How a robot is measured.

    Attributes
    ----------
    name : str
    postures, trials : int
    markers : int
        Evenly spaced; 0: one at every cell.
    input : str
        'tension', or 'displacement' where the wires are driven by their lengths.
    data : DataSet, optional
        Measured as these are instead: its postures, trials and markers.

    """

    name: str
    postures: int = 12
    trials: int = 5
    markers: int = 0
    input: str = 'tension'
    data: DataSet | None = None

    def placed(self, robot: Robot) -> tuple[Marker, ...] | None:
        """Return the markers; None: one at every cell."""
        if self.data is not None:
            return self.data.markers
        return even_markers(robot, self.markers) if self.markers else None


@dataclass(frozen=True)
class PlannedRobot:
    """A robot of a plan."""

    robot: Robot  # as its owner describes it, with all that may be hidden
    down: tuple[float, float, float] | None = None  # [m/s²] where gravity is hidden
    skips: tuple[str, ...] = ()  # what is not hidden in it, of all that the plan names


@dataclass(frozen=True)
class Case:
    """
    One simulated robot to judge.

    Attributes
    ----------
    robot, hidden : str
    size : float
        Times the typical size of the effect.
    number : int
        Which of the robots that differ in chance only.
    design, noise : int
        Which of the plan's.
    level : float
        How badly the arm is built, undeclared; 1: as in a laboratory.
    exact : bool
        Whether the description says that the arm is exact.
    scatter : float
        Of the cells' stiffness, where the level is 0.
    declared : bool
        Whether the description's tolerances say that scatter.

    """

    robot: str
    hidden: str
    size: float
    number: int
    design: int = 0
    noise: int = 0
    level: float = 1.0
    exact: bool = False
    scatter: float = 0.0
    declared: bool = False

    @property
    def key(self) -> str:
        """Name it among all cases of all plans that share a folder."""
        tail = f'{self.design}/{self.noise}/{self.level:g}/{self.exact:d}'
        more = f'/{self.scatter:g}/{self.declared:d}' if self.scatter else ''
        return f'{self.robot}/{self.hidden}/{self.size:.6g}/{self.number}/{tail}{more}'


def seeds_of(case: Case, seed: int) -> tuple[int, ...]:
    """
    Return the seeds of the arm, of the measurements to fit and to check, and of what is hidden.

    The plan's seed and what the case is give the same arm whatever the design, whoever computes
    it and when.
    """
    label = f'{case.robot}/{case.hidden}/{case.size:.6g}'
    root = np.random.SeedSequence(seed, spawn_key=(zlib.crc32(label.encode()), case.number))
    return tuple(int(one.generate_state(1)[0]) for one in root.spawn(4))


@dataclass(frozen=True)
class Simulated:
    """The measurements of a case, and the truth."""

    robot: Robot  # as its owner describes it
    fit: DataSet
    check: DataSet
    values: HiddenSizes
    built: Built
    catalogue: Catalogue = field(repr=False)


def described(case: Case, arm: PlannedRobot, catalogue: Catalogue) -> Robot:
    """Return the owner's description: the arm without what is hidden."""
    robot = arm.robot
    if case.hidden in robot.effects:
        robot = robot.without_effect(case.hidden)
    if 'gravity' in needs(case.hidden, catalogue) and arm.down is not None:
        robot = replace(robot, gravity=arm.down)
    known = {'cell_stiffness': case.scatter} if case.declared else {}
    return replace(robot, tolerances={**robot.tolerances, **known}, exact=case.exact)


def needs(hidden: str, catalogue: Catalogue) -> str:
    """Return what the measurements must have for an effect to show."""
    return catalogue[hidden].needs if hidden in catalogue else ''


def hidden_values(
    hidden: str, size: float, robot: Robot, catalogue: Catalogue, seed: int
) -> HiddenSizes:
    """Return the true parameters: typical ones times size; forces and bends point anywhere."""
    random = np.random.default_rng([seed, 5])
    if hidden == 'soft_cell':
        cell = 1 + robot.cells // 4 + int(random.integers(max(robot.cells // 2, 1)))
        return {'cell': float(cell), 'factor': 1.0 - SOFT_CELL_LOSS * size}
    if hidden in CAUSES or hidden == NOTHING:
        return {}
    effect = catalogue[hidden].sized(natural_sizes(robot))
    if effect.placed:  # many times its size would be another place
        return {key: float(np.ravel(v)[0]) for key, v in chosen(effect, {}, robot).items()}
    values: HiddenSizes = {}
    vector = sum(parameter.low <= -parameter.typical for parameter in effect.parameters) > 1
    for parameter in effect.parameters:
        shapes = parameter.has_default or parameter.only_described
        value = parameter.neutral if shapes else parameter.typical * size
        if parameter.low <= -parameter.typical:  # may have either sign
            value *= float(random.choice([-1.0, 1.0]))
            value *= float(random.uniform(*VECTOR_FRACTIONS)) if vector else 1.0
        if parameter.per_section and len(robot.sections) > 1 and parameter.low < 0.0:
            factors = itertools.islice(itertools.cycle(SECTION_FACTORS), len(robot.sections))
            values[parameter.name] = [abs(value) * factor for factor in factors]
        else:
            values[parameter.name] = float(np.clip(value, parameter.low, parameter.high))
    return values


def postures_of(
    case: Case, robot: Robot, design: Design, catalogue: Catalogue, which: int
) -> tuple[Floats, str, str]:
    """Return the inputs, what they are and how postures are reached."""
    need, data = needs(case.hidden, catalogue), design.data
    path = 'sequence' if 'history' in need else 'from_straight'
    kind, count = 'displacement' if 'pulls' in need else design.input, design.postures
    if data is not None:
        path, kind, count = data.path, data.input, len(data.postures)
        if which == 0:
            return data.inputs, kind, path
    count = round(SEQUENCE_FACTOR * count) if path == 'sequence' else count
    return default_postures(robot, count, which, kind, path), kind, path


def with_lost_readings(dataset: DataSet, seed: int) -> DataSet:
    """Remove some readings of the markers, and displace a few of them far."""
    random, positions = np.random.default_rng([seed, 19]), dataset.positions.copy()
    wild = random.random(positions.shape[:3]) < WILD_FRACTION
    positions[wild] += random.normal(0.0, WILD_SD, (int(wild.sum()), 3))
    lost = random.random(positions.shape[:3]) < LOST_FRACTION
    lost[:, 0, 0] = False  # every posture keeps a reading
    positions[lost] = np.nan
    return replace(dataset, positions=positions)


def is_visible(case: Case, sim: Simulated) -> bool:
    """
    Return whether the hidden effect exceeds the noise.

    On an arm as built, by the part that imperfections of that level cannot explain.
    """
    if case.hidden in CAUSES or case.hidden == NOTHING:
        return case.hidden != NOTHING
    before = Predictor(sim.fit, sim.robot, sim.catalogue)
    slopes = input_slopes(before, {})
    noise = estimate_noise(sim.fit, slopes)
    effect = sim.catalogue[case.hidden].sized(natural_sizes(sim.robot))
    values = chosen(effect, sim.values, sim.robot)
    real = sim.robot.with_effect(case.hidden, values)
    after = Predictor(sim.fit, real, sim.catalogue).markers({})
    markers = before.markers({})
    if after is None or markers is None or noise is None:
        return True
    whitener = Whitener(sim.fit, noise, slopes)
    white = whitener.white(after - markers)
    built = None if case.exact else imperfections(BuiltPredictor(before), {})
    if built is None:
        return float(white @ white) > VISIBLE_FROM_CHI2
    random = RandomEffects.of(built, whitener)
    sizes = case.level * np.where(np.isfinite(random.plausible), random.plausible, 0.0)
    unexplained = random.lift(random.root(sizes), white)
    return float(unexplained @ unexplained) > VISIBLE_FROM_CHI2


def truth_of(sim: Simulated, keys: Mapping[str, object]) -> dict[str, float]:
    """Return the true value of every fitted parameter, by its key: `name` or `name[section]`."""
    truth = {}
    for key in keys:
        bare, _, member = key.partition('[')
        value = np.atleast_1d(sim.values[bare])
        names = [f'{section.name}]' for section in sim.robot.sections]
        truth[key] = float(value[names.index(member)] if len(value) > 1 else value[0])
    return truth
