"""A laboratory's table becomes the data set that was simulated, wherever the tracker stands."""

import csv
import re
from dataclasses import replace
from datetime import datetime, timedelta
from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose

pytest.importorskip('pandas')

import pandas
from laboratory_tables import (
    ARM,
    CALM,
    EXACT,
    PLACES,
    QUIET,
    calm_import,
    calm_recording,
    noisy_import,
    noisy_recording,
    recorded,
)
from scipy.spatial.transform import Rotation

from tendon_robot_ros.cli.main import main
from tendon_robot_ros.common.errors import DataSetError, InputError
from tendon_robot_ros.common.rotations import rigid_fit
from tendon_robot_ros.data import load_dataset
from tendon_robot_ros.diagnosis.diagnose import diagnose
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.robot import dump_robot
from tendon_robot_ros.simulation.measurements import (
    simulate,
    tracker_frame,
    write_table,
)
from tendon_robot_ros.simulation.plant import make_plant
from tendon_robot_ros.tables import import_table
from tendon_robot_ros.tables.recipe import dump_recipe, load_recipe
from tendon_robot_ros.workspace.postures import default_postures


@pytest.fixture(scope='module')
def calm():
    return calm_recording()


@pytest.fixture(scope='module')
def noisy():
    return noisy_recording()


@pytest.fixture(scope='module')
def walk():
    return walked()


def test_an_exact_recording_gives_the_model_back():
    imported = calm_import()
    data = imported.dataset
    assert data.path == 'from_straight'
    assert_allclose(data.inputs[1:], default_postures(ARM, 4), atol=1e-3)
    expected = Model(ARM).shapes(data.inputs).markers(data.arc_lengths, data.offsets)
    assert_allclose(data.mean, expected, atol=3e-4)
    assert imported.frame.method == 'level'
    assert imported.frame.residual < 3e-4


def test_the_frame_is_the_one_that_the_tracker_stood_in():
    frame = calm_import().frame
    turn, shift = tracker_frame(ARM.gravity, CALM)  # base to tracker
    assert_allclose(frame.rotation @ turn, np.eye(3), atol=3e-3)
    assert_allclose(frame.rotation @ shift + frame.shift, 0.0, atol=3e-4)


@pytest.mark.parametrize(('method', 'seed'), [('model', 0), ('straight', 1)])
def test_any_rotation_of_the_tracker_gives_the_same_data_set(calm, method, seed):
    turn = Rotation.random(random_state=seed).as_matrix()
    moved = calm.copy()
    columns = [name for name in calm.columns if '[mm]' in name]
    places = calm[columns].to_numpy().reshape(-1, 3) @ turn.T + [300.0, -4000.0, 77.0]
    moved[columns] = places.reshape(len(calm), -1)
    imported = import_table(moved, ARM, {'frame': {'method': method}})
    expected = Model(ARM).shapes(imported.dataset.inputs)
    expected = expected.markers(imported.dataset.arc_lengths, imported.dataset.offsets)
    assert_allclose(imported.dataset.mean, expected, atol=3e-4)


def test_markers_in_another_order_give_the_same_data_set(calm):
    reference = calm_import().dataset
    order = np.random.default_rng(5).permutation(len(calm.columns))
    again = import_table(calm[calm.columns[order]], ARM, {'up': 'y'}).dataset
    assert_allclose(again.positions, reference.positions, atol=1e-9)
    assert again.markers == reference.markers


def other_units(frame):
    """Write the same in grams, metres and milliseconds, and name columns otherwise."""
    other = frame.copy()
    renamed = {}
    for name in frame.columns:
        if '[mm]' in name:
            other[name] = frame[name] / 1e3
            renamed[name] = name.replace(' [mm]', '').replace('marker_', 'M')
        elif '[N]' in name:
            other[name] = frame[name] / 9.80665e-3
            renamed[name] = name.replace('T', 'load ').replace('[N]', '(g)')
        else:
            other[name] = 1e3 * frame[name]
            renamed[name] = 't [ms]'
    return other.rename(columns=renamed)


def test_dates_whose_whole_seconds_have_no_decimals_are_times(calm):
    written = [str(datetime(2026, 3, 1) + timedelta(seconds=t)) for t in calm['time_s'].round(3)]
    assert {len(text) for text in written} == {19, 26}
    dated = import_table(calm.drop(columns='time_s').assign(time=written), ARM, {'up': 'y'})
    assert_allclose(dated.dataset.mean, calm_import().dataset.mean)


