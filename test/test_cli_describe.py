"""The commands describe and robot new, as a user types them."""

import io
import itertools
import json
import sys
import xml.etree.ElementTree as ElementTree
from dataclasses import replace

import numpy as np
import pytest
import yaml
from arms import planar
from source_tree import ROOT

from tendon_robot_ros.cli.main import main
from tendon_robot_ros.cli.robot import description
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.report import pictures
from tendon_robot_ros.robot import load_robot, parse_robot
from tendon_robot_ros.robot.estimates import handling, sag
from tendon_robot_ros.robot.urdf import joint_angles, joint_names, transforms, urdf
from tendon_robot_ros.tables.markers import order_markers

SHIPPED = ('kato_10_1', 'spatial_3', 'spatial_6')
ROBOTS = ROOT / 'config' / 'robots'
KATO = str(ROBOTS / 'kato_10_1.yaml')
GROUPS = str(ROBOTS / 'kato_1_1.yaml')
SPATIAL = str(ROBOTS / 'spatial_6.yaml')


def test_describe_names_the_model_and_every_part(capsys):
    assert main(['robot', 'describe', KATO]) == 0
    out = capsys.readouterr().out
    assert out.startswith('robot kato_10_1: 2 sections, 30 cells, 4 tendons, 208 mm\n')
    assert 'model: FKM (tendon_friction, friction coefficient 0.33)\n' in out
    for name in ('proximal', 'distal', 'prox_left', 'dist_right', '0.1 to 5 N each'):
        assert name in out


def bent(tree, angles):
    """Return the frames (n, 4, 4) of the cells' hinges: what RViz makes of a URDF."""
    angles = dict(zip([j.get('name') for j in tree.iter('joint')], angles, strict=True))
    frame, frames = np.eye(4), []
    for joint in tree.iter('joint'):
        axis = np.array([float(v) for v in joint.find('axis').get('xyz').split()])
        up = np.eye(4)
        up[:3, 3] = [float(v) for v in joint.find('origin').get('xyz').split()]
        cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
        angle = angles[joint.get('name')]
        turn = np.eye(4)
        turn[:3, :3] += np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross
        frame = frame @ up @ turn
        frames.append(frame)
    return np.array(frames[1::2])


def test_the_urdf_is_a_chain_of_two_joints_per_cell(capsys):
    assert main(['robot', 'describe', SPATIAL, '--urdf']) == 0
    text = capsys.readouterr().out
    assert main(['robot', 'describe', SPATIAL, '--urdf', '--json']) == 0
    assert json.loads(capsys.readouterr().out)['urdf'].strip() == text.strip()
    tree = ElementTree.fromstring(text)
    joints = list(tree.iter('joint'))
    assert [j.get('name') for j in joints] == list(joint_names(load_robot(SPATIAL)))
    assert len(joints) == 2 * 30
    links = [link.get('name') for link in tree.iter('link')]
    assert len(set(links)) == len(links)
    assert {j.find('child').get('link') for j in joints} == set(links) - {'base'}
    for before, joint in itertools.pairwise(joints):
        assert joint.find('parent').get('link') == before.find('child').get('link')


def test_the_urdf_takes_the_shape_of_the_model():
    robot = load_robot(SPATIAL)
    shape = Model(robot).shape([0.1, 1.5, 0.1, 0.1, 0.1, 1.2])
    frames = bent(ElementTree.fromstring(urdf(robot)), joint_angles(robot, shape.frames))
    tips = frames[:, :3, 3] + 0.003 * frames[:, :3, 2]  # from the hinge to the end of the cell
    assert np.allclose(tips, shape.positions, rtol=0, atol=1e-9)
    assert np.allclose(frames[:, :3, 2], shape.frames[:, :, 2], rtol=0, atol=1e-12)


