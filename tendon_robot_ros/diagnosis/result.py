"""Results of a diagnosis and an improvement, and the JSON that reports and other tools read."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np

from ..common.arrays import Floats
from ..common.colours import ERROR, GOOD, HELD_OUT, PREDICTED
from ..common.files import write_text
from ..common.results import TextResult, make_frame, picture_axes, plain
from ..common.words import LISTED_MAX, mm
from ..effects import Catalogue
from ..inference.description import PROFILE
from ..inference.imperfections import Members
from ..inference.intervals import LoadVector, Value, Values
from ..inference.predict import FreeParameter, frees_of
from ..robot import Robot
from .verdict import Verdict

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FORMAT = 'tendon_robot_ros/diagnosis@1'
NOT_NEEDED = 'not needed'  # status where the model is adequate: there is nothing to explain
AS_FOUND = 'arm_as_found'  # the step that writes cells, inputs and the frame as they were found
IMPROVEMENT_FORMAT = 'tendon_robot_ros/improvement@1'
COLOURS = {'fitted': PREDICTED, 'left out': HELD_OUT, 'check': GOOD}


@dataclass(frozen=True)
class EffectFinding:
    """An effect that should be added (or changed)."""

    name: str
    parameters: dict[str, Value]
    explained: float  # fraction of the explainable error that the description of `add` explains
    present: bool = False
    load: LoadVector | None = None  # of an effect that is a force: its size and direction

    def __repr__(self) -> str:
        """Return name and values."""
        values = ', '.join(
            f'{key} = {v.value:.4g} ({v.low:.4g} to {v.high:.4g}) {v.unit}'
            for key, v in self.parameters.items()
        )
        return f'{self.name}: {values}'


def found_values(
    effects: Sequence[EffectFinding], catalogue: Catalogue, robot: Robot
) -> dict[FreeParameter, float]:
    """Return the values of the effects that were found, by parameter."""
    known = {(e.name, key): value.value for e in effects for key, value in e.parameters.items()}
    frees = frees_of([effect.name for effect in effects], catalogue, robot)
    return {
        free: known[free.effect, free.key] for free in frees if (free.effect, free.key) in known
    }


@dataclass(frozen=True)
class CandidateRow:
    """A row of the candidate table."""

    name: str
    parameters: dict[str, Value]
    chi2: float
    freedom: int
    probability: float
    explained: float
    error: float  # [m] rms of the description with it, of the kind of `error_after`
    held_out: float  # [m] rms of the same on postures left out in turn (of rejected ones linear)
    status: str  # 'best', 'cannot be told apart', 'adequate, less likely', 'rejected', NOT_NEEDED
    present: bool
    load: LoadVector | None = None  # of an effect that is a force: its size and direction


@dataclass(frozen=True)
class NextMeasurement:
    """The posture that separates the class."""

    input: dict[str, float]  # [N] or [m]
    after: dict[str, float] | None  # come from this posture, else from straight
    gravity: list[float] | None  # [m/s²] turn the robot so that this acts, else as it is
    difference: float  # [m] largest tip distance between the predictions
    noise: float  # [m] sd of a tip measurement there
    predictions: dict[str, list[float]] = field(default_factory=dict)  # tip [m] per candidate


@dataclass(frozen=True)
class Diagnosis(TextResult):
    """Verdict, effects to add, alternatives, what was not tested, errors and remainder."""

    verdict: Verdict
    effects: tuple[EffectFinding, ...] = ()
    cannot_tell_apart: tuple[str, ...] = ()
    not_tested: tuple[str, ...] = ()
    out_of_tolerance: tuple[str, ...] = ()
    # [m] rms over postures and markers, of the description as it stands
    error_before: float = math.nan
    error_after: float = math.nan  # [m] of the description that `add` writes; see `error_alone`
    noise_floor: float = math.nan  # [m] of a perfect model
    next_measurement: NextMeasurement | None = None
    remainder: str = ''
    candidates: tuple[CandidateRow, ...] = ()
    details: dict[str, Any] = field(default_factory=dict)
    format: str = FORMAT
    error_alone: float = math.nan  # [m] with the effects, the arm otherwise as it was described

    def __post_init__(self) -> None:
        """Accept a verdict by its name as well."""
        object.__setattr__(self, 'verdict', Verdict(self.verdict))

    def __repr__(self) -> str:
        """Return the verdict, the effects with their intervals, and the errors."""
        rows = [f'{effect!r}' for effect in self.effects]
        if self.cannot_tell_apart:
            rows.append(f'cannot be told apart: {", ".join(self.cannot_tell_apart)}')
        errors = f'error {mm(self.error_before)} -> {mm(self.error_after)}'
        rows += [f'{errors}, noise floor {mm(self.noise_floor)}', self.remainder]
        return f'<Diagnosis {self.verdict}: {"; ".join(filter(None, rows))}>'

    @property
    def adds(self) -> bool:
        """Whether `add` writes effects without `--partial`."""
        return self.verdict.may_add

    def to_json(self) -> dict[str, Any]:
        """Return plain data for JSON, NaN and infinity as null."""
        content = asdict(self)
        first = {key: content.pop(key) for key in ('format', 'verdict', 'effects')}
        return dict(plain({**first, **content}))

    def frame(self) -> Any:
        """
        Return the candidates as a table (pandas): a row per effect and parameter, best first.

        Columns `effect`, `status`, `present`, `parameter`, `value`, `low`, `high`, `unit`, and of
        the effect `error` and `held_out` [m], `explained` and `probability` [1].
        """
        of_value = ('value', 'low', 'high', 'unit')
        of_effect = ('error', 'held_out', 'explained', 'probability')
        rows = [
            {'effect': row.name, 'status': row.status, 'present': row.present, 'parameter': key}
            | {name: getattr(value, name) for name in of_value}
            | {name: getattr(row, name) for name in of_effect}
            for row in self.candidates
            for key, value in row.parameters.items()
        ]
        columns = {key: [row[key] for row in rows] for key in (rows[0] if rows else {})}
        return make_frame(columns, {'error': 'm', 'held_out': 'm'})

    def plot(self, axes: Axes | None = None) -> Axes:
        """
        Draw the remaining error [mm] with each effect, best first, with matplotlib.

        The dashed line is the error of the model as described, the grey band the noise. Where no
        effect was judged, the picture says why.

        Parameters
        ----------
        axes : matplotlib Axes, optional

        """
        rows = [row for row in self.candidates if math.isfinite(row.error)][:LISTED_MAX]
        height = 1.6 + 0.3 * max(len(rows), len(self.remainder) // 60)
        axes = axes or picture_axes((6.4, height))
        if not rows:
            centred: dict[str, Any] = {'ha': 'center', 'va': 'center', 'transform': axes.transAxes}
            axes.text(0.5, 0.5, fill(f'{self.verdict}: {self.remainder}', 60), **centred)
            axes.set_axis_off()
            return axes
        chosen = {effect.name for effect in self.effects}
        colours = [GOOD if row.name in chosen else ERROR for row in rows]
        axes.barh([row.name for row in rows], [1e3 * row.error for row in rows], color=colours)
        axes.axvspan(0.0, 1e3 * self.noise_floor, color='0.8', zorder=3, alpha=0.7)
        axes.axvline(1e3 * self.error_before, color=PREDICTED, linestyle='--')
        axes.invert_yaxis()
        axes.set(
            xlabel='rms error that is left [mm]; dashed: as described, grey: noise',
            title=f'{self.verdict}: {", ".join(chosen)}' if chosen else str(self.verdict),
        )
        return axes

    def save(self, path: str | Path) -> None:
        """Write the JSON file."""
        write_text(path, json.dumps(self.to_json(), indent=1))


@dataclass(frozen=True)
class ImprovementStep:
    """A description of the search, and its errors: rms over postures, per marker (J,) [m]."""

    joined: str  # effects, 'bending_stiffness' along the arm, by ' + '; AS_FOUND; '' as it was
    left: tuple[str, ...]  # what was no longer needed with it
    fitted: Floats  # of the description, on the postures that it was fitted to
    left_out: Floats  # on postures that had no part in choosing and fitting
    check: Floats | None  # of the description, on the check set
    fall: float  # [m] of the left-out rms over all markers, since the last step that was taken
    scatter: float  # [m] 1 sd of that fall, from posture to posture

    @property
    def label(self) -> str:
        """Names of the effects that joined and left."""
        joined = self.joined.replace(PROFILE, f'{PROFILE} along the arm')
        joined = joined.replace(AS_FOUND, 'the arm as it was found')
        left = ''.join(f', without {name}' for name in self.left)
        return f'+ {joined}{left}' if self.joined else 'as described'

    @property
    def errors(self) -> dict[str, Floats]:
        """Errors (J,) [m] by kind, without a missing check."""
        kinds = {'fitted': self.fitted, 'left out': self.left_out, 'check': self.check}
        return {kind: errors for kind, errors in kinds.items() if errors is not None}


@dataclass(frozen=True)
class Improvement(TextResult):
    """An improved description, the steps to it, and what remains."""

    robot: Robot  # with what was taken
    steps: tuple[ImprovementStep, ...]  # first: as it was; some more than were taken
    taken: int  # steps after the first
    chosen: Floats  # (J,) [m] left out, where the number of steps was chosen without them as well
    values: Values  # with their intervals
    loads: dict[str, LoadVector]  # size and direction, of effects that are forces
    profile: tuple[float, ...]  # change of the stiffness at base, middle and tip [1], or nothing
    routes: dict[str, tuple[float, float]]  # tendon -> turn at the base [rad], helix [rad/m]
    markers: tuple[str, ...]
    data: str
    check: str  # name of the check set; '' where there is none
    noise_floor: float  # [m] rms of a perfect model
    probability: float  # that noise alone leaves as much on the fitted postures
    more_at_work: str  # what the file says where this is not the whole story
    tips: dict[str, float]  # posture -> its error [m] at the last marker when it is left out
    local_faults: tuple[dict[str, Any], ...]  # where it is still wrong beyond the rest
    left_out: dict[str, Any]  # postures that do not settle, readings that others contradict
    as_built: dict[str, Any] | None = None  # its scatter, where the arm as found was taken
    anew: Members = field(default_factory=dict)  # in each of several recordings; off the errors

    def __repr__(self) -> str:
        """Return the effects that joined, and the left-out error before and after."""
        names = ', '.join(step.joined for step in self.steps[1 : self.taken + 1])
        before, after = (mm(total(self.steps[k].left_out)) for k in (0, self.taken))
        return f'<Improvement by {names or "nothing"}: left out {before} -> {after}>'

    @property
    def falling(self) -> dict[str, list[float]]:
        """Rms errors [m] over postures and markers after every step, by kind."""
        return {
            kind: [total(step.errors[kind]) for step in self.steps]
            for kind in self.steps[0].errors
        }

    def frame(self) -> Any:
        """
        Return the errors as a table (pandas): a row per step, kind of error and marker.

        Columns `step` (0: as described), `joined`, `taken`, `kind` ('fitted', 'left out',
        'check'), `marker`, and the rms `error` [m] over the postures.
        """
        rows = [
            (k, step.joined, k <= self.taken, kind, marker, float(error))
            for k, step in enumerate(self.steps)
            for kind, errors in step.errors.items()
            for marker, error in zip(self.markers, errors, strict=True)
        ]
        names = 'step', 'joined', 'taken', 'kind', 'marker', 'error'
        columns = dict(zip(names, map(list, zip(*rows, strict=True)), strict=True))
        return make_frame(columns, {'error': 'm'}, {'marker': self.markers})

    def plot(self, axes: Axes | None = None) -> Axes:
        """
        Draw how the error falls step by step [mm], with matplotlib.

        Steps behind the dotted line were not taken; the grey band is the noise.

        Parameters
        ----------
        axes : matplotlib Axes, optional

        """
        axes = axes or picture_axes((7.2, 4.2))
        names = [step.label for step in self.steps]
        for kind, errors in self.falling.items():
            height = 1e3 * np.array(errors)
            axes.plot(range(len(names)), height, 'o-', color=COLOURS[kind], label=kind)
        axes.axhspan(0.0, 1e3 * self.noise_floor, color='0.8', alpha=0.7)
        axes.axvline(self.taken + 0.5, color='0.4', linestyle=':')
        axes.set_xticks(range(len(names)), names, rotation=30, ha='right')
        axes.set(ylabel='rms error [mm]', ylim=(0.0, None))
        axes.legend()
        return axes

    def to_json(self) -> dict[str, Any]:
        """Return plain data for JSON; errors are rms [m] over postures, one per marker."""
        names = {'values': 'effects'}  # in files; the description is a file of its own
        own = {names.get(key, key): value for key, value in vars(self).items() if key != 'robot'}
        steps = [
            {key: getattr(step, key) for key in ('joined', 'left', 'fall', 'scatter')}
            | {kind.replace(' ', '_'): errors for kind, errors in step.errors.items()}
            for step in self.steps
        ]
        excluded = own.pop('left_out')
        return dict(plain({'format': IMPROVEMENT_FORMAT, **own, 'steps': steps, **excluded}))


def total(per_marker: Floats) -> float:
    """Return the rms [m] over all markers of rms errors (J,)."""
    return float(np.sqrt(np.nanmean(per_marker**2)))
