"""Recordings of many postures: which of them are used, and what the path between them does."""

from dataclasses import replace

import numpy as np
import pytest

from tendon_robot_ros.data import DataSet
from tendon_robot_ros.data.dataset import BLOCKS_MAX
from tendon_robot_ros.data.visits import corners, remembered
from tendon_robot_ros.diagnosis.diagnose import diagnose
from tendon_robot_ros.diagnosis.improve import improve
from tendon_robot_ros.effects import load_catalogue
from tendon_robot_ros.inference import session
from tendon_robot_ros.inference.predict import Predictor, free_parameters
from tendon_robot_ros.report.diagnosis_text import lines
from tendon_robot_ros.robot import load_robot

NOISE_M = 2e-4
COUNT = 120
USED = 24


def arm(**effects):
    """Return an arm of two sections with three wires each, without friction."""
    section = {'cells': 2, 'cell_length': 0.03, 'bending_stiffness': 0.2, 'bends_as': 'arc'}
    angles = np.radians([0.0, 120.0, 240.0, 60.0, 180.0, 300.0])
    return load_robot(
        {
            'name': 'six_wires',
            'sections': [{'name': 's1', **section}, {'name': 's2', **section}],
            'tendons': [
                {
                    'name': f'w{k}',
                    'offset': [float(5e-3 * np.cos(a)), float(5e-3 * np.sin(a))],
                    'section': f's{1 + k // 3}',
                }
                for k, a in enumerate(angles)
            ],
            'tension_limits': [0.0, 50.0],
            'gravity': [0.0, 0.0, 0.0],
            'effects': {'wire_spring': {'compliance': 1e-4}} | effects,
        }
    )


