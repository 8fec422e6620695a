"""
Emulate the servos of a robot on a pseudo-terminal and print the port to give to the driver.

The servos speak real bytes, wind an emulated arm, and misbehave on request: type a command on
the standard input, `help` lists them. Example:

    emulate dynamixel --robot spatial_3.yaml --write-config servos.yaml
    driver --ros-args -p robot:=spatial_3.yaml -p backend:=dynamixel -p config:=servos.yaml
"""

from __future__ import annotations

import argparse
import signal
import sys
import threading
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from ..drivers.dynamixel.tables import BAUD_RATES, MODELS
from ..drivers.dynamixel.units import smallest_spool
from ..drivers.emulator.arm import Arm, HangingWeights, RelaxedArm, SpringArm
from ..drivers.emulator.commands import obey
from ..drivers.emulator.line import Line
from ..drivers.emulator.rig import Rig, Wire
from ..drivers.emulator.servo import Servo
from ..exceptions import InputError
from ..robot import Robot, load_robot

NAME = 'emulate'
HELP = 'emulate motors on a port of their own, with faults on request'
ARMS = ('plant', 'springs', 'weights')
SPRING = 200.0  # [N/m]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument('kind', choices=('dynamixel',), help='what is emulated')
    parser.add_argument('--robot', required=True, help='robot description (YAML)')
    parser.add_argument('--model', default='XL330-M077', choices=tuple(MODELS))
    parser.add_argument(
        '--spool-radius',
        type=float,
        metavar='M',
        help='default: the smallest that is not too coarse for the robot',
    )
    parser.add_argument(
        '--baudrate', type=int, default=1_000_000, choices=tuple(BAUD_RATES.values())
    )
    parser.add_argument(
        '--arm',
        default='plant',
        choices=ARMS,
        help='what the wires pull: the mock arm, springs, or weights to hang',
    )
    parser.add_argument(
        '--slack',
        type=float,
        default=0.002,
        metavar='M',
        help='loose wire at the start (default 0.002)',
    )
    parser.add_argument('--port', metavar='PATH', help='where the port appears (default: made up)')
    parser.add_argument(
        '--ends-with-input', action='store_true', help='end when the standard input ends'
    )
    parser.add_argument(
        '--write-config', metavar='FILE', help='write a configuration for the driver'
    )


def run(args: argparse.Namespace) -> int:
    """Serve until the input says quit or a signal comes."""
    robot = load_robot(args.robot)
    radius = args.spool_radius or smallest_spool(MODELS[args.model], robot.tension_limits[1])
    servos = [Servo(MODELS[args.model], i + 1, args.baudrate) for i in range(len(robot.inputs))]
    wires = [Wire(i + 1, radius) for i in range(len(robot.inputs))]
    line = Line(Rig(servos, wires, _arm(args, robot)), args.port)
    if args.write_config:
        _write_config(args, robot, radius, line.port)
    ending = threading.Event()

    def end(number: int, frame: FrameType | None) -> None:
        ending.set()

    before = {number: signal.signal(number, end) for number in (signal.SIGINT, signal.SIGTERM)}
    with line:
        print(line.port, flush=True)
        print(
            f'{len(servos)} x {args.model}, ids 1 to {len(servos)}, spools of {1e3 * radius:g} '
            'mm; type help for faults',
            file=sys.stderr,
        )
        more = (line, ending, args.ends_with_input)
        listener = threading.Thread(target=_listen, args=more, daemon=True)
        listener.start()
        ending.wait()
    for number, handler in before.items():
        signal.signal(number, handler)
    return 0


def _listen(line: Line, ending: threading.Event, to_the_end: bool) -> None:
    """Obey what comes in on the standard input."""
    for text in sys.stdin:
        if not text.strip():
            continue
        if text.strip() == 'quit':
            ending.set()
            return
        try:
            print(obey(line, text), flush=True)
        except InputError as error:
            print(f'error: {error}', file=sys.stderr, flush=True)
    if to_the_end:
        ending.set()


def _arm(args: argparse.Namespace, robot: Robot) -> Arm:
    m = len(robot.inputs)
    if args.arm == 'springs':
        return SpringArm(np.full(m, SPRING), np.full(m, args.slack))
    if args.arm == 'weights':
        return HangingWeights(np.zeros(m))
    from ..model.plant import make_plant

    plant = make_plant(robot)
    shown: dict[str, Any] = {}

    def pulls(tensions: NDArray[np.float64]) -> NDArray[np.float64]:
        shape = plant.respond(tensions)
        shown['tip'] = shape.tip_position.tolist()
        return shape.pulls

    return RelaxedArm(pulls, m, 2.0 * robot.tension_limits[1], args.slack, shown=shown)


def _write_config(args: argparse.Namespace, robot: Robot, radius: float, port: str) -> None:
    content: dict[str, Any] = {
        'port': port,
        'baudrate': args.baudrate,
        'model': args.model,
        'spool_radius': radius,
        'pull_limits': [-0.05, 0.05],
        'motors': {name: {'id': i + 1} for i, name in enumerate(robot.inputs)},
    }
    text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None)
    Path(args.write_config).write_text(f'# emulated servos, docs/dynamixel.md\n{text}')
