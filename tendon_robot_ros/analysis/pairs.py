"""Which two inputs of a robot are pulled together (Kato et al. 2015, section IV.B)."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt

from ..model.arrays import tendon_offsets
from ..robot import Robot

ALIGNED = 0.5  # cosine from which two inputs pull to the same side


@dataclass(frozen=True)
class Pair:
    """Two inputs that are pulled while all others hold the pretension."""

    inputs: tuple[str, str]  # the one that ends nearer to the base first
    indices: tuple[int, int]
    kind: str  # 'opposite sides', 'same side' or 'across'

    @property
    def name(self) -> str:
        """Both inputs and how they lie."""
        return f'{self.inputs[0]} + {self.inputs[1]} ({self.kind})'


def pairs_of(robot: Robot) -> tuple[Pair, ...]:
    """
    List the pairs of inputs that end in different sections (in the same one if there is one).

    Opposite sides: their offsets point away from each other; same side: the same way.
    """
    last = [max(robot.tendon_cells[k] for k in tendons) for tendons in robot.input_tendons]
    toward = [_direction(robot, tendons) for tendons in robot.input_tendons]
    ends = len(set(last))
    found = []
    for i, j in combinations(range(len(robot.inputs)), 2):
        if ends > 1 and last[i] == last[j]:
            continue
        a, b = (i, j) if last[i] <= last[j] else (j, i)
        cosine = float(toward[i] @ toward[j])
        kind = (
            'opposite sides'
            if cosine < -ALIGNED
            else 'same side'
            if cosine > ALIGNED
            else 'across'
        )
        found.append(Pair((robot.inputs[a], robot.inputs[b]), (a, b), kind))
    return tuple(found)


def _direction(robot: Robot, tendons: tuple[int, ...]) -> npt.NDArray[np.float64]:
    offset = tendon_offsets(robot)[0, list(tendons)].sum(axis=0)
    return np.asarray(offset / max(float(np.linalg.norm(offset)), 1e-300))
