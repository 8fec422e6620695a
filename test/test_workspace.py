"""The range of motion: pairs of inputs, postures at a view angle, files, the command."""

from dataclasses import replace

import numpy as np
import pytest
from arms import planar, spatial, two_sections

from tendon_robot_ros.cli.main import main
from tendon_robot_ros.common.errors import InputError
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.robot import dump_robot
from tendon_robot_ros.workspace.grid import find_workspace, pairs_of

FRICTION = {'tendon_friction': {'friction_coefficient': 0.3}}


def test_two_sections_have_pairs_on_opposite_and_on_the_same_side():
    kinds = {pair.inputs: pair.kind for pair in pairs_of(two_sections())}
    assert kinds == {
        ('near_left', 'far_left'): 'same side',
        ('near_left', 'far_right'): 'opposite sides',
        ('near_right', 'far_left'): 'opposite sides',
        ('near_right', 'far_right'): 'same side',
    }


def test_one_section_has_the_pair_of_its_own_inputs():
    (pair,) = pairs_of(planar())
    assert pair.inputs == ('left', 'right')
    assert pair.kind == 'opposite sides'


def test_without_friction_the_postures_are_those_of_the_closed_form():
    robot = planar(cells=6)
    found = find_workspace(Model(robot), [np.radians(45.0)], step=0.1, tolerance=np.radians(3.0))
    cells, arm, stiffness = 6, 0.0055, 0.027
    levels = np.round(np.arange(51) * 0.1, 9)
    angle = cells * arm / stiffness * (levels[None, :] - levels[:, None])  # right minus left
    expected = (np.abs(np.abs(angle) - np.radians(45.0)) <= np.radians(3.0)).sum()
    assert sum(map(len, found.families)) == expected
    assert found.postures == 51**2
    assert found.unsolved == 0


def test_chunks_do_not_change_what_is_found(monkeypatch):
    model = Model(two_sections(effects=FRICTION))
    whole = find_workspace(model, [1.0], step=0.5, tolerance=0.1)
    calls = []
    monkeypatch.setattr('tendon_robot_ros.workspace.grid.POSTURES_AT_ONCE', 50)
    parts = find_workspace(
        model, [1.0], step=0.5, tolerance=0.1, progress=lambda *a: calls.append(a)
    )
    assert [len(family) for family in parts.families] == [len(f) for f in whole.families]
    np.testing.assert_array_equal(parts.families[0].positions, whole.families[0].positions)
    assert calls[-1][1] == calls[-1][2] == whole.postures
    assert len(calls) > len(whole.pairs)


def test_a_spatial_arm_is_judged_by_its_tip_direction():
    robot = spatial(effects=FRICTION)
    found = find_workspace(Model(robot), [np.radians(60.0)], step=1.0, tolerance=np.radians(10.0))
    assert found.families
    for family in found.families:
        assert np.abs(np.abs(family.angle) - np.radians(60.0)).max() <= np.radians(10.0)


def test_highest_median_and_lowest_tip_are_in_that_order():
    found = find_workspace(
        Model(two_sections(cells=8, effects=FRICTION)), [1.0], 0.25, tolerance=0.1
    )
    family = found.families[0]
    heights = family.tips[list(family.salient), 2]
    assert heights[0] == family.tips[:, 2].max()
    assert heights[2] == family.tips[:, 2].min()
    assert heights[0] >= heights[1] >= heights[2]


@pytest.mark.parametrize(
    ('options', 'message'),
    [
        ({'step': 0.0}, 'a step above 0'),
        ({'pretension': 6.0}, 'a pretension from 0 to below the limit'),
        ({'step': 1e-4}, 'postures are more than 100,000,000; make the step larger'),
    ],
)
def test_sweeps_that_make_no_sense_are_refused(options, message):
    with pytest.raises(InputError, match=message):
        find_workspace(Model(planar()), [1.0], **options)


def test_a_robot_with_one_input_has_no_pair():
    robot = planar()
    with pytest.raises(InputError, match='one input only'):
        find_workspace(Model(replace(robot, tendons=robot.tendons[:1])), [1.0])


def test_the_command_writes_table_arrays_and_page(tmp_path, capsys):
    pytest.importorskip('plotly')
    robot = tmp_path / 'robot.yaml'
    robot.write_text(dump_robot(two_sections(effects=FRICTION)))
    out = tmp_path / 'out'
    call = ['workspace', str(robot), '--view', '60', '--view', '720', '--step', '0.5']
    assert main([*call, '--tolerance', '8', '--output', str(out)]) == 0
    printed = capsys.readouterr().out
    assert 'opposite sides' in printed
    assert 'no posture at 720°' in printed
    rows = (out / 'postures.csv').read_text().splitlines()
    with np.load(out / 'workspace.npz') as arrays:
        assert len(rows) - 1 == len(arrays['tensions']) == len(arrays['pair'])
        assert arrays['positions'].shape[1:] == (8, 3)
    assert '60° view' in (out / 'workspace.html').read_text(encoding='utf-8')
    assert main([*call, '--output', str(out)]) == 1
    assert 'use --overwrite' in capsys.readouterr().err
