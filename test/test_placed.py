"""What pushes the arm at a place is named, placed, and told from what pushes elsewhere."""

import math
from dataclasses import replace

import numpy as np
import pytest
import simulated
from marks import slow
from measurements import blind

from tendon_robot_ros.data import load_dataset
from tendon_robot_ros.diagnosis.add import add_effect, fit_effects
from tendon_robot_ros.diagnosis.diagnose import diagnose
from tendon_robot_ros.diagnosis.placed import Screen, acting, directions, pushes_by, ways
from tendon_robot_ros.diagnosis.select import gather
from tendon_robot_ros.diagnosis.verdict import Verdict
from tendon_robot_ros.inference.crossval import described_by
from tendon_robot_ros.inference.predict import Predictor
from tendon_robot_ros.inference.session import Question
from tendon_robot_ros.report.comparison import Push
from tendon_robot_ros.report.diagnosis_text import verdict
from tendon_robot_ros.report.sentences import pushed
from tendon_robot_ros.robot import load_robot
from tendon_robot_ros.simulation.hidden import Workmanship
from tendon_robot_ros.simulation.measurements import simulate
from tendon_robot_ros.simulation.plant import make_plant
from tendon_robot_ros.workspace.postures import default_postures

pytestmark = pytest.mark.long

ARMS = {  # robot, cell, fixed point [m], pull of the straight arm [N]
    'planar': ('kato_10_1_single', 5, (0.12, 0.0, 0.15), 0.06),
    'spatial': ('spatial_3', 5, (0.07, 0.08, 0.1), 0.05),
}
FACES = 'stiffness', 'distance', 'azimuth', 'elevation'
WALLS = {  # stiffness [N/m], distance [m], azimuth [rad], elevation [rad]
    'planar': (15.0, 0.04, math.pi, -0.3),
    'spatial': (15.0, 0.04, -2.2, -0.3),
}
FIRM = 1e-3  # [N] of a push: a lighter touch may not be seen
BUILT = {'exact': True, 'as built': False}
CASES = [
    slow('planar', 'exact'),
    ('spatial', 'exact'),
    ('planar', 'as built'),
    slow('spatial', 'as built'),
]
# of what pushes an arm as built `make test` has the wall
FEWER = [*CASES[:2], slow('planar', 'as built'), CASES[3]]


def middle(arm):
    """Return the middle of the cell where something is tied."""
    robot = simulated.robot(ARMS[arm][0], cells=6)
    return {'arc_length': (ARMS[arm][1] - 0.5) / robot.cells * robot.length}


def measured(arm, hidden, exact=False, count=12):
    """Return measurements of an arm of six cells, as built or exact, that hides something."""
    robot = simulated.robot(ARMS[arm][0], cells=6)
    if exact:
        return simulated.measured(replace(robot, exact=True), hidden, count=count)
    plant = make_plant(robot, hidden, seed=3, work=Workmanship())
    rows = default_postures(robot, count, 0, 'tension', 'from_straight')
    return replace(simulate(plant, rows, seed=3), robot=robot)


def assert_told(told, true):
    """Assert that values are within three sd of the truth; one of 400 is not, by chance."""
    for key, value in true.items():
        one = told[key]
        turns = 2.0 * np.pi * round((one.value - value) / (2.0 * np.pi)) * (one.unit == 'rad')
        assert abs(value + turns - one.value) < 3.0 / 1.96 * 0.5 * (one.high - one.low), key


@pytest.mark.parametrize(('arm', 'built'), FEWER)
def test_a_string_is_named_with_its_place_and_its_fixed_point(arm, built):
    _, _, point, tension = ARMS[arm]
    anchor = dict(zip(('point_x', 'point_y', 'point_z'), point, strict=True))
    hidden = {'tether': {**middle(arm), 'tension': tension, **anchor}}
    found = diagnose(measured(arm, hidden, BUILT[built]))
    assert found.verdict is Verdict.MISSING_EFFECT
    assert [effect.name for effect in found.effects] == ['tether']
    told = found.effects[0].parameters
    for key, value in (anchor | middle(arm)).items():
        assert told[key].value == pytest.approx(value, abs=0.01), key
    assert_told(told, anchor | middle(arm))
    assert told['arc_length'].low <= middle(arm)['arc_length'] <= told['arc_length'].high
    assert told['tension'].value == pytest.approx(tension, rel=0.2)
    assert found.error_after < 0.1 * found.error_before