def test_where_cells_twist_a_third_joint_gives_them_their_frames():
    robot = load_robot(SPATIAL)
    load = {'force_x': 0.1, 'force_y': 0.2, 'force_z': 0.0}
    robot = robot.with_effect('torsion', {'compliance': 1.3}).with_effect('tip_load', load)
    shape, tree = Model(robot).shape([0.1, 1.5, 0.1, 0.1, 0.1, 1.2]), urdf(robot)
    angles = joint_angles(robot, shape.frames)
    joints = list(ElementTree.fromstring(tree).iter('joint'))
    assert [j.get('name') for j in joints] == list(joint_names(robot))
    assert len(joints) == len(angles) == 3 * 30 and np.abs(shape.twist).max() > 1e-3
    place, turned, ends = np.zeros(3), np.eye(3), []
    for _, child, rotation, up in transforms(robot, angles, ''):
        place, turned = place + turned @ [0.0, 0.0, up], turned @ rotation
        if child.startswith('cell') and '_' not in child[5:]:
            ends.append((place + 0.003 * turned[:, 2], turned))
    assert np.allclose([at for at, _ in ends], shape.positions, rtol=0, atol=1e-9)
    assert np.allclose([turn for _, turn in ends], shape.frames, rtol=0, atol=1e-9)


def test_describe_shows_tendons_that_wind_and_weight_beside_the_axis(capsys, tmp_path):
    content = yaml.safe_load((ROBOTS / 'kato_10_1_single.yaml').read_text())
    content['sections'][0]['mass_offset'] = [0.001, -0.002]
    content['tendons'][0]['offset'] = {'base': [0.0055, 0.0], 'helix': 8.726646}
    content['tendons'][1]['offset'] = {'base': [-0.0055, 0.0], 'end': [-0.004, 0.0]}
    (tmp_path / 'wound.yaml').write_text(yaml.safe_dump(content))
    assert main(['robot', 'describe', str(tmp_path / 'wound.yaml')]) == 0
    printed = capsys.readouterr().out
    assert '5.5, 0, winds 0.5°/mm' in printed and '-5.5, 0 to -4, 0' in printed
    assert 'weight at x, y [mm]' in printed and '1, -2' in printed


def new_robot(monkeypatch, tmp_path, answers, *arguments, drawn=False):
    monkeypatch.chdir(tmp_path)
    if not drawn:  # which takes most of its time
        monkeypatch.setattr(pictures, 'draw_robot', lambda model, path: path.touch())
    monkeypatch.setattr(sys, 'stdin', io.StringIO(answers))
    return main(['robot', 'new', *arguments])


def test_new_robot_takes_answers_from_a_pipe_and_draws(monkeypatch, tmp_path, capsys):
    answers = 'my arm\n3\n4\n6\n\n\nhinge\n3\n5\n\n8\n0.2\nhorizontal\n1\n10\n0\n'
    assert new_robot(monkeypatch, tmp_path, answers, drawn=True) == 0
    robot = load_robot(tmp_path / 'my_arm.yaml')
    assert (robot.name, robot.cells, len(robot.tendons)) == ('my arm', 12, 9)
    assert robot.tension_limits == (0.1, 8.0) and robot.gravity == (9.81, 0.0, 0.0)
    assert {np.hypot(*t.base).round(6) for t in robot.tendons} == {0.005}
    assert robot.effects == {
        'tendon_friction': {'friction_coefficient': 0.2},
        'gravity': {'linear_density': 0.01389},
        'straight_tendon': {'fraction': 1.0},
        'eyelet_wrap': {'fraction': 1.0},
        'tendon_travel': {'fraction': 1.0},
    }
    assert robot.tolerances == {'bending_stiffness': 0.1}
    assert (tmp_path / 'my_arm.png').read_bytes().startswith(b'\x89PNG')
    printed = capsys.readouterr().out
    assert 'written: my_arm.yaml' in printed
    assert 'bends section_1 by 42.4° (without friction)' in printed  # 4 · 0.005 / 0.027 rad
    assert 'weighs 1 g; level, it sags by 2.8 mm at the tip' in printed
    assert 'model: FKM + eyelet_wrap, gravity, straight_tendon, tendon_travel\n' in printed
    assert main(['robot', 'describe', 'my_arm.yaml']) == 0
    assert capsys.readouterr().out.strip() in printed
    assert new_robot(monkeypatch, tmp_path, f'{answers}\n\nyes\n', '--output', 'plate.yaml') == 0
    plate = load_robot(tmp_path / 'plate.yaml')
    assert [s.name for s in plate.sections] == ['plate', *(s.name for s in robot.sections)]
    assert plate.length == pytest.approx(robot.length, abs=2e-5)
    size = description(robot).splitlines()[0]  # a plate is no section and no cell
    assert description(plate).splitlines()[0] == f'{size}, on a base plate with holes'
    postures = [Model(plate).shape([x] + 8 * [0.1]).positions for x in (0.1, 1.0, 2.0)]
    order = order_markers(np.array(postures)[:, 2::2], plate)
    assert order.reason.endswith('all at the ends of cells 2, 4, 6, 8, 10 and 12')
    tips = [Model(one).shape([3.0] + 8 * [0.1]).tip_position for one in (robot, plate)]
    assert np.hypot(*tips[1][:2]) != pytest.approx(np.hypot(*tips[0][:2]), rel=1e-3)


