"""
The real arm in `data/tentacle`, effect by effect, judged on postures left out one at a time.

Prints the rms error per marker as fitted, and of each posture as
predicted from the fifteen others.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import numpy as np

from tendon_robot_ros.data import load_dataset
from tendon_robot_ros.effects import load_catalogue
from tendon_robot_ros.inference.candidates import Candidate
from tendon_robot_ros.inference.session import Question

DATA = Path(__file__).parent.parent / 'data' / 'tentacle'
ORDER = (
    'section_stiffness',
    'axial_compression',
    'base_misalignment',
    'tip_load',
    'tension_offset',
    'hinge_friction',
    'tendon_friction',
)


def per_marker(difference: np.ndarray) -> np.ndarray:
    """Return the rms distance (J,) [m] of differences (P, J, 3) [m]."""
    return np.sqrt((difference**2).sum(axis=2).mean(axis=0))


def left_out(names: tuple[str, ...], start: dict) -> np.ndarray:
    """Predict every posture from the others: measured minus model (P, J, 3) [m]."""
    dataset, catalogue = load_dataset(DATA), load_catalogue()
    whole = Question.of(dataset, dataset.robot, catalogue)
    errors = []
    for i, posture in enumerate(dataset.postures):
        others = dataset.select([name for name in dataset.postures if name != posture])
        session = Question.of(others, others.robot, catalogue).weigh()
        frees = combined(session, names).frees
        fit = session.fitter.fit(frees, start)
        errors.append(dataset.mean[i] - whole.predictor.markers(fit.point)[i])
    return np.array(errors)


def combined(session: Question, names: tuple[str, ...]) -> Candidate:
    """Return several effects as one candidate."""
    known = {candidate.names[0]: candidate for candidate in session.candidates}
    together = known[names[0]]
    for name in names[1:]:
        together = together.with_(known[name])
    return together


def main() -> int:
    """Add the effects of `--order` one after the other."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--order', nargs='*', default=ORDER)
    parser.add_argument('--json', type=Path)
    options = parser.parse_args()
    dataset = load_dataset(DATA)
    session = Question.of(dataset, dataset.robot, load_catalogue()).weigh()
    prior = per_marker(dataset.mean - session.predictor.markers({}))
    print('rms error [mm] at markers p1 p2 p3 p4       fitted                   left out')
    print(f'{"prior description":38s} {_text(prior)}')
    rows, start = [{'added': None, 'fitted': prior.tolist()}], {}
    for count in range(1, len(options.order) + 1):
        names = tuple(options.order[:count])
        fit = session.fitter.fit(combined(session, names).frees, start or None)
        start = fit.point
        errors = left_out(names, start)
        fitted, left = per_marker(dataset.mean - fit.markers), per_marker(errors)
        print(f'+ {names[-1]:36s} {_text(fitted)}   {_text(left)}', flush=True)
        tips = dict(zip(dataset.postures, np.linalg.norm(errors[:, -1], axis=1), strict=True))
        rows.append(
            {
                'added': names[-1],
                'fitted': fitted.tolist(),
                'left_out': left.tolist(),
                'tip_by_posture': tips,
            }
        )
    print(
        'left-out tip error by posture [mm]: '
        + ', '.join(f'{name} {1e3 * error:.0f}' for name, error in tips.items())
    )
    for free, value in fit.point.items():
        print(f'  {free.effect}.{free.key} = {value:.4g} {free.parameter.unit}')
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1))
    return 0


def _text(errors: np.ndarray) -> str:
    return ' '.join(f'{1e3 * error:5.1f}' for error in errors)


if __name__ == '__main__':
    sys.exit(main())
