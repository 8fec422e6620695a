"""
What control that knows friction gains: spread by the way, loads, paths, stiffness, and its ticks.

The arms are plants as they are built (scatter, kinks, gains, holes), with friction that remembers
by another slip law than the model's, behind a driver with lag and noisy load cells; the tip is
seen at 50 Hz with noise. The controller runs with its solver in place, in simulated time; ticks
are measured in processor time of their thread. Prints JSON with what is asked and whether it is
met; `--only orders` (or another part) for one. Orders that were broken off go on with the
`--resume FILE` that they were given, a line per order and kind.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from control_rig import (
    CYCLE,
    DESCRIBED,
    TIP_NOISE,
    TRACK_EVERY,
    Rig,
    load_of,
    loaded,
    robot_of,
)
from machine import machine, tell

from tendon_robot_ros.control import Target, tip_loop
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.model.redundancy import Balance, balanced
from tendon_robot_ros.model.tip_task import Preferences, TipTask

KINDS = {  # of control, for the orders
    'today': {'knows': ''},
    'from_below': {'knows': '', 'approach': 'from_below'},
    'memory': {},
    'memory_from_below': {'approach': 'from_below'},
    'law': {'knows': 'law'},
    'recorded': {'knows': 'recorded'},
    'law_from_below': {'knows': 'law', 'approach': 'from_below'},
    'closed': {'tip_gain': 5.0},
    'closed_from_below': {'tip_gain': 5.0, 'approach': 'from_below'},
    'closed_law': {'knows': 'law', 'tip_gain': 5.0},
}
PATHS = (  # ahead: with look_ahead; told: the model has the load
    'open',
    'fixed',
    'fixed_ahead',
    'learned',
    'learned_ahead',
    'told_ahead',
)
PARTS = 'ticks', 'orders', 'load', 'path', 'reachable', 'stiffness'
STANDING_S, LOOK_S = 4.0, 0.5  # [s] before an arm stiffens; between two looks at how stiff
PROGRAMS, LOOKED_FOR = 60, 10.0  # at most, from each beginning; times as stiff
TICKS = 1050  # the first 50 are not counted
ENOUGH = 3.0  # times as stiff, by a model that is not quite the arm's
FIXED = {'MODEL_SLOPE_SD': 1e-9}  # the model's own Jacobian
LIMITS = {  # what is aimed at
    'open_loop_spread_share': 0.15,
    'closed_loop_spread_noises': 1.5,
    'overshoot_share': 0.10,
    'load_error_mm': 1.2,
    'share_of_fixed': 0.5,
    'stiffness_factor': 2.0,
    'stiffness_tip_mm': 0.2,
    'tick_ms': {'kato_10_1': 0.3, 'spatial_6': 1.5},
}


def targets(name, count=12):
    """Return tips (count, 3) [m] in the middle of the workspace."""
    model, random = Model(robot_of(name, False)), np.random.default_rng(7)
    low, high = model.limits.T
    found = []
    while len(found) < count:
        tensions = low + random.random(len(low)) * 0.2 * (high - low)
        tip = model.shape(tensions).tip_position
        if tip[2] > 0.6 * model.robot.length and np.hypot(*tip[:2]) > 0.1 * model.robot.length:
            found.append(tip)
    return np.array(found)


def visited(name, number, **settings):
    """Visit the targets in a random order: where the tip ends, and how far it was beyond."""
    places, rig = targets(name), Rig(name, **settings)
    ends, hardly, beyond = np.empty((len(places), 3)), np.empty((len(places), 3)), []
    for place in np.random.default_rng(number).permutation(len(places)):
        here, tips = rig.tip.copy(), rig.go(places[place])
        ends[place], hardly[place] = tips[-20:].mean(axis=0), rig.hardly_led()
        step = ends[place] - here
        if np.linalg.norm(step) > 0.02:
            beyond.append(((tips - here) @ step).max() / (step @ step) - 1.0)
    made = {'ends': ends.tolist(), 'hardly_led': hardly.tolist()}
    return made | {'beyond': beyond, 'skipped': rig.skipped}


def told(name, rows):
    """
    Return spread by the way, error and overshoot of the orders of one kind.

    The spread also without the direction along which tendons lead the tip least at each target.
    """
    ends, hardly = (np.array([row[key] for row in rows]) for key in ('ends', 'hardly_led'))
    axes = np.linalg.eigh(np.einsum('opi,opj->pij', hardly, hardly))[1][:, :, :2]
    parted = ends - ends.mean(axis=0)
    away, led = np.linalg.norm(parted, axis=2), np.einsum('opi,pij->opj', parted, axes)
    beyond = np.concatenate([row['beyond'] for row in rows])
    return {
        'orders': len(rows),
        'spread_mm': round(1e3 * float(np.sqrt((away**2).mean())), 3),
        'spread_led_mm': round(1e3 * float(np.sqrt((led**2).sum(axis=2).mean())), 3),
        'error_mm': round(1e3 * float(np.linalg.norm(ends - targets(name), axis=2).mean()), 3),
        'overshoot_p95': round(float(np.quantile(beyond, 0.95)), 3),
        'overshoot_max': round(float(beyond.max()), 3),
    }


def bench_orders(count, name, exact, kinds, file):
    rows = [json.loads(line) for line in file.read_text().splitlines()] if file.exists() else []
    rows = [row for row in rows if (row['robot'], row['exact']) == (name, exact)]
    done = {(row['kind'], row['number']) for row in rows}
    for number in range(count):
        for kind in kinds:
            if (kind, number) in done:
                continue
            row = {'robot': name, 'exact': exact, 'kind': kind, 'number': number}
            row |= visited(name, number, exact=exact, **KINDS[kind])
            rows.append(row)
            with file.open('a') as log:
                log.write(json.dumps(row) + '\n')
    made = {kind: told(name, [r for r in rows if r['kind'] == kind]) for kind in kinds}
    axes = 2.0 if name.startswith('kato') else 3.0  # that the arm moves in
    noise, today = 1e3 * TIP_NOISE * axes**0.5, made.get('today', {'spread_mm': np.nan})
    for kind, figures in made.items():
        figures['share_of_today'] = round(figures['spread_mm'] / (today['spread_mm'] or np.nan), 3)
        figures['spread_noises'] = round(figures['spread_mm'] / noise, 2)
        two_axes = 1e3 * TIP_NOISE * 2.0**0.5
        figures['spread_led_noises'] = round(figures['spread_led_mm'] / two_axes, 2)
        figures['met'] = met(figures, 'closed' in kind)
    return made


def met(figures, closed):
    """Tell which aims the orders of one kind of control meet."""
    spread = 'spread_noises', 'closed_loop_spread_noises'
    if not closed:
        spread = 'share_of_today', 'open_loop_spread_share'
    return {
        'spread': figures[spread[0]] <= LIMITS[spread[1]],
        'overshoot': figures['overshoot_p95'] <= LIMITS['overshoot_share'],
    }


def bench_load(count, gain, name, exact, knows):
    """Load the tip within 0.1 s: how far it is off, and for how long."""
    errors, settled, moved = [], [], []
    for number, place in enumerate(targets(name)[:count]):
        rig = Rig(name, knows, tip_gain=gain, seed=number, exact=exact, rate_limit=20.0)
        rig.go(place)
        force, began = load_of(rig, 0.02), rig.now

        def load(rig, force=force, began=began):
            loaded(rig, force * min((rig.now - began) / 0.1, 1.0))

        rig.run(1.3, load)
        away = np.linalg.norm(np.array(rig.tips[-260:]) - place, axis=1)
        moved.append(1e3 * away[:40].max())
        errors.append(1e3 * np.sqrt((away[190:210] ** 2).mean()))
        late = np.flatnonzero(away > 1.2e-3)
        settled.append(CYCLE * (late[-1] + 1) if len(late) else 0.0)
    return {
        'gain_per_s': gain,
        'largest_mm': np.round(moved, 1).tolist(),
        'error_after_1s_mm': np.round(errors, 2).tolist(),
        'within_1.2mm_after_s': np.round(settled, 2).tolist(),
        'met': int((np.array(errors) <= LIMITS['load_error_mm']).sum()),
        'of': count,
    }


def circle(name):
    """Return a circle (k, 3) [m] within reach: in the plane of the arm, or about its axis."""
    angles = np.linspace(0.0, 2.0 * np.pi, 721)
    turn = np.array([np.cos(angles), np.sin(angles)]).T
    if name.startswith('kato'):
        return np.array([0.05, 0.0, 0.17]) + 0.02 * turn @ [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    model = Model(robot_of(name, False))
    height = model.reach([0.03, 0.0, 0.11]).shape.tip_position
    return np.column_stack([np.hypot(*height[:2]) * turn, np.full(len(turn), height[2])])


def bench_path(gain, lead, name, exact, knows):
    """Follow circles at 100 mm/s under an unknown load."""
    made, kept = {}, {key: getattr(tip_loop, key) for key in FIXED}
    for kind in PATHS:
        for key, value in (FIXED if kind.startswith('fixed') else kept).items():
            setattr(tip_loop, key, value)
        ahead = lead if kind.endswith('ahead') else 0.0
        closed = 0.0 if kind == 'open' else gain
        rig = Rig(name, knows, tip_gain=closed, exact=exact, look_ahead=ahead)
        away = circled(rig, name, told=kind.startswith('told'))
        made[f'{kind}_rms_mm'] = round(1e3 * float(np.sqrt((away**2).mean())), 3)
    for key, value in kept.items():
        setattr(tip_loop, key, value)
    for fixed in ('fixed', 'fixed_ahead'):
        for kind in ('learned', 'told'):
            share = made[f'{kind}_ahead_rms_mm'] / made[f'{fixed}_rms_mm']
            made[f'{kind}_share_of_{fixed}'] = round(share, 3)
    return made | {'met': made['learned_share_of_fixed'] <= LIMITS['share_of_fixed']}


def circled(rig, name, told):
    """Load the tip, follow circles for 3 s: how far (k,) [m] it was off after the first second."""
    way, speed = circle(name), 0.1
    round_s = float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum()) / speed
    rig.go(way[0])
    loaded(rig, force := 0.5 * load_of(rig, 0.02))
    if told:
        described = rig.core.model.robot.with_effect('tip_load', {'force_x': force})
        rig.core.set_model(Model(described))
    rig.run(1.0)
    began, wanted = rig.now, []

    def send(rig):
        share = (rig.now - began) / round_s % 1.0 * (len(way) - 1)
        place = way[round(share)]
        wanted.append(place)
        if rig.step % TRACK_EVERY == 0:
            rig.core.aim(Target(place))

    first = len(rig.tips)
    rig.run(3.0, send)
    return np.linalg.norm(np.array(rig.tips[first:]) - np.array(wanted), axis=1)[200:]


def bench_stiffness(count, gain, seconds, name, exact, knows):
    """Co-contraction while the tip is held: how much stiffer, how far the tip moves meanwhile."""
    rows = []
    for number, place in enumerate(targets(name)[:count]):
        rig = Rig(name, knows, seed=number, exact=exact, tip_gain=gain)
        rig.go(place)
        rig.run(2.0)
        rows.append(stiffened(rig, seconds))
    figures = {key: [row[key] and round(row[key], 3) for row in rows] for key in rows[0]}
    away = [row['tip_moved_until_twice_mm'] for row in rows]
    kept = [one is not None and one <= LIMITS['stiffness_tip_mm'] for one in away]
    return figures | {'met': sum(kept), 'of': count}


def bench_reachable(count, name):
    """How much stiffer along x the tip can be by the model, held where it is: programs alone."""
    model, factors, moved, most = Model(robot_of(name)), [], [], []
    for place in targets(name)[:count]:
        here = model.reach(place).shape
        before = model.tip_stiffness(here).along([1, 0, 0])
        if before <= 0.0:  # friction holds the arm where it gives way against a small force
            for row in (factors, moved, most):
                row.append(None)
            continue
        wants = Preferences(
            0.0, 1.0, stiffness_direction=(1, 0, 0), stiffness_enough=LOOKED_FOR * before
        )
        balance = Balance(TipTask.at(model, here.tip_position, memory=here.memory), wants)
        end = balanced(balance, balance.task.shape(here.inputs, here.state), PROGRAMS)
        factors.append(round(model.tip_stiffness(end).along([1, 0, 0]) / before, 2))
        moved.append(round(1e3 * float(np.linalg.norm(end.tip_position - here.tip_position)), 3))
        most.append(round(float(end.inputs.max()), 2))
    return {'factor': factors, 'tip_moved_mm': moved, 'highest_tension_n': most}


def stiffened(rig, seconds):
    """Let the arm stand, then co-contract it: its stiffness along x, and how far the tip moved."""
    tip = rig.tip.copy()

    def away():
        return 1e3 * float(np.linalg.norm(np.array(rig.tips[begin:]) - tip, axis=1).max())

    begin = len(rig.tips)
    rig.run(STANDING_S)
    stood, tip, begin = away(), rig.tip.copy(), len(rig.tips)
    model, arm = rig.core.model, rig.stiffness()
    before = model.tip_stiffness(rig.core.track.last).along([1, 0, 0])
    wants = Preferences(
        low_tension=0.5,
        stiffness=0.1,
        stiffness_direction=(1, 0, 0),
        stiffness_enough=ENOUGH * before,
    )
    rig.core.settings = replace(rig.core.settings, preferences=wants)
    least, twice_mm, twice_s = 1.0, None, None
    for look in range(round(seconds / LOOK_S)):
        rig.run(LOOK_S)
        least = rig.stiffness() / arm
        if twice_s is None and least >= LIMITS['stiffness_factor']:
            twice_mm, twice_s = away(), LOOK_S * (look + 1)
    after = model.tip_stiffness(rig.core.track.last).along([1, 0, 0])
    return {
        'factor_of_the_model': after / before,
        'factor_of_the_arm': least,
        'twice_after_s': twice_s,
        'tip_moved_until_twice_mm': twice_mm,
        'tip_moved_mm': away(),
        'tip_moved_standing_mm': stood,
    }


def bench_ticks():
    """One program with its Jacobian and the equilibrium it leads to: median and 99 %."""
    made = {}
    for name in ('kato_10_1', 'spatial_6'):
        for remembers in (False, True):
            model = Model(robot_of(name, remembers))
            low, high = model.limits.T
            shape = model.shape(low + 0.12 * (high - low) * np.linspace(0.5, 1.5, len(low)))
            past = shape.memory if remembers else model.arrays.fresh_memory()
            wants, took = Preferences(slack=0.1), []
            for number in range(TICKS):
                angle = 0.1 * number
                place = shape.tip_position + 5e-4 * np.array([np.cos(angle), 0.0, np.sin(angle)])
                began = time.thread_time()
                task = TipTask.at(model, place, memory=past)
                balance = Balance(task, wants)
                at = balance.begin(shape)
                balance.solve_at(at, balance.step(at, 0.02))
                took.append(1e3 * (time.thread_time() - began))
            kind = f'{name}{"_remembers" if remembers else ""}'
            for share in (50, 99):
                made[f'{kind}_{share}_ms'] = round(float(np.percentile(took[50:], share)), 3)
            made[f'{kind}_met'] = made[f'{kind}_99_ms'] <= LIMITS['tick_ms'][name]
    return made


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--orders', type=int, default=20)
    parser.add_argument('--places', type=int, default=8)
    parser.add_argument('--gain', type=float, default=6.0)
    parser.add_argument('--lead', type=float, default=0.03)
    parser.add_argument('--seconds', type=float, default=120.0, help='of co-contraction')
    parser.add_argument('--robot', default='kato_10_1')
    parser.add_argument('--knows', default='memory', choices=('', *DESCRIBED))
    parser.add_argument('--exact', action='store_true', help='an arm that is what is written')
    parser.add_argument('--kinds', nargs='+', default=list(KINDS), choices=KINDS)
    parser.add_argument('--resume', type=Path, help='file of orders: read first, then added to')
    parser.add_argument('--only', choices=PARTS)
    parser.add_argument('--json', type=Path)
    options = parser.parse_args()
    arm = options.robot, options.exact
    file = options.resume or Path(tempfile.mkdtemp()) / 'orders.jsonl'
    parts = {
        'ticks': bench_ticks,
        'orders': lambda: bench_orders(options.orders, *arm, options.kinds, file),
        'load': lambda: bench_load(options.places, options.gain, *arm, options.knows),
        'path': lambda: bench_path(options.gain, options.lead, *arm, options.knows),
        'reachable': lambda: bench_reachable(options.places, options.robot),
        'stiffness': lambda: bench_stiffness(
            options.places, options.gain, options.seconds, *arm, options.knows
        ),
    }
    figures = {**machine(), 'asked': LIMITS}
    for name, part in parts.items():
        if options.only in (None, name):
            figures[name] = part()
    tell(figures, options.json)
    return figures


if __name__ == '__main__':
    main()
