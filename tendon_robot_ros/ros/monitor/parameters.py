"""The parameters of the monitor node."""

from __future__ import annotations

from typing import Any

from ...common.errors import InputError
from ...common.yaml_reading import parse_yaml
from ...monitoring import MonitorSettings
from ...monitoring.watch import ALARM_POSTURES, WatchSettings
from ..shared.parameters import Parameters, Spec

SPECS = (
    Spec(
        'model',
        '',
        'robot description to compare with: a path, the name of a robot in config/robots, or YAML '
        'text; empty: that of the controller',
        read_only=True,
    ),
    Spec('effects', [''], 'Python files with effects of your own (they are executed)'),
    Spec('controller', 'controller', 'name of the controller node', read_only=True),
    Spec(
        'markers',
        '',
        'YAML list of {name, arc_length, offset} in metres, as poses[i] of measured_shape; empty: '
        'one at the end of every cell',
        read_only=True,
    ),
    Spec(
        'measured_markers',
        '',
        'YAML mapping {marker: topic} of PoseStamped topics; empty: measured_shape, or '
        'measured_tip where there is no shape',
        read_only=True,
    ),
    Spec('folder', 'monitor', 'where recordings go, a folder each', read_only=True),
    Spec('partial', False, 'add what was found even if more is at work'),
    Spec('still_time', 0.6, 'time to stand still before a posture counts', 's', 0.1, 30.0, True),
    Spec('still_speed', 0.002, 'speed below which the arm is still', 'm/s', 1e-6, 1.0, True),
    Spec('rolling', 1.0, 'time over which the rolling error is taken', 's', 0.05, 600.0, True),
    Spec(
        'position_noise',
        0.0,
        '1 sd of a recorded mean position; 0: from the frames of the posture',
        'm',
        0.0,
        0.1,
        True,
    ),
    Spec('setting_noise', 0.002, 'relative 1 sd of a measured input', '', 0.0, 0.5, True),
    Spec(
        'path',
        'sequence',
        'how recorded postures are taken: one after the other, or each by itself, which is faster '
        'and cannot test friction_memory',
        choices=('sequence', 'from_straight'),
        read_only=True,
    ),
    Spec(
        'force_rate',
        0.0,
        'times a second that the force at the tip is estimated; 0: never',
        'Hz',
        0.0,
        100.0,
        True,
    ),
    Spec(
        'force_time',
        3.0,
        'longest time over which frames are averaged for it, while neither tensions nor the arm '
        'change by more than chance',
        's',
        0.0,
        60.0,
        True,
    ),
    Spec(
        'reference_postures',
        0.0,
        'postures at which the arm is learned, free of any touch, before drift is watched; 0: not '
        'watched',
        '',
        0.0,
        10000.0,
        True,
    ),
    Spec(
        'alarm_postures',
        ALARM_POSTURES,
        'without a change no alarm before so many postures, on average',
        '',
        10.0,
        1e9,
        True,
    ),
    Spec(
        'adapt',
        False,
        'parameters of the added effects follow the arm slowly, within their intervals',
    ),
    Spec('tracker_noise', 2e-4, '1 sd of a coordinate of a marker', 'm', 1e-7, 0.1, True),
    Spec('base_frame', '', 'frame of the base; empty: <robot>_base', read_only=True),
    Spec('frame_prefix', '', 'put before frame names', read_only=True),
    Spec('stamp_tolerance', 0.5, 'largest age, and largest lead, of a stamp', 's', 0.01, 60.0),
    Spec(
        'tracker_transform',
        '',
        'x y z qx qy qz qw of the frame of the tracker in that of the base [m]; empty: the '
        'tracker measures in the base frame, or TF knows',
        read_only=True,
    ),
)


def settings(parameters: Parameters) -> MonitorSettings:
    """Return what the core is told."""
    names = ('still_time', 'still_speed', 'rolling', 'position_noise', 'setting_noise', 'path')
    return MonitorSettings(**{name: parameters[name] for name in names})


def watched(parameters: Parameters) -> WatchSettings:
    """Return how drift and force are watched."""
    return WatchSettings(
        int(parameters['reference_postures']) or 30,
        parameters['alarm_postures'],
        parameters['tracker_noise'],
    )


def parsed(parameters: Parameters, name: str, kind: type) -> Any:
    """Return a YAML parameter of a kind; empty where nothing is given."""
    try:
        value = parse_yaml(parameters[name]) or kind()
    except ValueError as error:
        raise InputError(f'{name}: not valid YAML: {error}') from None
    if not isinstance(value, kind):
        raise InputError(f'{name}: expected a YAML {kind.__name__}, got {value!r}')
    return value
