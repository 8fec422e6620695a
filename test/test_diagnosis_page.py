"""The page of a diagnosis: every verdict, its pictures, and the moment that a model lacks."""

import html
import re
from dataclasses import replace

import numpy as np
import pytest
import simulated
from browser import assert_fine, open_page
from measurements import blind
from source_tree import ROOT

from tendon_robot_ros.cli.main import main
from tendon_robot_ros.comparison.compare import compare
from tendon_robot_ros.data import load_dataset, save_dataset
from tendon_robot_ros.diagnosis.add import Addition
from tendon_robot_ros.diagnosis.missing_moment import blocks_of, missing_moment
from tendon_robot_ros.diagnosis.result import (
    NOT_NEEDED,
    CandidateRow,
    Diagnosis,
    EffectFinding,
    NextMeasurement,
    Value,
)
from tendon_robot_ros.diagnosis.verdict import Verdict
from tendon_robot_ros.effects import load_catalogue
from tendon_robot_ros.inference.crossval import Errors
from tendon_robot_ros.inference.description import with_values
from tendon_robot_ros.inference.predict import free_parameters
from tendon_robot_ros.report.diagnosis_page import (
    candidate_row,
    diagnosis_page,
    pictures_of,
    with_effects,
)
from tendon_robot_ros.report.error_plots import heat_maps, moments
from tendon_robot_ros.robot import load_robot
from tendon_robot_ros.robot.description import Section
from tendon_robot_ros.ros.viewer import page_parts
from tendon_robot_ros.simulation.measurements import SimulatedNoise, simulate
from tendon_robot_ros.simulation.plant import make_plant
from tendon_robot_ros.workspace.postures import default_postures

LEVER = Value(1.58e-4, 1.52e-4, 1.65e-4, 'm')
HINGE = EffectFinding('hinge_friction', {'lever': LEVER}, 0.99)
STIFF = EffectFinding('section_stiffness', {
    'relative_change[proximal]': Value(0.1, 0.08, 0.12, '1'),
    'relative_change[distal]': Value(-0.05, -0.06, -0.04, '1')}, 0.9)  # fmt: skip
DETAILS = {
    'robot': 'planar1', 'data': 'data/x', 'postures': 6, 'trials': 30, 'markers': 15,
    'noise': {'position': 2e-4, 'trial': 0.004, 'setting': 0.002, 'source': 'trials'},
    'tolerances': {'bending_stiffness': 0.02},
}  # fmt: skip


def diagnosis(verdict, effects=(HINGE,), **changed):
    row = CandidateRow('hinge_friction', {'lever': LEVER}, 500.0, 539, 0.7, 0.99, 2.4e-4, 2.5e-4,
                       'best', False)  # fmt: skip
    usual = {
        'cannot_tell_apart': (), 'not_tested': ('gravity',), 'out_of_tolerance': (),
        'error_before': 2.66e-3, 'error_after': 2.4e-4, 'noise_floor': 2.45e-4,
        'next_measurement': None, 'remainder': 'What is left (0.24 mm) equals your repeatability.',
        'candidates': (row, replace(row, name='tip_load', status='rejected', probability=1e-9)),
        'details': DETAILS,
    }  # fmt: skip
    return Diagnosis(verdict=verdict, effects=effects, **{**usual, **changed})


def text(page):
    return html.unescape(re.sub('<[^>]*>', ' ', '\n'.join(page.parts)))


@pytest.fixture(scope='module')
def hinges():
    return load_dataset(blind('b') / 'fit')


@pytest.mark.parametrize('verdict', Verdict)
def test_every_verdict_has_its_page(verdict):
    effects = () if verdict in ('adequate', 'cannot_judge') else (HINGE,)
    page = diagnosis_page(diagnosis(verdict, effects))
    said = text(page)
    assert page.parts[0].startswith(f'<div class="box verdict {verdict.colour}">')
    head = {'adequate': 'Nothing is missing', 'wrong_parameter': 'A value is off: ',
            'cannot_judge': 'Cannot be judged: '}  # fmt: skip
    assert head.get(verdict, 'Missing: ') in said
    assert ('The error falls' in said) == bool(effects and verdict != 'outside_catalogue')
    assert ('What else it could be' in said) == (verdict != 'cannot_judge')
    assert ('--add better.yaml' in said) == bool(effects)
    assert ('--partial' in said) == (verdict == 'outside_catalogue')


