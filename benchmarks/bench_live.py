"""
How often the story of `make live` comes true, each run with another hidden effect.

Runs `live --headless` with the seeds 1 to N, one after the other; prints a line each and the
success rate, writes JSON. `--hidden` fixes what is hidden, such as none or soft_cell.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
import time
from pathlib import Path

from machine import machine


def run(seed: int, hidden: str, postures: int) -> dict:
    command = [sys.executable, '-m', 'tendon_robot_ros', 'live', '--headless', '--reveal']
    command += ['--seed', str(seed), '--postures', str(postures)]
    command += ['--hidden', hidden] if hidden else []
    began = time.perf_counter()
    done = subprocess.run(command, capture_output=True, text=True)
    lines = done.stdout.strip().splitlines() or ['']
    named = re.search(r'^hidden: (\w+)', done.stdout, re.M)
    return {
        'seed': seed,
        'hidden': named[1] if named else '?',
        'true': done.returncode == 0,
        'end': lines[-2] if len(lines) > 1 else done.stderr.strip()[-200:],
        'seconds': round(time.perf_counter() - began, 1),
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--runs', type=int, default=20)
    parser.add_argument('--first', type=int, default=1, help='first seed')
    parser.add_argument('--hidden', default='')
    parser.add_argument('--postures', type=int, default=14)
    parser.add_argument('--json', type=Path)
    args = parser.parse_args()
    found = []
    for seed in range(args.first, args.first + args.runs):
        found.append(run(seed, args.hidden, args.postures))
        one = found[-1]
        mark = 'true ' if one['true'] else 'FALSE'
        print(f'{one["hidden"]:22} {mark} {one["seconds"]:6.1f} s  {one["end"]}', flush=True)
    count = sum(one['true'] for one in found)
    print(f'{count} of {len(found)} came true')
    if args.json:
        args.json.write_text(json.dumps({'machine': machine(), 'runs': found}, indent=1))
    return 0 if count >= 0.9 * len(found) else 1


if __name__ == '__main__':
    sys.exit(main())