def test_units_do_not_matter(calm):
    reference = calm_import()
    other = import_table(other_units(calm), ARM, {'up': 'y'})
    assert_allclose(other.dataset.inputs, reference.dataset.inputs, atol=1e-8)
    assert_allclose(other.dataset.positions, reference.dataset.positions, atol=1e-7)
    assert any('markers are in m:' in line for line in other.assumed)


@pytest.mark.parametrize(('unit', 'a_turn'), [('ticks', 4096.0), ('deg', 360.0)])
def test_motors_with_a_spool_give_wire_pulls(unit, a_turn):
    radius = 0.01
    shapes = Model(ARM).shapes(default_postures(ARM, 3))
    turns = np.vstack([np.zeros(3), shapes.pulls]) / radius / (2.0 * np.pi)
    straight = np.zeros((1, 8, 3))
    straight[0, :, 2] = 0.015 * np.arange(1, 9)
    places = np.vstack([straight, shapes.positions])
    columns = {f'motor{i + 1} [{unit}]': a_turn * turns[:, i] + 1234.0 for i in range(3)}
    for j in range(8):
        columns |= {f'm{j}_{axis}_mm': 1e3 * places[:, j, a] for a, axis in enumerate('xyz')}
    spool = {'radius': radius, 'counts_per_turn': 4096}
    recipe = {'spool': spool, 'frame': {'method': 'base'}}
    data = import_table(pandas.DataFrame(columns), ARM, recipe).dataset
    assert data.input == 'displacement'
    assert_allclose(data.inputs[1:], shapes.pulls, atol=1e-8)
    if unit == 'ticks':
        with pytest.raises(InputError, match='inputs are in ticks: say --counts-per-turn'):
            import_table(pandas.DataFrame(columns), ARM, {'spool': {'radius': radius}})
    with pytest.raises(InputError, match='how far is the wire from the axis of its spool'):
        import_table(pandas.DataFrame(columns), ARM)


def test_wires_that_hold_against_each_other_are_said_with_the_posture():
    columns = {f'motor{i + 1} [deg]': [0.0, 30.0] for i in range(3)}
    for j in range(8):
        columns |= {f'm{j}_{axis}_mm': [0.0, 0.0] for axis in 'xy'}
        columns[f'm{j}_z_mm'] = [15.0 * (j + 1)] * 2
    said = 'in 1 of 2 postures the model finds no equilibrium, first in 1: pulls: no tensions give'
    with pytest.raises(InputError, match=f'{said}.*; release one of the wires; .*wire_spring'):
        import_table(pandas.DataFrame(columns), ARM, {'spool': {'radius': 0.01}})


def test_currents_with_a_torque_constant_give_tensions(calm):
    spool = {'radius': 0.01, 'torque_constant': 0.5}
    amps = calm.copy()
    for name in [n for n in calm.columns if '[N]' in n]:
        amps[name] = calm[name] * 0.01 / 0.5 * 1e3
    amps = amps.rename(columns=lambda name: name.replace('T', 'I').replace('[N]', '[mA]'))
    data = import_table(amps, ARM, {'up': 'y', 'spool': spool}).dataset
    assert_allclose(data.inputs[1:], default_postures(ARM, 4), atol=1e-3)


def test_a_sequence_that_was_gone_through_twice_has_two_trials_of_each_posture():
    """Rest, one, rest, two, rest, three, once more, and rest."""
    frame = recorded(CALM, count=3, trials=2)
    data = import_table(frame, ARM, {'up': 'y', 'path': 'sequence'}).dataset
    assert (data.path, data.trials.tolist()) == ('sequence', [3, 2, 2, 2, 2, 2])
    once = frame[frame['time_s'] < 0.55 * frame['time_s'].iloc[-1]]
    assert import_table(once, ARM, {'up': 'y', 'path': 'sequence'}).dataset.trials.max() == 1


def test_it_is_said_where_the_way_to_a_posture_is_taken_not_to_matter(calm, walk):
    told = 'from where the arm came to a posture is taken not to matter'
    assert told not in calm_import().text()
    # rests that are too short to be measured are rests
    assert told not in import_table(calm, ARM, {'up': 'y', 'rest': 0.0}).text()
    assert told in import_table(walk[0], ARM, {'up': 'y'}).text()


