"""The demo reaches its postures, draws them, ends by itself and leaves nothing behind."""

import os
import re
from contextlib import nullcontext
from pathlib import Path
from unittest.mock import MagicMock

import numpy as np
import processes
import pytest
from forked import Forked

pytest.importorskip('rclpy')

from tendon_robot_ros.common.errors import TendonRobotError
from tendon_robot_ros.ros.commands import demo as command

pytestmark = [pytest.mark.ros, pytest.mark.long]
ROOT = Path(__file__).parents[1]


def children(namespace):
    """List processes of a demo that still run."""
    found = []
    for path in Path('/proc').glob('[0-9]*/cmdline'):
        try:
            if namespace.encode() in path.read_bytes():
                found.append(path.parent.name)
        except OSError:
            continue
    return found


def demo(kind, command, folder):
    return kind(
        command,
        cwd=folder,
        stdout=processes.PIPE,
        stderr=processes.PIPE,
        env={**os.environ, 'PYTHONPATH': str(ROOT)},
    )


def test_the_demo_reaches_its_postures(tmp_path):
    process = demo(processes.Process, processes.package('demo'), tmp_path)
    out, err = process.communicate(timeout=150)
    assert process.returncode == 0, out + err
    rows = {line[:20].strip(): line for line in out.splitlines()}
    for name in (
        'highest, 180° view',
        'middle, 180° view',
        'lowest, 180° view',
        'S-shape, 45° view',
    ):
        miss = float(re.search(r'([\d.]+) mm', rows[name]).group(1))
        assert miss < 0.5
        assert ' reached ' in rows[name]
    assert re.search(r'nearest|at_limit', rows['out of reach'])
    assert (tmp_path / 'demo' / 'postures.png').stat().st_size > 10_000
    assert children(f'/demo_{process.pid}') == []


def test_a_posture_that_is_not_reached_is_named_and_the_exit_code_is_1(monkeypatch):
    def go(pilot, posture):
        status = 'no_driver' if posture.name.startswith('middle') else 'reached'
        return command.Outcome(posture, np.zeros(3), 1e-4, np.zeros(4), status, '')

    for name, stand_in in {
        'go': go,
        'draw': lambda *given: None,
        **dict.fromkeys(
            ('ros', 'NodeProcess', 'Pilot'), lambda *_, **__: nullcontext(MagicMock())
        ),
    }.items():
        monkeypatch.setattr(command, name, stand_in)
    with pytest.raises(TendonRobotError, match=r'missed by more than 0\.3 mm: middle'):
        command.main([])


def test_an_interrupted_demo_leaves_no_processes(tmp_path):
    process = demo(Forked, ['demo'], tmp_path)
    namespace = f'/demo_{process.pid}'
    processes.until(lambda: len(children(namespace)) == 2, 'both nodes', 120)
    process.kill()  # it cannot tidy up: the kernel tells its children
    process.communicate()
    # one that still begins hears of it when it has begun
    processes.until(lambda: children(namespace) == [], 'their end', 60)
