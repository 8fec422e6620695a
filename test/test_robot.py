"""Robot descriptions: what is read, what is refused and how, and the way back to YAML."""

import dataclasses
import json
import re
from functools import reduce
from operator import getitem

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from measurements import TENTACLE, blind
from source_tree import ROOT

from tendon_robot_ros.common.errors import InputError, RobotDescriptionError, TendonRobotError
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.robot import dump_robot, load_robot, parse_robot
from tendon_robot_ros.simulation.plant import make_plant

ARM = """
name: arm
sections:
- {name: near, cells: 3, cell_length: 0.01, bending_stiffness: [0.03, 0.02, 1e-2],
   mass_profile: [2.0, 1.0, 0.5], bends_as: hinge}
- {name: far, cells: 2, cell_length: 0.02, bending_stiffness: 0.01}
tendons:
- {name: a, offset: [0.005, 0.0], section: near}
- {name: b1, offset: {base: [0.0, 0.005], end: [0.0, 0.002]}, section: far, group: b}
- {name: b2, offset: [0.001, -0.005], section: far, group: b}
tension_limits: [0.1, 4]
gravity: [0, 0, 9.81]
tolerances: {bending_stiffness: 0.02}
effects:
  tendon_friction: {friction_coefficient: 0.3}
  section_stiffness: {relative_change: [0.1, -0.2]}
"""


def test_a_description_becomes_a_frozen_robot_in_si():
    robot = parse_robot(ARM)
    assert (robot.name, robot.cells, robot.source) == ('arm', 5, 'robot')
    assert robot.length == pytest.approx(0.07)
    assert robot.sections[0].bending_stiffness == (0.03, 0.02, 0.01)
    assert robot.sections[1].bending_stiffness == (0.01, 0.01)
    assert robot.sections[1].mass_profile == (1.0, 1.0)
    assert [section.bends_as for section in robot.sections] == ['hinge', 'arc']
    assert robot.tendons[1].base == (0.0, 0.005) and robot.tendons[1].end == (0.0, 0.002)
    assert robot.inputs == ('a', 'b') and robot.input_tendons == ((0,), (1, 2))
    assert robot.tendon_cells == (3, 5, 5)
    assert robot.tension_limits == (0.1, 4.0)
    assert robot.effects['section_stiffness'] == {'relative_change': (0.1, -0.2)}
    with pytest.raises(dataclasses.FrozenInstanceError):
        robot.name = 'other'


def test_a_description_may_be_one_line_of_json():
    described = dump_robot(load_robot('spatial_3'))
    for separators in ((',', ':'), (', ', ': ')):
        text = json.dumps(yaml.safe_load(described), separators=separators)
        assert dump_robot(load_robot(text)) == described


def test_effects_and_gravity_may_be_left_out():
    content = yaml.safe_load(ARM)
    del content['effects'], content['gravity'], content['tolerances']
    robot = parse_robot(yaml.safe_dump(content))
    assert (robot.effects, robot.gravity, robot.tolerances) == ({}, None, {})


def test_tendons_that_wind_or_go_cell_by_cell_and_weight_beside_the_axis():
    steps = [[0.005, 0.0], [0.0049, 0.001], [0.0048, 0.0014]]
    content = yaml.safe_load(ARM)
    content['tendons'][0]['offset'] = {'cells': steps}
    content['tendons'][1]['offset'] = {'base': [0.0, 0.005], 'helix': 8.0}
    content['tendons'][2]['offset'] = {'base': [0.0, 0.005], 'end': [0.0, 0.004], 'helix': -8.0}
    content['sections'][0]['mass_offset'] = [0.001, -0.002]
    content['sections'][1]['mass_offset'] = [[0.0, 0.0], [0.003, 0.0]]
    robot = parse_robot(yaml.safe_dump(content))
    listed, wound, tapered = robot.tendons
    assert listed.offsets == tuple(map(tuple, steps)) and listed.base == (0.005, 0.0)
    assert (wound.base, wound.end, wound.helix) == ((0.0, 0.005), (0.0, 0.005), 8.0)
    assert (tapered.end, tapered.helix) == ((0.0, 0.004), -8.0)
    assert robot.sections[0].mass_offset == ((0.001, -0.002),) * 3
    assert robot.sections[1].mass_offset == ((0.0, 0.0), (0.003, 0.0))
    assert parse_robot(dump_robot(robot)) == robot