def test_where_nothing_is_missing_no_effect_explains_anything():
    found = diagnosis('adequate', ())
    rows = tuple(replace(row, status=NOT_NEEDED, explained=0.0) for row in found.candidates)
    said = text(diagnosis_page(replace(found, candidates=rows)))
    assert NOT_NEEDED in said and not re.search(r'(?<![\d.])0 %', said)
    said = {'sentence': 'Missing: a load (`tip_load`).\nIt explains 98 %.'}
    shown = page_parts.verdict(said | {'rows': [*map(candidate_row, rows)]})
    assert '>Missing: a load (<code>tip_load</code>).</p><p style=' in shown
    assert NOT_NEEDED in shown and '0 %' not in shown and 'lever = 0.158 ± 0.006 mm' in shown


def test_a_diagnosis_that_judged_nothing_draws_why():
    axes = diagnosis('cannot_judge', (), candidates=(), remainder='two trials').plot()
    assert 'two trials' in axes.texts[0].get_text() and not axes.axison


def test_the_page_says_what_it_rests_on_and_what_it_did_not_test():
    said = text(diagnosis_page(diagnosis('missing_effect')))
    assert (
        'Declared tolerances (1 sd): bending_stiffness 2.0 %; everything else is taken as' in said
    )
    assert 'Not tested by these postures: gravity' in said
    assert 'lever 0.158 ± 0.006 mm' in said


def test_a_class_has_its_box_and_the_next_measurement():
    step = NextMeasurement({'left': 1.1, 'right': 0.8}, None, None, 6.3e-3, 3e-4, {
        'hinge_friction': [0.0, 0.0, 0.1], 'transmission_loss': [0.0063, 0.0, 0.1]})  # fmt: skip
    names = ('hinge_friction', 'transmission_loss')
    found = diagnosis('ambiguous', cannot_tell_apart=names, next_measurement=step)
    said = text(diagnosis_page(found))
    assert 'These postures cannot tell hinge_friction or transmission_loss apart.' in said
    assert 'Measure this next: left 1.10 N, right 0.800 N, 5 trials.' in said


def test_an_addition_shows_both_kinds_of_postures(hinges):
    fitted = Errors('fitted', 'x', 12, 2.66e-3, 2.4e-4, 2.45e-4)
    check = Errors('check', 'y', 6, 2.5e-3, 2.7e-4, 2.2e-4)
    made = Addition(hinges.robot, {'hinge_friction': {'lever': LEVER}}, fitted, check, 0.5)
    said = text(diagnosis_page(diagnosis('missing_effect'), addition=made))
    assert 'Error on postures never used: 2.50 mm → 0.270 mm (floor 0.220 mm).' in said
    for label in ('postures that were fitted', 'postures never used', '2.66', '0.270'):
        assert label in said
    in_turn = replace(made, check=replace(check, kind='left out'))
    said = text(diagnosis_page(diagnosis('missing_effect'), addition=in_turn))
    assert 'postures left out in turn' in said and 'postures never used' not in said


@pytest.fixture(scope='module')
def commanded(tmp_path_factory):
    """Give a folder with the page of a diagnosis with --check and --add, and what was measured."""
    folder = tmp_path_factory.mktemp('commanded')
    robot = simulated.robot(cells=8, exact=True)  # diagnosed at once
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for which, name in enumerate(('fit', 'check')):
            made = simulated.measured(robot, {'hinge_friction': {'lever': 3e-4}}, which=which)
            save_dataset(made, name)
        asked = ['diagnose', 'fit', '--check', 'check', '--add', 'new.yaml']
        assert main([*asked, '--report', 'page.html']) == 0
    return folder


