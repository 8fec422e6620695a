"""The README shows what its commands on comparing a model print."""

import os
import re
import subprocess
import sys
from pathlib import Path

from source_tree import ROOT
from test_readme import README

SECTION = 'Compare your model with measurements'


def shown():
    """Yield each command of the section with the lines that the README shows after it."""
    section = README.split(f'## {SECTION}\n')[1].split('\n## ')[0]
    for block in re.findall(r'```console\n(.*?)```', section, re.S):
        for part in re.split(r'^\$ ', block, flags=re.M)[1:]:
            command = re.match(r'(?:[^\n]*\\\n)*[^\n]*', part)[0]
            yield command, [line for line in part[len(command) :].splitlines() if line.strip()]


def plain(line):
    return ' '.join(line.split())


def test_the_commands_print_what_the_readme_shows(tmp_path):
    for name in ('config', 'data'):
        (tmp_path / name).symlink_to(ROOT / name)
    path = f'{Path(sys.executable).parent}:{os.environ["PATH"]}'
    environment = os.environ | {'PATH': path, 'PYTHONPATH': str(ROOT)}
    parts = list(shown())
    assert len(parts) == 5, 'five commands'
    for command, lines in parts:
        run = subprocess.run(
            ['bash', '-c', command], cwd=tmp_path, env=environment, capture_output=True, text=True
        )
        assert run.returncode == 0, run.stderr
        printed = [plain(line) for line in run.stdout.splitlines()]
        missing = [line for line in lines if line != '...' and plain(line) not in printed]
        assert not missing, f'{command}\nprints\n{run.stdout}'
