"""
The emulator's bytes against those printed in the servo's manual.

Every sequence below is printed, byte by byte, on the page "DYNAMIXEL Protocol 2.0" of the ROBOTIS
e-Manual (https://emanual.robotis.com/docs/en/dxl/protocol2/, sections "Ping" to "Fast Bulk Read");
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
    'reg write': (
        'FF FF FD 00 01 09 00 04 68 00 C8 00 00 00 AE 8E',
        1,
        Code.REG_WRITE,
        '68 00 C8 00 00 00',
    ),
    'action': ('FF FF FD 00 01 03 00 05 02 CE', 1, Code.ACTION, ''),
    'factory reset': ('FF FF FD 00 01 04 00 06 01 A1 E6', 1, Code.FACTORY_RESET, '01'),
    'reboot': ('FF FF FD 00 01 03 00 08 2F 4E', 1, Code.REBOOT, ''),
    'clear': (
        'FF FF FD 00 01 08 00 10 01 44 58 4C 22 B1 DC',
        1,
        Code.CLEAR,
        '01 44 58 4C 22',
    ),
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
    'bulk read': (
        'FF FF FD 00 FE 0D 00 92 01 90 00 02 00 02 92 00 01 00 1A 05',
        0xFE,
        Code.BULK_READ,
        '01 90 00 02 00 02 92 00 01 00',
    ),
    'bulk write': (
        'FF FF FD 00 FE 10 00 93 01 20 00 02 00 A0 00 02 1F 00 01 00 50 B7 68',
        0xFE,
        Code.BULK_WRITE,
        '01 20 00 02 00 A0 00 02 1F 00 01 00 50',
    ),
}

ANSWERS = {
    'ping, id 1': ('FF FF FD 00 01 07 00 55 00 06 04 26 65 5D', 1, '06 04 26'),
    'ping, id 2': ('FF FF FD 00 02 07 00 55 00 06 04 26 6F 6D', 2, '06 04 26'),
    'read': ('FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0', 1, 'A6 00 00 00'),
    'write': ('FF FF FD 00 01 04 00 55 00 A1 0C', 1, ''),
    'sync read, id 2': ('FF FF FD 00 02 08 00 55 00 1F 08 00 00 BA BE', 2, '1F 08 00 00'),
    'bulk read, id 1': ('FF FF FD 00 01 06 00 55 00 77 00 C3 69', 1, '77 00'),
    'bulk read, id 2': ('FF FF FD 00 02 05 00 55 00 24 8B A9', 2, '24'),
}


@pytest.mark.parametrize('name', INSTRUCTIONS)
def test_the_receiver_understands_the_printed_instruction(name):
    text, identity, code, parameters = INSTRUCTIONS[name]
    expected = Instruction(identity, code, printed(parameters))
    assert InstructionReceiver().feed(printed(text)) == [expected]


@pytest.mark.parametrize('name', INSTRUCTIONS)
def test_framing_gives_the_printed_instruction(name):
    text, identity, code, parameters = INSTRUCTIONS[name]
    assert packets.packet(identity, bytes([code]) + printed(parameters)) == printed(text)


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


def test_a_fast_bulk_read_is_answered_by_the_printed_parts_in_one_packet():
    parts = [(3, 0, printed('A6 00 00 00')), (7, 0, printed('A5 01')), (4, 0, printed('1F'))]
    assert packets.fast_status(parts) == printed(
        'FF FF FD 00 FE 14 00 55 00 03 A6 00 00 00 67 A4 00 07 A5 01 24 74 00 04 1F D9 C1'
    )


def test_the_crc_printed_for_the_fast_bulk_read_is_a_misprint():
    # the page repeats the CRC of its fast sync read; all other printed CRCs agree with the rule
    text = 'FF FF FD 00 FE 12 00 9A 03 84 00 04 00 07 7C 00 02 00 04 92 00 01 00'
    assert packets.with_crc(printed(text))[-2:] == printed('DA 2D') != printed('20 F2')


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
