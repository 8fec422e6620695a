"""Every command answers; a user's mistake is one line on stderr and exit code 1."""

import contextlib
import importlib
import io
import json
import re
import shlex
import sys
import time

import processes
import pytest
from documents import prepare, run_forked
from marks import slow

from tendon_robot_ros.cli import main as command_line
from tendon_robot_ros.cli import options
from tendon_robot_ros.cli.main import COMMANDS, GROUPS, OLD_NAMES, OLD_OPTIONS, Parser, main
from tendon_robot_ros.data import load_dataset, save_dataset
from tendon_robot_ros.data.bag_writer import export_bag
from tendon_robot_ros.robot import dump_robot
from tendon_robot_ros.simulation.measurements import SimulatedNoise, simulate
from tendon_robot_ros.workspace.postures import default_postures

NOISE = SimulatedNoise(position=1e-4)
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
    source_of = command_line.source_of
    own = {'move': tmp_path / 'move.py', 'tendon_robot_ros.ros.move': tmp_path / 'move.py'}
    monkeypatch.setattr(command_line, 'source_of', lambda at: own.get(at) or source_of(at))
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setitem(COMMANDS, 'move', 'move')
    monkeypatch.delitem(sys.modules, 'move', raising=False)


PROGRAM = 'python -m tendon_robot_ros'


def help_of(name, *more):
    """Return the lines of the help of a command."""
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.suppress(SystemExit):
        assert main([*name.split(), *(more or ['--help'])]) == 0
    return said.getvalue().splitlines()


def example_of(name):
    """Return the words of the example with which a help ends."""
    text = ' '.join(' '.join(help_of(name)).partition(' example: ')[2].split())
    return shlex.split(text.removeprefix(PROGRAM))


@pytest.mark.parametrize('name', COMMANDS)
def test_every_command_explains_itself_on_a_screen_and_ends_with_an_example(name):
    lines = help_of(name)
    assert lines[0].startswith(f'usage: {PROGRAM} {name}')
    assert len(lines) <= 24, '\n'.join(lines)
    assert max(map(len, lines)) <= 100, '\n'.join(lines)
    assert example_of(name)[: len(name.split())] == name.split()
    assert len(help_of(name, '--help-all')) >= len(lines) - 1


@pytest.mark.parametrize('name', [n for n, place in COMMANDS.items() if '.cli.' in place])
def test_the_arguments_of_an_example_exist(name):
    parser = Parser(prog=name, description='')
    command_line.command_of(COMMANDS[name]).add_arguments(parser)
    parser.parse_args(example_of(name)[len(name.split()) :])


# what an example goes on from
BEFORE = {'effect remove': 'effect add', 'import bag': 'export bag'}
RUN = [
    *(n for n in ('robot new', 'robot describe', 'model shape', 'model reach', 'model workspace')),
    *('model sweep', 'compare', 'diagnose', 'effect remove', 'import table', 'import bag'),
    *('export mjcf', 'simulate', 'study friction', 'completion'),
    *map(slow, ('improve', 'study campaign', 'study fleet', 'study paper', 'study rehearse')),
]


# nodes; a show that a person watches; a command whose result is a file or a port
NO_JSON = {
    'controller', 'driver', 'monitor', 'viewer', 'robot-model', 'teleop', 'demo', 'live',
    'completion', 'export mjcf', 'motors emulate',
}  # fmt: skip


@pytest.mark.parametrize('name', COMMANDS)
def test_every_command_that_prints_a_result_prints_it_as_json(name):
    options = help_of(name, '--help-all')
    assert any(line.startswith('  --json ') for line in options) == (name not in NO_JSON)


@pytest.mark.parametrize('name', RUN)
@pytest.mark.long
def test_the_example_of_a_help_runs(name, tmp_path):
    """Those of motors and nodes need an arm; test_docs.py runs the like."""
    prepare(tmp_path)
    if name in BEFORE:
        run_forked(example_of(BEFORE[name]), folder=tmp_path, timeout=500.0)
    more = [] if name in NO_JSON else ['--json', 'result.json']
    run_forked([*example_of(name), *more], folder=tmp_path, timeout=500.0)
    if more:
        assert json.loads((tmp_path / 'result.json').read_text(encoding='utf-8'))


