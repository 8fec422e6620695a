"""
Record what the running robot says, until Ctrl-C: a rosbag2 folder with one .mcap file.

All topics of the namespace are recorded as they come, and those that no namespace has (/tf,
/tf_static, /diagnostics), with their message definitions, so that Foxglove, PlotJuggler and
`ros2 bag play` open the file. The description of the robot, as the
controller has it, goes in, too: `compare`, `diagnose`, `plot`, `follow` and `import bag` take the
recording as it is.

example: python -m tendon_robot_ros record run1
"""

from __future__ import annotations

import argparse
import importlib
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

from ...common.errors import InputError, TendonRobotError
from ...common.files import write_errors
from ...common.results import JSON_OPTION, emit, narrate
from ...common.words import typed
from ...data import bag_writer
from ...robot import dump_robot, load_robot
from ..shared.inbox import polled
from ..shared.interface import quality
from ..shared.parameters import RemoteParameter
from ..shared.robot_client import MESSAGES_MAX, add_controller
from ..shared.runtime import ClientNode, repeat, ros
from ..shared.timing import NEWS_PERIOD_S, VALUES_PERIOD_S

HELP = 'record the running robot to an mcap file'
TOPICS_EXCLUDED = ('/rosout', '/parameter_events')
TOPICS_OF_ALL = ('/tf', '/tf_static', '/diagnostics')  # of every namespace
# a robot that moves from posture to posture; its tensions are known to 0.2 %, as in the monitor
DATASET_DEFAULTS = 'path: sequence\ntension_noise: {setting: 0.002}\n'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add, named = parser.add_argument, time.strftime('recording_%Y-%m-%d_%H-%M-%S')
    add(
        'output', nargs='?', default=named, metavar='DIR', help='new folder (default: by the time)'
    )
    what = 'seconds (default: to Ctrl-C)'
    add('--duration', type=float, default=float('inf'), metavar='S', help=what)
    add('--topics', nargs='+', default=[], metavar='TOPIC', help='only these (default: all)')
    what = 'of the folder (default: mcap)'
    add('--storage', choices=bag_writer.STORAGES, default='mcap', help=what)
    add_controller(parser)
    add('--json', **JSON_OPTION)


def run(args: argparse.Namespace, ros_arguments: Sequence[str]) -> int:
    """Record until a signal comes or the duration is over."""
    bag_writer.need_rosbags()
    if not args.duration > 0.0:
        raise InputError(f'--duration: expected more than 0, got {args.duration:g}')
    with (
        ros(ros_arguments) as ending,
        write_errors(Path(args.output)),
        bag_writer.BagWriter(args.output, args.storage) as writer,
        Recorder(writer, args.controller, args.topics) as recorder,
    ):
        narrate(args, f'recording to {args.output}; Ctrl-C ends')
        began = time.monotonic()
        while not ending.signal and time.monotonic() - began < args.duration:
            recorder.serve(NEWS_PERIOD_S)
            recorder.drain()
    seconds = time.monotonic() - began
    content = {'messages': recorder.counts, 'seconds': seconds, 'written': args.output}
    emit(args, content, recorder.summary(args.output, seconds))
    return 0 if recorder.counts else 1


class Recorder(ClientNode):
    """
    Subscribes to topics and writes their serialised messages.

    No executor serves the subscriptions, because it takes one message per wait, which is late on a
    busy machine: `drain` takes them, and the time of a message is that of its arrival.
    """

    def __init__(
        self, writer: bag_writer.BagWriter, controller: str, topics: Sequence[str]
    ) -> None:
        """Discover topics now and periodically."""
        super().__init__('record')
        self._writer, self.counts = writer, dict[str, int]()
        self._only = {self.resolve_topic_name(topic) for topic in topics}
        self._subscribed: set[str] = set()
        self._sources: list[tuple[str, type, Any]] = []  # topic, type, handle
        self._robot = RemoteParameter(self, controller, 'model')
        self._robot_written = False
        for topic in (bag_writer.DESCRIPTION, bag_writer.ROBOT):
            writer.add_topic(topic, bag_writer.STRING, latched=True)
        self._write_text(bag_writer.DESCRIPTION, DATASET_DEFAULTS)
        repeat(self, VALUES_PERIOD_S, self._discover)
        self._discover()

    def destroy_node(self) -> None:
        """Destroy the subscriptions and the node."""
        for *_, handle in self._sources:
            handle.destroy_when_not_in_use()
        super().destroy_node()

    def summary(self, output: str, seconds: float) -> str:
        """Return a summary of the recording, as text."""
        total = sum(self.counts.values())
        text = f'{total} messages of {len(self.counts)} topics in {seconds:.1f} s: {output}'
        if not total:
            return f'{text}\nnothing was published here: is the robot running, in this namespace?'
        if not self._robot_written:
            text += '\nno description of the robot: name it with --robot when you use this'
        return f'{text}\nnext: {typed("plot", output)}'

    def _discover(self) -> None:
        space = self.get_namespace().rstrip('/') + '/'
        for topic, kinds in self.get_topic_names_and_types():
            own = topic.startswith(space) or topic in TOPICS_OF_ALL
            selected = topic in self._only or (not self._only and own)
            if selected and topic not in self._subscribed and topic not in TOPICS_EXCLUDED:
                publishers = self.get_publishers_info_by_topic(topic)
                if publishers:
                    self._subscribed.add(topic)
                    self._subscribe(topic, kinds[0], publishers)

        def write(text: str) -> None:
            self._robot_written = True
            try:
                self._write_text(bag_writer.ROBOT, dump_robot(load_robot(text)))
            except (TendonRobotError, OSError) as error:
                print(f'the robot cannot be read: {error}', file=sys.stderr)

        if not self._robot_written:
            self._robot.ask(write)

    def _subscribe(self, topic: str, kind: str, publishers: Sequence[Any]) -> None:
        package, _, name = kind.partition('/msg/')
        profiles = [publisher.qos_profile for publisher in publishers]
        reliable = all(one.reliability == ReliabilityPolicy.RELIABLE for one in profiles)
        latched = all(one.durability == DurabilityPolicy.TRANSIENT_LOCAL for one in profiles)
        try:
            message = getattr(importlib.import_module(f'{package}.msg'), name)
            self._writer.add_topic(topic, kind, latched)
        except Exception as error:  # the type is not installed, or unknown to rosbags
            print(f'left out: {topic}: {kind} is not known here ({error})', file=sys.stderr)
            return
        qos = quality(MESSAGES_MAX, reliable=reliable, latched=latched)
        self._sources.append((topic, message, polled(self, message, topic, qos)))

    def drain(self) -> None:
        """Write all received messages, with the times of their arrival."""
        for topic, kind, handle in self._sources:
            with handle:
                while (received := handle.take_message(kind, True)) is not None:
                    data, info = received
                    time = info['received_timestamp'] or info['source_timestamp']
                    self.counts[topic] = self.counts.get(topic, 0) + 1
                    self._writer.write(topic, time or self.get_clock().now().nanoseconds, data)

    def _write_text(self, topic: str, text: str) -> None:
        message = bag_writer.Builder(self._writer.types).string(text)
        self._writer.write(topic, self.get_clock().now().nanoseconds, message)
