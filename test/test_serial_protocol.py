"""Frames of the serial protocol: published CRC, both sides alike, nothing wrong gets through."""

import ctypes
import itertools
import random
import re
import struct

import numpy as np
import pytest
from emulated_board import needs_compiler
from hypothesis import given, settings
from hypothesis import strategies as st
from source_tree import ROOT

from tendon_robot_ros.drivers.serial_board import messages
from tendon_robot_ros.drivers.serial_board.messages import (
    FRAME_BYTES_MAX,
    Frame,
    FrameReceiver,
    Message,
    crc16,
    decode,
    encode,
)
from tendon_robot_ros.emulator.board import Firmware

SLOW = pytest.param(100_000, marks=pytest.mark.slow, id='100000')
PAYLOADS = st.binary(max_size=106) | st.lists(st.sampled_from([0, 1, 255]), max_size=106).map(
    bytes
)


def state(i=0):
    """Make the payload of telemetry of four channels, full of zeros as real ones are."""
    head = struct.pack('<IBBBBH', 1_000_000 + 1000 * i, 1, 15, 0, i & 0xFF, 0)
    values = [(1_500_000 + 997 * i, 12_000 - i, 300, 0), (0, 0, 0, 0), (-5, -65_536, -1, 4)]
    return head + b''.join(struct.pack('<iihH', *v) for v in [*values, (256, 0, 0, 0)])


def test_the_crc_gives_the_published_check_value():
    # CRC-16/IBM-3740 (CCITT-FALSE) in Cook's catalogue of parametrised CRC algorithms
    assert crc16(b'123456789') == 0x29B1


def test_the_frames_printed_in_the_document_are_those_that_are_sent():
    text = (ROOT / 'docs/serial_protocol.md').read_text(encoding='utf-8')
    printed = {
        name: bytes.fromhex(row)
        for name, row in re.findall(r'^    (\w+): ((?:[0-9A-F]{2} ?)+)$', text, re.MULTILINE)
    }
    tensions = messages.command('tension', np.array([1.5, 0.25, 0.0, 0.1]))
    assert printed['HELLO'] == encode(Message.HELLO, 1)[1:]
    assert printed['COMMAND'] == encode(Message.COMMAND, 7, tensions)[1:]


@given(kind=st.integers(0, 255), sequence=st.integers(0, 255), payload=PAYLOADS)
@settings(max_examples=200, deadline=None)
def test_every_frame_is_read_as_it_was_written(kind, sequence, payload):
    data = encode(kind, sequence, payload)
    assert data.count(0) == 2
    assert len(data) - 2 <= FRAME_BYTES_MAX
    assert decode(data[1:-1]) == Frame(1, kind, sequence, payload)


@needs_compiler
@given(data=st.binary(max_size=130) | PAYLOADS.map(lambda p: encode(0x82, 3, p)[1:-1]))
@settings(max_examples=300, deadline=None)
def test_board_and_computer_read_the_same_from_the_same_bytes(data):
    data = data.replace(b'\0', b'\1')
    frame = decode(data)
    ours = frame and bytes((*frame[:3], len(frame.payload))) + frame.payload
    assert firmware_of_eight().decode(data) == ours


class DecodingFirmware(Firmware):
    """A board that shows what it reads between two delimiters: header and payload."""

    def decode(self, data):
        buffer = ctypes.create_string_buffer(256)
        size = self._library.host_decode(data, len(data), buffer) if len(data) < 256 else -1
        return buffer.raw[: 4 + size] if size >= 0 else None


_EIGHT = []


def firmware_of_eight():
    if not _EIGHT:
        _EIGHT.append(DecodingFirmware(8))
    return _EIGHT[0]


@needs_compiler
def test_a_frame_in_pieces_of_any_size_is_read_once():
    whole = b''.join(encode(Message.TELEMETRY, i, state(i)) for i in range(20))
    for size in (1, 2, 3, 7, 64, 1000):
        receiver = FrameReceiver()
        pieces = (whole[k : k + size] for k in range(0, len(whole), size))
        frames = [frame for piece in pieces for frame in receiver.feed(piece)]
        assert [frame.sequence for frame in frames] == list(range(20))
        assert receiver.bad == 0


