"""Whoever follows the advice of a message gets on: the same message does not come again."""

import re
import shutil

import emulated
import numpy as np
import pytest
import small_dataset
from laboratory_tables import ARM, calm_recording
from matplotlib.figure import Figure
from recorded import BENT, LEFT, Recorder
from source_tree import ROOT

from tendon_robot_ros.cli.main import main
from tendon_robot_ros.common.errors import TendonRobotError
from tendon_robot_ros.drivers import make_driver
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.robot import dump_robot
from tendon_robot_ros.tables import ImportedTable

ROBOT = ROOT / 'config' / 'robots' / 'spatial_3.yaml'
RUN = ROOT / 'data' / 'hinge_friction' / 'fit'


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Stand in a folder with a robot, a data set, and files and folders that are neither."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(ImportedTable, 'plot', lambda self: Figure())  # most of an import's time
    shutil.copy(ROBOT, 'arm.yaml')
    shutil.copytree(RUN, 'run')
    (tmp_path / 'empty.yaml').touch()
    (tmp_path / 'nothing').mkdir()
    return tmp_path


# what is typed; what the message says; what it advises, typed instead (None: it advises nothing)
SITUATIONS = [
    ('model shape arm.yaml --tensions tree=1', "unknown 'tree'; did you mean three?",
     'model shape arm.yaml --tensions three=1'),
    ('model shape arm.yaml --tensions one=-1',
     'one: expected a finite tension not below 0 N, got -1',
     'model shape arm.yaml --tensions one=1'),
    ('model shape arm.yaml --tensions one=20', 'above the limit of 8 N .*; say --beyond-limits',
     'model shape arm.yaml --tensions one=20 --beyond-limits'),
    ('model shape arm.yaml --pulls one=0.002,two=0.001', 'if m is meant, say --unit m',
     'model shape arm.yaml --pulls one=0.002,two=0.001 --unit m'),
    ('model shape arm.yaml --pulls one=500', '500 mm on an arm of 120 mm$', None),
    ('model shape arm.yaml --pulls one=5m', '5000 mm on an arm of 120 mm$', None),
    ('model shape run --tensions left=1', 'run: is a folder; name its run/robot.yaml',
     'model shape run/robot.yaml --tensions left=1'),
    ('model shape spatial3 --tensions one=1', 'did you mean spatial_3?',
     'model shape spatial_3 --tensions one=1'),
    ('model shape empty.yaml --tensions one=1', r'a robot description .* got .an empty file.',
     None),
    ('model reach arm.yaml --position 0.01,0,0.1', 'if m is meant, say --unit m',
     'model reach arm.yaml --position 0.01,0,0.1 --unit m'),
    ('model reach arm.yaml --position 10,0,100 --unit m', 'if mm is meant, say --unit mm',
     'model reach arm.yaml --position 10,0,100 --unit mm'),
    ('model reach arm.yaml --positon 10,0,100', 'did you mean --position? see ',
     'model reach arm.yaml --position 10, 0 100'),
    ('simulate arm.yaml --outptu new', 'did you mean --output? see ',
     'simulate arm.yaml --postures 1 --output new'),
    ('model reach arm.yaml --position 1e9,0,0', 'from the base of an arm of 120 mm$', None),
    ('model reach arm.yaml --position 10m,0,0', 'from the base of an arm of 120 mm$', None),
    ('compare arm.yaml', 'is a file, and no data set; name the folder that holds dataset.yaml',
     'compare run'),
    ('compare absent', 'absent: is not there; name the folder of a data set', 'compare run'),
    ('compare run/shapes.csv', 'is a table, and no data set', None),
    ('compare run --model arm.yaml', 'run: was measured with the inputs left, right of planar1, '
     'but arm.yaml has one, two, three; name a description of the robot that was measured',
     'compare run --model run/robot.yaml'),
    ('import table run/shapes.csv --robot arm.yaml --output new',
     'run/shapes.csv: belongs to the data set run, which needs no import; compare it: ',
     'compare run'),
    ('import table run --robot arm.yaml --output new', 'compare it: ', 'compare run'),
    ('import bag run --output new', 'run: is a data set, and no recording; compare it: ',
     'compare run'),
    ('import bag nothing --output new', 'nothing: is a folder without metadata.yaml', None),
    ('simulate arm.yaml --output new --postures 0',
     '--postures: expected a whole number from 1 on',
     'simulate arm.yaml --output new --postures 1'),
]  # fmt: skip


