"""
What `diagnose` and `improve` say of the recorded sets: names, values, intervals, processor time.

The sets: arms as they are built and the blind cases of test/data (an independent engine made
them, truth.yaml has the answers), the shipped examples, and the two real arms of data/. Everything
goes through the public names of the package, so that the figures of two versions compare.

example: python benchmarks/diagnosed.py --sets as_built blind --json figures.json
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import yaml
from machine import tell

from tendon_robot_ros import diagnose, improve, join, load_dataset

ROOT = Path(__file__).resolve().parents[1]
ELSEWHERE = {'case_b': ROOT / 'data/hinge_friction', 'case_f': ROOT / 'data/tendon_stiffness'}


def recorded(name: str) -> dict[str, dict[str, Any]]:
    """Diagnose every case of a set whose answers are known."""
    folder = ROOT / 'test' / 'data' / name
    truths = yaml.safe_load((folder / 'truth.yaml').read_text(encoding='utf-8'))
    return {case: told(ELSEWHERE.get(case, folder / case) / 'fit', truth)
            for case, truth in truths.items()}  # fmt: skip


def told(folder: Path, truth: dict[str, Any]) -> dict[str, Any]:
    """Diagnose a folder; say what was named, and whether the intervals hold the truth."""
    dataset, start = load_dataset(folder), time.process_time()
    found = diagnose(dataset)
    took, effects = time.process_time() - start, found.effects
    made: dict[str, Any] = {
        'verdict': str(found.verdict),
        'effects': ' '.join(effect.name for effect in effects),
        'class': ' '.join(found.cannot_tell_apart),
        'error_before_mm': 1e3 * found.error_before,
        'error_after_mm': 1e3 * found.error_after,
        'processor_s': took,
    }
    for effect in effects:
        for key, value in effect.parameters.items():
            name = f'{effect.name}.{key}'
            made[name] = {'value': value.value, 'low': value.low, 'high': value.high}
            true = truth['parameters'].get(key) if effect.name == truth['hidden'] else None
            if true is not None:
                made[name]['holds'] = str(value.low <= true <= value.high)
    return made


def improved(folders: list[str]) -> dict[str, Any]:
    """Improve the description of a real arm; the errors of postures left out [mm]."""
    parts, start = [load_dataset(ROOT / folder) for folder in folders], time.process_time()
    found = improve(parts[0] if len(parts) == 1 else join(parts)).to_json()
    took, taken = time.process_time() - start, found['steps'][: found['taken'] + 1]
    return {
        'processor_s': took,
        'steps': '; '.join(step['joined'] for step in taken[1:]),
        'fitted_mm': {'all': rms(taken[-1]['fitted']), 'tip': 1e3 * taken[-1]['fitted'][-1]},
        'left_out_mm': {'all': rms(found['chosen']), 'tip': 1e3 * found['chosen'][-1]},
    }


def rms(errors: list[float]) -> float:
    """Return the rms [mm] of errors [m], one per marker."""
    return 1e3 * (sum(error**2 for error in errors) / len(errors)) ** 0.5


RAW = 'tentacle', 'trunk/base', 'trunk/payload_100'  # real arms, diagnosed as they come
UNKNOWN = {'hidden': '', 'parameters': {}}  # truth
SETS = {
    'as_built': lambda: recorded('as_built'),
    'blind': lambda: recorded('blind'),
    'tentacle': lambda: improved(['data/tentacle']),
    'trunk': lambda: improved(['data/trunk/base', 'data/trunk/payload_100']),
    'raw': lambda: {name: told(ROOT / 'data' / name, UNKNOWN) for name in RAW},
}


def main() -> None:
    """Go through the sets."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--sets', nargs='+', default=list(SETS), choices=list(SETS))
    parser.add_argument('--json', type=Path)
    options = parser.parse_args()
    tell({name: SETS[name]() for name in options.sets}, options.json)


if __name__ == '__main__':
    main()
