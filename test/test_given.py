"""Every public function takes what a user would give it, and refuses the rest in one line."""

import numpy as np
import pytest
import yaml
from source_tree import ROOT

from tendon_robot_ros import Model, load_robot
from tendon_robot_ros.common.errors import InputError, TendonRobotError

ROBOT = ROOT / 'config' / 'robots' / 'spatial_3.yaml'
TEXT = ROBOT.read_text(encoding='utf-8')
SHIPPED = load_robot('spatial_3')


def tuples(value):
    """Return what YAML holds as a script writes it: lists as tuples, numbers of numpy."""
    if isinstance(value, dict):
        return {key: tuples(item) for key, item in value.items()}
    if isinstance(value, list):
        return tuple(map(tuples, value))
    return np.float64(value) if isinstance(value, float) else value


@pytest.mark.parametrize(
    'given',
    [ROBOT, str(ROBOT), TEXT, yaml.safe_load(TEXT), tuples(yaml.safe_load(TEXT)), SHIPPED,
     Model(SHIPPED)],
    ids=['path', 'path as text', 'text', 'dict', 'tuples', 'robot', 'model'],
)  # fmt: skip
def test_a_robot_is_named_in_every_way(given):
    assert load_robot(given) == SHIPPED or load_robot(given).inputs == SHIPPED.inputs
    assert Model(given).robot.length == SHIPPED.length


@pytest.mark.parametrize(
    ('given', 'said'),
    [
        ('spatial3', r'spatial3: expected a path or .* no such file; did you mean spatial_3\? '),
        (ROOT / 'data' / 'tentacle', r'is a folder; name its .*robot\.yaml'),
        (ROOT / 'docs', 'is a folder; name a robot description in it'),
        (' ', 'robot: expected the name of a robot .* got nothing'),
        ('no\0thing.yaml', 'a readable YAML file, got'),
        ({}, 'robot given as dict: sections: expected a list'),
        (7, 'robot: expected the name of a robot in config/robots, .* as a dict, got 7'),
        (None, 'got None'),
        (np.zeros(3), 'got ndarray array'),
    ],
)
def test_what_names_no_robot_is_refused(given, said):
    with pytest.raises(TendonRobotError, match=said):
        load_robot(given)


def frame_of(rows, names):
    """Return a DataFrame, a mapping and a structured array of the same columns."""
    pandas = pytest.importorskip('pandas')
    columns = dict(zip(names, np.asarray(rows).T, strict=True))
    records = np.rec.fromarrays(list(columns.values()), names=list(names))
    return pandas.DataFrame(columns), columns, records


def test_tensions_with_names_are_taken_by_name():
    model, rows = Model('spatial_3'), np.array([[2.0, 0.1, 0.3], [0.1, 0.2, 1.5]])
    expected = model.shapes(rows).positions
    for order in ([2, 0, 1], [1, 2, 0]):
        for given in frame_of(rows[:, order], [model.inputs[i] for i in order]):
            np.testing.assert_array_equal(model.shapes(given).positions, expected)
    numbered = frame_of(rows, model.inputs)[0]
    numbered.columns = range(3)  # of an array: these are no names
    np.testing.assert_array_equal(model.shapes(numbered).positions, expected)
    one = frame_of(rows[:, ::-1], model.inputs[::-1])[0].iloc[1]  # a Series
    np.testing.assert_array_equal(model.shape(one).positions, expected[1])


@pytest.mark.parametrize(
    ('given', 'said'),
    [
        ({'one': [1.0], 'tree': [1.0]}, "unknown 'tree'; did you mean three?"),
        ({'one': [1.0]}, "tensions: 'two', 'three' missing; spatial_3 has one, two, three"),
        ([[1.0, np.nan, 0.0]], r'posture 0, two: expected a finite .* nan; say 0 where'),
        ([[1.0, -1.0, 0.0]], 'posture 0, two: expected a finite tension not below 0 N'),
        ([['a', 'b', 'c']], 'tensions: expected numbers for one'),
        ('spatial_3', 'tensions: expected numbers'),
        (None, r'got shape \(\)|expected numbers'),
    ],
)
def test_tensions_that_are_none_are_refused(given, said):
    with pytest.raises(InputError, match=said):
        Model('spatial_3').shapes(given)
