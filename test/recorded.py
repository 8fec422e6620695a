"""Recordings as a laboratory makes them: noise, drop-outs, topics with their own rates."""

import dataclasses

import numpy as np
from small_dataset import ROBOT

from tendon_robot_ros.data.bag_reader import POSE_STAMPED
from tendon_robot_ros.data.bag_writer import JOINT_STATE, POSE_ARRAY, BagWriter, Builder
from tendon_robot_ros.robot import parse_robot

SMALL = parse_robot(ROBOT)
STRAIGHT = np.array([[0.0, 0.0, 0.01], [0.0, 0.0, 0.02], [0.0, 0.0, 0.03]])
BENT = STRAIGHT + [[0.002, 0.0, 0.0], [0.005, 0.0, -0.001], [0.009, 0.0, -0.003]]
TURNED = STRAIGHT - [[0.001, 0.0, 0.0], [0.003, 0.0, 0.0], [0.006, 0.0, 0.0]]
REST, LEFT, RIGHT = (0.1, 0.1), (1.0, 0.1), (0.1, 0.7)
# shape, inputs, seconds to get there, seconds there
LOADED_TWICE = [
    (STRAIGHT, REST, 0.0, 2.0), (BENT, LEFT, 0.5, 3.0), (STRAIGHT, REST, 0.5, 2.0),
    (TURNED, RIGHT, 0.5, 3.0), (STRAIGHT, REST, 0.5, 2.0), (BENT, LEFT, 0.5, 3.0),
    (STRAIGHT, REST, 0.5, 2.0), (TURNED, RIGHT, 0.5, 3.0),
]  # fmt: skip


@dataclasses.dataclass
class Recorder:
    """Write a recording message by message."""

    rate: float = 100.0  # [1/s] of the tracker
    noise: float = 2e-4  # [m]
    ripple: float = 1e-3  # [N]
    names: tuple = ('left', 'right')
    frame: str = 'base'
    by_topic: bool = False  # one PoseStamped topic per marker instead of a PoseArray
    tensions: bool = True  # else the efforts are NaN, as a driver gives them in pull mode
    lost: tuple = ()  # (marker, begin [s], end [s]) not seen then
    since: float = 0.0  # [s] from which there are tendon states
    until: float = np.inf  # [s] after which there are none
    silent: bool = False  # a lost marker has no message on its topic, else one of NaN

    def write(self, path, plan):
        """Follow a plan: shape, inputs, seconds to get there, seconds there."""
        rng = np.random.default_rng(1)
        with BagWriter(path) as writer:
            self.build = Builder(writer.types, self.frame)
            writer.add_topic('/tendon_states', JOINT_STATE)
            for i in range(3 if self.by_topic else 0):
                writer.add_topic(f'/tracker/m{i}', POSE_STAMPED)
            if not self.by_topic:
                writer.add_topic('/measured_shape', POSE_ARRAY)
            for count, (shape, inputs) in enumerate(self._instants(plan)):
                now = count / self.rate
                time = 1_700_000_000_000_000_000 + round(1e9 * now)
                noisy = shape + rng.normal(0.0, self.noise, shape.shape)
                for marker, begin, end in self.lost:
                    if begin <= now < end:
                        noisy[marker] = np.nan
                self._write(writer, time, noisy, inputs + rng.normal(0.0, self.ripple, 2))
        return path

    def _instants(self, plan):
        last = plan[0][:2]
        for shape, inputs, way, stay in plan:
            goal = (shape, np.array(inputs))
            for share in np.linspace(0.0, 1.0, round(way * self.rate), endpoint=False):
                yield tuple(
                    np.add(a, share * np.subtract(b, a)) for a, b in zip(last, goal, strict=True)
                )
            yield from [goal] * round(stay * self.rate)
            last = goal

    def _write(self, writer, time, shape, inputs):
        unknown = np.full(2, np.nan)
        tension, pull = (inputs, unknown) if self.tensions else (unknown, inputs * 1e-3)
        message = self.build.joint_state(time, self.names, pull, tension)
        now = 1e-9 * (time - 1_700_000_000_000_000_000)
        if self.since <= now <= self.until:
            writer.write('/tendon_states', time, message)
        turned = np.tile([0.0, 0.0, 0.0, 1.0], (3, 1))
        array = self.build.pose_array(time, shape, turned)
        if not self.by_topic:
            writer.write('/measured_shape', time, array)
            return
        stamped = writer.types.types[POSE_STAMPED]
        for i, pose in enumerate(array.poses):
            late = time + i * 1_000_000
            if self.silent and np.isnan(shape[i]).any():
                continue
            writer.write(f'/tracker/m{i}', late, stamped(header=array.header, pose=pose))