@pytest.mark.parametrize(('typed', 'said', 'advised'), SITUATIONS, ids=[s[0] for s in SITUATIONS])
def test_who_follows_the_advice_gets_on(folder, capsys, typed, said, advised):
    assert main(typed.split()) == 1
    message = capsys.readouterr().err.strip().splitlines()[-1]
    assert re.search(said.replace('?', r'\?'), message), message
    if advised is None:
        assert not re.search(r'say --|did you mean', message)
    else:
        assert main(advised.split()) == 0, capsys.readouterr().err


# -----------------------------------------------------------------------------
# Of tables: what is typed and said, again and again, until the last line does what was wanted.

IMPORT = '--robot coarse.yaml --up y --output new'
NAMED = '--column one=T1 --column two=T2 --column three=T3'
GREEK = '--column one=alpha --column two=beta --column three=gamma'
TURN_MM = 2.0 * np.pi * 10.0  # [mm] of wire on a spool of 10 mm
TABLES = [
    [(f'untold.csv {IMPORT}', 'or say --unit inputs=N'),
     (f'untold.csv {IMPORT} --unit inputs=N', None)],
    [(f'untold.csv {IMPORT} --column one=T', r"no column 'T' .*; use one of time_s, T1, T2, T3"),
     (f'untold.csv {IMPORT} --column one=T1', 'for the inputs two, three .*; name each by --col'),
     (f'untold.csv {IMPORT} {NAMED} --unit inputs=N', None)],
    [(f'motors.csv {IMPORT}', 'are recognised among .*; name each by --column INPUT=COLUMN'),
     (f'motors.csv {IMPORT} {GREEK}', 'nothing says the unit .* or say --unit inputs=N'),
     (f'motors.csv {IMPORT} {GREEK} --unit inputs=N', None)],
    [(f'cm.csv {IMPORT}', 'neither m nor mm fits: .*; say --unit positions=cm$'),
     (f'cm.csv {IMPORT} --unit positions=cm', None)],
    [(f'mixed.csv {IMPORT}', 'where only the header is wrong, say --unit positions=mm'),
     (f'mixed.csv {IMPORT} --unit positions=mm', None)],
    [(f'metres.csv {IMPORT}', r'check the unit \(--unit positions=...\)'),
     (f'metres.csv {IMPORT} --unit positions=mm', None)],
    [(f'frames.csv {IMPORT} --unit time=20Hz', 'no column of times; say --column time=COLUMN'),
     (f'frames.csv {IMPORT} --unit time=20Hz --column time=number', None)],
    [(f'inputs.csv places.csv {IMPORT}', 'has no column of times; say --column time=COLUMN'),
     (f'inputs.csv places.csv {IMPORT} --column time=moment', None)],
    [(f'table.csv {IMPORT} --column time=tme', "no column 'tme' .*; use one of time_s"),
     (f'table.csv {IMPORT} --column time=time_s', None)],
    [(f'amps.csv {IMPORT}', 'say --spool MM'),
     (f'amps.csv {IMPORT} --spool 10', 'say --torque-constant'),
     (f'amps.csv {IMPORT} --spool 10 --torque-constant 0.5', None)],
    [(f'ticks.csv {IMPORT}', 'say --spool MM'),
     (f'ticks.csv {IMPORT} --spool 10', 'say --counts-per-turn, 4096'),
     (f'ticks.csv {IMPORT} --spool 10 --counts-per-turn 4096', None)],
    [(f'table.csv {IMPORT} --duration 30', 'lasts 18.4 s, .*; allow a shorter duration, say 9.2'),
     (f'table.csv {IMPORT} --duration 9.2', 'never stands still for 9.2 s .*; allow a shorter'),
     (f'table.csv {IMPORT} --duration 1.2', None)],
    [('table.csv --robot coarse.yaml --output new --frame level', "needs the tracker's --up"),
     (f'table.csv {IMPORT} --frame level', None)],
    [(f'table.csv {IMPORT} --points bodies', 'holds no bodies .*; use one of markers'),
     (f'table.csv {IMPORT} --points markers', None)],
    [(f'table.csv {IMPORT} --markers 30,60,90', '4 markers, but 3 places .*; give one arc length'),
     (f'table.csv {IMPORT} --markers 30,60,90,120', None)],
    [(f'table.csv {IMPORT} --markers 30,60,90,100', 'give the distance of every marker'),
     (f'table.csv {IMPORT} --markers 30,60,90,120', None)],
    [('table.csv --output new', '--robot: describe the arm with `robot new`, then name its file'),
     (f'table.csv {IMPORT}', None)],
    [('table.csv --robot coarse.yaml --output run', 'holds a data set already; .* --overwrite'),
     ('table.csv --robot coarse.yaml --output run --overwrite', None)],
]  # fmt: skip
# what an import that goes well advises, and what is typed then: the advice is gone
LOOKS = [
    (f'table.csv {IMPORT} --path visits', 'leave out --path visits', f'table.csv {IMPORT}'),
    (f'mixed.csv {IMPORT} --unit positions=mm', 'if the table is right, leave out --unit positi',
     f'table.csv {IMPORT}'),
    ('table.csv --robot arm.yaml --output new', 'where down is: say --up',
     'table.csv --robot coarse.yaml --up y --output new'),
]  # fmt: skip


