"""The commands `diagnose`, `add` and `remove`: what they print, write, and refuse."""

import json
import shutil

import pytest
import simulated
import yaml
from measurements import blind, truth

from tendon_robot_ros.cli.main import main
from tendon_robot_ros.cli.options import load_measurements
from tendon_robot_ros.comparison.compare import compare
from tendon_robot_ros.data import load_dataset, save_dataset
from tendon_robot_ros.robot import load_robot

HINGES, STIFF = blind('b'), blind('f')


@pytest.fixture(scope='module')
def small(tmp_path_factory):
    """Give measurements of a short exact arm that hides hinge friction: diagnosed at once."""
    robot = simulated.robot(cells=8, exact=True)
    dataset = simulated.measured(robot, {'hinge_friction': {'lever': 3e-4}})
    return save_dataset(dataset, tmp_path_factory.mktemp('small') / 'set')


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch, small):
    """Run in an empty folder that links to the measurements."""
    (tmp_path / 'small').symlink_to(small)
    (tmp_path / 'hinges').symlink_to(HINGES)
    (tmp_path / 'stiff').symlink_to(STIFF)
    for letter in 'ikl':
        (tmp_path / letter).symlink_to(blind(letter))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def said(capsys, *arguments, code=0):
    """Run a command; return its lines."""
    assert main(list(arguments)) == code, capsys.readouterr().err
    return capsys.readouterr().out.rstrip('\n').split('\n')


def written(folder):
    return sorted(path.name for path in folder.iterdir() if not path.is_symlink())


def assert_named(content, letter):
    """Refuse a diagnosis that names anything but what a blind case hides."""
    hidden = truth(letter)
    (effect,) = content['effects']
    assert (content['verdict'], effect['name']) == ('missing_effect', hidden['hidden'])
    assert content['cannot_tell_apart'] == []
    for key, value in effect['parameters'].items():
        assert value['low'] <= hidden['parameters'][key] <= value['high']
    assert effect['explained'] > 0.95  # of the error, not of its square
    assert content['error_after'] < 1.3 * content['noise_floor'] < content['error_before']


def assert_better(folder, data, effects, error):
    """Hold the description that was written to what was said of it: values, error [mm]."""
    robot = load_robot('better.yaml')
    for name, values in effects.items():
        assert robot.effects[name] == pytest.approx(values, rel=0.02)
    assert list(robot.fitted) == list(effects)
    read_again = compare(load_dataset(f'{data}/check'), [('better', robot)]).models[-1]
    assert 1e3 * read_again.rms == pytest.approx(error, abs=5e-4)
    assert written(folder) == ['better.yaml', 'why.json']


@pytest.mark.long
def test_a_missing_effect_is_named_added_and_shown(capsys, folder):
    lines = said(capsys, 'diagnose', 'hinges/fit', '--add', 'better.yaml', '--check',
                 'hinges/check', '--json', 'why.json')  # fmt: skip
    assert_named(json.loads((folder / 'why.json').read_text()), 'b')
    assert lines[:3] == [
        'Missing: friction in the hinges of the pressed guides, lever 0.155 ± 0.013 mm '
        '(`hinge_friction`).',
        'It explains 100 % of the error above the noise.',
        'What is left (0.23 mm) equals your repeatability (0.25 mm).',
    ]
    assert lines[-2:] == [
        'error on postures never used: 2.50 mm -> 0.247 mm  (floor 0.227 mm)',
        'written: better.yaml    send it to the robot: controller parameter model := better.yaml',
    ]
    assert_better(folder, 'hinges', {'hinge_friction': {'lever': 1.55e-4}}, 0.247)