@pytest.mark.parametrize(
    ('answer', 'gravity'),
    [('', (9.81, 0.0, 0.0)), ('right', (0.0, -9.81, 0.0)), ('left', (0.0, 9.81, 0.0)),
     ('180', (-9.81, 0.0, 0.0)), ('up', (-9.81, 0.0, 0.0))],
)  # fmt: skip
def test_where_the_first_tendon_lies_is_asked_with_a_picture(
    answer, gravity, monkeypatch, tmp_path, capsys
):
    """The first tendon lies on x of the base frame, whatever hangs down."""
    answers = f'arm\n1\n4\n6\n\n\n\n3\n5\n\n8\n0\nhorizontal\n0\n\nchannel\n{answer}\n'
    assert new_robot(monkeypatch, tmp_path, answers) == 0
    robot = load_robot(tmp_path / 'arm.yaml')
    assert robot.gravity == pytest.approx(gravity)
    assert robot.tendons[0].base == (0.005, 0.0)
    asked = capsys.readouterr().err
    assert '     270 left --o-- 90 right     tendon_1 is the first tendon.\n' in asked
    assert 'tendon_2 and so on follow counter-clockwise, 120° apart.\n' in asked
    assert 'In your base frame' not in asked, 'gravity has told that frame'


@pytest.mark.parametrize(
    ('known', 'stiffness', 'sure'),
    [
        ('number\n0.02\n', 0.02, 0.05),
        ('rod\n1\n200\n', 200e9 * np.pi * 1e-12 / 64.0 / 0.007, 0.1),
        ('tube\n2\n0.1\n60\n', 60e9 * np.pi * (16e-12 - 1.8e-3**4) / 64.0 / 0.007, 0.1),
        ('bend\n2\n90\n', 2.0 * 0.0055 * 15 / (np.pi / 2.0), 0.2),
        ('unknown\n', 5.0 * 0.0055 * 15 / np.pi, 0.5),
    ],
)
def test_the_stiffness_follows_from_what_is_known(known, stiffness, sure, monkeypatch, tmp_path):
    assert new_robot(monkeypatch, tmp_path, f'arm\n1\n\n\n{known}') == 0
    robot = load_robot(tmp_path / 'arm.yaml')
    assert robot.sections[0].bending_stiffness[0] == pytest.approx(stiffness, rel=1e-3)
    assert robot.tolerances['bending_stiffness'] == sure


