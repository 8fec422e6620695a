"""Every public function takes what a user would give it, and refuses the rest in one line."""

import inspect
from dataclasses import replace

import numpy as np
import pytest
import yaml
from source_tree import ROOT

import tendon_robot_ros
from tendon_robot_ros import (
    DataSet,
    Model,
    add_effect,
    compare,
    default_postures,
    diagnose,
    dump_robot,
    improve,
    join,
    load_dataset,
    load_robot,
    make_plant,
    save_dataset,
    simulate,
)
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
        ('nobody', r'nobody: .*known names: kato_10_1, kato_10_1_single, '),
        ('nobody.yaml', 'nobody.yaml: file: expected a readable YAML file'),
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
        (
            [[1.0] * 3, [1.0, np.nan, 0.0]],
            r'posture 1, two: expected a finite .* nan; say 0 where',
        ),
        ([[1.0, -1.0, 0.0]], 'tensions: two: expected a finite tension not below 0 N'),
        ([['a', 'b', 'c']], 'tensions: expected numbers for one'),
        ('spatial_3', 'tensions: expected numbers'),
        (None, r'got shape \(1,\)'),
    ],
)
def test_tensions_that_are_none_are_refused(given, said):
    with pytest.raises(InputError, match=said):
        Model('spatial_3').shapes(given)


MODEL = Model(SHIPPED)
ROWS = np.array([[2.0, 0.1, 0.3], [0.1, 0.2, 1.5], [0.0, 1.0, 0.0], [0.5, 0.0, 2.0]])
PLACES = MODEL.shapes(ROWS).positions
DATA = DataSet.from_arrays(SHIPPED, ROWS, PLACES, position_noise=1e-4)
FOLDER = ROOT / 'data' / 'hinge_friction' / 'fit'

