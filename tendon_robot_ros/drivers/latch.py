"""A stop that latches, and that nobody can reset while its cause lasts."""

from __future__ import annotations

from ..exceptions import DriverError


class StopLatch:
    """Why there is a stop: a sentence per cause."""

    def __init__(self) -> None:
        """Nothing is stopped."""
        self._latched: dict[str, str] = {}
        self._lasting: set[str] = set()

    def __bool__(self) -> bool:
        """Whether there is a stop."""
        return bool(self._latched)

    @property
    def reasons(self) -> list[str]:
        """One sentence per cause."""
        return list(self._latched.values())

    def stop(self, key: str, reason: str, lasting: bool = False) -> None:
        """Latch a stop; while its cause is lasting, `reset` is refused."""
        self._latched[key] = reason
        if lasting:
            self._lasting.add(key)

    def cause_gone(self, key: str) -> None:
        """Say that the cause of a stop is gone; the stop stays latched until `reset`."""
        self._lasting.discard(key)

    def forget(self, key: str) -> None:
        """Take back a stop, for its sender only: people call `reset`."""
        self._latched.pop(key, None)
        self._lasting.discard(key)

    def reset(self) -> None:
        """
        Clear the stops.

        Raises
        ------
        DriverError
            A cause is still there.

        """
        if self._lasting:
            reasons = [self._latched[key] for key in self._latched if key in self._lasting]
            raise DriverError('reset refused: ' + '; '.join(reasons))
        self._latched.clear()
