"""
How often a hidden hysteresis is named in simulated sequences, how quiet others are.

Quiet: `adequate`, no effect and no cause outside the catalogue.

Arms as they are built. Of `bending_hysteresis` lags of a third to three times what matters,
presliding of 0.5 to 4; of `backlash`, always by pulls, plays of two to five times what matters;
postures in any order, fresh for every seed. Held: 95 % intervals that hold the true value.

example: python benchmarks/bench_hysteresis.py --cases 10
example: python benchmarks/bench_hysteresis.py --cases 10 --by-pulls
example: python benchmarks/bench_hysteresis.py --cases 10 --effect backlash --stiff
"""

import argparse

import numpy as np

from tendon_robot_ros import diagnose, load_robot
from tendon_robot_ros.diagnosis.verdict import Verdict
from tendon_robot_ros.effects import load_catalogue
from tendon_robot_ros.robot.estimates import natural_sizes
from tendon_robot_ros.simulation.measurements import simulate
from tendon_robot_ros.simulation.plant import make_plant
from tendon_robot_ros.workspace.postures import default_postures


def drawn(name, robot, random):
    """Return the true values of the effect."""
    parameters = load_catalogue().sized(natural_sizes(robot))[name].parameters
    if name == 'backlash':
        return {'width': parameters[0].typical * random.uniform(2.0, 5.0)}
    lag, presliding = parameters
    size = 10.0 ** random.uniform(-0.5, 0.5), 10.0 ** random.uniform(-0.3, 0.6)
    return {'lag': lag.typical * size[0], 'presliding': presliding.typical * size[1]}


def main():
    """Count over arms and seeds, and print a line for each arm."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--cases', type=int, default=10)
    parser.add_argument('--first', type=int, default=900)
    what = 'wires that end in springs are pulled by lengths'
    parser.add_argument('--by-pulls', action='store_true', help=what)
    parser.add_argument('--stiff', action='store_true', help='the wires are fixed to the motors')
    choices = ('bending_hysteresis', 'backlash')
    parser.add_argument('--effect', default=choices[0], choices=choices)
    parser.add_argument('--postures', type=int, default=14)
    parser.add_argument('--robots', nargs='+', default=['kato_10_1', 'spatial_3'])
    args = parser.parse_args()
    hides, by_pulls = args.effect, args.by_pulls or args.effect == 'backlash'
    for name in args.robots:
        robot, named, quiet, held = load_robot(name), 0, 0, []
        if by_pulls and not args.stiff:
            (spring,) = load_catalogue().sized(natural_sizes(robot))['wire_spring'].parameters
            robot = robot.with_effect('wire_spring', {spring.name: spring.typical})
        given = 'displacement' if by_pulls else 'tension'
        postures = default_postures(robot, args.postures, input=given)
        for seed in range(args.first, args.first + args.cases):
            random = np.random.default_rng(seed)
            true = drawn(hides, robot, random)
            for hidden in ({hides: true}, {}):
                plant = make_plant(robot, hidden, seed=seed)
                data = simulate(
                    plant,
                    random.permutation(postures),
                    trials=2,
                    path='sequence',
                    input=given,
                    seed=seed,
                )
                found = diagnose(data)
                effects = found.effects
                names = [effect.name for effect in effects]
                named += names == [hides] and bool(hidden)
                quiet += found.verdict is Verdict.ADEQUATE and not hidden
                if hidden and hides in names:
                    values = effects[names.index(hides)].parameters.items()
                    held += [v.low <= true[k.partition('[')[0]] <= v.high for k, v in values]
        print(
            f'{name}: named alone in {named} of {args.cases}, quiet without it in {quiet} of '
            f'{args.cases}; intervals hold the truth in {sum(held)} of {len(held)}'
        )


if __name__ == '__main__':
    main()
