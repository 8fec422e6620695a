"""What a diagnosis says of the arm as it is built, and of readings that were left out."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..common.words import digits, listed, mm
from ..diagnosis.result import Diagnosis

KIND_NAMES = {
    'cell_stiffness': 'stiffness of the cells',
    'cell_kink': 'kinks at rest',
    'cell_kink_across': 'kinks across the plane',
    'channel_gain': 'gains of the inputs',
    'hole_radius': 'holes',
    'pull_zero': 'zeros of the pulls',
    'position': 'position of the tracker',
    'rotation': 'rotation of the tracker',
}
READINGS_LISTED_MAX = 6  # readings that are listed one by one


def amount(value: float, unit: str, sign: bool = False) -> str:
    """Return a size with its unit as a person reads it."""
    if unit == 'm':
        return mm(value, 2)
    scale, mark = (100.0, ' %') if unit == '1' else (float(np.degrees(1.0)), '°')
    return f'{"+" if sign and value > 0.0 else ""}{digits(scale * value, 2)}{mark}'


def as_built(diagnosis: Diagnosis) -> list[str]:
    """Say how much the arm scatters, with 95 % intervals, and what is out of line."""
    report = diagnosis.details.get('as_built')
    if not report:
        return []
    scatter = ', '.join(_scatter(kind) for kind in report['kinds'] if _is_told(kind))
    lines = [f'the arm as built scatters by (1 sd, 95 %): {scatter}'] if scatter else []
    strange = [
        f'{name} ({amount(kind["members"][name]["value"], kind["unit"], True)})'
        for kind in report['kinds']
        for name in kind['out_of_line']
        if kind['kind'] not in ('position', 'rotation')
    ]
    if strange:
        lines.append(f'out of line with the others: {listed(strange)}')
    hidden = [KIND_NAMES[kind['kind']] for kind in report['kinds'] if not _is_told(kind)]
    if hidden:
        lines.append(f'these measurements do not tell: {", ".join(hidden)}')
    return lines


def _is_told(kind: dict[str, Any]) -> bool:
    return bool(kind['told'] or kind['size'] > 0.3 * kind['plausible'])


def _scatter(kind: dict[str, Any]) -> str:
    low, high = (amount(kind[key], kind['unit']) for key in ('low', 'high'))
    return f'{KIND_NAMES[kind["kind"]]} {amount(kind["size"], kind["unit"])} ({low} to {high})'


def left_out(diagnosis: Diagnosis) -> list[str]:
    """Name the readings and trials that the others contradict, and postures that do not settle."""
    unsettled = diagnosis.details.get('unsettled') or []
    outliers = diagnosis.details.get('outliers') or []
    trials = [f'trial {o["trial"]} of posture {o["posture"]}' for o in outliers if not o['marker']]
    readings = [o for o in outliers if o['marker']]
    sentences = []
    if unsettled:
        named = [f'posture {name}' for name in unsettled]
        sentences.append(f'left out, because the description has no equilibrium: {listed(named)}')
    if trials:
        sentences.append(f'left out, because the other trials contradict it: {listed(trials)}')
    if 0 < len(readings) <= READINGS_LISTED_MAX:
        named = [
            f'marker {o["marker"]} in trial {o["trial"]} of posture {o["posture"]} '
            f'({mm(o["distance"])})'
            for o in readings
        ]
        sentences.append(f'left out, because the other trials contradict it: {listed(named)}')
    elif readings:
        far = max(o['distance'] for o in readings)
        sentences.append(
            f'left out: {len(readings)} readings of single markers that the other trials '
            f'contradict (by up to {mm(far)})'
        )
    return sentences