@pytest.fixture(scope='module')
def measured(tmp_path_factory):
    """Return a folder with tables of one arm, each with something wrong but the first."""
    folder = tmp_path_factory.mktemp('tables')
    table = calm_recording()
    (folder / 'coarse.yaml').write_text(dump_robot(ARM))
    inputs, places = ([c for c in table if f'[{unit}]' in c] for unit in ('N', 'mm'))
    shifted = [c for c in places if 'marker_04' in c]

    def other(names, values=None):
        changed = table.rename(columns=dict(names))
        return changed if values is None else changed.assign(**dict(values))

    def in_unit(unit, values):
        names = [c.replace('[N]', f'[{unit}]') for c in inputs]
        return other(zip(inputs, names, strict=True), zip(names, values.T, strict=True))

    tables = {
        'table': table,
        'untold': other((c, c.replace(' [N]', '')) for c in inputs),
        'motors': other(zip(inputs, ('alpha', 'beta', 'gamma'), strict=True)),
        'cm': other(((c, c.replace(' [mm]', '')) for c in places),
                    ((c.replace(' [mm]', ''), 0.1 * table[c]) for c in places)),
        'mixed': other((c, c.replace('[mm]', '[m]')) for c in shifted),
        'metres': other((c, c.replace('[mm]', '[m]')) for c in places),
        'frames': other([('time_s', 'number')], [('number', range(len(table)))]),
        'inputs': table[['time_s', *inputs]],
        'places': table[['time_s', *places]].rename(columns={'time_s': 'moment'}),
        'amps': in_unit('A', table[inputs].to_numpy() * 0.01 / 0.5),
        'ticks': in_unit('ticks', simulated_pulls(table[inputs].to_numpy()) * 4096 / TURN_MM),
    }  # fmt: skip
    for name, content in tables.items():
        content.to_csv(folder / f'{name}.csv', index=False)
    return folder


