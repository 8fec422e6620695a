"""Tables that are refused in one line, and what is said of those that contradict the arm."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

pytest.importorskip('pandas')

from laboratory_tables import (
    ARM,
    CALM,
    PLACES,
    calm_import,
    calm_recording,
    noisy_recording,
    recorded,
)

from tendon_robot_ros.common.errors import DataSetError, InputError
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.tables import import_table
from tendon_robot_ros.tables.recipe import as_recipe


@pytest.fixture(scope='module')
def calm():
    return calm_recording()


@pytest.fixture(scope='module')
def noisy():
    return noisy_recording()


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        (lambda f: f.assign(time_s=f['time_s'].where(f.index != 40, 0.0)),
         r'row 41: time goes back from 1\.95 to 0 s; one file per recording: split it there'),
        (lambda f: f.assign(time_s=f['time_s'].where(f.index != 40, np.inf)),
         'row 41: time_s is inf; every row needs its time'),
        (lambda f: f.assign(time_s=f['time_s'].where(f.index != 40)),
         'row 41: time_s is empty; every row needs its time'),
        (lambda f: f.drop(columns='T2 [N]'), 'no columns for the inputs one, two, three'),
        (lambda f: f.assign(**{'T2 [N]': np.nan}),
         r'there is no number in T2 \[N\]; name another column: --column INPUT=COLUMN'),
        (lambda f: f.assign(**{c: np.nan for c in f if '[mm]' in c}), 'no marker was ever seen'),
        (lambda f: f[[c for c in f.columns if '_y' not in c]], 'no columns of a marker'),
        (lambda f: f.rename(columns=lambda c: c.replace('T1 [N]', 'T1')), 'unit of T1'),
        (lambda f: f.rename(columns=lambda c: c.replace('T1 [N]', 'T1 [mN]')), None),
        (lambda f: f.assign(**{'T1 [N]': 1e3 * f['T1 [N]']}), 'a tendon is'),
        (lambda f: f.assign(**{c: 1e3 * f[c] for c in f if '[mm]' in c}), 'check the unit'),
        (lambda f: f.rename(columns=lambda c: c.replace('04_x [mm]', '04_x [m]')
                            .replace('04_y [mm]', '04_y [m]').replace('04_z [mm]', '04_z [m]')),
         'markers are in several units: m, mm'),
    ],
)  # fmt: skip
def test_a_bad_table_is_one_line(calm, change, message):
    if message is None:  # one tension a thousand times smaller is a table as good as any
        assert import_table(change(calm), ARM, {'up': 'y'}).dataset.inputs[:, 0].max() < 1e-2
        return
    with pytest.raises((DataSetError, InputError), match=message) as refusal:
        import_table(change(calm), ARM, {'up': 'y'})
    assert '\n' not in str(refusal.value)


def test_a_marker_that_was_never_seen_is_said_and_left_out(calm):
    columns = calm_import().recipe.markers[1].columns
    imported = import_table(calm.assign(**dict.fromkeys(columns, np.nan)), ARM, {'up': 'y'})
    assert len(imported.dataset.markers) == len(PLACES) - 1
    name = columns[0].removesuffix('_x [mm]').replace('_', ' ')
    assert f'{name}: not seen while the arm stood still, left out' in imported.assumed
    places = imported.dataset.arc_lengths
    expected = Model(ARM).shapes(imported.dataset.inputs).markers(places, imported.dataset.offsets)
    assert_allclose(imported.dataset.mean, expected, atol=3e-4)


def test_a_recipe_whose_places_are_those_of_other_markers_is_contradicted(calm):
    """Markers without labels are numbered anew in every recording."""
    first = calm_import()
    assert not first.look
    markers = first.recipe.markers
    names = [name for marker in markers for name in marker.columns]
    moved = [name for marker in (*markers[1:], markers[0]) for name in marker.columns]
    again = import_table(
        calm.rename(columns=dict(zip(names, moved, strict=True))), ARM, first.recipe
    )
    (told,) = [line for line in again.look if line.startswith('markers ')]
    assert 'of the arm between them: they sit in another order, or elsewhere' in told
    free = replace(first.recipe, markers=None)
    same = import_table(calm.rename(columns=dict(zip(names, moved, strict=True))), ARM, free)
    assert not same.look
    assert_allclose(same.dataset.mean, first.dataset.mean, atol=1e-9)


def test_an_arm_that_never_stands_still_is_refused(calm):
    moving = calm.copy()
    column = next(name for name in calm.columns if '[mm]' in name)
    moving[column] += 300.0 * np.sin(3.0 * calm['time_s'])
    with pytest.raises(DataSetError, match='the arm never stands still for 1 s at once'):
        import_table(moving, ARM)


def test_a_recording_without_times_is_no_table_of_measurements(noisy):
    with pytest.raises(DataSetError, match='rows follow each other like the frames of a recor'):
        import_table(noisy.drop(columns='time_s'), ARM)


def test_a_recording_that_is_too_short_says_how_long_it_is(calm):
    with pytest.raises(
        DataSetError,
        match=r'lasts 0\.65 s, and .* still after 1 s; allow a sh',
    ):
        import_table(calm[:14], ARM)


def test_a_mirrored_tracker_is_said(calm):
    mirrored = calm.copy()
    for name in [n for n in calm.columns if '_x [mm]' in n]:
        mirrored[name] = -calm[name]
    look = ' '.join(import_table(mirrored, ARM).look)
    assert 'an axis has the wrong sign, or two inputs are swapped' in look


def test_a_marker_that_would_sit_at_the_base_and_moves_asks_for_the_length_of_the_arm(calm):
    short = replace(
        ARM.sections[0], cells=6, bending_stiffness=(0.016,) * 6, mass_profile=(1.0,) * 6
    )
    look = import_table(calm, replace(ARM, sections=(short,)), {'up': 'y'}).look
    assert any('would sit at the base: is the arm longer than its 90' in one for one in look)
    assert not any('sit at the base' in one for one in calm_import().look)


def test_markers_beside_the_backbone_are_noticed_and_can_be_said():
    beside = tuple(replace(place, offset=(0.006, -0.003, 0.0)) for place in PLACES)
    frame = recorded(CALM, count=6, places=beside)
    imported = import_table(frame, ARM, {'up': 'y'})
    (line,) = [text for text in imported.look if 'beside the backbone' in text]
    x, y = map(float, line.rpartition('--offset ')[2].split(','))
    assert (x, y) == pytest.approx((6.0, -3.0), abs=0.8)
    again = import_table(frame, ARM, {'up': 'y', 'offset': [0.006, -0.003, 0.0]})
    assert again.frame.residual < 3e-4
    assert not again.look
    assert again.dataset.markers[0].offset == (0.006, -0.003, 0.0)


def test_no_marker_sits_farther_beside_an_arm_than_it_is_long(calm):
    """All postures are taken for one, so that no bend tells an offset from a shift."""
    imported = import_table(calm, ARM, {'up': 'y', 'same': 100.0})
    assert imported.dataset.postures == ('0',)
    assert not any('beside the backbone' in line for line in imported.look)


def test_gravity_is_told_by_the_up_of_the_tracker(calm):
    data = import_table(calm, replace(ARM, gravity=None), {'up': 'y'}).dataset
    assert_allclose(data.gravity, [-9.80665, 0.0, 0.0], atol=0.15)
    wrong = import_table(calm, ARM, {'up': '-y', 'frame': {'method': 'model'}})
    assert 'gravity of the robot and up of the tracker are 180° apart' in ' '.join(wrong.look)
    (told,) = import_table(calm, replace(ARM, gravity=None), {'up': 'y'}).look
    assert told.startswith(
        'up is told (y), but the description has no gravity: the tracker is not'
    )
    zero = replace(ARM, gravity=(0.0, 0.0, 0.0))
    assert 'gravity is zero: up is not used' in ' '.join(
        import_table(calm, zero, {'up': 'y'}).look
    )


def in_grams(frame):
    """Write tensions in grams, and say so in the header."""
    other = frame.copy()
    for name in [n for n in frame.columns if '[N]' in n]:
        other[name] = frame[name] / 9.80665e-3
    return other.rename(columns=lambda name: name.replace('[N]', '[gf]'))


def test_a_unit_given_by_hand_that_the_table_contradicts_is_said(calm):
    grams = in_grams(calm)
    assert not import_table(grams, ARM, {'up': 'y'}).look
    wrong = import_table(grams, ARM, replace(as_recipe({'up': 'y'}), input_unit='mN'))
    assert wrong.look[0] == (
        'the table says gf of T1 [gf], T2 [gf], T3 [gf], and mN was taken, 9.81 times as little: '
        'if the table is right, leave out --unit inputs=mN (or take the unit out of import.yaml)'
    )
    right = import_table(calm, ARM, replace(as_recipe({'up': 'y'}), input_unit='N'))
    assert not right.look
    columns = [name for name in calm.columns if '[mm]' in name]
    metres = calm.rename(columns=lambda name: name.replace('[mm]', '[m]'))
    look = import_table(metres, ARM, {'up': 'y', 'positions': 'mm'}).look[0]
    assert look.startswith('the table says m of ') and ', and mm was taken, 1000 times as' in look
    assert columns[0].replace('[mm]', '[m]') in look
