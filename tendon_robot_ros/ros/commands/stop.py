"""
Stop every controller and driver that can be found, and say whether all of them have stopped.

Exit code 0: every one has answered that it is stopped; 1: somebody has not, a controller has no
driver beside it, or nobody was found. It takes 2 s from the beginning of discovery; who is found
is stopped at once, on the same computer without any discovery. The stop stays until the reset of
each is called. This is no safety-rated stop.

example: python -m tendon_robot_ros stop --namespace /left_arm
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence

from ...common.errors import InputError, TendonRobotError
from ...common.local_stop import stop_local
from ...common.processes import go_first
from ...common.results import JSON_OPTION, emit
from ..shared.timing import STOP_ANSWER_S

HELP = 'stop every controller and driver, say whether they have stopped'
NO_SOFTWARE = 'use the switch in the supply of the motors'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    what = 'stop what is in this one and below it (default: all namespaces)'
    parser.add_argument('--namespace', default='/', metavar='NAMESPACE', help=what)
    parser.add_argument('--json', **JSON_OPTION)


def run(args: argparse.Namespace, ros_arguments: Sequence[str]) -> int:
    """Stop every controller and driver that is discovered."""
    go_first()
    below, text = '/' + args.namespace.strip('/'), os.environ.get('ROS_DOMAIN_ID') or '0'
    if not text.isdecimal():
        raise InputError(f'ROS_DOMAIN_ID: expected a number, got {text!r}')
    domain = int(text)
    local = stop_local(domain, below, STOP_ANSWER_S)
    from ..shared.stopping import stop_nodes  # a slow import, after the local stop

    results = stop_nodes(ros_arguments, below, local)
    emit(args, {'stopped': sorted(results)}, verdict(results, below, domain))
    return 0


def verdict(results: dict[str, tuple[bool, str]], below: str, domain: int) -> str:
    """
    Return which nodes have stopped, as text.

    Parameters
    ----------
    results : dict
        Name of a node -> whether it drives motors, and why it has not stopped ('': it has).
    below : str
        Namespace.
    domain : int

    Raises
    ------
    TendonRobotError
        A node has not stopped, or none was discovered.

    """
    if not results:
        where = below if below != '/' else 'any namespace'
        raise TendonRobotError(
            f'nothing was stopped: no controller or driver found in {where} of ROS_DOMAIN_ID '
            f'{domain}; if an arm moves, {NO_SOFTWARE}'
        )
    if problems := [f'{name} {why}' for name, (_, why) in sorted(results.items()) if why]:
        raise TendonRobotError(f'not stopped: {"; ".join(problems)}; {NO_SOFTWARE}')
    driven = {name.rpartition('/')[0] for name, (drives, _) in results.items() if drives}
    names = ', '.join(sorted(results))
    for name in sorted(results):
        if name.rpartition('/')[0] not in driven:
            raise TendonRobotError(
                f'stopped: {names}; but no driver was found beside {name}; {NO_SOFTWARE}'
            )
    return f'stopped: {names} (call reset of each to go on)'
