"""The benchmarks of the whole chain, for a minute: benchmarks/soak_chain.py runs half an hour."""

import json
import sys

import emulated
import processes
import pytest
from source_tree import ROOT

pytest.importorskip('rclpy')
pytest.importorskip('dynamixel_sdk')

pytestmark = [pytest.mark.slow, pytest.mark.ros]


def run(tmp_path, script, *arguments):
    found = tmp_path / 'found.json'
    command = [sys.executable, f'benchmarks/{script}', '--json', found, '--logs', tmp_path]
    run = processes.run(
        [*command, *arguments], timeout=400.0, cwd=ROOT, env=emulated.environment()
    )
    assert found.is_file(), run.stdout + run.stderr
    return json.loads(found.read_text())


@pytest.mark.timeout(500)
@pytest.mark.parametrize('mode', ['tension', 'pull'])
def test_a_minute_of_faults_ends_no_process_and_passes_no_limit(tmp_path, mode):
    found = run(tmp_path, 'soak_chain.py', '--minutes', '1', '--mode', mode, '--busy', '1')
    assert found['died'] == []
    assert found['beyond limits'] == []
    assert found['faults'] > 0
    assert found['following'] > 0.0


@pytest.mark.timeout(500)
def test_every_stop_brings_the_arm_to_pretension(tmp_path):
    found = run(tmp_path, 'bench_stop.py', '--trials', '1')
    assert found['died'] == []
    stops = [row for row in found.values() if isinstance(row, dict)]
    assert len(stops) == 9  # kinds of stops
    assert all(row['trials'] + row['not held'] == 1 for row in stops)
    held = [row for row in stops if row['trials']]
    assert held
    assert all(row['begun_ms']['worst'] < 1e9 for row in held)
