"""A campaign whose cases take a tenth of a second each."""

from dataclasses import replace

from source_tree import ROOT

from tendon_robot_ros.studies.plan import plan_of

ROBOT = str(ROOT / 'config' / 'robots' / 'kato_10_1_single.yaml')
CHEAP = {
    'robots': [ROBOT],
    'hidden': ['hinge_friction'],
    'sizes': [1.0],
    'seeds': 2,
    'clean': 2,
    'imperfections': [0],
    'exact': True,
    'designs': [{'postures': 4, 'trials': 3, 'markers': 4}],
}


def plan(**changes):
    """Return a plan of cases that take a tenth of a second each."""
    return plan_of(CHEAP | changes, 'plan.yaml')


def without_time(rows):
    """Take off what differs from run to run."""
    return [replace(row, seconds=0.0) for row in rows]