def test_a_spring_is_told_from_a_string_of_constant_tension():
    anchor = dict(zip(('point_x', 'point_y', 'point_z'), ARMS['spatial'][2], strict=True))
    spring = {**middle('spatial'), **anchor, 'stiffness': 1.5, 'slack_length': 0.05}
    found = diagnose(measured('spatial', {'tether': spring}, exact=True))
    assert (found.verdict, [one.name for one in found.effects]) == ('missing_effect', ['tether'])
    told = found.effects[0].parameters
    assert 'tension' not in told
    assert told['stiffness'].value == pytest.approx(spring['stiffness'], rel=0.05)
    for key in (*anchor, 'arc_length', 'slack_length'):
        assert told[key].value == pytest.approx(spring[key], abs=0.006), key


@pytest.mark.parametrize('arm', [slow('planar'), 'spatial'])
def test_a_load_that_is_always_the_same_stays_a_tip_load(arm):
    force = 0.5 * ARMS[arm][3]
    hidden = {'tip_load': {'force_x': force, 'force_z': -force}}
    found = diagnose(measured(arm, hidden))
    assert found.verdict in (Verdict.MISSING_EFFECT, Verdict.AMBIGUOUS)
    assert found.effects[0].name == 'tip_load'


def test_a_string_that_imitates_stiff_and_soft_cells_does_not_beat_a_tip_load():
    """Its score is better by 15, with twice the parameters and a place that was searched for."""
    robot = load_robot('kato_10_1_single')
    load = {'force_x': 0.0011, 'force_z': -0.0032}
    plant = make_plant(robot, {'tip_load': load}, seed=1, work=Workmanship())
    found = diagnose(simulate(plant, default_postures(robot, 30), trials=5, seed=1))
    assert found.effects[0].name == 'tip_load'
    assert {*found.cannot_tell_apart} <= {'tip_load', 'tether'}


@pytest.mark.parametrize(('arm', 'built'), FEWER)
def test_a_constant_force_within_the_arm_is_named_with_its_place(arm, built):
    """A string from far away is the same, which the verdict then says."""
    force = {'force_x': 0.5 * ARMS[arm][3], 'force_z': -0.5 * ARMS[arm][3]}
    found = diagnose(measured(arm, {'point_load': middle(arm) | force}, BUILT[built], count=8))
    named = {found.effects[0].name, *found.cannot_tell_apart}
    assert found.verdict.may_add and 'point_load' in named <= {'point_load', 'tether'}
    told = next(row.parameters for row in found.candidates if row.name == 'point_load')
    place = middle(arm)['arc_length']
    assert told['arc_length'].value == pytest.approx(place, abs=0.003)
    for key, value in force.items():
        assert told[key].value == pytest.approx(value, rel=0.1), key


@pytest.mark.parametrize('arm', ARMS)
def test_the_search_for_a_load_starts_beside_what_imperfections_explain(arm):
    """A force that is screened as if the arm were exact would be many times too small."""
    force = {'force_x': 0.2 * ARMS[arm][3], 'force_z': -0.2 * ARMS[arm][3]}
    dataset = measured(arm, {'point_load': middle(arm) | force})
    session = Question.of(dataset, dataset.robot, simulated.CATALOGUE).prepared()
    screen = Screen.of(session.fitter, session.base_fit())
    start = next(screen.loads())
    assert abs(start['arc_length'] - middle(arm)['arc_length']) < 0.2 * screen.length
    assert start['force_x'] == pytest.approx(force['force_x'], rel=0.5)


def test_a_wall_chooses_its_postures_and_a_load_acts_in_all():
    assert [ways('contact', postures) for postures in (3, 4, 5, 12)] == [8, 16, 30, 464]
    assert [ways(name, 12) for name in ('point_load', 'tether')] == [1, 2]


