"""
The daily check: pulls and tensions at a reference posture against the last time.

A tendon that creeps, a knot that slips or a zero that is lost leaves the wire pull at the same
tension changed. All tendons are brought to the same few newtons and held still; the pulls and what
the motors measure there are kept in a file beside the calibration, and the next check compares.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np

from ..common.arrays import Floats
from ..common.errors import DriverError, InputError
from ..common.files import write_text
from ..common.processes import ends_between
from ..common.yaml_reading import ConfigFields, dump_yaml, in_range, read_yaml
from .interface import CYCLE_S, Driver

RAMP_S = 4.0  # [s] to the reference tension, so that the arm follows without swinging
STOP_S = 0.2  # [s] in which tendons let go when a signal asks for the end, else it would be a jerk
STILL_S = 1.0  # [s] in which pulls have to stand, so that a mean has a hundred readings
STILL_TIMEOUT_S = 15.0 * STILL_S  # [s] to wait for that, else a person would wait for a held arm
STILL_TOLERANCE_M = 5e-5  # [m] that a mean pull may change, so that creep shows beside it
CHANGED_MIN = 0.1  # [1] of the reference tension, so that the friction of a gear is no change
BOOT = Path('/proc/sys/kernel/random/boot_id')


def _names(top: ConfigFields, key: str) -> tuple[str, ...]:
    names = top.content.get(key)
    if not isinstance(names, list) or not names:
        raise top.error(key, 'a list of names', names)
    return tuple(map(str, names))


def _numbers(top: ConfigFields, key: str) -> Floats:
    """Return a number of every input; it may be missing (nan)."""
    values, size = top.content.get(key), len(_names(top, 'inputs'))
    listed = values if isinstance(values, list) else []
    if len(listed) != size or not all(type(value) in (int, float) for value in listed):
        raise top.error(key, f'a list of {size} numbers', values)
    return np.array(listed, dtype=float)


def _text(top: ConfigFields, key: str) -> str:
    return str(top.content.get(key, ''))


@dataclass(frozen=True)
class TendonReference:
    """What was measured at the reference posture."""

    inputs: Annotated[tuple[str, ...], _names]
    tension: Annotated[float, in_range(0.0, 1e4, 'N')]  # commanded on every input
    pulls: Annotated[Floats, _numbers]  # (m,) [m]
    # (m,) [N] as the motors or load cells measure them, nan where nothing does
    tensions: Annotated[Floats, _numbers]
    date: Annotated[str, _text]
    # id of this start of the computer: it changes when the power was off
    boot: Annotated[str, _text] = ''


class TendonChange(NamedTuple):
    """Change of one tendon since the reference."""

    name: str
    pull: float  # [m] more wire wound up at the same tension: the tendon has become longer
    tension: float  # [N] that is measured more at the same command

    def text(self, reference: float) -> str:
        """Return the change as text, '' without one; `reference` [N] is the tension."""
        words = []
        if abs(self.pull) > 6.0 * STILL_TOLERANCE_M:  # what still changes at rest is no creep
            longer = 'longer' if self.pull > 0.0 else 'shorter'
            words.append(f'has crept: {1e3 * abs(self.pull):.2f} mm {longer}')
        if abs(self.tension) > CHANGED_MIN * reference:
            more = 'more' if self.tension > 0.0 else 'less'
            words.append(f'measures {abs(self.tension):.2f} N {more}')
        return f'{self.name}: {"; ".join(words)}' if words else ''


def measure_reference(driver: Driver, tension: float) -> TendonReference:
    """
    Bring all tendons slowly to a tension [N], wait until they rest, read, then release them.

    Raises
    ------
    DriverError
        A fault; or the arm does not come to rest, and the tendons have been released.
    KeyboardInterrupt
        A signal requested the end: the tendons have been released.

    """
    highest = float(driver.limits[:, 1].min())
    lowest = float(driver.limits[:, 0].max())
    if not lowest < tension <= highest:
        raise InputError(
            f'--tension: expected more than {lowest:g} and at most {highest:g} N, got {tension:g}'
        )
    with ends_between() as check:
        driver.enable()
        try:
            present = np.clip(np.nan_to_num(driver.read().tensions), lowest, highest)
            arm = _HeldTendons(driver, check, present)
            try:
                arm.ramp(tension, RAMP_S)
                pulls, tensions = arm.still()
            except (DriverError, KeyboardInterrupt):
                arm.check = lambda: None
                arm.ramp(lowest, STOP_S)
                raise
            arm.ramp(lowest, RAMP_S)
        finally:
            driver.disable()
    date = time.strftime('%Y-%m-%d %H:%M')
    return TendonReference(driver.inputs, tension, pulls, tensions, date, boot_id())


def changes(reference: TendonReference, now: TendonReference) -> list[TendonChange]:
    """
    Return the change of every tendon.

    The pulls of all tendons together change with the arm's temperature and the posture: where
    there are three or more, their median is subtracted.
    """
    if now.inputs != reference.inputs:
        raise InputError(
            f'the reference holds {", ".join(reference.inputs)}, expected {", ".join(now.inputs)}'
        )
    pulls, tensions = now.pulls - reference.pulls, now.tensions - reference.tensions
    if len(pulls) > 2:
        pulls = pulls - np.median(pulls)
    tensions = np.nan_to_num(tensions)
    rows = zip(now.inputs, pulls.tolist(), tensions.tolist(), strict=True)
    return [TendonChange(name, pull, change) for name, pull, change in rows]


def read_reference(path: Path) -> TendonReference:
    """Read a reference that `save_reference` has written; one line where it is not valid."""
    content = read_yaml(path, lambda reason: InputError(f'{path}: cannot be read: {reason}'))
    return ConfigFields(str(path), '', content).read(TendonReference)


def save_reference(path: Path, reference: TendonReference) -> None:
    """Write a reference."""
    pulls, tensions = reference.pulls.round(7).tolist(), reference.tensions.round(5).tolist()
    lists = {'inputs': list(reference.inputs), 'pulls': pulls, 'tensions': tensions}
    head = '# tendons at a reference posture, SI; written by motors calibrate --check\n'
    write_text(path, head + dump_yaml(asdict(reference) | lists))


def due(path: Path) -> str:
    """Return why the tendons need a check, '' where they need none."""
    if not path.exists():
        return f'{path}: no reference yet: make one with motors calibrate --check'
    reference = read_reference(path)
    if reference.boot and reference.boot != boot_id():
        return (
            f'the power was off since the tendons were looked at ({reference.date}): '
            'motors calibrate --check says whether one has crept'
        )
    return ''


def boot_id() -> str:
    """Return the id of this start of the computer, '' where there is none."""
    try:
        return BOOT.read_text(encoding='utf-8').strip()
    except OSError:
        return ''


@dataclass
class _HeldTendons:
    """All tendons on a ramp or at rest; readings are checked after every command."""

    driver: Driver
    check: Callable[[], None]  # raises when a signal requests the end
    command: Floats  # (m,) [N] the last one
    clock = staticmethod(time.monotonic)

    def ramp(self, tension: float, seconds: float) -> None:
        """Bring all tendons from the last command to a tension [N]."""
        begin, began, end = self.command, self.clock(), np.full_like(self.command, tension)
        while (passed := self.clock() - began) < seconds:
            self._cycle(begin + passed / seconds * (end - begin))
        self._cycle(end)

    def still(self) -> tuple[Floats, Floats]:
        """Hold until the pulls are constant for a while; return mean pulls and tensions."""
        began, rows = self.clock(), []
        while self.clock() - began < STILL_TIMEOUT_S:
            pulls, tensions = self._cycle(self.command)
            rows.append((self.clock(), pulls, tensions))
            recent = [row for row in rows if row[0] > rows[-1][0] - STILL_S]
            if rows[-1][0] - began < 2.0 * STILL_S or len(recent) < 2:  # the computer was busy
                continue
            window = np.array([row[1] for row in recent])
            half = len(window) // 2
            moved = np.abs(window[half:].mean(axis=0) - window[:half].mean(axis=0)).max()
            if moved < STILL_TOLERANCE_M:
                return window.mean(axis=0), np.array([row[2] for row in recent]).mean(axis=0)
        raise DriverError(
            f'the tendons do not come to rest at {self.command[0]:g} N within '
            f'{STILL_TIMEOUT_S:g} s; is something holding the arm?'
        )

    def _cycle(self, command: Floats) -> tuple[Floats, Floats]:
        self.check()
        self.driver.write(command)
        self.command, reading = command, self.driver.read()
        if reading.faults:
            raise DriverError(reading.faults[0].message)
        time.sleep(CYCLE_S)
        return reading.pulls, reading.tensions
