"""
How often the interval of a printed scatter holds: the estimator alone, on columns of a real arm.

Imperfections are taken once from a simulated arm; then many arms are drawn with the same columns
and other members, a third, once and twice as badly built as usual. A minute of one core.

With --fits arms are simulated and fitted whole instead, by the effect that they hide and no
other: half a second each, without the search for the effect.

example: python benchmarks/bench_scatter.py --arms 60
    python benchmarks/bench_scatter.py --fits hinged arcs --arms 10 --hidden none tip_load
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from planned import PLANS

from tendon_robot_ros.diagnosis.report_rows import arm_report
from tendon_robot_ros.effects import load_catalogue
from tendon_robot_ros.inference.intervals import SizeIntervals
from tendon_robot_ros.inference.marginal import Prior, RandomEffects
from tendon_robot_ros.inference.session import Question
from tendon_robot_ros.robot import load_robot
from tendon_robot_ros.simulation.hidden import Workmanship
from tendon_robot_ros.simulation.measurements import simulate
from tendon_robot_ros.simulation.plant import make_plant
from tendon_robot_ros.studies.cases import NOTHING, Case
from tendon_robot_ros.studies.judge import scatter_held
from tendon_robot_ros.studies.plan import read_plan
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
    session = Question.of(dataset, robot, load_catalogue()).weigh()
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
    sizes = effects.estimate(residual, np.zeros((len(columns), 0)), prior=Prior.NONE).values
    low, high = SizeIntervals(effects, sizes).ends(sizes)
    return {name: (sizes[k] / rms, low[k] <= rms <= high[k]) for name, (k, rms) in true.items()}


def fitted(name, hidden, number, level, seed):
    """Build an arm of a plan and fit what it hides; return its report, and how it is built."""
    plan = 'diagnosis_spatial' if name == 'spatial_3' else 'diagnosis'
    setup, catalogue = read_plan(PLANS / f'{plan}.yaml').setup, load_catalogue()
    case = Case(name, hidden, SIZE, number, level=level)
    made = replace(setup, seed=seed).simulated(case)
    session, fit = Question.of(made.fit, made.robot, catalogue).weigh(), None
    session = session.without_outliers()
    frees = [c.frees for c in session.candidates if c.names == (hidden,)]
    for _ in range(3):
        if fit is not None:
            session = session.weigh(fit)
        fit = session.fitter.fit(frees[0] if frees else (), fit)
        fit = session.fitter.over_reversals(fit)
    return arm_report(session, session.fitter.for_values(fit)), made.built


def fits(options):
    """Print how many of the printed sizes of cells and kinks hold, of whole fits."""
    for name in options.fits:
        for level in options.levels:
            made = [
                fitted(name, hidden, number, level, options.seed)
                for hidden in options.hidden
                for number in range(options.arms)
            ]
            held = [one for pair in made for one in scatter_held(*pair)]
            print(f'level {level:.2f}  {name}: {sum(held)} of {len(held)} hold', flush=True)
            for kind in made[0][1].sizes:
                print(f'    {kind:15} {widths(made, kind)}', flush=True)


def widths(made, kind):
    """Tell how wide the intervals of a kind are."""
    rows = [(one, built.sizes) for report, built in made for one in report['kinds']]
    told = [(one, true[kind]) for one, true in rows if one['kind'] == kind and one['told']]
    ends = np.array([[o['low'], o['high'] or np.inf, true, o['plausible']] for o, true in told])
    low, high, true, plausible = ends.T
    below = low == 0.0
    text = (
        f'told {len(ends)} of {len(made)}, upper end {np.median(high / true):.1f} times the true '
        f'size (median; 90 % {np.quantile(high / true, 0.9):.1f})'
    )
    if not below.any():
        return text
    most = np.median((high / plausible)[below])
    return f'{text}; {below.sum()} times "below" {most:.1f} times the plausible size (median)'


def main():
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--robot', default='kato_10_1_single')
    parser.add_argument('--arms', type=int, default=60)
    parser.add_argument('--fits', nargs='+', metavar='ROBOT', help='hinged, arcs, spatial_3')
    parser.add_argument('--hidden', nargs='+', default=[NOTHING])
    parser.add_argument('--levels', nargs='+', type=float, default=LEVELS)
    parser.add_argument('--seed', type=int, default=21, help='of the arms of --fits')
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
