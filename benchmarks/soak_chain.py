"""
Break the whole chain for half an hour: controller and driver on emulated servos, a user beside.

    python benchmarks/soak_chain.py [--minutes 30] [--mode pull] [--busy 2] [--at-limit]

Targets come five times a second, a fault every ten seconds on average: of the bus and the motors
(those of soak_dynamixel.py), stops of every kind, killed, ended and frozen processes, a second
controller, commands and targets that are wrong, models that are broken. Targets: no goal beyond
the limits, no tension beyond its limit, no process that died, no wire wound beyond the bound. The
wires move the mock arm (`--robot` takes another one), or with `--arm springs` a spring each; with
`--at-limit` each wire in turn is to pull with the limit, and how often and by how much the wires
pass it is counted. In pull mode the current of the motors limits the tension
(docs/dynamixel.md): what current and dry friction of a motor hold may not pass the limit, the
tension by no more than the drag of a motor that the wire turns. Prints what was passed each
minute, at the end all figures as JSON and a short table. Not under `nice`: see bench_stop.py.
"""

import argparse
import contextlib
import math
import os
import signal
import tempfile
import time
from pathlib import Path

import numpy as np
from chain import Chain, Load
from emulated_bus import ROBOT, Passings, driver_for
from machine import machine, tell
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from sensor_msgs.msg import JointState
from soak_dynamixel import KINDS as OF_THE_BUS
from soak_dynamixel import Breaker, too_strong
from std_msgs.msg import Bool

from tendon_robot_ros.common.errors import TendonRobotError
from tendon_robot_ros.drivers.dynamixel.homing import BACK_OFF_M
from tendon_robot_ros.emulator.rig import BALANCED_N
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.robot import load_robot
from tendon_robot_ros.ros.shared.messages import COMMAND, LATCHED

BETWEEN = 10.0  # [s] from fault to fault, on average
PERIOD = 0.2  # [s] of the targets
ROUND = 20.0  # [s] of a round of the path
BOUNDS = {'pull_limits': [-0.03, 0.03], 'home_travel': 0.02}  # [m]
NOT_HERE = ('busy process', 'second process')  # they need a driver in this process
BROKEN_MODELS = ('name: [', 'nobody', 'x: ' + 'y' * 2_000_000)


class ChainBreaker(Breaker):
    """Breaks bus, motors, processes and topics; mends later, without waiting."""

    def __init__(self, chain, seed):
        super().__init__(chain.servos, None, seed)
        self.chain, self.user = chain, chain.user
        self.later = []  # (time, what to do then)
        self.stop = self.user.create_publisher(Bool, 'stop', COMMAND)
        self.latched_stop = self.user.create_publisher(Bool, 'stop', LATCHED)
        self.rival = self.user.create_publisher(JointState, 'tendon_command', COMMAND)
        self.model = self.user.create_client(SetParameters, 'controller/set_parameters')

    def for_a_while(self, broken, mended):
        self.servos.say(broken)
        self.in_a_while(lambda: self.servos.say(mended))

    def in_a_while(self, action, longest=1.5):
        self.later.append((time.monotonic() + self.random.uniform(0.05, longest), action))

    def work(self, now):
        """Do what is due."""
        due, self.later = ([e for e in self.later if (e[0] <= now) == is_due]
                           for is_due in (True, False))  # fmt: skip
        for _, action in due:
            action()

    def strike(self):
        name = self.random.choice(sorted(ALL))
        self.done[name] += 1
        ALL[name](self, self.random.choice(self.ids))

    def stop_topic(self, _):
        publisher = self.random.choice((self.stop, self.latched_stop))
        publisher.publish(Bool(data=True))
        self.in_a_while(lambda: publisher.publish(Bool(data=False)))

    def end(self, name, number):
        self.chain.signal(name, number)
        self.chain.again(name, -number if number == signal.SIGKILL else 0)

    def freeze(self, name):
        self.chain.signal(name, signal.SIGSTOP)
        self.in_a_while(lambda: self.chain.signal(name, signal.SIGCONT))

    def wrong_targets(self, _):
        for x, z in ((math.nan, 0.1), (5.0, 0.1), (1e300, 0.0), (0.0, -0.3)):
            self.user.aim(x, 0.0, z)

    def rival_commands(self, value):
        names = list(load_robot(self.chain.robot).inputs)
        for _ in range(30):
            message = JointState(name=names)
            message.effort = message.position = [value] * len(names)
            self.rival.publish(message)
            self.user.spin(0.01)

    def new_model(self, text):
        value = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=text)
        request = SetParameters.Request(parameters=[Parameter(name='model', value=value)])
        if self.model.service_is_ready():
            self.model.call_async(request)


def _service(name):
    return lambda breaker, _: breaker.user.call(name, 1.0)


def _end(name, number):
    return lambda breaker, _: breaker.end(name, number)


OF_THE_CHAIN = {
    'stop topic': ChainBreaker.stop_topic,
    'stop of the driver': _service('driver/stop'),
    'stop of the controller': _service('controller/stop'),
    'controller killed': _end('controller', signal.SIGKILL),
    'controller ended': _end('controller', signal.SIGTERM),
    'driver killed': _end('driver', signal.SIGKILL),
    'driver ended': _end('driver', signal.SIGINT),
    'controller frozen': lambda breaker, _: breaker.freeze('controller'),
    'driver frozen': lambda breaker, _: breaker.freeze('driver'),
    'wrong targets': ChainBreaker.wrong_targets,
    'second controller': lambda breaker, _: breaker.rival_commands(1e3),
    'commands that are no numbers': lambda breaker, _: breaker.rival_commands(math.nan),
    'broken model': lambda breaker, _: breaker.new_model(breaker.random.choice(BROKEN_MODELS)),
    'model again': lambda breaker, _: breaker.new_model(str(breaker.chain.robot)),
}
ALL = {**{k: v for k, v in OF_THE_BUS.items() if k not in NOT_HERE}, **OF_THE_CHAIN}


