"""
How often the interval of a printed scatter holds: the estimator alone, on columns of a real arm.

Imperfections are taken once from a simulated arm; then many arms are drawn with the same columns
and other members, a third, once and twice as badly built as usual. A minute of one core.

With --fits arms are simulated and fitted whole instead, by the effect that they hide and no
other: two seconds each, without the search for the effect.

example: python benchmarks/bench_scatter.py --arms 60
    python benchmarks/bench_scatter.py --fits arcs --arms 12 --hidden none tip_load
"""

import argparse
from pathlib import Path

import numpy as np
from planned import PLANS

from tendon_robot_ros.campaign.cases import NOTHING, Case, simulated
from tendon_robot_ros.campaign.judge import scatter_held
from tendon_robot_ros.campaign.plan import read_plan
from tendon_robot_ros.diagnosis.arm_report import arm_report
from tendon_robot_ros.diagnosis.marginal import RandomEffects
from tendon_robot_ros.diagnosis.outliers import find_outliers
from tendon_robot_ros.diagnosis.session import Session
from tendon_robot_ros.effects import load_catalogue
from tendon_robot_ros.robot import load_robot
from tendon_robot_ros.simulation.hidden import Workmanship
from tendon_robot_ros.simulation.measurements import simulate
from tendon_robot_ros.simulation.plant import make_plant
from tendon_robot_ros.workspace.postures import default_postures

LEVELS = (1.0 / 3.0, 1.0, 2.0)
SIZE = 0.6  # times the typical size, of what is hidden
ROBOTS = Path(__file__).parents[1] / 'config' / 'robots'
USUAL = Workmanship()
TRUE = {
    'cell_stiffness': USUAL.stiffness,
    'cell_kink': USUAL.kink,
    'cell_kink_across': USUAL.kink,
    'channel_gain': float(np.hypot(USUAL.gain, USUAL.hole)),
    'position': USUAL.position,
    'rotation': USUAL.rotation,
}


def columns_of(name):
    """Return the random effects of an arm, its whitened columns and whose they are."""
    robot = load_robot(ROBOTS / f'{name}.yaml')
    plant = make_plant(robot, work=USUAL, seed=1)
    dataset = simulate(plant, default_postures(robot, 12), seed=1)
    session = Session(dataset, robot, load_catalogue(), workers=1)
    assert session.weigh({}) and session.imperfections is not None
    columns = session.whitener.white(session.imperfections.moves).T
    owners, kinds = session.imperfections.owners, session.imperfections.kinds
    return RandomEffects(columns, owners, kinds), columns, owners


def held(arm, level, random):
    """Draw an arm; return by kind size over true rms, and whether the interval holds it."""
    effects, columns, owners = arm
    members, true = np.zeros(len(owners)), {}
    for k, kind in enumerate(effects.kinds):
        if kind.name in TRUE:
            own = owners == k
            members[own] = level * TRUE[kind.name] * random.normal(size=own.sum())
            true[kind.name] = (k, float(np.sqrt(np.mean(members[own] ** 2))))
    residual = columns @ members + random.normal(size=len(columns))
    sizes = effects.estimate(residual, np.zeros((len(columns), 0)), told=False).values
    low, high = effects.intervals(sizes)
    return {name: (sizes[k] / rms, low[k] <= rms <= high[k]) for name, (k, rms) in true.items()}


def fitted(name, hidden, number, level):
    """Build an arm of the plan and fit what it hides; tell of each printed size if it holds."""
    setup, catalogue = read_plan(PLANS / 'diagnosis.yaml').setup, load_catalogue()
    case = Case(name, hidden, SIZE, number, level=level)
    made = simulated(case, setup.arm(name), setup.designs[0], setup.noises[0][1], catalogue)
    session, fit = Session(made.fit, made.robot, catalogue, workers=1), None
    assert session.weigh({})
    session.leave_out(find_outliers(session.predictor, {}))
    frees = [c.frees for c in session.candidates if c.names == (hidden,)]
    for _ in range(3):
        if fit is not None:
            session.weigh(fit.point, fit.around)
        fit = session.fitters[0].fit(frees[0] if frees else (), fit)
    return scatter_held(arm_report(session, fit), made.built)


def fits(options):
    """Print how many of the printed sizes of cells and kinks hold, of whole fits."""
    for level in options.levels:
        for hidden in options.hidden:
            held = [
                one
                for number in range(options.arms)
                for one in fitted(options.fits, hidden, number, level)
            ]
            print(
                f'level {level:.2f}  {options.fits}, {hidden:17} intervals of cells and kinks '
                f'that hold {sum(held)} of {len(held)}',
                flush=True,
            )


def main():
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--robot', default='kato_10_1_single')
    parser.add_argument('--arms', type=int, default=60)
    parser.add_argument('--fits', metavar='ROBOT', help='of benchmarks/plans/diagnosis.yaml')
    parser.add_argument('--hidden', nargs='+', default=[NOTHING])
    parser.add_argument('--levels', nargs='+', type=float, default=LEVELS)
    options = parser.parse_args()
    if options.fits:
        fits(options)
        return
    arm, random = columns_of(options.robot), np.random.default_rng(0)
    for level in options.levels:
        found = [held(arm, level, random) for _ in range(options.arms)]
        for name in found[0]:
            ratio, inside = zip(*(one[name] for one in found), strict=True)
            print(
                f'level {level:.2f}  {name:17} size over true {np.median(ratio):.2f}, '
                f'intervals that hold {100.0 * np.mean(inside):.0f} %'
            )


if __name__ == '__main__':
    main()
