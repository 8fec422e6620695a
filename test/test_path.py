"""Paths of the tip: sampled, timed within limits, flown backwards; without ROS."""

from dataclasses import replace

import numpy as np
import pytest
from control_rig import ROBOTS, model

from tendon_robot_ros.common.errors import InputError
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.paths.path import (
    Pace,
    Plan,
    retreat,
    set_points,
    stretched,
    thinned,
    tip_path,
)
from tendon_robot_ros.robot import load_robot
from tendon_robot_ros.workspace.view_angle import look_around
from tendon_robot_ros.workspace.volume import Sampling

PLACES = np.array([[0.0, 0.0, 0.2], [0.06, 0.0, 0.17], [0.08, 0.0, 0.14]])
NONE = np.full((3, 3), np.nan)
TIMED = tip_path(np.array([0.0, 2.0, 3.0]), PLACES, NONE)
WIDE = Pace(speed=1e3, turning=1e3, tension=1e3)


def test_a_path_goes_through_its_rows_at_their_times():
    path = TIMED
    assert path.positions[path.rows] == pytest.approx(PLACES)
    assert path.times[path.rows] == pytest.approx([0.0, 2.0, 3.0])
    assert np.linalg.norm(np.diff(path.positions, axis=0), axis=1).max() < 0.0025


def test_a_smooth_path_rests_at_its_ends_and_never_overshoots_its_rows():
    speeds = np.linalg.norm(np.diff(TIMED.positions, axis=0), axis=1) / np.diff(TIMED.times)
    assert max(speeds[0], speeds[-1]) < 0.1 * speeds.max()
    low, high = PLACES.min(axis=0) - 1e-12, PLACES.max(axis=0) + 1e-12
    assert np.all((TIMED.positions >= low) & (TIMED.positions <= high))


def test_a_linear_path_is_straight_and_evenly_timed():
    path = tip_path(np.array([0.0, 2.0, 3.0]), PLACES, NONE, smooth=False)
    first = path.positions[: path.rows[1] + 1]
    assert np.diff(first, axis=0) == pytest.approx(
        np.tile(first[1] - first[0], (len(first) - 1, 1))
    )


def test_directions_turn_at_constant_speed_and_stay_unit():
    views = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    path = tip_path(np.array([0.0, 1.0, 2.0]), PLACES, views)
    assert np.linalg.norm(path.directions, axis=1) == pytest.approx(1.0)
    angles = np.degrees(np.arctan2(path.directions[:, 0], path.directions[:, 2]))
    assert angles == pytest.approx(90.0 * path.times, abs=1e-6)


def test_a_row_without_direction_asks_for_none_on_its_two_sides():
    views = np.array([[0.0, 0.0, 1.0], [np.nan] * 3, [1.0, 0.0, 0.0]])
    path = tip_path(np.array([0.0, 1.0, 2.0]), PLACES, views)
    assert np.isfinite(path.directions[[0, -1]]).all()
    assert np.isnan(path.directions[1:-1]).all()


def test_opposite_directions_are_refused_by_row():
    views = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])
    with pytest.raises(InputError, match='rows 2 and 3 look in opposite directions'):
        tip_path(np.array([0.0, 1.0, 2.0]), PLACES, views)


def test_backwards_is_the_same_way_from_its_end():
    path = tip_path(np.array([0.0, 2.0, 3.0]), PLACES, NONE)
    back = path.backwards()
    assert back.positions[back.rows] == pytest.approx(PLACES[::-1])
    assert back.times[back.rows] == pytest.approx([0.0, 1.0, 3.0])
    assert back.backwards().positions == pytest.approx(path.positions)


def test_set_points_stand_until_the_next_one_and_a_stream_is_a_path():
    path = set_points(np.array([0.0, 2.0, 2.1]), PLACES, NONE)
    before = path.times < 2.0
    assert np.ptp(path.positions[before], axis=0).max() == 0.0
    assert path.positions[path.rows] == pytest.approx(PLACES)
    assert path.times[path.rows] == pytest.approx([0.0, 2.0, 2.1])


def test_a_plan_keeps_every_limit_and_the_given_times_where_it_can():
    path, start = TIMED, model().shape(np.full(4, 0.1))
    free = Plan(model(), path, WIDE, start)
    assert free.duration == pytest.approx(3.0)
    pace = Pace(speed=0.02, turning=1e3, tension=0.5)
    slow = Plan(model(), path, pace, start)
    gaps = np.diff(slow.path.times)
    assert (np.linalg.norm(np.diff(path.positions, axis=0), axis=1) <= 0.02 * gaps + 1e-12).all()
    assert (np.abs(np.diff(slow.tensions, axis=0)).max(axis=1) <= 0.5 * gaps + 1e-12).all()
    assert slow.duration > 4.9
    position, direction = slow.at(slow.path.times[path.rows[1]])
    assert position == pytest.approx(PLACES[1])
    assert direction is None