@pytest.mark.long
def test_what_became_of_the_file_stands_where_it_was_asked_for(commanded, monkeypatch, capsys):
    monkeypatch.chdir(commanded)
    assert main(['diagnose', 'fit', '--report', 'other.html']) == 0
    assert 'report: other.html' in capsys.readouterr().out
    for page, told in (('other.html', '--add better.yaml'), ('page.html', 'written: new.yaml')):
        body = (commanded / page).read_text(encoding='utf-8').partition('<body>')[2]
        assert told in body
        assert ('Add it to the robot description' in body) == (page == 'other.html')
    lacking = diagnosis_page(diagnosis('outside_catalogue'), outcome='Nothing was added.')
    assert 'Nothing was added.' in text(lacking) and '--add better.yaml' not in text(lacking)


def test_the_page_says_what_the_chance_beside_the_best_means():
    said = text(diagnosis_page(diagnosis('missing_effect')))
    assert 'above 0.001 it may be; “best” is the likeliest of those' in said


def test_found_values_go_into_the_description():
    robot = load_robot(ROOT / 'config' / 'robots' / 'kato_10_1.yaml')
    changed = with_effects(diagnosis('several', (HINGE, STIFF)), robot, load_catalogue())
    assert changed.effects['hinge_friction'] == {'lever': 1.58e-4}
    assert changed.effects['section_stiffness'] == {'relative_change': (0.1, -0.05)}
    assert changed.effects['tendon_friction'] == robot.effects['tendon_friction']


def test_hinge_friction_is_a_straight_line_in_the_total_tension(hinges):
    _, (lacks, _) = pictures_of(diagnosis('missing_effect'), hinges)
    total, moment = lacks.total_tension[:, 0], lacks.moment[:, 0]
    slope = float(total @ moment / (total @ total))
    assert slope == pytest.approx(-1.58e-4, rel=0.15)
    assert np.corrcoef(total, moment)[0, 1] < -0.97
    assert abs(np.corrcoef(lacks.model_bend[:, 0], moment)[0, 1]) < 0.5


def test_the_missing_bend_of_a_softer_block_is_found():
    robot = replace(load_robot(ROOT / 'config' / 'robots' / 'kato_10_1.yaml'), effects={})
    first, second = robot.sections
    softer = tuple(k / 1.05 for k in second.bending_stiffness)
    really = replace(robot, sections=(first, replace(second, bending_stiffness=softer)))
    quiet = SimulatedNoise(1e-5, 0.0, 0.0)
    data = simulate(make_plant(really, scatter=0.0), default_postures(robot, 6), noise=quiet)
    data = replace(data, robot=robot)
    lacks = missing_moment(data, robot, compare(data).measured, load_catalogue())
    assert lacks.blocks == ('cells 1 to 5', 'cells 6 to 10', 'cells 11 to 15', 'cells 16 to 20',
                            'cells 21 to 25', 'cells 26 to 30')  # fmt: skip
    expected = 0.05 * lacks.model_bend[:, 3:]
    np.testing.assert_allclose(lacks.bend[:, 3:], expected, atol=3e-4, rtol=0.1)
    np.testing.assert_allclose(lacks.bend[:, :3], 0.0, atol=2e-4)


def test_a_missing_bend_is_the_same_in_whatever_frame_the_tracker_sees_it():
    robot, lacks = simulated.robot(), []
    quiet = replace(simulated.NOISE, position=1e-6, trial=0.0, setting=0.0)
    for frame in ({}, {'rotation_x': 0.3, 'rotation_y': 0.9, 'rotation_z': -0.5, 'shift_x': 0.01}):
        seen = replace(robot, effects={**robot.effects, 'base_misalignment': frame})
        hidden = {'backbone_stiffness': {'relative_change': 0.3}}
        data = simulated.measured(seen, hidden, count=4, noise=quiet)
        lacks.append(missing_moment(data, seen, compare(data).measured, load_catalogue()))
    for key in ('bend', 'deviation'):
        plain, turned = (getattr(one, key) for one in lacks)
        np.testing.assert_allclose(turned, plain, atol=0.01 * np.abs(plain).max())


