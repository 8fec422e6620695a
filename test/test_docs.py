"""
Every page in docs/: its commands and its Python run in order, its links lead somewhere.

The rules for blocks are those of test_readme.py; the blocks of a page share a folder.
"""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from source_tree import ROOT, files
from test_readme import BLOCK, commands

PAGES = [*files('docs/*.md'), *files('data/*.md')]
LINK = re.compile(r'\]\((?!https?:|#)([^)#\s]+)')


@pytest.mark.parametrize('page', PAGES, ids=str)
def test_the_blocks_of_a_page_run(page, tmp_path):
    for name in ('config', 'data', 'examples'):
        (tmp_path / name).symlink_to(ROOT / name)
    path = f'{Path(sys.executable).parent}:{os.environ["PATH"]}'
    for block in BLOCK.finditer((ROOT / page).read_text(encoding='utf-8')):
        if block['reason'] or block['language'] not in ('console', 'python'):
            continue
        run = ['bash', '-c', commands(block['text'])]
        if block['language'] == 'python':
            run = [sys.executable, '-c', block['text']]
        environment = os.environ | {'PATH': path, 'PYTHONPATH': str(ROOT)}
        result = subprocess.run(
            run, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=120
        )
        assert result.returncode == 0, f'{block["text"]}\n{result.stdout}{result.stderr}'


@pytest.mark.parametrize('page', PAGES, ids=str)
def test_the_links_of_a_page_lead_somewhere(page):
    for target in LINK.findall((ROOT / page).read_text(encoding='utf-8')):
        assert (ROOT / page.parent / target).exists(), f'{page}: {target}'
