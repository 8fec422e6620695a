"""One minute of random faults at 100 Hz; benchmarks/soak_dynamixel.py runs it for half an hour."""

import sys

import emulated
import processes
import pytest
from source_tree import ROOT

pytest.importorskip('dynamixel_sdk')

pytestmark = pytest.mark.slow


@pytest.mark.parametrize('mode', ['tension', 'pull'])
def test_a_minute_of_random_faults_loses_nothing_and_passes_no_limit(mode):
    run = processes.run(
        [sys.executable, 'benchmarks/soak_dynamixel.py', '--minutes', '1', '--mode', mode],
        cwd=ROOT,
        env=emulated.environment(),
    )
    assert run.returncode == 0, run.stdout + run.stderr
