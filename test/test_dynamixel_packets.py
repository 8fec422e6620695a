"""
The emulator's bytes against those printed in the servo's manual.

Every sequence below is printed, byte by byte, on the page "DYNAMIXEL Protocol 2.0" of the ROBOTIS
e-Manual (https://emanual.robotis.com/docs/en/dxl/protocol2/, sections "Ping" to "Fast Sync Read");
none was produced by the SDK or by this package.
"""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tendon_robot_ros.emulator import bus as packets
from tendon_robot_ros.emulator.bus import Instruction, InstructionReceiver
from tendon_robot_ros.emulator.bus import InstructionCode as Code


def printed(text):
    return bytes.fromhex(text)


INSTRUCTIONS = {
    'ping': ('FF FF FD 00 01 03 00 01 19 4E', 1, Code.PING, ''),
    'ping of all': ('FF FF FD 00 FE 03 00 01 31 42', 0xFE, Code.PING, ''),
    'read': ('FF FF FD 00 01 07 00 02 84 00 04 00 1D 15', 1, Code.READ, '84 00 04 00'),
    'write': (
        'FF FF FD 00 01 09 00 03 74 00 00 02 00 00 CA 89',
        1,
        Code.WRITE,
        '74 00 00 02 00 00',
    ),
    'reboot': ('FF FF FD 00 01 03 00 08 2F 4E', 1, Code.REBOOT, ''),
    'sync read': (
        'FF FF FD 00 FE 09 00 82 84 00 04 00 01 02 CE FA',
        0xFE,
        Code.SYNC_READ,
        '84 00 04 00 01 02',
    ),
    'sync write': (
        'FF FF FD 00 FE 11 00 83 74 00 04 00 01 96 00 00 00 02 AA 00 00 00 82 87',
        0xFE,
        Code.SYNC_WRITE,
        '74 00 04 00 01 96 00 00 00 02 AA 00 00 00',
    ),
    'fast sync read': (
        'FF FF FD 00 FE 0A 00 8A 84 00 04 00 03 07 04 20 F2',
        0xFE,
        Code.FAST_SYNC_READ,
        '84 00 04 00 03 07 04',
    ),
}

ANSWERS = {
    'ping, id 1': ('FF FF FD 00 01 07 00 55 00 06 04 26 65 5D', 1, '06 04 26'),
    'ping, id 2': ('FF FF FD 00 02 07 00 55 00 06 04 26 6F 6D', 2, '06 04 26'),
    'read': ('FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0', 1, 'A6 00 00 00'),
    'write': ('FF FF FD 00 01 04 00 55 00 A1 0C', 1, ''),
    'sync read, id 2': ('FF FF FD 00 02 08 00 55 00 1F 08 00 00 BA BE', 2, '1F 08 00 00'),
}


@pytest.mark.parametrize('name', INSTRUCTIONS)
def test_framing_gives_the_printed_instruction_and_the_receiver_understands_it(name):
    text, identity, code, parameters = INSTRUCTIONS[name]
    assert packets.packet(identity, bytes([code]) + printed(parameters)) == printed(text)
    expected = Instruction(identity, code, printed(parameters))
    assert InstructionReceiver().feed(printed(text)) == [expected]


@pytest.mark.parametrize('name', ANSWERS)
def test_an_answer_is_the_printed_status_packet(name):
    text, identity, data = ANSWERS[name]
    assert packets.status(identity, 0, printed(data)) == printed(text)


def test_a_fast_sync_read_is_answered_by_the_printed_parts_in_one_packet():
    parts = [
        (3, 0, printed('A6 00 00 00')),
        (7, 0, printed('1F 08 00 00')),
        (4, 0, printed('FF 03 00 00')),
    ]
    assert packets.fast_status(parts) == printed(
        'FF FF FD 00 FE 19 00 55 00 03 A6 00 00 00 84 08'
        '00 07 1F 08 00 00 16 CA 00 04 FF 03 00 00 D1 9E'
    )


def test_every_half_of_a_packet_waits_for_the_other_half():
    text = printed(INSTRUCTIONS['sync write'][0])
    for cut in range(1, len(text)):
        receiver = InstructionReceiver()
        assert receiver.feed(text[:cut]) == []
        assert len(receiver.feed(text[cut:])) == 1


def test_a_wrong_crc_drops_the_packet_and_the_next_one_is_understood():
    text = printed(INSTRUCTIONS['read'][0])
    receiver = InstructionReceiver()
    spoilt = text[:-1] + bytes([text[-1] ^ 1])
    assert receiver.feed(spoilt + text) == [Instruction(1, Code.READ, printed('84 00 04 00'))]
    assert receiver.broken == 1


@given(st.binary(max_size=60))
def test_stuffing_hides_every_header_and_comes_out_again(body):
    assert packets.HEADER not in packets.stuff(body)
    receiver = InstructionReceiver()
    found = receiver.feed(packets.packet(5, b'\x03' + body))
    assert found == [Instruction(5, Code.WRITE, body)]


@given(st.binary(max_size=400))
def test_noise_never_breaks_the_receiver(noise):
    receiver = InstructionReceiver()
    receiver.feed(noise)
    for _ in range(2):  # noise may have promised a long packet: silence ends no packet here
        receiver.feed(bytes(packets.PACKET_BYTES_MAX))
    assert receiver.feed(printed(INSTRUCTIONS['ping'][0]))[-1:] == [Instruction(1, Code.PING, b'')]