@pytest.mark.slow  # eight times as long: two sections, and friction that turns over
def test_tendons_that_resist_bending_are_named_added_and_shown(capsys, folder):
    lines = said(capsys, 'diagnose', 'stiff/fit', '--add', 'better.yaml', '--check', 'stiff/check',
                 '--json', 'why.json')  # fmt: skip
    assert_named(json.loads((folder / 'why.json').read_text()), 'f')
    assert lines == [
        'Missing: the tendons resist bending with 0.23 ± 0.06 mN·m/rad each (`tendon_stiffness`).',
        'It explains 96 % of the error above the noise.',
        'In the description: tendon_stiffness: per_tendon = 0.23 ± 0.06 mN·m/rad.',
        'What is left (0.50 mm) equals your repeatability (0.45 mm).',
        'cannot be told apart from: nothing (next best, transmission_loss, is 450 times less '
        'likely; section_stiffness does the same with more parameters)',
        '',
        'planar2 on stiff/fit: 12 postures, 60 trials and 30 markers',
        'the arm is taken as it is built: cells, tendons and tracker may be a little off',
        'noise, from the trials: 0.20 mm per coordinate, inputs 0.39 % per trial, '
        '0.20 % per setting (declared)',
        'the arm as built scatters by (1 sd, 95 %): stiffness of the cells below 1.4 %, kinks at '
        'rest below 0.046°, kinks across the plane below 0.025°, gains of the inputs below '
        '0.53 %, position of the tracker below 0.032 mm, rotation of the tracker below 0.042°',
        'not tested by these postures: friction_memory, bending_hysteresis (every posture loaded '
        'from straight); '
        'torsion (these postures hardly show it); gravity (set to zero); tendon_elongation, '
        'wire_spring, backlash, pull_zero, spool_gain (wire pulls not commanded)',
        'error on postures never used: 1.06 mm -> 0.236 mm  (floor 0.372 mm)',
        'written: better.yaml    send it to the robot: controller parameter model := better.yaml',
    ]
    assert_better(folder, 'stiff', {'tendon_stiffness': {'per_tendon': 2.303e-4}}, 0.236)


def test_the_json_has_the_promised_keys(capsys, folder):
    main(['diagnose', 'small', '--json'])
    content = json.loads(capsys.readouterr().out)
    assert content['format'] == 'tendon_robot_ros/diagnosis@1'
    (effect,) = content['effects']
    assert effect['name'] == 'hinge_friction'
    assert effect['explained'] > 0.98
    lever = effect['parameters']['lever']
    assert lever['low'] < lever['value'] < lever['high']
    assert lever['unit'] == 'm'
    for key in ('cannot_tell_apart', 'not_tested', 'out_of_tolerance', 'candidates'):
        assert isinstance(content[key], list)
    assert content['error_before'] > content['error_after'] > 0.5 * content['noise_floor']
    assert content['next_measurement'] is None
    assert content['written'] is None
    assert written(folder) == []


@pytest.mark.long
def test_json_goes_beside_the_text_when_it_has_a_name(capsys, folder):
    lines = said(capsys, 'diagnose', 'i/fit', '--json', 'why.json')
    content = json.loads((folder / 'why.json').read_text())
    assert content['verdict'] == 'ambiguous'
    assert lines[0] == 'Missing: one of these, and these 6 postures do not tell which:'
    assert lines[1].startswith('- friction in the hinges of the pressed guides, lever 0.')
    assert [line.partition('`')[2] for line in lines[1:6]] == [
        'hinge_friction`)', 'backbone_stiffness`)', 'tendon_stiffness`)', 'transmission_loss`)',
        'moment_arm`)',
    ]  # fmt: skip
    (step,) = (line for line in lines if line.startswith('Measure this next: '))
    assert step.startswith('Measure this next: left 0.641 N, right 0.684 N, 5 trials. '
                           'hinge_friction predicts the tip at least 4.9 mm')  # fmt: skip
    assert content['next_measurement']['input'] == {'left': 0.641, 'right': 0.684}


def exact(folder):
    """Write the description of case l as one that knows of no imperfections."""
    path = folder / 'exact.yaml'
    text = (folder / 'l' / 'fit' / 'robot.yaml').read_text(encoding='utf-8')
    path.write_text(f'exact: true\n{text}', encoding='utf-8')
    return str(path)


