"""Nodes hear others of any transport, and are held up by nobody's shared memory."""

import os
import sys

import pytest

pytest.importorskip('rclpy')

from compiling import ROOT
from forked import Forked
from processes import PIPE

from tendon_robot_ros.ros.shared import runtime

pytestmark = pytest.mark.ros
SAYS = """
import time, rclpy
from std_msgs.msg import String
rclpy.init()
node = rclpy.create_node('user')
publisher = node.create_publisher(String, 'said', 1)
while True:
    publisher.publish(String(data='by any user'))
    time.sleep(0.05)
"""
HEARS = """
import os, sys, time, rclpy
from std_msgs.msg import String
from tendon_robot_ros.ros.shared.runtime import ros
with ros([]):
    node, heard = rclpy.create_node('own'), []
    node.create_subscription(String, 'said', heard.append, 1)
    end = time.monotonic() + 60.0
    while not heard and time.monotonic() < end:
        rclpy.spin_once(node, timeout_sec=0.1)
    tasks = [open(f'/proc/self/task/{one}/comm').read() for one in os.listdir('/proc/self/task')]
print(len(heard), sum('.udp.' in one for one in tasks), sum('.shm.' in one for one in tasks))
"""


def started(code, **environment):
    plain = {
        key: value for key, value in os.environ.items() if not key.startswith(('ROS_', 'FAST'))
    }
    given = {**plain, 'ROS_DOMAIN_ID': os.environ['ROS_DOMAIN_ID'], 'PYTHONPATH': str(ROOT)}
    given |= {'AMENT_PREFIX_PATH': sys.prefix, **environment}
    return Forked(['-c', code], env=given, stdout=PIPE)


@pytest.mark.parametrize(
    'environment',
    [
        {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'},
        {'ROS_LOCALHOST_ONLY': '1'},
        {'ROS_STATIC_PEERS': '127.0.0.1'},  # a range of its own would need multicast
    ],
    ids=lambda environment: next(iter(environment)),
)
def test_a_node_hears_a_user_with_shared_memory_and_has_none(environment):
    with started(SAYS, **environment), started(HEARS, **environment) as own:
        heard, udp, shared = own.communicate(timeout=120.0)[0].split()
    assert int(heard) and int(udp)
    assert int(shared) == 0, 'a killed process would hold it up'


@pytest.mark.parametrize('name', [runtime.TRANSPORTS, runtime.PROFILES])
def test_transports_of_the_user_are_kept(name, monkeypatch):
    for key in (runtime.TRANSPORTS, runtime.PROFILES):
        monkeypatch.delenv(key, raising=False)
    monkeypatch.setenv(name, 'own')
    before = dict(os.environ)
    runtime.without_shared_memory()
    assert dict(os.environ) == before