def test_an_arm_whose_sag_was_measured_sags_so_in_the_model(monkeypatch, tmp_path, capsys):
    answers = 'arm\n2\n10\n6\nsag\n2\n8\nhinge\n2\n\n0\n5\n0\n'
    assert new_robot(monkeypatch, tmp_path, answers) == 0
    robot = load_robot(tmp_path / 'arm.yaml').with_effect('tip_load', {'force_x': 2e-3 * 9.81})
    assert Model(robot).shape([0.0] * 4).tip_position[0] == pytest.approx(8e-3, rel=0.01)
    assert new_robot(monkeypatch, tmp_path, 'b\n2\n10\n6\nsag\n2\n80\n') == 1
    error = capsys.readouterr().err.splitlines()[-1]
    assert 'to 36 (30 % of the arm; if it sags more, take a lighter weight), got' in error


@pytest.mark.parametrize(
    ('stiffness', 'doubt'),
    [
        (27.0, 'left at its limit of 5 N bends by 0.875° only; is bending_stiffness too high'),
        (2.7e-4, 'left bends by 90° at 0.0051 N, with tensions from 0 to 5 N; is bending_st'),
        (0.027, None),
        (0.27, None),
    ],
)
def test_what_no_arm_is_like_is_doubted(stiffness, doubt):
    robot = load_robot(ROBOTS / 'kato_10_1_single.yaml')
    section = robot.sections[0]
    section = replace(section, bending_stiffness=(stiffness,) * section.cells)
    lines = '\n'.join(handling(replace(robot, sections=(section,))))
    says = (
        '90° take'
        if stiffness < 0.1
        else '5 N, the most that may pull, bend by 87.5° (90° take 5.1'
    )
    assert (f'NOT PLAUSIBLE: {doubt}' in lines) if doubt else (f'\nplausible: {says}' in lines)


@pytest.mark.parametrize('name', SHIPPED)
@pytest.mark.parametrize(
    ('old', 'times', 'wrong'),
    [  # an offset above 1 m is refused
        ('cell_length', 1000.0, 'is cell_length in mm'), ('offset', 100.0, 'is the offset in mm'),
        ('', 1.0, ''),
    ],
)  # fmt: skip
def test_a_length_in_millimetres_is_told(name, old, times, wrong):
    content = yaml.safe_load((ROBOTS / f'{name}.yaml').read_text())
    for part in (*content['sections'], *content['tendons']):
        for key in {old} & set(part):
            value = part[key]
            part[key] = [times * v for v in value] if isinstance(value, list) else times * value
    told = [line for line in handling(load_robot(content)) if ' in mm' in line]
    assert all(line.startswith('NOT PLAUSIBLE: a cell of ') and wrong in line for line in told)
    assert len(told) == bool(old)


def test_kilograms_and_decimetres_are_told_without_an_exponent():
    effects = {'gravity': {'linear_density': 2.5}}
    robot = planar(cells=10, stiffness=200.0, length=0.1, arm=0.02, effects=effects)
    assert 'weighs 2500 g; level, it sags by 150 mm at the tip' in handling(robot)


@pytest.mark.parametrize(('share', 'stands'), [(0.8, True), (1.2, False)])
def test_an_upright_arm_bends_over_above_the_load_that_buckles_a_column(share, stands):
    """The critical weight per length is 7.837 EI / L³, EI of a cell its stiffness by length."""
    robot = planar(cells=20, stiffness=0.2, length=0.005)
    density = share * 7.837 * 0.2 * 0.005 / robot.length**3 / 9.81
    effects = {'gravity': {'linear_density': density}, 'tip_load': {'force_x': 1e-5}}
    robot = replace(robot, effects=effects, gravity=(0.0, 0.0, -9.81))
    assert any(line.endswith('; upright, it bends over') for line in handling(robot)) != stands
    sideways = Model(robot).shape([0.0, 0.0]).tip_position[0]
    assert (abs(sideways) < 0.05 * robot.length) == stands


