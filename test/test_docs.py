"""
Every page: its commands run, its links and paths lead somewhere, and nothing escapes both.

How blocks are marked: documents.py. Of commands that are not run here, at least the options,
parameters and scripts that they name exist.
"""

import importlib
import importlib.util
import re

import pytest
from documents import (
    COMMAND,
    PAGES,
    SHELLS,
    blocks,
    is_live,
    prepare,
    run,
    run_live,
    runs,
    shows,
    text_of,
)
from source_tree import ROOT, files

from tendon_robot_ros.cli.main import COMMANDS, OLD_OPTIONS, Parser, command_of

DOCS = [page for page in PAGES if page.parent.name in ('docs', 'data')]
LIVE = [page for page in DOCS if is_live(text_of(page))]
SLOW = [page for page in DOCS if any(block['slow'] for block in blocks(text_of(page)))]
CALL = re.compile(r'(?:python -m|ros2 run) tendon_robot_ros ([a-z-]+)((?: (?:[^`\n]|\\\n)*)?)')
LOOSE = re.compile(r'^ *(?:\$ |sudo |python3? |ros2 |make |pip |git |source |echo |colcon )', re.M)
SCRIPT = r'(?:benchmarks|config|data|examples|firmware|launch|test|tools|tendon_robot_ros)'
FILE = re.compile(rf'(?<![\w/.-])({SCRIPT}/[\w./-]+\.(?:py|yaml|sh|csv|c|h|txt|md))')


# [s] A hang, not a speed: one that compiles a model takes long beside what runs in real time.
BLOCK, PAGE = 900.0, 2400.0


def run_at_once(page, folder, slow):
    for block in blocks(text_of(page)):
        if runs(block, slow):
            shows(block, run(block, folder, BLOCK))


@pytest.mark.timeout(PAGE)
@pytest.mark.parametrize('page', [page for page in DOCS if page not in LIVE], ids=str)
@pytest.mark.long
def test_the_blocks_of_a_page_run(page, tmp_path):
    run_at_once(page, prepare(tmp_path), slow=False)


@pytest.mark.slow
@pytest.mark.parametrize('page', [page for page in SLOW if page not in LIVE], ids=str)
def test_the_slow_blocks_of_a_page_run(page, tmp_path):
    run_at_once(page, prepare(tmp_path), slow=True)


@pytest.mark.slow
@pytest.mark.ros
@pytest.mark.parametrize('page', LIVE, ids=str)
def test_the_terminals_of_a_page_show_what_it_says(page, tmp_path):
    run_live(text_of(page), prepare(tmp_path), slow=True)


@pytest.mark.parametrize('page', PAGES, ids=str)
def test_no_command_of_a_page_escapes(page):
    text = text_of(page)
    found = blocks(text)
    assert 2 * len(found) == len(re.findall(r'^```', text, re.M)), 'a fence that is no block'
    assert not SHELLS & {block['language'] for block in found}, 'commands stand in console blocks'
    for block in found:
        if block['language'] == 'console':
            assert COMMAND.search(block['text']), 'a command begins with "$ "'
        elif not block['language']:
            assert not LOOSE.search(block['text']), f'make it a console block: {block["text"]}'
    outside = re.sub(r'^```.*?^```$', '', text, flags=re.M | re.S)
    indented = '\n'.join(re.findall(r'^    .+$', outside, re.M))
    assert not LOOSE.search(indented), f'make it a console block: {LOOSE.search(indented)[0]}'


@pytest.mark.parametrize('page', PAGES, ids=str)
def test_what_is_not_run_says_who_runs_it_instead(page):
    for block in blocks(text_of(page)):
        for name in re.findall(r'test/\w+\.py', block['reason'] or ''):
            assert (ROOT / name).exists(), f'{page}: {block["reason"]}'


def arguments():
    """Yield page, command and arguments of every call of this package on any page."""
    for page in PAGES:
        for name, given in CALL.findall(text_of(page).replace('\\\n', ' ')):
            first, _, rest = given.lstrip().partition(' ')
            if any(one.startswith(f'{name} ') for one in COMMANDS):
                name, given = f'{name} {first}', f' {rest}'
            yield page, name, given.split('  #')[0]


def test_every_command_and_option_on_a_page_exists():
    wrong = []
    for page, name, given in arguments():
        if name not in COMMANDS:
            wrong.append(f'{page}: no command {name}')
        elif '.cli.' in COMMANDS[name]:
            parser = Parser(prog=name, description='')
            command_of(COMMANDS[name]).add_arguments(parser)
            known = set(parser._option_string_actions)
            wrong += [
                f'{page}: {name} {o}' for o in re.findall(r' (--[\w-]+)', given) if o not in known
            ]
    assert not wrong, '\n'.join(wrong)


SCRIPT = re.compile(r'python ((?:benchmarks|examples|tools)/\w+\.py)([^`\n]*)')


def test_every_script_and_its_options_on_a_page_exist():
    calls = [(page, *call) for page in PAGES for call in SCRIPT.findall(text_of(page))]
    assert len(calls) > 20
    wrong = [f'{page}: {name}' for page, name, _ in calls if not (ROOT / name).is_file()]
    shared = ''.join(map(text_of, files('benchmarks/[!b]*.py')))  # what benchmarks import
    for page, name, given in calls:
        source = text_of(name) + shared
        options = re.findall(r' (--[\w-]+)', given)
        wrong += [f'{page}: {name} {o}' for o in options if not re.search(f"['-]{o[2:]}'", source)]
    assert not wrong, '\n'.join(wrong)


def test_no_page_says_an_option_of_an_earlier_version():
    known = set()
    for place in COMMANDS.values():
        if '.cli.' in place:
            parser = Parser(prog='', description='')
            command_of(place).add_arguments(parser)
            known |= {*parser._option_string_actions}
    old = {option for options in OLD_OPTIONS.values() for option in options} - known
    assert '--limit' in old
    said = [f'{p}: {o}' for p in PAGES for o in re.findall(r'--[\w-]+', text_of(p)) if o in old]
    assert not said, '\n'.join(said)


@pytest.mark.skipif(importlib.util.find_spec('rclpy') is None, reason='rclpy is not installed')
def test_every_node_parameter_on_a_page_exists():
    from tendon_robot_ros.ros.shared.parameters import declared

    wrong, seen = [], 0
    for page, name, given in arguments():
        for parameter in re.findall(r'-p (\w+):=', given):
            seen += 1
            if parameter not in declared()[name.replace('-', '_')]:
                wrong.append(f'{page}: {name} has no parameter {parameter}')
    assert seen > 10
    assert not wrong, '\n'.join(wrong)


def test_every_target_of_make_on_a_page_exists():
    known = re.findall(r'^([a-z-]+):', text_of('Makefile'), re.M)
    found = [
        (page, name) for page in PAGES for name in re.findall(r'`make ([a-z-]+)', text_of(page))
    ]
    assert [(str(page), name) for page, name in found if name not in known] == []


@pytest.mark.parametrize('page', PAGES, ids=str)
def test_every_file_that_a_page_names_exists(page):
    wrong = [name for name in FILE.findall(text_of(page)) if not (ROOT / name).exists()]
    assert not wrong, f'{page}: {wrong}'


def test_documents_that_the_code_names_exist():
    named = {}
    for path in [*files('tendon_robot_ros/*.py'), *files('config/*'), *files('firmware/*')]:
        for name in re.findall(r'docs/\w+\.md', text_of(path)):
            named.setdefault(name, path)
    assert len(named) > 3
    assert {name: path for name, path in named.items() if not (ROOT / name).exists()} == {}
