"""Exports of every maker, version, separator and order give the places that were written."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

pytest.importorskip('pandas')

import pandas
import tracker_exports as write
from laboratory_tables import ARM, calm_import, calm_recording

from tendon_robot_ros.common.errors import DataSetError
from tendon_robot_ros.tables import import_table
from tendon_robot_ros.tables.columns import table_of, triples_of
from tendon_robot_ros.tables.markers import choose_points, circle_centres
from tendon_robot_ros.tables.reading import read_tables, widened
from tendon_robot_ros.tables.recipe import Recipe, Selection

PLACES = write.truth()
RIMS = write.rim(PLACES)
MARKERS = [c for j, n in enumerate(write.NAMES) for c in write.triple('marker', n, PLACES[:, j])]
BODIES = [c for j, n in enumerate(write.NAMES) for c in write.triple('body', n, PLACES[:, j])]
ONE_BODY = write.triple('body', 'Arm', PLACES.mean(axis=1))
OF_ONE_BODY = [
    c
    for j in range(4)
    for c in write.triple('body marker', f'Arm:Marker{j + 1}', PLACES[:, j])
]  # fmt: skip


def rims_of(kind):
    return [
        c
        for j, n in enumerate(write.NAMES)
        for k in range(3)
        for c in write.triple(kind, f'{n}:Marker{k + 1}', RIMS[:, j, k])
    ]


TRAJECTORIES = write.vicon_part(
    'Trajectories', [f'Arm:{n}' for n in write.NAMES], ['X', 'Y', 'Z'], ['mm'] * 3,
    PLACES.reshape(len(PLACES), -1),
)  # fmt: skip
OUTPUTS = write.vicon_part(
    'Model Outputs', ['Arm:Angle'], ['X', 'Y', 'Z'], ['deg'] * 3, np.ones((8, 3))
)
CENTRES = write.vicon_part(
    'Model Outputs', ['Arm:Mass'], ['X', 'Y', 'Z'], ['mm'] * 3, np.ones((8, 3))
)
DEVICES = write.vicon_part(
    'Devices', ['Plate'], ['Fx', 'Fy', 'Fz', 'Mx', 'My', 'Mz'], ['N'] * 3 + ['N.mm'] * 3,
    np.ones((16, 6)), rate=1000,
)  # fmt: skip
OBJECTS = write.vicon_part(
    'Objects', [f'{n}:{n}' for n in write.NAMES], ['RX', 'RY', 'RZ', 'RW', 'TX', 'TY', 'TZ'],
    [''] * 4 + ['mm'] * 3,
    np.concatenate([np.ones((8, 4, 4)), PLACES], axis=2).reshape(8, -1),
)  # fmt: skip

EXPORTS = {
    'Motive, markers': write.motive(MARKERS),
    'Motive 3.1, with parents': write.motive(MARKERS, version='1.25', parent=True),
    'Motive 1.0, bodies without labels': write.motive(BODIES, version='1.0', labels=False),
    'Motive, semicolons, decimal commas': write.motive(MARKERS, delimiter=';', decimal=','),
    'Motive, ghosts': write.motive([*write.ghosts(120, 8), *MARKERS, *write.ghosts(300, 8, 2000)]),
    'Motive, a body and its markers': write.motive([*ONE_BODY, *OF_ONE_BODY]),
    'Motive, constraint markers': write.motive(OF_ONE_BODY),
    'Motive, everything': write.motive([*ONE_BODY, *OF_ONE_BODY, *MARKERS]),
    'Motive, rims': write.motive([*BODIES, *rims_of('body marker'), *rims_of('marker')]),
    'Motive, rims without bodies': write.motive(rims_of('marker')),
    'Nexus, trajectories': write.vicon([TRAJECTORIES]),
    'Nexus, outputs behind': write.vicon([TRAJECTORIES, OUTPUTS]),
    'Nexus, outputs before': write.vicon([OUTPUTS, CENTRES, TRAJECTORIES]),
    'Nexus, devices before, padded': write.vicon([DEVICES, TRAJECTORIES, OUTPUTS], padded=True),
    'Nexus, semicolons': write.vicon([OUTPUTS, TRAJECTORIES], delimiter=';', padded=True),
    'Nexus, decimal commas': write.vicon([TRAJECTORIES, DEVICES], delimiter=';', decimal=','),
    'Tracker, objects': write.vicon([OBJECTS]),
    'Qualisys': write.qualisys(PLACES),
    'Qualisys, names only in its head': write.qualisys(PLACES, counted=False),
    'Cortex': write.trc(PLACES),
    'NDI ToolBox': write.ndi_toolbox(PLACES),
    'NDI First Principles': write.ndi_first_principles(PLACES),
}


def read(folder, text):
    path = folder / 'run.csv'
    path.write_text(text)
    return read_tables(path)


def places_of(tables, choice=None):
    """Return the places (T, J, 3) of the points that are taken, and their table."""
    points = choose_points(tables, choice)
    (table,) = [t for t in tables if points.columns[0][0] in t.columns]
    found = [np.column_stack([table.columns[c] for c in one]) for one in points.columns]
    return np.stack([circle_centres(f.reshape(len(f), -1, 3)) for f in found], axis=1), table


@pytest.mark.parametrize('name', EXPORTS)
def test_an_export_gives_the_places_and_times_that_were_written(tmp_path, name):
    places, table = places_of(read(tmp_path, EXPORTS[name]))
    order = np.argsort(places[0, :, 2])
    assert_allclose(places[:, order], PLACES, atol=2e-5)
    column = choose_points([table], None).columns[0][0]
    assert table.units[column] in ('mm', 'millimeters')
    if table.units['time'] == 's':
        assert_allclose(np.diff(table.columns['time']), 1.0 / write.RATE, atol=1e-5)
    else:
        assert (table.units['time'], name) == ('frames', 'NDI ToolBox')
    assert any(f'exported by {maker}' in note for note in table.notes
               for maker in ('OptiTrack', 'Vicon', 'Qualisys', 'Motion', 'NDI'))  # fmt: skip


def test_numbers_in_a_head_that_are_none_are_not_read(tmp_path):
    text = write.qualisys(PLACES)
    (table,) = read(tmp_path, text.replace('NO_OF_FRAMES\t8', 'NO_OF_FRAMES\t²'))
    assert len(table) == len(PLACES)
    (table,) = read(tmp_path, text.replace('NO_OF_FRAMES', 'x\tx\tTrajectories'))
    assert len(table) == len(PLACES)


def test_a_head_of_100_kb_is_read(tmp_path):
    text = write.motive([*MARKERS, *write.ghosts(700, 8)])
    assert len(text.split('\n0,')[0]) > 100_000
    places, _ = places_of(read(tmp_path, text))
    assert_allclose(places, PLACES, atol=1e-6)


@pytest.mark.parametrize(
    ('choice', 'count', 'others'),
    [(None, 4, 'markers or bodies'), ('bodies', 4, 'markers or rims'), ('markers', 12, 'rims or')],
)
def test_markers_rims_or_bodies_is_a_choice_that_is_told(tmp_path, choice, count, others):
    tables = read(tmp_path, write.motive([*BODIES, *rims_of('marker')]))
    points = choose_points(tables, choice)
    assert len(points.columns) == count
    assert f'(otherwise say --points {others}' in points.note


def test_bodies_that_are_more_than_the_markers_are_taken(tmp_path):
    tables = read(tmp_path, write.motive([*BODIES, *MARKERS[:3]]))
    assert len(choose_points(tables, None).columns) == 4
    with pytest.raises(DataSetError, match=r'holds no rims .*; use one of markers, bodies'):
        choose_points(tables, 'rims')


def test_markers_that_move_against_each_other_or_lie_in_a_row_are_no_rim():
    straight = PLACES[:, :3]
    assert len(choose_points([wide({'a:1': straight[:, 0], 'a:2': straight[:, 1],
                                    'a:3': straight[:, 2]})], None).columns) == 3  # fmt: skip
    fixed = np.repeat(PLACES[:1, :3], 8, axis=0)
    names = ('disk a', 'disk b', 'disk c')
    row = choose_points([wide(dict(zip(names, fixed.swapaxes(0, 1), strict=True)))], None)
    assert len(row.columns) == 3
    around = choose_points([wide({n: RIMS[:, 0, k] for k, n in enumerate(names)})], None)
    assert [len(columns) for columns in around.columns] == [9]


def wide(points):
    columns = {f'{n}_{a} [mm]': p[:, i] for n, p in points.items() for i, a in enumerate('xyz')}
    return table_of('DataFrame', pandas.DataFrame({'time_s': write.times(len(PLACES)), **columns}))


def test_the_centre_of_a_circle_is_that_of_any_markers_on_it():
    for angles in (
        (0.0, 80.0, 200.0),
        (0.0, 60.0, 130.0, 250.0),
        (10.0, 100.0, 190.0, 280.0, 300),
    ):
        assert_allclose(
            circle_centres(write.rim(PLACES, angles=angles)[:, 2]), PLACES[:, 2], atol=1e-9
        )
    lost = RIMS[:, 0].copy()
    lost[3, 1] = np.nan
    assert np.isnan(circle_centres(lost)).all(axis=1).tolist() == [i == 3 for i in range(8)]


@pytest.mark.parametrize(
    ('name', 'message'),
    [
        ('run.tak', 'is a file of Motive (OptiTrack) and cannot be read; export the take as CSV'),
        ('run.qtm', 'is a file of Qualisys Track Manager and cannot be read; export it as TSV'),
        ('run.x2d', 'is a file of Vicon Nexus and cannot be read'),
        ('run.trb', 'is a file of Cortex (Motion Analysis) and cannot be read'),
    ],
)
def test_what_only_its_maker_reads_is_refused_by_its_name(tmp_path, name, message):
    (tmp_path / name).write_bytes(b'\0\1')
    with pytest.raises(DataSetError) as refusal:
        read_tables(tmp_path / name)
    assert message in str(refusal.value)


def test_a_file_of_qualisys_that_was_cut_or_thinned_is_noticed(tmp_path):
    long = np.repeat(PLACES, 10, axis=0)
    (table,) = read(tmp_path, write.qualisys(long, counted=False, thinned=8))
    assert_allclose(np.diff(table.columns['time']), 8 / write.RATE)
    assert 'every 8th of 80 frames' in table.notes[-1]
    cut = write.qualisys(long, counted=False).rsplit('\n', 8)[0]
    with pytest.raises(DataSetError, match='says that it has 80 frames and has 73 rows'):
        read(tmp_path, cut + '\n')


# -----------------------------------------------------------------------------
# What x, y and z are, by name and unit.


@pytest.mark.parametrize(
    ('columns', 'quantity'),
    [
        ('tag1_rvec_x tag1_rvec_y tag1_rvec_z', 'rotations'),
        ('rot_x rot_y rot_z', 'rotations'),
        ('tipOrientationX tipOrientationY tipOrientationZ', 'rotations'),
        ('euler_x euler_y euler_z', 'rotations'),
        ('tool rx,tool ry,tool rz', 'rotations'),
        ('quat_x quat_y quat_z', 'rotations'),
        ('x [deg],y [deg],z [deg]', 'rotations'),
        ('acc_x acc_y acc_z', 'accelerations'),
        ('linear_acceleration_x linear_acceleration_y linear_acceleration_z', 'accelerations'),
        ('x [m/s^2],y [m/s^2],z [m/s^2]', 'accelerations'),
        ('vel_x vel_y vel_z', 'velocities'),
        ('gyroX gyroY gyroZ', 'angular velocities'),
        ('mag_x mag_y mag_z', 'magnetic fields'),
        ('Fx Fy Fz', 'forces'),
        ('torque_x torque_y torque_z', 'torques'),
        ('x (N),y (N),z (N)', 'forces'),
        ('tip_std_x tip_std_y tip_std_z', 'errors'),
        ('desired_x desired_y desired_z', 'commanded places'),
    ],
)
def test_triples_of_other_quantities_are_left_aside_as_what_they_are(columns, quantity):
    names = columns.split(',' if ',' in columns else None)
    frame = pandas.DataFrame({name: [1.0, 2.0] for name in ('t [s]', *names)})
    (triple,) = triples_of(table_of('DataFrame', frame))
    assert triple.quantity == quantity
    with pytest.raises(DataSetError, match=rf'{quantity} .* no measured places; name them alike'):
        choose_points([table_of('DataFrame', frame)], None)
    frame[['tip_x', 'tip_y', 'tip_z']] = 1.0
    points = choose_points([table_of('DataFrame', frame)], None)
    assert points.columns == (('tip_x', 'tip_y', 'tip_z'),)
    assert points.aside[0].startswith(f'{quantity} (')


@pytest.mark.parametrize(
    'columns', ['tag1_tvec_x tag1_tvec_y tag1_tvec_z', 'tipX tipY tipZ', 'tx ty tz', 'px py pz',
                'pos_x pos_y pos_z', 'X Y Z', 'X_m1 Y_m1 Z_m1'],
)  # fmt: skip
def test_places_are_told_however_they_are_called(columns):
    names = columns.split()
    frame = pandas.DataFrame({name: [1.0, 2.0] for name in names})
    assert choose_points([table_of('DataFrame', frame)], None).columns == (tuple(names),)


# -----------------------------------------------------------------------------
# Whole imports.


@pytest.fixture(scope='module')
def calm():
    return calm_recording()


@pytest.fixture(scope='module')
def reference(calm):
    return calm_import().dataset


def markers_of(frame):
    """Return places (T, J, 3) [mm] and the other columns."""
    columns = [c for c in frame.columns if '[mm]' in c]
    return frame[columns].to_numpy().reshape(len(frame), -1, 3), frame.drop(columns=columns)


def long_table(frame, with_inputs, stamps='alike', order='rounds'):
    places, rest = markers_of(frame)
    time = next(c for c in rest.columns if 'time' in c)
    kept = rest if with_inputs else rest[[time]]
    rows = [
        kept.assign(**{'tag_id': 10 + j, 'x': places[:, j, 0], 'y': places[:, j, 1],
                       'z': places[:, j, 2], 'rvec_x': 0.1, 'rvec_y': 0.2, 'rvec_z': 0.3})
        for j in range(places.shape[1])
    ]  # fmt: skip
    if stamps == 'own':
        rows = [one.assign(**{time: one[time] + 1e-4 * j}) for j, one in enumerate(rows)]
    whole = pandas.concat(rows)
    whole = whole.sort_values([time, 'tag_id']) if order == 'rounds' else whole
    return whole.dropna(subset=['x']).reset_index(drop=True)


@pytest.mark.parametrize(
    ('with_inputs', 'stamps', 'order'),
    [(True, 'alike', 'rounds'), (False, 'alike', 'rounds'), (True, 'own', 'rounds'),
     (False, 'alike', 'one after the other')],
)  # fmt: skip
def test_a_long_table_is_the_same_as_a_wide_one(calm, reference, with_inputs, stamps, order):
    tall = long_table(calm, with_inputs, stamps, order)
    sources = [tall] if with_inputs else [markers_of(calm)[1], tall]
    imported = import_table(sources, ARM, {'up': 'y', 'delay': [0.0]})
    assert len(imported.dataset.markers) == 4
    assert_allclose(imported.dataset.mean, reference.mean, atol=3e-5)
    assert any('a row for each tag_id and time: 4 markers' in line for line in imported.assumed)
    assert any('rotations (' in line for line in imported.dropped)


@pytest.mark.parametrize('what', ['number of the trial', 'marker was seen', 'one of two markers'])
def test_a_table_with_a_row_for_each_time_stays(calm, what):
    places, rest = markers_of(calm)
    half = (np.arange(len(calm)) > len(calm) / 2).astype(int)
    one = rest.assign(x=places[:, 0, 0], y=places[:, 0, 1], z=places[:, 0, 2])
    match what:
        case 'number of the trial':
            one['id'] = half
        case 'marker was seen':
            one['marker_visible'] = np.arange(len(calm)) % 2
        case 'one of two markers':
            one[[f'm2_{axis}' for axis in 'xyz']] = places[:, 1]
            one['label'] = np.arange(len(calm)) % 2
    table = table_of('DataFrame', one)
    assert widened(table) is table


def test_a_tracker_that_was_set_up_with_another_axis_upwards_is_noticed(tmp_path, calm, reference):
    """Motive has y up, unless its export says otherwise, which no file tells."""
    places, rest = markers_of(calm)
    turned = places[:, :, [0, 2, 1]] * [1.0, -1.0, 1.0]  # z up
    columns = [c for j in range(4) for c in write.triple('marker', f'm{j}', turned[:, j])]
    loads = tmp_path / 'loads.csv'
    rest.to_csv(loads, index=False)
    take = tmp_path / 'take.csv'
    take.write_text(write.motive(columns, at=rest.iloc[:, 0].to_numpy()))
    imported = import_table([loads, take], ARM, {'delay': [0.0]})
    assert imported.recipe.up == 'z'
    assert any(line.startswith('z points up: with y, as files') for line in imported.assumed)
    assert_allclose(imported.dataset.mean, reference.mean, atol=3e-5)


def test_few_frames_a_second_are_enough(calm, reference):
    imported = import_table(calm.iloc[::8].reset_index(drop=True), ARM, {'up': 'y'})
    assert len(imported.dataset.postures) == len(reference.postures)
    assert_allclose(imported.dataset.mean, reference.mean, atol=1e-3)


@pytest.mark.parametrize(
    ('scale', 'advice'),
    [
        (0.1, 'say --unit positions=cm'),
        (1.0 / 25.4, 'say --unit positions=cm or say --unit positions=inch'),
        (0.01, 'correct cell_length and cells of the robot'),
    ],
)
def test_no_unit_is_guessed_that_the_data_do_not_show(calm, scale, advice):
    places, rest = markers_of(calm)
    columns = {f'm{j}_{a}': scale * places[:, j, i] for j in range(4) for i, a in enumerate('xyz')}
    with pytest.raises(DataSetError, match=f'neither m nor mm fits: .*; {advice}'):
        Selection([table_of('DataFrame', rest.assign(**columns))], ARM, Recipe())


def test_a_frame_that_stays_unknown_asks_for_a_look(calm):
    stiff = replace(ARM.sections[0], bending_stiffness=(0.1,) * 8)
    look = import_table(calm, replace(ARM, sections=(stiff,)), {'frame': {'method': 'model'}}).look
    assert any('more than a tenth of the arm at its tip' in line for line in look)
