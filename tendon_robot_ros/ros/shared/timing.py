"""
Times that several nodes share: how often they speak and ask, and when silence means absence.

What a user may set is a parameter instead (docs/ros_interface.md).
"""

from __future__ import annotations

# [s] Between two states of a status, so that news that comes and goes with every message at the
# largest rate of a node fills neither network nor log.
NEWS_PERIOD_S = 0.02
# [s] Between two messages whose values alone have changed, and between two looks at who publishes
# a topic, because nobody reads more than ten numbers a second.
VALUES_PERIOD_S = 0.1
# [s] After which a status is repeated and another node is asked again, so that who comes later
# knows within a second.
STATUS_PERIOD_S = 1.0
# [s] Between two attempts to start, and between two log entries of the same kind, else a port that
# is missing would fill the log.
RETRY_PERIOD_S = 2.0 * STATUS_PERIOD_S
# [s] Without a message after which its publisher counts as gone. Discovery takes as long, and a
# busy machine is silent for tenths of a second, which would count as an absence.
SILENCE_S = 1.0
# [s] Without an answer after which a request counts as lost and is made again, and without a
# status, which comes every second, after which a node counts as gone: discovery takes 0.1 to
# 2.3 s, else who comes late would be taken for who has gone.
ANSWER_TIMEOUT_S = 3.0
# [s] Without an answer after which a stop is asked for again, because sixty cycles of the default
# rate leave an answer that is not lost enough time.
STOP_ANSWER_S = 0.3
# [s] For a running node to be discovered and to answer, because discovery alone takes 0.1 to
# 2.3 s, and several times that on a busy machine.
NODE_TIMEOUT_S = 15.0
# [s] For an arm to come to rest after a move, be seen and be recorded, because motors lag,
# trackers lose frames, and a busy machine is late with both.
STAND_TIMEOUT_S = 20.0
# [s] For an arm to go anywhere within its reach: at the default rate_limit of 10 N/s a tension
# would change by 600 N, a hundred times the range of the shipped robots.
MOVE_TIMEOUT_S = 60.0
# [s] For all nodes to start or a diagnosis to end, because models compile for minutes on a slow
# machine the first time.
WORK_TIMEOUT_S = 600.0
