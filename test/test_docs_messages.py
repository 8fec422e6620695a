"""Every message that a page quotes is one that the code can print."""

import ast
import functools
import re

import pytest
from source_tree import ROOT, files, parse

from tendon_robot_ros.diagnosis.verdict import Verdict

GAP = '\0'
# what differs from one printed message to the next
VARYING = re.compile(r"…|<[^>]*>|'[^']*'|\b\d+(?:\.\d+)?")
PAGES = {
    'docs/troubleshooting.md': ('Start', 'Robot description, model', 'Controller', 'Driver')
    + ('Compare and diagnose',),
    'docs/data_sets.md': ('When something is refused',),
}


def flat(node):
    """Return the text of a string in the source, with a gap for everything put into it."""
    if isinstance(node, ast.Constant):
        return node.value
    if isinstance(node, ast.BinOp):
        return flat(node.left) + flat(node.right)
    if isinstance(node, ast.JoinedStr):
        return ''.join(flat(v) if isinstance(v, ast.Constant) else GAP for v in node.values)
    return GAP


@functools.cache
def templates():
    """Return all texts in the sources, and those that a class of exceptions puts together."""
    found = set()
    for path in [*files('tendon_robot_ros/*.py'), *files('examples/*.py')]:
        for node in ast.walk(parse(path)):
            if isinstance(node, ast.JoinedStr) or (
                isinstance(node, ast.Constant) and isinstance(node.value, str)
            ):
                found.add(flat(node))
            if isinstance(node, ast.Call) and getattr(node.func, 'id', '') == 'DataSetError':
                found.add('; '.join(flat(argument) for argument in node.args[1:]))
    texts = {re.sub(r'\{[\w:.]*\}|%[sdg]', GAP, text) for text in found}
    return [VARYING.sub(GAP, text) for text in texts if len(text) > 8]


def pieces(message):
    """Return what a quoted message says whatever the case."""
    found = VARYING.sub(GAP, message).split(GAP)
    return [piece.strip(' :;,') for piece in found if re.search(r'\w', piece)]


def is_printed(message):
    """Tell whether one text of the sources has all pieces in this order."""
    wanted = pieces(message)
    pattern = re.compile('.*'.join(re.escape(piece) for piece in wanted), re.S)
    return bool(wanted) and any(pattern.search(text) for text in templates())


def quoted(page):
    """Yield the messages in the first column of the tables of a page."""
    text = (ROOT / page).read_text(encoding='utf-8')
    for title in PAGES[page]:
        section = text.split(f'\n## {title}\n')[1].split('\n## ')[0]
        for cell in re.findall(r'^\| (`.*?) \|', section, re.M):
            yield from re.findall(r'`([^`]+)`', cell)


@pytest.mark.parametrize(('page', 'message'), [(p, m) for p in PAGES for m in quoted(p)])
def test_a_quoted_message_is_in_the_sources(page, message):
    assert is_printed(message), f'{page}: no such message in the code; pieces: {pieces(message)}'


def test_there_are_messages_on_the_pages():
    assert len(list(quoted('docs/troubleshooting.md'))) > 30


def test_the_page_of_the_diagnosis_says_what_every_verdict_means():
    page = (ROOT / 'docs/diagnosis.md').read_text(encoding='utf-8')
    assert sorted(re.findall(r'^\| `(\w+)`: \*', page, re.M)) == sorted(Verdict)
