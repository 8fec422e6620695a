"""
Commands for motors: real ones, calibrated with weights; emulated ones, on a port of their own.

calibrate, emulate.
"""

from __future__ import annotations

import argparse
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from contextlib import closing, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..common.errors import InputError, MissingExtraError, choice, short
from ..common.files import write_picture, write_text
from ..common.processes import handled_by
from ..common.words import STANDARD_GRAVITY
from ..common.yaml_reading import dump_yaml, read_yaml
from ..drivers.dynamixel import config as dynamixel
from ..drivers.dynamixel.control_table import BAUD_RATES, MODELS
from ..drivers.serial_board import config as board
from ..emulator.board import BoardRig, EmulatedBoard
from ..emulator.bus import EmulatedBus
from ..emulator.port import Plug
from ..emulator.rig import Arm, ElasticArm, HangingWeights, Rig, SpringArm, Wire
from ..emulator.servo import Servo
from ..robot import Robot, load_robot
from .options import add_file, declare, emit, positive

if TYPE_CHECKING:
    from ..drivers.dynamixel.bus import Bus
    from ..drivers.dynamixel.motor import Motor

KINDS = {'dynamixel': 'motors', 'serial': 'tendons'}  # and what such a configuration has
# [1] of the highest tension, of a check: taut, and so low that nothing would break
CHECK_FRACTION = 0.2
# [s] of reading, so that the mean of a cell is known better than its noise
SECONDS_PER_WEIGHT = 2.0
CELL_UNITS = 'tendon: tension = (counts - zero) * newtons_per_count [N]; errors are 1 sd'
MOTOR_UNITS = 'tendon: [intercept A, slope A/N] of current over tension'
ARMS = ('plant', 'springs', 'weights')
# [N/m] of the spring that each motor winds against: soft, so that a millimetre of wire changes the
# tension by less than the tension limits of a small arm are apart
SPRING_STIFFNESS = 200.0


