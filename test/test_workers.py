"""Work on the processes of this machine: some die, some raise, some are of another version."""

import os
import signal
from pathlib import Path

import pytest
from source_tree import ROOT

from tendon_robot_ros.campaign.versions import Preparation, UserEffect, catalogue_of
from tendon_robot_ros.common.errors import InputError
from tendon_robot_ros.common.workers import LostWork, Workers
from tendon_robot_ros.effects import load_catalogue


def die_once(folder):
    """Kill the process that does this, the first time; then say which it was."""
    mark = Path(folder) / 'died'
    if not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return 'done'


def die(_):
    os.kill(os.getpid(), signal.SIGKILL)


def refuse(_):
    raise InputError('not this')


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


def test_what_the_work_raises_is_raised_here():
    with Workers(2) as workers, pytest.raises(InputError, match='not this'):
        list(workers.run(refuse, [0]))


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
