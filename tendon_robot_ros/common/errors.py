"""Errors a user can meet: each carries one line that says what, where and what to do."""

from __future__ import annotations

import math
import reprlib

_SHORT = reprlib.Repr()  # a file may hold a value of any size; a message may not
_SHORT.maxstring = _SHORT.maxother = _SHORT.maxlong = 120
_SHORT.maxlist = _SHORT.maxtuple = _SHORT.maxdict = 8
_SHORT.maxlevel = 3


def short(value: object) -> str:
    """Show a value in a message: its `repr`, cut where it gets long."""
    return _SHORT.repr(value)


class TendonRobotError(Exception):
    """Base of every error that the command line prints as one line."""


class RobotDescriptionError(TendonRobotError):
    """A robot description is not valid."""

    def __init__(self, source: str, key: str, expected: str, got: object) -> None:
        """Say which file and key, what was expected and what came."""
        self.source, self.key, self.expected, self.got = source, key, expected, got
        super().__init__(f'{source}: {key}: expected {expected}, got {short(got)}')


class EffectError(TendonRobotError):
    """An effect is unknown, or its definition is not usable."""


class InputError(TendonRobotError):
    """Tensions, pulls or targets that the model cannot take."""


class NoEquilibriumError(TendonRobotError):
    """The model finds no equilibrium for a posture."""

    def __init__(self, posture: str, effects: tuple[str, ...], last_change: float) -> None:
        """Say at which posture, with which implicit effects, and how far it moved [rad]."""
        self.posture, self.effects, self.last_change = posture, effects, last_change
        names = ', '.join(effects) or 'no implicit effect'
        still = ''
        if math.isfinite(last_change):
            still = f': the last step still changed a bend by {last_change:.2g} rad'
        super().__init__(
            f'no equilibrium for {posture} with {names}{still}; lower the tensions or loads, or '
            'check the units'
        )


class DataSetError(TendonRobotError):
    """A data set cannot be read or written."""

    def __init__(self, where: str, problem: str, remedy: str) -> None:
        """Say file (and row), what is wrong, and what to do."""
        self.where, self.problem, self.remedy = where, problem, remedy
        super().__init__(f'{where}: {problem}; {remedy}')


class ClusterLostError(TendonRobotError):
    """The scheduler of a cluster is gone while it was at work."""


class DriverError(TendonRobotError):
    """A driver cannot do what it was asked."""


class MovedError(DriverError):
    """Motors were moved, and what that was for failed: a person looks before it is tried again."""

    def __init__(self, problem: str) -> None:
        """Say what failed; what to do is the same for all."""
        super().__init__(
            f'{problem}; the motors have moved: look at the wires, call reset, then activate again'
        )


class MissingExtraError(TendonRobotError):
    """An optional dependency is not installed."""

    def __init__(self, package: str, extra: str) -> None:
        """Say the exact line to type."""
        self.package, self.extra = package, extra
        super().__init__(
            f'{package} is not installed; type: python -m pip install "tendon_robot_ros[{extra}]"'
        )
