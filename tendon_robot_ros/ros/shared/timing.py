"""
Times that several nodes share: periods of messages and requests, and time-outs.

Times that a user may set are parameters instead (ros/parameters.yaml).
"""

from __future__ import annotations

from ...common.local_stop import SILENCE_S as SILENCE_S

# [s] Between two changes of a status, so that a state that alternates at the largest rate of a
# node fills neither network nor log.
NEWS_PERIOD_S = 0.02
# [s] Between two statuses whose values alone have changed, and between two checks of the
# publishers of a topic, because nobody reads more than ten numbers a second.
VALUES_PERIOD_S = 0.1
# [s] After which a status is repeated and a request to another node too, so that a node that
# starts later is up to date within a second.
STATUS_PERIOD_S = 1.0
# [s] Between two attempts to start, and between two log entries of the same kind, else a port that
# is missing would fill the log.
RETRY_PERIOD_S = 2.0 * STATUS_PERIOD_S
# [s] Without an answer after which a request is repeated, and without a status (one a second)
# after which a node counts as gone: discovery takes 0.1 to 2.3 s, else a node that is discovered
# late would count as gone.
ANSWER_TIMEOUT_S = 3.0
# [s] Without an answer after which a request to stop is repeated, because sixty cycles of the
# default rate are enough for an answer that is not lost.
STOP_ANSWER_S = 0.3
# [s] For the motors to carry out a call or a release, a process to end, and a tip to come to rest,
# because a Dynamixel that restarts answers after up to 2 s, and a release of 5 N at the default
# release_rate takes 0.5 s.
CALL_TIMEOUT_S = 5.0
# [s] For a running node to be discovered and to answer, and for an arm to come to rest after a
# move, be seen and be recorded, because discovery alone takes 0.1 to 2.3 s, motors lag, trackers
# lose frames, and a busy machine is several times as late with all of that.
REACTION_TIMEOUT_S = 20.0
# [s] For an arm to go anywhere within its reach: at the default rate_limit of 10 N/s a tension
# would change by 600 N, a hundred times the range of the shipped robots.
MOVE_TIMEOUT_S = 60.0
# [s] For all nodes to start, torque to come on or a diagnosis to end, because models compile for
# minutes on a slow machine the first time, and a driver may search for the slack of a dozen wires.
WORK_TIMEOUT_S = 600.0