def simulated_pulls(tensions):
    """Return how far wires (R, 3) [mm] are wound under tensions [N]."""
    model = Model(ARM)
    rows, index = np.unique(tensions, axis=0, return_inverse=True)
    return 1e3 * model.shapes(rows).pulls[index.ravel()]


@pytest.fixture
def tables(folder, measured):
    """Stand beside the tables."""
    for path in measured.iterdir():
        shutil.copy(path, folder)
    return folder


@pytest.mark.parametrize('steps', TABLES, ids=[steps[0][0] for steps in TABLES])
def test_who_follows_the_advice_about_a_table_gets_on(tables, capsys, steps):
    for typed, said in steps:
        code = main(['import', 'table', *typed.split()])
        message = capsys.readouterr().err.strip()
        assert code == (said is not None), message
        assert said is None or re.search(said, message), message


@pytest.mark.parametrize(('typed', 'said', 'advised'), LOOKS, ids=[look[0] for look in LOOKS])
def test_a_look_is_gone_where_its_advice_is_followed(tables, capsys, typed, said, advised):
    assert main(['import', 'table', *typed.split()]) == 0
    assert said in capsys.readouterr().out
    shutil.rmtree('new')
    assert main(['import', 'table', *advised.split()]) == 0
    assert said not in capsys.readouterr().out


# -----------------------------------------------------------------------------
# Of recordings: what is recorded, and the steps as above.

MARKERS = 'markers: [{name: one, arc_length: 0.01}, {name: two, arc_length: 0.02}, ' \
    '{name: three, arc_length: 0.03}]\n'  # fmt: skip
RECORDINGS = {
    'without a robot': ({}, [
        ('import bag bag --output new', 'no robot description; name one with --robot robot.yaml'),
        ('import bag bag --output new --robot small.yaml', None)]),
    'judged without a robot': ({}, [
        ('compare bag', 'no robot description; name one with --robot'),
        ('compare bag --model small.yaml', None)]),
    'without tensions': ({'tensions': False}, [
        ('import bag bag --output new --robot small.yaml --description tension.yaml',
         'say input: displacement in a dataset.yaml and name it with --description'),
        ('import bag bag --output new --robot small.yaml --description pulls.yaml', None)]),
    'markers that are not described': ({}, [
        ('import bag bag --output new --robot small.yaml --description tip.yaml',
         'list the markers in a dataset.yaml and name it with --description'),
        ('import bag bag --output new --robot small.yaml --description three.yaml', None)]),
    'topics of markers': ({'by_topic': True}, [
        ('import bag bag --output new --robot small.yaml',
         '--marker 1=NAME for each; there: /tracker/m0, /tracker/m1, /tracker/m2'),
        ('import bag bag --output new --robot small.yaml --marker 1=/tracker/m0 '
         '--marker 2=/tracker/m1 --marker 3=/tracker/m2', None)]),
    'too short to be still': ({}, [
        ('import bag bag --output new --robot small.yaml --duration 9',
         'counts as still after 9 s; allow a shorter duration, say 0.98'),
        ('import bag bag --output new --robot small.yaml --duration 1', None)]),
    'too short to be seen still': ({}, [
        ('import bag bag --output new --robot small.yaml --duration 0.1',
         'holds a place every 0.05 s, .*; ask for a duration of 0.4 or more'),
        ('import bag bag --output new --robot small.yaml --duration 0.4',
         'never stands still for 0.4 s .*, or a higher speed where noise looks like one'),
        ('import bag bag --output new --robot small.yaml --duration 0.4 --speed 5', None)]),
    'a folder that is called as a bag of ROS 1': ({}, [
        ('export bag run new.bag', 'ends with .bag, and a folder .*; leave out .bag'),
        ('export bag run new', None), ('import bag new --output imported', None)]),
    'all at rest': ({}, [
        ('import bag bag --output new --robot small.yaml --rest 5N', 'lower what counts as rest'),
        ('import bag bag --output new --robot small.yaml --rest 0.5mm', 'one of N, .*, got .mm.'),
        ('import bag bag --output new --robot small.yaml --rest 0.5N', None)]),
    'a posture wider in another unit': ({}, [
        ('import bag bag --output new --robot small.yaml --same 2mm', 'one of N, .*, got .mm.'),
        ('import bag bag --output new --robot small.yaml --same 0.05N', None)]),
    'in the frame of a tracker': ({'frame': 'camera'}, [
        ('compare bag --model small.yaml', 'take it in with `import bag`, .*--frame base'),
        ('import bag bag --output new --robot small.yaml --frame base', None)]),
    'nothing to draw': ({}, [
        ('plot bag', 'holds neither target_pose, target_point nor tendon_command; record them')]),
}  # fmt: skip


