"""The emulated bus: a pseudo-terminal, the servos on it, and a thread that serves both."""

from __future__ import annotations

import contextlib
import os
import select
import shutil
import tempfile
import termios
import threading
import time
import tty
from collections import deque
from pathlib import Path

from ..dynamixel.tables import BAUD_RATES, REGISTERS
from . import packets
from .faults import Faults
from .packets import Instruction
from .rig import Rig
from .servo import INSTRUCTION_ERROR, Servo

IDLE = 0.005  # [s] between two looks at the clock when nothing arrives
BOOT_TIME = 0.3  # [s] in which a rebooting servo is silent
GAP = 0.02  # [s] of silence that ends a broken packet
WATCHED = {
    REGISTERS[name].address: name
    for name in ('torque_enable', 'goal_current', 'goal_position', 'bus_watchdog')
}


class Line:
    """
    An emulated port with servos; `port` is the path to open.

    Attributes
    ----------
    rig : Rig
    faults : Faults
    log : deque of (time, id, register, value)
        What the servos accepted for torque, goals and watchdog, `time.monotonic` [s].
    extremes : dict of (id, register) to (lowest, highest)
        What was written to them, accepted or not.

    """

    def __init__(self, rig: Rig) -> None:
        """Plug it in; `start` begins to answer."""
        self.rig, self.faults = rig, Faults()
        self.log: deque[tuple[float, int, str, int]] = deque(maxlen=200_000)
        self.extremes: dict[tuple[int, str], tuple[int, int]] = {}
        self._folder = Path(tempfile.mkdtemp(prefix='tendon_robot_ros_'))
        self.port = str(self._folder / 'dynamixel')
        self._master: int | None = None
        self._receiver = packets.Receiver()
        self._booting: dict[int, float] = {}
        self._lock = threading.Lock()
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._serve, name='emulated bus', daemon=True)
        self._before = self._heard = time.monotonic()
        self.plug()

    def start(self) -> Line:
        """Answer from now on, in a thread of its own."""
        self._before = time.monotonic()
        self._thread.start()
        return self

    def stop(self) -> None:
        """End the thread and take the port away."""
        self._end.set()
        if self._thread.is_alive():
            self._thread.join()
        self.unplug()
        shutil.rmtree(self._folder, ignore_errors=True)

    def __enter__(self) -> Line:
        """Start."""
        return self.start()

    def __exit__(self, *_: object) -> None:
        """Stop."""
        self.stop()

    def plug(self) -> None:
        """Make the port appear; the servos kept their power."""
        with self._lock:
            if self._master is not None:
                return
            master, slave = os.openpty()
            tty.setraw(slave)
            os.set_blocking(master, False)
            with contextlib.suppress(FileNotFoundError):
                os.unlink(self.port)
            os.symlink(os.ttyname(slave), self.port)
            os.close(slave)  # else a client's exclusive lock would outlive the client
            self._master, self._receiver = master, packets.Receiver()

    def unplug(self) -> None:
        """Pull the plug: the port is gone, the servos keep their power."""
        with self._lock:
            if self._master is None:
                return
            os.close(self._master)
            self._master = None
            with contextlib.suppress(FileNotFoundError):
                os.unlink(self.port)

    def servo(self, identity: int) -> Servo:
        """Return the servo with an id."""
        return self.rig.servos[identity]

    def _serve(self) -> None:
        while not self._end.is_set():
            data = self._receive()
            with self._lock:
                self._let_time_pass()
                if not data:
                    continue
                now = time.monotonic()
                if now - self._heard > GAP:
                    self._receiver = packets.Receiver()
                self._heard = now
                for instruction in self._receiver.feed(data):
                    self._send(self.faults.on_the_way(self._carry_out(instruction)))

    def _receive(self) -> bytes:
        """Wait a little for bytes; none when there are none or nobody has the port open."""
        master = self._master
        if master is not None:
            with contextlib.suppress(OSError, ValueError):
                if not select.select([master], [], [], IDLE)[0]:
                    return b''
                return os.read(master, 4096)
        time.sleep(IDLE)
        return b''

    def _send(self, answer: bytes) -> None:
        if self._master is not None and answer:
            with contextlib.suppress(OSError):
                os.write(self._master, answer)

    def _let_time_pass(self) -> None:
        now = time.monotonic()
        self.rig.advance(now - self._before)
        self._before = now
        for identity, until in list(self._booting.items()):
            if now >= until:
                del self._booting[identity]

    def _listening(self) -> dict[int, Servo]:
        """Servos that hear and answer: with power, at the line's speed, not silenced."""
        speed = self._speed()
        return {
            identity: servo
            for identity, servo in self.rig.servos.items()
            if identity not in self.faults.silent
            and identity not in self._booting
            and speed in (None, BAUD_RATES.get(servo.get('baud_rate')))
        }

    def _speed(self) -> int | None:
        """Baud rate that the client has set, None when it is an odd one."""
        if self._master is None:
            return None
        try:
            code = termios.tcgetattr(self._master)[5]
        except termios.error:
            return None
        for baud in BAUD_RATES.values():
            if getattr(termios, f'B{baud}') == code:
                return baud
        return None

    def _carry_out(self, instruction: Instruction) -> bytes:
        """Let the servos do what an instruction says; return all their answers."""
        servos = self._listening()
        for servo in servos.values():
            servo.heard()
        code, parameters = instruction.code, instruction.parameters
        if code == packets.SYNC_WRITE:
            self._sync_write(servos, parameters)
            return b''
        if code in (packets.SYNC_READ, packets.FAST_SYNC_READ):
            return _sync_read(servos, parameters, code == packets.FAST_SYNC_READ)
        everyone = instruction.identity == packets.BROADCAST
        wanted = sorted(servos) if everyone else [instruction.identity]
        answers = [self._single(servos[i], code, parameters) for i in wanted if i in servos]
        return b'' if everyone and code != packets.PING else b''.join(answers)

    def _single(self, servo: Servo, code: int, parameters: bytes) -> bytes:
        error, data = INSTRUCTION_ERROR | servo.alert, b''
        if code == packets.PING:
            number = servo.model.number.to_bytes(2, 'little')
            error, data = servo.alert, number + bytes([servo.firmware])
        elif code == packets.READ and len(parameters) == 4:
            error, data = servo.read(*_address_and_length(parameters))
        elif code == packets.WRITE and len(parameters) > 2:
            error = self._write(servo, int.from_bytes(parameters[:2], 'little'), parameters[2:])
        elif code == packets.REBOOT:
            self.rig.rebooted(servo.identity)
            self._booting[servo.identity] = time.monotonic() + BOOT_TIME
            error = 0
        return packets.status(servo.identity, error, data)

    def _sync_write(self, servos: dict[int, Servo], parameters: bytes) -> None:
        address, length = _address_and_length(parameters)
        for start in range(4, len(parameters) - length, length + 1):
            servo = servos.get(parameters[start])
            if servo is not None:
                self._write(servo, address, parameters[start + 1 : start + 1 + length])

    def _write(self, servo: Servo, address: int, data: bytes) -> int:
        error = servo.write(address, data)
        name = WATCHED.get(address)
        if name is not None and len(data) == REGISTERS[name].size:
            value = int.from_bytes(data, 'little', signed=REGISTERS[name].signed)
            key = (servo.identity, name)
            low, high = self.extremes.get(key, (value, value))
            self.extremes[key] = (min(low, value), max(high, value))
            if not error & 0x7F:
                self.log.append((time.monotonic(), servo.identity, name, value))
        return error


def _address_and_length(parameters: bytes) -> tuple[int, int]:
    return int.from_bytes(parameters[:2], 'little'), int.from_bytes(parameters[2:4], 'little')


def _sync_read(servos: dict[int, Servo], parameters: bytes, fast: bool) -> bytes:
    """Answer in the order asked; in a fast read nobody speaks behind a silent servo."""
    address, length = _address_and_length(parameters)
    wanted = list(parameters[4:])
    parts = []
    for identity in wanted:
        if identity in servos:
            parts.append((identity, *servos[identity].read(address, length)))
        elif fast:
            break
    if not fast:
        return b''.join(packets.status(*part) for part in parts)
    old = [i for i, _, _ in parts if servos[i].firmware < servos[i].model.fast_read_firmware]
    if old or not parts:
        return b''
    whole = packets.fast_status(parts + [(i, 0, bytes(length)) for i in wanted[len(parts) :]])
    return whole[: 8 + sum(len(data) + 4 for _, _, data in parts)]
