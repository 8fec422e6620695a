"""What a diagnosis says: a typed result, and the JSON that reports and other tools read."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass, field
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any

from ..common.colours import ERROR, GOOD, PREDICTED
from ..common.dataframes import make_frame
from ..common.files import new_file
from ..common.told import Told
from .decide import Verdict

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FORMAT = 'tendon_robot_ros/diagnosis@1'
CANDIDATES_DRAWN = 12
NOT_NEEDED = 'not needed'  # status where the model is adequate: there is nothing to explain


@dataclass(frozen=True)
class Value:
    """A fitted parameter with its 95 % interval [unit]."""

    value: float
    low: float
    high: float
    unit: str
    note: str = ''  # 'at its bound', 'not determined by these postures', 'correlated with ...'


@dataclass(frozen=True)
class LoadVector:
    """
    A force at an arm as people say it, with 95 % intervals.

    Attributes
    ----------
    size : Value
        [N]
    from_axis : Value, optional
        [rad] from the axis of the straight arm (+z of its base); None: not told.
    around_axis : float
        [rad] about that axis, from x towards y.
    from_gravity : Value, optional
        [rad] from the way in which weights pull; None: not told, or gravity is not known.

    """

    size: Value
    from_axis: Value | None
    around_axis: float
    from_gravity: Value | None = None


@dataclass(frozen=True)
class EffectFinding:
    """An effect that should be added (or changed)."""

    name: str
    parameters: dict[str, Value]
    explained: float  # share of the explainable error that is gone with what `add` writes, 0 to 1
    present: bool = False
    load: LoadVector | None = None  # of an effect that is a force: its size and direction

    def __repr__(self) -> str:
        """Say name and values."""
        values = ', '.join(
            f'{key} = {v.value:.4g} ({v.low:.4g} to {v.high:.4g}) {v.unit}'
            for key, v in self.parameters.items()
        )
        return f'{self.name}: {values}'


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
    """The posture that would separate the class."""

    input: dict[str, float]  # [N] or [m]
    after: dict[str, float] | None  # come from this posture, else from straight
    gravity: list[float] | None  # [m/s²] turn the robot so that this acts, else as it is
    difference: float  # [m] largest tip distance between the predictions
    noise: float  # [m] sd of a tip measurement there
    predictions: dict[str, list[float]] = field(default_factory=dict)  # tip [m] per candidate


@dataclass(frozen=True)
class Diagnosis(Told):
    """Verdict, effects to add, alternatives, what was not tested, errors and remainder."""

    verdict: Verdict
    effects: tuple[EffectFinding, ...]
    cannot_tell_apart: tuple[str, ...]
    not_tested: tuple[str, ...]
    out_of_tolerance: tuple[str, ...]
    error_before: float  # [m] rms over postures and markers, of the description as it stands
    error_after: float  # [m] of the description that `add` writes; see `error_alone`
    noise_floor: float  # [m] of a perfect model
    next_measurement: NextMeasurement | None
    remainder: str
    candidates: tuple[CandidateRow, ...]
    details: dict[str, Any] = field(default_factory=dict)
    format: str = FORMAT
    error_alone: float = math.nan  # [m] with the effects, the arm otherwise as it was described

    def __post_init__(self) -> None:
        """Take a verdict by its name as well."""
        object.__setattr__(self, 'verdict', Verdict(self.verdict))

    def __repr__(self) -> str:
        """Say the verdict, the effects with their intervals, and the errors."""
        rows = [f'{effect!r}' for effect in self.effects]
        if self.cannot_tell_apart:
            rows.append(f'cannot be told apart: {", ".join(self.cannot_tell_apart)}')
        before, after, floor = (
            f'{1e3 * error:.3g} mm'
            for error in (self.error_before, self.error_after, self.noise_floor)
        )
        rows += [f'error {before} -> {after}, noise floor {floor}', self.remainder]
        return f'<Diagnosis {self.verdict}: {"; ".join(filter(None, rows))}>'

    @property
    def adds(self) -> bool:
        """Whether there is something to add without the user insisting."""
        return self.verdict.may_add

    def to_json(self) -> dict[str, Any]:
        """Return plain data for JSON, NaN and infinity as null."""
        plain = asdict(self)
        first = {key: plain.pop(key) for key in ('format', 'verdict', 'effects')}
        return dict(_plain({**first, **plain}))

    def frame(self) -> Any:
        """
        Return the candidates as a table (pandas): a row per effect and parameter, best first.

        Columns `effect`, `status`, `present`, `parameter`, `value`, `low`, `high`, `unit`, and of
        the effect `error` and `held_out` [m], `explained` and `probability` [1].
        """
        rows = [
            {
                'effect': row.name,
                'status': row.status,
                'present': row.present,
                'parameter': key,
                'value': value.value,
                'low': value.low,
                'high': value.high,
                'unit': value.unit,
                'error': row.error,
                'held_out': row.held_out,
                'explained': row.explained,
                'probability': row.probability,
            }
            for row in self.candidates
            for key, value in row.parameters.items()
        ]
        columns = {key: [row[key] for row in rows] for key in (rows[0] if rows else {})}
        return make_frame(columns, {'error': 'm', 'held_out': 'm'})

    def plot(self, axes: Axes | None = None) -> Axes:
        """
        Draw what each effect leaves of the error [mm], best first, with matplotlib.

        The dashed line is the error of the model as described, the grey band the noise. Where no
        effect was judged, the picture says why.

        Parameters
        ----------
        axes : matplotlib Axes, optional

        """
        from matplotlib import pyplot as plt

        rows = [row for row in self.candidates if math.isfinite(row.error)][:CANDIDATES_DRAWN]
        if axes is None:
            height = 1.6 + 0.3 * max(len(rows), len(self.remainder) // 60)
            axes = plt.figure(figsize=(6.4, height), layout='constrained').add_subplot()
        if not rows:
            axes.text(0.5, 0.5, fill(f'{self.verdict}: {self.remainder}', 60), ha='center',
                      va='center', transform=axes.transAxes)  # fmt: skip
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
        with new_file(Path(path)) as draft:
            draft.write_text(json.dumps(self.to_json(), indent=1), encoding='utf-8')


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not abs(value) < 1e300:
        return None
    return value