@pytest.mark.parametrize('rows', [slice(1), slice(9)])
def test_rows_at_one_time_are_no_duration_that_could_be_shorter(calm, rows):
    with pytest.raises(DataSetError, match=r'lasts 0 s, .*; let the arm rest longer'):
        import_table(calm[rows].assign(time_s=0.0), ARM, {'up': 'y'})


def test_one_table_has_one_clock(calm):
    with pytest.raises(DataSetError, match='has one clock for inputs and markers; leave out the'):
        import_table(calm, ARM, {'up': 'y', 'delay': 0.5})


def test_rows_that_were_taken_after_the_arm_had_settled_are_each_a_measurement(walk, tmp_path):
    """Too far apart to show stillness; said, and asked for with `--column time=none`."""
    (frame, places), path = walk, tmp_path / 'rows.csv'
    settled = frame.iloc[::48].assign(time_s=lambda rows: 0.6 * np.arange(len(rows)))
    guess = {'up': 'y', 'path': 'sequence', 'frame': {'method': 'model'}}
    with pytest.raises(DataSetError, match=r'0.6 s apart, .*say --column time=none'):
        import_table(settled, ARM, guess)
    seldom = settled.assign(time=lambda rows: 2.3 * np.arange(len(rows))).drop(columns='time_s')
    with pytest.raises(DataSetError, match=r'2.3 s apart, .*say --column time=none'):
        import_table(seldom, ARM, guess)  # milliseconds would be over at once
    imported = import_table(settled, ARM, guess | {'time': {}})
    assert imported.dataset.trials.sum() == len(settled) == len(places)
    assert 'time=none' not in imported.text()
    settled.to_csv(path, index=False)
    import_table(path, ARM, guess | {'time': {}}).save(tmp_path / 'set')
    again = import_table((), None, tmp_path / 'set' / 'import.yaml')
    assert_allclose(again.dataset.inputs, imported.dataset.inputs)


def test_a_column_of_times_in_import_yaml_has_a_unit(tmp_path):
    (tmp_path / 'import.yaml').write_text('time: {1: {a: 2}}')
    with pytest.raises(DataSetError, match=r'import\.yaml: time\.1: got .* expected a text'):
        load_recipe(tmp_path / 'import.yaml')


@pytest.mark.parametrize('rows', [slice(1, None), slice(None, -1)])
def test_tables_without_times_that_differ_in_length_are_refused(walk, rows):
    frame = walk[0].iloc[::48].drop(columns='time_s')
    places = [name for name in frame.columns if '[mm]' in name]
    tables = frame.drop(columns=places), frame[places]
    for one, other in ((tables[0][rows], tables[1]), (tables[0], tables[1][rows])):
        with pytest.raises(DataSetError, match=r'rows, and DataFrame with the inputs .* belong'):
            import_table([one, other], ARM, {'up': 'y'})


def walked(seed=4, drift=0.0, **hidden):
    """
    Return a table of an arm that goes from posture to posture in any order, and its visits.

    Inputs are off by a share that the posture before decides, as motors with friction leave them.
    """
    plant = make_plant(ARM, hidden, seed=3, work=EXACT)
    postures = default_postures(ARM, 4)
    truth = simulate(plant, postures, noise=QUIET, trials=5, seed=seed, markers=PLACES,
                     path='visits')  # fmt: skip
    turn, shift = tracker_frame(ARM.gravity, CALM)
    visits, places, rows = truth.visits, [], []
    for v, (p, q) in enumerate(zip(visits.rows, visits.trials, strict=True)):
        if v and visits.commands[p] == visits.commands[visits.rows[v - 1]]:
            continue  # nothing moves
        places.append((visits.commands[p], truth.positions[p, q]))
        here, places_here = truth.inputs_by_trial[p, q], truth.positions[p, q]
        if drift and v:
            here = here * (1.0 + drift * (-1.0) ** visits.rows[v - 1])
            places_here = (
                Model(ARM)
                .shapes(here[None])
                .markers([marker.arc_length for marker in PLACES], np.zeros((len(PLACES), 3)))[0]
            )
        seen = 1e3 * (places_here @ turn.T + shift)
        rows.append(np.append(here, seen.ravel()))
    hold, share = np.ones((32, 1)), 0.5 - 0.5 * np.cos(np.pi * np.arange(1, 17) / 17.0)
    table = [hold * rows[0]]
    for here, there in pairwise(rows):
        table += [here + share[:, None] * (there - here), hold * there]
    values = np.concatenate(table)
    names = ['time_s', *(f'T{i + 1} [N]' for i in range(3))]
    names += [f'm{j + 1}_{axis} [mm]' for j in range(len(PLACES)) for axis in 'xyz']
    times = np.arange(len(values)) / 20.0
    return pandas.DataFrame(np.column_stack([times, values]), columns=names), places