@pytest.mark.parametrize(('arm', 'built'), CASES)
def test_a_wall_is_named_with_the_postures_that_touch_it_and_added(arm, built):
    wall = dict(zip(FACES, WALLS[arm], strict=True))
    dataset = measured(arm, {'contact': wall}, BUILT[built])
    found = diagnose(dataset)
    assert [effect.name for effect in found.effects] == ['contact']
    assert_told(found.effects[0].parameters, wall)
    described = dataset.robot.with_effect('contact', wall)
    true = acting(Predictor(dataset, described, simulated.CATALOGUE), {}, 'contact')
    firm = np.linalg.norm(np.nan_to_num(true[:, 4:]), axis=1) > FIRM
    touched = {one['posture']: one for one in found.details['pushes']['contact']}
    assert {dataset.postures[p] for p in np.flatnonzero(firm)} <= set(touched)
    assert len(touched) < len(dataset.postures)
    for p in np.flatnonzero(firm):
        one = touched[dataset.postures[p]]
        assert one['arc_length'] == pytest.approx(true[p, 0], abs=0.1 * dataset.robot.length)
        off = np.linalg.norm(np.array(one['force']) - true[p, 4:])
        assert off < 0.3 * np.linalg.norm(true[p, 4:]) + FIRM
    assert 'touches in postures' in verdict(found)
    made = add_effect(dataset, found.effects)
    assert made.check.gone > 0.8


def test_the_measured_arm_is_where_the_markers_that_were_seen_say():
    wall = dict(zip(FACES, WALLS['planar'], strict=True))
    dataset = measured('planar', {'contact': wall})
    positions = dataset.positions.copy()
    positions[:, :, -1] = np.nan
    screens = []
    for one in (dataset, replace(dataset, positions=positions)):
        session = Question.of(one, dataset.robot, simulated.CATALOGUE).prepared()
        screens.append(Screen.of(session.fitter, session.base_fit()))
    whole, without_tip = (screen.measured for screen in screens)
    pushed_by = np.linalg.norm(whole - screens[0].free, axis=2).max()
    assert np.linalg.norm(whole - without_tip, axis=2).max() < 0.3 * pushed_by


def test_the_measured_arm_is_the_same_in_whatever_frame_the_tracker_sees_it():
    frame = {'rotation_x': 0.3, 'rotation_y': 0.9, 'rotation_z': -0.5, 'shift_x': 0.01}
    wall = dict(zip(FACES, WALLS['planar'], strict=True))
    robot, screens = simulated.robot(cells=5, exact=True), []
    for seen in (robot, robot.with_effect('base_misalignment', frame)):
        dataset = simulated.measured(seen, {'contact': wall}, count=6)
        session = Question.of(dataset, seen, simulated.CATALOGUE).weigh()
        screens.append(Screen.of(session.fitter, session.base_fit()))
    plain, turned = screens
    pushed_by = np.linalg.norm(plain.measured - plain.free, axis=2).max()
    assert np.linalg.norm(turned.measured - plain.measured, axis=2).max() < 0.1 * pushed_by


def test_what_pushes_the_arm_is_told_with_the_effects_beside_it():
    wall = dict(zip(FACES, (40.0, 0.035, math.pi, 0.0), strict=True))
    described = simulated.robot(cells=5, exact=True).with_effect('contact', wall)
    stiffer = {'backbone_stiffness': {'relative_change': 0.8}}
    dataset = simulated.measured(described, stiffer, count=10)
    session = Question.of(dataset, described, simulated.CATALOGUE).prepared()
    session, fit = fit_effects(session, ['contact', *stiffer])
    robot = described_by(session, fit, beside=False)
    rows = acting(Predictor(dataset, robot, session.catalogue), {}, 'contact')
    touching = np.flatnonzero(np.isfinite(rows[:, 0]))
    told = pushes_by(session, fit, 'contact')
    assert [one['posture'] for one in told] == [dataset.postures[p] for p in touching]
    np.testing.assert_allclose([one['force'] for one in told], rows[touching, 4:], rtol=1e-3)


def test_imperfections_are_weighed_as_they_move_an_arm_that_is_held():
    """A free arm answers them in another way, and intervals of the wall would miss it."""
    wall = dict(zip(FACES, WALLS['planar'], strict=True))
    dataset = measured('planar', {'contact': wall}, count=8)
    question = Question.of(dataset, dataset.robot, simulated.CATALOGUE)
    fits = gather(question.prepared())
    chosen = fits.judge().chosen
    assert chosen.names == ('contact',)
    weighed = fits.session.imperfections.moves
    held = fits.session.weigh(chosen.fit).imperfections.moves
    free = fits.session.weigh().imperfections.moves
    assert np.abs(weighed - held).max() < 0.1 * np.abs(free - held).max()


