"""
Break the whole chain for half an hour: controller and driver on emulated servos, a user beside.

    python benchmarks/soak_chain.py [--minutes 30] [--mode pull] [--busy 2] [--at-limit]

Targets come five times a second, a fault every ten seconds on average: of the bus and the motors
(those of soak_dynamixel.py), stops of every kind, killed, ended and frozen processes, a second
controller, commands and targets that are wrong, models that are broken. Targets: no goal beyond
the limits, no process that died, no wire wound beyond the bound, none that pulls more than current
and dry friction of its motor hold (docs/dynamixel.md), but for the drag of a motor that it turns.
The wires move the mock arm (`--robot` takes another one), or with `--arm springs` a spring each.
With `--at-limit` each wire in turn is told by trajectories to pull with the limit while the others
are at their lowest, in pull mode as far as the model winds it for that; how often a motor is at
its largest current is counted. Prints what was passed each minute, at the end all figures as JSON
and a short table. Not under `nice`: see bench_stop.py.
"""

import argparse
import math
import os
import signal
import tempfile
import time
from pathlib import Path

import numpy as np
from chain import Chain, Load
from emulated_bus import ROBOT, Passings, driver_for, strongest
from machine import machine, tell
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from sensor_msgs.msg import JointState
from soak_dynamixel import KINDS as OF_THE_BUS
from soak_dynamixel import Breaker, too_strong
from std_msgs.msg import Bool

from tendon_robot_ros.drivers import make_driver
from tendon_robot_ros.drivers.dynamixel.motions import BACK_OFF_M
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.robot import load_robot
from tendon_robot_ros.ros.shared.interface import COMMAND, LATCHED

BETWEEN = 10.0  # [s] from fault to fault, on average
PERIOD = 0.2  # [s] of the targets
ROUND = 20.0  # [s] of a round of the path
LEG = 8.0  # [s] for a wire: up to 5 to wind 0.1 m at the usual 20 mm/s, then at its limit
AGAIN, PLAYED = 1.0, 0.8  # [s] from one trajectory to the next; of one
PULL_MAX, HOME_TRAVEL = 0.03, 0.02  # [m] of wire away from the limits; of the search for slack
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


def path(chain):
    """Return the tips [m] of a round that the arm follows between the faults."""
    if chain.robot == ROBOT:
        return [(0.05 * math.sin(angle), 0.0, 0.18) for angle in np.linspace(0.0, 2 * np.pi, 100)]
    return chain.targets


def hard_pulls(robot, high):
    """
    Return the wire pulls (m, m) [m] where one wire after the other has a tension [N].

    The others are at their lowest.
    """
    model = Model(load_robot(robot))
    rows = np.where(np.eye(len(model.inputs)) > 0.0, high, model.robot.tension_limits[0])
    return np.array([model.shape(row).pulls for row in rows])


class Targets:
    """What the arm is told: tips of a path, or each wire in turn to pull with its limit."""

    def __init__(self, chain, args):
        self.user, self.tips = chain.user, path(chain)
        robot = load_robot(chain.robot)
        low, high = robot.tension_limits
        self.names, self.rows, self.due = robot.inputs, None, 0.0
        if args.at_limit and args.mode == 'tension':
            self.rows = np.where(np.eye(len(self.names)) > 0.0, high, low)
        elif args.at_limit:
            self.rows = hard_pulls(chain.robot, high)

    def send(self, passed):
        """Send what is due so many seconds after the beginning."""
        if self.rows is None:
            self.user.aim(*self.tips[int(passed / ROUND * len(self.tips)) % len(self.tips)])
        elif passed >= self.due:
            self.due = passed + AGAIN
            self.user.play(self.names, self.rows[int(passed / LEG) % len(self.rows)], PLAYED)


def follow(chain, breaker, passings, args):
    """Send targets and break things until the time is up; return how often it followed."""
    begin = time.monotonic()
    due = begin + breaker.random.expovariate(1.0 / BETWEEN)
    following = ticks = 0
    told, targets = begin, Targets(chain, args)
    while (now := time.monotonic()) < begin + 60.0 * args.minutes:
        targets.send(now - begin)
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


def farthest(config, args):
    """Return how much wire the arm gives at most [m]: what a motor holds pulls at one of them."""
    if not args.at_limit:
        return PULL_MAX
    driver = make_driver('dynamixel', load_robot(args.robot), config, mode=args.mode)
    return float(np.abs(hard_pulls(args.robot, strongest(driver))).max())


def judge(chain, args):
    """Return what was passed: goals, what motors hold, and wire."""
    state, driver = chain.servos.ask('state'), driver_for(chain.servos, args.mode, chain.robot)
    beyond = too_strong(state, driver)
    within = HOME_TRAVEL + 2.0 * BACK_OFF_M + farthest(chain.servos.content(), args)
    wound = np.maximum(np.abs(state['least']), state['most'])
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
    servos = {
        'pull_limits': lambda config: [sign * farthest(config, args) for sign in (-1.0, 1.0)],
        'home_travel': HOME_TRAVEL,
    }
    chain = Chain(args.logs, args.mode, arm=args.arm, servos=servos, robot=args.robot)
    passings = Passings(chain.servos, driver_for(chain.servos, args.mode, chain.robot))
    try:
        breaker = ChainBreaker(chain, args.seed)
        if not chain.up(path(chain)[0], -math.inf):
            raise RuntimeError(f'the arm does not follow; see {args.logs}')
        followed = follow(chain, breaker, passings, args)
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
    rows += ('motors hold at most [N]', 'share of the time with a motor at its limit')
    rows += ('most wire wound [m]',)
    lines = [f'{key:44s}{found[key]:10g}' for key in rows]
    lines += [f'{key:44s}{len(found[key]):10d}' for key in ('died', 'beyond limits')]
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
