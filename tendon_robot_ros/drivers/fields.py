"""Checked reading of a configuration of a driver."""

from __future__ import annotations

from ..exceptions import DriverError
from ..robot_checks import Reader


class Fields(Reader):
    """Checked reading of the configuration."""

    def error(self, key: str, expected: str, got: object) -> DriverError:
        """Build the error for a key."""
        return DriverError(f'{self.source}: {self._where(key)}: expected {expected}, got {got!r}')

    def value(self, key: str, default: float, low: float, high: float, unit: str) -> float:
        """Return a number, or the default when absent."""
        return self.number(key, low, high, unit) if self.has(key) else default

    def flag(self, key: str) -> bool:
        """Return true or false, false when absent."""
        value = self.content.get(key, False)
        if not isinstance(value, bool):
            raise self.error(key, 'true or false', value)
        return value

    def port(self) -> str:
        """Return the path of the serial port."""
        value = self.content.get('port')
        if not isinstance(value, str) or not value:
            raise self.error('port', 'the path of a serial port, such as /dev/ttyUSB0', value)
        return value
