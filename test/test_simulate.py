"""Simulated measurements: the noise that was asked for, postures that exercise the robot."""

from dataclasses import fields, replace

import numpy as np
import pytest
from arms import planar
from source_tree import ROOT

from tendon_robot_ros.cli.main import main
from tendon_robot_ros.common.errors import InputError
from tendon_robot_ros.data import Marker, load_dataset
from tendon_robot_ros.data.dataset import INPUTS, PATHS
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.monitoring.built_arm import usual_kinks
from tendon_robot_ros.robot import load_robot
from tendon_robot_ros.robot.estimates import handling
from tendon_robot_ros.simulation.hidden import Built, Workmanship
from tendon_robot_ros.simulation.measurements import SimulatedNoise, simulate
from tendon_robot_ros.simulation.plant import make_plant
from tendon_robot_ros.workspace.postures import SECTION_BEND_MAX_RAD, default_postures

ROBOTS = sorted((ROOT / 'config' / 'robots').glob('*.yaml'))
KATO = ROOT / 'config' / 'robots' / 'kato_10_1.yaml'
QUIET = SimulatedNoise(position=0.0, setting=0.0, trial=0.0)


@pytest.fixture(scope='module')
def plant():
    return make_plant(load_robot(KATO), scatter=0.0)


@pytest.mark.parametrize('path', ROBOTS, ids=lambda path: path.stem)
def test_default_postures_are_within_the_limits_and_bend_every_section(path):
    robot = load_robot(path)
    tensions = default_postures(robot)
    assert tensions.shape == (12, len(robot.inputs))
    low, high = robot.tension_limits
    assert ((tensions >= low) & (tensions <= high)).all()
    assert len(np.unique(tensions, axis=0)) == 12
    assert ((tensions > low).sum(axis=0) >= 2).all(), 'an input is hardly used'
    bend = Model(replace(robot, effects={})).shapes(tensions).bend
    edges = np.cumsum([section.cells for section in robot.sections])[:-1]
    last = np.linalg.norm(np.split(bend, edges, axis=1)[-1].sum(axis=1), axis=1)
    assert last.max() < 1.3 * SECTION_BEND_MAX_RAD
    assert np.ptp(last) > 0.5 * SECTION_BEND_MAX_RAD


@pytest.mark.parametrize('input', INPUTS)
def test_every_posture_of_an_arm_with_one_tendon_pulls_it_otherwise(input):
    arm = planar()
    tensions = default_postures(replace(arm, tendons=arm.tendons[1:]), 12, 1, input)
    assert (tensions > 0.0).all()
    assert len(np.unique(tensions)) == 12


def test_postures_stay_within_limits_of_more_digits_than_they_have():
    robot = replace(planar(), tension_limits=(0.03333333, 0.77777777))
    tensions = default_postures(robot)
    assert (tensions.min(), tensions.max()) == robot.tension_limits


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize('cells', [1, 4])
def test_a_group_whose_tendons_balance_squeezes_and_bends_to_no_side(cells):
    arm = planar(cells=cells)
    group = [replace(one, name=f'{one.name} too', group='both') for one in arm.tendons]
    robot = replace(arm, tendons=(*arm.tendons, *group))
    *single, both = default_postures(robot, 20)[3:].T
    assert np.array_equal(both, np.min(single, axis=0))
    assert usual_kinks(robot, 1.0)[2] == 0.0
    assert 'NOT PLAUSIBLE' not in '\n'.join(handling(robot))


def test_a_check_has_other_postures_and_a_sequence_lets_go():
    robot = load_robot(KATO)
    assert not np.isin(default_postures(robot, 6, 1), default_postures(robot)).all(axis=1).any()
    cycle = default_postures(robot, 20, path='sequence')
    steps = np.diff(cycle.max(axis=1))
    assert (steps > 0).any()
    assert (steps < 0).any()


@pytest.mark.parametrize('name', ['kato_10_1', 'spatial_6'])
def test_default_pulls_are_possible_together(name):
    robot = load_robot(ROOT / 'config' / 'robots' / f'{name}.yaml')
    pulls = default_postures(robot, 6, input='displacement')
    assert np.isnan(pulls).any(axis=1).all()
    assert np.isfinite(pulls).any(axis=1).all()
    data = simulate(make_plant(robot), pulls, noise=QUIET, trials=1, input='displacement')
    assert data.input == 'displacement'
    model = Model(robot)
    own = np.array([model.pull_shape(row).tip_position for row in pulls])
    assert np.linalg.norm(data.mean[:, -1] - own, axis=1).max() < 5e-3  # 2 % scatter


