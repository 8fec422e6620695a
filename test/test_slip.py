"""The friction coefficient from slip angles: mean, spread, outliers, and into a description."""

import numpy as np
import pytest
from source_tree import ROOT

from tendon_robot_ros.cli.main import main
from tendon_robot_ros.common.errors import DataSetError, InputError
from tendon_robot_ros.robot import load_robot
from tendon_robot_ros.studies.friction import SlipFriction, read_slip_angles, with_friction

ROBOT = ROOT / 'config/robots/kato_10_1.yaml'


def angles_file(folder, *angles):
    path = folder / 'angles.csv'
    rows = [f'{i + 1},{angle}' for i, angle in enumerate(angles)]
    path.write_text('\n'.join(['measurement,angle_deg', *rows, '']))
    return path


def test_the_coefficient_is_the_mean_tangent():
    found = SlipFriction(('a', 'b', 'c'), np.arctan([0.3, 0.32, 0.34]))
    assert found.mean == pytest.approx(0.32)
    assert found.sd == pytest.approx(0.02)
    # 95 % t quantile for two degrees of freedom: 4.3027
    assert found.high - found.mean == pytest.approx(4.3027 * 0.02 / np.sqrt(3.0), rel=1e-4)
    assert found.outliers == ()


def test_an_outlier_is_named_and_stays():
    tangents = [0.30, 0.31, 0.32, 0.33, 0.34, 0.6]
    found = SlipFriction(tuple('abcdef'), np.arctan(tangents))
    assert found.outliers == ('f',)
    assert found.mean == pytest.approx(np.mean(tangents))
    assert found.mean_without == pytest.approx(0.32)


def test_an_outlier_among_angles_that_are_alike_is_named():
    found = SlipFriction(tuple('abcdef'), np.radians([18, 18, 18, 18, 19, 45]))
    assert found.outliers == ('f',)
    assert SlipFriction(tuple('abc'), np.radians([18, 18, 18])).outliers == ()


def test_fewer_than_three_measurements_are_refused():
    with pytest.raises(InputError, match='expected at least 3, got 2; measure more'):
        SlipFriction(('a', 'b'), [0.3, 0.3])


@pytest.mark.parametrize(
    ('angles', 'message'),
    [
        ((17, 95, 18), 'row 3: angle_deg is 95; write the slip angle in degrees'),
        ((0.31, 0.32, 0.33), 'no angle exceeds 1.57°; write degrees, not radians'),
    ],
)
def test_what_is_no_slip_angle_in_degrees_is_refused(tmp_path, angles, message):
    with pytest.raises(DataSetError, match=message):
        read_slip_angles(angles_file(tmp_path, *angles))


def test_the_description_gets_coefficient_origin_and_tolerance():
    found = SlipFriction(tuple('abc'), np.arctan([0.3, 0.32, 0.34]))
    robot = with_friction(load_robot(ROBOT), found, 'angles.csv', '2020-02-29')
    assert robot.effects['tendon_friction'] == {'friction_coefficient': 0.32}
    assert robot.fitted['tendon_friction']['data'] == 'angles.csv'
    assert 0.0 < robot.tolerances['friction_coefficient'] < 0.1


def test_the_command_writes_a_description_that_loads(tmp_path, capsys):
    new = tmp_path / 'new.yaml'
    angles = angles_file(tmp_path, 17, 18, 19, 18)
    assert (
        main(['study', 'friction', str(angles), '--robot', str(ROBOT), '--output', str(new)]) == 0
    )
    assert 'friction coefficient: 0.325 ± 0.016' in capsys.readouterr().out
    value = load_robot(new).effects['tendon_friction']['friction_coefficient']
    assert value == pytest.approx(0.325, abs=1e-3)


def test_robot_and_output_go_together(tmp_path, capsys):
    assert (
        main(['study', 'friction', str(angles_file(tmp_path, 17, 18, 19)), '--robot', str(ROBOT)])
        == 1
    )
    assert '--robot and --output go together' in capsys.readouterr().err
