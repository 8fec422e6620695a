"""The style that no tool checks: short files, short functions, nothing of a private machine."""

import ast
import re

import pytest
from source_tree import ROOT, files, parse

FILE_LINES, FUNCTION_LINES = 250, 40

# path, or path:function -> why splitting it would hurt
LONGER = {}

PRIVATE = {
    'a path of one machine': re.compile(r'(?<![\w.])/(?:home|root|Users|work)/(?!<)\w'),
    'a folder beside the repository': re.compile(r'\.\./(?:shared|dev)\b'),
}
TEXT = {'.cfg', '.css', '.html', '.js', '.json', '.md', '.py', '.rst', '.sh', '.toml', '.yaml'}


def functions(path):
    """Yield name and length of every function, its docstring not counted."""
    for node in ast.walk(parse(path)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            first = node.body[0]
            documented = ast.get_docstring(node) is not None
            docstring = first.end_lineno - first.lineno + 1 if documented else 0
            yield node.name, node.end_lineno - node.lineno + 1 - docstring


@pytest.mark.parametrize('path', files('*.py'), ids=str)
def test_files_and_functions_are_short(path):
    lines = len((ROOT / path).read_text(encoding='utf-8').splitlines())
    assert lines <= FILE_LINES or str(path) in LONGER
    long = [f'{path}:{name}' for name, length in functions(path) if length > FUNCTION_LINES]
    assert [name for name in long if name not in LONGER] == []


def test_every_exception_is_still_needed():
    present = {str(path) for path in files('*.py')}
    for name in LONGER:
        path, _, function = name.partition(':')
        assert path in present
        assert not function or dict(functions(path))[function] > FUNCTION_LINES


@pytest.mark.parametrize('path', files(), ids=str)
def test_nothing_names_a_private_machine(path):
    if path.suffix in TEXT or path.name in ('Makefile', 'run'):
        text = (ROOT / path).read_text(encoding='utf-8')
        for what, pattern in PRIVATE.items():
            assert not (found := pattern.search(text)), f'{path} names {what}: {found.group()}'
