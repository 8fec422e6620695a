"""The range of motion: pairs of inputs, postures at a view angle, files, the command."""

from dataclasses import replace

import numpy as np
import pytest
from arms import planar, spatial, two_sections
from browser import assert_fine, open_page
from numpy.testing import assert_allclose, assert_array_equal

from tendon_robot_ros.cli.main import main
from tendon_robot_ros.common.errors import InputError
from tendon_robot_ros.common.workers import Workers
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.robot import dump_robot, load_robot
from tendon_robot_ros.workspace.cubes import SPHERE_PART_COUNT, Cubes, Reached, folds
from tendon_robot_ros.workspace.view_angle import Workspace, pairs_of
from tendon_robot_ros.workspace.volume import Sampling, Volume

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
    found = Workspace(Model(robot), [np.radians(45.0)], step=0.1, tolerance=np.radians(3.0))
    cells, arm, stiffness = 6, 0.0055, 0.027
    levels = np.round(np.arange(51) * 0.1, 9)
    angle = cells * arm / stiffness * (levels[None, :] - levels[:, None])  # right minus left
    expected = (np.abs(np.abs(angle) - np.radians(45.0)) <= np.radians(3.0)).sum()
    assert sum(map(len, found.families)) == expected
    assert found.postures == 51**2
    assert found.unsolved == 0


def test_chunks_do_not_change_what_is_found(monkeypatch):
    model = Model(two_sections(effects=FRICTION))
    whole = Workspace(model, [1.0], step=0.5, tolerance=0.1)
    calls = []
    monkeypatch.setattr('tendon_robot_ros.workspace.view_angle.ROWS_AT_ONCE', 50)
    parts = Workspace(model, [1.0], step=0.5, tolerance=0.1, progress=lambda *a: calls.append(a))
    assert [len(family) for family in parts.families] == [len(f) for f in whole.families]
    np.testing.assert_array_equal(parts.families[0].positions, whole.families[0].positions)
    assert calls[-1][1] == calls[-1][2] == whole.postures
    assert len(calls) > len(whole.pairs)


def test_a_spatial_arm_is_judged_by_its_tip_direction():
    robot = spatial(effects=FRICTION)
    found = Workspace(Model(robot), [np.radians(60.0)], step=1.0, tolerance=np.radians(10.0))
    assert found.families
    for family in found.families:
        assert np.abs(np.abs(family.angle) - np.radians(60.0)).max() <= np.radians(10.0)


@pytest.mark.parametrize('robot', [planar(), spatial()], ids=['planar', 'spatial'])
def test_a_posture_that_looks_ahead_is_counted_once(robot):
    found = Workspace(Model(robot), [0.0], step=1.0, tolerance=np.radians(10.0))
    for pair in found.pairs:
        own = [family for family in found.families if family.pair == pair]
        rows = np.concatenate([family.tensions for family in own])
        assert len(np.unique(rows, axis=0)) == len(rows) > 1
        assert all((family.side * family.angle >= 0.0).all() for family in own)


def test_highest_median_and_lowest_tip_are_in_that_order():
    found = Workspace(Model(two_sections(cells=8, effects=FRICTION)), [1.0], 0.25, tolerance=0.1)
    family = found.families[0]
    heights = family.tips[list(family.salient), 2]
    assert heights[0] == family.tips[:, 2].max()
    assert heights[2] == family.tips[:, 2].min()
    assert heights[0] >= heights[1] >= heights[2]


def test_a_robot_with_one_input_has_no_pair():
    robot = planar()
    with pytest.raises(InputError, match='one input only'):
        Workspace(Model(replace(robot, tendons=robot.tendons[:1])), [1.0])