@pytest.fixture(scope='module')
def remembering():
    return walked(friction_memory={'presliding_length': 4e-4, 'exponent': 1.0})


def test_visits_in_any_order_come_out_of_a_table_as_they_were_made(remembering, tmp_path):
    frame, truth = remembering
    imported = import_table(frame, ARM, {'up': 'y', 'path': 'visits'})
    data, visits = imported.dataset, imported.dataset.visits
    assert data.path == 'visits' and 'without letting go' in imported.text()
    assert visits.fresh.tolist() == [True] + [False] * (len(truth) - 1)
    names = {command: visits.commands[visits.rows[v]] for v, (command, _) in enumerate(truth)}
    assert [visits.commands[row] for row in visits.rows] == [names[c] for c, _ in truth]
    seen = data.positions[visits.rows, visits.trials]
    true = np.array([places for _, places in truth])
    turn, shift = rigid_fit(seen.reshape(-1, 3), true.reshape(-1, 3))
    assert_allclose(seen @ turn.T + shift, true, atol=2e-5)
    again = load_dataset(imported.save(tmp_path / 'visits'))
    assert again.postures == data.postures
    assert again.visits.rows.tolist() == visits.rows.tolist()
    assert load_recipe(tmp_path / 'visits' / 'import.yaml').path == 'visits'


def test_trials_that_differ_by_the_way_ask_for_visits_and_others_do_not(remembering):
    look = '\n'.join(import_table(remembering[0], ARM, {'up': 'y'}).look)
    assert 'apart where the arm came from different ones' in look and '--path visits' in look
    assert not any('different ones' in line for line in calm_import().look)


def test_trials_that_differ_by_their_inputs_do_not_ask_for_visits():
    imported = import_table(walked(drift=0.01)[0], ARM, {'up': 'y', 'same': 0.2})
    assert imported.dataset.trial_inputs is not None
    assert not any('different ones' in line for line in imported.look)


def test_markers_that_exchange_their_columns_are_put_back_and_said(noisy):
    reference = noisy_import()
    mixed, half = noisy.copy(), len(noisy) // 2
    for axis in 'xyz':
        one, other = (f'marker_{n}_{axis} [mm]' for n in ('03', '04'))
        mixed.loc[mixed.index[half:], [one, other]] = noisy.loc[
            noisy.index[half:], [other, one]
        ].to_numpy()
    imported = import_table(mixed, ARM, {'up': 'y'})
    assert any('marker 03 and marker 04 exchange their names at' in line for line in imported.look)
    assert_allclose(imported.dataset.mean, reference.dataset.mean, atol=1e-9)


def test_a_marker_that_is_numbered_anew_is_followed(noisy, tmp_path):
    reference = noisy_import()
    mixed = noisy.copy()
    half = len(mixed) // 2
    for axis in 'xyz':
        old, new = f'marker_03_{axis} [mm]', f'Unlabeled 1207_{axis} [mm]'
        mixed[new] = np.nan
        mixed.loc[mixed.index[half:], new] = mixed.loc[mixed.index[half:], old]
        mixed.loc[mixed.index[half - 2 :], old] = np.nan
    mixed.to_csv(tmp_path / 'raw.csv', index=False)
    imported = import_table(tmp_path / 'raw.csv', ARM, {'up': 'y'})
    assert any('Unlabeled 1207 is marker 03, numbered anew' in line for line in imported.assumed)
    assert_allclose(imported.dataset.mean, reference.dataset.mean, atol=2e-5)
    folder = imported.save(tmp_path / 'data')
    again = import_table((), None, folder / 'import.yaml')
    assert_allclose(again.dataset.positions, imported.dataset.positions, atol=1e-12)


