"""Several data sets of one robot as one, and what is known of each."""

from dataclasses import replace

import numpy as np
import pytest
import simulated
import small_dataset
from arms import planar, spatial
from simulated import measure, postures

from tendon_robot_ros.common.errors import DataSetError, EffectError
from tendon_robot_ros.comparison.compare import compare, equilibria
from tendon_robot_ros.data import join, load_dataset, save_dataset
from tendon_robot_ros.data.dataset import EarlierRecording, names_in
from tendon_robot_ros.diagnosis.add import add_effect
from tendon_robot_ros.diagnosis.diagnose import diagnose
from tendon_robot_ros.diagnosis.improve import improve
from tendon_robot_ros.diagnosis.result import total
from tendon_robot_ros.diagnosis.verdict import Verdict
from tendon_robot_ros.inference.crossval import set_alike
from tendon_robot_ros.inference.imperfections import (
    ANEW,
    POSITION,
    ROTATION,
    BuiltPredictor,
    imperfections,
)
from tendon_robot_ros.inference.predict import Predictor
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.report.improvement_page import improvement_lines
from tendon_robot_ros.robot.estimates import natural_sizes
from tendon_robot_ros.simulation.hidden import Workmanship
from tendon_robot_ros.simulation.measurements import simulate
from tendon_robot_ros.simulation.plant import make_plant
from tendon_robot_ros.workspace.postures import default_postures

ROBOT = replace(planar(5), gravity=(0.0, 0.0, 0.0), exact=True)
INPUTS = np.array([[0.0, 1.0], [1.4, 0.2], [0.3, 1.8], [2.2, 0.0], [1.0, 0.9]])
LOAD = {'tip_load': {'force_x': 0.05, 'force_z': 0.2}}


def loaded(robot=ROBOT, **fields):
    """Return measurements without a load, and with a known one."""
    free = replace(measure(postures(robot, INPUTS, 3), seed=1), name='lab/free')
    weighed = measure(postures(robot, INPUTS[:3], 4), LOAD, seed=2)
    return free, replace(weighed, name='lab/weight', known=LOAD, **fields)


def test_postures_keep_their_data_set_and_the_trials_they_had():
    both = join(loaded())
    assert both.postures[0] == 'free/0' and both.postures[5] == 'weight/0'
    assert both.name == 'lab/free lab/weight' and names_in(both.name) == ['lab/free', 'lab/weight']
    apart = join(
        [replace(one, name=name) for one, name in zip(loaded(), ("it's", 'my arm'), strict=True)]
    )
    assert names_in(apart.name) == ["it's", 'my arm'] and names_in("it's") == ["it's"]
    assert both.positions.shape[:2] == (8, 4)
    assert both.trials.tolist() == [3] * 5 + [4] * 3
    assert [part.name for part, _ in both.divided] == ['free', 'weight']
    assert [rows.tolist() for _, rows in both.divided] == [[0, 1, 2, 3, 4], [5, 6, 7]]
    assert both.groups[0] == both.groups[5] and len(set(both.groups.tolist())) == 5


def test_one_data_set_stays_as_it_is_and_joined_ones_join_again():
    free, weighed = loaded()
    assert join([free]) is free
    three = join([join([free, weighed]), replace(free, name='again')])
    assert [part.name for part, _ in three.divided] == ['free', 'weight', 'again']
    part = three.select([three.postures[1], three.postures[6]])
    assert part.part.tolist() == [0, 1]


def test_postures_of_data_sets_of_one_name_have_names_of_their_own():
    free = loaded()[0]
    both = join([free, free])
    assert (both.postures[0], both.postures[5]) == ('lab/free no 1/0', 'lab/free no 2/0')
    assert both.select(both.postures[:1]).postures == both.postures[:1]


def test_a_data_set_of_which_no_posture_is_selected_has_no_part_in_what_is_predicted():
    free, weighed = loaded()
    _, check = join([free, weighed.select(['0'])]).hold_out(0.2)
    assert [part.name for part, _ in check.divided] == ['free']
    shown = Predictor(check, ROBOT, simulated.CATALOGUE).markers({})
    assert np.allclose(shown, Model(ROBOT).shapes(check.inputs).positions, rtol=0, atol=1e-12)


def test_what_is_known_acts_on_its_own_postures_only():
    both = join(loaded())
    predictor = Predictor(both, ROBOT, simulated.CATALOGUE)
    shown = predictor.markers({})
    plain = Model(ROBOT).shapes(INPUTS)
    pulled = Model(ROBOT.with_effect('tip_load', LOAD['tip_load'])).shapes(INPUTS[:3])
    expected = [batch.markers(both.arc_lengths, both.offsets) for batch in (plain, pulled)]
    assert np.allclose(shown, np.concatenate(expected), rtol=0, atol=1e-12)
    assert np.allclose(equilibria(predictor).positions[5:], pulled.positions, rtol=0, atol=1e-12)
    assert compare(both).measured.floor is not None
    unknown = replace(both, parts=tuple(replace(part, known={}) for part in both.parts))
    assert compare(unknown).text().endswith(' diagnose lab/free lab/weight')


