"""Files that cannot be read or written: one line that names them, and nothing half-written."""

import os
import re
import resource
import shutil
import sys
from contextlib import contextmanager

import pytest
import small_dataset
from source_tree import ROOT

from tendon_robot_ros.cli.main import main
from tendon_robot_ros.common import files
from tendon_robot_ros.common.errors import DataSetError, InputError
from tendon_robot_ros.comparison.result import load_comparison
from tendon_robot_ros.data import load_dataset
from tendon_robot_ros.data.bag_writer import STORAGES, STRING, BagWriter, Builder, export_bag
from tendon_robot_ros.investigation.measuring import LOG
from tendon_robot_ros.studies.fleet import FleetRow
from tendon_robot_ros.studies.running import GrowingTable
from tendon_robot_ros.workspace.volume import KEPT

ROBOT = ROOT / 'config' / 'robots' / 'spatial_3.yaml'
CALIBRATE = '--tendon one --weights 0.1 --yes'
# who reads; {} is the file; its ending
READERS = {
    'robot': ('model shape {} --tensions one=1', '.yaml'),
    'robot of a comparison': ('compare run --model {}', '.yaml'),
    'robot of a data set': ('diagnose run --robot {}', '.yaml'),
    'robot of a table': ('import table table.csv --robot {} --output new', '.yaml'),
    'data set': ('compare {}', ''),
    'data set to export': ('export bag {} new', ''),
    'check': ('effect add tip_load --data run --check {} --output new', ''),
    'table': ('import table {} --robot arm.yaml --output new', '.csv'),
    'table of pandas': ('import table {} --robot arm.yaml --output new', '.parquet'),
    'table of a tracker': ('import table {} --robot arm.yaml --output new', '.c3d'),
    'table of Excel': ('import table {} --robot arm.yaml --output new', '.xlsx'),
    'recipe': ('import table table.csv --robot arm.yaml --recipe {} --output new', '.yaml'),
    'recording': ('import bag {} --output new', '.mcap'),
    'recording in a database': ('compare {}', '.db3'),
    'recording to draw': ('plot {}', '.mcap'),
    'no recording': ('plot {}', '.csv'),
    'recording to follow': ('follow {}', '.mcap'),
    'path': ('follow {}', '.csv'),
    'slip angles': ('study friction {}', '.csv'),
    'postures': ('simulate arm.yaml --postures {} --output new', '.csv'),
    'regions': ('model reach arm.yaml --position 0,0,110 --keep-out {}', '.yaml'),
    'regions of a rehearsal': ('study rehearse arm.yaml --keep-out {} --output new', '.yaml'),
    'effect': ('model shape arm.yaml --tensions one=1 --effect-file {}', '.py'),
    'plan': ('study campaign {} --output new', '.yaml'),
    'recordings of a fleet': ('study fleet {} --output new', ''),
    'robot with an effect': ('effect remove tip_load --robot {} --output new', '.yaml'),
    'motors': (f'motors calibrate dynamixel {{}} --robot arm.yaml {CALIBRATE}', '.yaml'),
    'board': (f'motors calibrate serial {{}} --robot arm.yaml {CALIBRATE}', '.yaml'),
    'lines of other tendons': (
        f'motors calibrate dynamixel motors.yaml --robot arm.yaml --output {{}} {CALIBRATE}',
        '.yaml',
    ),
}  # fmt: skip
KINDS = ('missing', 'folder', 'empty', 'binary', 'cut short')
if os.geteuid() != 0:  # who is root may read everything
    KINDS += ('not permitted',)
