"""Default postures to measure: single inputs, bends in all directions, squeezes."""

from __future__ import annotations

import numpy as np

from ..common.arrays import Floats
from ..common.errors import choice, whole
from ..model.model import Model
from ..robot import Robot, RobotLike, load_robot
from ..robot.estimates import bend_rates, end_sections

INPUTS = ('tension', 'displacement')
PATHS = ('from_straight', 'sequence', 'visits')  # of a data set
# [rad] largest bend of a section by the frictionless model: U-shaped, so that all of its cells are
# strained and none touches the next
SECTION_BEND_MAX_RAD = 2.0
# [1] of it, the bend by one input alone; less, so that friction may add to it
SINGLE_FRACTION = 0.75
# [1] of the tension that bends by a radian, of a squeeze: enough, so that friction differs from
# posture to posture
SQUEEZE_FRACTIONS = (0.3, 1.0)
# [1] cosine between a tendon and a bend below which it would squeeze more than it bends
SIDE_COSINE = 0.2
# [1] of a peak, one posture after the other: up and down, because friction shows its memory when a
# tendon is let go; no value twice
CYCLE = (0.25, 0.6, 1.0, 0.7, 0.3)
# [1] postures of a sequence for each of others, because those of a cycle beyond its peak only go
# down again
SEQUENCE_FACTOR = len(CYCLE) / (CYCLE.index(max(CYCLE)) + 1)
# [1] peak over a random bend, of arms of one section and of several; smaller there, because the
# bends of sections add up
PEAKS = (1.7, 1.2)


def default_postures(
    robot: RobotLike,
    count: int = 12,
    seed: int = 0,
    input: str = 'tension',
    path: str = 'from_straight',
) -> Floats:
    """
    Return inputs (count, m) that exercise a robot.

    One input after the other alone; then random bends of every section, half of them with all
    tendons of a section squeezing it as well, which tells friction from stiffness. A sequence goes
    up and down instead, because friction shows its memory when a tendon is let go.

    Parameters
    ----------
    robot : Robot, name, path, text or dict
        Every section bends by at most `SECTION_BEND_MAX_RAD`, tensions stay within the limits.
    count : int
        Number of postures.
    seed : int
        Another seed gives other postures.
    input : str
        'tension' [N], or 'displacement' [m] with nan where a wire is slack.
    path : str
        How they are reached: 'from_straight', 'sequence' (one after the other) or 'visits' (the
        postures of 'from_straight', in any order).

    """
    robot, count, seed = load_robot(robot), whole('count', count, 1), whole('seed', seed)
    choice('input', input, INPUTS)
    choice('path', path, PATHS)
    design = _Design(robot, np.random.default_rng(seed), input == 'tension')
    if path == 'sequence':
        rows = design.cycles(count)
    else:
        singles = design.singles()[: max(count // 3, 1)] if seed == 0 else []
        rows = [*singles, *design.bends(count - len(singles))]
    tensions = np.clip(np.round(rows, 4), *robot.tension_limits)
    if input == 'tension':
        return tensions
    taut = np.array(rows) > 0.0
    pulls = Model(robot).shapes(np.where(taut, tensions, 0.0)).pulls  # of the owner's model
    return np.where(taut, np.round(pulls, 6), np.nan)


class _Design:
    """Tensions that bend sections by a wanted angle, without friction."""

    def __init__(self, robot: Robot, random: np.random.Generator, squeezes: bool) -> None:
        self.random, self.squeezes = random, squeezes
        self.count = len(robot.inputs)
        self.last = end_sections(robot)  # section that an input ends in
        self.rate = bend_rates(robot)  # bend of that section per newton [rad/N]
        # (m,) its size; of a group that only squeezes any, as it bends nothing
        self.size = np.maximum(np.linalg.norm(self.rate, axis=1), 1e-300)
        self.sections = np.unique(self.last)

    def singles(self) -> list[Floats]:
        """Each input alone at three quarters of the largest bend."""
        full = SINGLE_FRACTION * SECTION_BEND_MAX_RAD / self.size
        return list(np.diag(full))

    def bends(self, count: int) -> list[Floats]:
        """Random bends of all sections, of all sizes."""
        sizes = {
            s: self.random.permutation((np.arange(count) + 0.5) / max(count, 1))
            for s in self.sections
        }
        rows = []
        for i in range(count):
            row = np.zeros(self.count)
            for s in self.sections:
                row += self.section(s, SECTION_BEND_MAX_RAD * sizes[s][i])
                if self.squeezes and self.random.random() < 0.5:
                    members = self.last == s  # all tendons of a section leave it straight
                    size = 1.0 / self.size[members].max()  # [N] a radian
                    row[members] += self.random.uniform(*SQUEEZE_FRACTIONS) * size
            rows.append(row)
        return rows

    def section(self, s: int, bend: float) -> Floats:
        """Tensions (m,) [N] that bend one section in a random direction of those it can bend."""
        members = np.flatnonzero(self.last == s)
        rate = self.rate[members]
        weights = self.random.normal(size=len(members)) @ rate  # a direction that they span
        towards = weights / max(float(np.linalg.norm(weights)), 1e-300)
        cosines = rate @ towards / self.size[members]
        if (cosines < SIDE_COSINE).all():  # no tendon is on this side
            cosines = -cosines
        cosines[cosines < SIDE_COSINE] = 0.0
        row = np.zeros(self.count)
        row[members] = cosines * bend / max(float(np.linalg.norm(cosines @ rate)), 1e-300)
        return row

    def cycles(self, count: int) -> list[Floats]:
        """Load and let go in even steps, from one random bend to the next."""
        factor = PEAKS[0] if len(self.sections) == 1 else PEAKS[1]
        rows: list[Floats] = []
        while len(rows) < count:
            peak = self.bends(1)[0] * factor
            rows += [step * peak for step in CYCLE]
        return rows[:count]