def test_markers_scatter_as_declared(plant):
    noise = SimulatedNoise(position=3e-4, setting=0.0, trial=0.0)
    data = simulate(plant, default_postures(plant.robot), noise=noise, trials=6, seed=5)
    spread = data.positions.std(axis=1, ddof=1)
    assert np.sqrt((spread**2).mean()) == pytest.approx(3e-4, rel=0.03)
    assert (data.position_noise, data.setting_noise, data.trial_noise) == (3e-4, 0.0, 0.0)


def test_setting_noise_is_shared_by_the_trials_and_trial_noise_is_not(plant):
    tensions = np.tile([[0.5, 0.1, 0.1, 0.1]], (300, 1))
    step = 1e-3 * np.array([[0.5, 0.0, 0.0, 0.0]])
    tip = np.array([plant.robot.length])
    slope = (
        plant.markers(tensions[:1] + step, tip, np.zeros((1, 3)))
        - plant.markers(tensions[:1] - step, tip, np.zeros((1, 3)))
    )[0, 0, 0] / 2e-3

    def tips(**noise):
        given = SimulatedNoise(**{'position': 0.0, 'setting': 0.0, 'trial': 0.0, **noise})
        data = simulate(plant, tensions, noise=given, trials=3, seed=1)
        return data.positions[:, :, -1, 0] / slope

    shared = tips(setting=0.01)
    np.testing.assert_allclose(shared, shared[:, :1] * np.ones(3), rtol=1e-9)
    assert shared[:, 0].std() == pytest.approx(0.01, rel=0.15)
    own = tips(trial=0.01)
    assert own.std(axis=1, ddof=1).mean() == pytest.approx(0.01 * 0.886, rel=0.15)
    assert abs(np.corrcoef(own[:, 0], own[:, 1])[0, 1]) < 0.2


def test_the_same_seed_gives_the_same_data_and_another_one_does_not(plant):
    tensions = default_postures(plant.robot, 2)
    one, same, other = (simulate(plant, tensions, seed=s).positions for s in (3, 3, 4))
    assert (one == same).all()
    assert not (one == other).any()


def test_a_sequence_is_replayed_in_order():
    robot = load_robot(KATO).with_effect('friction_memory', {'presliding_length': 1e-4})
    plant = make_plant(robot, scatter=0.0)
    cycle = [[1.0, 0.1, 0.1, 0.1], [0.4, 0.1, 0.1, 0.1]]
    data = simulate(plant, cycle, noise=QUIET, trials=2, path='sequence')
    expected = plant.shapes(cycle, sequence=True).positions
    np.testing.assert_allclose(data.positions, np.stack([expected] * 2, axis=1), atol=1e-12)
    straight = simulate(plant, cycle, noise=QUIET, trials=1).mean
    assert np.linalg.norm(straight[1, -1] - expected[1, -1]) > 1e-3


def test_markers_stand_where_they_are_put(plant):
    marker = Marker('clip', 0.1, (0.01, 0.0, 0.0))
    data = simulate(plant, [[0.0] * 4], noise=QUIET, trials=1, markers=[marker])
    np.testing.assert_allclose(data.positions[0, 0, 0], [0.01, 0.0, 0.1], atol=1e-12)


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        ({'trials': 0}, 'trials: expected a whole number from 1 on, got 0'),
        ({'inputs': [[1.0]]}, 'postures: expected (postures, 4) numbers for prox_left, '),
        ({'inputs': [[-1.0, 0.0, 0.0, 0.0]]}, 'postures: prox_left: expected a finite tension'),
    ],
)
def test_senseless_measurements_are_refused(plant, change, message):
    options = {'inputs': [[0.1] * 4], **change}
    with pytest.raises(InputError) as refusal:
        simulate(plant, options.pop('inputs'), **options)
    assert str(refusal.value).startswith(message)


def test_the_command_writes_what_compare_and_diagnose_read(tmp_path, capsys):
    out, check = tmp_path / 'fit', tmp_path / 'check'
    arguments = ['simulate', str(KATO), '--output', str(out), '--check', str(check)]
    arguments += ['--hidden', 'hinge_friction:lever=0.0004', 'soft_cell', '--trials', '2']
    assert main([*arguments, '--markers', '5', '--noise', 'position=0.1']) == 0
    printed = capsys.readouterr().out
    assert f'written: {out}: 12 postures x 2 trials x 5 markers' in printed
    assert f'written: {check}: 6 postures x 2 trials x 5 markers' in printed
    assert 'hidden:  hinge_friction:lever=0.0004, soft_cell' in printed
    data = load_dataset(out)
    assert data.robot.effects == load_robot(KATO).effects
    assert data.robot.sections == load_robot(KATO).sections
    assert data.position_noise == 1e-4
    assert data.arc_lengths[-1] == pytest.approx(0.208)
    own = Model(data.robot).shapes(data.inputs).markers(data.arc_lengths, data.offsets)
    assert np.linalg.norm(own - data.mean, axis=2).max() > 5e-3