# what is nothing of the kind that any argument takes
NEITHER = [object(), 3, 1.5, b'text', True, {1: 2}, np.zeros(3), 'no such thing', ['no such']]
NO_NUMBER = [object(), 'three', b'3', [1, 2], np.zeros(3), -1, np.nan, None]
NO_ROWS = [object(), 'three', None, 3, [], np.zeros(3), [[1.0]], {'one': [1.0]}, [['a'] * 3]]
NO_WORD = [object(), 3, 'tensions', None, []]
LIKE = {
    'robot': NEITHER, 'dataset': NEITHER, 'data': [*NEITHER, [], [3], DATA.frame],
    'datasets': [*NEITHER, [], [3]], 'check': NEITHER, 'catalogue': NEITHER, 'models': NEITHER,
    'recipe': NEITHER, 'source': NEITHER[:-2], 'plant': NEITHER, 'hidden': NEITHER,
    'name': [object(), 3, None, 'no such effect', []], 'folder': [object(), 3, None, ''],
    'workers': NO_NUMBER, 'trials': NO_NUMBER, 'count': NO_NUMBER, 'seed': NO_NUMBER,
    'refine': NO_NUMBER, 'scatter': NO_NUMBER, 'starts': NO_NUMBER, 'progress': [3, 'bar'],
    'position_noise': [*NO_NUMBER[:-1], 2.0], 'accuracy': [*NO_NUMBER[:-1], 2.0],
    'setting_noise': NO_NUMBER[:-1], 'trial_noise': NO_NUMBER[:-1], 'gravity': NO_ROWS[:2],
    'input': NO_WORD, 'path': NO_WORD, 'error': NO_WORD, 'inputs': NO_ROWS,
    'tensions': [object(), 'three', None, [1.0], {'tree': 1.0}, [-1.0] * 3, [np.nan] * 3],
    'pulls': [object(), 'three', None, [1.0], {'tree': 1.0}, [np.inf] * 3],
    'positions': [object(), 'three', None, 3, np.zeros((4, 3)), 1e3 * PLACES],
    'frame': NEITHER, 'noise': NEITHER, 'guess': NEITHER,
    'position': [object(), 'three', [1.0], [np.nan] * 3, [0.0, 0.0, 90.0]],
    'direction': [object(), 'three', [1.0], [np.nan] * 3, np.zeros(3)],
    'markers': [object(), 3, 'three', [1.0], ['a'] * len(DATA.markers)],
    'postures': [object(), 3, ['a'], ['a'] * 4],
}  # fmt: skip
CALLS = {
    'load_robot': (load_robot, {'robot': SHIPPED}),
    'dump_robot': (dump_robot, {'robot': SHIPPED}),
    'load_dataset': (load_dataset, {'data': FOLDER, 'robot': None}),
    'save_dataset': (save_dataset, {'dataset': DATA, 'folder': 'never'}),
    'join': (join, {'datasets': [DATA, DATA]}),
    'from_arrays': (
        DataSet.from_arrays,
        {'robot': SHIPPED, 'inputs': ROWS, 'positions': PLACES, 'markers': None, 'postures': (),
         'input': 'tension', 'path': 'sequence', 'gravity': None, 'position_noise': None,
         'accuracy': None, 'setting_noise': 0.0, 'trial_noise': 0.0},
    ),
    'from_frame': (DataSet.from_frame, {'frame': DATA, 'robot': SHIPPED}),
    'Model': (Model, {'robot': SHIPPED, 'catalogue': None}),
    'shape': (MODEL.shape, {'tensions': ROWS[0]}),
    'pull_shape': (MODEL.pull_shape, {'pulls': [0.001] * 3}),
    'reach': (MODEL.reach, {'position': [0.0, 0.0, 0.1], 'direction': None, 'guess': None,
                            'starts': 1}),
    'compare': (compare, {'dataset': DATA, 'models': SHIPPED, 'catalogue': None, 'error': 'ci'}),
    'diagnose': (diagnose, {'dataset': DATA, 'robot': None, 'catalogue': None, 'workers': 1,
                            'progress': None}),
    'improve': (improve, {'dataset': DATA, 'robot': None, 'catalogue': None, 'check': None,
                          'workers': 1, 'progress': None}),
    'add_effect': (add_effect, {'dataset': DATA, 'name': 'tip_load', 'robot': None,
                                'catalogue': None, 'check': None}),
    'default_postures': (default_postures, {'robot': SHIPPED, 'count': 3, 'seed': 0,
                                            'input': 'tension', 'path': 'from_straight'}),
    'make_plant': (make_plant, {'robot': SHIPPED, 'hidden': None, 'catalogue': None, 'refine': 1,
                                'scatter': 0.0, 'seed': 0}),
    'simulate': (simulate, {'plant': SHIPPED, 'inputs': ROWS, 'trials': 1, 'seed': 0,
                            'input': 'tension', 'path': 'from_straight', 'noise': None,
                            'markers': None, 'postures': ()}),
    'import_table': (tendon_robot_ros.import_table, {'source': (), 'robot': SHIPPED,
                                                     'recipe': None, 'catalogue': None}),
}  # fmt: skip


@pytest.mark.parametrize(
    ('call', 'argument'),
    [(call, argument) for call, (_, arguments) in CALLS.items() for argument in arguments],
)
def test_what_is_of_another_kind_is_refused_in_one_line(call, argument):
    function, arguments = CALLS[call]
    for wrong in LIKE[argument]:
        with pytest.raises(TendonRobotError) as refusal:
            function(**{**arguments, argument: wrong})
        assert '\n' not in str(refusal.value)
        assert len(str(refusal.value)) < 700


def test_every_public_function_is_tried():
    functions = {
        name
        for name in tendon_robot_ros.__all__
        if inspect.isfunction(getattr(tendon_robot_ros, name))
    }
    assert functions <= set(CALLS)


@pytest.mark.parametrize('name', [name for name in CALLS if name != 'Model'])
def test_help_shows_every_parameter(name):
    kinds = [one.kind for one in inspect.signature(CALLS[name][0]).parameters.values()]
    assert inspect.Parameter.VAR_KEYWORD not in kinds
    assert inspect.getdoc(CALLS[name][0])