@pytest.mark.slow  # as built: test_as_built.py; what is printed: of an exact arm below
def test_a_soft_cell_of_an_arm_as_built_is_named_and_no_effect_in_its_place(capsys, folder):
    lines = said(capsys, 'diagnose', 'l/fit', '--add', 'better.yaml', code=2)
    assert lines[:2] == [
        'Missing: something that no known effect describes.',
        'No known effect helps; the error is 5.9 times the noise.',
    ]
    assert lines[2].endswith('cell 4 bends 1.4 times as much as it should. Look at that cell.')
    assert lines[-1] == 'Nothing was added: there is nothing to add.'
    assert written(folder) == []


def test_a_cause_outside_is_not_added(capsys, folder):
    own = exact(folder)
    lines = said(capsys, 'diagnose', 'l/fit', '--robot', own, '--add', 'better.yaml', code=2)
    assert lines[:2] == [
        'Missing: something that no known effect describes.',
        'Nearest: the backbone is 4.3 ± 0.3 % softer than described (`backbone_stiffness`). It '
        'lowers the error from 1.49 mm to 0.280 mm, but what remains is not random (p < 1e-6), '
        'though it is only 1.1 times the noise.',
    ]
    told = 'cell 4 bends 1.4 times as much as it should. Look at that cell.'
    assert 'in every posture' in lines[2] and lines[2].endswith(told)
    assert lines[-1] == 'Nothing was added (--partial would add backbone_stiffness).'
    assert written(folder) == ['exact.yaml']


@pytest.mark.long
def test_partial_adds_it_and_says_that_more_is_at_work(capsys, folder):
    added = ('--robot', exact(folder), '--add', 'better.yaml', '--partial')
    lines = said(capsys, 'diagnose', 'l/fit', *added)
    note, known = lines[-3:-1]
    assert note.startswith('note: more is at work than these effects: what is left on the '
                                'fitted postures is 1.1 times the noise')  # fmt: skip
    origin = yaml.safe_load((folder / 'better.yaml').read_text())['fitted']['backbone_stiffness']
    assert note == f'note: {origin["more_at_work"]}'
    assert 'at the tip on postures left out: the file says so, as model_error' in known
    assert any(
        line.startswith('error on postures left out in turn: 1.49 mm -> 0.287') for line in lines
    )


@pytest.mark.slow  # the verdict and what it names: test_diagnose.py
def test_a_wrong_parameter_is_said_and_added(capsys, folder):
    lines = said(capsys, 'diagnose', 'k/fit', '--add', 'better.yaml', '--check', 'k/check',
                 '--json', 'why.json')  # fmt: skip
    content = json.loads((folder / 'why.json').read_text())
    assert (content['verdict'], content['out_of_tolerance']) == (
        'wrong_parameter', ['bending_stiffness'])  # fmt: skip
    assert 'backbone_stiffness' in content['cannot_tell_apart']
    assert content['error_before'] > 5e-3, 'the error of the description as it stands'
    assert lines[:3] == [
        'A value is off: the backbone is 10.8 ± 1.1 % stiffer than described '
        '(`backbone_stiffness`).',
        'bending_stiffness (by 5.0 times its tolerance) must move further than declared.',
        'In the description: backbone_stiffness: relative_change = 10.8 ± 1.1 %.',
    ]
    assert lines[lines.index('') + 2] == (
        'the arm is taken as it is built: cells, tendons and tracker may be a little off; '
        'declared (1 sd): bending_stiffness 2.0 %'
    )
    # no posture tells the three of the class apart by more than its noise
    assert not any(line.startswith('Measure this next') for line in lines)
    (never,) = (line for line in lines if line.startswith('error on postures never used'))
    assert never.startswith('error on postures never used: 5.15 mm -> 0.593 mm')


