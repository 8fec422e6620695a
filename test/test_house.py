"""The style that no tool checks: short functions, numbers with reasons, no private machine."""

import ast
import re

from source_tree import ROOT, files, parse

from tendon_robot_ros.diagnosis.verdict import Verdict

FUNCTION_LINES = 80

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


def test_functions_are_short():
    lengths = ((f'{path}:{name}', n) for path in files('*.py') for name, n in functions(path))
    long = [name for name, length in lengths if length > FUNCTION_LINES]
    assert not long, f'over {FUNCTION_LINES} lines: {", ".join(long)}'


UNIT = re.compile(r'\[[^\[\]]+\]')
# what a comment says of a number: a source, or what another value would do
REASON = re.compile(
    r'because|so that|measured|else |would|by chance|probab|p-value|significance|1 of '
    r'|manual|datasheet|docs/|eq\.|Kato|(?:19|20)\d\d',
    re.I,
)
TABLE = (
    6  # [1] numbers; a dictionary or call with more is a table, whose source stands at its head
)


def outside_functions(node):
    """Yield the nodes of an expression without the bodies of its lambdas."""
    if not isinstance(node, ast.Lambda):
        yield node
        for child in ast.iter_child_nodes(node):
            yield from outside_functions(child)


def is_number(node):
    """Whether a node is a literal number."""
    return isinstance(node, ast.Constant) and type(node.value) in (int, float)


def numbers(path):
    """Yield line, name and comment of every number that a module names: beside it or above it."""
    lines = (ROOT / path).read_text(encoding='utf-8').split('\n')
    for node in parse(path).body:
        if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None:
            continue
        target = node.targets[0] if isinstance(node, ast.Assign) else node.target
        named = target.elts if isinstance(target, ast.Tuple) else [target]
        names = [n.id for n in named if isinstance(n, ast.Name) and n.id.lstrip('_').isupper()]
        values = [n for n in outside_functions(node.value) if is_number(n)]
        table = isinstance(node.value, ast.Dict | ast.Call) and len(values) > TABLE
        # an effect declares each parameter with its unit
        if names and values and not table and names != ['EFFECT']:
            first = node.lineno - 1
            while lines[first - 1].startswith('#'):
                first -= 1
            block = lines[first : node.end_lineno]
            comment = ' '.join(line.partition('#')[2].strip() for line in block)
            yield node.lineno, ', '.join(names), comment


def test_every_number_has_a_unit_and_a_reason():
    wrong = [
        f'{path}:{line} {name}: its comment gives '
        + ('no reason' if UNIT.search(comment) else 'no unit in brackets')
        for path in files('tendon_robot_ros/*.py')
        for line, name, comment in numbers(path)
        if ',' in name or not UNIT.search(comment) or not REASON.search(comment)
    ]
    assert not wrong, '\n'.join(wrong)


def test_a_verdict_is_named_in_its_table_only():
    names = {str(verdict) for verdict in Verdict}
    wrong = []
    for path in files('*.py'):
        if path.parts[0] == 'test' or path.match('diagnosis/verdict.py'):
            continue
        wrong += [
            f'{path}:{node.lineno} says {node.value!r}: import Verdict'
            for node in ast.walk(parse(path))
            if isinstance(node, ast.Constant) and node.value in names
        ]
    assert not wrong, '\n'.join(wrong)


def test_tests_start_processes_in_one_way():
    imports = {
        name.name
        for path in files('test/*.py')
        if path.name != 'processes.py'
        for node in parse(path).body
        if hasattr(node, 'names')
        for name in node.names
    }
    assert 'subprocess' not in imports, 'use processes.run or processes.Process'


def test_nothing_names_a_private_machine():
    wrong = []
    for path in files():
        if path.suffix in TEXT or path.name in ('Makefile', 'run'):
            text = (ROOT / path).read_text(encoding='utf-8')
            for what, pattern in PRIVATE.items():
                wrong += [f'{path} names {what}: {found}' for found in pattern.findall(text)]
    assert not wrong, '\n'.join(wrong)


# folders whose files are named as the command or the effect; the kernel's are in its README
NOT_LISTED = {'tendon_robot_ros/cli', 'tendon_robot_ros/effects', 'tendon_robot_ros/model/kernel'}


def test_the_first_words_of_a_folder_name_its_files():
    wrong = []
    for path in files('tendon_robot_ros/*/__init__.py'):
        folder = path.parent
        told = ast.get_docstring(parse(path)) or ''
        there = {p.name for p in (ROOT / folder).glob('*.py')} - {'__init__.py'}
        named = set(re.findall(r'(?<![\w/.])(\w+\.py)\b', told))
        if str(folder) not in NOT_LISTED:
            wrong += [f'{path} does not name {name}' for name in sorted(there - named)]
        rows = set(re.findall(r'^(\w+\.py)\b', told, re.M))
        wrong += [f'{path} names {name}, which is not there' for name in sorted(rows - there)]
    assert not wrong, '\n'.join(wrong)
