"""Checks of incoming messages; a refusal has a code for programs and a sentence for people."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..common.errors import InputError
from ..common.rotations import from_quaternion
from ..robot import Robot

Array = NDArray[np.float64]
# [1] names in a sentence, because a message may hold a million
NAMES_LISTED_MAX = 8
# [1] letters of a name in a sentence, because it may be of any length
NAME_LENGTH_MAX = 40


class Refusal(InputError):
    """A message is refused; `code` is short and stable, for programs."""

    def __init__(self, code: str, message: str) -> None:
        """Store the code beside the sentence."""
        self.code = code
        super().__init__(message)


def cut(name: str) -> str:
    """Return a name for a message, cut where it gets long."""
    return name if len(name) <= NAME_LENGTH_MAX else f'{name[:NAME_LENGTH_MAX]}...'


def check_stamp(stamp: float, now: float, tolerance: float, what: str) -> None:
    """
    Refuse an old or a future stamp.

    Parameters
    ----------
    stamp, now : float
        Time in the message's header and of this node's clock [s]; a stamp of 0 means now.
    tolerance : float
        Largest difference [s].
    what : str
        Names the message.

    """
    if stamp == 0.0:
        return
    age = now - stamp
    if age > tolerance:
        raise Refusal(
            'stale',
            f'{what}: stamp is {age:.3g} s old, expected at most '
            f'{tolerance:g} s; check clocks, or send stamp 0 for now',
        )
    if age < -tolerance:
        raise Refusal(
            'future',
            f'{what}: stamp is {-age:.3g} s in the future, expected at most '
            f'{tolerance:g} s; check clocks, or send stamp 0 for now',
        )


def check_frame(frame: str, known: Sequence[str], what: str) -> None:
    """Refuse a frame other than the known ones."""
    if frame not in known:
        raise Refusal(
            'frame',
            f'{what}: frame {cut(frame)!r}, expected {" or ".join(map(repr, known))}'
            ' (no transform between the two is known)',
        )


def finite(values: Sequence[float], what: str) -> Array:
    """Return the values as an array; refuse nan and inf."""
    array = np.array(values, dtype=float)
    if not np.isfinite(array).all():
        raise Refusal('not_finite', f'{what}: expected finite numbers, got {array.tolist()}')
    return array


def position(values: Sequence[float], longest: float, what: str) -> Array:
    """Return a position [m]; refuse one that is further away than any robot's tip could be."""
    point = finite(values, what)
    if np.linalg.norm(point) > longest:
        raise Refusal(
            'too_far',
            f'{what}: {np.linalg.norm(point):.4g} m from the base, expected '
            f'at most {longest:.4g} m; positions are in metres',
        )
    return point


def direction(quaternion: Sequence[float], what: str) -> Array:
    """
    Return the +z axis of an orientation, its approach direction; roll is ignored.

    Parameters
    ----------
    quaternion : sequence of 4 float
        x, y, z, w; its norm may be off by 1 %.
    what : str
        Names the message.

    """
    x, y, z, w = finite(quaternion, what)
    norm = float(np.sqrt(x * x + y * y + z * z + w * w))
    if not 0.99 < norm < 1.01:
        raise Refusal(
            'quaternion',
            f'{what}: orientation (x, y, z, w) has norm {norm:.4g}, '
            'expected 1; for a position alone use the point topic',
        )
    return from_quaternion((x / norm, y / norm, z / norm, w / norm))[:, 2]


def by_name(
    names: Sequence[str], values: Sequence[float], inputs: Sequence[str], what: str, quantity: str
) -> Array:
    """
    Return the values of a joint message in the robot's order.

    Parameters
    ----------
    names, values : sequence
        As in the message.
    inputs : sequence of str
        The robot's inputs: every one of them must be there, once, and nothing else.
    what, quantity : str
        Name the message and its field.

    """
    if tuple(names) == tuple(inputs) and len(values) == len(names):
        return np.array(values, dtype=float)  # the usual case
    unknown = [name for name in names if name not in inputs]
    missing = [name for name in inputs if name not in names]
    if unknown or missing or len(names) != len(inputs):
        problem = 'a name stands twice'
        if unknown:
            more = len(unknown) - NAMES_LISTED_MAX
            problem = f'unknown {", ".join(map(cut, unknown[:NAMES_LISTED_MAX]))}'
            problem += f' and {more} more' if more > 0 else ''
        elif missing:
            problem = f'missing {", ".join(missing)}'
        raise Refusal('names', f'{what}: {problem}; expected {", ".join(inputs)}, once each')
    if len(values) != len(names):
        raise Refusal(
            'length', f'{what}: expected {len(names)} values of {quantity}, got {len(values)}'
        )
    at = dict(zip(names, values, strict=True))
    return np.array([at[name] for name in inputs], dtype=float)


def check_inputs(inputs: tuple[str, ...], expected: tuple[str, ...]) -> None:
    """Refuse a model with other inputs than the one in use."""
    if inputs != expected:
        raise InputError(
            f'the new model has the inputs {", ".join(inputs)}, expected {", ".join(expected)}; '
            'restart the node to change them'
        )


def another_robot(robot: Robot, before: Robot) -> bool:
    """Whether a description is of another arm, so that targets in its base frame are void."""
    return robot.name != before.name or not np.isclose(robot.length, before.length, rtol=1e-9)
