"""The `model` parameter: what is loaded, what is asked for, and what was refused."""

from __future__ import annotations

from ..control.loading import Loader
from ..exceptions import InputError, TendonRobotError
from ..model.model import Model
from .parameters import Parameters
from .shared import read_robot


class ModelLoading:
    """Loads the model that the parameter names; another one at run time."""

    def __init__(self, parameters: Parameters) -> None:
        """Begin with what the node was started with."""
        self._parameters = parameters
        self._loader: Loader | None = None
        self._problem: TendonRobotError | None = None
        self._in_use = ''
        self._inputs: tuple[str, ...] = ()  # of the model in use
        self.asked = False  # another model, at run time
        self.note = ''
        self.restart()

    @property
    def compiling(self) -> bool:
        """Whether the model is being compiled: that takes long."""
        return self._loader is not None and self._loader.compiling

    @property
    def done(self) -> bool:
        """Whether `result` returns soon."""
        return self._loader is None or self._loader.done

    def restart(self) -> None:
        """Load what the parameter says; `result` raises what is wrong with it."""
        self.cancel()
        self._problem, self._loader, self.asked = None, None, False
        self._inputs = ()
        self._in_use = self._parameters['model']
        try:
            self._loader = self._begin(self._in_use)
        except TendonRobotError as error:
            self._problem = error

    def change(self, text: str) -> None:
        """Begin to load another model; raise what is wrong with its description."""
        loader = self._begin(text)
        if self._inputs and loader.robot.inputs != self._inputs:
            loader.cancel()
            raise InputError(
                f'the new model has the inputs {", ".join(loader.robot.inputs)}, '
                f'expected {", ".join(self._inputs)}; restart the node to change '
                'them'
            )
        self.cancel()
        self._loader, self._problem, self.asked = loader, None, True

    def result(self) -> Model:
        """Return the model; raise when there is none."""
        loader, self._loader = self._loader, None
        if loader is None:
            problem = self._problem or TendonRobotError('no model is loaded')
            self.restart()  # the file may be right the next time
            raise problem
        model = loader.result()
        self._inputs = self._inputs or model.inputs
        self.note = f'{loader.robot.name} ({", ".join(loader.robot.effects) or "PCCA"})'
        return model

    def accept(self) -> None:
        """Keep the model that was asked for."""
        self._in_use, self.asked = self._parameters['model'], False

    def refuse(self, problem: str) -> None:
        """Go back to the model before: the parameter always names the one in use."""
        self.asked = False
        self._parameters.put_back('model', self._in_use)

    def cancel(self) -> None:
        """End what is being loaded."""
        if self._loader is not None:
            self._loader.cancel()

    def _begin(self, text: str) -> Loader:
        in_use = bool(self._inputs)
        return Loader(read_robot(text), self._parameters['effects'], gently=in_use)