MAY_BE_ABSENT = {'lines of other tendons'}
JUNK = bytes(range(256)) * 20


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Stand in a folder with a robot, a data set and a table."""
    monkeypatch.chdir(tmp_path)
    shutil.copy(ROBOT, 'arm.yaml')
    (tmp_path / 'table.csv').write_text('time,one,two,three,m_x,m_y,m_z\n0,1,0,0,0,0,120\n')
    (tmp_path / 'motors.yaml').write_text('port: nowhere\nmotors: {one: {id: 1}}\n')
    small_dataset.write(tmp_path / 'run')
    return tmp_path


def _make(kind, name, folder):
    """Put something that cannot be read under a name."""
    path = folder / name
    if kind == 'folder':
        path.mkdir()
    elif kind == 'empty':
        path.touch()
    elif kind == 'binary':
        path.write_bytes(JUNK)
    elif kind == 'cut short':
        whole = folder / 'whole.mcap'
        export_bag(load_dataset(folder / 'run'), whole)
        path.write_bytes(whole.read_bytes()[:1000])
    elif kind == 'not permitted':
        path.write_text('x')
        path.chmod(0)


def _there(folder):
    """Return all that lies in a folder but what Python keeps of a user's file."""
    return sorted(path for path in folder.rglob('*') if '__pycache__' not in path.parts)


@pytest.mark.parametrize('kind', KINDS)
@pytest.mark.parametrize('reader', READERS)
def test_what_cannot_be_read_is_named_in_one_line(reader, kind, folder, capsys):
    command, ending = READERS[reader]
    if kind == 'missing' and reader in MAY_BE_ABSENT:
        return
    name = f'given{ending}'
    _make(kind, name, folder)
    before = _there(folder)
    assert main(command.format(name).split()) == 1
    out, err = capsys.readouterr()
    assert out == ''
    assert err.count('\n') == 1
    assert name in err
    assert _there(folder) == before


@pytest.mark.parametrize(
    'content',
    [None, b'', JUNK, b'{}', b'[1]', b'{"format": 1', b'{"format": "other"}', b'null', b'no json'],
)
def test_a_saved_comparison_that_is_none_is_named(content, tmp_path):
    path = tmp_path / 'saved.json'
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=r'saved\.json: expected the JSON of a comparison'):
        load_comparison(path)


def test_a_parameter_that_names_a_file_says_which(tmp_path):
    pytest.importorskip('rclpy')
    from tendon_robot_ros.ros.shared.parameters import read_config

    (tmp_path / 'junk.yaml').write_bytes(JUNK)
    for name in ('junk.yaml', 'absent.yaml', '.'):
        path = str(tmp_path / name)
        with pytest.raises(InputError, match=f'config: {path}: '):
            read_config(path)


@pytest.mark.parametrize('content', [b'', JUNK, b'PK\3\4' + JUNK, b'PAR1' + JUNK])
def test_what_an_earlier_run_left_and_cannot_be_read_is_named(content, folder, capsys):
    """A table or samples to go on from."""
    (folder / 'table').mkdir()
    (folder / 'table' / 'rows-000001.parquet').write_bytes(content)
    with pytest.raises(DataSetError, match=r'rows-000001\.parquet: cannot be read .*; delete it'):
        GrowingTable(folder / 'table', FleetRow).keys()
    (folder / 'samples').mkdir()
    (folder / 'samples' / KEPT[0]).write_bytes(content)
    (folder / 'found').mkdir()
    (folder / 'found' / LOG).write_bytes(content)
    assert main(['study', 'rehearse', 'arm.yaml', '--output', 'found', '--resume']) == 1
    assert re.search(f'{LOG}: cannot be read .*; begin a new folder', capsys.readouterr().err)
    options = '--postures 200 --workers 1 --output samples --overwrite'
    assert main(f'model workspace arm.yaml {options}'.split()) == 1
    assert re.search(f'{KEPT[0]}: cannot be read .*; delete it', capsys.readouterr().err)


# -----------------------------------------------------------------------------
# A disk that is full: a limit on the size of files fails every write behind it in the same way.

