"""The reference firmware: it compiles for the boards, and lets go whatever the computer does."""

import re
import shutil
import struct

import numpy as np
import processes
import pytest
from emulated_board import needs_compiler
from source_tree import ROOT

from tendon_robot_ros.drivers.serial_board import messages
from tendon_robot_ros.drivers.serial_board.messages import (
    BoardFlag,
    FrameReceiver,
    Message,
    encode,
)
from tendon_robot_ros.emulator import board as emulated
from tendon_robot_ros.emulator.board import BoardRig
from tendon_robot_ros.emulator.rig import SpringArm

SOURCE = ROOT / 'firmware'
STRICT = ['-std=c99', '-pedantic', '-Wall', '-Wextra', '-Werror']


@pytest.mark.skipif(not shutil.which('avr-gcc'), reason='no avr-gcc: apt install gcc-avr avr-libc')
@pytest.mark.skipif(not shutil.which('make'), reason='no make')
@pytest.mark.parametrize(
    ('mcu', 'channels', 'ram'), [('atmega2560', 4, 8192), ('atmega328p', 2, 2048)]
)
def test_it_compiles_for_the_board_and_fits_in(tmp_path, mcu, channels, ram):
    run = processes.run(
        ['make', '-C', SOURCE, f'MCU={mcu}', f'CHANNELS={channels}', f'BUILD={tmp_path}'],
    )
    assert run.returncode == 0, run.stderr
    assert (tmp_path / f'{mcu}.hex').stat().st_size > 1000
    text, data, bss = map(int, re.findall(r'^\s*(\d+)\s+(\d+)\s+(\d+)', run.stdout, re.M)[0])
    assert text + data < 30 * 1024
    assert data + bss < 0.6 * ram  # the rest is for the stack


@needs_compiler
@pytest.mark.parametrize('channels', [1, 2, 4, 8])
def test_its_portable_part_compiles_without_a_warning(tmp_path, channels):
    for part in ('protocol.c', 'control.c', 'board.c'):
        command = [emulated.compiler(), *STRICT, f'-DCHANNELS={channels}', '-c', SOURCE / part]
        run = processes.run([*command, '-o', tmp_path / 'x.o'])
        assert run.returncode == 0, run.stderr


@needs_compiler
def test_a_board_leaves_nothing_in_the_temporary_folder(tmp_path, monkeypatch):
    monkeypatch.setattr('tempfile.tempdir', str(tmp_path))
    emulated.compiled_firmware.cache_clear()
    board = emulated.Firmware(2)
    board.step(1000)
    assert list(tmp_path.iterdir()) == []


class Board:
    """Four springs on an emulated board, driven by messages; no port, no clock."""

    def __init__(self):
        self.rig = BoardRig(SpringArm(np.full(4, 400.0), np.zeros(4)), 4)
        self.receiver = FrameReceiver()

    def say(self, kind, payload=b''):
        """Send a message; return the code of the answer, None when there is none."""
        self.rig.firmware.receive(encode(kind, 5, payload))
        answers = [f for f in self.heard() if f.type == Message.RESULT]
        return answers[-1].payload[2] if answers else None

    def heard(self):
        return self.receiver.feed(self.rig.firmware.take())

    def wait(self, seconds):
        for _ in range(round(seconds / 0.01)):
            self.rig.advance(0.01)
        return [f for f in self.heard() if f.type == Message.TELEMETRY]

    def state(self):
        self.rig.firmware.receive(encode(Message.HEARTBEAT, 1))
        return messages.read_telemetry(self.wait(0.05)[-1], 4)

    def configure(self, release_to='pretension'):
        for i, cell in enumerate(self.rig.cells):
            scales = (cell.zero, cell.newtons_per_count, self.rig.motor.spool.metres_per_tick)
            assert self.say(Message.CALIBRATION, messages.calibration(i, *scales)) == 0
            values = np.array([0.0, 5.0, -0.02, 0.03, 20.0, 0.05])
            assert self.say(Message.LIMITS, messages.limits(i, values)) == 0
        content = messages.settings(0.2, release_to, 0.01, 10.0, 0.2, 0.015)
        assert self.say(Message.SETTINGS, content) == 0

    def command(self, *tensions, mode='tension'):
        return self.say(Message.COMMAND, messages.command(mode, np.array(tensions)))

    def tense(self, *tensions):
        assert self.say(Message.ENABLE, b'\x00\x0f') == 0
        for _ in range(150):
            assert self.command(*tensions) is None
            self.rig.advance(0.01)
            self.heard()


