"""Columns of a table: names as codes, numbers as floats."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .dataset import FloatArray

IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class Table:
    """Columns of n rows; row i stands in line i + 2 of the file."""

    codes: dict[str, IntArray]  # (n,) index into labels, per name column
    labels: dict[str, tuple[str, ...]]  # in the order in which they appear
    numbers: dict[str, FloatArray]  # (n,), NaN where the cell is empty

    def name(self, row: int, *keys: str) -> str:
        """Say which row of the table this is, by its names (in all name columns by default)."""
        return ', '.join(
            f'{key} {self.labels[key][self.codes[key][row]]!r}' for key in keys or self.labels
        )

    def repeated(self) -> tuple[int, int] | None:
        """Return the first row whose names stood in an earlier row, and that row."""
        if not self.codes:
            return None
        sizes = [len(labels) for labels in self.labels.values()]
        index = np.zeros(len(next(iter(self.codes.values()))), dtype=np.int64)
        for codes, size in zip(self.codes.values(), sizes, strict=True):
            index = index * size + codes
        order = np.argsort(index, kind='stable')
        same = np.flatnonzero(index[order][1:] == index[order][:-1])
        if not len(same):
            return None
        row = int(order[same + 1].min())
        return row, int(np.flatnonzero(index == index[row])[0])

    def translate(self, key: str, known: tuple[str, ...]) -> IntArray:
        """Return the index of each row's name among the known ones, (n,), -1 for others."""
        places = {name: place for place, name in enumerate(known)}
        table = np.array([places.get(label, -1) for label in self.labels[key]], dtype=np.int64)
        return table[self.codes[key]]


class Labels(dict[str, int]):
    """Cell text to code; a new text gets the next code, spaces around it do not count."""

    def __init__(self) -> None:
        super().__init__()
        self.index: dict[str, int] = {}

    def __missing__(self, cell: str) -> int:
        code = self[cell] = self.index.setdefault(cell.strip(), len(self.index))
        return code