FULL_BYTES = 100
WRITERS = {
    'data set': 'simulate arm.yaml --output new --postures 1 --trials 1',
    'table': 'simulate arm.yaml --table new.csv --postures 1 --trials 1',
    'recording': 'export bag run new.mcap',
    'recording in a folder': 'export bag run new',
    'recording in a database': 'export bag run new --storage sqlite3',
    'robot': 'effect remove tendon_friction --robot arm.yaml --output new.yaml',
    'result': 'compare run --json new.json',
    'page': 'compare run --report new.html',
    'path': 'model sweep kato_10_1 --steps 3 --output new.csv',
    'motors': ('motors emulate dynamixel --robot arm.yaml --ends-with-input --output new.yaml'),
}


@contextmanager
def _full():
    """Let every file end after some bytes: what is written behind them fails."""
    most = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (FULL_BYTES, most[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, most)


@pytest.mark.parametrize('writer', WRITERS)
def test_a_full_disk_is_told_in_one_line_and_leaves_nothing(writer, folder, capsys, monkeypatch):
    told = files.write_errors
    monkeypatch.setattr(sys, 'dont_write_bytecode', True)  # Python would leave a part of it
    monkeypatch.setattr('tendon_robot_ros.cli.main.keep_bytecode', lambda: None)

    @contextmanager
    def told_when_full(path):
        with told(path), _full():
            yield

    monkeypatch.setattr(files, 'write_errors', told_when_full)
    before = _there(folder)
    code = main(WRITERS[writer].split())
    err = capsys.readouterr().err
    assert code == 1, err
    assert 'new' in err.splitlines()[-1]
    assert 'cannot be written' in err.splitlines()[-1]
    assert _there(folder) == before


@pytest.mark.parametrize('storage', STORAGES)
def test_a_recording_that_runs_into_a_full_disk_is_named(storage, folder):
    """As `record` writes it: message by message."""

    def record():
        with files.write_errors(folder / 'run1'), BagWriter(folder / 'run1', storage) as writer:
            writer.add_topic('/said', STRING)
            message = Builder(writer.types).string('x' * 10_000)
            with _full():
                for time in range(1000):
                    writer.write('/said', time, message)
                writer.close()

    with pytest.raises(DataSetError, match=r'run1: cannot be written \(.*\); make room there'):
        record()


# -----------------------------------------------------------------------------
# Where something is written is looked at before the work.

OUTPUTS = {
    'robot': 'robot new --output {}',
    'data set': 'simulate arm.yaml --output {}',
    'check': 'simulate arm.yaml --output new --check {}',
    'recording': 'import bag nothing.mcap --output {}',
    'table': 'import table nothing.csv --robot arm.yaml --output {}',
    'result': 'compare nothing --json {}',
    'page': 'compare nothing --report {}',
    'page of a diagnosis': 'diagnose nothing --report {}',
    'better robot': 'diagnose nothing --add {}',
    'added': 'effect add tip_load --data nothing --output {}',
    'improved': 'improve nothing --output {}',
    'removed': 'effect remove tip_load --robot nothing.yaml --output {}',
    'path': 'model sweep nothing.yaml --output {}',
    'picture': 'plot nothing.mcap --output {}',
    'picture of a path': 'follow nothing.csv --picture {}',
    'picture of a recording': 'import bag nothing.mcap --output new --picture {}',
    'motors': 'motors emulate dynamixel --robot nothing.yaml --output {}',
    'calibration': (
        f'motors calibrate serial nothing.yaml --robot arm.yaml --output {{}} {CALIBRATE}'
    ),
}
FOLDERS = ('data set', 'check', 'recording', 'table')


@pytest.mark.parametrize('output', OUTPUTS)
def test_where_a_result_goes_is_looked_at_first(output, folder, capsys, monkeypatch):
    monkeypatch.setattr('sys.stdin', None)  # nobody is asked anything
    (folder / 'there').mkdir()
    (folder / 'there' / 'mine.txt').write_text('mine')
    (folder / 'file').write_text('mine')
    for place in ('there', 'file/in.png') if output not in FOLDERS else ('there', 'file'):
        assert main(OUTPUTS[output].format(place).split()) == 1
        err = capsys.readouterr().err
        assert place in err
        assert 'nothing' not in err.replace('and nothing', '')
        assert err.count('\n') == 1
