"""
The README's commands run, in its order.

In a ```console block every line that begins with `$ ` is a command (a backslash at its end
continues it), all other lines show output. ```python blocks run as they stand. The blocks share
one folder, so that a later one finds the files of an earlier one; it holds links to config/, data/
and examples/, and `python` is the one that runs the tests. A block is left out if the line before
it says

    <!-- not run: the reason -->
"""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from source_tree import ROOT

BLOCK = re.compile(
    r'^(?:<!-- not run: (?P<reason>[^\n]+) -->\n)?```(?P<language>\w*)\n(?P<text>.*?)^```$',
    re.M | re.S,
)
README = (ROOT / 'README.md').read_text(encoding='utf-8')
BLOCKS = [match.groupdict() for match in BLOCK.finditer(README)]
SHELLS = {'bash', 'sh', 'shell', 'zsh'}


def commands(text):
    """Return the commands of a console block as one script that stops at the first failure."""
    found = re.findall(r'^\$ ((?:[^\n]*\\\n)*[^\n]*)$', text, re.M)
    return '\n'.join(['set -e', *found])


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    """Make the folder in which all blocks run."""
    folder = tmp_path_factory.mktemp('readme')
    for name in ('config', 'data', 'examples'):
        (folder / name).symlink_to(ROOT / name)
    return folder


@pytest.mark.parametrize('block', BLOCKS, ids=lambda block: block['text'].split('\n')[0][:60])
def test_the_blocks_of_the_readme_run(block, folder):
    if block['reason'] or block['language'] not in ('console', 'python'):
        pytest.skip(block['reason'] or 'no commands')
    run = ['bash', '-c', commands(block['text'])]
    if block['language'] == 'python':
        run = [sys.executable, '-c', block['text']]
    path = f'{Path(sys.executable).parent}:{os.environ["PATH"]}'
    result = subprocess.run(
        run,
        cwd=folder,
        env=os.environ | {'PATH': path},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert result.returncode == 0, f'{block["text"]}\n{result.stdout}{result.stderr}'


def test_no_block_escapes():
    assert 2 * len(BLOCKS) == len(re.findall(r'^```', README, re.M))
    assert not SHELLS & {block['language'] for block in BLOCKS}, 'commands stand in console blocks'
    for block in BLOCKS:
        if block['language'] == 'console':
            assert '\n$ ' in f'\n{block["text"]}', 'a command begins with "$ "'


def test_commands_are_told_from_their_output():
    text = '$ python -m x \\\n    --more\nsome output\n$ ls\n'
    assert commands(text) == 'set -e\npython -m x \\\n    --more\nls'