def test_the_sag_of_a_beam_of_many_cells_is_that_of_the_textbook():
    robot = load_robot(ROBOTS / 'kato_10_1_single.yaml')
    cells = 400
    section = replace(
        robot.sections[0],
        cells=cells,
        cell_length=0.1 / cells,
        bending_stiffness=(2e-3 * cells / 0.1,) * cells,
        mass_profile=(1.0,) * cells,
    )
    beam = replace(robot, sections=(section,))  # 0.1 m, EI = 2e-3 N·m²
    assert sag(beam, force=0.1) == pytest.approx(0.1 * 0.1**3 / 3.0 / 2e-3, rel=1e-4)
    assert sag(beam, weight=0.1) == pytest.approx(0.1 * 0.1**3 / 8.0 / 2e-3, rel=1e-4)


@pytest.mark.parametrize('name', ['kato_10_1', 'spatial_6', 'kato_1_1'])
def test_legends_of_the_picture_hide_nothing_and_every_line_and_tendon_is_named(name, tmp_path):
    robot = load_robot(ROBOTS / f'{name}.yaml')
    figure = pictures.draw_robot(Model(robot), tmp_path / 'arm.png')
    side, section = figure.axes
    for axes in (side, section):
        legend = axes.get_legend().get_window_extent()
        assert not legend.overlaps(axes.get_position().transformed(figure.transFigure))
    named = [text.get_text() for text in side.get_legend().get_texts()]
    assert [line.get_label() for line in side.lines] == named and len(named) > 1
    words = '\n'.join(text.get_text() for text in section.texts)
    assert all(tendon.name in words for tendon in robot.tendons)
    assert min(text.get_fontsize() for text in section.texts) * 400 / 8.0 / 72.0 > 9.0  # [px]


@pytest.mark.parametrize('back', ['<', 'back'])
def test_a_wrong_answer_is_taken_back_and_the_others_stay(back, monkeypatch, tmp_path, capsys):
    """Radius 55 instead of 5.5: back over the two questions after it, and once too often."""
    answers = f'{back}\narm\n1\n11\n7\nrod\n1\n200\n\n3\n55\n0.2\n{back}\n{back}\n5.5\n\n9\n0\n'
    assert new_robot(monkeypatch, tmp_path, answers) == 0
    robot = load_robot(tmp_path / 'arm.yaml')
    assert (robot.cells, len(robot.tendons), robot.tension_limits) == (11, 3, (0.2, 9.0))
    assert np.hypot(*robot.tendons[0].base) == pytest.approx(5.5e-3)
    asked = capsys.readouterr().err
    assert asked.count('Modulus E') == 1, 'what stays is not asked again'
    assert 'off the centre by [mm] [55]: 5.5' in asked, 'the answer of before is the default'
    assert 'Lowest tension [N] [0.2]: \n' in asked
    assert '< goes back to the question before' in asked


def test_going_back_over_a_choice_asks_what_follows_from_the_new_one(monkeypatch, tmp_path):
    answers = 'arm\n2\n10\n6\nsag\n<\ntube\n2\n0.1\n60\n'
    assert new_robot(monkeypatch, tmp_path, answers) == 0
    stiffness = load_robot(tmp_path / 'arm.yaml').sections[0].bending_stiffness[0]
    assert stiffness == pytest.approx(60e9 * np.pi * (16e-12 - 1.8e-3**4) / 64.0 / 0.006, rel=1e-3)


def test_new_robot_needs_no_answer_at_all(monkeypatch, tmp_path):
    assert new_robot(monkeypatch, tmp_path, '', '--output', 'arm.yaml') == 0
    robot = load_robot(tmp_path / 'arm.yaml')
    assert robot.inputs == ('proximal_right', 'proximal_left', 'distal_right', 'distal_left')