def test_the_command_writes_table_arrays_and_page(tmp_path, capsys):
    pytest.importorskip('plotly')
    robot = tmp_path / 'robot.yaml'
    robot.write_text(dump_robot(two_sections(effects=FRICTION)))
    out = tmp_path / 'out'
    call = ['model', 'workspace', str(robot), '--view', '60', '--view', '720', '--step', '0.5']
    assert main([*call, '--tolerance', '8', '--output', str(out)]) == 0
    printed = capsys.readouterr().out
    assert 'opposite sides' in printed
    assert 'no posture at 720°' in printed
    assert 'a smaller --step or a higher --tension-max' in printed
    rows = (out / 'postures.csv').read_text().splitlines()
    with np.load(out / 'workspace.npz') as arrays:
        assert len(rows) - 1 == len(arrays['tensions']) == len(arrays['pair'])
        assert arrays['positions'].shape[1:] == (8, 3)
    assert '60° view' in (out / 'workspace.html').read_text(encoding='utf-8')
    assert main([*call, '--output', str(out)]) == 1
    assert 'use --overwrite' in capsys.readouterr().err
    (out / 'mine.txt').touch()
    assert main([*call, '--output', str(out), '--overwrite']) == 1
    said = capsys.readouterr()
    assert 'it holds mine.txt' in said.err
    assert 'opposite sides' not in said.out, 'told before the work'


def single(effects=None, cells=8):
    """Return one section with three tendons all around."""
    robot = spatial(cells=cells, effects=effects)
    return replace(
        robot,
        sections=robot.sections[:1],
        tendons=tuple(t for t in robot.tendons if t.section == 'near'),
    )


def test_without_friction_the_tips_of_one_section_lie_on_the_arcs_of_all_bends():
    robot = single()
    volume = Volume(Sampling.of(Model(robot), 4000))
    reached, cells, length = volume.reached, robot.cells, robot.sections[0].cell_length
    assert volume.frictionless is None
    assert len(reached) > 200
    offsets = np.array([tendon.base for tendon in robot.tendons])
    bend = np.linalg.norm(reached.tensions @ offsets, axis=1) / 0.05  # moment over stiffness
    # hinges in the middle of the cells: half a cell straight at either end
    weights = np.r_[0.5, np.ones(cells - 1), 0.5]
    angles = bend[:, None] * np.arange(cells + 1)
    assert_allclose(reached.tips[:, 2], length * np.cos(angles) @ weights, atol=1e-9)
    across = length * np.abs(np.sin(angles) @ weights)
    assert_allclose(np.hypot(*reached.tips[:, :2].T), across, atol=1e-9)
    assert volume.largest == pytest.approx(np.pi, abs=0.1)


@pytest.mark.long
def test_a_volume_is_the_same_bit_for_bit_from_processes_and_after_an_interruption(tmp_path):
    robot = two_sections(effects=FRICTION)
    sampling = Sampling.of(Model(robot), 9000, [1.0])
    whole = Volume(sampling)

    def stop(what, done, total):
        if done > 5000:
            raise KeyboardInterrupt

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr('tendon_robot_ros.workspace.volume.UPKEEP_S', 0.0)
        with pytest.raises(KeyboardInterrupt):
            Volume(sampling, stop, kept=tmp_path)
    with pytest.raises(InputError, match='is of another robot or other options; delete it'):
        Volume(Sampling.of(Model(robot), 9001, [1.0]), kept=tmp_path)
    seen = []
    with Workers(2) as workers:
        spread = Volume(sampling, lambda *told: seen.append(told), workers, tmp_path)
    assert seen[0][1] > 5000
    assert_array_equal(spread.reached.tensions, whole.reached.tensions)
    assert_array_equal(spread.views[1.0].looks, whole.views[1.0].looks)
    assert spread.to_json() == whole.to_json()