def test_nothing_missing_has_nothing_to_add(capsys, folder):
    main(['effect', 'add', 'hinge_friction', '--data', 'small', '--output', 'better.yaml'])
    capsys.readouterr()
    lines = said(capsys, 'diagnose', 'small', '--robot', 'better.yaml', '--add', 'more.yaml')
    assert lines[0] == 'Nothing is missing that these measurements could show.'
    assert lines[-1] == 'Nothing was added: there is nothing to add.'
    assert any(line.startswith('smallest size that would have been seen') for line in lines)
    assert written(folder) == ['better.yaml']


def test_a_printed_command_can_be_typed_though_a_name_has_a_blank(capsys, folder):
    shutil.copytree('hinges/fit', 'my run')
    lines = said(capsys, 'compare', 'my run')
    assert any("tendon_robot_ros diagnose 'my run'" in line for line in lines)


def test_add_prints_values_and_the_staircase(capsys, folder):
    lines = said(capsys, 'effect', 'add', 'hinge_friction', '--data', 'hinges/fit', '--output',
                 'better.yaml')  # fmt: skip
    assert lines == [
        'hinge_friction: lever = 0.155 ± 0.013 mm',
        'error (rms)                           before     after  noise floor   gone',
        'fitted: 12 postures of hinges/fit    2.66 mm  0.229 mm     0.245 mm  100 %',
        'left out: 12 postures of hinges/fit  2.66 mm  0.275 mm     0.245 mm   98 %',
        'written: better.yaml    send it to the robot: controller parameter model := better.yaml',
    ]
    lines = said(capsys, 'effect', 'remove', 'hinge_friction', '--robot', 'better.yaml',
                 '--output', 'plain.yaml')  # fmt: skip
    assert lines == ['removed: hinge_friction', 'written: plain.yaml']
    before, after = load_robot('hinges/fit/robot.yaml'), load_robot('plain.yaml')
    assert (before.effects, after.fitted) == (after.effects, {})


def test_add_prints_json(capsys, folder):
    main(
        ['effect', 'add', 'hinge_friction', '--data', 'hinges/fit', '--output', 'a.yaml', '--json']
    )
    content = json.loads(capsys.readouterr().out)
    assert content['effects']['hinge_friction']['lever']['unit'] == 'm'
    assert content['check']['kind'] == 'left out'
    assert content['written'] == 'a.yaml'


@pytest.mark.parametrize(('arguments', 'message'), [
    (['diagnose', 'nowhere'], 'nowhere: is not there; name the folder of a data set'),
    (['diagnose', 'hinges/fit', '--partial'], '--partial: expected together with --add'),
    (['diagnose', 'hinges/fit', '--workers', '0'], '--workers: expected at least 1, got 0'),
    (['diagnose', 'hinges/fit', '--add', 'there.yaml'],
     'there.yaml: is there already; use --overwrite or another --add'),
    (['diagnose', 'hinges/fit', '--add', 'no/new.yaml'],
     'no/new.yaml: its folder does not exist; make it or correct --add'),
    (['diagnose', 'hinges/fit', '--robot', 'stiff/fit/robot.yaml'],
     'hinges/fit: was measured with the inputs left, right of planar1, but '),
    (['diagnose', 'hinges/fit', '--check', 'nowhere'],
     'nowhere: is not there; name the folder of a data set'),
    (['diagnose', 'hinges/fit', '--check', 'hinges/fit/'],
     'hinges/fit: is named twice; measurements count once, and check no fit to themselves'),
    (['diagnose', 'hinges/fit', '--reference', 'hinges/fit'], 'hinges/fit: is named twice; '),
    (['compare', 'hinges/fit', 'hinges/check', 'hinges/fit'], 'hinges/fit: is named twice; '),
    (['effect', 'add', 'hinge_friction', '--data', 'hinges/fit', '--output', 'there.yaml'],
     'there.yaml: is there already; use --overwrite or another --output'),
    (['effect', 'add', 'gravity', '--data', 'hinges/fit', '--output', 'new.yaml'],
     'gravity: these measurements cannot tell its value (set to zero); nothing was written'),
    (['effect', 'add', 'hinges', '--data', 'hinges/fit', '--output', 'new.yaml'],
     "unknown effect 'hinges'; known: tendon_friction, "),
    (['effect', 'remove', 'tip_load', '--robot', 'hinges/fit/robot.yaml', '--output', 'new.yaml'],
     "hinges/fit/robot.yaml: effects: no 'tip_load' to remove; listed: tendon_friction, "),
])  # fmt: skip
def test_mistakes_are_one_line_and_nothing_is_written(arguments, message, capsys, folder):
    (folder / 'there.yaml').write_text('name: mine\n')
    assert main(arguments) == 1
    out, err = capsys.readouterr()
    assert out == ''
    assert err.startswith(f'error: {message}')
    assert err.count('\n') == 1
    assert written(folder) == ['there.yaml']
    assert (folder / 'there.yaml').read_text() == 'name: mine\n'


