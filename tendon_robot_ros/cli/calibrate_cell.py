"""Calibrate the load cell of a board with known weights: the part of `calibrate serial`."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..exceptions import InputError
from ..robot import load_robot
from ..robot_checks import parse_yaml

if TYPE_CHECKING:
    from ..drivers.serial_board.calibration import Point

SECONDS = 2.0  # per weight
UNITS = 'tendon: tension = (counts - zero) * newtons_per_count [N]; errors are 1 sd'


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Measure and fit; print what was found; return what is written for the tendon."""
    from ..drivers.serial_board import calibration
    from ..drivers.serial_board.config import read_config

    robot = load_robot(args.robot)
    content = parse_yaml(Path(args.config).read_text(encoding='utf-8'))
    if not isinstance(content, dict):
        raise InputError(f'{args.config}: expected keys with values, got {content!r}')
    config = read_config(robot, content, 'tension', args.config, calibrated=False)
    tendon = next((tendon for tendon in config.tendons if tendon.name == args.tendon), None)
    if tendon is None:
        raise InputError(
            f'--tendon: expected one of {", ".join(robot.inputs)}, got {args.tendon!r}'
        )
    link, channels = calibration.connect(config)
    points: list[Point] = []
    try:
        for mass in (0.0, *args.weights):
            hang = f'hang {mass:g} kg on' if mass else 'nothing may pull at'
            print(f'{hang} the load cell of {tendon}', file=sys.stderr)
            if not args.yes:
                input('press Enter when it hangs still ')
            force = mass * calibration.GRAVITY
            points.append(calibration.measure(link, channels, tendon.channel, force, SECONDS))
            print(
                f'  {force:.3f} N: {points[-1].mean:.0f} ± {points[-1].spread:.0f} counts',
                file=sys.stderr,
            )
    finally:
        link.close()
    cell = calibration.fit(points)
    heaviest = max(point.tension for point in points)
    print(
        f'{tendon}: tension = (counts - {cell.zero:.0f}) * {cell.newtons_per_count:.5g} N\n'
        f'uncertainty: {cell.uncertainty(np.array(heaviest)):.2g} N (1 sd) at {heaviest:.3g} N'
    )
    return calibration.to_mapping(cell, points)