def test_a_row_is_reached_with_its_direction_where_its_neighbour_has_none():
    views = np.array([[0.0, 0.0, 1.0], [np.nan] * 3])
    path = tip_path(np.array([0.0, 1.0]), PLACES[:2], views)
    planned = Plan(model(), path, WIDE, model().shape(np.full(4, 0.1)))
    assert planned.at(0.0)[1] == pytest.approx(views[0])
    assert planned.at(0.01)[1] is None


@pytest.mark.long
def test_what_is_out_of_reach_is_named_by_row():
    far = np.vstack([PLACES, [0.0, 0.0, 0.4]])
    path = tip_path(None, far, np.full((4, 3), np.nan))
    found = Plan(model(), path, WIDE, model().shape(np.full(4, 0.1)))
    assert 'on the way to row 4 are out of reach, by up to 19' in found.out_of_reach()
    good = Plan(model(), tip_path(None, PLACES, NONE), WIDE, model().shape(np.full(4, 0.1)))
    assert good.out_of_reach() == ''


def test_an_arm_that_remembers_leaves_no_path_that_it_follows_from_where_it_is():
    robot = load_robot(ROBOTS / 'kato_10_1.yaml')
    arm = Model(robot.with_effect('friction_memory', {'presliding_length': 2e-4}))
    shape = None
    for tension in (0.1, 0.6, 0.3):  # [N] it is let go, and stays bent by friction
        shape = arm.follow(shape, np.array([tension, 0.1, 0.1, 0.1]))
    end = arm.follow(shape, np.array([0.34, 0.1, 0.1, 0.1]))
    path = tip_path(None, np.array([shape.tip_position, end.tip_position]), NONE[:2])
    planned = Plan(arm, path, WIDE, shape)
    assert planned.detours.max() < 1e-5
    assert planned.detour() == ''


def test_commands_are_thinned_to_what_straight_lines_need():
    times = np.linspace(0.0, 10.0, 2001)
    values = np.column_stack([np.interp(times, [0.0, 3.0, 10.0], [0.1, 2.0, 1.0]), times * 0.1])
    kept = thinned(times, values)
    assert len(kept) == 3
    curved = np.column_stack([np.sin(times), np.cos(times)])
    kept = thinned(times, curved)
    line = np.column_stack([np.interp(times, times[kept], c[kept]) for c in curved.T])
    assert np.abs(line - curved).max() < 0.005
    assert len(kept) < 100


def test_a_retreat_ends_where_the_flight_began_no_faster_than_allowed():
    times = np.array([0.0, 1.0, 2.0])
    commands = np.array([[0.1, 0.1], [2.0, 0.1], [2.0, 3.0]])
    back = retreat(times, commands, 1.0)
    assert back.values == pytest.approx(commands[::-1])
    assert back.times == pytest.approx([0.05, 2.95, 4.85])
    assert stretched(times, commands, 10.0) == pytest.approx(times)


@pytest.mark.parametrize(
    ('name', 'angle'), [('kato_10_1', 180), ('kato_10_1', 45), ('spatial_6', 60)]
)
def test_a_sweep_keeps_the_view_angle_while_the_tip_moves(name, angle):
    robot = Model(load_robot(ROBOTS / f'{name}.yaml'))
    shapes = look_around(robot, np.radians(angle), 12)
    directions = np.array([shape.tip_direction for shape in shapes])
    assert np.degrees(np.arctan2(np.hypot(*directions.T[:2]), directions[:, 2])) == pytest.approx(
        angle, abs=0.3
    )
    places = np.array([robot.shape(shape.inputs).tip_position for shape in shapes])
    assert places == pytest.approx(np.array([shape.tip_position for shape in shapes]), abs=1e-9)
    assert np.ptp(places, axis=0).max() > 0.1


def test_an_arm_whose_offsets_are_computed_is_as_flat_as_one_whose_offsets_are_typed():
    typed = load_robot(ROBOTS / 'kato_10_1.yaml')
    rounding = 1e-2 * np.sin(np.pi)  # [m] of an offset at 180 degrees
    tendons = (replace(t, base=(t.base[0], rounding), end=t.end) for t in typed.tendons)
    computed = replace(typed, tendons=tuple(tendons))
    one, other = (look_around(Model(robot), 1.0, 5) for robot in (typed, computed))
    for a, b in zip(one, other, strict=True):
        assert b.inputs == pytest.approx(a.inputs, abs=1e-6)
    edges = {Sampling.of(Model(robot), 3000).edge for robot in (typed, computed)}
    assert len(edges) == 1
