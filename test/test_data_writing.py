"""Files and data sets are written whole or not at all, and never over anything else."""

import dataclasses
import os
import stat
import threading

import numpy as np
import pytest
from measurements import LETTERS, TENTACLE, blind
from small_dataset import assert_same, write

from tendon_robot_ros.common.errors import DataSetError
from tendon_robot_ros.common.files import new_file
from tendon_robot_ros.data import folder as module
from tendon_robot_ros.data import load_dataset, save_dataset

FOLDERS = [TENTACLE, *(blind(letter) / 'check' for letter in LETTERS)]


@pytest.fixture
def small(tmp_path):
    return load_dataset(write(tmp_path / 'small'))


@pytest.mark.parametrize('folder', FOLDERS, ids=lambda path: path.parent.name)
def test_a_copy_says_the_same(folder, tmp_path):
    data = load_dataset(folder)
    copy = load_dataset(save_dataset(data, tmp_path / 'copy'))
    assert_same(copy, data)
    assert dataclasses.replace(copy.robot, source='') == dataclasses.replace(data.robot, source='')


def test_markers_that_were_never_seen_are_not_declared(small, tmp_path):
    part = small.select(['1'])
    copy = load_dataset(save_dataset(part, tmp_path / 'part'))
    assert [marker.name for marker in copy.markers] == ['1', '3']


def test_a_folder_that_holds_anything_is_left_alone(small, tmp_path):
    notes = tmp_path / 'notes.txt'
    notes.write_text('mine')
    with pytest.raises(DataSetError) as caught:
        save_dataset(small, tmp_path, overwrite=True)
    assert str(caught.value) == (
        f'{tmp_path}: is not empty, it holds notes.txt; name a new folder or empty it'
    )
    assert notes.read_text() == 'mine'


def test_a_data_set_is_replaced_only_when_told(small, tmp_path):
    target = save_dataset(small, tmp_path / 'out')
    with pytest.raises(
        DataSetError, match='holds a data set already; name a new folder or allow --over'
    ):
        save_dataset(small.select(['1']), target)
    assert load_dataset(target).postures == ('0', '1')
    save_dataset(small.select(['1']), target, overwrite=True)
    assert load_dataset(target).postures == ('1',)


def test_an_empty_folder_and_missing_parents_are_fine(small, tmp_path):
    (tmp_path / 'empty').mkdir()
    save_dataset(small, tmp_path / 'empty')
    save_dataset(small, tmp_path / 'a' / 'b')
    assert load_dataset(tmp_path / 'a' / 'b').postures == ('0', '1')


def test_nothing_is_left_behind_when_writing_fails(small, tmp_path, monkeypatch):
    target = save_dataset(small, tmp_path / 'out')

    def full(*_):
        raise OSError(28, 'No space left on device')

    monkeypatch.setattr(module, '_shape_rows', full)
    for place in ('out', 'new'):
        with pytest.raises(DataSetError) as caught:
            save_dataset(small, tmp_path / place, overwrite=True)
        assert str(caught.value) == (
            f'{tmp_path / place}: cannot be written (No space left on device); make room there '
            'or name another place'
        )
    assert load_dataset(target).postures == ('0', '1')
    assert sorted(path.name for path in tmp_path.iterdir()) == ['out', 'small']


def test_a_file_is_no_folder(small, tmp_path):
    (tmp_path / 'file').write_text('')
    with pytest.raises(DataSetError, match='file: is a file; name a folder'):
        save_dataset(small, tmp_path / 'file')


def test_what_could_not_be_read_back_is_not_written(small, tmp_path):
    blind = dataclasses.replace(small, positions=np.full_like(small.positions, np.nan))
    with pytest.raises(DataSetError, match="posture '0': has no measurement to write; select"):
        save_dataset(blind, tmp_path / 'out')
    assert not (tmp_path / 'out').exists()


def write_file(path, text):
    with new_file(path) as draft:
        draft.write_text(text, encoding='utf-8')


def test_a_file_that_failed_leaves_the_old_one_and_nothing_beside_it(tmp_path):
    path = tmp_path / 'page.html'
    write_file(path, 'old')

    def fail():
        with new_file(path) as draft:
            draft.write_text('half', encoding='utf-8')
            raise ValueError('no more')

    with pytest.raises(ValueError, match='no more'):
        fail()
    assert path.read_text(encoding='utf-8') == 'old'
    assert list(tmp_path.iterdir()) == [path]


def test_a_link_still_leads_to_what_is_written(tmp_path):
    path, link = tmp_path / 'robot_3.yaml', tmp_path / 'latest.yaml'
    path.write_text('old', encoding='utf-8')
    link.symlink_to(path)
    write_file(link, 'new')
    assert link.is_symlink()
    assert path.read_text(encoding='utf-8') == 'new'


def test_a_pipe_is_written_into(tmp_path):
    path, heard = tmp_path / 'pipe', []
    os.mkfifo(path)
    reader = threading.Thread(target=lambda: heard.append(path.read_text(encoding='utf-8')))
    reader.start()
    write_file(path, 'through')
    reader.join(10.0)
    assert heard == ['through']
    assert stat.S_ISFIFO(path.stat().st_mode)
