"""The README's commands run, in its order; how blocks are marked: documents.py."""

from pathlib import Path

import pytest
from documents import blocks, prepare, run, runs, text_of

README = text_of(Path('README.md'))


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    """Make the folder in which all blocks run."""
    return prepare(tmp_path_factory.mktemp('readme'))


@pytest.mark.parametrize(
    'block', blocks(README), ids=lambda block: block['text'].split('\n')[0][:60]
)
def test_the_blocks_of_the_readme_run(block, folder):
    if not runs(block, slow=False):
        pytest.skip(block['reason'] or 'no commands')
    run(block, folder)
