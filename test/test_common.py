"""Rotations in their three forms, and the colours that mean something."""

import errno
import os
import re
import sys

import numpy as np
import processes
import pytest
from hypothesis import given
from hypothesis import strategies as st
from source_tree import ROOT, files

from tendon_robot_ros.common import colours
from tendon_robot_ros.common.colours import COLOURS, ERROR, MEASURED, PREDICTED, rgb
from tendon_robot_ros.common.errors import DataSetError
from tendon_robot_ros.common.files import new_file
from tendon_robot_ros.common.rotations import (
    about,
    bent,
    from_quaternion,
    from_rotation_vector,
    quaternions,
    rigid_fit,
    towards,
)

ANGLE = st.floats(-3.1, 3.1)
VECTOR = st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda v: np.linalg.norm(v) > 0.1)


@given(st.tuples(*[st.floats(-1.0, 1.0)] * 4).filter(lambda q: np.linalg.norm(q) > 0.1))
def test_a_quaternion_becomes_the_rotation_that_becomes_it_again(numbers):
    quaternion = np.array(numbers) / np.linalg.norm(numbers)
    rotation = from_quaternion(quaternion.tolist())
    assert rotation @ rotation.T == pytest.approx(np.eye(3), abs=1e-9)
    back = quaternions(rotation[None])[0]
    assert abs(back @ quaternion) == pytest.approx(1.0, abs=1e-9)


def test_half_turns_have_quaternions_too():
    turns = np.array([np.diag(d) for d in ([1.0, -1, -1], [-1, 1, -1], [-1, -1, 1], [1, 1, 1])])
    assert np.abs(quaternions(turns)) == pytest.approx(np.eye(4), abs=1e-12)
    assert towards(np.array([0.0, 0.0, -1.0]))[:, 2].tolist() == [0.0, 0.0, -1.0]


@given(ANGLE)
def test_bending_towards_an_axis_turns_about_the_other(angle):
    assert bent(np.array([1.0, 0.0]), np.array(angle)) == pytest.approx(about(1, angle), abs=1e-12)
    assert bent(np.array([0.0, 1.0]), np.array(angle)) == pytest.approx(
        about(0, -angle), abs=1e-12
    )


@given(ANGLE, st.integers(0, 1))
def test_a_rotation_vector_turns_as_the_matrix_does(angle, axis):
    vector = np.array([0.6, 0.0, 0.8])
    turned = from_rotation_vector(angle * np.eye(3)[axis]) @ vector
    assert turned == pytest.approx(about(axis, angle) @ vector, abs=1e-9)


@given(VECTOR)
def test_the_shortest_turn_towards_a_direction_ends_there(direction):
    direction = np.array(direction) / np.linalg.norm(direction)
    assert towards(direction)[:, 2] == pytest.approx(direction, abs=1e-9)


def test_no_model_has_the_colour_of_what_was_measured():
    assert MEASURED not in COLOURS and ERROR not in COLOURS
    assert COLOURS[0] == PREDICTED
    assert rgb(MEASURED) == (213, 94, 0)


def contrast(one, other):
    """Return the contrast of two colours as WCAG 2.2 computes it, 1 to 21."""
    lights = []
    for colour in (one, other):
        shares = np.array(rgb(colour)) / 255.0
        linear = np.where(shares <= 0.04045, shares / 12.92, ((shares + 0.055) / 1.055) ** 2.4)
        lights.append(float(linear @ [0.2126, 0.7152, 0.0722]))
    return (max(lights) + 0.05) / (min(lights) + 0.05)


def test_contrast_is_that_of_the_standard():
    assert contrast('#000000', '#ffffff') == pytest.approx(21.0)
    assert contrast('#777777', '#ffffff') == pytest.approx(4.48, abs=0.01)


def test_words_and_graphics_of_the_palette_stand_out():
    text = (ROOT / 'tendon_robot_ros/report/page.css').read_text()
    css = dict(re.findall(r'--(\w+): (#\w{6})', text))
    words = {colours.INK, colours.ERROR, colours.FLOOR, colours.ORANGE, css['soft'],
             *colours.KINDS.values()}  # fmt: skip
    graphics = {MEASURED, colours.REST, colours.LEFT_OUT, *COLOURS, *colours.KINDS.values()}
    for paper in ('#ffffff', css['tint']):
        assert {c: contrast(c, paper) for c in words if contrast(c, paper) < 4.5} == {}
        assert {c: contrast(c, paper) for c in graphics if contrast(c, paper) < 3.0} == {}


def test_colours_stand_in_the_palette_only():
    """A grid or a paper may be as faint as it likes; what tells something is in the palette."""
    known = {value.lower() for value in vars(colours).values() if isinstance(value, str)}
    wrong = []
    for path in files('tendon_robot_ros/*.py'):
        if path.match('common/colours.py'):
            continue
        wrong += [
            f'{path}: {colour}'
            for colour in re.findall(r'#[0-9a-fA-F]{6}\b', (ROOT / path).read_text())
            if colour.lower() in known or contrast(colour, '#ffffff') > 1.9
        ]
    assert not wrong, '\n'.join(wrong)


@given(ANGLE, st.integers(0, 2))
def test_points_that_turned_about_an_axis_are_laid_back(angle, axis):
    points = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.2], [0.0, 2.0, 0.1], [0.3, 0.1, 3.0]])
    shift = np.array([0.4, -0.2, 0.1])
    turned = points @ about(axis, angle).T + shift
    turn, moved = rigid_fit(points, turned, axis=np.eye(3)[axis])
    np.testing.assert_allclose(turn, about(axis, angle), atol=1e-9)
    np.testing.assert_allclose(moved, shift, atol=1e-9)
    tilted = points @ about((axis + 1) % 3, 0.3).T  # what another axis does stays
    turn, _ = rigid_fit(points, tilted, axis=np.eye(3)[axis])
    np.testing.assert_allclose(turn @ np.eye(3)[axis], np.eye(3)[axis], atol=1e-9)


def test_a_full_disk_names_the_file_that_was_to_be_written(tmp_path):
    path = tmp_path / 'run.csv'
    full = pytest.raises(DataSetError, match=r'run.csv: cannot be written \(No space left')
    with full, new_file(path):
        raise OSError(errno.ENOSPC, 'No space left on device')
    assert not list(tmp_path.iterdir())


def test_compiled_python_is_kept_where_it_may_not_lie_beside_its_sources(tmp_path):
    own = {
        'PYTHONDONTWRITEBYTECODE': '1',
        'NUMBA_CACHE_DIR': str(tmp_path),
        'PYTHONPATH': str(ROOT),
    }
    command = [sys.executable, '-m', 'tendon_robot_ros', 'model', 'reach', '--help']
    assert processes.run(command, env={**os.environ, **own}).returncode == 0
    assert any((tmp_path / 'bytecode').rglob('cli/model.*.pyc'))
