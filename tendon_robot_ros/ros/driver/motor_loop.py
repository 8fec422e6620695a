"""The only thread that accesses the motors: supervisor, write, read, in a fixed cycle."""

from __future__ import annotations

import contextlib
import queue
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass

import numpy as np

from ...common.arrays import Floats
from ...common.errors import DriverError, MovedError
from ...drivers.interface import SETTLED_S, Driver, Fault, Reading
from ...drivers.safety import FOLLOWING, LIMP, OFF, RELEASED, Decision, Supervisor
from ..shared.timing import CALL_TIMEOUT_S, SILENCE_S, WORK_TIMEOUT_S


@dataclass(frozen=True)
class Cycle:
    """The decision of one cycle, and the reading of the motors after it."""

    reading: Reading
    decision: Decision
    faults: tuple[Fault, ...]  # of the decision: those of `reading` count in the next cycle
    held: str = ''  # why the arm was released, until commands are followed again
    releases: int = 0  # number of releases so far


class MotorLoop:
    """
    Runs an open driver in a thread.

    All access to driver and supervisor is in this thread: `call` runs a function there and waits
    for its result.
    """

    def __init__(
        self,
        driver: Driver,
        supervisor: Supervisor,
        period: float,
        report: Callable[[Cycle], None],
        receive: Callable[[], None] = lambda: None,
    ) -> None:
        """Keep driver and supervisor; `receive` is called before a cycle, `report` after it."""
        self.driver, self.supervisor = driver, supervisor
        self._period, self._report, self._receive = period, report, receive
        self._calls: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._command: Floats | None = None
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name='motors', daemon=True)
        self.off = driver.inputs  # inputs whose torque is off
        self._last: Reading | None = None
        self.crashed: BaseException | None = None

    def start(self) -> None:
        """Start the thread, which reads the motors."""
        self._thread.start()

    def put(self, command: Floats) -> None:
        """Set the newest command, (m,) [N] or [m], for the next cycle."""
        self._command = command

    def newcomer(self) -> None:
        """Follow a new publisher, unless the cause of a release persists."""
        with contextlib.suppress(DriverError):
            self.supervisor.resume()

    def let_go(self, reason: str) -> None:
        """Release the arm at once and drop the pending command."""
        self._command = None
        self.supervisor.let_go(reason)

    def call[T](self, function: Callable[[], T], timeout: float = CALL_TIMEOUT_S) -> T:
        """Run a function in the thread; return its result or raise its error."""
        if not self._thread.is_alive():
            raise DriverError(f'the motor thread has ended: {self.crashed or "closed"}')
        result: Future[T] = Future()

        def task() -> None:
            if not result.set_running_or_notify_cancel():  # the caller was told that it failed
                return
            try:
                result.set_result(function())
            except Exception as error:
                result.set_exception(error)

        self._calls.put(task)
        try:
            return result.result(timeout)
        except TimeoutError:
            result.cancel()
            raise DriverError(f'the motors did not answer within {timeout:g} s') from None

    def activate(self) -> None:
        """Switch torque on, starting from the measured state."""
        self.call(self._enable, WORK_TIMEOUT_S)

    def reset(self) -> None:
        """Clear latched stops, and undo the travel of failed searches for slack."""
        self.supervisor.reset()
        self.driver.reset()

    def reboot(self) -> None:
        """Restart the motors; the next reset switches torque on again."""
        self.off = self.driver.inputs
        if self.supervisor.state != OFF:
            self.supervisor.latch.stop('reboot', 'rebooted, torque is off')
        self.driver.reboot()

    @property
    def _ramp_time(self) -> float:
        """Duration [s] of a release over the whole range of the commands."""
        rules = self.supervisor.rules
        return float(np.ptp(rules.limits, axis=1).max() / rules.release_rate)

    def release(self, key: str, reason: str) -> bool:
        """
        Ramp the arm to rest and wait, no longer than the longest ramp takes.

        Returns
        -------
        bool
            Whether the arm is at rest; False when it took longer, or when the thread died.

        """
        deadline = time.monotonic() + self._ramp_time + SILENCE_S
        self.supervisor.latch.stop(key, reason)
        while time.monotonic() < deadline and self._thread.is_alive():
            if self.supervisor.state in (RELEASED, LIMP, OFF):
                time.sleep(SETTLED_S)  # motors lag behind the end of the ramp
                return True
            time.sleep(self._period)
        return False

    def close(self) -> None:
        """End the thread, then close the driver."""
        self._ending.set()
        if self._thread.is_alive():
            longest = self._ramp_time + 2.0 * CALL_TIMEOUT_S  # a rescue is to end its ramp
            self._thread.join(timeout=min(longest, threading.TIMEOUT_MAX))
        self.driver.close()

    def _enable(self) -> None:
        try:
            self.driver.enable()
        except MovedError as error:
            self.supervisor.latch.stop('enable', str(error))
            raise
        self._last = self.driver.read()
        self.off = ()
        self.supervisor.start(time.monotonic(), self._last)

    def _run(self) -> None:
        due = time.monotonic()
        try:
            self._last = self.driver.read()
            while not self._ending.is_set():
                self._cycle()
                due = max(due + self._period, time.monotonic())
                # Event.wait would cost three times as much
                time.sleep(max(due - time.monotonic(), 0.0))
        except Exception as error:
            self.crashed = error
            self._rescue()

    def _cycle(self) -> None:
        began = time.monotonic()
        self._receive()
        command, self._command = self._command, None
        assert self._last is not None
        judged = self._last
        decision = self.supervisor.step(began, command, judged)
        self._apply(decision)
        self._last = self.driver.read()
        held, releases = self.supervisor.held, self.supervisor.releases
        self._report(Cycle(self._last, decision, judged.faults, held, releases))
        while not self._calls.empty():  # last: a command that came before a reset moves nothing
            self._calls.get()()

    def _apply(self, decision: Decision) -> None:
        """Switch torque and write the command, which is void where torque is off or came back."""
        if self._torque(decision) or decision.state in (OFF, LIMP):
            return
        tension = self.supervisor.rules.stop_tension or 0.0
        self.driver.limit_current(decision.current_reduction, tension)
        self.driver.write(decision.command)

    def _torque(self, decision: Decision) -> bool:
        """
        Switch torque off where the decision says so, and on again where it may come back.

        Returns
        -------
        bool
            Whether torque came back: the command of this cycle is then void.

        """
        new = tuple(name for name in decision.off if name not in self.off)
        if new:
            self.driver.disable(new)
            self.off += new
        back = set(self.off) - set(decision.off)
        if not back or decision.state != FOLLOWING:
            return False
        try:
            self._enable()
        except DriverError as error:
            self.supervisor.latch.stop('enable', f'torque stays off: {error}')
        return True

    def _rescue(self) -> None:
        """Handle an unexpected error: ramp down if the driver works, else switch torque off."""
        try:
            self.supervisor.latch.stop('crash', f'the driver process failed: {self.crashed}')
            while True:  # every step comes closer to rest, or is at rest
                decision = self.supervisor.step(time.monotonic(), None, self.driver.read())
                self._apply(decision)
                if decision.state in (OFF, LIMP, RELEASED):
                    return
                time.sleep(self._period)
        except Exception:
            self.driver.disable()
