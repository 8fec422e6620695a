"""The parameters of the controller node, and the model that one of them names."""

from __future__ import annotations

import math

from ...common.errors import InputError, TendonRobotError
from ...common.words import numbers
from ...common.yaml_reading import EXPLAINED_CHARACTERS_MAX
from ...control import Settings
from ...control.inputs import check_inputs
from ...control.loading import Loader
from ...effects import load_catalogue
from ...model.model import Model
from ...model.tip_task import Preferences
from ...robot.description import DESCRIPTION_MAX
from ...robot.keep_out import KeepOut
from ...robot.loading import load_robot, robot_file
from ..shared.parameters import Parameters


def direction_of(text: str) -> tuple[float, float, float]:
    """Read a direction; zeros where there is none."""
    if not text.strip():
        return 0.0, 0.0, 0.0
    separator = ',' if ',' in text else None
    x, y, z = numbers('prefer_stiffness_along', text, separator, '"x y z"', 3)
    if not 1e-9 < math.hypot(x, y, z) < math.inf:
        raise InputError(f'prefer_stiffness_along: expected some length, got {text!r}')
    return x, y, z


# weights of the preferences of tensions, as named in `Preferences`
WEIGHTS = 'low_tension', 'stiffness', 'slack', 'limit', 'smooth'


def settings(parameters: Parameters, keep_out: KeepOut) -> Settings:
    """Return the settings of the core; without preferences if all weights are 0."""
    preferences = None
    if any(parameters[f'prefer_{name}'] for name in WEIGHTS):
        along = direction_of(parameters['prefer_stiffness_along'])
        preferences = parameters.fill(Preferences, 'prefer_', stiffness_direction=along)
    return parameters.fill(
        Settings,
        patience=parameters['no_equilibrium_timeout'],
        pull_mode=parameters['command_mode'] == 'pull',
        preferences=preferences,
        keep_out=keep_out,
    )


class ModelLoading:
    """Loads the model of the parameter `model`, again when it changes."""

    def __init__(self, parameters: Parameters) -> None:
        """Start to load the model."""
        self._parameters = parameters
        self._loader: Loader | None = None
        self._in_use = self._requested = self._loaded = ''
        self._inputs: tuple[str, ...] = ()  # of the model in use
        self.change_requested = False  # another model was requested at run time
        self.note = ''
        self._loader = self.loader

    @property
    def loader(self) -> Loader:
        """What loads the model; it starts anew after `forget`."""
        if self._loader is None:
            self._in_use = self._requested = self._parameters['model']
            self._loader = self._begin(self._requested)
        return self._loader

    def forget(self) -> None:
        """Drop the model; the next access loads that of the parameter."""
        self.cancel()
        self._loader, self._inputs, self.change_requested = None, (), False

    def check(self, text: str) -> None:
        """Raise the errors of another model that are quickly detected."""
        file, size = robot_file(text), len(text)
        if file is not None and file.exists():  # to read anything else, as a pipe, may block
            size = file.stat().st_size if file.is_file() else DESCRIPTION_MAX
        # read or refused at once, unless that would delay the commands
        if not EXPLAINED_CHARACTERS_MAX < size <= DESCRIPTION_MAX:
            robot = load_robot(text)
            if self._inputs:
                check_inputs(robot.inputs, self._inputs)
            if not self._parameters['effects']:
                catalogue = load_catalogue([])
                for name in robot.effects:
                    catalogue[name]

    def change(self, text: str) -> None:
        """Start to load another model."""
        self.cancel()
        self._loader, self._requested, self.change_requested = self._begin(text), text, True

    def result(self) -> Model:
        """Return the loaded model; TendonRobotError: it is invalid."""
        loader = self.loader
        self.change_requested, self._loaded = False, self._requested
        try:
            return loader.result()
        except TendonRobotError:
            if not self._inputs:
                self.forget()  # the file may be corrected
            raise

    def accept(self, model: Model) -> None:
        """Use the model that was loaded last."""
        self._in_use, self._inputs = self._loaded, model.inputs
        self.note = f'{model.robot.name} ({", ".join(model.robot.effects) or "PCCA"})'

    def refuse(self) -> None:
        """Restore the parameter of the model in use, unless another one was requested."""
        if not self.change_requested:
            self._parameters.put_back('model', self._in_use)

    def cancel(self) -> None:
        """Cancel the loading."""
        if self._loader is not None:
            self._loader.cancel()

    def _begin(self, text: str) -> Loader:
        return Loader(lambda: load_robot(text), self._parameters['effects'], bool(self._inputs))
