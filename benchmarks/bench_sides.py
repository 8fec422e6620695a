"""
Where a target ends from different sides, of arms that remember: by a model that does, and without.

Hysteresis of the bends, friction that remembers and backlash, planar and spatial, exact and as
built, by tensions and by pulls; two targets from three sides for every seed. The spread is how far
an end is from the mean of the three.

example: python benchmarks/bench_sides.py --seeds 5
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from machine import tell

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / 'test'))
from friction_rig import BENDS, MORE_SIDES, SIDES, SPRINGS, from_sides


def main() -> None:
    """Print a line per combination, means over all targets."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument('--seeds', type=int, default=5)
    parser.add_argument('--json', type=Path)
    options = parser.parse_args()
    results = {}
    for arm, memory, wires, pull, built in (
        *SIDES,
        *MORE_SIDES,
        ('spatial', BENDS, SPRINGS, False, True),
    ):
        runs = [
            from_sides(arm, memory, wires, pull, built, seed)
            for seed in range(2, 2 + options.seeds)
        ]
        spread, off = (
            {k: 1e3 * np.array([r[i][k] for r in runs]) for k in runs[0][i]} for i in (0, 1)
        )
        within = np.sum(3.0 * spread[True].max(axis=1) < spread[False].max(axis=1))
        kinds = 'pulls' if pull else 'tensions', 'as built' if built else 'exact'
        name = ', '.join((arm, *memory, *wires, *kinds))
        results[name] = {
            'spread [mm]': round(float(spread[True].mean()), 3),
            'spread without memory [mm]': round(float(spread[False].mean()), 3),
            'off [mm]': round(float(off[True].mean()), 3),
            'off without memory [mm]': round(float(off[False].mean()), 3),
            'seeds within a third': f'{within} of {len(runs)}',
        }
        print(f'{name}: {results[name]}', flush=True)
    tell(results, options.json)


if __name__ == '__main__':
    main()