class Calibrate:
    """
    Calibrate a motor: hang known weights, wind and pay out, fit two lines.

    For every weight the wire is wound up and paid out once at constant speed. The two lines, their
    standard errors and half the gap between them go to a YAML file that the driver's configuration
    names under `calibration`; a picture shows lines and currents.

        motors calibrate dynamixel servos.yaml --robot arm.yaml --tendon left --weights 0.1 0.2

    For a board with load cells the weights hang still on the cell, and one line is fitted:

        motors calibrate serial board.yaml --robot arm.yaml --tendon left --weights 0.1 0.2

    Every day, and after the power was off: have any tendons crept? All are brought to the same
    tension and compared with the last time; the first time makes the reference, --renew another
    one.

        motors calibrate dynamixel servos.yaml --robot arm.yaml --check --tension 1

    In a folder with one robot description and one driver's configuration
    `motors calibrate --check` will do.

    example: python -m tendon_robot_ros motors calibrate dynamixel servos.yaml --robot arm.yaml
        --tendon left --weights 0.1 0.2 0.4
    """

    HELP = 'calibrate tension with known weights; --check: which tendon has crept'

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declare the arguments."""
        add = parser.add_argument
        add('kind', nargs='?', choices=tuple(KINDS))
        add('config', nargs='?', help="the driver's configuration (YAML)")
        add('--robot', help='robot description (YAML)')
        add('--tendon', help='the input whose motor is calibrated')
        add('--weights', nargs='+', type=float, metavar='KG')
        add('--check', action='store_true', help='only look which tendon has crept')
        what = 'of the check (default: a fifth of the limit)'
        add('--tension', type=float, metavar='N', help=what)
        what = 'what the check compares with (default %(default)s)'
        add_file(parser, '--reference', what, default='tendons.yaml')
        add('--renew', action='store_true', help='make this check the reference')
        add('--travel', type=float, default=20.0, metavar='MM')
        add('--speed', type=float, default=5.0, metavar='MM/S')
        what = 'lines of other tendons in it are kept (default %(default)s)'
        add_file(parser, '--output', what, default='calibration.yaml')
        add_file(parser, '--picture', 'default: beside the output, as PNG')
        add('--yes', action='store_true', help='do not wait for Enter')
        declare(parser, '--json')

    def run(self, args: argparse.Namespace) -> int:
        """Measure, fit, write, say what was found."""
        if args.check:
            find_files(args)
            return check_tendons(args)
        if None in (args.kind, args.config, args.robot):
            raise InputError(
                'motors calibrate: expected dynamixel or serial, a configuration and --robot, '
                'or --check'
            )
        if args.tendon is None or args.weights is None:
            raise InputError('motors calibrate: expected --tendon and --weights, or --check')
        if not all(0.0 < mass <= 50.0 for mass in args.weights):
            raise InputError(f'--weights: expected masses from 0 to 50 kg, got {args.weights}')
        if Path(args.output).exists():
            _content(args.output)  # lines of other tendons in it are kept
        try:
            calibrate = calibrate_cell if args.kind == 'serial' else calibrate_motor
            calibrate(args)
        except ModuleNotFoundError as error:
            raise MissingExtraError(error.name or args.kind, args.kind) from None
        return 0


def find_files(args: argparse.Namespace) -> None:
    """Fill in missing arguments from the only description and configuration in this folder."""
    contents: dict[str, dict[str, Any]] = {}
    for path in sorted(Path().glob('*.yaml')):
        with suppress(InputError):
            contents[str(path)] = _content(str(path))
    if args.robot is None:
        robots = [name for name, content in contents.items() if 'sections' in content]
        args.robot = _only(robots, 'a robot description', '--robot FILE')
    if args.config is None:
        drivers = {
            name: kind
            for name, content in contents.items()
            for kind, key in KINDS.items()
            if key in content and 'port' in content and args.kind in (None, kind)
        }
        args.config = _only(
            list(drivers), "a driver's configuration", 'dynamixel CONFIG, or serial CONFIG'
        )
        args.kind = drivers[args.config]


def _only(names: list[str], what: str, remedy: str) -> str:
    if len(names) != 1:
        came = f'{len(names)} of them ({", ".join(names)})' if names else 'none'
        raise InputError(
            f'motors calibrate --check: expected {what} in this folder, got {came}; say {remedy}'
        )
    return names[0]


def check_tendons(args: argparse.Namespace) -> int:
    """Compare the tendons with the reference; return 1 if one has crept."""
    from ..drivers import make_driver
    from ..drivers.tendon_check import changes, measure_reference, read_reference, save_reference

    robot, path = load_robot(args.robot), Path(args.reference)
    content = _content(args.config)
    before = read_reference(path) if path.exists() and not args.renew else None
    tension = args.tension if before is None else before.tension
    if before is not None and args.tension not in (None, before.tension):
        raise InputError(f'--tension: {path} was made at {before.tension:g} N; or use --renew')
    with make_driver(args.kind, robot, content, mode='tension', source=args.config) as driver:
        if tension is None:
            tension = CHECK_FRACTION * float(driver.limits[:, 1].min())
        wait_for(args, f'pulling all tendons with {tension:g} N; keep hands away')
        now = measure_reference(driver, tension)
    if before is None:
        save_reference(path, now)
        emit(args, {'written': str(path)}, f'written: {path}; the next check compares with it')
        return 0
    crept = changes(before, now)
    texts = [text for change in crept if (text := change.text(tension))]
    worst = max(abs(change.pull) for change in crept)
    lines = [*texts] or [f'no tendon has crept (at most {1e3 * worst:.2f} mm)']
    lines.append(f'since {before.date}, at {tension:g} N')
    if texts:
        lines.append(
            'mend what has slipped and calibrate it, or take it as it is: --check --renew'
        )
    content = {'crept': texts, 'largest': worst, 'since': str(before.date), 'tension': tension}
    emit(args, content, '\n'.join(lines))
    return 1 if texts else 0


def _content(path: str) -> dict[str, Any]:
    """Read a YAML file of keys with values."""

    def refuse(reason: str) -> InputError:
        return InputError(f'{path}: expected keys with values (YAML), got {reason}')

    content = read_yaml(Path(path), refuse)
    if not isinstance(content, dict):
        raise refuse(short(content))
    return content


def calibrate_motor(args: argparse.Namespace) -> None:
    """Measure currents under weights, fit two lines, write and draw them."""
    from ..drivers.dynamixel.motions import wind_weight

    if not (1.0 <= args.travel <= 1000.0 and 0.1 <= args.speed <= 200.0):
        raise InputError('--travel, --speed: expected 1 to 1000 mm and 0.1 to 200 mm/s')
    bus, motor, wire = open_motor(args)
    with closing(bus):
        points = []
        for mass in args.weights:
            wait_for(
                args,
                f'hang {mass:g} kg on {args.tendon}: it stands on the ground, the wire is just '
                'taut; keep hands away',
            )
            weight = mass * STANDARD_GRAVITY
            point = wind_weight(bus, motor, weight, 1e-3 * args.travel, 1e-3 * args.speed)
            currents = f'winding {point.wind:.4f} A, paying out {point.pay_out:.4f} A'
            print(f'  {point.tension:.3f} N: {currents}', file=sys.stderr)
            points.append(point)
    fitted = dynamixel.fit_current(points)
    half_gap = fitted.uncertainty(max(point.tension for point in points))
    lines = dynamixel.to_mapping(fitted, points, wire.model.name, wire.spool.radius)
    _write(Path(args.output), args.tendon, lines, MOTOR_UNITS)
    picture = Path(args.picture or f'{Path(args.output).with_suffix("")}_{args.tendon}.png')
    draw(fitted, points, args.tendon, picture)
    text = [
        f'{args.tendon}: {what} I = {line.intercept:.4f} A + {line.slope:.4f} A/N T'
        for what, line in (('winding', fitted.wind), ('paying out', fitted.pay_out))
    ]
    text.append(f'half the gap: {half_gap:.3f} N: that is how well the current tells the tension')
    text.append(f'written: {args.output}, {picture}')
    content = {'lines': lines, 'half_gap': half_gap, 'written': args.output}
    emit(args, content, '\n'.join(text))


def chosen(args: argparse.Namespace, tendons: Sequence[Any]) -> Any:
    """Return the one of some tendons that --tendon names."""
    by_name = {tendon.name: tendon for tendon in tendons}
    return by_name[choice('--tendon', args.tendon, tuple(by_name))]


def wait_for(args: argparse.Namespace, text: str, ask: str = 'press Enter when ready ') -> None:
    """Say what is needed before a measurement, and wait for it."""
    print(text, file=sys.stderr)
    if not args.yes:
        input(ask)


def open_motor(args: argparse.Namespace) -> tuple[Bus, Motor, Any]:
    """Open the bus and find the motor; its current may lift twice the heaviest weight."""
    from ..drivers.dynamixel.bus import Bus
    from ..drivers.dynamixel.motor import Motor
    from ..drivers.dynamixel.servos import shake_hands

    content = {**_content(args.config), 'allow_coarse': True}
    config = dynamixel.read_config(load_robot(args.robot), content, 'tension', args.config)
    heaviest = 2.0 * STANDARD_GRAVITY * max(args.weights)
    wire = replace(chosen(args, config.motors), tension_limit=heaviest)
    motor = Motor(wire.motor, (wire,), 'pull')
    bus = Bus(config.port, config.baudrate, config.answer_time)
    bus.open(lambda: shake_hands(bus, config, {wire.motor: motor}))
    return bus, motor, wire


def _write(path: Path, tendon: str, lines: dict[str, Any], units: str) -> None:
    """Put the lines of a tendon into the file, keep those of the others."""
    content = {**(_content(str(path)) if path.exists() else {}), tendon: lines}
    write_text(path, f'# {units}; written by calibrate\n{dump_yaml(content)}')


def draw(
    fitted: dynamixel.Calibration, points: list[dynamixel.CurrentPoint], tendon: str, path: Path
) -> None:
    """Draw currents and lines over tension."""
    from matplotlib.figure import Figure

    from ..common.colours import ERROR, MEASURED, PREDICTED
    from ..report.pictures import STYLES

    size, dots, _ = STYLES['lines']
    figure = Figure(figsize=size, layout='constrained')
    axes = figure.add_subplot()
    tensions = [point.tension for point in points]
    ends = [0.0, 1.05 * max(tensions)]
    for name, words, colour in (
        ('wind', 'winding', MEASURED),
        ('pay_out', 'paying out', PREDICTED),
    ):
        currents = [getattr(point, name) for point in points]
        axes.plot(tensions, currents, 'o', color=colour, label=words)
        axes.plot(ends, [getattr(fitted, name).current(t) for t in ends], color=colour)
    label = f'mean, ±{fitted.uncertainty(max(tensions)):.2g} N'
    axes.plot(ends, [fitted.mean.current(t) for t in ends], '--', color=ERROR, label=label)
    axes.set(xlabel='tension [N]', ylabel='current [A]', title=f'{tendon}: calibration')
    axes.legend()
    axes.grid(alpha=0.3)
    write_picture(figure, path, dots)


def calibrate_cell(args: argparse.Namespace) -> None:
    """Measure counts under weights, fit a line and write it."""
    from ..drivers.serial_board.link import BoardLink

    robot, content = load_robot(args.robot), _content(args.config)
    config = board.read_config(robot, content, 'tension', args.config, calibrated=False)
    tendon = chosen(args, config.tendons)
    link = BoardLink(config.port, config.baudrate)
    link.open(lambda: link.identify(config))
    points: list[board.CountsPoint] = []
    with closing(link):
        for mass in (0.0, *args.weights):
            hang = f'hang {mass:g} kg on' if mass else 'nothing may pull at'
            text = f'{hang} the load cell of {tendon}'
            wait_for(args, text, 'press Enter when it hangs still ')
            force = mass * STANDARD_GRAVITY
            point = link.measure_counts(tendon.channel, force, SECONDS_PER_WEIGHT)
            counts = f'{point.mean:.0f} ± {point.spread:.0f} counts'
            print(f'  {force:.3f} N: {counts}', file=sys.stderr)
            points.append(point)
    cell = board.fit_counts(points)
    heaviest = max(point.tension for point in points)
    text = (
        f'{tendon}: tension = (counts - {cell.zero:.0f}) * {cell.newtons_per_count:.5g} N\n'
        f'uncertainty: {cell.uncertainty(heaviest):.2g} N (1 sd) at {heaviest:.3g} N'
    )
    line = board.cell_mapping(cell, points)
    _write(Path(args.output), args.tendon, line, CELL_UNITS)
    emit(args, {'line': line, 'written': args.output}, f'{text}\nwritten: {args.output}')


class Emulate:
    """
    Emulate the motors of a robot on a pseudo-terminal and print the port to give to the driver.

    Servos or a board with load cells speak real bytes, wind an emulated arm, and misbehave on
    request: type a command on the standard input, `help` lists them. The driver goes on with
    `-p robot:=spatial_3 -p backend:=dynamixel -p config:=servos.yaml`.

    example: python -m tendon_robot_ros motors emulate dynamixel --robot spatial_3
        --output servos.yaml
    """

    HELP = 'emulate motors on a port of their own, with faults on request'

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declare the arguments."""
        add = parser.add_argument
        add('kind', choices=('dynamixel', 'serial'), help='what is emulated')
        add('--robot', required=True, help='robot description (YAML), or the name of one')
        what = 'kind of servo (default: %(default)s)'
        add('--servo', default='XL330-M077', choices=tuple(MODELS), help=what)
        what = 'its radius (default: the smallest that is not too coarse for the robot)'
        add('--spool', type=positive, metavar='MM', help=what)
        add('--baudrate', type=int, default=1_000_000, choices=tuple(BAUD_RATES.values()))
        what = 'what the wires pull: the mock arm, springs, or weights to hang'
        add('--arm', default='plant', choices=ARMS, help=what)
        what = 'loose wire at the start (default 2)'
        add('--slack', type=float, default=2.0, metavar='MM', help=what)
        add_file(parser, '--port', 'where the port appears (default: made up)', 'PATH')
        add('--ends-with-input', action='store_true', help='end when the standard input ends')
        add_file(parser, '--output', 'write a configuration for the driver')

    def run(self, args: argparse.Namespace) -> None:
        """Serve until the input says quit or a signal comes."""
        emulated = emulated_servos if args.kind == 'dynamixel' else emulated_board
        plug, config, words = emulated(args, load_robot(args.robot))
        ending = threading.Event()
        with handled_by(lambda _: ending.set(), (signal.SIGINT, signal.SIGTERM)), plug as line:
            if args.output:
                write_text(args.output, f'# emulated: {words}\n{dump_yaml(config)}')
            more = (line.obey, ending, args.ends_with_input)
            threading.Thread(target=listen, args=more, daemon=True).start()
            print(line.port, flush=True)  # who reads it gives all threads their priority
            print(f'{words}; type help for faults', file=sys.stderr)
            ending.wait()


