"""Files as laboratories have them: what can be read is read, the rest is refused in one line."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from source_tree import ROOT

pytest.importorskip('pandas')

from tendon_robot_ros.cli.main import main
from tendon_robot_ros.common.errors import DataSetError, InputError
from tendon_robot_ros.common.words import find_unit, read_quantity, split_name
from tendon_robot_ros.robot import load_robot
from tendon_robot_ros.tables import import_table
from tendon_robot_ros.tables.columns import (
    RawTable,
    guess_inputs,
    guess_time,
    names_of,
    triples_of,
)
from tendon_robot_ros.tables.markers import choose_points
from tendon_robot_ros.tables.reading import read_c3d, read_tables
from tendon_robot_ros.tables.recipe import Recipe, Selection

PLAIN = 'time,T1 [N],m_x\n0,1,2\n0.5,1.5,\n'
MOTIVE = """\
Format Version,1.23,Take Name,Run 1,Length Units,Millimeters,Coordinate Space,Global

,Type,Rigid Body,Rigid Body,Marker,Marker,Marker,Marker,Marker,Marker
,Name,base,base,Unlabeled 10,Unlabeled 10,Unlabeled 10,tip,tip,tip
,ID,a,a,b,b,b,c,c,c
,,Rotation,Position,Position,Position,Position,Position,Position,Position
Frame,Time (Seconds),X,X,X,Y,Z,X,Y,Z
0,0.0,0.1,7,1,2,3,4,5,6
1,0.01,0.1,7,1,2,3,,,
"""


def read(folder, text, name='raw.csv', **options):
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode(**options))
    (table,) = read_tables(path)
    return table


def points_of(table, choice=None):
    """Return the columns of the points that are taken of a table."""
    return choose_points([table], choice).columns


def test_a_plain_table_is_read(tmp_path):
    table = read(tmp_path, PLAIN)
    assert list(table.columns) == ['time', 'T1 [N]', 'm_x']
    assert_allclose(table.columns['time'], [0.0, 0.5])
    assert_array_equal(np.isnan(table.columns['m_x']), [False, True])


@pytest.mark.parametrize(
    'text',
    [
        '# a note\n# another\n' + PLAIN,
        'System,2\nunits,mm\nrate,50\n\n' + PLAIN,
        'rate,2024-01-01\n\n' + PLAIN,
        '-,nan,NA\n' + PLAIN,
        PLAIN.replace(',', ';').replace('0.5', '0,5').replace('1.5', '1,5'),
        PLAIN.replace(',', '\t'),
        PLAIN.replace('\n', '\r\n'),
        PLAIN.replace('\n', ',\n'),
        PLAIN.replace('0,1,2', '"0","1","2"'),
        PLAIN + '\n\n',
        '\ufeff' + PLAIN,
        PLAIN.replace('1.5,', '1.5,nan'),
        PLAIN.replace('1.5,', '1.5, - '),
    ],
)  # fmt: skip
def test_other_ways_to_write_it_read_the_same(tmp_path, text):
    table, expected = read(tmp_path, text), read(tmp_path, PLAIN, 'plain.csv')
    for name in expected.columns:
        assert_array_equal(table.numbers(name), expected.columns[name], name)


def test_units_may_stand_in_a_row_of_their_own(tmp_path):
    table = read(tmp_path, 'time,pull,x\nms,mm,\n0,1,2\n10,1,2\n')
    assert table.units == {'time': 'ms', 'pull': 'mm'}
    assert (len(table), table.where(1)) == (2, f'{tmp_path}/raw.csv, row 4')


def test_other_alphabets_than_utf8_are_read_and_said(tmp_path):
    table = read(tmp_path, 'time,Länge [µm]\n0,1\n', encoding='cp1252')
    assert 'Länge [µm]' in table.columns
    assert table.notes == ('text is taken as Windows-1252: it is no UTF-8',)


def test_a_row_that_a_logger_did_not_finish_is_left_out_and_said(tmp_path):
    table = read(tmp_path, PLAIN + '1.0,1')
    assert len(table) == 2
    assert table.notes == ('the last row, 4, is cut short: left out',)


def test_a_date_is_a_time(tmp_path):
    table = read(tmp_path, 'stamp,T1\n2024-03-01 12:00:00.0,1\n2024-03-01 12:00:00.5,2\n')
    assert table.columns['stamp'][1] == '2024-03-01 12:00:00.5'
    assert guess_time(names_of(table)).column == 'stamp'


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('', 'is empty; export it again'),
        ('\n\n', 'is empty; export it again'),
        ('a,b\n', 'has no row below its header; export it again'),
        ('only\n1\n', "row 1: has one column only ('only'); separate columns by commas"),
        ('0,1\n2,3\n', 'row 1: is no header, it holds numbers; start the file with the names of'),
        ('a,a\n1,2\n', "row 1: column 'a' stands twice; rename one of them"),
        ('a,,b\n1,2,3\n', 'row 1: column 2 has no name; give it one'),
        ('a,b\n1,2\n1,2,3\n1,2\n', 'row 3: has 3 cells under 2 columns; write every row with the'),
        ('a,b\n1,2\n1\n1,2\n', 'row 3: has 1 cells under 2 columns; write every row with the'),
        ('a,b\n0,5,0,7\n', '(decimal commas? export with points)'),
        (b'PK\x03\x04\x00\x00', 'is no text file; export it as CSV (UTF-8)'),
    ],
)  # fmt: skip
def test_what_is_no_table_is_refused(tmp_path, text, message):
    with pytest.raises(DataSetError) as refusal:
        read(tmp_path, text)
    assert message in str(refusal.value)
    assert '\n' not in str(refusal.value)


def test_text_among_numbers_is_found(tmp_path):
    table = read(tmp_path, 'time,m_x\n0,1\n1,abc\n2,3\n')
    with pytest.raises(DataSetError, match=r"raw\.csv, row 3: m_x is 'abc'; expected a number"):
        table.numbers('m_x')


def test_two_gigabytes_are_refused_by_their_size_before_they_are_read(tmp_path):
    with (tmp_path / 'raw.csv').open('w') as file:
        file.write(PLAIN)
        file.truncate(2_000_000_000)  # it takes no room
    with pytest.raises(DataSetError, match=r'has 2\.0 GB, .* are not read at once; export 50'):
        read_tables(tmp_path / 'raw.csv')


@pytest.mark.parametrize('name', ['raw.xlsx', 'raw', 'raw.parquet', 'raw.c3d'])
def test_a_file_of_another_kind_is_refused(tmp_path, name):
    with pytest.raises(DataSetError, match=r'is (no (table|Parquet|\.c3d)|a file of Excel) ?'):
        read(tmp_path, PLAIN, name)


def test_a_frame_that_has_a_column_twice_is_refused():
    pandas = pytest.importorskip('pandas')
    frame = pandas.DataFrame([[0.0, 1.0, 1.0]], columns=['time', 'T1', 'T1'])
    with pytest.raises(DataSetError, match="Frame: column 'T1' stands twice; rename one of them"):
        import_table(frame, 'kato_10_1')


def test_parquet_and_a_frame_give_the_same_columns(tmp_path):
    pandas = pytest.importorskip('pandas')
    pytest.importorskip('pyarrow')
    frame = pandas.DataFrame({'time': [0.0, 0.5], 'T1 [N]': [1, 2], 'note': ['a', None]})
    frame.to_parquet(tmp_path / 'raw.parquet')
    (table,) = read_tables(tmp_path / 'raw.parquet')
    assert list(table.columns) == ['time', 'T1 [N]', 'note']
    assert table.columns['note'].tolist() == ['a', '']


def test_the_export_of_optitrack_is_read_with_its_header_rows(tmp_path):
    table = read(tmp_path, MOTIVE)
    ((_, y, _),) = points_of(table)
    assert table.columns[y][0] == 5.0
    assert table.units['tip X'] == 'millimeters'
    assert table.up == 'y'
    assert guess_time(names_of(table)).column == 'time'
    assert np.isnan(table.columns['tip Z'][1])


VICON = """\
Trajectories
100
,,arm:elbow,,,arm:tip,,
Frame,Sub Frame,X,Y,Z,X,Y,Z
,,mm,mm,mm,mm,mm,mm
1,0,1,2,3,4,5,6
2,0,1,2,3,,,
"""


def test_an_export_of_vicon_gives_markers_their_unit_time_and_up(tmp_path):
    table = read(tmp_path, VICON)
    _, (_, y, _) = points_of(table)
    assert table.columns[y][0] == 5.0
    assert np.isnan(table.columns['tip Z'][1])
    assert table.units['tip X'] == 'mm'
    assert table.up == 'z'
    assert guess_time(names_of(table)).column == 'time'
    assert table.columns['time'].tolist() == [0.01, 0.02]


def test_a_marker_may_be_called_as_an_axis_is(tmp_path):
    table = read(tmp_path, VICON.replace('arm:elbow', 'arm:disk Z'))
    (x, _, z), _ = points_of(table)
    assert (table.columns[x][0], table.columns[z][0]) == (1.0, 3.0)
    assert (x, z) == ('disk Z X', 'disk Z Z')


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('Devices\n1000\n', 'is an export of Vicon .* its header rows'),
        (VICON.replace('\n2,0,', '\nx,0,'), "row 7: frame is 'x'; expected a number"),
        (VICON.replace('\n2,0,', '\n2,x,'), "row 7: Sub Frame is 'x'; expected a number"),
    ],
)
def test_an_export_of_vicon_without_points_or_numbers_of_frames_is_refused(
    tmp_path, text, message
):
    with pytest.raises(DataSetError, match=message):
        read(tmp_path, text)


def test_frames_of_an_unknown_rate_are_no_seconds(tmp_path):
    robot = load_robot(ROOT / 'config/robots/kato_10_1_single.yaml')
    table = read(tmp_path, VICON.replace('100\n', '\n', 1))
    with pytest.raises(DataSetError, match=r'counts frames, .* say --unit time=60Hz, or how many'):
        Selection([table], robot, Recipe())
    table = replace(table, columns={**table.columns, 'T1 [N]': np.ones(2), 'T2 [N]': np.ones(2)})
    asked = Recipe(time_unit='60Hz', positions='mm')
    assert Selection([table], robot, asked).recipe.time == {'time': '60Hz'}
    assert find_unit('60Hz').factor == pytest.approx(1.0 / 60.0)


def test_an_export_of_optitrack_without_its_rows_is_refused(tmp_path):
    with pytest.raises(DataSetError, match='OptiTrack without rows that name the points'):
        read(tmp_path, 'Format Version,1.23\n1,2\n')


@pytest.mark.parametrize(
    ('labels', 'taken'),
    [
        (('disk', 'disk', 'disk'), ('disk', 'disk no 2', 'disk no 3')),
        (('disk1', 'disk2', 'disk2'), ('disk1', 'disk2', 'disk2 no 2')),
        (('m', 'm', 'm no 2'), ('m', 'm no 3', 'm no 2')),
    ],
)
def test_points_with_one_label_all_stay(tmp_path, labels, taken):
    ezc3d = pytest.importorskip('ezc3d')
    made = ezc3d.c3d()
    made['parameters']['POINT']['RATE']['value'] = [50.0]
    made['parameters']['POINT']['LABELS']['value'] = list(labels)
    made['parameters']['POINT']['UNITS']['value'] = ['mm']
    points = np.ones((4, 3, 5))
    points[:3] = np.arange(1.0, 10.0).reshape(3, 3, 1)
    made['data']['points'] = points
    made.write(str(tmp_path / 'run.c3d'))
    table = read_c3d('run.c3d', tmp_path / 'run.c3d')
    assert list(table.columns) == ['time', *(f'{name} {axis}' for name in taken for axis in 'xyz')]
    assert [table.columns[f'{name} x'][0] for name in taken] == [1.0, 2.0, 3.0]
    assert 'points are called' in table.notes[1]


def test_points_and_analog_channels_of_a_c3d_file_are_read(tmp_path):
    ezc3d = pytest.importorskip('ezc3d')
    made = ezc3d.c3d()
    made['parameters']['POINT']['RATE']['value'] = [100.0]
    made['parameters']['POINT']['LABELS']['value'] = ['A', 'B']
    made['parameters']['POINT']['UNITS']['value'] = ['mm']
    points = np.ones((4, 2, 3))
    points[:3] = np.arange(18.0).reshape(3, 2, 3)
    made['data']['points'] = points
    made.add_parameter('POINT', 'Y_SCREEN', '+Z')
    made['parameters']['ANALOG']['RATE']['value'] = [200.0]
    made['parameters']['ANALOG']['LABELS']['value'] = ['T1']
    made['parameters']['ANALOG']['UNITS']['value'] = ['N']
    made['data']['analogs'] = np.arange(6.0).reshape(1, 1, 6)
    made.write(str(tmp_path / 'run.c3d'))
    table = read_c3d('run.c3d', tmp_path / 'run.c3d')
    assert_allclose(table.columns['time'], [0.0, 0.01, 0.02])
    assert_allclose(table.columns['B y'], points[1, 1])
    assert_allclose(table.columns['T1'], [0.5, 2.5, 4.5])
    assert (table.units['T1'], table.units['A x'], table.up) == ('N', 'mm', 'z')


@pytest.mark.parametrize(
    ('column', 'name', 'unit'),
    [
        ('T1 [N]', 'T1', 'N'),
        ('m3_x (mm)', 'm3_x', 'mm'),
        ('time_s', 'time', 's'),
        ('Time (Seconds)', 'Time', 'seconds'),
        ('load cell 2 [kgf]', 'load cell 2', 'kgf'),
        ('motor1_deg', 'motor1', 'deg'),
        ('tip_m', 'tip_m', None),
        ('motor_A', 'motor_A', None),
        ('wire (left)', 'wire (left)', None),
    ],
)
def test_units_are_told_from_names(column, name, unit):
    found, its_unit = split_name(column)
    assert (found, its_unit and its_unit.text) == (name, unit)


@pytest.mark.parametrize(
    ('text', 'si'),
    [('0.2N', 0.2), ('20 g', 0.1961330), ('1lbf', 4.4482216), ('3', 3.0), ('5mN', 0.005)],
)
def test_quantities_are_read_with_their_unit(text, si):
    assert read_quantity('--rest', text, 'N', 'force') == pytest.approx(si)


def test_a_quantity_of_another_kind_is_refused():
    with pytest.raises(InputError, match=r"--rest: expected one of N, newton, .*, got 'mm'"):
        read_quantity('--rest', '3mm', 'N', 'force')
    assert find_unit('MN') is None


def table_of(*columns):
    return RawTable('raw.csv', {name: np.zeros(2) for name in columns})


@pytest.mark.parametrize(
    ('columns', 'taken'),
    [
        (('left [N]', 'right [N]'), ('left [N]', 'right [N]')),
        (('T2 [N]', 'T1 [N]', 'temp'), ('T1 [N]', 'T2 [N]')),
        (('F1_cmd_N', 'F2_cmd_N', 'F1_N', 'F2_N'), ('F1_N', 'F2_N')),
        (('pull 1 [mm]', 'pull 2 [mm]', 'I1 [mA]', 'I2 [mA]'), ('pull 1 [mm]', 'pull 2 [mm]')),
        (('motor1_deg', 'motor2_deg'), ('motor1_deg', 'motor2_deg')),
        (('tension_right', 'tension_left'), ('tension_left', 'tension_right')),
        (('load a [g]', 'load b [g]'), ('load a [g]', 'load b [g]')),
        (('T1 [N]', 'T2 [N]', 'load ² [N]'), ('T1 [N]', 'T2 [N]')),
    ],
)
def test_inputs_are_told_from_names(columns, taken):
    columns, _ = guess_inputs(names_of(table_of('time', *columns)), ('left', 'right'))
    assert tuple(name.column for name in columns) == taken


def test_a_number_too_few_is_no_guess():
    assert guess_inputs(names_of(table_of('T1 [N]')), ('left', 'right')) is None


@pytest.mark.parametrize(
    'columns', ['a_x a_y a_z', 'X1 Y1 Z1', 'm1.x m1.y m1.z', 'Arm:M3:X Arm:M3:Y Arm:M3:Z', 'x y z']
)
def test_markers_are_told_from_names(columns):
    names = columns.split()
    (one,) = triples_of(table_of('time', *names, 'rot_x'))
    assert one.columns == tuple(names) and not one.quantity


def test_the_command_refuses_in_one_line_and_writes_nothing(tmp_path, capsys):
    raw = tmp_path / 'raw.csv'
    raw.write_text('time,T1,T2,m_x,m_y,m_z\n0,1,2,3,4,5\n1,1,2,3,4,x\n')
    robot = 'config/robots/kato_10_1_single.yaml'
    out = tmp_path / 'out'
    call = ['import', 'table', str(raw), '--robot', robot, '--output', str(out)]
    for more, message in (
        ([], 'nothing says the unit of T1, T2; write it into the header'),
        (['--unit', 'inputs=N'], "row 3: m_z is 'x'; expected a number"),
        (['--unit', 'inputs=furlong'], '--unit inputs: expected one of N, newton'),
        (['--column', 'up=T1'], '--column up=...: expected time or one of left, right'),
        (['--markers', '30,20'], '--markers: expected distances that grow, from base to tip [mm]'),
        (['--unit', 'inputs=deg'], "row 3: m_z is 'x'"),
        (['--same', '1e9N'], '--same: got 1000000000.0; expected a finite number from'),
    ):  # fmt: skip
        assert main([*call, *more]) == 1
        error = capsys.readouterr().err
        assert message in error, error
        assert error.count('\n') == 1
    (tmp_path / 'run').mkdir()
    (tmp_path / 'run' / 'dataset.yaml').write_text('mine')
    assert main([*call[:-1], str(tmp_path / 'run')]) == 1  # before 20 s of work
    said = capsys.readouterr()
    assert said.out == '' and 'run: holds a data set already; name a new folder' in said.err
    shutil.rmtree(tmp_path / 'run')
    assert not out.exists()
    assert [path.name for path in tmp_path.iterdir()] == ['raw.csv']


def test_arguments_in_each_others_place_are_told_apart(tmp_path, capsys, monkeypatch):
    """A robot, a folder or a data set where a table is meant, and tables behind options."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'raw.csv').write_text(PLAIN)
    (tmp_path / 'arm.yaml').write_text('name: arm\n')
    (tmp_path / 'data').mkdir()
    (tmp_path / 'data' / 'dataset.yaml').write_text('input: tension\n')
    (tmp_path / 'tables').mkdir()
    before = sorted(tmp_path.rglob('*'))
    for call, message in (
        (
            'arm.yaml raw.csv --output run',
            'arm.yaml: is no table; a robot description goes behind',
        ),
        ('run raw.csv --robot arm.yaml --output out', 'run: is not there; tables stand first'),
        ('data --robot arm.yaml --output run', 'data: is a folder, and no table; compare it: '),
        ('tables --robot arm.yaml --output run', 'is a folder, and no table; name the tables in'),
        ('--robot raw.csv --output run', '--robot raw.csv: is a table; tables stand alone'),
        ('--recipe raw.csv --output run', '--recipe raw.csv: is a table; tables stand alone'),
        ('raw.csv --robot arm.yaml --output new.csv', '--output new.csv: expected the folder'),
        ('raw.csv --robot arm.yaml --output arm.yaml', '--output arm.yaml: expected the folder'),
    ):
        assert main(['import', 'table', *call.split()]) == 1, call
        said = capsys.readouterr()
        assert message in said.err, said.err
        assert said.out == '' and said.err.count('\n') == 1
    assert sorted(tmp_path.rglob('*')) == before


@pytest.mark.parametrize('command', ['compare raw.csv', 'diagnose raw.csv',
                                     'improve raw.csv --output new.yaml',
                                     'effect add tip_load --data raw.csv --output new.yaml',
                                     'compare data/hinge_friction/fit/shapes.csv'])  # fmt: skip
def test_a_table_where_a_data_set_is_meant_is_sent_to_its_import(
    tmp_path, capsys, monkeypatch, command
):
    (tmp_path / 'raw.csv').write_text(PLAIN)
    (tmp_path / 'data').symlink_to(ROOT / 'data')
    monkeypatch.chdir(tmp_path)
    assert main(command.split()) == 1
    said = capsys.readouterr().err
    path = next(word for word in command.split() if word.endswith('.csv'))
    assert said == (
        f'error: {path}: is a table, and no data set; make one of it: python -m tendon_robot_ros '
        f'import table {path} --robot ARM.yaml --output run\n'
    )
