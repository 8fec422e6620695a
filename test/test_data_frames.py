"""Measurements and results as tables of pandas, and back."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from source_tree import ROOT

pytest.importorskip('pandas')

import pandas

from tendon_robot_ros import DataSet, Marker, Model, compare, load_dataset, load_robot
from tendon_robot_ros.common.errors import DataSetError, TendonRobotError
from tendon_robot_ros.diagnosis.result import CandidateRow, Diagnosis, EffectFinding
from tendon_robot_ros.effects import load_catalogue
from tendon_robot_ros.inference.intervals import Value
from tendon_robot_ros.inference.predict import Predictor

ROBOT = load_robot(ROOT / 'config/robots/kato_10_1_single.yaml')
CELLS = ROBOT.cells


@pytest.fixture(scope='module')
def dataset():
    return load_dataset(ROOT / 'data/hinge_friction/fit')


def same(one, other, rtol=1e-15):
    """Refuse data sets whose measurements differ."""
    assert (one.postures, one.markers, one.trial_names) == (
        other.postures, other.markers, other.trial_names
    )  # fmt: skip
    assert_array_equal(one.positions, other.positions)
    assert_allclose(one.inputs, other.inputs, rtol=rtol)


def test_a_frame_gives_the_same_data_set(dataset):
    frame = dataset.frame()
    assert list(frame.columns[:7]) == [
        'posture', 'trial', 'marker', 'arc_length', 'x', 'y', 'z'
    ]  # fmt: skip
    assert len(frame) == 12 * 5 * 15
    assert frame.attrs['units'] == {'arc_length': 'm', 'x': 'm', 'y': 'm', 'z': 'm',
                                    'left': 'N', 'right': 'N'}  # fmt: skip
    same(DataSet.from_frame(frame, dataset.robot), dataset)
    shuffled = frame.sort_values('marker', kind='stable')
    again = DataSet.from_frame(shuffled, dataset.robot, position_noise=2e-4)
    assert again.position_noise == 2e-4
    by_name = [[m.name for m in again.markers].index(m.name) for m in dataset.markers]
    assert_array_equal(again.positions[:, :, by_name], dataset.positions)


def test_what_was_not_seen_and_inputs_of_every_trial_survive(dataset):
    positions, inputs = dataset.positions.copy(), np.repeat(dataset.inputs[:, None], 5, axis=1)
    positions[3, 2, 4] = np.nan
    positions[5, 1] = np.nan  # a whole trial
    inputs = inputs * np.linspace(0.99, 1.01, 5)[:, None]
    changed = replace(dataset, positions=positions, trial_inputs=inputs)
    again = DataSet.from_frame(changed.frame(), dataset.robot)
    same(again, changed, rtol=2e-3)  # of the fifth posture one trial fewer makes the mean
    assert_allclose(again.trial_inputs[changed.trial_mask], inputs[changed.trial_mask])


def test_a_sequence_keeps_a_posture_that_nobody_measured(dataset):
    positions = dataset.positions.copy()
    positions[4] = np.nan
    changed = replace(dataset, positions=positions, path='sequence')
    again = DataSet.from_frame(changed.frame(), dataset.robot, path='sequence')
    assert again.postures == changed.postures
    assert again.trials[4] == 0


def test_arrays_of_any_rank_make_a_data_set():
    inputs = [[1.0, 0.0], [0.0, 2.0]]
    shapes = Model(ROBOT).shapes(inputs)
    data = DataSet.from_arrays(ROBOT, inputs, shapes.positions)
    assert (data.postures, data.trial_names) == (('0', '1'), ('0',))
    assert_allclose(Predictor(data, ROBOT, load_catalogue(())).markers({}), data.mean)
    tip = DataSet.from_arrays(
        ROBOT, inputs, shapes.positions[:, None, -1:], markers=[ROBOT.length], gravity=(0, 0, 9.81)
    )
    assert tip.markers == (Marker('1', ROBOT.length),)
    assert tip.gravity == (0, 0, 9.81)


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        ({'positions': np.zeros((2, 3))}, r'positions: has shape \(2, 3\); expected \(post'),
        ({'positions': np.zeros((2, 4, 3))}, 'markers: there are 4, none with a place; give the'),
        ({'markers': [0.1]}, f'there are {CELLS}, 1 with a place'),
        ({'markers': [1e3 * k for k in range(CELLS)]}, 'a marker is at .* m of an arm of'),
        ({'positions': np.full((2, CELLS, 3), 50.0)}, 'a marker is 50 m away, but the robot is'),
        ({'inputs': [[1000.0, 0.0], [0.0, 1.0]]}, 'a tendon is 1000 N, but tension_limits end'),
        ({'inputs': [[-1.0, 0.0], [0.0, 1.0]]}, 'expected a finite tension not below'),
        ({'inputs': [[1.0], [0.0]]}, r'inputs: expected \(postures, 2\) numbers for '),
        ({'inputs': [[np.nan, 1.0], [0.0, 0.0]]}, 'got nan; say 0 where a tendon is slack'),
        ({'inputs': [[1.0, 1.0]]}, 'inputs: has shape'),
        (
            {'inputs': np.zeros((0, 2)), 'positions': np.zeros((0, CELLS, 3))},
            'positions: hold no posture',
        ),
        ({'position_noise': 0.2 * 1e3}, 'position_noise: expected a number from 0 to 0.1'),
        ({'path': 'visits'}, 'path: expected one of from_straight, sequence, got'),
    ],
)  # fmt: skip
def test_arrays_in_other_units_or_shapes_are_refused(change, message):
    fields = {'inputs': [[1.0, 0.0], [0.0, 2.0]], 'positions': np.zeros((2, CELLS, 3)), **change}
    with pytest.raises(TendonRobotError, match=message):
        DataSet.from_arrays(ROBOT, **fields)


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        (lambda f: f.drop(columns='left'), "no column 'left'; a row per posture and marker needs"),
        (lambda f: pandas.concat([f, f[:1]]), "posture '0', trial '0', marker '1' stands twice"),
        (lambda f: f.assign(x=['a', *f['x'][1:]]), r"row 0: x is 'a'; expected a number or nan"),
        (
            lambda f: f.assign(left=[9.0, *f['left'][1:]]),
            'row 0: left is 9, in another row',
        ),
        (lambda f: f.drop(columns='arc_length')[f['marker'] != '2'], 'there are 14, none with'),
        (lambda f: f[:0], 'DataFrame: has no row; a table over time goes'),
        (
            lambda f: f.assign(arc_length=[0.02, *f['arc_length'][1:]]),
            "row 0: marker '1' is at 0.02 m; in another row it is at 0.00693333 m",
        ),
        (
            lambda f: f.assign(arc_length=[np.nan, *f['arc_length'][1:]]),
            "row 0: marker '1' is at nan m; in another row",
        ),
    ],
)
def test_a_frame_that_does_not_fit_is_refused(dataset, change, message):
    with pytest.raises(DataSetError, match=message):
        DataSet.from_frame(change(dataset.frame()), dataset.robot)


def test_a_wire_that_is_slack_in_some_trials_only_is_refused(dataset):
    pulls = 1e-3 * dataset.inputs_by_trial
    pulled = replace(dataset, input='displacement', trial_inputs=pulls)
    frame = pulled.frame()
    frame.loc[(frame['posture'] == '2') & (frame['trial'] == '1'), 'left'] = np.nan
    with pytest.raises(DataSetError, match=r"posture '2': an input is nan \(slack\) in some"):
        DataSet.from_frame(frame, dataset.robot, input='displacement')


def test_errors_and_candidates_are_tables(dataset):
    comparison = compare(dataset)
    errors = comparison.frame()
    assert len(errors) == 12 * 15
    tip = errors[errors['marker'] == '15']['error']
    assert np.sqrt((tip**2).mean()) == pytest.approx(comparison.best.per_marker_rms[-1])
    away = errors[['measured_x', 'measured_y', 'measured_z']].to_numpy()
    away = away - errors[['predicted_x', 'predicted_y', 'predicted_z']].to_numpy()
    assert_allclose(np.linalg.norm(away, axis=1), errors['error'])


def test_a_diagnosis_is_a_table_and_a_picture():
    value = Value(0.15, 0.14, 0.16, 'N')
    rows = [
        CandidateRow(name, {'force_x': value}, 1.0, 3, 0.4, 0.9, error, error, 'best', False)
        for name, error in (('tip_load', 1e-3), ('gravity', 4e-3))
    ]
    diagnosis = Diagnosis(
        'missing_effect', (EffectFinding('tip_load', {'force_x': value}, 0.99),), (), (), (),
        8e-3, 1e-3, 2e-4, None, '', tuple(rows),
    )  # fmt: skip
    table = diagnosis.frame()
    assert list(table['effect']) == ['tip_load', 'gravity']
    assert table.iloc[0][['parameter', 'value', 'unit']].tolist() == ['force_x', 0.15, 'N']
    axes = diagnosis.plot()
    assert [bar.get_width() for bar in axes.patches[:2]] == pytest.approx([1.0, 4.0])
    assert axes.get_title() == 'missing_effect: tip_load'
    assert axes.lines[0].get_xdata()[0] == pytest.approx(8.0)
    import matplotlib.pyplot as plt

    plt.close('all')
