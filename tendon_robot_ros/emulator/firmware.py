"""The reference firmware, compiled for this computer: the emulated board runs the real thing."""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from ..common.errors import DriverError

SOURCES = ('protocol.c', 'control.c', 'board.c', 'host.c')
OUTBOX_BYTES = 8192


class Sensors(ctypes.Structure):
    """`struct sensors` of firmware/control.h."""

    _fields_ = (
        ('cell', ctypes.c_int32),
        ('fresh', ctypes.c_bool),
        ('ticks', ctypes.c_int32),
        ('current', ctypes.c_int16),
        ('faults', ctypes.c_uint16),
    )


def folder() -> Path:
    """Find the sources: in a source tree, or where pip and colcon install shared files."""
    roots = [Path(__file__).resolve().parents[2]]
    prefixes = [sys.prefix, *os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)]
    roots += [Path(prefix, 'share', 'tendon_robot_ros') for prefix in prefixes if prefix]
    for root in roots:
        if (root / 'firmware' / SOURCES[0]).is_file():
            return root / 'firmware'
    raise DriverError('the folder firmware is missing; install the package again')


def compiler() -> str | None:
    """Find a C compiler: $CC, cc, gcc or clang."""
    names = (os.environ.get('CC', ''), 'cc', 'gcc', 'clang')
    return next((path for name in names if name and (path := shutil.which(name))), None)


@contextlib.contextmanager
def library(channels: int) -> Iterator[Path]:
    """
    Compile the firmware for this computer, once for every version of its sources.

    Yields
    ------
    Path
        The library: in the user's cache, or gone afterwards where there can be none.

    Raises
    ------
    DriverError
        There is no C compiler, or it refuses.

    """
    source = folder()
    files = sorted(source.glob('*.[ch]'))
    digest = hashlib.sha256(b''.join(file.read_bytes() for file in files)).hexdigest()[:16]
    name = f'board-{digest}-{channels}.so'
    cache = Path(os.environ.get('XDG_CACHE_HOME') or os.path.expanduser('~/.cache'))
    with contextlib.ExitStack() as stack:
        try:
            made = _made(source, cache / 'tendon_robot_ros', name, channels)
        except OSError:  # no home, or nothing may be written there
            own = stack.enter_context(tempfile.TemporaryDirectory(prefix='tendon_robot_ros_'))
            made = _made(source, Path(own), name, channels)
        yield made


def _made(source: Path, place: Path, name: str, channels: int) -> Path:
    """Return the library in a folder; compile it first if it is not there."""
    if not (place / name).is_file():
        place.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=place) as draft:
            made = Path(draft, name)
            _compile(source, made, channels)
            os.replace(made, place / name)
    return place / name


def _compile(source: Path, made: Path, channels: int) -> None:
    cc = compiler()
    if cc is None:
        raise DriverError('no C compiler for the emulated board; type: sudo apt install gcc')
    command = [cc, '-std=c99', '-O2', '-fPIC', '-shared', f'-DCHANNELS={channels}']
    command += [str(source / part) for part in SOURCES] + ['-o', str(made)]
    run = subprocess.run(command, capture_output=True, text=True)
    if run.returncode:
        raise DriverError(f'{source}: {cc}: {(run.stderr.splitlines() or ["failed"])[0]}')


class Firmware:
    """
    The firmware of one board, with bytes and sensors given by the caller.

    Attributes
    ----------
    channels : int
    duties : list of float
        Of the motors, -1 to 1.
    enabled : int
        Bit mask of the motors that are on.

    """

    def __init__(self, channels: int) -> None:
        """Switch a board with so many channels on."""
        self.channels = channels
        # a copy of its own: the board's memory is that of the library
        with library(channels) as made, tempfile.NamedTemporaryFile(suffix='.so') as own:
            shutil.copyfile(made, own.name)
            self._library = ctypes.CDLL(own.name)
        self._library.host_step.argtypes = (
            ctypes.c_void_p,
            ctypes.c_uint32,
            ctypes.c_void_p,
            ctypes.c_void_p,
        )
        self._duties = (ctypes.c_float * channels)()
        self._enabled = ctypes.c_uint8()
        self._outbox = ctypes.create_string_buffer(OUTBOX_BYTES)
        self.sensors = (Sensors * channels)()
        self.power_on()

    def power_on(self) -> None:
        """Start anew: everything off, nothing known."""
        self._library.host_power_on()
        self.duties, self.enabled = [0.0] * self.channels, 0

    def receive(self, data: bytes) -> None:
        """Give it bytes."""
        self._library.host_receive(data, len(data))

    def step(self, now: int) -> None:
        """Let its clock go to `now` [µs] with the present `sensors`."""
        self._library.host_step(
            ctypes.addressof(self.sensors),
            now & 0xFFFFFFFF,
            ctypes.addressof(self._duties),
            ctypes.addressof(self._enabled),
        )
        self.duties, self.enabled = list(self._duties), self._enabled.value

    def take(self) -> bytes:
        """Return what it wants to send."""
        size = self._library.host_take(self._outbox)
        return self._outbox.raw[:size]

    def decode(self, data: bytes) -> bytes | None:
        """Decode what stood between two delimiters as the board does: header and payload."""
        buffer = ctypes.create_string_buffer(256)
        size = self._library.host_decode(data, len(data), buffer) if len(data) < 256 else -1
        return buffer.raw[: 4 + size] if size >= 0 else None
