"""How the controller is, as a level, a code, a sentence and values."""

from __future__ import annotations

from dataclasses import dataclass
from math import degrees
from typing import TYPE_CHECKING

import numpy as np

from .modes import FollowTarget
from .release import GO_ON
from .remainder import foreign

if TYPE_CHECKING:
    from ..model.shape import Reach
    from .core import ControllerCore
    from .target_search import TargetSearch

OK, WARN, ERROR = 'ok', 'warn', 'error'


@dataclass(frozen=True)
class ControllerStatus:
    """The first thing that a person should know comes as level, code and message."""

    level: str
    code: str
    message: str
    values: dict[str, str]


def controller_status(core: ControllerCore, now: float) -> ControllerStatus:
    """Say how the controller is; codes are listed in docs/ros_interface.md."""
    level, code, message = _condition(core, now)
    values = {'moving': str(core.moving).lower()}
    if stamp := followed(core):
        values['target_stamp'] = stamp
    if core.playing is not None:
        values['trajectory_time (s)'] = f'{core.playing.passed(now):.3f}'
        values['trajectory_duration (s)'] = f'{core.playing.times[-1]:.3f}'
    if core.solution is not None:
        values.update(_solution(core.solution))
    if core.command is not None:
        for name, tension in zip(core.model.inputs, core.command, strict=True):
            values[f'tension {name} (N)'] = f'{tension:.4f}'
    values.update(core.null_space.values())
    if core.settings.tip_gain > 0.0:
        values.update(core.loop.values(now))
    return ControllerStatus(level, code, message, values)


def followed(core: ControllerCore) -> str:
    """Return the stamp of the target or the trajectory that the controller is at, '' for none."""
    if core.release.waiting is not None:
        return core.release.stamp
    if core.search is not None:
        return core.search.target.stamp
    for one in (core.looked_at, core.playing, core.target):
        if one is not None:
            return one.stamp
    return ''


def _condition(core: ControllerCore, now: float) -> tuple[str, str, str]:
    if core.latch:
        return ERROR, 'stopped', '; '.join(core.latch.reasons) + '; call reset to go on'
    if core.driver_stopped:
        return ERROR, 'driver_stopped', f'the driver does not follow: {core.driver_stopped}'
    if not core.fresh(now):
        if core.command is None:
            return WARN, 'waiting', 'no tendon_states yet: is the driver running?'
        return ERROR, 'no_driver', _silence(core.settings.state_timeout, core.gone(now))
    if core.release.why:
        refusal = core.refusals.get('target')
        again = f'; {refusal}' if refusal is not None else ''
        return WARN, 'released', f'the driver let go: {core.release.why}; {GO_ON}{again}'
    if core.track.problem:
        return ERROR, 'no_equilibrium', core.track.problem
    for refusal in core.refusals.values():
        return WARN, f'refused_{refusal.code}', str(refusal)
    return activity(core, now)


def activity(core: ControllerCore, now: float) -> tuple[str, str, str]:
    """Return level, code and sentence of what the arm does, where nothing keeps it from that."""
    if core.search is not None:
        return _searching(core.search, now)
    if core.jogging:
        return OK, 'jogging', 'following a twist'
    if core.playing is not None:
        if core.playing.over(now) and not core.moving:
            return OK, 'played', 'at the end of the trajectory of the tendons'
        return OK, 'playing', f'playing a trajectory: {core.playing.progress(now)}'
    if core.solution is None:
        return OK, 'holding', 'waiting for a target'
    if core.settings.tip_gain > 0.0 and (seen := _as_seen(core, now)) is not None:
        return seen
    if core.moving:
        return OK, 'moving', 'moving to the target'
    return _arrived(core.solution, not isinstance(core.mode, FollowTarget) or core.mode.in_time)


def _as_seen(core: ControllerCore, now: float) -> tuple[str, str, str] | None:
    """Say where the tip is as the tracker sees it; None where the model alone tells."""
    if core.loop.left:
        return WARN, 'nearest', f'the closed loop was left: {core.loop.left}; the model says where'
    doubt, left = _doubt(core), core.loop.remainder(now)
    if left is None:
        loop = core.loop.values(now)['correction_frozen']
        return None if loop else (OK, 'moving', f'moving to the target{doubt}')
    off = f'{1e3 * left.away:.2f} mm'
    if left.none:
        assert core.solution is not None and core.target is not None
        if core.target.direction is not None and core.solution.status != 'reached':
            return None
        return OK, 'reached', f'at the target within {off}, as the tracker sees it{doubt}'
    why = left.why(core.model.inputs) or 'it comes no nearer now'
    return WARN, 'nearest', f'as near as it can, {off} from the target: {why}{doubt}'


def _doubt(core: ControllerCore) -> str:
    """Say what to do about a model that is far from the arm, as the loop has learned."""
    if core.loop.estimate is None:
        return ''
    offset = float(np.linalg.norm(core.loop.estimate.bias))
    said = foreign(offset, core.model.robot.length, core.model.remembers)
    return f'; {said}' if said else ''


def _silence(timeout: float, gone: bool) -> str:
    if gone:
        return f'no tendon_states for {timeout:g} s; no commands until they are back'
    return f'no tendon_states for {timeout:g} s; holding the last command'


def _searching(search: TargetSearch, now: float) -> tuple[str, str, str]:
    passed = now - search.began
    if search.streamed and passed < search.budget:
        return OK, 'moving', 'moving to the target'
    return OK, 'searching', f'looking for tensions for the target, for {passed:.1f} s'


def _arrived(solution: Reach, in_time: bool) -> tuple[str, str, str]:
    error = f'{1e3 * solution.position_error:.2f} mm and {degrees(solution.direction_error):.2f}°'
    if solution.status == 'reached':
        return OK, 'reached', f'at the target within {error}, as the model sees it'
    limits = ', '.join(solution.at_limit)
    limits = f'; at its limit: {limits}' if limits else ''
    limits += f'; kept out of {solution.region}' if solution.region else ''
    if not in_time:
        return WARN, solution.status, f'as near as found in time, {error} from the target{limits}'
    return WARN, solution.status, f'as near as it can, {error} from the target{limits}'


def _solution(solution: Reach) -> dict[str, str]:
    return {
        'solution': solution.status,
        'position_error (m)': f'{solution.position_error:.3g}',
        'direction_error (rad)': f'{solution.direction_error:.3g}',
        'at_limit': ', '.join(solution.at_limit),
        'kept_out_of': solution.region,
    }
