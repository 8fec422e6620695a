"""Improving: what joins, when it stops, and that its left-out error is no postures' own."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import simulated
from arms import planar
from simulated import CATALOGUE, measured
from source_tree import ROOT

from tendon_robot_ros import improve, load_robot
from tendon_robot_ros.cli.main import main
from tendon_robot_ros.data import save_dataset
from tendon_robot_ros.diagnosis.improve import how_many, shown
from tendon_robot_ros.diagnosis.result import total
from tendon_robot_ros.diagnosis.stepwise import Stepwise
from tendon_robot_ros.inference.crossval import fall, last_worthwhile, left_out_errors
from tendon_robot_ros.inference.description import (
    DescribedArm,
    arm_with,
    blocks_of_the_arm,
    profile_factors,
    with_cells,
)
from tendon_robot_ros.inference.noise import Noise, Whitener
from tendon_robot_ros.inference.predict import Predictor
from tendon_robot_ros.report.improvement_page import (
    improvement_lines,
    sentences,
    step_table,
)
from tendon_robot_ros.robot import dump_robot, parse_robot
from tendon_robot_ros.simulation.measurements import SimulatedNoise, simulate
from tendon_robot_ros.simulation.plant import make_plant

ROBOT = simulated.robot()
HIDDEN = {
    'hinge_friction': {'lever': 2e-4},
    'tip_load': {'force_x': 0.02, 'force_y': 0.0, 'force_z': 0.0},
}


def errors_of(robot, dataset):
    """Return the distances (P, J) [m] of a description from measurements."""
    shown = Predictor(dataset, robot, CATALOGUE).markers({})
    return np.linalg.norm(dataset.mean - shown, axis=2)


def rms_of(robot, dataset):
    """Return rms distances (J,) [m]."""
    return np.sqrt((errors_of(robot, dataset) ** 2).mean(axis=0))


@pytest.fixture(scope='module')
def arm():
    """Return measurements of an arm that hides two effects, other ones, and what was found."""
    dataset = measured(ROBOT, HIDDEN, seed=1)
    check = measured(ROBOT, HIDDEN, count=6, which=1, seed=2)
    return dataset, check, improve(dataset, check=check)


def test_both_hidden_effects_are_found_and_then_it_stops(arm):
    _, _, found = arm
    assert found.taken == 2 and len(found.steps) == 3
    assert found.values.keys() == HIDDEN.keys()
    for name, values in found.values.items():
        for key, value in values.items():
            half = value.high - value.low
            assert value.low - half <= HIDDEN[name][key] <= value.high + half, (name, key)
    said = '\n'.join(improvement_lines(found))
    assert 'It stops there: what remains is noise (p = ' in said
    assert repr(found).startswith('<Improvement by tip_load, hinge_friction: left out 15')


def test_a_marker_that_was_never_seen_keeps_no_effect_out():
    described = simulated.robot(cells=4, exact=True)
    dataset = measured(described, {'backbone_stiffness': {'relative_change': 0.3}})
    positions = dataset.positions.copy()
    positions[:, :, 2] = np.nan
    found = improve(replace(dataset, positions=positions))
    assert found.taken == 1
    assert total(found.steps[1].left_out) < 0.1 * total(found.steps[0].left_out)


def test_the_errors_of_every_step_are_those_of_descriptions(arm):
    dataset, check, found = arm
    last = found.steps[found.taken]
    np.testing.assert_allclose(last.fitted, rms_of(found.robot, dataset), rtol=1e-9)
    np.testing.assert_allclose(last.check, rms_of(found.robot, check), rtol=1e-9)
    np.testing.assert_allclose(found.steps[0].left_out, rms_of(ROBOT, dataset), rtol=1e-9)
    assert total(last.fitted) < total(last.left_out) < 3.0 * found.noise_floor
    assert total(last.check) < 3.0 * found.noise_floor
    falling = found.falling
    assert falling['left out'] == sorted(falling['left out'], reverse=True)


def test_a_posture_left_out_has_no_part_in_its_prediction(arm):
    dataset, _, found = arm
    p = int(np.argmax(list(found.tips.values())))
    others = [q for q in range(len(dataset.postures)) if q != p]
    without = replace(
        dataset,
        postures=tuple(dataset.postures[q] for q in others),
        inputs=dataset.inputs[others],
        positions=dataset.positions[others],
    )
    search = Stepwise(without, ROBOT, CATALOGUE)
    robot = search.written([*search.path()][-1])
    assert errors_of(robot, dataset)[p, -1] == pytest.approx(
        found.tips[dataset.postures[p]], rel=0.05
    )


def test_nothing_joins_where_nothing_is_missing(tmp_path, capsys, monkeypatch):
    dataset = measured(ROBOT, count=6)
    found = improve(dataset)
    assert found.taken == 0 and len(found.steps) == 1
    assert found.robot.effects == ROBOT.effects
    monkeypatch.setattr('tendon_robot_ros.cli.diagnosis.improve', lambda *args, **more: found)
    save_dataset(dataset, tmp_path / 'data')
    new = tmp_path / 'new.yaml'
    assert main(['improve', str(tmp_path / 'data'), '--output', str(new)]) == 2
    assert 'Nothing was written: there is no step' in capsys.readouterr().out
    assert not new.exists()


def test_a_stiffness_that_changes_along_the_arm_is_found_and_written():
    coefficients = [0.3, -0.2]
    factors = profile_factors(coefficients, ROBOT)
    true = with_cells(ROBOT, factors, digits=12)
    dataset = replace(measured(true, seed=3), robot=ROBOT)
    found = improve(dataset)
    assert [step.joined for step in found.steps[1 : found.taken + 1]] == ['bending_stiffness']
    change = np.divide(*(r.sections[0].bending_stiffness for r in (found.robot, true)))
    assert np.abs(np.log(change[1:-1])).max() < 0.1
    assert '% at the middle' in '\n'.join(improvement_lines(found))


@pytest.mark.parametrize('name', ['kato_10_1', 'spatial_6'])
def test_an_effect_that_keeps_a_better_one_out_is_exchanged_for_it(name):
    robot = simulated.robot(name, lacks=simulated.SHAPING)
    changes = [0.3, -0.2]
    hidden = {'section_stiffness': {'relative_change': changes}}
    dataset = measured(robot, hidden, seed=3)
    search = Stepwise(dataset, robot, CATALOGUE)
    own = ('backbone_stiffness', 'section_stiffness')
    search.blocks = [block for block in search.blocks if block.label in own]
    (first,) = (block for block in search.blocks if block.label == own[0])
    state = search.fitted((first,), {}, search.weights())
    better = search.step(state, {})
    assert (better.names, better.removed) == ({own[1]}, (own[0],))
    assert better.score < state.score
    np.testing.assert_allclose(better.fit.values, changes, atol=0.02)


def test_what_moved_of_the_arm_is_what_the_description_says():
    robot = simulated.robot('spatial_3')
    dataset = measured(robot, count=4)
    arm = DescribedArm(dataset, robot, CATALOGUE)
    frees = [free for block in blocks_of_the_arm(robot) for free in block.frees]
    assert {free.effect for free in frees} == {'bending_stiffness', 'tendon_routes'}
    moves = np.random.default_rng(0).normal(size=len(frees))
    point = {f: float(3.0 * f.parameter.typical * x) for f, x in zip(frees, moves, strict=True)}
    shown = Predictor(dataset, arm_with(robot, point), CATALOGUE).markers({})
    np.testing.assert_allclose(arm.markers(point), shown, atol=1e-7)
    before = Predictor(dataset, robot, CATALOGUE).markers({})
    assert np.abs(shown - before).max() > 1e-3
    np.testing.assert_allclose(arm.markers({}), before, atol=1e-7)
    again = parse_robot(dump_robot(arm_with(robot, point)))
    assert again.tendons == arm_with(robot, point).tendons


def test_stiffness_along_the_arm_and_routes_have_the_slopes_of_differences():
    robot = simulated.robot('spatial_3')
    dataset = measured(robot, count=3)
    arm = DescribedArm(dataset, robot, CATALOGUE)
    frees = [free for block in blocks_of_the_arm(robot) for free in block.frees]
    point = {free: 0.5 * free.parameter.typical for free in frees}
    assert arm.markers(point) is not None
    near = arm.settled
    slopes = arm.tangent(point, frees, near).markers
    for free, slope in zip(frees, slopes, strict=True):
        h = 1e-2 * free.parameter.typical
        up, down = (arm.markers({**point, free: point[free] + x}, near=near) for x in (h, -h))
        np.testing.assert_allclose(slope, (up - down) / (2 * h), atol=2e-3 * np.abs(slope).max())


def test_friction_that_remembers_joins_where_visits_tell_of_it():
    """Neither of the two does what both do together, and memory has no small size to begin at."""
    robot = replace(planar(5), gravity=(0.0, 0.0, 0.0), exact=True)
    hidden = {
        'tendon_friction': {'friction_coefficient': 0.4},
        'friction_memory': {'presliding_length': 2e-4},
    }
    plant = make_plant(robot, hidden, refine=1, scatter=0.0, capstan=False)
    rng = np.random.default_rng(3)
    inputs, noise = rng.uniform(0.0, 2.0, (8, 2)), SimulatedNoise(position=1e-4)
    data = simulate(plant, inputs, noise=noise, trials=3, path='visits', seed=1)
    found = improve(data)
    assert found.values.keys() == hidden.keys()
    length = found.values['friction_memory']['presliding_length']
    assert length.low < 2e-4 < length.high
    assert total(found.steps[found.taken].left_out) < 2.0 * found.noise_floor


def test_where_a_fit_has_no_equilibrium_the_search_goes_on(arm, monkeypatch):
    def fails(*arguments):
        raise ArithmeticError('no start of the fit has an equilibrium')

    search = Stepwise(arm[0], ROBOT, CATALOGUE)
    state = next(search.path())
    monkeypatch.setattr('tendon_robot_ros.diagnosis.stepwise.Fitter.freeze', fails)
    assert search.step(state, {}) is None


def test_the_command_writes_what_it_says(arm, tmp_path, capsys, monkeypatch):
    dataset, check, found = arm
    monkeypatch.setattr('tendon_robot_ros.cli.diagnosis.improve', lambda *args, **more: found)
    for name, one in (('data', dataset), ('check', check)):
        save_dataset(one, tmp_path / name)
    new, page, out = (tmp_path / name for name in ('new.yaml', 'page.html', 'out.json'))
    call = ['improve', tmp_path / 'data', '--output', new, '--check', tmp_path / 'check']
    call += ['--report', page, '--json', out, '--workers', '1']
    assert main([str(part) for part in call]) == 0
    printed = capsys.readouterr().out
    assert f'written: {new}' in printed and '+ hinge_friction' in printed
    content = json.loads(out.read_text())
    assert content['taken'] == 2 and content['steps'][2]['joined'] == 'hinge_friction'
    robot = load_robot(new)
    np.testing.assert_allclose(content['steps'][2]['check'], rms_of(robot, check), rtol=1e-9)
    assert robot.fitted['hinge_friction']['error']['check']['after'] == pytest.approx(
        total(found.steps[2].check), rel=0.01
    )
    html = page.read_text(encoding='utf-8')
    assert 'hollow: not taken' in html and '+ tip_load' in html and 'What remains' in html


def test_an_error_of_the_only_marker_is_said_once(arm):
    found = arm[2]
    steps = [
        replace(s, fitted=s.fitted[-1:], left_out=s.left_out[-1:], check=None) for s in found.steps
    ]
    tip = replace(
        found, steps=tuple(steps), chosen=found.chosen[-1:], markers=found.markers[-1:], check=''
    )
    header, first, *_ = step_table(tip)
    assert header[1:3] == ['fitted [mm]', 'left out [mm]']
    assert ' ' not in first[1]
    assert 'at marker' not in ' '.join(sentences(tip))
    assert 'at marker' in ' '.join(sentences(found))


def test_the_curve_is_drawn(arm):
    from matplotlib import pyplot as plt

    _, _, found = arm
    axes = found.plot()
    shown = {line.get_label(): line.get_ydata() for line in axes.lines}
    np.testing.assert_allclose(shown['left out'], 1e3 * np.array(found.falling['left out']))
    plt.close('all')


def test_left_out_errors_are_those_of_a_linear_fit_without_the_group():
    rng = np.random.default_rng(0)
    dataset = simulated.postures(ROBOT, rng.uniform(0.1, 1.0, (5, len(ROBOT.inputs))), trials=1)
    dataset = replace(dataset, positions=np.zeros(dataset.positions.shape))
    P, J = dataset.positions.shape[0], len(dataset.markers)
    slopes = np.zeros((P, len(ROBOT.inputs), J, 3))
    noise = Noise(1e-3, 0.0, 0.0, np.inf, 'declared')
    whitener = Whitener(dataset, noise, slopes, 2e-3, 1e-3)
    moves = rng.normal(size=(3, P, J, 3))
    off = rng.normal(size=(P, J, 3))
    jacobian, white = -whitener.white(moves).T, whitener.white(off)
    step = np.linalg.lstsq(jacobian, white, rcond=None)[0]
    groups = np.array([0, 1, 1, 2, 3])
    errors = left_out_errors(white - jacobian @ step, jacobian, whitener, groups)
    for p in range(P):
        used = groups[whitener.owners] != groups[p]
        own = np.linalg.lstsq(jacobian[used], white[used], rcond=None)[0]
        left = off[p] + np.tensordot(own, moves, 1)[p]
        assert errors[p] == pytest.approx((left**2).sum(axis=1).mean(), rel=1e-6)


def test_a_fall_within_its_scatter_is_not_taken():
    before = np.full((6, 1), 4e-6)
    uneven = before + np.array([[1e-6], [-3e-6], [3e-6], [-3e-6], [2e-6], [-1e-6]])
    better = 0.5 * before
    assert last_worthwhile(np.array([before, uneven, better])) == 2
    gain, scatter = fall(before, uneven)
    assert gain < scatter
    assert fall(before, better) == pytest.approx((2e-3 - np.sqrt(2e-6), 0.0))
    assert last_worthwhile(np.array([before, uneven])) == 0


def test_a_search_says_how_many_steps_are_taken_and_other_postures_may_take_some_back():
    own = [SimpleNamespace(left_out=np.full(6, one)) for one in (9.0, 4.0, 3.0, 2.0)]
    nested = np.array([9.0, 5.0, 4.5, 4.0])[:, None, None] * np.ones((4, 6, 2))
    assert how_many(own, nested) == 3, 'though the last falls are small'
    assert how_many(own[:3], nested) == 2, 'no further than the search went'
    nested[3] = 4.6
    assert how_many(own, nested) == 2


def test_a_step_that_needs_a_later_one_is_shown_with_it():
    squares = np.array([9.0, 4.0, 5.0, 3.0, 3.5, 2.0, 2.1])
    assert shown(squares[:, None, None], 5) == [0, 1, 3, 5, 6]
    assert shown(squares[:, None, None], 0) == [0, 1, 2, 3, 4, 5, 6]
    lower = np.array([9.0, 4.0, 1.9, 2.0])  # the one before was within its scatter
    assert shown(lower[:, None, None], 3) == [0, 1, 3]
    lost = np.array([9.0, np.inf, 4.0, np.inf, 3.9])  # no equilibrium until the next has joined
    assert shown(lost[:, None, None], 2) == [0, 2, 4]


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        ({'--output': 'nowhere/new.yaml'}, 'nowhere/new.yaml: its folder does not exist'),
        ({'data': 'nothing'}, 'nothing'),
    ],
)
def test_bad_input_is_one_line(change, message, tmp_path, capsys):
    given = {'--output': str(tmp_path / 'new.yaml')} | change
    data = given.pop('data', str(ROOT / 'data' / 'tentacle'))
    options = [part for pair in given.items() for part in pair]
    assert main(['improve', data, *options]) == 1
    error = capsys.readouterr().err
    assert message in error and error.count('\n') == 1


def test_too_few_postures_are_refused(tmp_path, capsys):
    save_dataset(measured(ROBOT, count=3), tmp_path / 'data')
    assert main(['improve', str(tmp_path / 'data'), '--output', str(tmp_path / 'n.yaml')]) == 1
    assert 'expected 4 or more measured postures' in capsys.readouterr().err
