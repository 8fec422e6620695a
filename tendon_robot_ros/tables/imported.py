"""What an import of tables gives: a data set, and how it came out of them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from ..common.words import mm
from ..data import DataSet, save_dataset
from .account import columns_table, frame_lines, taken_line, told
from .choices import Taken
from .marker_order import MarkerOrder
from .measuring import StillMeasurements
from .picture import draw, picture_file
from .raw_table import FloatArray
from .recipe import Recipe, dump_recipe
from .registration import TrackerFrame

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RECIPE, PICTURE = 'import.yaml', 'import.png'


@dataclass(frozen=True)
class ImportedTable:
    """
    A data set, and how it came out of tables.

    Attributes
    ----------
    dataset : DataSet
        In the robot's base frame.
    recipe : Recipe
        Every choice: importing again with it gives the same data set.
    taken : Taken
        Columns, and how they were recognised.
    measured : StillMeasurements
        Still segments in the tracker's frame, and what was cut out.
    order : MarkerOrder
        Which marker is where.
    frame : TrackerFrame
        How the tracker stands.
    source : str
        The tables, with their sizes.
    predicted : (P, J, 3) [m]
        What the robot as described does in these postures.
    dropped, assumed, look : tuple of str
        What was not used; what nobody said; what asks for a look.

    """

    dataset: DataSet
    recipe: Recipe
    taken: Taken
    measured: StillMeasurements
    order: MarkerOrder
    frame: TrackerFrame
    source: str
    predicted: FloatArray
    dropped: tuple[str, ...]
    assumed: tuple[str, ...]
    look: tuple[str, ...]

    def __repr__(self) -> str:
        """Say what came out."""
        P, Q, J = self.dataset.positions.shape[:3]
        return (
            f'<ImportedTable {self.dataset.name}: {P} postures x up to {Q} trials x {J} markers; '
            f'frame by {self.frame.method}, residual {mm(self.frame.residual)}>'
        )

    def save(self, folder: str | Path, overwrite: bool = False) -> Path:
        """
        Write the data set, its import.yaml and a picture, whole or not at all.

        Raises
        ------
        DataSetError
            The folder is not empty or cannot be written.

        """
        recipe = dump_recipe(self.recipe, Path(folder)).encode()
        return save_dataset(
            self.dataset, folder, overwrite, {RECIPE: recipe, PICTURE: picture_file(self.plot())}
        )

    def plot(self) -> Figure:
        """Draw the raw traces, what was cut out, and the markers on the arm (matplotlib)."""
        members = self.order.members
        return draw(self.dataset, self.measured, self.recipe, members, self.predicted)

    def text(self) -> str:
        """Say which columns were taken, what was dropped and assumed, and how the frame lies."""
        lines = [
            f'{self.dataset.robot.name} from {self.source}',
            columns_table(self.recipe, self.taken),
            '',
        ]
        lines += told('taken', [taken_line(self.dataset, self.measured)])
        lines += told('dropped', self.dropped)
        lines += told('assumed', self.assumed)
        lines += told('frame', frame_lines(self.frame, self.dataset.robot))
        return '\n'.join([*lines, *told('LOOK', self.look)])
