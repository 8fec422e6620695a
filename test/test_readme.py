"""The README's commands run, in its order; how blocks are marked: documents.py."""

from pathlib import Path
from types import SimpleNamespace

import pytest
from documents import blocks, prepare, run, runs, text_of

import tendon_robot_ros

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


def test_the_snippet_of_the_readme_ends_well_where_nothing_is_found(monkeypatch):
    monkeypatch.setattr(
        tendon_robot_ros, 'load_dataset', lambda *_: SimpleNamespace(), raising=False
    )
    for name in ('compare', 'diagnose'):
        monkeypatch.setattr(
            tendon_robot_ros, name, lambda *_: SimpleNamespace(effects=()), raising=False
        )
    snippet = next(
        block['text'] for block in blocks(README) if 'diagnose(dataset)' in block['text']
    )
    exec(compile(snippet, 'README.md', 'exec'), {})
