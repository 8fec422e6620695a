"""
Emulate the motors of a robot on a pseudo-terminal and print the port to give to the driver.

Servos or a board with load cells speak real bytes, wind an emulated arm, and misbehave on
request: type a command on the standard input, `help` lists them. Example:

    emulate dynamixel --robot spatial_3.yaml --write-config servos.yaml
    driver --ros-args -p robot:=spatial_3.yaml -p backend:=dynamixel -p config:=servos.yaml
"""

from __future__ import annotations

import argparse
import signal
import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass
from types import FrameType
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from ..common.errors import InputError
from ..common.files import file_to_write, write_text
from ..drivers.dynamixel.calibration import smallest_spool
from ..drivers.dynamixel.control_table import BAUD_RATES, MODELS
from ..emulator.board import BoardRig, EmulatedBoard
from ..emulator.bus import EmulatedBus
from ..emulator.port import Plug
from ..emulator.rig import Arm, ElasticArm, HangingWeights, Rig, SpringArm, Wire
from ..emulator.servo import Servo
from ..robot import Robot, load_robot

HELP = 'emulate motors on a port of their own, with faults on request'
ARMS = ('plant', 'springs', 'weights')
# [N/m] of the spring that each motor winds against: soft, so that a millimetre of wire changes the
# tension by less than the tension limits of a small arm are apart
SPRING_STIFFNESS = 200.0


@dataclass(frozen=True)
class Emulated:
    """An emulated device: its port, a configuration for the driver, and a description."""

    line: Plug
    config: dict[str, Any]
    words: str


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add = parser.add_argument
    add('kind', choices=('dynamixel', 'serial'), help='what is emulated')
    add('--robot', required=True, help='robot description (YAML), or the name of one')
    add('--model', default='XL330-M077', choices=tuple(MODELS))
    what = 'default: the smallest that is not too coarse for the robot'
    add('--spool-radius', type=float, metavar='MM', help=what)
    add('--baudrate', type=int, default=1_000_000, choices=tuple(BAUD_RATES.values()))
    what = 'what the wires pull: the mock arm, springs, or weights to hang'
    add('--arm', default='plant', choices=ARMS, help=what)
    what = 'loose wire at the start (default 2)'
    add('--slack', type=float, default=2.0, metavar='MM', help=what)
    add('--port', metavar='PATH', help='where the port appears (default: made up)')
    what = 'end when the standard input ends'
    add('--ends-with-input', action='store_true', help=what)
    to, what = file_to_write('--write-config'), 'write a configuration for the driver'
    add('--write-config', type=to, metavar='FILE', help=what)


def run(args: argparse.Namespace) -> int:
    """Serve until the input says quit or a signal comes."""
    robot = load_robot(args.robot)
    emulated = (
        emulated_servos(args, robot) if args.kind == 'dynamixel' else emulated_board(args, robot)
    )
    ending = threading.Event()

    def end(number: int, frame: FrameType | None) -> None:
        ending.set()

    before = {number: signal.signal(number, end) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        serve(args, emulated, ending)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    return 0


def serve(args: argparse.Namespace, emulated: Emulated, ending: threading.Event) -> None:
    """Write the configuration and say where the port is, then wait for the end."""
    with emulated.line as line:
        if args.write_config:
            text = yaml.safe_dump(emulated.config, sort_keys=False, default_flow_style=None)
            write_text(args.write_config, f'# emulated: {emulated.words}\n{text}')
        print(line.port, flush=True)
        print(f'{emulated.words}; type help for faults', file=sys.stderr)
        more = (line.obey, ending, args.ends_with_input)
        threading.Thread(target=listen, args=more, daemon=True).start()
        ending.wait()


def listen(obey: Callable[[str], str], ending: threading.Event, to_the_end: bool) -> None:
    """Execute the commands of the standard input."""
    for text in sys.stdin:
        if not text.strip():
            continue
        if text.strip() == 'quit':
            ending.set()
            return
        try:
            print(obey(text), flush=True)
        except InputError as error:
            print(f'error: {error}', file=sys.stderr, flush=True)
    if to_the_end:
        ending.set()


def emulated_servos(args: argparse.Namespace, robot: Robot) -> Emulated:
    """Return servos on a bus, one for every input."""
    many = range(1, len(robot.inputs) + 1)
    typed = None if args.spool_radius is None else args.spool_radius / 1e3
    radius = typed or smallest_spool(MODELS[args.model], robot.tension_limits[1])
    servos = [Servo(MODELS[args.model], i, args.baudrate) for i in many]
    line = EmulatedBus(Rig(servos, [Wire(i, radius) for i in many], _arm(args, robot)), args.port)
    config: dict[str, Any] = {
        'port': line.port,
        'baudrate': args.baudrate,
        'model': args.model,
        'spool_radius': radius,
        'pull_limits': [-0.05, 0.05],
        'watchdog': 0.2,  # [s]; what is emulated is late with the computer that it runs on
        'motors': {name: {'id': i} for name, i in zip(robot.inputs, many, strict=True)},
    }
    words = f'{len(servos)} x {args.model}, ids 1 to {len(servos)}, spools of {1e3 * radius:g} mm'
    return Emulated(line, config, words)


def emulated_board(args: argparse.Namespace, robot: Robot) -> Emulated:
    """Return a board with a motor and a load cell for every input."""
    rig = BoardRig(_arm(args, robot), len(robot.inputs))
    line = EmulatedBoard(rig, args.port)
    words = f'a board with {rig.channels} motors and load cells, channels 0 to {rig.channels - 1}'
    config = {'port': line.port, **rig.config(robot.inputs)}
    return Emulated(line, config, words)


def _arm(args: argparse.Namespace, robot: Robot) -> Arm:
    m = len(robot.inputs)
    if args.arm == 'springs':
        return SpringArm(np.full(m, SPRING_STIFFNESS), np.full(m, 1e-3 * args.slack))
    if args.arm == 'weights':
        return HangingWeights(np.zeros(m))
    from ..simulation.plant import make_plant

    plant = make_plant(robot)
    shown: dict[str, Any] = {}

    def pulls(tensions: NDArray[np.float64]) -> NDArray[np.float64]:
        shape = plant.respond(tensions)
        shown['tip'] = shape.tip_position.tolist()
        return shape.pulls

    highest = 2.0 * robot.tension_limits[1]
    stretch = 1e-3 if args.kind == 'dynamixel' else 1e-2  # [m] a spring in every wire
    return ElasticArm(pulls, m, highest, 1e-3 * args.slack, shown=shown, stretch=stretch)
