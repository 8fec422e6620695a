"""The rate limit moves on a straight line."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tendon_robot_ros.drivers.safety import approach


@given(st.lists(st.tuples(*[st.floats(-10, 10)] * 2), min_size=1), st.floats(0.0, 3.0))
def test_approach_moves_straight_and_at_most_by_the_step(goals, step):
    current = np.zeros(2)
    for goal in goals:
        after = approach(current, np.array(goal), np.full(2, step))
        assert np.all(np.abs(after - current) <= step * (1 + 1e-12) + 1e-15)
        way, done = np.array(goal) - current, after - current
        assert abs(way[0] * done[1] - way[1] * done[0]) < 1e-9
        current = after
