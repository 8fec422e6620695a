"""The README shows what its commands on comparing a model print."""

import re

import pytest
from documents import appears, prepare, run, typed
from test_readme import README

SECTION = 'Compare your model with measurements'


def shown():
    """Yield each command of the section with the lines that the README shows after it."""
    section = README.split(f'## {SECTION}\n')[1].split('\n## ')[0]
    for block in re.findall(r'```console\n(.*?)```', section, re.S):
        yield from typed(block)


@pytest.mark.long
def test_the_commands_print_what_the_readme_shows(tmp_path):
    prepare(tmp_path)
    parts = list(shown())
    assert len(parts) == 3, 'three commands'
    for command, lines in parts:
        printed = run({'text': f'$ {command}\n', 'language': 'console'}, tmp_path, timeout=240.0)
        missing = [line for line in lines if not appears(line, printed)]
        assert not missing, f'{command}\nprints\n{printed}'
