"""`make live`: the story as text, and clicked through in a browser."""

import os
import signal
import sys
import time
import urllib.request
from types import SimpleNamespace

import numpy as np
import processes
import pytest
from arms import coarse

from tendon_robot_ros.cli.main import main
from tendon_robot_ros.common.errors import TendonRobotError
from tendon_robot_ros.robot import dump_robot

pytest.importorskip('rclpy')
pytestmark = pytest.mark.ros
LIVE = [sys.executable, '-u', '-m', 'tendon_robot_ros', 'live']


def told(*arguments, timeout=500.0):
    run = processes.run([*LIVE, '--headless', *arguments], timeout=timeout)
    return run.returncode, run.stdout + run.stderr


@pytest.mark.long
def test_the_story_of_a_hidden_effect_comes_true(tmp_path):
    """Of an arm of fewer cells: each has a stiffness of its own, which a diagnosis fits."""
    described = tmp_path / 'coarse.yaml'
    described.write_text(dump_robot(coarse('kato_10_1', 3)), encoding='utf-8')
    arguments = ('--hidden', 'tip_load', '--seed', '1', '--postures', '6', '--reveal')
    code, text = told(*arguments, '--robot', str(described))
    assert code == 0, text
    assert 'tip_load' in text.split('hidden:')[0]
    assert '% gone)' in text


@pytest.mark.slow  # test_ros_investigate.py has the same between nodes, without the page's story
def test_the_arm_finds_out_by_itself():
    code, text = told('--investigate', '--hidden', 'tip_load', '--seed', '1')
    assert code == 0, text
    assert 'one name is left' in text
    assert 'the controller uses it' in text
    assert text.count('\nposture ') <= 6, 'half of the twelve that a person would record'
    assert '% gone)' in text


def test_a_node_that_ends_while_all_others_start_is_named_at_once():
    from tendon_robot_ros.ros.commands.live import Director
    from tendon_robot_ros.ros.shared.runtime import ros

    with ros([]) as ending:
        director = Director(f'/live_{os.getpid()}', ending)
        ended = SimpleNamespace(name='monitor', process=SimpleNamespace(poll=lambda: 1))
        director.nodes = [ended]
        with pytest.raises(TendonRobotError, match='the monitor has ended with code 1'):
            director.wait_until_up()
        director.destroy_node()


@pytest.mark.slow
@pytest.mark.parametrize('name', ['hinge_friction', 'backbone_stiffness', 'none', 'soft_cell'])
def test_every_kind_of_story_comes_true(name):
    code, text = told('--hidden', name, '--seed', '1', timeout=600.0)
    assert code == 0, text


@pytest.mark.parametrize(
    ('arguments', 'words'),
    [
        (['--hidden', 'gremlins'], 'hidden: expected one of '),
        (['--postures', '1'], 'expected a whole number from 4 on, got 1'),
        (['--hide', 'x'], 'unrecognized arguments: --hide x; did you mean --hidden? see '),
    ],
)
def test_what_cannot_be_is_one_line(arguments, words, capsys):
    assert main(['live', '--headless', *arguments]) == 1
    said = capsys.readouterr().err.splitlines()
    assert words in said[-1]
    assert [line for line in said if line.startswith('error: ')] == said[-1:]


@pytest.fixture
def page(tmp_path):
    """Start the live page; give its address."""
    pytest.importorskip('viser')
    port = processes.free_port()
    command = [*LIVE, '--hidden', 'hinge_friction', '--seed', '4', '--postures', '14']
    with (tmp_path / 'live.log').open('w+') as log:
        process = processes.Process(
            [*command, '--port', str(port)],
            stdout=log,
            stderr=log,
            cwd=tmp_path,
            env={**os.environ, 'PYTHONPATH': os.getcwd()},
        )
        end = time.monotonic() + 180.0
        while 'open http' not in (tmp_path / 'live.log').read_text():
            assert process.poll() is None and time.monotonic() < end, log.read()
            time.sleep(0.2)
        yield f'http://127.0.0.1:{port}'
        process.send_signal(signal.SIGINT)
        assert process.wait(60.0) == 0


@pytest.mark.browser
@pytest.mark.slow
def test_clicking_record_diagnose_add_makes_the_error_fall(page, tmp_path):
    from live_browser import Browser

    browser = Browser(tmp_path)
    try:
        verdict, before = browser.find_the_effect(page, tmp_path)
        assert 'hinge_friction' in verdict
        assert before > 2.0  # [mm]
        errors = [browser.tip_error() or 0.0 for _ in range(20) if not time.sleep(1.0)]
        assert np.median(errors) < 0.2 * before, 'it must stay low on the whole tour'
        browser.resize(400, 850)
        assert browser.run('document.documentElement.scrollWidth') <= 400
    finally:
        browser.close()


@pytest.mark.browser
def test_the_page_asks_nothing_of_the_network(tmp_path):
    pytest.importorskip('viser')
    from tendon_robot_ros.ros.viewer.page import LivePage

    page = LivePage('127.0.0.1', processes.free_port(), '', 0.2)
    try:
        with urllib.request.urlopen(f'http://127.0.0.1:{page.port}') as answer:
            html = answer.read().decode()
    finally:
        page.close()
    assert 'src="http' not in html and 'href="http' not in html
