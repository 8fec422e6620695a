"""Joint messages read from their bytes are what rclpy makes of them, or no message at all."""

import struct

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

pytest.importorskip('rclpy')

from builtin_interfaces.msg import Time
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from tendon_robot_ros.ros.shared import joints
from tendon_robot_ros.ros.shared.joints import JointReader
from tendon_robot_ros.ros.shared.messages import seconds

texts = st.text(st.characters(codec='utf-8', exclude_characters='\0'), max_size=9)
numbers = st.lists(st.floats(), max_size=4)
stamps = st.builds(Time, sec=st.integers(-(2**31), 2**31 - 1), nanosec=st.integers(0, 2**32 - 1))
messages = st.builds(
    JointState,
    header=st.builds(Header, stamp=stamps, frame_id=texts),
    name=st.lists(texts, max_size=4),
    position=numbers,
    velocity=numbers,
    effort=numbers,
)
ARM = JointState(
    header=Header(frame_id='kato_10_1_base'),
    name=['prox_left', 'prox_right', 'dist_left'],
    position=[0.001, 0.002, -0.003],
    effort=[0.1, 0.2, np.nan],
)


def expected(data):
    """Return what rclpy reads, None for nothing."""
    try:
        return deserialize_message(data, JointState)
    except rclpy_implementation.RMWError:
        return None


def same(read, message):
    """Compare, also what is no number."""
    assert read.stamp == pytest.approx(seconds(message.header.stamp), abs=0.0)
    assert list(read.names) == list(message.name)
    for values, wanted in ((read.position, message.position), (read.effort, message.effort)):
        np.testing.assert_array_equal(np.array(values), np.array(wanted))


def refilled(message, values):
    """Return a message with the same names and other values, as a node sends one."""
    stamp = Time(sec=int(values[0]) % 2**31, nanosec=7)
    fields = {
        key: np.resize(values, len(getattr(message, key))).tolist()
        for key in ('position', 'velocity', 'effort')
    }
    header = Header(stamp=stamp, frame_id=message.header.frame_id)
    return JointState(header=header, name=message.name, **fields)


@given(st.lists(messages, min_size=1, max_size=3), st.lists(st.integers(0, 999), min_size=1))
@example([JointState()], [1])
@example([ARM, JointState(), ARM], [5, 6, 7])
def test_whatever_comes_after_whatever_is_read_as_rclpy_reads_it(different, values):
    read = JointReader()
    for message in different:
        for one in (message, refilled(message, values), message):
            same(read(serialize_message(one)), one)


def test_what_is_laid_out_as_the_last_one_is_not_read_anew(monkeypatch):
    asked = []
    monkeypatch.setattr(
        joints,
        'deserialize_message',
        lambda *given: asked.append(1) or deserialize_message(*given),
    )
    read = JointReader()
    for i in range(5):
        one = refilled(ARM, [float(i), 2.0 * i])
        same(read(serialize_message(one)), one)
    assert len(asked) == 1
    turned = JointState(header=ARM.header, name=ARM.name[::-1], effort=ARM.effort)
    for one in (turned, ARM, turned):
        same(read(serialize_message(one)), one)
    assert len(asked) == 4


@given(messages, st.data())
def test_a_message_that_is_cut_short_is_none_and_the_next_one_is_read(message, data):
    whole, read = serialize_message(message), JointReader()
    read(whole)
    cut = whole[: data.draw(st.integers(0, len(whole) - 1))]
    if expected(cut) is None:
        with pytest.raises(rclpy_implementation.RMWError):
            read(cut)
    else:  # only what fills it up is missing
        same(read(cut), expected(cut))
    same(read(whole), message)


@given(st.data())
def test_a_message_with_any_byte_wrong_is_read_as_rclpy_reads_it(data):
    whole, read = bytearray(serialize_message(ARM)), JointReader()
    read(bytes(whole))
    whole[data.draw(st.integers(0, len(whole) - 1))] ^= data.draw(st.integers(1, 255))
    message = expected(bytes(whole))
    if message is None:
        with pytest.raises(rclpy_implementation.RMWError):
            read(bytes(whole))
    else:
        same(read(bytes(whole)), message)


def test_numbers_with_the_high_byte_first_are_read_too():
    head = struct.pack('>4xiI', 12, 5 * 10**8)
    text = struct.pack('>I6s2x', 6, b'frame\0')
    name = struct.pack('>II2s2x', 1, 2, b'a\0')
    values = struct.pack('>I4xdIId', 1, 0.25, 0, 1, -3.0)
    assert len(head + text + name) % 8 == 4, (
        'aligned to 8 behind the first four bytes, and a count'
    )
    read = JointReader()
    for _ in range(2):
        found = read(head + text + name + values)
        assert (found.stamp, list(found.names)) == (12.5, ['a'])
        assert (list(found.position), list(found.effort)) == ([0.25], [-3.0])
