"""The model of a robot: one object for prediction, control, fitting and the mock robot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from ..common.arrays import Floats
from ..common.errors import whole
from ..robot.inputs import TensionsLike
from ..robot.keep_out import KeepOut
from . import derivatives as slopes
from . import pulls as wires
from .forward import ForwardModel
from .inverse import reach
from .shape import Reach, Shape, ShapeBatch
from .tip_task import COLD, Policy, Preferences, TipTask, refuse_other_unit


class Model(ForwardModel):
    """
    A frictionless chain of cells plus the physical effects that a robot description lists.

    PCCA is the chain alone; with `tendon_friction` it is the FKM of Kato et al. 2015.

    Shapes (`shape`, `shapes`, `pull_shape`) and targets (`reach`) are in the base frame of the
    arm; `observed` returns what a tracker sees, whose frame `base_misalignment` describes.
    """

    derivatives = slopes.derivatives
    tip_stiffness = slopes.tip_stiffness
    pull_shape = wires.pull_shape

    def observed(
        self,
        shape: Shape | ShapeBatch,
        arc_lengths: npt.ArrayLike | None = None,
        offsets: npt.ArrayLike | None = None,
    ) -> Floats:
        """
        Return where the tracker sees markers of a shape (J, 3) [m], or of b shapes (b, J, 3).

        Parameters
        ----------
        shape : Shape or ShapeBatch
            As `shape`, `shapes` or `pull_shape` return it.
        arc_lengths : (J,) [m], optional
            Of the markers along the straight arm; default: the end of every cell.
        offsets : (J, 3) [m], optional
            Of the markers from the backbone, in the frame there; default: none.

        Raises
        ------
        InputError
            A marker lies beyond the tip.

        """
        if arc_lengths is None:
            arc_lengths = np.cumsum(self.robot.cell_lengths)
        along = np.asarray(arc_lengths, dtype=float)
        beside = np.zeros((len(along), 3)) if offsets is None else np.asarray(offsets, dtype=float)
        return self.measured(shape.markers(along, beside))

    def jacobian(self, tensions: TensionsLike) -> Floats:
        """Return d (tip position [m], tip direction) / d tensions [N], (6, m), from straight."""
        inputs = self.tensions(tensions)
        if not self.friction_remembers:
            return slopes.tip_slopes(self, self.shape(inputs), self.arrays.fresh_memory())[0]
        shapes = self.shapes(inputs[None])
        return np.asarray(self.derivatives(shapes, self.inputs, lambda batch: batch.tip)[0])

    def reach(
        self,
        position: npt.ArrayLike | None = None,
        direction: npt.ArrayLike | None = None,
        *,
        guess: Shape | None = None,
        memory: Floats | None = None,
        by_pulls: bool = False,
        preferences: Preferences | None = None,
        keep_out: KeepOut | None = None,
        starts: int = COLD.starts,
    ) -> Reach:
        """
        Return tensions within the limits that bring the tip to a target.

        Parameters
        ----------
        position : (3,) [m], optional
        direction : (3,), optional
            Approach direction of the tip; its length and the roll about it are ignored.
        guess : Shape, optional
            The present shape: the search starts there and looks elsewhere only if it must.
        memory : optional
            Friction memory where the arm is (`Shape.memory`): tensions then count as reached from
            there, along a straight line. Default: from straight and free of tension.
        by_pulls : bool
            Only tensions that wire lengths can hold; the lower limit is 0.
        preferences : Preferences, optional
            What the freedom that the target leaves is used for; default: low tension.
        keep_out : KeepOut, optional
            Regions that no part of the arm may enter; a target that leads there is `nearest`, with
            the region named.
        starts : int
            Number of starts all over the workspace that the search may try; 0: none but the guess.

        Raises
        ------
        InputError
            Neither position nor direction, or not finite; a position that is no place in metres;
            a guess of another robot; neither a guess nor a start.

        """
        refuse_other_unit(self.robot, position)
        if guess is not None:
            self.own_shape('guess', guess)
        task = replace(
            TipTask.at(self, position, direction, memory=memory),
            guess=guess,
            by_pulls=by_pulls,
            preferences=preferences,
            keep_out=keep_out or KeepOut(),
        )
        return reach(task, Policy(starts=whole('starts', starts, 1 if guess is None else 0)))

    def follow_pulls(self, last: Shape | None, pulls: TensionsLike) -> Shape:
        """
        Return the shape under wire pulls that follow those of the last shape, as `follow` does.

        Parameters
        ----------
        last : Shape or None
            None: the arm was straight and free of tension.
        pulls : mapping or (m,) [m]

        Raises
        ------
        InputError, NoEquilibriumError

        """
        return self.pull_shape(pulls, last, None if last is None else last.memory)