def test_measurements_are_named_in_every_way():
    both = load_dataset([FOLDER, load_dataset(str(FOLDER))])
    assert len(both.postures) == 2 * len(load_dataset(FOLDER).postures)
    assert load_dataset(DATA) is DATA
    other = make_plant('spatial_3').robot.with_effect('tip_load', {'force_x': 0.01})
    assert load_dataset(DATA, other).robot.effects == other.effects
    with pytest.raises(TendonRobotError, match=r'has the inputs one, two, three, not .* of kato'):
        load_dataset(DATA, 'kato_10_1')
    pandas = pytest.importorskip('pandas')
    with pytest.raises(TendonRobotError, match=r'from_frame makes one of a tidy table'):
        load_dataset(pandas.DataFrame())


def test_models_are_named_in_every_way():
    stiffer = SHIPPED.with_effect('backbone_stiffness', {'relative_change': 0.2})
    found = compare(DATA, [MODEL, stiffer, ('named', 'spatial_3')])
    assert [model.name for model in found.models] == ['spatial_3', 'spatial_3 (2)', 'named']
    assert [m.name for m in compare(DATA, {'a': stiffer, 'b': MODEL}).models] == ['a', 'b']
    assert compare(DATA, Model(stiffer)).best.rms == pytest.approx(found.models[1].rms)


def test_columns_are_matched_by_name_in_any_order():
    for given in frame_of(ROWS[:, [2, 0, 1]], ['three', 'one', 'two']):
        np.testing.assert_array_equal(
            DataSet.from_arrays('spatial_3', given, PLACES).inputs, DATA.inputs
        )
    seen = simulate('spatial_3', frame_of(ROWS[:, ::-1], ['three', 'two', 'one'])[0], trials=2)
    np.testing.assert_array_equal(seen.inputs, ROWS)


def test_a_table_sorts_postures_and_markers_in_their_order():
    pandas = pytest.importorskip('pandas')
    many = simulate('spatial_3', np.tile(ROWS, (3, 1)), trials=1)
    table = many.frame()
    for column, names in (('posture', many.postures), ('marker', [m.name for m in many.markers])):
        assert list(table[column].cat.categories) == list(names)
        assert list(table.sort_values(column)[column].unique()) == list(names)
    assert table[table.marker > '9'].arc_length.min() > table[table.marker == '9'].arc_length.max()
    shuffled = table.sample(frac=1.0, random_state=1)
    again = DataSet.from_frame(shuffled, many.robot)
    np.testing.assert_array_equal(again.positions, many.positions)
    assert isinstance(compare(many).frame().marker.dtype, pandas.CategoricalDtype)


@pytest.mark.long
def test_results_say_themselves_and_show_a_table(tmp_path):
    comparison = compare(DATA, 'spatial_3')
    exact = replace(SHIPPED, exact=True)  # so that the diagnosis takes no time
    plain = make_plant(exact, {'tip_load': {'force_x': 0.05}}, scatter=0.0)
    load = simulate(plain, default_postures('spatial_3'), trials=3)
    save_dataset(load, tmp_path / 'run')
    diagnosis = diagnose(str(tmp_path / 'run'))
    added = add_effect(load, 'tip_load')
    told = [SHIPPED, MODEL.shape(ROWS[0]), MODEL.reach([0.0, 0.01, 0.1]), DATA, comparison,
            diagnosis, added]  # fmt: skip
    for result in told:
        assert len(result.text()) > 40
        assert '<pre' in result._repr_html_()
    assert comparison.text().splitlines()[0].split()[-4:] == ['(mean', '±', '95', '%)']
    assert 'tip_load' in diagnosis.text()
    page = diagnosis._repr_html_()
    assert page.count('<tr>') == 1 + len(diagnosis.candidates)
    assert '<th>tension [N]</th>' in MODEL.shape(ROWS[0])._repr_html_()
    assert DATA._repr_html_().count('<tr>') == 1 + len(ROWS)
    shown = MODEL.shape(ROWS[0]).frame()
    assert shown.arc_length.iloc[-1] == pytest.approx(SHIPPED.length)
    assert repr(MODEL).startswith('<Model of spatial_3: ')
    assert diagnosis.effects[0].name == 'tip_load'


def test_millimetres_are_asked_back():
    with pytest.raises(InputError, match=r'position: expected metres, got .* divide by 1000'):
        MODEL.reach([10.0, 0.0, 110.0])