@pytest.mark.parametrize(
    ('column', 'seen', 'hidden'),
    [
        ('marker_03_visible', 1, 0),
        ('marker 03 occluded', 'False', 'True'),
        ('marker_03 State', 'OK', 'Missing'),
        ('valid marker_03', 'yes', 'no'),
    ],
)
def test_a_column_that_says_what_was_seen_counts(noisy, column, seen, hidden):
    told = noisy.copy()
    away = (told['time_s'] > 8.0) & (told['time_s'] < 14.0)
    told.loc[away, [f'marker_03_{axis} [mm]' for axis in 'xyz']] += [50.0, 20.0, -30.0]
    told[column] = np.where(away, hidden, seen)
    imported = import_table(told, ARM, {'up': 'y'})
    assert any(f'the column {column} says so' in line for line in imported.dropped)
    assert not any('columns: ' in line for line in imported.dropped)
    assert np.abs(imported.dataset.mean - noisy_import().dataset.mean).max() < 1e-3


def test_the_way_is_said_and_a_sequence_of_an_arm_that_was_let_go_is_contradicted(noisy):
    text = noisy_import().text()
    assert 'every posture was loaded from the straight arm (path: from_straight); if' in text
    assert 'LOOK     before' not in text
    wrong = import_table(noisy, ARM, {'up': 'y', 'path': 'sequence'})
    said = r'before (\d+) of \1 loaded postures all inputs were let go \(below 0.1\d* N\)'
    assert any(re.match(said, line) for line in wrong.look)


def test_a_slipped_trial_is_named_and_left_out(noisy):
    imported = noisy_import()
    ((posture, trial),) = imported.recipe.leave_out
    line = f'posture {posture} trial {trial}: the other trials contradict (a slipped tendon?)'
    assert line in imported.dropped
    p, q = imported.dataset.postures.index(posture), imported.dataset.trial_names.index(trial)
    assert not imported.dataset.trial_mask[p, q]
    kept = import_table(noisy, ARM, replace(imported.recipe, leave_out=()))
    away = kept.dataset.positions[p, :, -1] - np.nanmedian(kept.dataset.positions[p, :, -1], 0)
    assert np.linalg.norm(away, axis=1).argmax() == q


def test_postures_and_trials_that_a_recipe_leaves_out_are_not_there(calm, tmp_path):
    every = calm_import()
    left = import_table(calm, ARM, {'up': 'y', 'leave_out': [['1', '0']]})
    assert left.dropped == (*every.dropped, 'posture 1 trial 0: left out, as leave_out says')
    others = [i for i, name in enumerate(every.dataset.postures) if name != '1']
    assert len(left.predicted) == len(others)
    saved = load_dataset(left.save(tmp_path / 'set'))
    assert_allclose(saved.inputs, every.dataset.inputs[others])
    again = import_table(calm, ARM, tmp_path / 'set' / 'import.yaml')
    assert_allclose(again.dataset.positions, left.dataset.positions)
    names = [[posture, '0'] for posture in every.dataset.postures]
    with pytest.raises(DataSetError, match='leave_out: leaves no trial'):
        import_table(calm, ARM, {'up': 'y', 'leave_out': names})


def test_gaps_rest_and_jumps_are_told(noisy):
    jumping = noisy.copy()
    column = next(name for name in noisy.columns if name.endswith('_x [mm]'))
    still = noisy.index[(noisy['time_s'] > 2.5) & (noisy['time_s'] < 3.2)][::6]
    jumping.loc[still, column] += 40.0
    reference = noisy_import()
    imported = import_table(jumping, ARM, {'up': 'y'})
    told = ' | '.join(imported.dropped)
    assert 'still segments at rest between the others' in told
    assert f'{len(still)} frames in which a marker jumps (marker 01 {len(still)})' in told
    drawn = [line for line in imported.plot().axes[1].lines if line.get_marker() == 'x']
    assert len(drawn) == 1  # what was cut out is seen where it was read
    assert_allclose(np.sort(drawn[0].get_xdata()), noisy['time_s'][still], atol=1e-9)
    assert '% of the marker readings are missing' in told
    difference = imported.dataset.mean - reference.dataset.mean
    assert np.abs(difference).max() < 2e-4
    assert 'below' in ' '.join(imported.assumed)