def test_overwrite_replaces_a_description(capsys, folder):
    (folder / 'there.yaml').write_text('name: mine\n')
    main(['effect', 'add', 'hinge_friction', '--data', 'hinges/fit', '--output', 'there.yaml',
          '--overwrite'])  # fmt: skip
    assert load_robot('there.yaml').name == 'planar1'


def test_remove_brings_back_what_add_replaced(capsys, folder):
    text = (folder / 'hinges' / 'fit' / 'robot.yaml').read_text(encoding='utf-8')
    (folder / 'one.yaml').write_text(f'{text}  hinge_friction: {{lever: 1.0e-4}}\n')
    main(['effect', 'add', 'hinge_friction', '--data', 'hinges/fit', '--robot', 'one.yaml',
          '--output', 'two.yaml'])  # fmt: skip
    capsys.readouterr()
    (first, second) = said(capsys, 'effect', 'remove', 'hinge_friction', '--robot', 'two.yaml',
                           '--output', 'three.yaml')  # fmt: skip
    lever = load_robot('one.yaml').effects['hinge_friction']['lever']
    assert first == (f'hinge_friction: as before the fit again (lever = {lever}); remove it once '
                     'more to drop it')  # fmt: skip
    assert second == 'written: three.yaml'
    assert load_robot('three.yaml').effects['hinge_friction']['lever'] == lever


def test_two_effects_are_added_by_one_command(capsys, folder):
    lines = said(capsys, 'effect', 'add', 'hinge_friction', 'backbone_stiffness', '--data',
                 'hinges/fit', '--output', 'both.yaml')  # fmt: skip
    assert lines[0].startswith('hinge_friction: lever = ')
    assert lines[1].startswith('backbone_stiffness: relative_change = ')
    assert list(load_robot('both.yaml').fitted) == ['hinge_friction', 'backbone_stiffness']


def test_another_description_keeps_what_an_import_declared_of_the_frame(folder, capsys):
    copy = shutil.copytree(blind('l') / 'fit', folder / 'copy')  # the others are links
    robot = copy / 'robot.yaml'
    own = robot.read_text(encoding='utf-8')
    (folder / 'other.yaml').write_text(own, encoding='utf-8')
    robot.write_text(f'{own}\ntolerances: {{position: 0.0012, rotation: 0.035}}\n')
    data = load_measurements(str(copy), str(folder / 'other.yaml'))
    assert data.robot.tolerances == {'position': 0.0012, 'rotation': 0.035}
    assert 'beside --robot: position 1.2 mm, rotation 2.0° (1 sd)' in capsys.readouterr().err
    (folder / 'known.yaml').write_text(f'{own}\ntolerances: {{position: 0.0002}}\n')
    data = load_measurements([str(copy)], str(folder / 'known.yaml'))
    assert data.robot.tolerances == {'position': 0.0002, 'rotation': 0.035}


def test_what_comes_after_reading_is_not_called_reading(folder):
    told = []
    load_measurements('hinges/fit', None, lambda what, *_: told.append(what))
    assert told == ['reading hinges/fit', 'working']