def test_a_command_runs_as_a_process_too():
    run = processes.run(processes.package('model', 'shape', '--help'))
    assert (run.returncode, run.stderr) == (0, '')
    assert run.stdout.startswith('usage: python -m tendon_robot_ros model shape')


def test_every_module_with_a_command_is_in_the_table():
    folders = ('cli', 'studies', 'ros/*')
    files = [p for folder in folders for p in command_line.PACKAGE.glob(f'{folder}/*.py')]
    commands = {path for path in files if re.search('^ *HELP = ', path.read_text(), re.M)}
    assert commands == {command_line.source_of(place) for place in COMMANDS.values()}


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
        (['move', '--tow', '1'], 'unrecognized arguments: --tow 1; did you mean --to? see '),
        (['move', '--from', 'x'], 'unrecognized arguments: --from x; '),  # no abbreviations
        (['move', '--to'], 'argument --to: expected one argument; see '),
        (
            ['import', 'table', 'a.csv', '--output', 'o', '--speed', '0'],
            'argument --speed: expected a number above 0, got 0; see ',
        ),
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


def test_a_reader_that_has_seen_enough_is_no_error():
    run = processes.run(
        ['bash', '-o', 'pipefail', '-c', f'{sys.executable} -m tendon_robot_ros | true'],
    )
    assert (run.returncode, run.stderr) == (0, '')


def _said(stream, words):
    """Wait until a stream holds words."""
    end = time.monotonic() + 30.0
    while words not in stream.getvalue():
        assert time.monotonic() < end, stream.getvalue()
        time.sleep(0.001)


@pytest.mark.parametrize('screen', [False, True])
def test_long_work_says_how_far_it_is_in_a_pipe_and_on_a_screen(monkeypatch, screen):
    """In the midst of a step, too, that tells nothing itself."""
    stream = io.StringIO()
    monkeypatch.setattr(stream, 'isatty', lambda: screen)
    monkeypatch.setattr('sys.stderr', stream)
    monkeypatch.setattr(options, 'UPKEEP_S', 0.01)
    with options.progress() as show:
        _said(stream, '' if screen else 'working, 0 s so far\n')
        for done in range(3):
            show('effects', done, 3)
            _said(stream, f'effects {done}/3')
    assert ('\r' in stream.getvalue()) == screen


def test_short_work_in_a_pipe_says_nothing(capsys):
    with options.progress() as show:
        show('effects', 1, 3)
    assert capsys.readouterr().err == ''


# what takes long -> what is told on the way
LONG = {
    'compare run --pcca': ['reading run', 'trials', 'models', 'models', 'noise'],
    'diagnose run': ['reading run', 'effects', 'fitting what was found'],
    'effect add tip_load --data run --output new.yaml': ['reading run', 'fitting tip_load'],
    'improve run --output new.yaml': ['reading run', 'searching', 'searching without'],
    'simulate arm.yaml --output new --postures 2 --trials 2': ['trials', 'trials'],
    'simulate arm.yaml --table new.csv --postures 2 --trials 2': ['trials', 'trials'],
    'export bag run new.mcap': ['writing'],
    'import bag run.mcap --output new': ['reading run.mcap', 'looking at the frame'],
    'plot run.mcap --output new.png': ['reading run.mcap'],
    'model sweep kato_10_1 --steps 3 --output new.csv': ['looking for 3 postures'],
    'import table table.csv --robot arm.yaml --up y --output new': [
        'reading the tables', 'looking where the arm stood still',
        'laying the frame of the tracker', 'comparing with the model',
    ],
    'model workspace arm.yaml --postures 200 --workers 1': ['postures'],
}  # fmt: skip


@pytest.fixture(scope='module')
def measured(tmp_path_factory):
    """Return a folder with an arm, its measurements, a recording and a table of them."""
    from laboratory_tables import ARM, calm_recording

    folder = tmp_path_factory.mktemp('measured')
    (folder / 'arm.yaml').write_text(dump_robot(ARM))
    calm_recording().to_csv(folder / 'table.csv', index=False)
    dataset = simulate(ARM, default_postures(ARM, 5), trials=2, noise=NOISE)
    save_dataset(dataset, folder / 'run')
    export_bag(load_dataset(folder / 'run'), folder / 'run.mcap')
    return folder


