"""A file is written whole or not at all; links, pipes and devices stay what they are."""

import os
import stat
import threading

import pytest

from tendon_robot_ros.common.files import new_file


def write(path, text):
    with new_file(path) as draft:
        draft.write_text(text, encoding='utf-8')


def test_a_file_that_failed_leaves_the_old_one_and_nothing_beside_it(tmp_path):
    path = tmp_path / 'page.html'
    write(path, 'old')

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
    write(link, 'new')
    assert link.is_symlink()
    assert path.read_text(encoding='utf-8') == 'new'


def test_a_pipe_is_written_into(tmp_path):
    path, heard = tmp_path / 'pipe', []
    os.mkfifo(path)
    reader = threading.Thread(target=lambda: heard.append(path.read_text(encoding='utf-8')))
    reader.start()
    write(path, 'through')
    reader.join(10.0)
    assert heard == ['through']
    assert stat.S_ISFIFO(path.stat().st_mode)
