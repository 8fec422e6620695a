"""What can be set at the driver node (docs/ros_interface.md)."""

from __future__ import annotations

from ...drivers.interface import BACKENDS
from ...drivers.safety import STOP_TIME_MIN_S
from ..shared.lifecycle import AUTOSTART
from ..shared.parameters import COMMAND_MODE, Spec

SPECS = (
    Spec(
        'robot',
        '',
        'robot description: a path, the name of a robot in config/robots, or YAML text',
        read_only=True,
    ),
    Spec(
        'backend',
        'mock',
        'what is behind the driver',
        read_only=True,
        choices=tuple(BACKENDS),
    ),
    Spec(
        'config',
        '',
        'configuration of the backend: a path, the name of a file in config, or YAML text',
        read_only=True,
    ),
    COMMAND_MODE,
    Spec('rate', 200.0, 'cycles of command and reading', 'Hz', 10.0, 1000.0, read_only=True),
    Spec('command_timeout', 0.1, 'silence after which the arm is released', 's', 0.01, 10.0),
    Spec('rate_limit', 20.0, 'largest change of a commanded tension', 'N/s', 0.01, 1000.0),
    Spec(
        'release_rate', 10.0, 'largest change of a tension during a release', 'N/s', 0.01, 1000.0
    ),
    Spec(
        'stop_time',
        0.06,
        'after a stop no motor pulls more than pretension so much later (docs/safety.md)',
        's',
        STOP_TIME_MIN_S,
        10.0,
    ),
    Spec(
        'release_to',
        'pretension',
        'end of a release: hold pretension, or torque off',
        choices=('pretension', 'limp'),
    ),
    Spec(
        'pretension',
        -1.0,
        'tension held after a release; -1: the lower tension limit',
        'N',
        -1.0,
        100.0,
        read_only=True,
    ),
    Spec(
        'pull_limit',
        0.0,
        'largest wire pull either way; 0: that of the backend',
        'm',
        0.0,
        1.0,
        read_only=True,
    ),
    Spec('pull_rate_limit', 0.05, 'largest change of a commanded wire pull', 'm/s', 1e-5, 10.0),
    Spec(
        'pull_release_rate',
        0.02,
        'largest change of a wire pull during a release',
        'm/s',
        1e-5,
        10.0,
    ),
    Spec(
        'stamp_tolerance',
        0.5,
        'largest age, and largest lead, of a stamped command',
        's',
        0.01,
        60.0,
    ),
    Spec('frame_prefix', '', 'put before frame names (backend mock: its tracker)', read_only=True),
    Spec('base_frame', '', 'frame of the base; empty: <robot>_base', read_only=True),
    Spec(
        'tendon_reference',
        '',
        'file of calibrate --check; after the power was off the status asks for the check; '
        'empty: nobody asks',
        read_only=True,
    ),
    Spec('mock_fault', '', 'backend mock: fault to inject, as overload:NAME,NAME; empty: none'),
    AUTOSTART,
)
