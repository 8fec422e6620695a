"""Every command answers; a user's mistake is one line on stderr and exit code 1."""

import contextlib
import sys

import processes
import pytest

from tendon_robot_ros.cli import main as command_line
from tendon_robot_ros.cli import options
from tendon_robot_ros.cli.main import COMMANDS, Parser, main
from tendon_robot_ros.common.errors import InputError

MOVE = """
'''What it moves, and where to.'''
HELP = 'move the tip'


def add_arguments(parser):
    parser.add_argument('--to')
    parser.add_argument('--from-file')


def run(args):
    if args.from_file:
        open(args.from_file)
    print(args.to)
    return 0
"""


@pytest.fixture
def move(monkeypatch, tmp_path):
    """Give the package one more command, in a file as any other."""
    (tmp_path / 'move.py').write_text(MOVE)
    monkeypatch.setattr(command_line, '_source', lambda module: tmp_path / 'move.py')
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setitem(COMMANDS, 'move', 'move')
    monkeypatch.delitem(sys.modules, 'move', raising=False)


@pytest.mark.parametrize('name', COMMANDS)
def test_every_command_explains_itself(name, capsys):
    with contextlib.suppress(SystemExit):
        assert main([name, '--help']) == 0
    assert capsys.readouterr().out.startswith(f'usage: python -m tendon_robot_ros {name}')


def test_a_command_runs_as_a_process_too():
    run = processes.run(processes.package('shape', '--help'))
    assert (run.returncode, run.stderr) == (0, '')
    assert run.stdout.startswith('usage: python -m tendon_robot_ros shape')


def test_every_module_with_a_command_is_in_the_table():
    files = [*command_line.PACKAGE.glob('cli/*.py'), *command_line.PACKAGE.glob('ros/*/*.py')]
    commands = {path for path in files if '\nHELP = ' in path.read_text()}
    assert commands == {command_line._source(module) for module in COMMANDS.values()}


def test_without_arguments_the_commands_are_listed(capsys, move):
    assert main([]) == 0
    assert '\n  move ' in (out := capsys.readouterr().out)
    assert out.splitlines()[-1].endswith('  move the tip')


def test_an_executable_runs_the_command_it_is_named_after(capsys, monkeypatch, move):
    monkeypatch.setattr(sys, 'argv', ['/opt/ws/lib/tendon_robot_ros/move', '--to', 'base'])
    assert command_line.run_named() == 0
    assert capsys.readouterr().out == 'base\n'


def test_a_vector_may_begin_with_a_minus(capsys, move):
    assert main(['move', '--to', '-0.1,0,0.2']) == 0
    assert capsys.readouterr().out == '-0.1,0,0.2\n'


@pytest.mark.parametrize(
    ('arguments', 'message'),
    [
        (['mvoe'], "no command 'mvoe'; did you mean move? known: "),
        (['move', '--tow', '1'], 'unrecognized arguments: --tow 1; see '),
        (['move', '--to'], 'argument --to: expected one argument; see '),
        (['move', '--from-file', 'no.yaml'], 'no.yaml: No such file or directory'),
    ],
)
def test_a_mistake_is_one_line(arguments, message, capsys, move):
    assert main(arguments) == 1
    out, err = capsys.readouterr()
    assert out == ''
    assert err.startswith(f'error: {message}')
    assert err.count('\n') == 1


def test_a_node_without_ros_says_what_to_install(capsys, monkeypatch, move):
    monkeypatch.setitem(COMMANDS, 'move', 'tendon_robot_ros.ros.move')
    monkeypatch.setattr('importlib.util.find_spec', lambda name: None)
    assert main(['move']) == 1
    assert capsys.readouterr().err == (
        'error: rclpy is not installed; type: python -m pip install "tendon_robot_ros[ros]"\n'
    )


def test_the_parser_refuses_abbreviations():
    parser = Parser(prog='x', description='')
    parser.add_argument('--position')
    with pytest.raises(InputError, match='--pos'):
        parser.parse_args(['--pos', '1'])


def test_a_reader_that_has_seen_enough_is_no_error():
    run = processes.run(
        ['bash', '-o', 'pipefail', '-c', f'{sys.executable} -m tendon_robot_ros | true'],
    )
    assert (run.returncode, run.stderr) == (0, '')


def test_long_work_in_a_pipe_says_now_and_then_how_far_it_is(capsys, monkeypatch):
    clock = iter(range(0, 1000, 3))  # [s], a call each
    monkeypatch.setattr(options.time, 'monotonic', lambda: float(next(clock)))
    with options.progress() as show:
        for done in range(1, 7):
            show('effects', done, 6)
    said = capsys.readouterr().err.split('\n')
    assert said == ['effects 2/6', 'effects 4/6', 'effects 6/6', '']
