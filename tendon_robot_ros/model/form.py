"""Where the results of postures lie in the one array that the kernel fills."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Form:
    """
    Sizes of a robot's results: n cells, k tendons, m inputs.

    A block of b postures holds one field after the other, each (b, ...), in the order of
    `fields`, which is the kernel's (`postures`); that of a single posture also a friction memory.
    """

    n: int
    k: int
    m: int
    memory: int  # floats that the friction memory takes
    cell_length: Floats  # (n,) [m] at rest
    hinge: npt.NDArray[np.bool_]  # (n,)

    @cached_property
    def fields(self) -> dict[str, tuple[int, ...]]:
        """Name and shape of the fields of one posture."""
        n, k, m = self.n, self.k, self.m
        return {
            'inputs': (m,),
            'bend': (n, 2),
            'tendon_tensions': (n, k),
            'frames': (n, 3, 3),
            'positions': (n, 3),
            'tendon_pulls': (k,),
            'pulls': (m,),
            'change': (),
        }

    @cached_property
    def starts(self) -> dict[str, int]:
        """Floats of one posture that lie before each field."""
        starts, size = {}, 0
        for name, shape in self.fields.items():
            starts[name] = size
            size += math.prod(shape)
        return starts

    @cached_property
    def size(self) -> int:
        """Floats of one posture without the memory."""
        return self.starts['change'] + 1

    @cached_property
    def one(self) -> dict[str, tuple[slice, tuple[int, ...]]]:
        """Where each field of a single posture lies, and its shape."""
        return {
            name: (slice(start, start + math.prod(self.fields[name])), self.fields[name])
            for name, start in self.starts.items()
        }

    def rows(self, block: Floats, name: str, count: int) -> Floats:
        """Field (count, ...) of a block of `count` postures."""
        shape = self.fields[name]
        start = self.starts[name] * count
        return block[start : start + count * math.prod(shape)].reshape(count, *shape)