def test_a_base_plate_lacks_no_moment_and_has_no_stiffness_of_its_own():
    """It does not bend: its 1000 N·m/rad would make a million of every small deviation."""
    robot = load_robot(ROOT / 'config' / 'robots' / 'kato_10_1.yaml')
    plate = Section('plate', 1, 1e-5, (1e3,), (1.0,), 'arc')
    robot = replace(robot, sections=(plate, *robot.sections), effects={})
    data = simulate(make_plant(robot, {'gravity': {}}, scatter=0.0), default_postures(robot, 6))
    data = replace(data, gravity=(9.81, 0.0, 0.0))
    lacks = missing_moment(data, robot, compare(data).measured, load_catalogue())
    assert lacks.blocks[0] == 'cells 1 to 5' and lacks.blocks[-1] == 'cells 26 to 30'
    assert np.nanmax(np.abs(lacks.moment)) < 1.0  # [N·m]
    own = free_parameters(load_catalogue()['section_stiffness'], robot)
    assert [free.label for free in own] == ['proximal', 'distal']
    written = with_values(robot, load_catalogue(), zip(own, (0.1, -0.2), strict=True))
    assert written.effects['section_stiffness'] == {'relative_change': (0.0, 0.1, -0.2)}
    assert robot.cell_names[:3] == ('cell 0', 'cell 1', 'cell 2')


def test_deviations_of_a_perfect_model_are_standard_normal():
    robot = load_robot(ROOT / 'config' / 'robots' / 'spatial_3.yaml')
    data = simulate(make_plant(robot, scatter=0.0), default_postures(robot, 40), trials=4,
                    noise=SimulatedNoise(2e-4, 0.0, 0.0))  # fmt: skip
    lacks = missing_moment(data, robot, compare(data).measured, load_catalogue())
    assert lacks.deviation.std() == pytest.approx(1.0, abs=0.08)
    z = (lacks.moment / lacks.moment_sd)[np.isfinite(lacks.moment_sd)]
    assert z.std() == pytest.approx(1.0, abs=0.2)


def test_blocks_do_not_outnumber_the_markers():
    tentacle = load_dataset(ROOT / 'data' / 'tentacle')
    assert len(blocks_of(tentacle.robot, len(tentacle.markers))) <= 4


def test_heat_maps_share_their_colours_and_units(hinges):
    comparison, lacks = pictures_of(diagnosis('missing_effect'), hinges)
    before, after = heat_maps(comparison, lacks)
    assert before.data[0]['zmax'] == after.data[0]['zmax'] == -before.data[0]['zmin']
    assert (before.title, after.title) == ('Deviation, as described',
                                           'Deviation, with hinge_friction')  # fmt: skip
    now, then = (np.abs(one.deviation).mean() for one in lacks[::-1])
    assert now < 0.2 * then
    for figure in moments(lacks[0]):
        for axis in ('xaxis', 'yaxis'):
            assert re.search(r'\[(N|mN·m|°|mm)\]$', figure.layout[axis]['title']['text'])


def test_no_noise_no_heat_map():
    data = load_dataset(blind('b') / 'fit')
    alone = replace(data, positions=data.positions[:, :1], position_noise=None, trial_names=('0',))
    shown = pictures_of(diagnosis('cannot_judge', ()), alone)
    assert shown[1] == []
    assert 'Deviation' not in text(diagnosis_page(diagnosis('cannot_judge', ()), alone))


@pytest.mark.browser
def test_the_page_of_the_command_opens_and_fits(commanded, tmp_path):
    seen = open_page(commanded / 'page.html', tmp_path)
    assert_fine(seen)
    for part in ('Missing: friction in the hinges', 'The error falls', 'What else it could be',
                 'The moment that the model lacks', 'What this rests on'):  # fmt: skip
        assert part in seen[1200]['text']


@pytest.mark.slow  # a comparison of such an arm is drawn by the same script: test_report.py
@pytest.mark.browser
def test_the_page_of_a_spatial_arm_opens(tmp_path):
    data = load_dataset(blind('e') / 'fit')
    tip = EffectFinding('tip_load', {'force_x': Value(2.5e-3, 2.4e-3, 2.6e-3, 'N')}, 0.99)
    found = diagnosis('missing_effect', (tip,))
    page = diagnosis_page(found, data).write(tmp_path / 'page.html')
    assert_fine(open_page(page, tmp_path, (1200, 390)), (1200, 390))