def test_arms_that_hardly_turn_are_not_looked_at_for_folds_and_none_of_them_folds():
    random = np.random.default_rng(0)
    bends = random.normal(0.0, 0.12, (4000, 12))
    steps = np.stack([np.sin(np.cumsum(bends, axis=1)), np.zeros_like(bends),
                      np.cos(np.cumsum(bends, axis=1))], axis=2) * 0.01  # fmt: skip
    ends, thickness = np.cumsum(steps, axis=1), np.full(12, 0.012)
    few = np.abs(bends).sum(axis=1) < 0.5 * np.pi
    middles = ends - 0.5 * steps
    gaps = np.linalg.norm(middles[:, :, None] - middles[:, None], axis=3)
    far = np.abs(np.subtract.outer(np.arange(12), np.arange(12))) * 0.01 > 0.5 * np.pi * 0.024
    touches = ((gaps < 0.024) & far).any(axis=(1, 2))
    assert 0.05 < few.mean() < 0.95
    assert not touches[few].any()
    assert_array_equal(folds(ends, thickness, np.full(12, 0.01)), touches)


def test_tips_on_a_curve_have_a_hull_and_no_area():
    reached = Volume(Sampling.of(Model(planar()), 5000)).reached
    assert reached.is_flat
    assert reached.size < 0.1 * reached.hull[2]


def test_cubes_hold_the_volume_of_a_ball():
    radius, edge = 0.03, 0.003
    low = np.stack(np.meshgrid(*[np.arange(-12, 12) * edge] * 3), axis=-1).reshape(-1, 3)
    nearest = np.clip(0.0, low + 1e-9, low + edge - 1e-9)  # of every cube to the base
    inside = nearest[np.linalg.norm(nearest, axis=1) < radius]
    cubes = Cubes(planar(), edge)
    cubes.add(np.ones((len(inside), 2)), inside, inside)
    reached, volume = Reached(cubes), 4 / 3 * np.pi * radius**3
    assert reached.size == pytest.approx(volume, rel=0.02)
    assert len(reached) * edge**3 > 1.2 * volume  # cubes alone hold more
    assert 0.9 * volume < reached.hull[2] < volume  # of points inside


def test_a_cube_keeps_the_posture_of_least_tension_and_all_directions():
    random = np.random.default_rng(0)
    tips, tensions = random.uniform(-0.02, 0.02, size=(5000, 3)), random.random((5000, 2))
    directions = tips / np.linalg.norm(tips, axis=1, keepdims=True)
    cubes = Cubes(planar(), 0.01)
    for rows in np.array_split(np.arange(5000), 7):
        cubes.add(tensions[rows], tips[rows], directions[rows])
    reached = Reached(cubes)
    assert (len(reached), reached.postures) == (4**3, 5000)
    for row, cell in enumerate(reached.cells):
        inside = (np.floor(tips / 0.01) == cell).all(axis=1)
        least = np.flatnonzero(inside)[np.argmin(tensions[inside].max(axis=1))]
        assert_allclose(reached.tensions[row], tensions[least])
        assert_allclose(reached.tips[row], tips[least])
    around_the_base = np.flatnonzero((reached.cells == [0, 0, 0]).all(axis=1))
    assert reached.looks[around_the_base] == SPHERE_PART_COUNT // 8  # an octant of all directions


def test_a_stiffer_arm_of_the_same_name_has_a_workspace_of_its_own():
    soft, stiff = (
        Volume(Sampling.of(Model(planar(stiffness=stiffness)), 500)) for stiffness in (0.027, 0.5)
    )
    assert stiff.largest < 0.5 * soft.largest


def test_an_arm_that_closes_a_ring_runs_into_itself():
    length, n = 0.006, 40
    bends = np.array([0.0, np.pi, 1.98 * np.pi, 2.2 * np.pi]) / n
    angles = bends[:, None] * np.arange(1, n + 1)
    steps = length * np.stack([np.sin(angles), 0.0 * angles, np.cos(angles)], axis=2)
    folded = folds(np.cumsum(steps, axis=1), np.full(n, 0.006), np.full(n, length))
    assert folded.tolist() == [False, False, True, True]


def test_friction_takes_places_and_adds_others():
    volume = Volume(Sampling.of(Model(single(effects=FRICTION, cells=12)), 6000, views=[1.0]))
    assert volume.frictionless is not None
    assert volume.given > 0.0
    # bent near the base and straight farther out, it reaches farther to the side
    assert volume.reached.highs[0] > 1.1 * volume.frictionless.highs[0]
    (view,) = volume.views.values()
    looking = np.arccos(view.directions[:, 2])
    assert_allclose(looking, 1.0, atol=np.radians(2.5))
    heights = view.tips[:, 2]
    assert np.ptp(heights) < 0.25 * volume.robot.length  # a ring