@pytest.fixture
def board():
    if emulated.compiler() is None:
        pytest.skip('no C compiler: the emulated board is skipped')
    return Board()


def test_it_is_silent_until_it_hears_a_frame_and_again_after_a_second_without(board):
    assert board.wait(0.5) == []
    board.say(Message.HELLO)
    assert len(board.wait(0.5)) > 30
    board.wait(1.0)
    assert board.wait(0.5) == []


def test_it_switches_nothing_on_before_it_is_configured(board):
    assert board.say(Message.ENABLE, b'\x00\x0f') == 3
    assert board.state().enabled == 0


def test_it_reaches_the_tensions_and_says_which_command_it_follows(board):
    board.configure()
    board.tense(2.0, 1.0, 0.5, 3.0)
    state = board.state()
    np.testing.assert_allclose(state.tensions, [2.0, 1.0, 0.5, 3.0], atol=0.08)
    assert (state.enabled, state.flags, state.sequence) == (15, BoardFlag.CONFIGURED, 5)


def test_it_lets_go_slowly_when_it_hears_no_command_however_many_heartbeats_come(board):
    board.configure()
    board.tense(3.0, 3.0, 3.0, 3.0)
    tensions = []
    for _ in range(150):
        board.say(Message.HEARTBEAT)
        board.say(Message.RAW)
        board.rig.advance(0.01)
        tensions.append(board.rig.tensions.max())
    assert min(tensions[:20]) > 2.8  # not before the timeout
    assert np.min(np.diff(tensions)) > -0.25  # 10 N/s are 0.1 N a step
    assert 0.1 < tensions[-1] < 0.35
    assert board.state().flags & BoardFlag.SILENCE
    assert board.state().enabled == 15


def test_a_release_to_limp_ends_with_the_motors_off(board):
    board.configure('limp')
    board.tense(3.0, 1.0, 1.0, 1.0)
    board.wait(1.0)
    assert board.state().enabled == 0


def test_a_command_after_silence_goes_on_from_the_measured_tension(board):
    board.configure()
    board.tense(3.0, 1.0, 1.0, 1.0)
    board.wait(1.0)
    low = board.rig.tensions[0]
    board.command(3.0, 1.0, 1.0, 1.0)
    board.rig.advance(0.02)
    assert board.rig.tensions[0] < low + 0.5
    assert not board.state().flags & BoardFlag.SILENCE


def test_no_command_passes_a_limit(board):
    board.configure()
    board.tense(2000.0, 4.9, 5.1, -3.0)
    tensions = board.state().tensions
    assert np.all(tensions < 5.1)
    assert np.all(board.rig.highest < 5.3)
    assert tensions[3] < 0.1


def test_a_wire_outside_its_limits_comes_back_at_its_rate(board):
    board.configure()
    board.rig.places[:] = -0.04, -0.03, 0.0, -0.025
    board.wait(0.05)
    before = board.rig.places.copy()
    assert board.say(Message.ENABLE, b'\x01\x0f') == 0
    for _ in range(10):
        board.command(0.0, 0.0, 0.0, 0.0, mode='pull')
        board.rig.advance(0.01)
    moved = np.abs(board.rig.places - before)
    assert np.all(moved < 0.1 * 0.05 + 1e-3)
    assert np.all(moved[[0, 1, 3]] > 1e-3)


@pytest.mark.parametrize(
    ('kind', 'payload', 'code'),
    [
        (Message.COMMAND, b'\x00' + bytes(12), 1),
        (Message.COMMAND, b'\x02' + bytes(16), 2),
        (Message.COMMAND, b'\x01' + bytes(16), 2),  # pull, but tension is enabled
        (Message.ENABLE, b'\x00\xff', 2),
        (Message.LIMITS, bytes((9,)) + struct.pack('<6i', 0, 1, 0, 1, 1, 1), 2),
        (Message.LIMITS, bytes((0,)) + struct.pack('<6i', 2, 1, 0, 1, 1, 1), 2),
        (Message.CALIBRATION, bytes((0,)) + struct.pack('<3i', 0, 1, 1), 2),  # it is on
        (Message.SETTINGS, struct.pack('<HBHiii', 5, 0, 1000, 1, 1, 1), 2),
        (0x70, b'', 5),
    ],
)
def test_a_message_that_is_wrong_is_refused_as_a_whole(board, kind, payload, code):
    board.configure()
    board.tense(2.0, 2.0, 2.0, 2.0)
    before = board.state()
    assert board.say(kind, payload) == code
    assert board.state().sequence == before.sequence
    assert board.state().enabled == 15