def change(path, value):
    """Return the description with one value replaced, or a key taken out (None)."""
    content = yaml.safe_load(ARM)
    *above, last = (int(key) if key.isdigit() else key for key in re.findall(r'\w+', path))
    at = reduce(getitem, above, content)
    at[last] = value
    if value is None:
        del at[last]
    return yaml.safe_dump(content, allow_unicode=True)


def refused(read, path, value, said):
    """Check that what is read of a changed description is refused in these words."""
    said = said if ': expected ' in said else f'{path}: expected {said}, got {value!r}'
    with pytest.raises(RobotDescriptionError) as caught:
        read(parse_robot(change(path, value), 'arm.yaml'))
    assert str(caught.value) == f'arm.yaml: {said}'


BAD = [  # key, value, and what was expected there; or all that is said
    ('sections[0].cell_length', -0.01, 'a finite number from 1e-06 to 10 [m]'),
    ('sections[0].cell_length', 'long', 'a number from 1e-06 to 10 [m]'),
    ('sections[0].cells', 0, 'a whole number from 1 to 10000'),
    ('sections[0].cells', 2.5, 'a whole number from 1 to 10000'),
    ('sections[0].cells', True, 'a whole number from 1 to 10000'),
    ('sections[0].bending_stiffness', [1.0, 2.0], "sections[0].bending_stiffness: expected one "
     "number or 3 of them (one per cell), got '2 numbers'"),
    ('sections[0].bending_stiffness', 0.0, 'a finite number from 1e-12 to 1e+06 [N·m/rad]'),
    ('sections[0].bends_as', 'ark', 'one of arc, hinge'),
    ('sections[1].name', 'near', "sections: expected names that differ, got 'near'"),
    ('sections[0].stiff', 1.0, "sections[0].stiff: expected one of name, cells, cell_length, "
     "bending_stiffness, mass_profile, bends_as, mass_offset, got 'stiff'"),
    ('sections[0].mass_offset', [3.0, 0.0], 'an offset below 1 m (is it in mm?)'),
    ('sections[0].mass_offset', [[0.0, 0.0], [0.0, 0.001]], "sections[0].mass_offset: expected "
     "3 offsets [x, y] (one per cell), got '2 of them'"),
    ('sections[0].mass_offset', [[0, 0], [0, 0], 0.001], 'sections[0].mass_offset[2]: expected '
     'a list of 2 numbers, got 0.001'),
    ('sections', [], 'a list with at least one entry'),
    ('tendons[0].section', 'middle', 'one of near, far'),
    ('tendons[0].offset', [5.0, 0.0], 'an offset below 1 m (is it in mm?)'),
    ('tendons[0].offset', 0.005, 'a list of 2 numbers'),
    ('tendons[0].offset', {'base': [0.0, 0.1]}, 'tendons[0].offset.end: expected a list of 2 '
     'numbers, got None'),
    ('tendons[0].offset', {'base': [0.0, 0.1], 'helix': 400.0},
     'tendons[0].offset.helix: expected a finite number from -157.08 to 157.08 [rad/m], got '
     '400.0'),
    ('tendons[1].offset', {'cells': [[0.005, 0.0]] * 3},
     "tendons[1].offset.cells: expected 5 offsets [x, y] (one per cell), got '3 of them'"),
    ('tendons[0].offset', {'cells': [[0.005, 0.0]] * 3, 'end': [0.0, 0.005]},
     "tendons[0].offset.end: expected nothing beside cells, which say it all, got 'end'"),
    ('tendons[0].name', 'b2', "tendons: expected names that differ, got 'b2'"),
    ('tendons[0].name', 'b', "tendons: expected group names that are not tendon names, got 'b'"),
    ('tendons[0].name', True, 'a name (put it in quotes: YAML reads it otherwise)'),
    ('tendons[0].name', 'a,b', 'a name without comma, equals sign or line break'),
    ('tension_limits', [5.0, 0.1], '[lowest, highest] with 0 <= lowest < highest [N]'),
    ('tension_limits', [-1.0, 4.0], '[lowest, highest] with 0 <= lowest < highest [N]'),
    ('tension_limits', None, 'a list of 2 numbers'),
    ('gravity', [0.0, 9.81], 'a list of 3 numbers'),
    ('tolerances.stiffness', 0.1, "tolerances.stiffness: expected one of bending_stiffness, "
     "cell_stiffness, cell_kink, channel_gain, hole_radius, pull_zero, friction_coefficient, "
     "tension_gain, position, rotation, got 'stiffness'"),
    ('effects.tendon_friction', 0.3, 'keys with values'),
    ('effects.tendon_friction.friction_coefficient', '.3.', 'a number [SI]'),
    ('limits', [0, 1], "limits: expected one of name, sections, tendons, tension_limits, "
     "effects, gravity, tolerances, fitted, exact, model_error, got 'limits'"),
]  # fmt: skip


