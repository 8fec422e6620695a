"""Lifecycle nodes that start by themselves, and keep trying while something is missing."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable

from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

from ..exceptions import TendonRobotError
from .parameters import Parameters, Spec

AUTOSTART = Spec(
    'autostart',
    True,
    'configure and activate by itself, and try again when that fails',
    read_only=True,
)
RETRY = 2.0  # [s]


class ManagedNode(LifecycleNode):
    """
    A lifecycle node whose transitions are plain methods.

    A subclass has `configure`, `activate`, `deactivate` and `cleanup`; each may raise a
    TendonRobotError, which refuses the transition with its text.
    """

    parameters: Parameters

    def __init__(self, name: str) -> None:
        """Begin unconfigured."""
        super().__init__(name)
        self.phase = 'unconfigured'
        self._tried = -RETRY
        self._last_problem = ''

    @property
    def node(self) -> LifecycleNode:
        """Return itself, for `run`."""
        return self

    def start(self) -> None:
        """Do nothing yet: `running` starts it, again and again if need be."""

    def running(self) -> bool:
        """Configure and activate when that is due."""
        due = self.phase != 'active' and time.monotonic() - self._tried >= RETRY
        if self.parameters['autostart'] and due and self.ready():
            self._tried = time.monotonic()
            if self.phase == 'unconfigured':
                self.trigger_configure()
            if self.phase == 'inactive':
                self.trigger_activate()
        return True

    def end(self, spin: Callable[[float], None]) -> None:
        """Leave the active state the proper way, then close."""
        if self.phase == 'active':
            self.trigger_deactivate()
        if self.phase == 'inactive':
            self.trigger_cleanup()

    def ready(self) -> bool:
        """Whether it makes sense to configure now."""
        return True

    def configure(self) -> None:
        """Read what is needed, open what is needed."""

    def activate(self) -> None:
        """Begin to act."""

    def deactivate(self) -> None:
        """Stop to act, safely."""

    def cleanup(self) -> None:
        """Give everything back."""

    def problem(self, message: str) -> None:
        """Say why a transition was refused."""
        self.get_logger().error(message)

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Run `configure`."""
        return self._pass(self.configure, 'inactive')

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Run `activate`."""
        return self._pass(self.activate, 'active')

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Run `deactivate`; a person who deactivates does not want autostart."""
        self._tried = float('inf')
        return self._pass(self.deactivate, 'inactive')

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Run `cleanup`."""
        self._tried = float('inf')
        return self._pass(self.cleanup, 'unconfigured')

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Leave whatever state it is in."""
        self._tried = float('inf')
        if self.phase == 'active':
            self._pass(self.deactivate, 'inactive')
        if self.phase == 'inactive':
            self._pass(self.cleanup, 'unconfigured')
        return TransitionCallbackReturn.SUCCESS

    def _pass(self, action: Callable[[], None], phase: str) -> TransitionCallbackReturn:
        try:
            action()
        except TendonRobotError as error:
            self.problem(' '.join(str(error).split()))
            return TransitionCallbackReturn.FAILURE
        except Exception:  # rclpy would say nothing
            self.problem(f'unexpected: {traceback.format_exc()}')
            raise
        self.phase = phase
        return TransitionCallbackReturn.SUCCESS
