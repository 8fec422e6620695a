"""Emulated servos, the real driver node on them, and a sender of commands, for the tests."""

import contextlib
import threading
import time
from functools import partial

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from emulated import ForkedEmulator
from marks import slow
from ros_station import Station, last, stamp, start, values
from sensor_msgs.msg import JointState

from tendon_robot_ros.common.files import shared_file
from tendon_robot_ros.drivers.dynamixel.config import from_data_sheet
from tendon_robot_ros.drivers.dynamixel.control_table import MODELS, Counts
from tendon_robot_ros.ros.shared.interface import COMMAND

ROBOT = 'kato_10_1'
TENSION = [1.5, 0.4, 1.0, 0.3]  # [N]
PULL = [0.006, -0.006, 0.003, -0.003]  # [m]


class Rig:
    """Emulated servos, the driver node on them, and a sender of commands."""

    kind = 'dynamixel'
    near = 0.1, 1e-3  # [N], [m] of an arm to its command

    def __init__(self, mode, folder):
        self.mode = mode
        self.servos = ForkedEmulator(shared_file(f'config/robots/{ROBOT}.yaml'), kind=self.kind)
        self.space = f'/{self.kind}_{mode}'
        self.folder = folder
        self.station = Station(self.space)
        self.diagnostics = self.station.hear(DiagnosticArray, '/diagnostics')
        self.command = TENSION if mode == 'tension' else PULL
        self._publisher = self.station.node.create_publisher(JointState, 'tendon_command', COMMAND)
        self.sending, self._open = True, True
        self._sender = threading.Thread(target=self._send_on, name='sender', daemon=True)
        self._sender.start()  # also while a test waits for a process
        self.node = None

    def run(self):
        self.node = start(
            'driver',
            self.space,
            self.folder,
            robot=ROBOT,
            backend=self.kind,
            config=str(self.servos.config),
            command_mode=self.mode,
        )
        self.station.until_code(self.station.driver, 'following', timeout=60.0)
        return self.node

    def _send_on(self):
        while self._open:
            if self.sending:
                self._send()
            time.sleep(0.01)

    def _send(self):
        message = JointState(name=['prox_left', 'prox_right', 'dist_left', 'dist_right'])
        message.header.stamp = self.station.node.get_clock().now().to_msg()
        field = 'effort' if self.mode == 'tension' else 'position'
        setattr(message, field, [float(value) for value in self.command])
        self._publisher.publish(message)

    def measured(self):
        state = last(self.station.states)
        return np.array(state.effort if self.mode == 'tension' else state.position)

    def until_following(self):
        """Have the node follow, again where a fault comes back, and wait for its arm."""
        begun, near = self.station.now(), self.near[self.mode == 'pull']

        def there():
            heard = self.station.states
            fresh = heard and stamp(last(heard)) > begun
            said = self.station.driver and values(last(self.station.driver))['code']
            near_it = fresh and np.allclose(self.measured(), self.command, atol=near)
            return near_it and said == 'following'

        try:
            ask = partial(self.station.trigger, 'driver/resume')
            self.station.repeat(ask, 0.5, there, 'the command', timeout=40.0)
        except AssertionError as error:
            raise AssertionError(f'{error}; {self._seen()}') from None

    def _seen(self):
        """Say who is where, for a test that waited in vain."""
        heard, process = self.station.states, self.node.process
        ago = self.station.now() - stamp(last(heard)) if heard else np.inf
        logs = sorted(self.folder.glob('driver_*.log'), key=lambda file: file.stat().st_mtime)
        said = logs[-1].read_text(encoding='utf-8').splitlines()[-5:] if logs else []
        return (
            f'command {self.command}, sender alive {self._sender.is_alive()}, measured '
            f'{self.measured() if heard else None} {ago:.2f} s ago, driver '
            f'{process.pid} ended {process.poll()}, motors {self.servos.ask("state")}, '
            f'log {said}'
        )

    def goals(self, since):
        """Return what the servos accepted as goals since a time [s]: id to list of values."""
        name = 'goal_current' if self.mode == 'tension' else 'goal_position'
        found = {i: [] for i in (1, 2, 3, 4)}
        log = self.servos.ask(f'log {time.monotonic() - since + 1.0}')
        for when, identity, register, value in log:
            if register == name and when >= since:
                found[identity].append(value)
        return found

    def counts(self, change):
        """Return by how many counts of current, or ticks, goals change with a command."""
        content = self.servos.content()
        if self.mode == 'pull':
            return change * Counts.TICKS_PER_TURN / (2.0 * np.pi * content['spool_radius'])
        model = MODELS[content['model']]
        line = from_data_sheet(model, content['spool_radius']).mean
        return change * line.slope / model.current_unit

    def servo(self, identity):
        return self.servos.ask('state')['servos'][str(identity)]

    def operate(self):
        """Reboot what reports an error, then reset, as a person does."""
        self.station.until(lambda: self.station.trigger('driver/reboot').success, 'a reboot')

        def reset():
            self.station.trigger('driver/reset')
            self.station.spin(0.2)
            return values(last(self.station.driver))['code'] == 'following'

        self.station.until(reset, 'following after a reset', timeout=30.0)

    def close(self):
        self._open = False
        self._sender.join()
        if self.node is not None:
            self.node.end()
        self.station.close()
        self.servos.end()


def running(kind):
    """Make a fixture of a module: a rig that runs, in tension and, slowly, in pull mode."""

    @pytest.fixture(scope='module', params=['tension', slow('pull')])
    def running(request, tmp_path_factory):
        with contextlib.closing(kind(request.param, tmp_path_factory.mktemp('logs'))) as rig:
            rig.run()
            yield rig

    return running


@pytest.fixture
def following(running):
    """Give every test a node that follows."""
    running.sending = True
    if running.node.process.poll() is not None:  # a test has failed
        running.station.driver.clear()
        running.run()
    running.until_following()
    return running


def steps(goals):
    """Largest step from goal to goal of any motor."""
    return max(np.abs(np.diff(sent)).max(initial=0) for sent in goals.values())
