"""Settled visits in any order: read, predicted and diagnosed by where the arm came from."""

from dataclasses import replace

import numpy as np
import pytest
import simulated
from arms import planar, spatial
from small_dataset import write

from tendon_robot_ros.common.errors import DataSetError
from tendon_robot_ros.comparison.compare import compare
from tendon_robot_ros.data import join, load_dataset, save_dataset
from tendon_robot_ros.data.bag_writer import export_bag
from tendon_robot_ros.diagnosis.diagnose import diagnose
from tendon_robot_ros.effects import load_catalogue
from tendon_robot_ros.inference.candidates import why_untested
from tendon_robot_ros.inference.noise import estimate_noise, input_slopes
from tendon_robot_ros.inference.predict import Predictor, frees_of
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.simulation.measurements import SimulatedNoise, simulate
from tendon_robot_ros.simulation.plant import make_plant

VISITS = 'path: visits\n'
ORDER = """\
posture,trial,visit,left,right
0,0,3,0.5,0.0
1,0,7,1.0,0.25
0,1,9,0.5,0.0
1,1,12,1.0,0.25
0,2,13,0.5,0.0
"""
ORIGIN = 'posture,previous,left,right\n0,1,0.5,0.0\n1,,1.0,0.25\n'
FRICTION = {'tendon_friction': {'friction_coefficient': 0.4}}
MEMORY = {'friction_memory': {'presliding_length': 2e-4}}
ROBOT = replace(planar(6, FRICTION), gravity=(0.0, 0.0, 0.0), exact=True)
INPUTS = np.array([[0.0, 1.0], [1.4, 0.2], [0.3, 1.8], [2.2, 0.0], [1.0, 0.9]])
EXACT = SimulatedNoise(0.0, 0.0, 0.0)


def visited(robot=ROBOT, hidden=None, noise=None, trials=4, seed=1):
    """Return visits in a random order of a robot without imperfections."""
    plant = make_plant(robot, hidden, refine=1, scatter=0.0, capstan=False)
    return simulate(plant, INPUTS, noise=noise, trials=trials, path='visits', seed=seed)


def test_trials_are_apart_by_the_visit_before(tmp_path):
    data = load_dataset(write(tmp_path / 'small', dataset=VISITS, inputs=ORDER))
    assert data.postures == ('0 after the straight arm', '0 after 1', '1 after 0')
    assert data.trials.tolist() == [1, 1, 1]
    assert data.visits.rows.tolist() == [0, 2, 1, 2, 1]
    assert data.visits.counts.tolist() == [True, True, True, False, False]
    assert data.trial_inputs is None
    assert data.groups[0] == data.groups[1] != data.groups[2]


def test_a_previous_posture_is_gone_to_from_the_straight_arm(tmp_path):
    data = load_dataset(write(tmp_path / 'small', dataset=VISITS, inputs=ORIGIN))
    assert data.postures == ('0 after 1', '1 after the straight arm')
    assert data.trials.tolist() == [2, 1]
    assert data.visits.rows.tolist() == [1, 0, 1]
    assert data.visits.fresh.tolist() == [True, False, True]
    assert data.visits.origins == ('1', '')


REFUSED = {
    'not declared': (ORDER, '', "row 1: column 'visit' tells of visits; write path: visits"),
    'no column': ('posture,left,right\n0,1,0\n', VISITS, 'there is neither visit nor previous'),
    'no trial': ('posture,visit,left,right\n0,1,1,0\n', VISITS, "column 'trial' is missing"),
    'twice': (ORDER.replace(',12,', ',9,'), VISITS, 'row 5: visit 9 stands twice'),
    'half': (ORDER.replace(',12,', ',1.5,'), VISITS, 'row 5: visit is no whole number'),
    'unknown': (ORIGIN.replace('0,1,', '0,bent,'), VISITS, "row 2: previous is 'bent', which no"),
}


@pytest.mark.parametrize(('inputs', 'dataset', 'message'), REFUSED.values(), ids=REFUSED)
def test_a_history_that_does_not_fit_is_refused_with_its_row(tmp_path, inputs, dataset, message):
    with pytest.raises(DataSetError) as error:
        load_dataset(write(tmp_path / 'small', inputs=inputs, dataset=dataset))
    assert message in str(error.value)


