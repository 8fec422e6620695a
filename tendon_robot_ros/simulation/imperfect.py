"""How a robot is built: the ordinary imperfections that no description declares."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from ..common.errors import InputError
from ..robot import Robot

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Workmanship:
    """One standard deviation of each imperfection, as in an ordinary laboratory."""

    stiffness: float = 0.03  # [1] from cell to cell
    kink: float = float(np.radians(0.1))  # [rad] of each cell at rest
    gain: float = 0.01  # [1] of the reading of each input
    hole: float = 0.01  # [1] of the radius at which each tendon runs
    position: float = 3e-4  # [m] of the tracker's frame, per axis
    rotation: float = float(np.radians(0.2))  # [rad] of the tracker's frame, per axis

    def __post_init__(self) -> None:
        """
        Refuse what is no standard deviation.

        Raises
        ------
        InputError

        """
        for field in fields(self):
            value = getattr(self, field.name)
            if not 0.0 <= value <= 0.2:
                raise InputError(
                    f'workmanship: {field.name}: expected a number from 0 to 0.2, got {value}'
                )

    def times(self, factor: float) -> Workmanship:
        """Return better (below 1) or worse work."""
        return Workmanship(*(factor * getattr(self, field.name) for field in fields(self)))


@dataclass(frozen=True)
class Built:
    """The imperfections of one robot."""

    stiffness: Floats  # (n,) [1] relative
    kink: Floats  # (n, 2) [rad]
    gain: Floats  # (m,) [1]
    hole: Floats  # (k,) [1]
    position: Floats  # (3,) [m]
    rotation: Floats  # (3,) [rad]

    @classmethod
    def draw(cls, robot: Robot, work: Workmanship, seed: int) -> Built:
        """Build a robot; a planar one has kinks in its plane only."""
        random = np.random.default_rng([seed, 41])
        n, m, k = robot.cells, len(robot.inputs), len(robot.tendons)
        offsets = np.array([end for t in robot.tendons for end in (t.base, t.end)])
        plane = (np.abs(offsets).max(axis=0) > 1e-6).astype(float)
        return cls(
            work.stiffness * random.normal(size=n).clip(-4, 4),
            work.kink * random.normal(size=(n, 2)) * plane,
            work.gain * random.normal(size=m),
            work.hole * random.normal(size=k),
            work.position * random.normal(size=3),
            work.rotation * random.normal(size=3),
        )

    @classmethod
    def exact(cls, robot: Robot) -> Built:
        """Return a robot without any."""
        return cls.draw(robot, Workmanship(0.0, 0.0, 0.0, 0.0, 0.0, 0.0), 0)

    def text(self) -> list[str]:
        """Say what was built in."""
        degrees = np.degrees(np.concatenate([self.kink.ravel()[self.kink.ravel() != 0.0], [0.0]]))
        worst = int(np.argmax(np.abs(self.stiffness)))
        return [
            f'cells scatter by {100.0 * np.std(self.stiffness):.1f} % in stiffness '
            f'(most cell {worst + 1}: {100.0 * self.stiffness[worst]:+.0f} %), '
            f'kinks of {np.sqrt(np.mean(degrees**2)):.2f}°',
            'inputs off by '
            + ', '.join(f'{100.0 * g:+.1f} %' for g in self.gain)
            + '; holes by '
            + ', '.join(f'{100.0 * h:+.1f} %' for h in self.hole),
            'tracker off by '
            + ', '.join(f'{1e3 * x:+.2f}' for x in self.position)
            + ' mm and '
            + ', '.join(f'{a:+.2f}' for a in np.degrees(self.rotation))
            + '°',
        ]
