"""What tests start dies with its test, and with the process that runs the tests."""

import os
import signal
import sys
import time
from pathlib import Path

import processes
import pytest
from forked import Forked
from processes import PIPE, Process, left, run
from source_tree import files, parse

SLEEP = 'sleep 1000 & echo $!; wait'


def gone(pid):
    """Wait until there is no such process."""
    end = time.monotonic() + 30.0
    while time.monotonic() < end:
        try:
            state = Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()[0]
        except OSError:
            return True
        if state == 'Z':
            return True
        time.sleep(0.05)
    return False


def test_a_process_ends_with_its_group():
    with Process(['bash', '-c', SLEEP], stdout=PIPE) as process:
        pid = int(process.stdout.readline())
    assert process.returncode == -signal.SIGKILL
    assert gone(pid)


def test_a_process_that_takes_too_long_is_ended():
    with pytest.raises(processes.TimeoutExpired):
        run(['sleep', '1000'], timeout=0.2)
    assert processes.started[-1].returncode == -signal.SIGKILL


def test_a_process_dies_with_the_one_that_runs_the_tests():
    code = (
        'import processes\n'
        'process = processes.Process(["sleep", "1000"])\n'
        'print(process.pid, flush=True)\n'
        'process.wait()'
    )
    with Process([sys.executable, '-c', code], cwd=Path(__file__).parent, stdout=PIPE) as tests:
        pid = int(tests.stdout.readline())
        tests.send_signal(signal.SIGKILL)  # it cannot tidy up
        assert gone(pid)


def test_what_a_process_leaves_in_another_group_is_found_and_ended():
    processes.adopt()
    before = processes.children()
    away = 'setsid sh -c "echo \\$\\$; exec sleep 1000 >/dev/null 2>&1" &'
    pid = int(run(['bash', '-c', away]).stdout)
    assert left(before, patience=0.5) == ['sleep 1000']
    assert gone(pid)
    assert left(before, patience=0.5) == []


def test_tests_start_processes_in_no_other_way():
    imports = {
        name.name
        for path in files('test/*.py')
        if path.name != 'processes.py'
        for node in parse(path).body
        if hasattr(node, 'names')
        for name in node.names
    }
    assert 'subprocess' not in imports, 'use processes.run or processes.Process'


def test_what_is_forked_has_its_own_words_place_and_surroundings(tmp_path):
    given = {**os.environ, 'PYTHONUNBUFFERED': '1'}
    with Forked(
        ['model', 'shape', '--help'], stdout=PIPE, stderr=PIPE, cwd=tmp_path, env=given
    ) as process:
        out, err = process.communicate(timeout=60.0)
    assert (process.returncode, err) == (0, '')
    assert out.startswith('usage: python -m tendon_robot_ros model shape')
    with Forked(['plot', 'none'], stdout=PIPE, stderr=PIPE, cwd=tmp_path) as process:
        out, err = process.communicate(timeout=60.0)
    assert (process.returncode, out) == (1, '')
    assert err.startswith('error: none')


def test_what_is_forked_is_a_child_and_dies_with_the_one_that_runs_the_tests():
    code = (
        'import processes\n'
        'from forked import Forked\n'
        'asks = Forked(["robot", "new"], stdin=processes.PIPE, stdout=processes.DEVNULL)\n'
        'assert asks.pid in processes.children()\n'
        'print(asks.pid, *processes.kept, flush=True)\n'
        'asks.wait()'
    )
    with Process([sys.executable, '-c', code], cwd=Path(__file__).parent, stdout=PIPE) as tests:
        pids = [int(word) for word in tests.stdout.readline().split()]
        tests.send_signal(signal.SIGKILL)
        assert len(pids) == 2
        assert all(map(gone, pids))