def test_a_folder_holds_the_same_visits_and_a_recording_does_not(tmp_path):
    ordered = visited()
    come_from = load_dataset(write(tmp_path / 'small', dataset=VISITS, inputs=ORIGIN))
    for name, data in {'order': ordered, 'origin': come_from}.items():
        again = load_dataset(save_dataset(data, tmp_path / name))
        assert again.postures == data.postures
        np.testing.assert_array_equal(again.positions, data.positions)
        for key in ('rows', 'fresh', 'counts', 'trials'):
            np.testing.assert_array_equal(getattr(again.visits, key), getattr(data.visits, key))
    pytest.importorskip('rosbags')
    with pytest.raises(DataSetError, match='does not hold in which order'):
        export_bag(ordered, tmp_path / 'visits.mcap')


def test_chosen_visits_keep_the_way_and_held_out_ones_the_whole_command():
    data = visited()
    chosen = data.select(data.postures[:1])
    assert chosen.postures == data.postures and (chosen.trials > 0).sum() == 1
    fit, check = data.hold_out(0.4, seed=2)
    commands = [set(np.array(d.visits.commands)[d.trials > 0]) for d in (fit, check)]
    assert not commands[0] & commands[1] and len(commands[0] | commands[1]) == len(INPUTS)


def test_without_memory_the_ways_coincide_and_with_it_they_are_a_friction_band_apart():
    """Each visit is what the model says of that way; its mean is that of the posture."""
    remembers = ROBOT.with_effect('friction_memory', MEMORY['friction_memory'])
    for robot, apart in ((ROBOT, False), (remembers, True)):
        data = visited(robot, noise=EXACT)
        shown = Predictor(data, robot, simulated.CATALOGUE).markers({})
        np.testing.assert_allclose(shown, data.mean, atol=1e-12)
        ways = data.visits.rows
        model = Model(robot)
        walked = model.sequence(data.inputs[ways]) if apart else model.shapes(data.inputs[ways])
        place = walked.markers(data.arc_lengths, data.offsets)
        np.testing.assert_allclose(
            data.positions[ways, data.visits.trials], place, rtol=0, atol=1e-12
        )
        for command in range(len(INPUTS)):
            tips = data.mean[data.groups == data.groups[command], -1]
            assert (np.ptp(tips, axis=0).max() > 1e-3) == apart


def test_two_sides_differ_by_the_friction_band_in_closed_form():
    """One cell, one tendon, long slides: tension behind the eyelet is T r or T / r."""
    mu, tension = 0.4, 0.6
    robot = replace(
        planar(2, FRICTION | {'friction_memory': {'presliding_length': 1e-6}}), exact=True
    )
    up = Model(robot).sequence([[0.0, 0.1], [0.0, tension]]).tendon_tensions[1, -1, 1]
    down = Model(robot).sequence([[0.0, 1.2], [0.0, tension]])
    bend, behind = down.bend[1, 0, 0], down.tendon_tensions[1, -1, 1]
    b = mu * np.sin(bend / 2)
    assert behind == pytest.approx(tension * (1 + b) / (1 - b), rel=1e-9)
    assert up < tension < behind


def test_pulled_wires_are_visited_as_well():
    robot = ROBOT.with_effect('friction_memory', MEMORY['friction_memory'])
    pulls = Model(robot).shapes(INPUTS[:3]).pulls
    plant = make_plant(robot, refine=1, scatter=0.0, capstan=False)
    data = simulate(
        plant, pulls, noise=EXACT, trials=2, path='visits', input='displacement', seed=4
    )
    shown = Predictor(data, robot, simulated.CATALOGUE).markers({})
    np.testing.assert_allclose(shown, data.mean, atol=1e-6)


