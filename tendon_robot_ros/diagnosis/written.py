"""The description that a fit writes: with its effects, and with the arm as it was found."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from ..robot import Robot
from .decide import LEFT_OUT_SHARE_MAX
from .fit import Fit
from .into_description import changed_robot, with_members, with_tolerances
from .prediction_errors import left_out, rms_of

if TYPE_CHECKING:
    from .session import Session


@dataclass(frozen=True)
class Written:
    """What a fit writes; every error that is told of it is that of one of these descriptions."""

    alone: Robot  # with the effects; the arm otherwise as it was described
    robot: Robot  # that is written: with the arm as it was found as well, where that helps
    beside: bool  # whether it is
    alone_left_out: float  # [m] error on postures left out in turn
    left_out: float  # [m] of what is written


def written(session: Session, fit: Fit) -> Written:
    """
    Return the description to write.

    What was fitted beside the effects goes along where that lowers the error on postures left
    out: tolerances that moved, and imperfections, which of an exact arm are only noise.
    """
    alone = described_by(session, fit, beside=False)
    error = left_out(session.fitters[0], fit, beside=False)
    if fit.built is None and not fit.nuisances:
        return Written(alone, alone, False, error, error)
    together = left_out(session.fitters[0], fit)
    if together > LEFT_OUT_SHARE_MAX * error:
        return Written(alone, alone, False, error, error)
    return Written(alone, described_by(session, fit, beside=True), True, error, together)


def described_by(session: Session, fit: Fit, beside: bool) -> Robot:
    """Return the description with the effects of a fit, and with the arm as it found it."""
    robot = changed_robot(session.robot, session.catalogue, fit, session.dataset)
    if not beside:
        return robot
    moved = with_tolerances(robot, session.catalogue, fit)
    return with_members(moved, fit, session.dataset.input)


def error_of(session: Session, robot: Robot) -> float:
    """Return the rms [m] of a description on the measurements; nan without an equilibrium."""
    return rms_of(session.dataset, robot, session.catalogue)
