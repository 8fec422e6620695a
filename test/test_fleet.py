"""Fleets: recordings and data sets of robots over time, and what changed when."""

import json
import os
from dataclasses import replace

import numpy as np
import pytest
import simulated

from tendon_robot_ros.cli.main import main
from tendon_robot_ros.data import save_dataset
from tendon_robot_ros.diagnosis.verdict import Verdict
from tendon_robot_ros.studies import fleet
from tendon_robot_ros.studies.fleet import (
    Fleet,
    FleetCase,
    FleetRow,
    changes,
    datasets_below,
    fleet_page,
    fleet_rows,
    map_parameters,
    when_of,
)

pytest.importorskip('pyarrow')
ROBOT = replace(simulated.robot(), exact=True)


def row(when='2026-01-01', lever=1.0, before=1e-3, **others):
    content = {
        'key': when, 'place': when, 'robot': 'arm', 'description': 'a', 'when': when,
        'dated_by': 'name', 'postures': 5, 'trials': 3, 'markers': 4,
        'verdict': Verdict.MISSING_EFFECT, 'effects': ('hinge_friction',), 'before': before,
        'parameter': ('hinge_friction lever',), 'unit': ('m',), 'value': (lever,),
        'low': (lever - 0.1,), 'high': (lever + 0.1,),
    }  # fmt: skip
    return FleetRow(**content | others)


def command(folder):
    told = ['--output', str(folder / 'out'), '--workers', '1']
    return ['study', 'fleet', str(folder / 'in'), *told]


def texts(*rows):
    return [change['text'] for change in changes(rows)]


def test_what_stays_within_its_intervals_is_no_change():
    assert texts(row(), row('2026-02-01', lever=1.15, before=1.4e-3)) == []


def test_what_leaves_its_intervals_is_said_with_both_values():
    (text,) = texts(row('2026-02-01', lever=1.5), row())
    assert text == ('hinge_friction lever: 1.0 (0.90 to 1.1) before, now 1.5 (1.4 to 1.6) m'), (
        'in the order of time'
    )


def test_another_verdict_description_and_error_are_said():
    quiet = row(verdict=Verdict.ADEQUATE, effects=(), description='b', before=3e-4)
    assert texts(quiet, row('2026-02-01')) == [
        'another description',
        'adequate before, now missing effect: hinge_friction',
        'the error of the description went from 0.300 mm to 1.00 mm',
    ]


def test_robots_are_not_mixed():
    assert texts(row(), row('2026-02-01', robot='other', verdict=Verdict.ADEQUATE)) == []


def test_when_something_was_measured(tmp_path):
    named = tmp_path / 'arm_20260314_a'
    named.mkdir()
    assert when_of(named) == ('2026-03-14', 'name')
    other = tmp_path / 'arm_20269914'  # no date
    other.mkdir()
    (other / 'metadata.yaml').write_text(
        'rosbag2_bagfile_information: {starting_time: {nanoseconds_since_epoch: 86400000000000}}'
    )
    assert when_of(other) == ('1970-01-02T00:00+00:00', 'recording')
    (other / 'metadata.yaml').write_text('[]')
    os.utime(other / 'metadata.yaml', (60.0, 60.0))
    assert when_of(other) == ('1970-01-01T00:01+00:00', 'file')


def test_a_folder_above_all_measurements_dates_none(tmp_path):
    folder = tmp_path / 'saved_20240131' / 'in'
    bag = folder / 'bag'
    bag.mkdir(parents=True)
    (bag / 'metadata.yaml').write_text(
        'rosbag2_bagfile_information: {starting_time: {nanoseconds_since_epoch: 86400000000000}}'
    )
    row = Fleet(question='fleet').refused(FleetCase.of(bag, folder), '')
    assert (row.when, row.dated_by) == ('1970-01-02T00:00+00:00', 'recording')


def test_another_effect_or_description_elsewhere_is_another_case(tmp_path):
    place = tmp_path / 'in' / 'run'
    save_dataset(simulated.measured(ROBOT, count=3, trials=2), place)
    before = FleetCase.of(place, tmp_path)
    assert FleetCase.of(place, tmp_path, {'catalogue': 'mine'}).key != before.key
    (place / 'robot.yaml').rename(tmp_path / 'arm.yaml')
    content = (place / 'dataset.yaml').read_text()
    (place / 'dataset.yaml').write_text(content.replace('robot.yaml', '../../arm.yaml'))
    before = FleetCase.of(place, tmp_path)
    assert FleetCase.of(place, tmp_path) == before
    os.utime(tmp_path / 'arm.yaml', (60.0, 60.0))
    assert FleetCase.of(place, tmp_path).key != before.key