PUSHES = {  # what pushes, and the expected place [m] and force [N] on a straight arm of 40 mm
    'a load at its place': (
        'point_load', {'arc_length': 0.015, 'force_z': -0.2}, 0.015, (0.0, 0.0, -0.2)),
    'a string along itself': (
        'tether', {'arc_length': 0.02, 'point_z': 0.1, 'tension': 0.3}, 0.02, (0.0, 0.0, 0.3)),
    'a slack string not': (
        'tether', {'arc_length': 0.02, 'point_z': 0.1, 'slack_length': 0.2, 'stiffness': 9.0},
        math.nan, None),
    'a wall where the arm is behind it': (
        'contact', {'stiffness': 1.0, 'distance': 0.035, 'elevation': -0.5 * math.pi},
        0.04, (0.0, 0.0, -0.005)),
    'a wall out of reach not': (
        'contact', {'stiffness': 100.0, 'distance': 0.05, 'elevation': -0.5 * math.pi},
        math.nan, None),
}  # fmt: skip


@pytest.mark.parametrize('case', PUSHES)
def test_where_something_pushes_the_arm_follows_from_its_law(case):
    name, values, place, force = PUSHES[case]
    robot = simulated.robot(cells=4)
    robot = replace(robot, sections=(replace(robot.sections[0], cell_length=0.01),))
    dataset = simulated.postures(robot.with_effect(name, values), np.zeros((1, 2)))
    (row,) = acting(Predictor(dataset, dataset.robot, simulated.CATALOGUE), {}, name)
    assert row[0] == pytest.approx(place, abs=1e-9, nan_ok=True)
    if force is not None:
        np.testing.assert_allclose(row[1:4], [0.0, 0.0, place], atol=1e-9)
        np.testing.assert_allclose(row[4:], force, atol=1e-9)


def test_directions_are_evenly_spread():
    """A neighbour of each is about 15° away, and none is missing."""
    every = directions()
    np.testing.assert_allclose(np.linalg.norm(every, axis=1), 1.0)
    angles = np.degrees(np.arccos(np.clip(every @ every.T - 2.0 * np.eye(len(every)), -1.0, 1.0)))
    assert angles.min(axis=0).min() > 10.0 and angles.min(axis=0).max() < 16.0


def test_friction_that_settles_elsewhere_lets_no_string_win():
    """The prior rows of a pattern are their own sum, not what a settled shape leaves of chi²."""
    found = diagnose(load_dataset(blind('c') / 'fit'))
    assert found.verdict is Verdict.MISSING_EFFECT
    assert [effect.name for effect in found.effects] == ['tendon_friction']


def test_the_postures_and_places_of_a_push_are_said():
    rows = [('4', 0.118, 0.002), ('7', 0.121, 0.001), ('9', 0.12, 0.006)]
    names = 'posture', 'arc_length', 'half'
    said = pushed([dict(zip(names, row, strict=True)) for row in rows])
    assert said == {'postures': 'postures 4, 7 and 9', 'place': '120 ± 6 mm'}
    assert pushed([]) == {}


def drawn(push):
    """Return the points (n, 3) [mm] of what is drawn of a push on an arm of 0.1 m."""
    traces = push.traces(0.1, 0.0)
    return [np.array([trace[axis] for axis in 'xyz'], dtype=float).T for trace in traces]


def test_a_push_is_an_arrow_with_its_string_or_its_wall():
    at, force = np.array([0.01, 0.0, 0.08]), np.array([-0.5, 0.0, 0.0])
    (arrow,) = drawn(Push(at, force))
    np.testing.assert_allclose(arrow[0], 1e3 * at)
    along = arrow[1] - arrow[0]
    assert along[0] < 0.0 and not along[1:].any()
    _, string = drawn(Push(at, force, to=np.array([-0.1, 0.0, 0.08])))
    np.testing.assert_allclose(string, [[10.0, 0.0, 80.0], [-100.0, 0.0, 80.0]])
    _, wall = drawn(Push(at, force, is_wall=True))
    np.testing.assert_allclose(wall.mean(axis=0), 1e3 * at)
    np.testing.assert_allclose((wall[1] - wall[0]) @ force, 0.0, atol=1e-9)
