"""The parameters of the controller node."""

from __future__ import annotations

from ...control import Settings
from ..shared.lifecycle import AUTOSTART
from ..shared.parameters import COMMAND_MODE, Parameters, Spec

SPECS = (
    Spec(
        'model',
        '',
        'robot description with its effects: a path, the name of a robot in '
        'config/robots, or YAML text; reloads at run time',
    ),
    Spec(
        'effects',
        [''],
        'Python files with effects of your own (they are executed); read when a model is loaded',
    ),
    COMMAND_MODE,
    Spec('rate', 200.0, 'commands per second', 'Hz', 10.0, 1000.0, read_only=True),
    Spec(
        'shape_rate',
        30.0,
        'predicted shapes, tips and markers per second',
        'Hz',
        1.0,
        200.0,
        read_only=True,
    ),
    Spec('rate_limit', 10.0, 'largest change of a tension', 'N/s', 0.01, 1000.0),
    Spec(
        'state_timeout',
        0.25,
        'silence of tendon_states after which the driver counts as gone',
        's',
        0.02,
        10.0,
    ),
    Spec('twist_timeout', 0.1, 'silence of delta_twist after which the tip stops', 's', 0.02, 2.0),
    Spec(
        'no_equilibrium_timeout',
        0.5,
        'time without equilibrium after which the arm is released',
        's',
        0.0,
        10.0,
    ),
    Spec(
        'resume',
        False,
        'go on to the old target when the driver comes back, instead of holding where the arm is',
    ),
    Spec('stamp_tolerance', 0.5, 'largest age, and largest lead, of a stamp', 's', 0.01, 60.0),
    Spec('hold_direction', False, 'keep the view while a twist moves the tip'),
    Spec(
        'direction_weight',
        0.0,
        'how much a radian counts against position; 0: a fifth of the length of the robot',
        'm/rad',
        0.0,
        10.0,
    ),
    Spec(
        'tip_gain',
        0.0,
        'closed loop on measured_tip: share of the error removed per second; 0: open loop',
        '1/s',
        0.0,
        10.0,
    ),
    Spec('base_frame', '', 'frame of the base; empty: <robot>_base', read_only=True),
    Spec('tip_frame', '', 'frame of the tip; empty: <robot>_tip', read_only=True),
    Spec('frame_prefix', '', 'put before frame names', read_only=True),
    Spec(
        'driver_status',
        'driver/status',
        'topic of the status of the driver; empty: none',
        read_only=True,
    ),
    AUTOSTART,
)


def settings(parameters: Parameters) -> Settings:
    """Return what the core is told."""
    return Settings(
        rate_limit=parameters['rate_limit'],
        state_timeout=parameters['state_timeout'],
        twist_timeout=parameters['twist_timeout'],
        patience=parameters['no_equilibrium_timeout'],
        hold_direction=parameters['hold_direction'],
        direction_weight=parameters['direction_weight'],
        pull_mode=parameters['command_mode'] == 'pull',
        tip_gain=parameters['tip_gain'],
        resume=parameters['resume'],
    )
