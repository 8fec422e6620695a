"""Work on the processes of this machine: some die, some raise, some are of another version."""

import os
import signal
import sys
from concurrent.futures import Future
from pathlib import Path

import pytest
import yaml
from source_tree import ROOT

from tendon_robot_ros.common.errors import (
    ClusterLostError,
    DataSetError,
    InputError,
    MissingExtraError,
    MovedError,
    NoEquilibriumError,
)
from tendon_robot_ros.common.workers import LostWork, Workers
from tendon_robot_ros.effects import load_catalogue
from tendon_robot_ros.model.versions import Preparation, UserEffect, catalogue_of


def die_once(folder):
    """Kill the process that does this, the first time; then say which it was."""
    mark = Path(folder) / 'died'
    if not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return 'done'


def die(_):
    os.kill(os.getpid(), signal.SIGKILL)


ERRORS = [
    InputError('not this'),
    NoEquilibriumError('posture 3', ('gravity',), 0.1),
    DataSetError('shapes.csv, row 2', 'x is missing', 'write it'),
    MovedError('the wire of a is not taut'),
]


def raise_it(number):
    raise ERRORS[number]


def test_a_worker_that_dies_costs_its_chunk_once(tmp_path):
    (tmp_path / 'other').mkdir()
    (tmp_path / 'other' / 'died').touch()
    with Workers(2) as workers:
        folders = [str(tmp_path), *[str(tmp_path / 'other')] * 3]
        assert dict(workers.run(die_once, folders)) == dict.fromkeys(range(4), 'done')


def test_a_chunk_that_kills_every_worker_is_given_up(monkeypatch):
    monkeypatch.setattr('tendon_robot_ros.common.workers.LOSSES_MAX', 2)
    with Workers(2) as workers:
        assert list(workers.run(die, [0])) == [(0, LostWork(2))]


@pytest.mark.parametrize('number', range(len(ERRORS)))
def test_what_the_work_raises_is_raised_here(number):
    expected = ERRORS[number]
    with Workers(2) as workers, pytest.raises(type(expected)) as raised:
        list(workers.run(raise_it, [number]))
    assert (str(raised.value), vars(raised.value)) == (str(expected), vars(expected))


class Immediate:
    """An engine of one slot that does a chunk when it gets it, until it breaks."""

    slots = 1

    def __init__(self, chunks=99):
        self.left = chunks

    def submit(self, work, chunk):
        self.left -= 1
        if self.left < 0:
            raise ClusterLostError('gone')
        future = Future()
        future.set_result(work(chunk))
        return future

    def is_loss(self, error):
        return False


def taken(engine, chunks):
    """Yield (how many chunks were handed out when a result came, the result)."""
    handed = []

    def counted():
        for chunk in chunks:
            handed.append(chunk)
            yield chunk

    workers = Workers()
    workers.engine = engine
    for index, result in workers.run(abs, counted()):
        yield len(handed), index, result


def test_a_worker_has_its_next_chunk_before_its_result_is_taken():
    assert list(taken(Immediate(), [-5, 6, -7])) == [(2, 0, 5), (3, 1, 6), (3, 2, 7)]


def test_a_cluster_that_is_lost_at_the_next_chunk_has_given_its_last_result():
    found = []

    def take_all():
        for each in taken(Immediate(2), [-5, 6, -7]):
            found.append(each)

    with pytest.raises(ClusterLostError, match='gone'):
        take_all()
    assert found == [(2, 0, 5), (3, 1, 6)]


def test_without_dask_a_cluster_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, 'distributed', None)
    with pytest.raises(MissingExtraError, match=r'tendon_robot_ros\[cluster\]'):
        Workers(cluster='tcp://127.0.0.1:9')


def test_a_scheduler_that_is_not_there_is_one_line(monkeypatch):
    pytest.importorskip('distributed')
    monkeypatch.setattr('tendon_robot_ros.common.workers.UPKEEP_S', 0.1)
    with pytest.raises(InputError, match=r'--cluster tcp://127.0.0.1:9: no scheduler answers'):
        Workers(cluster='tcp://127.0.0.1:9')


def test_the_settings_that_are_advised_are_settings_of_dask():
    pytest.importorskip('distributed')
    import dask.config

    def leaves(content, path=()):
        for key, value in content.items():
            inner = isinstance(value, dict)
            yield from leaves(value, (*path, key)) if inner else [('.'.join((*path, key)), value)]

    advised = dict(leaves(yaml.safe_load((ROOT / 'config' / 'dask.yaml').read_text())))
    assert len(advised) >= 4
    assert [name for name, value in advised.items() if dask.config.get(name) == value] == []


def test_workers_of_other_versions_are_refused():
    other = Preparation((('numpy', '0.1'),))
    with Workers(prepare=other) as workers, pytest.raises(InputError, match=r'here.*install'):
        list(workers.run(str, [0]))


def test_effects_of_the_user_go_to_workers_as_text(tmp_path):
    source = (ROOT / 'examples' / 'soft_pulley.py').read_text()
    (tmp_path / 'mine.py').write_text(source)
    effects = UserEffect.read([tmp_path / 'mine.py'])
    (tmp_path / 'mine.py').unlink()
    assert len(catalogue_of(effects).names) == len(load_catalogue().names) + 1
