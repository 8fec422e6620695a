"""What `improve` found: a better description, and how the error fell on the way there."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ..common.colours import GOOD, HELD_OUT, PREDICTED
from ..common.dataframes import make_frame
from ..common.told import Told
from ..robot import Robot
from .described_arm import PROFILE
from .result import LoadVector, Value

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Floats = npt.NDArray[np.float64]
AS_FOUND = 'arm_as_found'  # the step that writes cells, inputs and the frame as they were found
FORMAT = 'tendon_robot_ros/improvement@1'
COLOURS = {'fitted': PREDICTED, 'left out': HELD_OUT, 'check': GOOD}


@dataclass(frozen=True)
class ImprovementStep:
    """A description on the way, and its errors: rms over postures, per marker (J,) [m]."""

    joined: str  # effects, 'bending_stiffness' along the arm, by ' + '; AS_FOUND; '' as it was
    left: tuple[str, ...]  # what was no longer needed with it
    fitted: Floats  # of the description, on the postures that it was fitted to
    left_out: Floats  # on postures that had no part in choosing and fitting
    check: Floats | None  # of the description, on the check set
    fall: float  # [m] of the left-out rms over all markers, since the last step that was taken
    scatter: float  # [m] 1 sd of that fall, from posture to posture

    @property
    def label(self) -> str:
        """Say what joined and what left."""
        joined = self.joined.replace(PROFILE, f'{PROFILE} along the arm')
        joined = joined.replace(AS_FOUND, 'the arm as it was found')
        left = ''.join(f', without {name}' for name in self.left)
        return f'+ {joined}{left}' if self.joined else 'as described'

    @property
    def errors(self) -> dict[str, Floats]:
        """The kinds of errors that there are."""
        kinds = {'fitted': self.fitted, 'left out': self.left_out, 'check': self.check}
        return {kind: errors for kind, errors in kinds.items() if errors is not None}


@dataclass(frozen=True)
class Improvement(Told):
    """An improved description, the way there, and what remains."""

    robot: Robot  # with what was taken
    steps: tuple[ImprovementStep, ...]  # first: as it was; some more than were taken
    taken: int  # steps after the first
    chosen: Floats  # (J,) [m] left out, where the number of steps was chosen without them as well
    values: dict[str, dict[str, Value]]  # effect -> parameter -> value with its interval
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

    def __repr__(self) -> str:
        """Say what joined, and how the error on left-out postures fell."""
        names = ', '.join(step.joined for step in self.steps[1 : self.taken + 1])
        before, after = (1e3 * total(self.steps[k].left_out) for k in (0, self.taken))
        return f'<Improvement by {names or "nothing"}: left out {before:.3g} -> {after:.3g} mm>'

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
        from matplotlib import pyplot as plt

        if axes is None:
            axes = plt.figure(figsize=(7.2, 4.2), layout='constrained').add_subplot()
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
        steps = [
            {
                'joined': step.joined,
                'left': list(step.left),
                'fall': step.fall,
                'scatter': step.scatter,
                **{kind.replace(' ', '_'): one.tolist() for kind, one in step.errors.items()},
            }
            for step in self.steps
        ]
        values = {
            name: {key: vars(value) for key, value in items.items()}
            for name, items in self.values.items()
        }
        return {
            'format': FORMAT,
            'steps': steps,
            'taken': self.taken,
            'chosen': self.chosen.tolist(),
            'effects': values,
            'loads': {name: asdict(load) for name, load in self.loads.items()},
            'profile': list(self.profile),
            'routes': {name: list(change) for name, change in self.routes.items()},
            'markers': list(self.markers),
            'data': self.data,
            'check': self.check,
            'noise_floor': self.noise_floor,
            'probability': self.probability,
            'more_at_work': self.more_at_work,
            'tips': self.tips,
            'local_faults': list(self.local_faults),
            'as_built': self.as_built,
            **self.left_out,
        }


def total(per_marker: Floats) -> float:
    """Return the rms [m] over all markers of rms errors (J,)."""
    return float(np.sqrt(np.nanmean(per_marker**2)))
