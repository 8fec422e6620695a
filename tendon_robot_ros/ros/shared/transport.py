"""
How the nodes reach each other: by UDP, on one machine too.

Fast DDS, the usual middleware of Jazzy, has a shared-memory transport besides. A process that is
killed while it holds a lock there, or leaves a port behind, keeps every other process that sends
to it from going on: for 0.3 to 1 s each time, 5.5 s at worst, with all its threads, because rclpy
keeps Python's lock while it sends (eProsima/Fast-DDS#6535, `benchmarks/bench_killed.py`). Neither
a stop nor a watchdog would be heard in that time. A node that has no shared memory does not wait.
"""

from __future__ import annotations

import os

from ...common.files import shared_file

RANGE, ONLY_HERE = 'ROS_AUTOMATIC_DISCOVERY_RANGE', 'ROS_LOCALHOST_ONLY'
TRANSPORTS, PROFILES = 'FASTDDS_BUILTIN_TRANSPORTS', 'FASTRTPS_DEFAULT_PROFILES_FILE'
LOCALHOST_PROFILE = 'config/fastdds_localhost.xml'


def without_shared_memory() -> None:
    """
    Have the nodes of this process, and of its children, do without the shared memory of Fast DDS.

    To be called before the first node. Who has set transports or a profile of his own keeps them;
    other middlewares do not read these variables. rmw_fastrtps adds the shared memory by itself
    where `ROS_AUTOMATIC_DISCOVERY_RANGE` is LOCALHOST; a profile then says what that means. With
    `ROS_STATIC_PEERS` it cannot, and the shared memory stays.
    """
    if os.environ.get(TRANSPORTS) or os.environ.get(PROFILES):
        return
    os.environ[TRANSPORTS] = 'UDPv4'
    here = os.environ.get(RANGE) == 'LOCALHOST' or os.environ.get(ONLY_HERE) == '1'
    profile = shared_file(LOCALHOST_PROFILE)
    if here and profile is not None and not os.environ.get('ROS_STATIC_PEERS'):
        os.environ[PROFILES] = str(profile)
        os.environ[RANGE] = 'SYSTEM_DEFAULT'
        os.environ.pop(ONLY_HERE, None)