@pytest.mark.parametrize(
    ('answers', 'message'),
    [
        ('\n0\n', "How many sections: expected a whole number from 1 to 20, got '0'"),
        ('\n\n\n-3\n', "Length of a cell [mm]: expected a number from 0.001 to 10000, got '-3'"),
        ('\n\n\n\nbeam\n', 'known as: number, rod, tube, sag, bend, unknown: expected number or'),
        ('\n\n\n\n\n\nbar\n', "Cells bend as: arc, hinge: expected arc or hinge, got 'bar'"),
        (
            '\n' * 12 + 'horizontal' + '\n' * 5 + 'below\n',
            "or down or right or up or left, got 'below'",
        ),
        ('\n' * 9 + '5\n2\n', "Highest tension [N]: expected a number above 5 to 100000, got '2'"),
    ],
)
def test_a_wrong_answer_from_a_pipe_is_one_line(answers, message, monkeypatch, tmp_path, capsys):
    assert new_robot(monkeypatch, tmp_path, answers) == 1
    last = capsys.readouterr().err.splitlines()[-1]
    assert 'error: ' in last and message in last
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize('points', ['down', 'unknown'])
def test_a_hanging_arm_in_space_has_its_first_tendon_where_it_lies(points, monkeypatch, tmp_path):
    weight = {'down': '0\n', 'unknown': ''}[points]
    answers = f'arm\n1\n4\n6\n\n\n\n3\n5\n\n8\n0\n{points}\n{weight}\nchannel\n'
    assert new_robot(monkeypatch, tmp_path, f'{answers}30\nred, green,blue\n') == 0
    robot = load_robot(tmp_path / 'arm.yaml')
    assert robot.inputs == ('red', 'green', 'blue')
    angles = [np.degrees(np.arctan2(*t.base[::-1])) % 360.0 for t in robot.tendons]
    assert angles == pytest.approx([30.0, 150.0, 270.0], abs=1e-4)
    assert new_robot(monkeypatch, tmp_path, answers, '--output', 'as_ever.yaml') == 0
    robot = load_robot(tmp_path / 'as_ever.yaml')
    assert robot.inputs == ('tendon_1', 'tendon_2', 'tendon_3')
    assert robot.tendons[0].base == (0.005, 0.0)


def test_names_of_tendons_are_as_many_as_there_are_tendons(monkeypatch, tmp_path, capsys):
    answers = 'arm\n1\n4\n6\n\n\n\n2\n5\n\n8\n0\n\n\nchannel\n'
    for names in ('left', 'a,a', 'a,b=c', 'a,b,c'):
        assert new_robot(monkeypatch, tmp_path, f'{answers}{names}\n') == 1
        last = capsys.readouterr().err.splitlines()[-1]
        assert (
            f'expected 2 different names with commas between them, none with =, got {names!r}'
            in last
        )
    assert new_robot(monkeypatch, tmp_path, f'{answers}left,right\n') == 0
    assert load_robot(tmp_path / 'arm.yaml').inputs == ('left', 'right')


def test_new_robot_replaces_no_file(monkeypatch, tmp_path, capsys):
    (tmp_path / 'arm.yaml').write_text('mine')
    assert new_robot(monkeypatch, tmp_path, '', '--output', 'arm.yaml') == 1
    assert 'arm.yaml: is there already; use --overwrite or another --output' in (
        capsys.readouterr().err
    )
    assert (tmp_path / 'arm.yaml').read_text() == 'mine'


@pytest.mark.parametrize('path', sorted(ROBOTS.glob('*.yaml')), ids=lambda path: path.stem)
def test_every_robot_in_config_loads_bends_and_is_described(path, capsys):
    robot = load_robot(path)
    assert parse_robot(yaml.safe_dump(yaml.safe_load(path.read_text()))).inputs == robot.inputs
    shape = Model(robot).shape(np.full(len(robot.inputs), robot.tension_limits[0]))
    assert np.isfinite(shape.positions).all()
    assert main(['robot', 'describe', str(path)]) == 0