def place_of(command):
    """Return the place of the command that a line begins with."""
    return next(place for name, place in COMMANDS.items() if f'{command} '.startswith(f'{name} '))


@pytest.mark.parametrize('command', LONG)
def test_all_that_may_take_long_tells_what_it_does(command, measured, tmp_path, monkeypatch):
    told = []

    @contextlib.contextmanager
    def heard(remaining=False):
        yield lambda what, done, total: told.append((what, done, total))

    for path in measured.iterdir():
        (tmp_path / path.name).symlink_to(path)
    monkeypatch.chdir(tmp_path)
    module = importlib.import_module(place_of(command).partition(':')[0])
    owner = module if hasattr(module, 'progress') else options
    monkeypatch.setattr(owner, 'progress', heard)
    main(command.split())
    seen = iter(what for what, _, _ in told)
    assert all(any(what.startswith(words) for what in seen) for words in LONG[command]), told
    assert all(0 <= done <= total for _, done, total in told)


def test_a_port_that_cannot_appear_is_named_itself(tmp_path, capsys):
    port = str(tmp_path / 'none' / 'port')
    command = ['motors', 'emulate', 'dynamixel', '--robot', 'spatial_3', '--arm', 'springs']
    assert main([*command, '--port', port]) == 1
    said = f'error: {port}: its folder does not exist; make it or correct --port\n'
    assert capsys.readouterr().err == said


@pytest.mark.parametrize(('old', 'new'), OLD_NAMES.items())
def test_an_old_name_still_runs_and_says_the_new_one(old, new, capsys):
    with pytest.raises(SystemExit):
        main([old, '--help'])
    out, err = capsys.readouterr()
    assert out.startswith(f'usage: python -m tendon_robot_ros {new} ')
    assert err == f'{old} is now called: {new} (the old name goes with the next release)\n'


@pytest.mark.parametrize('group', GROUPS)
def test_a_group_lists_its_commands_and_refuses_others(group, capsys):
    members = [name.split()[1] for name in COMMANDS if name.startswith(f'{group} ')]
    assert main([group]) == 0
    listed = capsys.readouterr().out.splitlines()[3:]
    assert [line.split()[0] for line in listed] == members
    assert main([group, 'nonsense']) == 1
    assert capsys.readouterr().err == (
        f"error: {group}: no command 'nonsense'; known: {', '.join(members)}\n"
    )


def test_every_group_has_its_line():
    assert {name.split()[0] for name in COMMANDS if ' ' in name} == {*GROUPS}


@pytest.mark.parametrize(('typed', 'known'), [
    ('im', ['improve', 'import']),
    ('import ta', ['table']),
    ('import table --fr', ['--frame']),
    ('import table raw.csv --ov', ['--overwrite']),
    ('compare data --js', ['--json']),
    ('controller --r', ['--ros-args']),
])  # fmt: skip
def test_the_shell_completes_commands_and_options(typed, known, capsys):
    main(['completion'])
    script = capsys.readouterr().out
    words = ['tendon_robot_ros', *typed.split()]
    asked = f'COMP_WORDS=({shlex.join(words)}); COMP_CWORD={len(words) - 1}; _tendon_robot_ros'
    run = processes.run(['bash', '-c', f'{script}\n{asked}; echo "${{COMPREPLY[@]}}"'])
    assert (run.stdout.split(), run.stderr) == (known, '')


def test_an_old_option_still_counts_and_says_the_new_one(capsys):
    call = ['model', 'workspace', 'kato_10_1', '--view', '180', '--step', '2.5']
    main([*call, '--limit=5', '--json'])
    found = capsys.readouterr()
    assert json.loads(found.out)['limit'] == 5.0
    assert found.err.startswith('--limit is now called: --tension-max (the old name goes with')
    for name, options_of_it in OLD_OPTIONS.items():
        listed = '\n'.join(help_of(name, '--help-all'))
        assert all(f'\n  {new} ' in listed for new in options_of_it.values())