def test_the_command_diagnoses_what_is_new_and_names_what_cannot_be_read(tmp_path, capsys):
    pytest.importorskip('plotly')
    sets = {'2026-01-10': {}, '2026-05-20': {'hinge_friction': {'lever': 3e-4}}}
    for name, hidden in sets.items():
        save_dataset(simulated.measured(ROBOT, hidden, count=5, trials=3), tmp_path / 'in' / name)
    (tmp_path / 'in' / 'broken').mkdir()
    (tmp_path / 'in' / 'broken' / 'dataset.yaml').write_text('robot: none.yaml\n')
    call = command(tmp_path)
    assert main(call) == 0
    printed = capsys.readouterr().out
    assert '2026-05-20 (since 2026-01-10): adequate before, now missing effect: hinge_f' in printed
    assert 'left out: broken: ' in printed
    assert 'Errors over time' in (tmp_path / 'out' / 'fleet.html').read_text()
    table = sorted((tmp_path / 'out' / 'table').iterdir())
    assert main([*call, '--json', str(tmp_path / 'fleet.json')]) == 0
    assert sorted((tmp_path / 'out' / 'table').iterdir()) == table, 'nothing was new'
    assert len(json.loads((tmp_path / 'fleet.json').read_text())['changes']) >= 2


def test_a_measurement_at_which_the_program_fails_is_named_and_the_others_go_on(
    tmp_path, capsys, monkeypatch
):
    pytest.importorskip('plotly')
    for name in ('2026-01-10', '2026-05-20'):
        save_dataset(simulated.measured(ROBOT, {}, count=4, trials=3), tmp_path / 'in' / name)
    asked, real = [], fleet.diagnose

    def first_fails(*arguments, **options):
        asked.append(1)
        if len(asked) == 1:
            raise IndexError('a mistake of this program')
        return real(*arguments, **options)

    monkeypatch.setattr(fleet, 'diagnose', first_fails)
    call = command(tmp_path)
    assert main(call) == 0
    told = capsys.readouterr().out
    assert 'left out: 2026-01-10: IndexError: a mistake of this program' in told
    assert len(asked) == 2
    monkeypatch.setattr(fleet, 'versions', lambda effects: {'numpy': '1.0'})
    assert main(call) == 0
    assert 'left out' not in capsys.readouterr().out
    assert len(asked) == 4, 'rows of other versions do not count'


def test_an_interval_without_an_end_is_drawn_and_said():
    rows = [row(high=(np.inf,)), row('2026-02-01', lever=0.5, high=(0.6,))]
    bars = map_parameters(rows)[0].data[0]['error_y']['array']
    assert bars == [None, pytest.approx(0.1)]
    assert 'hinge_friction lever: 1.0 (0.90 to infinite) before, now 0.50' in texts(*rows)[0]
    assert fleet_page(rows, 'Fleet').html()


def test_a_folder_without_measurements_is_one_line(tmp_path, capsys):
    assert main(['study', 'fleet', str(tmp_path), '--output', str(tmp_path / 'out')]) == 1
    assert 'no data set (dataset.yaml) and no recording' in capsys.readouterr().err
    assert not (tmp_path / 'out').exists()
    with pytest.raises(Exception, match='is no folder'):
        datasets_below(tmp_path / 'none')


def test_the_page_has_units_that_suit_and_says_how_dates_are_known():
    rows = [row(lever=2e-4, low=(1e-4,), high=(3e-4,)),
            row('2026-02-01T08:00+00:00', lever=2.1e-4, low=(1e-4,), high=(3e-4,),
                dated_by='file')]  # fmt: skip
    (figure,) = map_parameters(rows)
    assert figure.layout['yaxis']['title']['text'] == '[mm]'
    np.testing.assert_allclose(figure.data[0]['y'], [0.2, 0.21])
    np.testing.assert_allclose(figure.data[0]['error_y']['array'], [0.1, 0.09])
    assert [cells[1] for cells in fleet_rows(rows)[1:]] == [
        '2026-01-01',
        '2026-02-01 08:00 (its files)',
    ]
    assert '2 recordings of 1 robot<' in fleet_page(rows, 'Fleet').html()