def path(chain, args):
    """
    Return the tips [m] of a round that the arm follows between the faults.

    At the limit every wire in turn pulls with it, as far as the arm has a posture for that.
    """
    if not args.at_limit and chain.robot == ROBOT:
        return [(0.05 * math.sin(angle), 0.0, 0.18) for angle in np.linspace(0.0, 2 * np.pi, 100)]
    if not args.at_limit:
        return chain.targets
    model = Model(load_robot(chain.robot))
    low, high = model.robot.tension_limits
    tips = []
    for row in np.eye(len(model.inputs)):
        for tension in high * np.arange(1.0, 0.0, -0.05):
            with contextlib.suppress(TendonRobotError):
                tips.append(model.shape(np.maximum(low, tension * row)).tip_position)
                break
    return tips


def follow(chain, breaker, passings, args, tips):
    """Send targets and break things until the time is up; return how often it followed."""
    begin = time.monotonic()
    due = begin + breaker.random.expovariate(1.0 / BETWEEN)
    following = ticks = 0
    told = begin
    while (now := time.monotonic()) < begin + 60.0 * args.minutes:
        chain.user.aim(*tips[int((now - begin) / ROUND * len(tips)) % len(tips)])
        chain.user.spin(PERIOD)
        breaker.work(time.monotonic())
        if now > due:
            breaker.strike()
            due = now + breaker.random.expovariate(1.0 / BETWEEN)
        passings.look(now)
        frozen = bool(breaker.later)
        if not frozen:
            chain.look()
            chain.mend()
        ticks += 1
        if now - told > 60.0:
            told = now
            passed, faults = round((now - begin) / 60.0), sum(breaker.done.values())
            print(f'{passed} min, {faults} faults', judge(chain, args), chain.died, flush=True)
        following += chain.user.code('driver') == 'following'
    return following / max(1, ticks)


def judge(chain, args):
    """Return what was passed: goals, tensions and wire."""
    driver = driver_for(chain.servos, args.mode, chain.robot)
    beyond = too_strong(chain.servos, driver)
    state = chain.servos.ask('state')
    high = load_robot(chain.robot).tension_limits[1]
    within = BOUNDS['home_travel'] + 2.0 * BACK_OFF_M + BOUNDS['pull_limits'][1]
    wound = np.maximum(np.abs(state['least']), state['most'])
    measured = 'highest' if args.mode == 'tension' else 'held'
    if max(state[measured]) > high + BALANCED_N:
        beyond.append(f'tension {max(state[measured]):.3f} N, limit {high:g} N')
    if wound.max() > within:
        beyond.append(f'wire {wound.max():.4f} m, bound {within:g} m')
    return {
        'beyond limits': beyond,
        'highest tension [N]': round(float(max(state['highest'])), 3),
        'held by the motors [N]': round(float(max(state['held'])), 3),
        'most wire wound [m]': round(float(wound.max()), 4),
    }


def run(args):
    load = Load(args.busy)
    chain = Chain(args.logs, args.mode, arm=args.arm, servos=BOUNDS, robot=args.robot)
    passings = Passings(chain.servos, load_robot(chain.robot).tension_limits[1])
    try:
        breaker = ChainBreaker(chain, args.seed)
        tips = path(chain, args)
        if not chain.up(tips[0], -math.inf):
            raise RuntimeError(f'the arm does not follow; see {args.logs}')
        followed = follow(chain, breaker, passings, args, tips)
        breaker.work(math.inf)
        chain.user.spin(1.0)
        passings.look()
        return {
            'following': round(followed, 3),
            'faults': sum(breaker.done.values()),
            'kinds': dict(sorted(breaker.done.items())),
            'died': chain.died,
            **judge(chain, args),
            **passings.told(),
        }
    finally:
        load.end()
        chain.close()


def table(found):
    rows = ('following', 'faults', 'highest tension [N]', 'held by the motors [N]')
    rows += ('most wire wound [m]',)
    lines = [f'{key:22s}{found[key]:10g}' for key in rows]
    lines += [f'{key:22s}{len(found[key]):10d}' for key in ('died', 'beyond limits')]
    return '\n'.join(lines)


def main():
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--minutes', type=float, default=30.0)
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--mode', choices=('tension', 'pull'), default='tension')
    parser.add_argument('--busy', type=int, default=2, help='busy processes beside it')
    parser.add_argument('--arm', default='plant', choices=('plant', 'springs'))
    parser.add_argument('--robot', type=Path, default=ROBOT)
    parser.add_argument('--at-limit', action='store_true')
    parser.add_argument('--logs', type=Path, default=Path(tempfile.gettempdir(), 'soak_chain'))
    parser.add_argument('--json', type=Path)
    args = parser.parse_args()
    begun = os.getloadavg()
    found = run(args)
    given = {
        key: getattr(args, key) for key in ('minutes', 'seed', 'mode', 'busy', 'arm', 'at_limit')
    }
    given['robot'] = args.robot.stem
    load = [round(begun[0], 1), round(os.getloadavg()[1], 1)]
    tell({**machine(), 'load_average': load, **given, **found}, args.json)
    print(table(found))
    return 1 if found['died'] or found['beyond limits'] else 0


if __name__ == '__main__':
    raise SystemExit(main())
