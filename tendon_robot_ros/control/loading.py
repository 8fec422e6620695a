"""Loading a model while controlling: a child process compiles, this one reads the cache."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..effects import Catalogue, load_catalogue
from ..exceptions import TendonRobotError
from ..robot import Robot, dump_robot, parse_robot

if TYPE_CHECKING:
    from ..model.model import Model


def load(robot: Robot, catalogue: Catalogue) -> Model:
    """Make a model and call all that a controller calls: nothing is compiled later."""
    from ..model.model import Model

    model = Model(robot, catalogue)
    tensions = np.clip(np.full(len(model.inputs), 0.2), model.limits[:, 0], model.limits[:, 1])
    shape = model.shape(tensions)
    model.shape(tensions, guess=shape.bend)
    model.reach(position=shape.tip_position, direction=shape.tip_direction)
    model.reach(position=shape.tip_position, guess=shape)
    model.pull_shape(shape.pulls)
    return model


def compiled_mark(catalogue: Catalogue) -> Path:
    """Return the file that says that the kernel of a catalogue is in the cache."""
    from ..model.compose import cache_folder, kernel_key

    return cache_folder() / f'tendon_robot_kernel_{kernel_key(catalogue)}' / 'controller_ready'


class Loader:
    """A child process that fills the cache; ask `done` now and then."""

    def __init__(self, robot: Robot, effects: Sequence[str]) -> None:
        """
        Start it, unless the cache is full.

        Raises
        ------
        EffectError
            An effect is unknown or its file is not usable.

        """
        self.robot, self.catalogue = robot, load_catalogue(effects)
        for name in robot.effects:
            self.catalogue[name]
        self._child: subprocess.Popen[str] | None = None
        if not compiled_mark(self.catalogue).is_file():
            command = [sys.executable, '-m', __name__, *effects]
            self._child = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
                start_new_session=True,
            )  # Ctrl-C is for the parent, which ends it
            assert self._child.stdin is not None
            self._child.stdin.write(dump_robot(robot))
            self._child.stdin.close()

    @property
    def done(self) -> bool:
        """Whether `result` returns at once."""
        return self._child is None or self._child.poll() is not None

    def result(self) -> Model:
        """
        Wait, then load the model in this process.

        Raises
        ------
        TendonRobotError
            The child found that the model does not work.

        """
        if self._child is not None:
            code = self._child.wait()
            assert self._child.stderr is not None
            said = self._child.stderr.read().strip().splitlines()
            self._child.stderr.close()
            if code:
                raise TendonRobotError(said[-1] if said else f'compiling ended with code {code}')
        return load(self.robot, self.catalogue)

    def cancel(self) -> None:
        """End the child."""
        if self._child is not None and self._child.poll() is None:
            self._child.kill()
            self._child.wait()


def main() -> int:
    """Compile for the robot on standard input and the effect files in the arguments."""
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
