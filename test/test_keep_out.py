"""Regions that the arm may not enter: distances against closed forms, reading, refusals."""

import numpy as np
import pytest

from tendon_robot_ros.common.errors import RobotDescriptionError, TendonRobotError
from tendon_robot_ros.common.rotations import about
from tendon_robot_ros.robot.keep_out import (
    Box,
    KeepOut,
    Plane,
    Region,
    Sphere,
    joined,
    load_keep_out,
    parse_keep_out,
)

TEXT = """
keep_out:
  - {name: table, plane: {point: [0, 0, -0.05], normal: [0, 0, 2]}}
  - {name: lamp, sphere: {centre: [0.08, 0, 0.12], radius: 2e-2}, margin: 0.005}
  - {name: frame, box: {centre: [0, 0.1, 0.1], size: [0.2, 0.02, 0.2], rotation: [0, 0, 0.3]}}
"""


def test_a_plane_forbids_what_lies_behind_it():
    plane = Plane((0.0, 0.0, 0.1), (0.0, 3.0, 4.0))
    points = np.array([[5.0, 0.0, 0.1], [0.0, 0.6, 0.9], [0.0, -0.6, -0.7]])
    assert plane.distance(points) == pytest.approx([0.0, 1.0, -1.0])


def test_a_box_is_as_far_as_its_nearest_face_edge_or_corner():
    box = Box((1.0, 0.0, 0.0), (0.2, 0.4, 0.6))
    points = np.array([[1.3, 0, 0], [1.4, 0.6, 0.0], [1.2, 0.3, 0.4], [1.0, 0.0, 0.0]])
    assert box.distance(points) == pytest.approx([0.2, 0.5, np.sqrt(0.03), -0.1])


def test_a_turned_box_is_the_box_among_points_turned_back():
    turn, random = 0.7, np.random.default_rng(3)
    points = random.normal(size=(50, 3))
    turned = points @ about(2, turn).T
    there = Box((0.0, 0.0, 0.0), (0.5, 1.0, 0.3), (0.0, 0.0, turn)).distance(turned)
    assert there == pytest.approx(Box((0.0, 0.0, 0.0), (0.5, 1.0, 0.3)).distance(points))


def test_no_distance_grows_faster_than_the_way():
    random = np.random.default_rng(4)
    a, b = random.normal(size=(2, 200, 3))
    away = np.linalg.norm(a - b, axis=1)
    for solid in (
        Plane((0.1, 0.2, 0.3), (1.0, -1.0, 2.0)),
        Sphere((0.2, 0.0, -0.1), 0.4),
        Box((0.2, 0.1, 0.0), (0.3, 0.6, 0.9), (0.4, -0.2, 1.0)),
    ):
        assert np.all(np.abs(solid.distance(a) - solid.distance(b)) <= away + 1e-12)


def test_the_clearance_names_the_nearest_region_and_point():
    regions = parse_keep_out(TEXT)
    near = regions.clearance([[0.0, 0.0, 0.1], [0.05, 0.0, 0.12]])
    assert (near.region, near.point) == ('lamp', 1)
    assert near.distance == pytest.approx(0.03 - 0.02 - 0.005)
    assert regions.distances(np.zeros((4, 7, 3))).shape == (3, 4, 7)


def test_without_regions_everything_is_allowed():
    for text in ('', '[]', 'keep_out: []'):
        assert not parse_keep_out(text)
    nothing = KeepOut().clearance([[0.0, 0.0, 0.0]])
    assert nothing.distance == np.inf and nothing.region == ''


def test_a_file_is_read_as_its_text_and_a_list_as_its_mapping(tmp_path):
    path = tmp_path / 'room.yaml'
    path.write_text(TEXT)
    lists = TEXT.replace('keep_out:', '')
    assert load_keep_out(path) == parse_keep_out(TEXT) == parse_keep_out(lists)
    assert load_keep_out(path).regions[0] == Region('table', Plane((0, 0, -0.05), (0, 0, 2)))


@pytest.mark.parametrize(
    ('text', 'told'),
    [
        ('keep_out: 3', 'keep_out: expected a list with at least one entry, got 3'),
        ('keepout: []', "room: keepout: expected one of keep_out, got 'keepout'"),
        ('[{name: a}]', "keep_out[0]: expected one of plane, sphere, box, got ['name']"),
        (
            '[{name: a, sphere: {centre: [0, 0, 0], radius: 1}, plane: {}}]',
            "keep_out[0]: expected one of plane, sphere, box, got 'plane, sphere'",
        ),
        (
            '[{name: a, sphere: {centre: [0, 0], radius: 1}}]',
            'keep_out[0].sphere.centre: expected a list of 3 numbers, got [0, 0]',
        ),
        (
            '[{name: a, sphere: {centre: [0, 0, 0], radius: -1}}]',
            'keep_out[0].sphere.radius: expected a finite number from 1e-06 to 100 [m], got -1',
        ),
        (
            '[{name: a, plane: {point: [0, 0, 0], normal: [0, 0, 0]}}]',
            'normal: expected a direction of some length, got [0.0, 0.0, 0.0]',
        ),
        (
            '[{name: a, box: {centre: [0, 0, 0], size: [1, 0, 1]}}]',
            'size: expected three lengths above 0 [m], got [1.0, 0.0, 1.0]',
        ),
        (
            '[{name: a, box: {centre: [0, 0, 500], size: [1, 1, 1]}}]',
            'centre: expected three numbers of at most 100 in SI units, got [0.0, 0.0, 500.0]',
        ),
        (
            '[{name: a, plane: {point: [0, 0, 0], normal: [0, 0, 1]}},'
            ' {name: a, plane: {point: [0, 0, 0], normal: [0, 0, 1]}}]',
            "keep_out: expected names that differ, got 'a'",
        ),
        ('[{name: a', 'room: line 1: '),
    ],
)
def test_what_is_wrong_is_one_line(text, told):
    with pytest.raises(TendonRobotError) as refused:
        parse_keep_out(text, 'room')
    assert told in str(refused.value) and '\n' not in str(refused.value)


def test_a_file_that_is_not_there_is_one_line(tmp_path):
    with pytest.raises(TendonRobotError, match='cannot be read'):
        load_keep_out(tmp_path / 'none.yaml')


def test_regions_of_two_texts_are_one_and_each_counts_once():
    lamp = '{name: lamp, sphere: {centre: [0.08, 0, 0.12], radius: 0.02}, margin: 0.005}'
    post = '{name: post, box: {centre: [0, 0.1, 0.1], size: [0.2, 0.02, 0.2]}}'
    made = parse_keep_out(joined(f'[{lamp}]', '', f'keep_out: [{post}, {lamp}]\n'))
    assert made == parse_keep_out(f'[{lamp}, {post}]')
    assert not parse_keep_out(joined('', ''))
    with pytest.raises(RobotDescriptionError, match='lamp'):
        joined(f'[{lamp}]', f'[{lamp.replace("0.02", "0.03")}]')