def pulls(count):
    """Return pulls (count, 6) [m]: sections bend to and fro in six directions, one by one."""
    amount = np.concatenate([np.linspace(0, 1, 11)[:-1], np.linspace(1, 0, 11)[:-1]])
    rows = []
    for move in range(-(-count // len(amount))):
        bend, section = np.radians(60.0 * move), move // 6 % 2
        towards = np.cos(np.radians(120.0 * np.arange(3) + 60.0 * section) - bend)
        wires = np.zeros((len(amount), 6))
        wires[:, 3 * section : 3 * section + 3] = 4e-3 * amount[:, None] * towards
        rows.append(wires)
    return np.concatenate(rows)[:count]


def restless(count):
    """Return pulls (count, 6) [m]: both sections bend anew in every posture, to any side."""
    bends = np.random.default_rng(2).uniform(-4e-3, 4e-3, (count, 2, 2))
    angles = np.radians([[0.0, 120.0, 240.0], [60.0, 180.0, 300.0]])
    towards = np.stack([np.cos(angles), np.sin(angles)])  # (2, 2, 3) axis, section, wire
    return np.einsum('bsa,asw->bsw', bends, towards).reshape(count, 6)


def recording(count=COUNT, path='sequence', inputs=None, **hidden):
    """Return the tip positions of an arm with hidden effects, described without them."""
    inputs, described = pulls(count) if inputs is None else inputs, arm()
    blank = DataSet.from_arrays(
        described,
        inputs,
        np.zeros((count, 1, 3)),
        markers=[described.length],
        input='displacement',
        path=path,
        position_noise=NOISE_M,
    )
    tips = Predictor(blank, arm(**hidden), load_catalogue()).markers({})
    noise = np.random.default_rng(1).normal(0.0, NOISE_M, tips.shape)
    return replace(blank, positions=(tips + noise)[:, None])


@pytest.mark.parametrize(
    ('path', 'kept', 'found'),
    [
        ([0, 1, 2, 3], [3], [0, 3]),
        ([0, 1, 2, 3, 2, 1, 0], [6], [0, 3, 6]),
        ([0, 1, 2, 3, 2, 1, 0], [4, 6], [0, 3, 4, 6]),
        ([0, 0, 0, 1, 1, 1, 1], [6], [0, 6]),  # where it rests, and when, does not matter
        ([0, 1.0, 2.01, 3, 4], [4], [0, 4]),  # within 2 % of the largest
    ],
)
def test_a_path_is_straight_between_its_corners(path, kept, found):
    assert corners(np.array(path, dtype=float)[:, None], np.array(kept)).tolist() == found


@pytest.mark.parametrize(
    ('path', 'kept', 'found'),
    [
        ([[0], [1], [0], [1], [0], [1]], [5], [4, 5]),
        ([[0], [1], [0], [1], [0], [1]], [3, 5], [2, 3, 4, 5]),
        ([[0, 3], [1, 3], [0, 3], [1, 3], [0, 3]], [4], [3, 4]),  # one that never moves
        ([[0, 0], [0, 1], [1, 1], [0, 1], [1, 1]], [4], [0, 1, 2, 3, 4]),  # one that rests since
    ],
)
def test_a_path_is_remembered_until_every_input_has_gone_up_and_down(path, kept, found):
    assert remembered(np.array(path, dtype=float), np.array(kept)).tolist() == found


def test_few_postures_are_all_used_and_of_many_some_evenly_spread():
    data = recording(40)
    assert data.thinned(40) is data
    thin = data.thinned(10)
    used = np.flatnonzero(thin.trials > 0)
    order = [data.postures.index(thin.postures[p]) for p in used]
    assert len(used) == 10
    assert set(np.diff(order)) <= {4, 5}
    assert thin.thinned_from == 40
    free = recording(40, path='from_straight').thinned(10)
    assert len(free.postures) == 10, 'no path leads to them'


@pytest.mark.parametrize(('count', 'blocks'), [(12, 12), (BLOCKS_MAX, BLOCKS_MAX), (320, 32)])
def test_neighbours_of_a_sequence_are_left_out_together(count, blocks):
    groups = recording(count).groups
    assert len(np.unique(groups)) == blocks
    assert (np.diff(groups) >= 0).all()
    assert np.bincount(groups).max() == count // blocks


HYSTERESIS = {'bending_hysteresis': {'lag': 0.02, 'presliding': 0.1}}


@pytest.mark.parametrize(
    ('inputs', 'used', 'hidden'),
    [
        (pulls(120), 20, {}),
        (pulls(120), 20, HYSTERESIS),
        (restless(120), 6, HYSTERESIS),
        (restless(120), 6, {'backlash': {'width': 2e-3}}),
    ],
)
def test_a_thinned_sequence_is_predicted_as_the_whole_one(inputs, used, hidden):
    """Also where bends remember: their law has the same end however a straight way is divided."""
    data = recording(120, inputs=inputs)
    thin = data.thinned(used)
    every, few = (Predictor(one, arm(**hidden), load_catalogue()) for one in (data, thin))
    whole, part = every.markers({}), few.markers({})
    rows = [data.postures.index(name) for name in thin.postures]
    used = thin.trials > 0
    assert len(rows) < 60
    assert np.allclose(part[used], whole[rows][used], atol=1e-5)
    if hidden:
        plain = Predictor(data, arm(), load_catalogue()).markers({})
        assert np.abs(whole - plain).max() > 5e-4, 'it is seen'


def test_slopes_along_a_thinned_path_are_those_along_the_whole_one():
    """Of an effect that remembers, though the model without it need not know the path."""
    data = recording(120)
    thin, slopes = data.thinned(20), []
    for one in (data, thin):
        predictor = Predictor(one, arm(), load_catalogue())
        lag = free_parameters(predictor.model.catalogue['bending_hysteresis'], predictor.robot)[0]
        assert predictor.markers({}) is not None
        slopes.append(predictor.tangent({}, [lag], predictor.settled).markers[0])
    measured = thin.trials > 0
    rows = [data.postures.index(thin.postures[p]) for p in np.flatnonzero(measured)]
    assert np.allclose(slopes[1][measured], slopes[0][rows], atol=1e-4)
    assert np.abs(slopes[1][measured]).max() > 1e-2


@pytest.fixture
def few_are_used(monkeypatch):
    """Use so few postures that a test is quick."""
    monkeypatch.setattr(session, 'POSTURES_MAX', USED)


@pytest.mark.long
def test_the_text_says_how_many_postures_were_used_and_the_error_is_of_all(few_are_used):
    data = recording(tip_load={'force_x': 0.05})
    found = diagnose(data)
    assert [effect.name for effect in found.effects] == ['tip_load']
    text = '\n'.join(lines(found))
    assert f'{USED} of {COUNT} postures were used, evenly spread' in text
    tips = Predictor(data, data.robot, load_catalogue()).markers({})
    off = np.linalg.norm(data.mean - tips, axis=2)
    assert found.error_before == pytest.approx(np.sqrt((off**2).mean()))


def test_improve_uses_some_postures_and_says_so(few_are_used):
    data = recording(tip_load={'force_x': 0.05})
    found = improve(data)
    assert 'tip_load' in [step.joined for step in found.steps[: found.taken + 1]]
    assert found.left_out['thinned'] == [USED, COUNT]
    assert len(found.tips) == USED
    last = found.steps[found.taken]
    assert last.fitted[0] < 1.1 * np.sqrt(3.0) * NOISE_M
    assert last.left_out[0] < 1.2 * np.sqrt(3.0) * NOISE_M