# port, configuration for the driver, description
Emulated = tuple[Plug, dict[str, Any], str]


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
    smallest = dynamixel.smallest_spool(MODELS[args.servo], robot.tension_limits[1])
    radius = args.spool / 1e3 if args.spool else smallest
    servos = [Servo(MODELS[args.servo], i, args.baudrate) for i in many]
    line = EmulatedBus(Rig(servos, [Wire(i, radius) for i in many], _arm(args, robot)), args.port)
    config: dict[str, Any] = {
        'port': line.port,
        'baudrate': args.baudrate,
        'model': args.servo,
        'spool_radius': radius,
        'pull_limits': [-0.05, 0.05],
        'watchdog': 0.2,  # [s]; what is emulated is late with the computer that it runs on
        'motors': {name: {'id': i} for name, i in zip(robot.inputs, many, strict=True)},
    }
    words = f'{len(servos)} x {args.servo}, ids 1 to {len(servos)}, spools of {1e3 * radius:g} mm'
    return line, config, words


def emulated_board(args: argparse.Namespace, robot: Robot) -> Emulated:
    """Return a board with a motor and a load cell for every input."""
    rig = BoardRig(_arm(args, robot), len(robot.inputs))
    line = EmulatedBoard(rig, args.port)
    words = f'a board with {rig.channels} motors and load cells, channels 0 to {rig.channels - 1}'
    return line, {'port': line.port, **rig.config(robot.inputs)}, words


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
