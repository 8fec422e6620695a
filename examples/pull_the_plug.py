"""
Drive emulated Dynamixel servos to the paper's postures and pull their plug on the way.

python examples/pull_the_plug.py [tension|pull]

Four processes: emulated servos on a port of their own, the driver with backend dynamixel, the
controller, and this one. The tip is where the emulated arm really is. In tension mode the servos
set the current, and their gears' friction bends the arm elsewhere; in pull mode they set wire
lengths.
"""

import sys
import time

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import JointState

from tendon_robot_ros.common.files import shared_file
from tendon_robot_ros.common.rotations import towards
from tendon_robot_ros.emulator.port import EmulatorProcess
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.robot import load_robot
from tendon_robot_ros.ros.shared.interface import COMMAND, LATCHED, LISTEN
from tendon_robot_ros.ros.shared.messages import pose_stamped
from tendon_robot_ros.ros.shared.runtime import NodeProcess
from tendon_robot_ros.workspace.view_angle import salient

ROBOT, SPACE = 'kato_10_1', '/plug'
SETTLED = ('reached', 'nearest', 'at_limit')


class Watcher:
    """Sends targets, hears statuses and tendons."""

    def __init__(self):
        self.node = rclpy.create_node('watcher', namespace=SPACE)
        self.targets = self.node.create_publisher(PoseStamped, 'controller/target_pose', COMMAND)
        self.controller, self.driver, self.said, self.states = {}, {}, [], []
        self.sent = ''  # stamp of the target
        hear = self.node.create_subscription
        hear(DiagnosticStatus, 'controller/status', self.hear_controller, LATCHED)
        hear(DiagnosticStatus, 'driver/status', self.hear_driver, LATCHED)
        hear(JointState, 'tendon_states', self.states.append, LISTEN)

    def hear_controller(self, status):
        self.controller = {item.key: item.value for item in status.values}

    def hear_driver(self, status):
        self.driver = {item.key: item.value for item in status.values}
        if not self.said or self.said[-1][1] != status.message:
            self.said.append((time.monotonic(), status.message))

    def until(self, condition, seconds, what):
        end = time.monotonic() + seconds
        while not condition():
            if time.monotonic() > end:
                sys.exit(f'waited {seconds:g} s in vain for {what}: {self.said[-1:]}')
            rclpy.spin_once(self.node, timeout_sec=0.02)

    def still(self):
        recent = np.array([state.position for state in self.states[-100:]])
        return len(recent) == 100 and np.ptp(recent, axis=0).max() < 5e-5

    def well(self):
        return self.driver['code'] in ('released', 'holding') and not self.driver['faults']

    def go(self, posture):
        """Go there; again where a busy machine has made the driver let go on the way."""
        self.send(posture)
        sent = time.monotonic()

        def there():
            nonlocal sent
            if self.controller['code'] == 'released' and time.monotonic() > sent + 1.0:
                self.send(posture)
                sent = time.monotonic()
            mine = self.controller.get('target_stamp') == self.sent
            return mine and self.controller['code'] in SETTLED

        def stands():
            return there() and self.still()

        self.until(there, 20, posture.name)
        self.states.clear()
        self.until(stands, 30, f'the arm at {posture.name}')

    def send(self, posture):
        header = PoseStamped().header
        header.frame_id = f'{ROBOT}_base'
        header.stamp = self.node.get_clock().now().to_msg()
        self.sent = f'{header.stamp.sec}.{header.stamp.nanosec:09d}'
        self.targets.publish(pose_stamped(header, posture.position, towards(posture.direction)))


def row(watcher, servos, posture):
    tip = np.array(servos.ask('state')['tip'])
    miss = 1e3 * np.linalg.norm(tip - posture.position)
    effort, pull = watcher.states[-1].effort, watcher.states[-1].position
    print(
        f'{posture.name:20} ({1e3 * tip[0]:6.1f}, {1e3 * tip[2]:6.1f}) {miss:6.1f} mm   '
        f'{" ".join(f"{1e3 * p:6.1f}" for p in pull)}   '
        f'{" ".join(f"{t:5.2f}" for t in effort)}   {watcher.controller["code"]}',
        flush=True,
    )


def pull_the_plug(watcher, servos):
    """Unplug for a second and print what the driver says meanwhile."""
    watcher.said.clear()
    began = time.monotonic()
    servos.say('unplug')
    print('    -- the plug is pulled --')
    watcher.until(lambda: time.monotonic() > began + 1.0, 2, 'a second')
    servos.say('plug')
    plugged = time.monotonic()
    watcher.until(watcher.well, 10, 'the motors')
    for when, message in watcher.said:
        print(f'    {when - began:5.2f} s  driver: {message.replace(servos.port, "PORT")}')
    print(f'    -- plugged in again after 1 s, heard {time.monotonic() - plugged:.2f} s later --')
    watcher.until(lambda: watcher.controller['code'] == 'released', 10, 'the controller')
    print('    -- the arm stays where it is until a target comes; it is sent anew --')


def main():
    mode = sys.argv[1] if len(sys.argv) > 1 else 'tension'
    model = Model(load_robot(ROBOT))
    postures = salient(model)
    rclpy.init()
    watcher = Watcher()
    with EmulatorProcess(shared_file(f'config/robots/{ROBOT}.yaml')) as servos:
        driver = {'robot': ROBOT, 'backend': 'dynamixel', 'config': str(servos.config)}
        driver |= {'command_mode': mode, 'pull_rate_limit': 0.02}
        with (
            open('/dev/null', 'w', encoding='utf-8') as quiet,
            NodeProcess('driver', driver, SPACE, quiet),
            NodeProcess('controller', {'model': ROBOT, 'command_mode': mode}, SPACE, quiet),
        ):
            watcher.until(
                lambda: watcher.controller.get('code') in ('holding', 'released'), 120, 'the nodes'
            )
            print(
                f'{"target":20} {"tip [mm]":16} {"missed by":9}   {"wire pulls [mm]":27}   '
                f'{"tensions [N]":23}   controller'
            )
            for number, posture in enumerate(postures):
                watcher.go(posture)
                row(watcher, servos, posture)
                if number == 1:
                    pull_the_plug(watcher, servos)
                    watcher.go(posture)
                    row(watcher, servos, posture)
    watcher.node.destroy_node()
    rclpy.shutdown()


if __name__ == '__main__':
    main()
