"""Whatever targets, twists and states come, commands stay within limits and rates."""

import contextlib

import numpy as np
import pytest
from control_rig import CYCLE, model
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tendon_robot_ros.common.errors import TendonRobotError
from tendon_robot_ros.control import ControllerCore, Settings, Target, Twist, inputs

RATE = 4.0

anything = st.floats(allow_nan=True, allow_infinity=True)
near = st.floats(-0.25, 0.25)
triples = st.tuples(near, near, near) | st.tuples(anything, anything, anything)
quadruples = st.tuples(anything, anything, anything, anything) | st.just(
    (0.0, 0.7071, 0.0, 0.7071)
)
tensions = st.lists(st.floats(0.0, 6.0) | anything, min_size=4, max_size=4)
messages = st.one_of(
    st.tuples(st.just('pose'), triples, quadruples),
    st.tuples(st.just('point'), triples),
    st.tuples(st.just('twist'), triples, triples, st.booleans()),
    st.tuples(st.just('states'), tensions),
    st.tuples(st.sampled_from(['stop', 'reset', 'driver stops', 'driver follows', 'nothing'])),
)


def tell(core, now, kind, *values):
    """Do what the node does with a message."""
    if kind == 'pose':
        direction = inputs.direction(values[1], kind)
        core.aim(Target(inputs.position(values[0], 0.4, kind), direction))
    elif kind == 'point':
        core.aim(Target(inputs.position(values[0], 0.4, kind)))
    elif kind == 'twist':
        core.twist(
            now, Twist(inputs.finite(values[0], kind), inputs.finite(values[1], kind), values[2])
        )
    elif kind == 'states':
        core.measured(now, np.array(values[0]), np.zeros(4))
    elif kind == 'stop':
        core.latch.stop('stop', 'stop was called')
    elif kind == 'reset':
        core.reset()
    elif kind.startswith('driver'):
        core.driver_reports('it says so' if kind == 'driver stops' else '')


FACING = (0.0, 0.7071, 0.0, 0.7071)  # along +x


@pytest.mark.filterwarnings('ignore::RuntimeWarning')  # squares of 1e308
@settings(max_examples=60)
@given(st.lists(messages, max_size=25), st.booleans())
@example(
    [('pose', (0.0, 0.0, 0.0), FACING), ('twist', (0.0,) * 3, (0.0, 0.0, 5e156), False)], False
)
def test_no_sequence_of_messages_breaks_limits_or_rates(sequence, pull_mode):
    core = ControllerCore(model(), Settings(rate_limit=RATE, pull_mode=pull_mode))
    low, high = core.limits.T
    now, before, began_again = 0.0, None, True
    core.measured(now, np.full(4, 0.3), np.zeros(4))
    for message in sequence:
        began_again |= message[0] in ('states', 'reset') or message[0].startswith('driver')
        with contextlib.suppress(TendonRobotError):
            tell(core, now, *message)
        for _ in range(3):
            now += CYCLE
            output = core.step(now)
            if output is None:
                began_again = True
                continue
            assert np.all((output.tensions >= low) & (output.tensions <= high))
            assert output.pulls is None or np.all(np.isfinite(output.pulls))
            if not began_again:
                assert np.abs(output.tensions - before).max() <= RATE * CYCLE * (1 + 1e-9)
            before, began_again = output.tensions, False