@pytest.mark.slow  # docs/from_mocap_to_verdict.md goes the same way, to a load within its interval
def test_what_was_hidden_is_found_through_the_table():
    imported = noisy_import()
    assert imported.frame.residual > 5e-3  # the model lacks the load, the frame is off by it
    found = diagnose(imported.dataset)
    assert [effect.name for effect in found.effects] == ['tip_load']
    force = found.effects[0].parameters['force_x']
    assert force.low < -0.05 < force.high


def test_importing_again_from_the_yaml_gives_the_same_data_set(noisy, tmp_path, capsys):
    write_table(tmp_path / 'raw.csv', list(noisy.columns), noisy.to_numpy())
    (tmp_path / 'arm.yaml').write_text(dump_robot(ARM))
    call = ['import', 'table', '--output', str(tmp_path / 'one'), '--up', 'y']
    call += [str(tmp_path / 'raw.csv'), '--robot', str(tmp_path / 'arm.yaml')]
    assert main(call) == 0
    printed = capsys.readouterr().out
    again = ['import', 'table', '--recipe', str(tmp_path / 'one/import.yaml')]
    assert main([*again, '--output', str(tmp_path / 'two')]) == 0
    names = sorted(path.name for path in (tmp_path / 'one').iterdir())
    assert names == [
        'dataset.yaml', 'import.png', 'import.yaml', 'inputs.csv', 'robot.yaml', 'shapes.csv'
    ]  # fmt: skip
    for name in names:
        one, two = (tmp_path / folder / name for folder in ('one', 'two'))
        assert one.read_bytes() == two.read_bytes(), name
    for line in ('T1 [N]', 'input one', 'taken    6 postures', 'known to'):
        assert line in printed
    assert load_dataset(tmp_path / 'one').robot.tolerances['rotation'] == pytest.approx(0.035)
    assert main([*call, '--overwrite', '--frame', 'base']) == 0  # 200 mm off is not the base
    assert 'free to turn, the frame would fit to' in capsys.readouterr().out
    assert main([*call, '--overwrite', '--markers', '30,6cm,0.09m']) == 1
    assert 'has 4 markers, but 3 places on the arm are given' in capsys.readouterr().err


def test_an_export_of_optitrack_says_itself_where_up_is(calm, tmp_path):
    """A file of tensions beside the export of Motive: header rows, metres, frames, y up."""
    places = [name for name in calm.columns if '[mm]' in name]
    labels = [name.rpartition('_')[0].replace('_', ' ') for name in places]
    rows = [
        ['Format Version', '1.23', 'Length Units', 'Meters'],
        ['', 'Type', *['Marker'] * len(places)],
        ['', 'Name', *labels],
        ['', 'ID', *labels],
        ['', '', *['Position'] * len(places)],
        ['Frame', 'Time (Seconds)', *(name[-6].upper() for name in places)],
    ]
    values = (1e-3 * calm[places]).round(6).to_numpy().tolist()
    rows += [[i, t, *row] for i, (t, row) in enumerate(zip(calm['time_s'], values, strict=True))]
    with (tmp_path / 'take.csv').open('w', newline='') as file:
        csv.writer(file).writerows(rows)
    calm[[name for name in calm.columns if name not in places]].to_csv(
        tmp_path / 'cells.csv', index=False
    )
    told = import_table([tmp_path / 'cells.csv', tmp_path / 'take.csv'], ARM, {'delay': 0.0})
    assert (told.recipe.up, told.frame.method) == ('y', 'level')
    same = calm_import().dataset
    assert_allclose(told.dataset.mean, same.mean, atol=1e-5)


def test_two_tables_of_one_recording_are_joined_on_time(calm):
    tensions = calm[[name for name in calm.columns if '[mm]' not in name]][::2]
    markers = calm[[name for name in calm.columns if '[N]' not in name]]
    reference = calm_import().dataset
    joined = import_table([tensions, markers], ARM, {'up': 'y'}).dataset
    assert_allclose(joined.mean, reference.mean, atol=2e-4)
    assert_allclose(joined.inputs, reference.inputs, atol=2e-3)
    with pytest.raises(DataSetError, match='2 tables hold inputs and 1 markers'):
        import_table([tensions, tensions, markers], ARM)