@pytest.mark.parametrize('what', RECORDINGS)
def test_who_follows_the_advice_about_a_recording_gets_on(folder, capsys, what):
    made, steps = RECORDINGS[what]
    Recorder(rate=20.0, **made).write(folder / 'bag', [(BENT, LEFT, 0.0, 2.0)])
    (folder / 'small.yaml').write_text(small_dataset.ROBOT)
    (folder / 'tension.yaml').write_text('input: tension\n')
    (folder / 'pulls.yaml').write_text('input: displacement\n')
    (folder / 'tip.yaml').write_text('markers: [{name: tip, arc_length: 0.03}]\n')
    (folder / 'three.yaml').write_text(MARKERS)
    for typed, said in steps:
        code = main(typed.split())
        message = capsys.readouterr().err.strip()
        assert code == (said is not None), message
        assert said is None or re.search(said, message), message


# -----------------------------------------------------------------------------
# Of drivers: a configuration, its mode, what is said, and what is changed then.

TWICE = {'motors': {name: {'id': 1 + i // 2} for i, name in enumerate(emulated.robot().inputs)}}
HALVES = {name: {'id': 1 + i // 2, 'share': 0.5} for i, name in enumerate(emulated.robot().inputs)}
COARSE = {'model': 'XM430-W350'}
DRIVERS = {
    'coarse: pull': (COARSE, 'tension', 'use command_mode: pull', {}, 'pull'),
    'coarse: allowed': (COARSE, 'tension', 'or set allow_coarse: true', {'allow_coarse': True},
                        'tension'),
    'coarse: lighter': (COARSE, 'tension', 'or a lighter motor', {'model': emulated.MODEL},
                        'tension'),
    'one motor for two wires': (TWICE, 'tension', 'use command_mode: pull', {'motors': HALVES},
                                'pull'),
    'baud rate': ({'baudrate': 1234}, 'tension', 'one of .*57600', {'baudrate': 57600}, 'tension'),
    'a motor without current': ({'model': 'XL430-W250'}, 'tension', emulated.MODEL,
                                {'model': emulated.MODEL}, 'tension'),
}  # fmt: skip


@pytest.mark.parametrize('what', DRIVERS)
def test_who_follows_the_advice_of_a_driver_gets_on(what):
    wrong, mode, said, change, after = DRIVERS[what]
    content = emulated.config('/dev/ttyUSB9', **wrong)
    with pytest.raises(TendonRobotError, match=said):
        make_driver('dynamixel', emulated.robot(), content, mode=mode, source='servos.yaml')
    content |= change
    make_driver('dynamixel', emulated.robot(), content, mode=after, source='servos.yaml')


def test_a_tension_may_have_its_unit(folder, capsys):
    assert main(['model', 'shape', 'arm.yaml', '--tensions', 'one=1500mN']) == 0
    with_unit = capsys.readouterr().out
    assert main(['model', 'shape', 'arm.yaml', '--tensions', 'one=1.5']) == 0
    assert with_unit == capsys.readouterr().out
    assert main(['model', 'shape', 'arm.yaml', '--tensions', 'one=3mm']) == 1
    assert 'one' in capsys.readouterr().err