def test_gravity_is_that_of_each_data_set():
    heavy = replace(ROBOT, gravity=None).with_effect('gravity', {'linear_density': 0.3})
    free = postures(heavy, INPUTS)
    lying, standing = (
        replace(free, gravity=g, name=str(g)) for g in ((9.81, 0.0, 0.0), (0.0, 0.0, -9.81))
    )
    both = Predictor(join([lying, standing]), heavy, simulated.CATALOGUE).markers({})
    for data, found in ((lying, both[:5]), (standing, both[5:])):
        alone = Predictor(data, heavy, simulated.CATALOGUE).markers({})
        assert np.allclose(found, alone, rtol=0, atol=1e-12)


def test_imperfections_move_each_data_set_as_they_move_it_alone():
    heavy = replace(ROBOT, gravity=None, exact=False).with_effect(
        'gravity', {'linear_density': 0.3}
    )
    free, weighed = loaded(heavy)
    free = replace(free, gravity=(9.81, 0.0, 0.0))
    weighed = replace(weighed, gravity=(0.0, 0.0, -9.81))
    joined, *alone = (
        imperfections(BuiltPredictor(Predictor(data, heavy, simulated.CATALOGUE)), {})
        for data in (join([free, weighed]), free, weighed)
    )
    kinds = [joined.kinds[i].name for i in joined.owners]
    anew = np.array([kind in ANEW.values() for kind in kinds])
    # the remainder is another one in every posture
    own = ~anew & (joined.owners < len(joined.kinds) - 1)
    for rows, single in ((slice(0, 5), alone[0]), (slice(5, 8), alone[1])):
        moves = single.moves[single.owners < len(single.kinds) - 1]
        np.testing.assert_allclose(joined.moves[own][:, rows], moves, rtol=1e-5, atol=1e-7)
    for kind in (POSITION, ROTATION):  # of one recording they do not move the other
        both = joined.moves[np.array(kinds) == kind]
        first, second = np.split(joined.moves[np.array(kinds) == ANEW[kind]], 2)
        np.testing.assert_allclose(first[:, :5], both[:, :5], rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(second[:, 5:], both[:, 5:], rtol=1e-9, atol=1e-12)
        assert not first[:, 5:].any() and not second[:, :5].any()


def on_two_days(robot, input, seed, lacks, again=1.0):
    """Return two recordings of an arm as built, the second with zeros and frame set again."""
    rng, sets = np.random.default_rng(seed), []
    for day, moved in enumerate((0.0, again)):
        rows = default_postures(robot, 8, seed + day, input, 'from_straight')
        plant = make_plant(robot, lacks, seed=seed, work=Workmanship())
        one = simulate(plant, rows, input=input, seed=10 * seed + day)
        turn = np.eye(3) + np.cross(np.eye(3), moved * rng.normal(0.0, np.radians(0.3), 3))
        places = one.positions @ turn + moved * rng.normal(0.0, 5e-4, 3)
        zeros = (input == 'displacement') * moved * rng.normal(0.0, 2e-4, rows.shape[1])
        sets.append(replace(one, name=f'day {day}', positions=places, inputs=one.inputs + zeros))
    return sets


@pytest.mark.long
@pytest.mark.parametrize('input', ['tension', 'displacement'])
@pytest.mark.parametrize('robot', ['planar', 'spatial'])
def test_zeros_and_trackers_frame_may_differ_between_recordings(robot, input):
    """They are no effect that is missing, and one that is missing is named beside them."""
    robot = {'planar': planar(5), 'spatial': spatial(4)}[robot]
    robot = replace(robot, gravity=(0.0, 0.0, 0.0))
    for seed in (1, 2):
        same, again = (on_two_days(robot, input, seed, {}, moved) for moved in (0.0, 1.0))
        assert diagnose(again).verdict is diagnose(same).verdict
    old = on_two_days(robot, input, 3, {})
    force = natural_sizes(robot)['force']
    new = on_two_days(robot, input, 3, {'tip_load': {'force_x': force}})
    for found in diagnose(new, reference=old), diagnose(new[1], reference=old[0]):
        told = {effect.name: effect.parameters for effect in found.effects}
        assert told['tip_load']['force_x'].low <= force <= told['tip_load']['force_x'].high
    mixed = diagnose([old[0], new[1]])
    mind = any("diagnose 'day 1' --reference 'day 0'" in said for said in mixed.details['caveats'])
    assert mind == (mixed.verdict is Verdict.OUTSIDE_CATALOGUE)


@pytest.mark.long
@pytest.mark.parametrize('input', ['tension', 'displacement'])
@pytest.mark.parametrize('robot', ['planar', 'spatial'])
def test_what_is_set_anew_in_each_recording_is_no_error_of_a_description(robot, input):
    """Errors are those of the arm whose zeros and tracker stayed as they were."""
    robot = {'planar': planar(5), 'spatial': spatial(4)}[robot]
    robot = replace(robot, gravity=(0.0, 0.0, 0.0))
    lacks = {'tendon_friction': {'friction_coefficient': 0.15}}
    same, again = (on_two_days(robot, input, 5, lacks, moved) for moved in (0.0, 1.0))
    once, better = improve(same), improve(again)
    assert total(better.chosen) < 1.3 * total(once.chosen)
    told = better.falling['fitted'][better.taken]
    alone, added = (add_effect(sets, ['tendon_friction']) for sets in (same, again))
    for kind in ('fitted', 'check'):
        one, other = (getattr(addition, kind) for addition in (alone, added))
        assert other.after == pytest.approx(one.after, rel=0.1), kind
    alike = set_alike(join(again), better.robot, simulated.CATALOGUE, better.anew)
    assert compare(alike, better.robot).models[0].rms == pytest.approx(told, rel=0.01)
    assert any('position of the tracker in each' in text for text in improvement_lines(better))


def test_a_known_load_gives_the_scale_of_forces():
    """Pulled by lengths, stiffness and forces have one scale: a known weight tells it."""
    soft = planar(5, {'wire_spring': {'compliance': 1e-3}, 'pull_zero': {'offset': 1e-3}})
    soft = replace(soft, gravity=(0.0, 0.0, 0.0), exact=True)
    pulls = np.array([[-3e-3, 3e-3], [4e-3, -4e-3], [-1e-3, 1e-3], [6e-3, -6e-3]])
    truth = {'backbone_stiffness': {'relative_change': 0.3}}
    sets = [
        measure(postures(soft, pulls, 4, input='displacement'), truth | hidden, seed=seed)
        for seed, hidden in ((1, {}), (2, LOAD))
    ]
    both = join([replace(sets[0], name='a'), replace(sets[1], name='b', known=LOAD)])
    made = add_effect(both, ['backbone_stiffness', 'wire_spring'])
    value = made.values['backbone_stiffness']['relative_change']
    assert value.low <= 0.3 <= value.high
    assert value.high - value.low < 0.2
    assert 'tip_load' not in made.robot.effects


@pytest.mark.parametrize(
    ('changes', 'message'),
    [
        ({'input': 'displacement'}, 'has other input than lab/free'),
        ({'path': 'sequence'}, 'has other path than lab/free'),
        ({'robot': replace(ROBOT, tension_limits=(0.0, 9.0))}, 'has another robot description'),
        (
            {'reference': EarlierRecording('old', 1e-3, np.zeros(3), np.zeros(3), {})},
            'lab/weight: the deviations of old are taken off it; join before',
        ),
    ],
)
def test_data_sets_that_do_not_belong_together_are_refused(changes, message):
    free, weighed = loaded()
    with pytest.raises(DataSetError, match=message):
        join([free, replace(weighed, **changes)])


@pytest.mark.parametrize(
    ('known', 'message'),
    [
        ({'load': {'force_z': 1.0}}, "lab/free: known: unknown effect 'load'; known: "),
        (
            {'tip_load': {'fz': 1.0}},
            'known: tip_load: expected one of force_x, force_y, force_z, moment_x',
        ),
        ({'tip_load': {'force_z': 1e9}}, 'known: tip_load.force_z: expected a number from'),
    ],
)
def test_what_cannot_be_known_is_refused(known, message):
    with pytest.raises(EffectError) as refusal:
        Predictor(replace(loaded()[0], known=known), ROBOT, simulated.CATALOGUE)
    assert message in str(refusal.value)


def test_joined_data_sets_are_not_written_as_one(tmp_path):
    with pytest.raises(DataSetError, match='was joined from free, weight'):
        save_dataset(join(loaded()), tmp_path / 'both')


def test_known_effects_are_read_and_written(tmp_path):
    text = small_dataset.DATASET + 'known: {tip_load: {force_z: 0.98}}\n'
    data = load_dataset(small_dataset.write(tmp_path / 'a', dataset=text))
    assert data.known == {'tip_load': {'force_z': 0.98}}
    assert load_dataset(save_dataset(data, tmp_path / 'b')).known == data.known


@pytest.mark.parametrize(
    ('line', 'message'),
    [
        ('known: 3', 'known: got 3; expected'),
        ('known: {tip_load: }', 'known: got {}; expected parameters such as tip_load: {force_z'),
        ('known: {tip_load: {force_z: big}}', "known.tip_load.force_z: got 'big'"),
    ],
)
def test_known_effects_that_are_none_are_refused(tmp_path, line, message):
    folder = small_dataset.write(tmp_path / 'a', dataset=small_dataset.DATASET + line)
    with pytest.raises(DataSetError) as refusal:
        load_dataset(folder)
    assert message in str(refusal.value)
