"""Loading a model while controlling: a child process compiles, this one reads the cache."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..effects import Catalogue, load_catalogue
from ..exceptions import TendonRobotError
from ..robot import Robot, dump_robot, parse_robot
from .parent import child_environment, end_with_parent

if TYPE_CHECKING:
    from ..model.model import Model

NICE = 10
GENTLY = 'TENDON_ROBOT_ROS_GENTLY'


def load(robot: Robot, catalogue: Catalogue) -> Model:
    """Make a model and call all that a controller calls: nothing is compiled later."""
    from ..model.model import Model

    model = Model(robot, catalogue)
    tensions = np.clip(np.full(len(model.inputs), 0.2), model.limits[:, 0], model.limits[:, 1])
    shape = model.shape(tensions)
    model.shape(tensions, guess=shape.bend)
    model.reach(position=shape.tip_position, direction=shape.tip_direction)
    model.reach(position=shape.tip_position, guess=shape)
    model.reach(position=shape.tip_position, by_pulls=True)
    return model


def compiled_mark(catalogue: Catalogue) -> Path:
    """Return the file that says that the kernel of a catalogue is in the cache."""
    from ..model.compose import cache_folder, kernel_key

    return cache_folder() / f'tendon_robot_kernel_{kernel_key(catalogue)}' / 'controller_ready'


class Loader:
    """A child process that fills the cache; ask `done` now and then."""

    def __init__(self, robot: Robot, effects: Sequence[str], gently: bool = False) -> None:
        """
        Start it, unless the cache is full; gently while something else is being controlled.

        Raises
        ------
        EffectError
            An effect is unknown or its file is not usable.

        """
        self.robot, self.catalogue = robot, load_catalogue(effects)
        for name in robot.effects:
            self.catalogue[name]
        self._child: subprocess.Popen[str] | None = None
        self._gently = gently
        self._loading: Future[Model] | None = None
        if not compiled_mark(self.catalogue).is_file():
            command = [sys.executable, '-m', __name__, *effects]
            self._child = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
                start_new_session=True,
                env=child_environment() | ({GENTLY: '1'} if gently else {}),
            )  # Ctrl-C is for the parent, which ends it
            assert self._child.stdin is not None
            self._child.stdin.write(dump_robot(robot))
            self._child.stdin.close()

    @property
    def compiling(self) -> bool:
        """Whether the child is at work: that takes long."""
        return self._child is not None and self._child.poll() is None

    @property
    def done(self) -> bool:
        """Whether `result` returns at once; asking moves the loading on."""
        if self.compiling:
            return False
        if self._loading is None:
            self._loading = Future()
            # not the thread that controls: reading the cache takes a moment, too
            threading.Thread(target=self._load, name='model', daemon=True).start()
        return self._loading.done()

    def result(self) -> Model:
        """
        Wait, then return the model.

        Raises
        ------
        TendonRobotError
            The model does not work.

        """
        while not self.done:
            time.sleep(0.01)
        assert self._loading is not None
        return self._loading.result()

    def _load(self) -> None:
        assert self._loading is not None
        if self._gently:
            _give_way()
        try:
            self._loading.set_result(self._read())
        except Exception as error:
            self._loading.set_exception(error)

    def _read(self) -> Model:
        """Say what the child found wrong, or load what it compiled."""
        if self._child is not None:
            assert self._child.stderr is not None
            said = self._child.stderr.read().strip().splitlines()
            self._child.stderr.close()
            if code := self._child.returncode:
                raise TendonRobotError(said[-1] if said else f'compiling ended with code {code}')
        return load(self.robot, self.catalogue)

    def cancel(self) -> None:
        """End the child."""
        if self._child is not None and self._child.poll() is None:
            self._child.kill()
            self._child.wait()


def _give_way() -> None:
    """Let the thread or process that controls go first."""
    with contextlib.suppress(OSError):  # a Linux thread has a priority of its own
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICE)


def main() -> int:
    """Compile for the robot on standard input and the effect files in the arguments."""
    end_with_parent()
    if os.environ.pop(GENTLY, ''):
        _give_way()
    try:
        catalogue = load_catalogue(sys.argv[1:])
        load(parse_robot(sys.stdin.read()), catalogue)
    except TendonRobotError as error:
        print(error, file=sys.stderr)
        return 1
    compiled_mark(catalogue).touch()
    return 0


if __name__ == '__main__':
    sys.exit(main())