@pytest.mark.parametrize(('path', 'value', 'said'), BAD, ids=lambda part: str(part)[:40])
def test_a_bad_value_is_named_with_file_key_expectation_and_what_came(path, value, said):
    refused(str, path, value, said)


IN_THE_MODEL = [
    ('effects.tendon_friction.friction_coefficient', 1.2, 'a number from 0 to 1 [1]'),
    ('effects.tendon_friction.mu', 0.2, "effects.tendon_friction.mu: expected one of "
     "friction_coefficient, got 'mu'"),
    ('effects.section_stiffness.relative_change', [0.1, 0.2, 0.3], '2 numbers (one per section)'),
    ('effects.tendon_friction.friction_coefficient', [0.1, 0.2], 'one number'),
    ('effects.tendon_friction.friction_coefficient', [], 'one number'),
]  # fmt: skip


@pytest.mark.parametrize('read', [Model, make_plant])
@pytest.mark.parametrize(('path', 'value', 'said'), IN_THE_MODEL)
def test_a_bad_effect_parameter_is_named_by_the_model(path, value, said, read):
    parse_robot(change(path, value))
    refused(read, path, value, said)


def test_an_unknown_effect_is_answered_with_the_known_ones():
    robot = parse_robot(change('effects.humidity', {'share': 1.0}), 'arm.yaml')
    with pytest.raises(TendonRobotError) as caught:
        Model(robot)
    message = str(caught.value)
    assert message.startswith(
        "arm.yaml: effects: unknown effect 'humidity'; known: tendon_friction"
    )
    assert 'base_misalignment' in message and '(name the file of your own: ' in message


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('name: [', 'arm.yaml: file: expected valid YAML, got '),
        ('just text', "arm.yaml: file: expected keys with values, got 'just text'"),
        (
            '',
            'arm.yaml: file: expected a robot description (`robot new` writes one), got ',
        ),
        ('name: !!python/object/apply:os.system [ls]', 'arm.yaml: file: expected valid YAML, got'),
    ],
)
def test_a_file_that_is_no_description_is_refused(text, message):
    with pytest.raises(RobotDescriptionError) as caught:
        parse_robot(text, 'arm.yaml')
    assert str(caught.value).startswith(message) and '\n' not in str(caught.value)


def test_a_missing_or_binary_file_is_refused(tmp_path):
    with pytest.raises(RobotDescriptionError, match='file: expected a readable YAML file, got'):
        load_robot(tmp_path / 'none.yaml')
    (tmp_path / 'binary.yaml').write_bytes(b'\xff\xfe\x00\x80')
    with pytest.raises(RobotDescriptionError, match="got 'not a text file'"):
        load_robot(tmp_path / 'binary.yaml')


FILES = [
    *sorted((ROOT / 'config/robots').glob('*.yaml')),
    TENTACLE / 'robot.yaml',
    *(blind(letter) / 'fit' / 'robot.yaml' for letter in 'abcdefghijkl'),
]


@pytest.mark.parametrize('path', FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_every_description_of_the_package_comes_back_as_it_went(path):
    robot = load_robot(path)
    assert parse_robot(dump_robot(robot), robot.source) == robot


def test_effects_are_added_and_taken_away_with_where_they_come_from():
    robot = parse_robot(ARM)
    fitted = robot.with_effect('gravity', {'linear_density': 0.1}, fitted={'data': 'set'})
    assert parse_robot(dump_robot(fitted)) == fitted
    assert fitted.fitted == {'gravity': {'data': 'set'}}
    assert fitted.without_effect('gravity') == robot
    with pytest.raises(InputError, match="effects: no 'gravity' to remove; listed: tendon_f"):
        robot.without_effect('gravity')


numbers = st.floats() | st.integers() | st.text(max_size=5) | st.none() | st.booleans()
anything = st.recursive(
    numbers,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner),
    max_leaves=6,
)
PATHS = [bad[0] for bad in BAD]


@settings(max_examples=100)
@given(path=st.sampled_from(PATHS), value=anything)
def test_whatever_stands_in_a_file_there_is_a_robot_or_one_clear_line(path, value):
    said = ''
    try:
        assert parse_robot(change(path, value), 'arm.yaml').cells > 0
    except RobotDescriptionError as error:
        said = str(error)
    assert not said or said.startswith('arm.yaml: ')
    assert len(said) < 500