def test_a_receiver_finds_the_next_frame_after_any_noise():
    receiver = FrameReceiver()
    noise = random.Random(1).randbytes(10_000)
    assert receiver.feed(noise) == []
    assert [f.type for f in receiver.feed(encode(Message.RESULT, 1, b'abc'))] == [0x84]


def test_noise_without_a_delimiter_is_not_collected_for_ever():
    receiver = FrameReceiver()
    for _ in range(100):
        assert receiver.feed(b'\x55' * 1000) == []
    assert len(receiver._rest) <= FRAME_BYTES_MAX + 1
    assert receiver.feed(b'\0') == []


def spoil(rng, data):
    """Flip, lose, add or repeat bytes, as a bad cable does."""
    data = bytearray(data)
    for _ in range(rng.randrange(1, 5)):
        place = rng.randrange(len(data))
        kind = rng.randrange(4)
        if kind == 0:
            data[place] = rng.randrange(256)
        elif kind == 1:
            del data[place : place + rng.randrange(1, 8)]
        elif kind == 2:
            data[place:place] = rng.randbytes(rng.randrange(1, 8))
        else:
            data[place:place] = data[place : place + rng.randrange(1, 20)]
        if not data:
            return b'\1'
    return bytes(data)


@needs_compiler
@pytest.mark.parametrize('count', [5_000, SLOW])
def test_spoilt_frames_crash_nobody_and_give_no_wrong_value(count):
    rng, receiver, board = random.Random(7), FrameReceiver(), firmware_of_eight()
    accepted = 0
    for i in range(count):
        payload = state(i) if i % 2 else rng.randbytes(rng.randrange(107))
        good = encode(Message.TELEMETRY, i, payload)
        data = spoil(rng, good) if i % 4 else rng.randbytes(rng.randrange(1, 130))
        for frame in receiver.feed(data + b'\0'):
            assert (frame.sequence, frame.payload) == (i & 0xFF, payload)  # spoilt outside it
            accepted += 1
        for piece in data.split(b'\0'):
            found = board.decode(piece)
            assert found is None or found[4:] == payload
        board.receive(data + b'\0')
    assert receiver.bad > 0.5 * count
    assert accepted < 0.2 * count
    board.receive(encode(Message.HELLO, 1))
    assert board.take()


def flipped(data, bits):
    spoilt = bytearray(data)
    for bit in bits:
        spoilt[bit // 8] ^= 1 << bit % 8
    return bytes(spoilt)


def check_flips(campaign):
    """Feed three frames with flipped bits; only frames that were sent may come out."""
    sent = {(i, state(i)) for i in range(3)}
    whole = b''.join(encode(Message.TELEMETRY, i, state(i))[1:] for i in range(3))
    board = firmware_of_eight()
    for bits in campaign(8 * len(whole)):
        data = flipped(whole, bits)
        found = {(f.sequence, f.payload) for f in FrameReceiver().feed(data)}
        assert found <= sent, bits
        assert len(found) >= 3 - 2 * len(bits), bits
        for piece in data.split(b'\0'):
            there = board.decode(piece)
            assert there is None or (there[2], there[4:]) in sent, bits


@needs_compiler
def test_no_single_flipped_bit_gives_a_wrong_value():
    check_flips(lambda size: ((bit,) for bit in range(size)))


@needs_compiler
@pytest.mark.parametrize('count', [2_000, SLOW])
def test_neither_two_three_nor_more_flipped_bits_give_a_wrong_value(count):
    rng = random.Random(3)
    check_flips(
        lambda size: (
            rng.sample(range(size), rng.choice((2, 2, 3, 3, 5, 8))) for _ in range(count)
        )
    )


@pytest.mark.slow
def test_no_pair_of_flipped_bits_in_a_command_gives_a_wrong_value():
    good = encode(Message.COMMAND, 9, messages.command('pull', np.array([0.01, 0, -0.02, 0])))
    for bits in itertools.combinations(range(8 * (len(good) - 2)), 2):
        pieces = flipped(good[1:-1], bits).split(b'\0')
        assert all(decode(piece) is None for piece in pieces), bits
