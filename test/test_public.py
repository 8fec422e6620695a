"""What a notebook imports: every public name, quickly, and results that print what one wants."""

import os
import sys

import numpy as np
import processes
import pytest
from matplotlib import pyplot as plt
from source_tree import ROOT

import tendon_robot_ros
from tendon_robot_ros import Model, compare, load_dataset, load_robot
from tendon_robot_ros.common.errors import InputError
from tendon_robot_ros.common.rotations import about
from tendon_robot_ros.model.pulls import pull_shapes
from tendon_robot_ros.model.shape import bending_azimuth, plot_arms, views_of
from tendon_robot_ros.workspace.postures import default_postures

ROBOTS = ROOT / 'config' / 'robots'


def test_every_public_name_can_be_imported():
    assert sorted(tendon_robot_ros.PUBLIC) == sorted(tendon_robot_ros.__all__)
    for name in tendon_robot_ros.__all__:
        assert getattr(tendon_robot_ros, name).__name__ == name
    assert set(tendon_robot_ros.__all__) <= set(dir(tendon_robot_ros))


def test_an_unknown_name_is_refused():
    with pytest.raises(AttributeError, match="'tendon_robot_ros' has no attribute 'lode_robot'"):
        _ = tendon_robot_ros.lode_robot


def test_a_robot_and_its_shapes_say_what_they_are():
    robot = load_robot(ROBOTS / 'kato_10_1.yaml')
    assert repr(robot).startswith(
        '<Robot kato_10_1: 208 mm; sections: proximal of 15 cells, distal of 15 cells; 4 tendons, '
    )
    model = Model(robot)
    shape = model.shape({'prox_left': 0.1})
    assert repr(shape).startswith('<Shape: tensions [0.1, 0, 0, 0] N, tip at (')
    solution = model.reach(position=shape.tip_position)
    assert repr(solution).startswith('<Reach: reached, ')


@pytest.mark.parametrize(('name', 'axis'), [('kato_10_1', 'z [mm]'), ('spatial_3', 'y [mm]')])
def test_an_arm_is_drawn_flat_or_in_space(name, axis):
    model = Model(load_robot(ROBOTS / f'{name}.yaml'))
    tensions = model.limits[:, 0].copy()
    tensions[1] += 0.5
    shape = model.shape(tensions)
    axes = shape.plot(label='once')
    assert axes.get_ylabel() == axis
    drawn = axes.lines[0].get_data_3d() if name == 'spatial_3' else axes.lines[0].get_data()
    assert drawn[0][-1] == pytest.approx(1e3 * shape.tip_position[0])
    assert shape.plot(axes) is axes
    assert len(axes.lines) == 2


@pytest.mark.parametrize('turn', [0.0, 1.0, 2.5, -2.0])
def test_an_arm_is_seen_across_the_plane_in_which_it_bends(turn):
    bent = np.array([[0.0, 0.0, 0.1], [0.03, 0.002, 0.18], [np.nan] * 3, [0.08, -0.002, 0.2]])
    arm = bent @ about(2, turn).T
    azimuth = bending_azimuth(arm)
    assert azimuth == pytest.approx(turn + bending_azimuth(bent), abs=1e-12)
    np.testing.assert_allclose(views_of(arm, turn), bent, atol=1e-12)
    axes = plot_arms(arm[[0, 1, 3]][None], None)
    if turn:
        line_of_sight = np.radians(axes.azim)
        assert np.cos(line_of_sight - azimuth) == pytest.approx(0.0, abs=1e-12)
    plt.close('all')


def test_a_straight_arm_is_seen_with_x_to_the_right():
    assert bending_azimuth(np.array([[0.0, 0.0, 0.1], [0.0, 0.0, 0.2]])) == 0.0


def test_a_comparison_prints_and_draws_its_errors():
    dataset = load_dataset(ROOT / 'data' / 'hinge_friction' / 'fit')
    assert ': 12 postures x up to 5 trials x 15 markers of planar1; tension [N]' in repr(dataset)
    comparison = compare(dataset)
    assert 'planar1: rms 2.66 mm, tip error 4.43 mm; a perfect model: 0.245 mm' in repr(comparison)
    axes = comparison.plot()
    assert axes.lines[0].get_ydata()[-1] == pytest.approx(1e3 * comparison.best.per_marker_rms[-1])
    across, along = comparison.plot_shapes('3').axes
    measured = next(line for line in across.lines if line.get_label() == 'measured')
    np.testing.assert_allclose(measured.get_ydata(), 1e3 * comparison.measured.mean[3, :, 2])
    assert np.abs(along.lines[-1].get_xdata()).max() < np.abs(measured.get_xdata()).max()
    with pytest.raises(InputError, match="no posture 'third'; there are: 0, 1, 2"):
        comparison.plot_shapes('third')
    plt.close('all')


