"""A stop on the same computer that needs no discovery."""

import os
import socket

import pytest

from tendon_robot_ros.common.errors import TendonRobotError
from tendon_robot_ros.common.local_stop import StopListener, Stoppable, stop_local
from tendon_robot_ros.ros.commands.stop import verdict

DOMAIN = 10_000 + os.getpid()  # of this test alone
DRIVER, CONTROLLER = Stoppable('/left/driver', True), Stoppable('/left/controller', False)
OTHER = Stoppable('/left_too/driver', True)


@pytest.fixture
def listening():
    told, made = [], []

    def listen(*who):
        made.extend(StopListener(DOMAIN, one, lambda one=one: told.append(one)) for one in who)
        return told

    yield listen
    for one in made:
        one.close()


@pytest.mark.parametrize(
    ('below', 'stopped'),
    [
        ('/', {DRIVER, CONTROLLER, OTHER}),
        ('/left', {DRIVER, CONTROLLER}),
        ('/left_too/', {OTHER}),
        ('/nowhere', set()),
    ],
)
def test_all_of_a_namespace_are_stopped_and_say_so(listening, below, stopped):
    told = listening(DRIVER, CONTROLLER, OTHER)
    assert stop_local(DOMAIN, below, 5.0) == dict.fromkeys(stopped, True)
    assert set(told) == stopped
    assert stop_local(DOMAIN + 1, below, 5.0) == {}


def test_who_hangs_is_named_and_keeps_nobody_from_stopping(listening):
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as hangs:
        hangs.bind(f'\0tendon_robot_ros.stop.{DOMAIN}.0.0.driver/a/driver')
        hangs.listen()
        told = listening(DRIVER)
        found = stop_local(DOMAIN, '/', 0.3)
    assert found == {DRIVER: True, Stoppable('/a/driver', True): False}
    assert told == [DRIVER]


def test_who_has_ended_listens_no_more(listening):
    StopListener(DOMAIN, DRIVER, lambda: None).close()
    assert stop_local(DOMAIN, '/', 1.0) == {}


@pytest.mark.parametrize(
    ('found', 'said'),
    [
        ({}, 'no controller or driver found in any namespace of ROS_DOMAIN_ID 7'),
        ({'/driver': (True, ''), '/controller': (False, '')}, None),
        ({'/driver': (True, '')}, None),
        ({'/driver': (True, 'does not answer')}, r'not stopped: /driver does not answer; use'),
        ({'/a/driver': (True, ''), '/b/controller': (False, '')}, r'beside /b/controller'),
    ],
)
def test_only_when_all_have_stopped_all_is_well(found, said):
    if said is None:
        assert verdict(found, '/', 7).startswith('stopped: ')
    else:
        with pytest.raises(TendonRobotError, match=said):
            verdict(found, '/', 7)
