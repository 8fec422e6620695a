"""How much of one core 1 kHz telemetry of four tendons costs; and write and read of the driver."""

import argparse
import json
import os
import sys
import threading
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from machine import machine

from tendon_robot_ros.drivers import make_driver
from tendon_robot_ros.drivers.serial_board import messages
from tendon_robot_ros.drivers.serial_board.link import BoardLink
from tendon_robot_ros.drivers.serial_board.messages import FrameReceiver, Message, encode
from tendon_robot_ros.emulator.port import EmulatorProcess, Plug
from tendon_robot_ros.robot import load_robot

ROBOT = Path(__file__).resolve().parents[1] / 'config/robots/kato_10_1.yaml'
CHANNELS = 4
TARGET = 0.10  # of one core


def telemetry(i):
    """Make the bytes of a telemetry frame with changing values."""
    values = np.zeros(CHANNELS, dtype=[('t', '<i4'), ('p', '<i4'), ('c', '<i2'), ('f', '<u2')])
    values['t'], values['p'], values['c'] = 1_500_000 + i, 12_000 - i, 300
    head = (1000 * i).to_bytes(4, 'little') + bytes((1, 15, 0, i & 255, 0, 0))
    return encode(Message.TELEMETRY, i, head + values.tobytes())


def parsing(count=50_000):
    """Return the seconds of processor time per frame, bytes to values."""
    frames, receiver = [telemetry(i) for i in range(1000)], FrameReceiver()
    begin = time.process_time()
    read = 0
    for i in range(count):
        for frame in receiver.feed(frames[i % 1000]):
            read += messages.read_telemetry(frame, CHANNELS).faults.size
    assert read == CHANNELS * count
    return (time.process_time() - begin) / count


class Source(Plug):
    """A port that gives a frame every millisecond."""

    def __init__(self):
        self.sent, self._due = 0, time.monotonic()
        super().__init__('telemetry', idle=0.001)

    def advance(self, passed):
        while self._due < time.monotonic():
            self._send(telemetry(self.sent))
            self.sent, self._due = self.sent + 1, self._due + 0.001

    def receive(self, data):
        pass

    def connected(self):
        pass


def through_a_port(seconds):
    """Return the share of a core for reading 1 kHz from a port, each frame as it comes."""
    with Source() as source:
        link = BoardLink(source.port, 1_000_000)
        link.open()
        used, got, begin = time.thread_time(), 0, time.monotonic()
        while time.monotonic() - begin < seconds:
            for frame in link.receive(0.1):
                if messages.read_telemetry(frame, CHANNELS):
                    got += 1
        share = (time.thread_time() - used) / (time.monotonic() - begin)
        link.close()
        return share, got / seconds, link.missed


def cycles(seconds):
    """Return cycles per second and times of write + read of the driver, [ms]."""
    with EmulatorProcess(ROBOT, '--arm', 'springs', kind='serial') as board:
        config = {**board.content(), 'telemetry_rate': 1000.0}
        with make_driver('serial', load_robot(ROBOT), config) as driver:
            driver.enable()
            times, end = [], time.monotonic() + seconds
            while (now := time.monotonic()) < end:
                driver.write(np.array([1.0, 0.5, 1.0, 0.5]))
                reading = driver.read()
                times.append(1e3 * (time.monotonic() - now))
            assert not reading.faults, reading.faults
    return len(times) / seconds, np.percentile(times, [50, 99])


def main():
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--seconds', type=float, default=5.0)
    parser.add_argument('--json', metavar='FILE')
    args = parser.parse_args()
    print(f'{machine()}, load {os.getloadavg()[0]:.1f} before the start', flush=True)
    each = parsing()
    print(f'parsing: {1e6 * each:.1f} µs a frame, {1e5 * each:.2f} % of a core at 1 kHz')
    share, rate, missed = through_a_port(args.seconds)
    print(f'through a port: {rate:.0f} frames/s, {100 * share:.1f} % of a core, {missed} missed')
    per_second, (p50, p99) = cycles(args.seconds)
    print(f'write + read: {per_second:.0f} cycles/s, p50 {p50:.2f} ms, p99 {p99:.2f} ms')
    if args.json:
        found = {'parse_s': each, 'share': share, 'rate': rate, 'cycles_per_s': per_second}
        Path(args.json).write_text(json.dumps({'machine': machine(), **found}, indent=1))
    assert threading.active_count() == 1
    if max(1e3 * each, share) > TARGET:
        print(f'MISSED: {100 * share:.1f} % of a core, target at most {100 * TARGET:g} %')
        return 1
    return 0


if __name__ == '__main__':
    sys.exit(main())