@pytest.mark.slow  # the same, of the same table: README.md, docs/from_mocap_to_verdict.md
def test_the_notebook_goes_from_a_table_to_a_verdict(tmp_path):
    pytest.importorskip('pandas')
    run = processes.run(
        [sys.executable, 'examples/from_table_to_verdict.py', tmp_path],
        cwd=ROOT,
    )
    assert run.returncode == 0, run.stderr
    starts = [line.split()[0] for line in run.stdout.splitlines() if line.startswith('<')]
    assert starts == [
        '<Robot', '<Shape:', '<ImportedTable', '<DataSet', '<Comparison', '<Diagnosis',
        '<ImportedTable', '<Comparison',
    ]  # fmt: skip
    assert 'missing_effect: tip_load: force_x = ' in run.stdout
    better = load_robot(tmp_path / 'better.yaml')
    assert better.effects['tip_load']['force_x'] == pytest.approx(0.147, rel=0.04)  # 15 g
    last = run.stdout.splitlines()[-1]
    assert float(last.partition('rms ')[2].split()[0]) < 0.6  # [mm], on postures never used
    for name in ('shape.png', 'errors.png', 'import.png', 'diagnosis.png'):
        assert (tmp_path / name).stat().st_size > 5000
    assert len(load_dataset(tmp_path / 'data').markers) == 6


@pytest.mark.slow  # half a minute: nine wires by pulls, the real tables are not in the project
def test_the_arm_that_remembers_is_followed_on_later_motions(tmp_path):
    """docs/opencr.md on simulated tables of the same kind: settled tips in the order of time."""
    pandas = pytest.importorskip('pandas')
    robot, random = load_robot(ROOT / 'examples/opencr.yaml'), np.random.default_rng(5)
    lag = 0.5 / robot.cells
    arm = Model(robot.with_effect('bending_hysteresis', {'lag': lag, 'presliding': 1.0}))
    for name, count, seed in (('train', 48, 0), ('val', 24, 1)):
        pulls = default_postures(robot, count, seed, 'displacement', 'sequence')
        let_go = np.where(np.isnan(pulls), -0.01, pulls)
        tips = pull_shapes(arm, let_go, memory=arm.arrays.fresh_memory()).tip_position
        table = {'timestamp': 0.6 * np.arange(count)}
        servos = zip((4, 3, 9, 5, 2, 8, 6, 1, 7), let_go.T, strict=True)
        table |= {f'servo_{number}_mm': 1e3 * pull for number, pull in servos}
        noisy = tips + random.normal(0.0, 3e-4, tips.shape)
        table |= {f'tip_{axis}': 1e3 * places for axis, places in zip('xyz', noisy.T, strict=True)}
        pandas.DataFrame(table).to_csv(tmp_path / f'{name}.csv', index=False)
    run = processes.run([sys.executable, 'examples/opencr.py', tmp_path, tmp_path], cwd=ROOT)
    assert run.returncode == 0, run.stderr
    rms = {
        line.split(' (')[0]: float(line.split(')')[1].split()[0])
        for line in run.stdout.splitlines()
        if line.startswith(('as described (', 'that forgets (', 'that remembers ('))
    }
    assert rms['that remembers'] < 0.25 * min(rms['that forgets'], rms['as described'])
    assert rms['that remembers'] < 1.0  # [mm], with noise of 0.5
    found = load_robot(tmp_path / 'better.yaml').effects['bending_hysteresis']
    assert found['lag'] == pytest.approx((lag,) * 3, rel=0.15)


def test_linear_algebra_runs_in_one_thread_unless_the_user_says_otherwise():
    code = 'import tendon_robot_ros, os; print(os.environ["OPENBLAS_NUM_THREADS"])'
    for given, expected in ((None, '1'), ('3', '3')):
        known = {k: v for k, v in os.environ.items() if k != 'OPENBLAS_NUM_THREADS'}
        run = processes.run(
            [sys.executable, '-c', code],
            env=known | ({} if given is None else {'OPENBLAS_NUM_THREADS': given}),
        )
        assert run.stdout.strip() == expected


def test_numpy_imported_first_makes_no_diagnosis_slow():
    code = (
        'import numpy, threadpoolctl\n'
        'from tendon_robot_ros.common.processes import one_thread\n'
        'blas = lambda: {p["num_threads"] for p in threadpoolctl.threadpool_info()\n'
        '                if p["user_api"] == "blas"}\n'
        'threadpoolctl.threadpool_limits(2, "blas")\n'
        'with one_thread(): inside = blas()\n'
        'print(inside, blas())\n'
    )
    run = processes.run([sys.executable, '-c', code])
    assert run.stdout.strip() == '{1} {2}', run.stderr