def test_nothing_is_measured_where_the_inputs_have_ended(calm):
    """Nor before they begin."""
    places = [name for name in calm.columns if '[mm]' in name]
    inputs, markers = calm.drop(columns=places), calm[['time_s', *places]]
    whole = calm_import().dataset
    for rows, delay in ((inputs['time_s'] < 12.5, 0.0), (inputs['time_s'] > 9.0, -9.05)):
        part = import_table([inputs[rows], markers], ARM, {'up': 'y', 'delay': delay})
        assert part.frame.residual < 3e-4
        told = 'marker readings are none: the inputs end before'
        assert any(line.endswith(told) for line in part.dropped) == (delay == 0.0)
        for tension, place in zip(part.dataset.inputs, part.dataset.mean, strict=True):
            same = np.abs(whole.inputs - tension).max(axis=1).argmin()
            assert_allclose(place, whole.mean[same], atol=5e-4)
    with pytest.raises(DataSetError, match='begins after DataFrame with the inputs has ended'):
        import_table([inputs, markers], ARM, {'up': 'y', 'delay': 1000.0})


@pytest.mark.parametrize('delay', [-12.4, 0.0, 0.37])
def test_the_delay_of_a_clock_of_its_own_is_found_said_and_written(noisy, delay):
    tensions = noisy[[name for name in noisy.columns if '[mm]' not in name]]
    markers = noisy[[name for name in noisy.columns if '[N]' not in name]]
    markers = markers[max(0, round(25 * delay)) :]  # the tracker was started later
    tensions = tensions[max(0, round(-25 * delay)) :]
    found = import_table([tensions, markers], ARM, {'up': 'y'})
    assert found.recipe.delay == (pytest.approx(delay, abs=0.02),)
    way = 'before' if delay < 0.0 else 'after'
    assert f's {way} that of the inputs: then' in found.text()
    given = import_table([tensions, markers], ARM, {'up': 'y', 'delay': delay})
    assert given.recipe.delay == (delay,)
    assert_allclose(found.dataset.mean, given.dataset.mean, atol=2e-4)


@pytest.fixture(scope='module')
def later(noisy):
    """Return tensions, markers of a tracker that was started 2 s later, and their import."""
    tensions = noisy[[name for name in noisy.columns if '[mm]' not in name]]
    markers = noisy[[name for name in noisy.columns if '[N]' not in name]][50:]
    return tensions, markers, import_table([tensions, markers], ARM, {'up': 'y', 'delay': 2.0})


@pytest.mark.parametrize('drift', [0.0, 0.006, -0.009])
def test_a_clock_that_is_fast_or_slow_is_found_said_and_written(later, tmp_path, drift):
    tensions, markers, known = later
    markers = markers.copy()
    time = markers.columns[0]
    near = 0.05 / (markers[time].iloc[-1] - markers[time].iloc[0])  # 0.05 s at the end
    markers[time] = 7.0 + (markers[time] - markers[time].iloc[0]) / (1.0 + drift)
    found = import_table([tensions, markers], ARM, {'up': 'y'})
    assert found.recipe.delay == (pytest.approx(2.0, abs=0.03),)
    assert found.recipe.drift == ((pytest.approx(drift, abs=near),) if drift else None)
    assert ('and its clock is' in found.text()) == bool(drift)
    assert_allclose(found.dataset.mean, known.dataset.mean, atol=3e-4)
    (tmp_path / 'import.yaml').write_text(dump_recipe(found.recipe, tmp_path))
    assert load_recipe(tmp_path / 'import.yaml').drift == found.recipe.drift


def test_clocks_that_nothing_tells_apart_are_said_and_not_guessed(noisy):
    """A tracker that was started a round and more later: every round is like the one before."""
    tensions = noisy[[name for name in noisy.columns if '[mm]' not in name]]
    markers = noisy[[name for name in noisy.columns if '[N]' not in name]][25 * 31 :]
    found = import_table([tensions, markers], ARM, {'up': 'y'})
    text = found.text()
    assert 'does not tell by how much one begins later' in text and 'say --delay' in text
    assert found.recipe.delay == (0.0,)
    with pytest.raises(DataSetError, match='2 delays are given for 1 recordings'):
        import_table([tensions, markers], ARM, {'up': 'y', 'delay': [0.0, 1.0]})


def test_recordings_one_after_the_other_are_trials_of_the_same_postures(calm):
    data = import_table([calm, calm], ARM, {'up': 'y'}).dataset
    assert data.postures == tuple('01234')
    assert data.trials.tolist() == [1, 2, 2, 2, 2]
