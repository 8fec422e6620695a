"""The parameters of the controller node."""

from __future__ import annotations

import math

from ...common.errors import InputError
from ...control import Settings
from ...control.approach import APPROACHES
from ...model.tip_task import Preferences
from ...robot.keep_out import KeepOut, parse_keep_out, text_of
from ..shared.lifecycle import AUTOSTART
from ..shared.parameters import COMMAND_MODE, Parameters, Spec

REGIONS_MAX = 50  # every one is looked at on every way
PREFERRED = 'low_tension', 'stiffness', 'slack', 'limit', 'smooth'
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
        'go on to the old target when the driver comes back or its release is over, instead of '
        'holding where the arm is',
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
        'closed loop on measured_tip: share of a lasting error removed per second; 0: open loop',
        '1/s',
        0.0,
        10.0,
    ),
    Spec(
        'approach',
        'any',
        'the last leg of the way to a target: any; from_below: from straight, friction has '
        'forgotten',
        choices=APPROACHES,
    ),
    Spec(
        'keep_out',
        '',
        'regions that no part of the arm may enter: the path of a YAML file, or its text',
    ),
    Spec('look_ahead', 0.0, 'by which a stream of targets is led', 's', 0.0, 0.5),
    Spec('drive_lag', 0.0, 'of first order, of tensions behind their commands', 's', 0.0, 0.5),
    Spec('tracker_delay', 0.0, 'from what the tracker sees to measured_tip', 's', 0.0, 0.5),
    Spec('prefer_low_tension', 0.0, 'weight of little tension', '1', 0.0, 1e3),
    Spec('prefer_stiffness', 0.0, 'weight of a tip that gives way little', '1', 0.0, 1e3),
    Spec(
        'prefer_stiffness_along',
        '',
        'direction of prefer_stiffness in the base frame, as "x y z"; empty: that in which the '
        'tip is softest',
    ),
    Spec(
        'prefer_stiffness_enough',
        0.0,
        'stiffness along it beyond which nothing is gained; 0: there is no such',
        'N/m',
        0.0,
        1e6,
    ),
    Spec('prefer_slack', 0.0, 'weight of distance from the lowest tension', '1', 0.0, 1e3),
    Spec('prefer_limit', 0.0, 'weight of distance from the highest tension', '1', 0.0, 1e3),
    Spec('prefer_smooth', 0.0, 'weight of little change of the tensions', '1', 0.0, 1e3),
    Spec('prefer_margin', 0.1, 'distance wanted, as a share of the range', '1', 0.001, 0.5),
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


def keep_out_of(text: str) -> KeepOut:
    """Read regions from the path of a file, or from YAML text."""
    inside = text_of(text)
    made = parse_keep_out(inside, 'keep_out' if inside == text else text)
    if len(made.regions) > REGIONS_MAX:
        raise InputError(
            f'keep_out: expected at most {REGIONS_MAX} regions, got {len(made.regions)}'
        )
    return made


def direction_of(text: str) -> tuple[float, float, float]:
    """Read a direction; zeros where there is none."""
    if not text.strip():
        return 0.0, 0.0, 0.0
    try:
        x, y, z = (float(word) for word in text.replace(',', ' ').split())
    except ValueError:
        raise InputError(f'prefer_stiffness_along: expected "x y z", got {text!r}') from None
    if not 1e-9 < math.hypot(x, y, z) < math.inf:
        raise InputError(f'prefer_stiffness_along: expected some length, got {text!r}')
    return x, y, z


def preferences(parameters: Parameters) -> Preferences | None:
    """Return what is preferred; None: all weights are 0."""
    weights = {name: parameters[f'prefer_{name}'] for name in PREFERRED}
    if not any(weights.values()):
        return None
    return Preferences(
        **weights,
        margin=parameters['prefer_margin'],
        stiffness_direction=direction_of(parameters['prefer_stiffness_along']),
        stiffness_enough=parameters['prefer_stiffness_enough'],
    )


def settings(parameters: Parameters, keep_out: KeepOut) -> Settings:
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
        approach=parameters['approach'],
        preferences=preferences(parameters),
        keep_out=keep_out,
        look_ahead=parameters['look_ahead'],
        drive_lag=parameters['drive_lag'],
        tracker_delay=parameters['tracker_delay'],
    )
