"""The command `compare`: what it prints, its JSON, and how models are named."""

import json
from dataclasses import replace

import numpy as np
import pytest
from measurements import blind
from source_tree import ROOT

from tendon_robot_ros.cli.main import main
from tendon_robot_ros.common.words import mm
from tendon_robot_ros.comparison.compare import compare
from tendon_robot_ros.comparison.result import from_json, load_comparison, to_json
from tendon_robot_ros.data import load_dataset, save_dataset
from tendon_robot_ros.report.comparison import kind, verdict


@pytest.fixture(scope='module')
def hinges():
    return load_dataset(blind('b') / 'fit')


def test_the_json_reads_back_and_has_the_promised_keys(hinges, tmp_path, capsys):
    out = tmp_path / 'compare.json'
    assert main(['compare', str(blind('b') / 'fit'), '--pcca', '--json', str(out)]) == 0
    assert 'rms' in capsys.readouterr().out
    content = json.loads(out.read_text())
    assert content['format'] == 'tendon_robot_ros/comparison@1'
    model = content['models'][0]
    assert {'name', 'rms', 'tip_error', 'max', 'per_marker_rms', 'per_posture'} <= set(model)
    assert [m['name'] for m in content['models']] == ['planar1', 'PCCA']
    assert len(model['per_posture']) == 12
    assert len(model['per_marker_rms']) == 15
    assert content['paired_t'][0]['p'] < 0.01
    back = load_comparison(out)
    assert back.noise_floor == pytest.approx(content['noise_floor'])
    assert json.dumps(to_json(from_json(content)))[:2000] == json.dumps(to_json(back))[:2000]
    direct = compare(hinges).models[0]
    np.testing.assert_allclose(back.models[0].distance, direct.distance, atol=1e-15)
    assert main(['compare', str(blind('b') / 'fit'), '--json']) == 0
    assert json.loads(capsys.readouterr().out)['noise_floor'] == pytest.approx(back.noise_floor)


def test_a_known_error_of_the_model_is_read_back(hinges):
    off = compare(hinges).models[0].rms
    found = compare(hinges, replace(hinges.robot, model_error=2.0 * off))
    back = from_json(json.loads(json.dumps(to_json(found))))
    assert back.models[0].model_error == found.models[0].model_error
    assert verdict(back) == verdict(found)
    assert verdict(back).endswith('as far off as its description says (model_error).')


def test_the_table_says_where_and_what_to_do(capsys):
    folder = blind('b') / 'fit'
    assert main(['compare', str(folder), '--pcca']) == 0
    lines = capsys.readouterr().out.splitlines()
    assert ' '.join(lines[0].split()[:9]) == '12 postures x 5 trials x 15 markers rms'
    assert lines[1].startswith('planar1 (FKM + 3 effects)')
    assert lines[2].startswith('PCCA  ')
    assert lines[4].startswith(
        'worst of planar1: posture 10 (left 2.34 N, right 2.13 N), rms 4.64 mm; '
    )
    assert lines[4].endswith('the error grows from cell 3 on.')
    assert 'planar1 23.7 mm less than PCCA (95 %: ' in lines[5]
    assert lines[-1] == (
        'The best model, planar1, is off by eleven times your repeatability. '
        f'Ask why: python -m tendon_robot_ros diagnose {folder}'
    )


def test_robots_of_one_name_are_named_by_their_files(tmp_path, capsys):
    robot = (blind('b') / 'fit' / 'robot.yaml').read_text()
    for name in ('before', 'after'):
        (tmp_path / f'{name}.yaml').write_text(robot)
    models = [str(tmp_path / 'before.yaml'), str(tmp_path / 'after.yaml')]
    assert main(['compare', str(blind('b') / 'fit'), '--model', *models]) == 0
    out = capsys.readouterr().out
    assert 'before (FKM' in out
    assert 'do not differ (paired t over 12 postures, p = 1' in out
    assert 'The best model by rms, before, is off by' in out
    assert main(['compare', str(blind('b') / 'fit'), '--model', models[0], models[0]]) == 1
    assert 'expected different files' in capsys.readouterr().err


def test_a_model_with_friction_is_called_fkm_whatever_else_it_has():
    assert [kind(effects) for effects in ((), ('gravity',), ('tendon_friction',))] == [
        'PCCA', 'PCCA + gravity', 'FKM'
    ]  # fmt: skip
    assert kind(('gravity', 'tendon_friction')) == 'FKM + gravity'
    assert kind(('gravity', 'tendon_friction', 'torsion')) == 'FKM + 2 effects'


@pytest.mark.parametrize('name', ['messy_002', 'messy_s0'])
def test_readings_that_other_trials_contradict_are_named_and_left_out(name, tmp_path, capsys):
    folder = ROOT / 'test' / 'data' / 'as_built' / name / 'fit'
    assert main(['compare', str(folder), '--report', str(tmp_path / 'page.html')]) == 0
    lines = capsys.readouterr().out.splitlines()
    direct = compare(folder)
    assert direct.measured.left_out and 'left out, because other trials contradict' in repr(direct)
    again = from_json(json.loads(json.dumps(to_json(direct))))
    assert again.text() == direct.text()
    start = next(i for i, line in enumerate(lines) if line.startswith('noise floor'))
    assert lines[start].split()[-2:] == mm(direct.noise_floor).split()
    assert mm(direct.best.rms) in lines[start - 1]
    assert lines[start + 1].startswith('left out')
    assert lines[start + 1][1:] in (tmp_path / 'page.html').read_text(encoding='utf-8')


@pytest.mark.parametrize(
    ('noise', 'said'),
    [
        (2e-4, 'The model is as good as your measurements can tell'),
        (8e-3, 'Nothing can be judged: the noise floor is '),
    ],
)
def test_a_floor_that_is_a_large_share_of_the_motion_judges_nothing(noise, said, hinges):
    exact = compare(hinges).models[0].markers[:, None]
    places = exact + np.random.default_rng(1).normal(0.0, noise, hinges.positions.shape)
    last = compare(replace(hinges, positions=places)).text().splitlines()[-1]
    assert last.startswith(said)
    assert 'diagnose' not in last


def test_a_trial_that_went_elsewhere_does_not_make_the_floor_that_judges(hinges, tmp_path, capsys):
    """It makes a floor of many times the noise, with which a wrong model would pass."""
    places = hinges.positions.copy()
    places[3, 1] = places[8, 1]
    data = replace(hinges, positions=places)
    save_dataset(data, tmp_path / 'data')
    assert main(['compare', str(tmp_path / 'data')]) == 0
    out = capsys.readouterr().out
    assert f'trial 1 of posture {data.postures[3]}' in out
    assert 'The model is off by' in out
    raw = compare(data, leave_out=False)
    assert raw.best.rms < 1.3 * raw.noise_floor, 'with that trial nothing would be told'
    found = compare(data)
    assert found.measured.left_out == (
        {'posture': data.postures[3], 'trial': '1', 'marker': None},
    )
    floor = compare(hinges).noise_floor
    assert found.noise_floor == pytest.approx(floor, rel=0.05), 'of the other trials'


def test_nothing_is_said_of_readings_where_none_is_left_out(capsys):
    assert main(['compare', str(blind('b') / 'fit')]) == 0
    out = capsys.readouterr().out
    assert 'left out' not in out
    assert '\nworst: posture 10' in out, 'of one model it is clear whose posture that is'