@pytest.mark.parametrize('path', PATHS)
@pytest.mark.parametrize('kind', INPUTS)
def test_the_command_takes_every_way_to_the_postures(path, kind, tmp_path, capsys):
    command = ['simulate', 'kato_10_1', '--output', str(tmp_path / 'new'), '--postures', '3']
    assert main([*command, '--trials', '2', '--path', path, '--input', kind]) == 0
    assert load_dataset(tmp_path / 'new').input == kind


def test_arms_are_built_with_imperfections_unless_told_otherwise(tmp_path, capsys):
    arguments = ['simulate', str(KATO), '--postures', '3', '--trials', '1', '--noise']
    arguments += ['position=0.001,setting=0,trial=0', '--output']
    moved = {}
    for name, options in {'built': [], 'exact': ['--exact'], 'bad': ['--level', '2']}.items():
        assert main([*arguments, str(tmp_path / name), *options]) == 0
        moved[name] = load_dataset(tmp_path / name).mean
        said = capsys.readouterr().out
        assert ('cells scatter by' in said) == (name != 'exact')
    off = {name: np.linalg.norm(moved[name] - moved['exact'], axis=2).max() for name in moved}
    assert 5e-4 < off['built'] < off['bad'] < 5e-2


def test_every_imperfection_moves_the_markers_by_itself():
    robot = load_robot(KATO)
    none = Workmanship().times(0.0)
    inputs = default_postures(robot, 3)
    exact = simulate(make_plant(robot, work=none), inputs, noise=QUIET, trials=1).mean
    for field in fields(Workmanship):
        work = replace(none, **{field.name: getattr(Workmanship(), field.name)})
        seen = simulate(make_plant(robot, work=work), inputs, noise=QUIET, trials=1).mean
        assert np.linalg.norm(seen - exact, axis=2).max() > 5e-5, field.name


def test_own_postures_and_gravity(tmp_path, capsys):
    table = tmp_path / 'postures.csv'
    table.write_text('posture,prox_left,prox_right,dist_left,dist_right\nup,0.3,0.1,0.1,0.1\n')
    arguments = ['simulate', str(KATO), '--postures', str(table), '--hidden', 'gravity']
    out = tmp_path / 'x'
    assert main([*arguments, '--output', str(out)]) == 1
    assert 'give --gravity 0,0,9.81' in capsys.readouterr().err
    assert not out.exists()
    arguments += ['--gravity', '0,0,-9.81', '--undeclared', '--output', str(out)]
    assert main(arguments) == 0
    data = load_dataset(out)
    assert (data.postures, data.gravity, data.position_noise) == (('up',), (0.0, 0.0, -9.81), None)


@pytest.mark.parametrize(
    ('arguments', 'message'),
    [
        (['--hidden', 'magic'], "unknown hidden effect 'magic'; in the catalogue: "),
        (['--hidden', 'gravity:x'], "hidden gravity: expected NAME=VALUE, got 'x'"),
        (['--hidden', 'tip_load:force_x=a'], "tip_load: force_x: expected numbers, got 'a'"),
        (
            ['--hidden', 'soft_cell:cell=3', 'soft_cell:cell=7'],
            '--hidden: expected each effect once, got soft_cell:cell=3, soft_cell:cell=7',
        ),
        (['--noise', 'tracker=1'], "--noise: expected position, setting, trial, got 'tracker'"),
        (['--noise', 'position=1000'], 'noise: position: expected a number from 0 to 0.1 [m]'),
        (['--noise', 'position=2e-4'], '--noise: position=0.0002 mm is no noise of a tracker; '),
        (['--markers', '0'], '--markers: expected a whole number from 1 on, got 0'),
        (['--markers', '²'], "--markers: expected numbers, got '²'"),
        (
            ['--hidden', 'gravity', '--gravity', '0,0,0'],
            'hidden gravity: ROBOT does not say where down is; give --gravity 0,0,9.81',
        ),
        (['--markers', '30,500'], 'markers: expected arc lengths from 0 to 0.208 m (the tip)'),
    ],
)
def test_a_mistake_is_one_line_and_writes_nothing(arguments, message, tmp_path, capsys):
    assert main(['simulate', str(KATO), '--output', str(tmp_path / 'x'), *arguments]) == 1
    error = capsys.readouterr().err
    assert error.startswith(f'error: {message}')
    assert error.count('\n') == 1
    assert not (tmp_path / 'x').exists()


def test_kinks_are_told_by_their_rms():
    robot = planar(effects={}, cells=2)
    built = replace(Built.exact(robot), kink=np.radians([[3.0, 0.0], [-5.0, 0.0]]))
    assert f'kinks of {np.sqrt(17.0):.2f}°' in built.text(robot)[0]
    assert built.sizes['cell_kink'] == pytest.approx(np.radians(np.sqrt(17.0)))
    assert 'kinks of 0.00°' in Built.exact(robot).text(robot)[0]