def test_where_no_posture_without_friction_is_left_there_is_nothing_to_compare():
    volume = Volume(Sampling.of(Model(load_robot('kato_10_1_single')), 1))  # it folds without
    assert (len(volume.reached), volume.frictionless, volume.taken) == (1, None, None)


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize(
    ('kind', 'options', 'message'),
    [
        (Workspace, {'step': 0.0}, 'a step above 0'),
        (Workspace, {'pretension': 6.0}, 'a pretension from 0 to below the limit'),
        (Workspace, {'step': 1e-4}, 'postures are more than 100,000,000; make the step larger'),
        (Sampling.of, {'postures': 0}, 'expected 1 to 100,000,000 postures, got 0'),
        (Sampling.of, {'postures': -1}, 'expected 1 to 100,000,000 postures, got -1'),
        (Sampling.of, {'pretension': 5.0, 'limit': 1.0}, 'below the limit, got 5 N and 1 N'),
        (Sampling.of, {'edge': 1e-6}, 'expected cubes of 0.42 mm to the length of the arm, got'),
        (Sampling.of, {'views': [-1.0]}, 'expected view angles of 0° or more'),
    ],
)
def test_what_makes_no_sense_is_refused(kind, options, message):
    with pytest.raises(InputError, match=message):
        kind(Model(planar()), **{'views': [1.0], **options})


def test_cubes_are_as_small_as_the_shell_of_one_section_lets_them():
    """Ten postures come to each: tips of one section lie on a sheet, of two in a space."""
    one, two = single(cells=4), spatial(cells=4)
    found = Volume(Sampling.of(Model(one), postures=4000))
    assert found.reached.edge == pytest.approx(one.length / np.sqrt(4000 / 10 / 4.0))
    assert 4000 / len(found.reached) == pytest.approx(10.0, rel=0.7)
    assert Sampling.of(Model(two), postures=6000).edge == pytest.approx(two.length / 8.0)


@pytest.mark.long
def test_the_command_shows_all_tendons_of_an_arm_in_space(tmp_path, capsys):
    pytest.importorskip('plotly')
    robot = tmp_path / 'robot.yaml'
    robot.write_text(dump_robot(spatial(effects=FRICTION)))
    out = tmp_path / 'out'
    call = ['model', 'workspace', str(robot), '--view', '60', '--view', '200']
    call += ['--postures', '3000']
    assert main([*call, '--cubes', '5', '--output', str(out)]) == 0
    printed = capsys.readouterr().out
    assert '3,000 postures over 6 tendons from 0 to 5 N' in printed
    assert 'in cubes of 5.0 mm; their convex hull has ' in printed
    assert 'friction takes ' in printed
    assert 'no posture at 200°: the largest tip angle is ' in printed
    rows = (out / 'postures.csv').read_text().splitlines()
    with np.load(out / 'workspace.npz') as arrays:
        assert len(rows) - 1 == len(arrays['tensions']) == len(arrays['looks'])
        tips = Model(spatial(effects=FRICTION)).shapes(arrays['tensions'][:50]).tip_position
        assert_allclose(tips, arrays['tips'][:50], atol=1e-9)
    page = (out / 'workspace.html').read_text(encoding='utf-8')
    assert 'Section along the x-z plane' in page
    seen = open_page(out / 'workspace.html', tmp_path, (1200, 400))
    assert_fine(seen, (1200, 400))
    assert seen[1200]['turned'] == [True, True]
    assert seen[400]['tall'] == 0, 'with one scale for both axes height is only empty'
    assert main([*call, '--step', '1', '--output', str(tmp_path / 'b')]) == 1
    assert '--step: --view of an arm in a plane sweeps pairs' in capsys.readouterr().err
