"""
The running robot chooses its own postures, until it knows what its description lacks.

Controller, driver and monitor run already, and the tracker sees the arm. Every posture is played
by the controller, within its limits; a stop of driver or controller ends it, Ctrl-C lets the arm
go. With one name left (or --add) the controller gets the better description, unless --keep. DIR
gets data, recording, diagnosis, report and description; --resume goes on. After a drift alarm of
the monitor the first postures are those that tell what has changed.

Topics: investigate/progress (std_msgs/String, JSON), investigate/status. Services:
investigate/start, investigate/stop. With --wait it starts when that is called, from the live page
for one.

example: python -m tendon_robot_ros investigate --output found --keep-out regions.yaml
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from std_msgs.msg import Bool, String
from std_srvs.srv import Trigger

from ...common.errors import InputError, TendonRobotError
from ...data.dataset import LOADINGS
from ...investigation.goal import add_goal, goal_of
from ...investigation.loop import Findings, Investigation, write_results
from ...investigation.measuring import News
from ...investigation.record import BETTER
from ...robot.keep_out import KeepOut, load_keep_out
from ..shared.lifecycle import OK, WARN, Status
from ..shared.messages import LATCHED, LATCHED_BY_MANY
from ..shared.parameters import RemoteText
from ..shared.robot_client import add_controller
from ..shared.running_arm import RunningArm
from ..shared.runtime import repeat, ros

HELP = 'the running robot chooses postures by itself until it knows what its model lacks'
TRIALS = 1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add = parser.add_argument
    add_goal(parser, TRIALS)
    add('--path', choices=LOADINGS, default=LOADINGS[0],
        help='let go before every posture, or go from one to the next')  # fmt: skip
    add('--speed', type=float, default=0.2, metavar='X',
        help='of an input, in largest tensions per second (default: 0.2)')  # fmt: skip
    add('--keep', action='store_true', help='do not send the controller what was found')
    add('--wait', action='store_true', help='wait for investigate/start; DIR gets a folder each')
    add('--monitor', default='monitor', metavar='NAME', help='of the node (default: monitor)')
    add_controller(parser)


def run(args: argparse.Namespace, ros_arguments: Sequence[str]) -> int:
    """Investigate once, or whenever it is asked."""
    goal_of(args)  # what cannot be is refused before anything is started
    if not 0.001 <= args.speed <= 100.0:
        raise InputError(f'--speed: expected 0.001 to 100, got {args.speed:g}')
    regions = load_keep_out(args.keep_out) if args.keep_out else KeepOut()
    with ros(ros_arguments) as ending:
        arm = RunningArm(args.controller, args.monitor, ending, None, args.path, args.speed)
        try:
            investigator = Investigator(arm, args, regions)
            if args.wait:
                investigator.serve()
            investigator.once(Path(args.output), args.resume)
            return 0
        except KeyboardInterrupt:
            return 130
        finally:
            arm.destroy_node()


class Investigator:
    """ROS around an investigation: services, progress, status."""

    def __init__(self, arm: RunningArm, args: argparse.Namespace, regions: KeepOut) -> None:
        """Offer the services."""
        self.arm, self.args, self.regions = arm, args, regions
        self._asked = False
        self._busy = False
        self._status = Status(arm, 'investigation')
        self._progress = arm.create_publisher(String, '~/progress', LATCHED_BY_MANY)
        self._tour = arm.create_publisher(Bool, 'tour', LATCHED)
        self._model = RemoteText(arm, args.controller, 'model')
        arm.create_service(Trigger, '~/start', self._start)
        arm.create_service(Trigger, '~/stop', self._stop)
        repeat(arm, 1.0, self._say)

    def serve(self) -> None:
        """Investigate whenever it is asked, until a signal comes."""
        while True:
            self._asked = self.arm.stop_asked = False
            while not self._asked:
                self.arm.spin_once(0.1)
            folder = Path(self.args.output) / time.strftime('%Y-%m-%d_%H-%M-%S')
            try:
                self.once(folder, False)
            except TendonRobotError as error:
                self.arm.stop_asked = False
                self.tell(News('failed', ' '.join(str(error).split())))

    def once(self, folder: Path, resume: bool) -> Findings:
        """Investigate, write, and give the controller what was found."""
        args = self.args
        self._busy = True
        try:
            self._tour.publish(Bool(data=False))
            self.arm.begin()
            goal, change = goal_of(args), self.arm.change()
            investigation = Investigation(
                self.arm, goal, folder, self.regions, self.tell, resume, change
            )
            findings = investigation.run()
            lines = write_results(findings, folder, investigation.catalogue, args.add)
            print(*lines, sep='\n', flush=True)
            if (folder / BETTER).exists() and not args.keep:
                self._send(folder / BETTER)
            return findings
        finally:
            self._busy = False
            self._tour.publish(Bool(data=True))
            self._say()

    def tell(self, news: News) -> None:
        """Print and publish what happens."""
        print(news.text, flush=True)
        content: dict[str, Any] = {'kind': news.kind, 'text': news.text, **news.content}
        self._progress.publish(String(data=json.dumps(content)))

    def _send(self, path: Path) -> None:
        """Give the controller the better description."""
        answers: list[tuple[bool, str]] = []
        self._model.put(str(path.resolve()), lambda taken, why: answers.append((taken, why)))
        self.arm.wait(lambda: answers, 30.0, 'an answer of the controller', strict=False)
        taken, why = answers[0] if answers else (False, 'it does not answer')
        said = 'the controller uses it' if taken else f'the controller refuses it: {why}'
        self.tell(News('sent', said, {'taken': taken}))

    def _say(self) -> None:
        """Publish how it is."""
        code = 'asking' if self._busy else 'waiting'
        text = 'investigating' if self._busy else 'call ~/start to investigate'
        self._status.say(WARN if self._busy else OK, code, text, {})

    def _start(self, request: object, response: Trigger.Response) -> Trigger.Response:
        response.success = not self._busy
        response.message = 'an investigation runs already' if self._busy else 'investigating'
        self._asked = not self._busy
        return response

    def _stop(self, request: object, response: Trigger.Response) -> Trigger.Response:
        response.success = self._busy
        response.message = 'stopping' if self._busy else 'no investigation runs'
        self.arm.stop_asked = self._busy
        return response
