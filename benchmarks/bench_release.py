"""
Whether an arm stays where it is after a release, and after the model of another robot.

    python benchmarks/bench_release.py [--trials 200] [--robot spatial_6] [--mode pull] [--busy 2]

Real controller and driver, each a process, on emulated servos in another one. Half of the trials
have a motor fall silent under load and answer again, after a time drawn at random; the other half
give the controller the model of another robot with the same tendon names. A trial is good when

- no wire gets tighter afterwards than it was then, or than pretension, but for what a standing
  wire may do in `bench_stop.py`;
- the controller never says `reached` until a new target is sent;
- the arm goes to that target.

Target: all of them.
"""

import argparse
import random
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import yaml
from bench_stop import ARMS, LEAST, STILL, settled
from chain import Chain, Load
from emulated_bus import ROBOTS
from machine import machine, tell
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters

from tendon_robot_ros.cli.motors import SPRING_STIFFNESS

STANDING_N = {'tension': STILL['tension'], 'pull': STILL['pull'] * SPRING_STIFFNESS}  # [N]
WATCHED_S = 1.5  # [s]; what moved by itself did so within 0.16 s
EVENT_S = 20.0  # [s], a generous end of every wait
LONGER = 1.1  # times the length of a cell: another robot


class Release:
    """One arm, and what happens to it."""

    def __init__(self, chain, seed):
        self.chain, self.user, self.draw = chain, chain.user, random.Random(seed)
        self.ids = sorted(motor['id'] for motor in chain.config['motors'].values())
        self.rest = yaml.safe_load(chain.robot.read_text())['tension_limits'][0]
        self.client = self.user.create_client(SetParameters, 'controller/set_parameters')
        other = yaml.safe_load(chain.robot.read_text())
        other['name'] = 'another'
        for section in other['sections']:
            section['cell_length'] *= LONGER
        self.other = yaml.safe_dump(other)

    def trial(self, number, kind):
        """Return what was wrong, '' where nothing was; None: the arm was not held before."""
        target = self.chain.targets[number % len(self.chain.targets)]
        held = self.chain.up(target, LEAST[self.chain.mode])
        if not held or not settled(self.user, STILL[self.chain.mode]):
            return None
        wrong = kind(self)
        next_target = self.chain.targets[(number + 1) % len(self.chain.targets)]
        if not self.chain.up(next_target, LEAST[self.chain.mode]):
            wrong.append('does not go to a new target')
        return '; '.join(wrong)

    def silent_motor(self):
        """Have a motor neither hear nor answer until the driver has released, and longer."""
        motor = self.draw.choice(self.ids)
        self.chain.servos.say(f'silent {motor}')
        released = self.user.until(lambda: self.user.code('driver') != 'following', EVENT_S)
        self.user.spin(self.draw.uniform(0.0, 1.0))
        self.chain.servos.say(f'hear {motor}')
        wrong = [] if released else ['the driver followed all the time']
        return wrong + self.watch(self.rest)

    def another_robot(self):
        """Give the controller another model, and later the first one again."""
        wrong = []
        for text, name in (
            (self.other, 'another'),
            (str(self.chain.robot), self.chain.robot.stem),
        ):
            value = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=text)
            self.client.wait_for_service(EVENT_S)
            self.client.call_async(
                SetParameters.Request(parameters=[Parameter(name='model', value=value)])
            )
            if not self.user.until(lambda name=name: self.model().startswith(name), EVENT_S):
                wrong.append(f'the model {name} is not taken')
            wrong += self.watch(self.rest)
        return wrong

    def model(self):
        said = self.user.said['controller']
        return '' if said is None else {v.key: v.value for v in said.values}.get('model', '')

    def watch(self, rest):
        """Return what happens in the next seconds that should not."""
        begin, reached = time.monotonic(), False
        while time.monotonic() - begin < WATCHED_S:
            self.user.executor_.spin_once(timeout_sec=0.01)
            reached |= self.user.code('controller') == 'reached'
        trace = self.chain.servos.ask(f'trace {time.monotonic() - begin}')
        wires = np.array([moment[2] for moment in trace])
        before, most = wires[0], wires.max(axis=0)
        wire = int(np.argmax(most - np.maximum(before, rest)))
        wrong = ['the controller says reached'] if reached else []
        if most[wire] - max(before[wire], rest) > STANDING_N[self.chain.mode]:
            wrong.append(f'wire {wire + 1} is at {most[wire]:.2f} N after {before[wire]:.2f} N')
        return wrong


KINDS = {
    'a silent motor answers again': Release.silent_motor,
    'the model of another robot': Release.another_robot,
}


def main():
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--trials', type=int, default=200)
    parser.add_argument('--busy', type=int, default=0, help='busy processes beside it')
    parser.add_argument('--mode', default='tension', choices=tuple(LEAST))
    parser.add_argument('--robot', default='kato_10_1', choices=ARMS)
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--logs', type=Path, default=Path(tempfile.gettempdir(), 'bench_release'))
    parser.add_argument('--json', type=Path)
    args = parser.parse_args()
    load = Load(args.busy)
    chain = Chain(args.logs, args.mode, 'springs', {}, ROBOTS / f'{args.robot}.yaml')
    counts = {name: {'good': 0, 'trials': 0, 'not held': 0} for name in KINDS}
    try:
        release = Release(chain, args.seed)
        for number in range(args.trials):
            name = list(KINDS)[number % len(KINDS)]
            wrong = release.trial(number, KINDS[name])
            if wrong is None:
                counts[name]['not held'] += 1
                continue
            counts[name]['trials'] += 1
            counts[name]['good'] += not wrong
            if wrong:
                print(f'trial {number}: {name}: {wrong}', file=sys.stderr, flush=True)
    finally:
        load.end()
        chain.close()
    about = {'robot': args.robot, 'mode': args.mode, 'busy processes': args.busy}
    tell({**machine(), **about, 'died': chain.died, **counts}, args.json)
    good = all(row['good'] == row['trials'] for row in counts.values())
    return 0 if good and not chain.died else 1


if __name__ == '__main__':
    raise SystemExit(main())
