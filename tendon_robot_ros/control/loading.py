"""Load a model while another one controls: a child process compiles, this one reads the cache."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from pathlib import Path

import numpy as np

from ..common.errors import TendonRobotError
from ..common.files import cache_folder
from ..common.processes import (
    FIRST_NICENESS,
    ComputingThread,
    end_with_parent,
    go_with_others,
    own_process,
)
from ..effects import Catalogue, load_catalogue
from ..model.compile import kernel_key
from ..model.model import Model
from ..robot import Robot, dump_robot, parse_robot


def load(robot: Robot, catalogue: Catalogue) -> Model:
    """Return a model, compiled by a call of every function that a controller uses."""
    model = Model(robot, catalogue)
    tensions = np.clip(np.full(len(model.inputs), 0.2), model.limits[:, 0], model.limits[:, 1])
    shape = model.shape(tensions)
    model.shape(tensions, guess=shape.state)
    model.reach(position=shape.tip_position, direction=shape.tip_direction)
    model.reach(position=shape.tip_position, guess=shape)
    model.reach(position=shape.tip_position, by_pulls=True)
    model.tip_stiffness(shape)
    _ = model.library  # else the first search that needs it takes 0.15 s
    compiled_mark(catalogue).touch()
    return model


def compiled_mark(catalogue: Catalogue) -> Path:
    """Return the file that marks the kernel of a catalogue as complete in the cache."""
    return cache_folder() / f'tendon_robot_kernel_{kernel_key(catalogue)}' / 'controller_ready'


class Loader:
    """Reads a description, compiles it in a child process and loads the model; poll `done`."""

    def __init__(
        self, read: Callable[[], Robot], effects: Sequence[str], gently: bool = False
    ) -> None:
        """
        Start in a thread; `result` raises its errors.

        Parameters
        ----------
        read : callable
            Returns the robot; it may take long.
        effects : sequence of str
            Paths of the user's own effects.
        gently : bool
            With a lower priority, because another model is in use.

        """
        self._read, self._effects, self._gently = read, effects, gently
        self._child: subprocess.Popen[str] | None = None
        self._cancelled = False
        self.doing = 'loading'  # then perhaps 'compiling', then 'building'
        self._loading: Future[Model] = Future()
        # not in the control thread: reading, linking and checking take time
        ComputingThread(self._load, 'model', self.cancel).start()

    @property
    def done(self) -> bool:
        """Whether `result` returns at once."""
        return self._loading.done()

    def result(self) -> Model:
        """
        Wait, then return the model.

        Raises
        ------
        TendonRobotError
            The description or the model is not usable.

        """
        return self._loading.result()

    def cancel(self) -> None:
        """Kill the child process."""
        self._cancelled = True
        if self._child is not None and self._child.poll() is None:
            self._child.kill()
            self._child.wait()

    def _load(self) -> None:
        if self._gently:  # the priority of this thread, which its child inherits (Linux)
            with contextlib.suppress(OSError):
                os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), -FIRST_NICENESS)
        try:
            self._loading.set_result(self._make())
        except Exception as error:
            self._loading.set_exception(error)

    def _make(self) -> Model:
        robot, catalogue = self._read(), load_catalogue(self._effects)
        for name in robot.effects:
            catalogue[name]
        if not compiled_mark(catalogue).is_file():
            self.doing = 'compiling'
            self._compile(robot)
        self.doing = 'building'
        return load(robot, catalogue)

    def _compile(self, robot: Robot) -> None:
        """Compile in the child process; raise its error."""
        pipe = subprocess.PIPE
        child = self._child = own_process(__name__, *self._effects, stdin=pipe, stderr=pipe)
        if self._cancelled:
            child.kill()
        _, complaint = child.communicate(dump_robot(robot))
        if child.returncode:
            lines = complaint.strip().splitlines()
            ended = f'compiling ended with code {child.returncode}'
            raise TendonRobotError(lines[-1] if lines else ended)


def main() -> int:
    """Compile for the robot on standard input and the effect files in the arguments."""
    end_with_parent()
    go_with_others()
    try:
        catalogue = load_catalogue(sys.argv[1:])
        load(parse_robot(sys.stdin.read()), catalogue)
    except TendonRobotError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == '__main__':
    sys.exit(main())