@pytest.mark.parametrize('absent', [False, True])
@pytest.mark.parametrize('kind', ['tension', 'displacement'])
def test_tangents_of_visits_are_what_small_changes_do(kind, absent):
    """Of bends that remember, and where a fit only frees them; postures are visited again."""
    robot = planar(4, {} if absent else {'bending_hysteresis': {'lag': 0.02}})
    pulls = np.array([[4e-3, np.nan], [np.nan, 3e-3], [2e-3, np.nan], [np.nan, 5e-3]])
    inputs = INPUTS if kind == 'tension' else pulls
    data = simulate(robot, inputs, path='visits', trials=3, seed=2, input=kind)
    predictor = Predictor(data, robot, load_catalogue())
    assert len(data.visits.rows) > len(data.postures)
    names = ['bending_hysteresis', 'tendon_stiffness', 'base_misalignment']
    frees = list(frees_of(names, predictor.model.catalogue, robot))
    point = {free: predictor.start(free) for free in frees}
    predictor.markers(point)
    near = predictor.settled
    for free, moves in zip(frees, predictor.tangent(point, frees, near).markers, strict=True):
        step = 1e-4 * free.parameter.typical
        up, down = (predictor.markers({**point, free: point[free] + s}) for s in (step, 0.0))
        off, settled_within = np.abs(moves - (up - down) / step).max(), 1e-10 / step
        assert off < 1e-2 * np.abs(moves).max() + settled_within, free.key


@pytest.mark.parametrize('path', ['from_straight', 'sequence'])
@pytest.mark.parametrize('robot', [planar(4, FRICTION), spatial(3, FRICTION)])
def test_tangents_of_friction_that_a_fit_lets_remember(robot, path):
    """Whatever was predicted before: fits take turns. By pulls only further solutions show it."""
    inputs = np.random.default_rng(2).uniform(0.2, 0.8, (5, len(robot.inputs)))
    data = simulate(robot, inputs, path=path, trials=1)
    predictor = Predictor(data, robot, load_catalogue())
    names = ['tendon_friction', 'friction_memory', 'backbone_stiffness']
    frees = list(frees_of(names, predictor.model.catalogue, robot))
    # a presliding length that no way is cut otherwise for
    point = {f: predictor.value(f) if f.effect == names[0] else f.parameter.typical for f in frees}
    predictor.markers(point)
    near = predictor.settled
    predictor.markers({})
    moves = predictor.tangent(point, frees, near).markers
    for free, rates in zip(frees, moves, strict=True):
        step = 1e-4 * free.parameter.typical
        up, down = (predictor.markers({**point, free: point[free] + s}) for s in (step, -step))
        off = np.abs(rates - (up - down) / (2.0 * step)).max()
        assert off < 1e-3 * np.abs(rates).max() + 1e-10 / step, free.key
    pulled = replace(data, input='displacement', inputs=0.01 * data.inputs)
    pulled = Predictor(pulled, robot, load_catalogue())
    assert pulled.tangent(point, frees, near) is None


def test_joined_visits_are_predicted_part_by_part():
    robot = ROBOT.with_effect('friction_memory', MEMORY['friction_memory'])
    both = join(
        [visited(robot, noise=EXACT), replace(visited(robot, seed=5, noise=EXACT), name='b')]
    )
    shown = Predictor(both, robot, simulated.CATALOGUE).markers({})
    np.testing.assert_allclose(shown, both.mean, atol=1e-12)


def test_declared_noise_counts_where_earlier_visits_move_the_arm():
    data = visited(hidden=MEMORY)
    predictor = Predictor(data, ROBOT, simulated.CATALOGUE)
    slopes = input_slopes(predictor, {})
    assert estimate_noise(data, slopes).source == 'declared'
    undeclared = replace(data, position_noise=None)
    assert estimate_noise(undeclared, slopes).trial > data.trial_noise


@pytest.mark.long
def test_hidden_memory_is_named_where_there_is_some_and_only_there():
    data = visited(hidden=MEMORY)
    assert not why_untested(simulated.CATALOGUE['friction_memory'], data, ROBOT).startswith('ev')
    found = diagnose(data)
    assert [effect.name for effect in found.effects] == ['friction_memory']
    length = found.effects[0].parameters['presliding_length']
    assert length.low < 2e-4 < length.high
    assert diagnose(visited()).effects == ()
    assert compare(data).models[0].rms > compare(visited()).models[0].rms
