from __future__ import annotations

import tracemalloc
from binascii import crc_hqx

import pytest
from hypothesis import given
from hypothesis import strategies as st

from wheelsight.io.devices.wire_formats import (
    Ack,
    Counts,
    FrameDecoder,
    LinkCommand,
    Message,
    Version,
    drive_body,
    encode_command,
    encode_frame,
    encode_message,
)

BYTE = st.integers(0, 255)
WORD = st.integers(-(1 << 31), (1 << 31) - 1)
MESSAGES = st.one_of(
    st.builds(Counts, BYTE, st.integers(0, (1 << 32) - 1), WORD, WORD),
    st.builds(Version, BYTE, BYTE, BYTE, BYTE, BYTE),
    st.builds(Ack, BYTE, BYTE, BYTE, BYTE),
)


def numbered(count: int, first: int = 0) -> list[Counts]:
    return [Counts(n & 0xFF, 20_000 * n, 157 * n, -157 * n) for n in range(first, first + count)]


def encoded(messages: list[Counts]) -> list[bytes]:
    return [encode_message(message) for message in messages]


def test_a_frame_byte_by_byte() -> None:
    """The frame that docs/serial-link.md spells out."""
    inside = bytes.fromhex("01 05 20 4e 00 00 9d 00 00 00 63 ff ff ff")
    crc = crc_hqx(inside, 0xFFFF)
    frame = encode_message(Counts(5, 20_000, 157, -157))
    assert frame.hex(" ") == f"05 01 05 20 4e 01 02 9d 01 01 07 63 ff ff ff {crc & 255:02x} {crc >> 8:02x} 00"
    assert FrameDecoder().feed(frame) == [Counts(5, 20_000, 157, -157)]


def test_the_checksum_is_the_catalogues() -> None:
    """The check value of CRC-16/CCITT-FALSE (IBM-3740) over "123456789" is 0x29B1."""
    frame = encode_frame(ord("1"), ord("2"), b"3456789")
    assert frame[-3:-1] == bytes([0xB1, 0x29])


def test_commands() -> None:
    assert drive_body(1, -1) == bytes.fromhex("e8 03 18 fc")
    assert drive_body(0.0004, -0.0006) == bytes.fromhex("00 00 ff ff")
    stop = encode_command(LinkCommand.STOP, 256 + 7)
    assert stop == b"\0" + encode_frame(0x82, 7)


@given(st.lists(MESSAGES, max_size=8), st.lists(st.integers(1, 40), max_size=20))
def test_what_was_sent_arrives_however_it_is_cut(messages: list[Message], cuts: list[int]) -> None:
    sent = b"".join(encode_message(message) for message in messages)
    decoder, received = FrameDecoder(), []
    for cut in [*cuts, len(sent) + 1]:
        received += decoder.feed(sent[:cut])
        sent = sent[cut:]
    statistics = decoder.statistics
    assert statistics.frames == len(messages)
    assert (statistics.crc_errors, statistics.malformed, statistics.resyncs) == (0, 0, 0)
    if statistics.duplicates == 0:
        assert received == messages


@given(st.binary(max_size=200))
def test_garbage_never_harms_more_than_one_frame(garbage: bytes) -> None:
    messages = numbered(3)
    decoder = FrameDecoder()
    received = decoder.feed(garbage + b"".join(encoded(messages)))
    assert received[-2:] == messages[-2:]


def test_every_single_and_double_bit_flip_is_noticed() -> None:
    frame = encode_message(Counts(9, 123_456_789, 1_000_000, -3))
    flips = [1 << bit for bit in range(8 * (len(frame) - 1))]
    number = int.from_bytes(frame, "little")
    damaged = {number ^ a ^ b for a in flips for b in flips if a != b} | {number ^ a for a in flips}
    for other in damaged:
        assert FrameDecoder().feed(other.to_bytes(len(frame), "little")) == []


def test_losses_are_counted_by_sequence_over_its_roll_over() -> None:
    frames = encoded(numbered(600))
    kept = [frame for n, frame in enumerate(frames) if n not in {3, 255, 256, 257, 599}]
    decoder = FrameDecoder()
    assert len(decoder.feed(b"".join(kept))) == 595
    assert decoder.statistics.lost == 4  # the last one's absence cannot show yet


def test_repeats_are_dropped_and_are_no_loss() -> None:
    frames = encoded(numbered(10))
    decoder = FrameDecoder()
    received = decoder.feed(b"".join([*frames[:4], frames[3], frames[2], frames[3], *frames[4:]]))
    assert received == numbered(10)
    assert (decoder.statistics.duplicates, decoder.statistics.lost) == (3, 0)


@pytest.mark.parametrize("more", [0, 1, 40])
def test_a_new_sequence_is_no_loss_once_a_restart_is_known(more: int) -> None:
    """However many frames a host that was late is handed with the one that shows the restart."""
    decoder = FrameDecoder()
    decoder.feed(b"".join(encoded(numbered(3, first=100) + numbered(2, first=105) + numbered(2 + more))))
    assert decoder.statistics.lost == 2 + 149
    decoder.forgive_gap(1)
    decoder.forgive_gap(1)
    assert decoder.statistics.lost == 2
    decoder.forget_sequence()
    decoder.feed(b"".join(encoded(numbered(5, first=200))))
    decoder.forgive_gap(204)
    assert decoder.statistics.lost == 2


def test_a_gap_is_forgotten_once_its_number_comes_again() -> None:
    decoder = FrameDecoder()
    decoder.feed(b"".join(encoded(numbered(3, first=100) + numbered(256, first=105) + numbered(2, first=105))))
    assert decoder.statistics.lost == 2
    decoder.forgive_gap(106)
    assert decoder.statistics.lost == 2


@pytest.mark.parametrize("kind", [0x01, 0x02, 0x03])
def test_a_right_checksum_with_a_wrong_length_is_malformed(kind: int) -> None:
    decoder = FrameDecoder()
    assert decoder.feed(b"\0" + encode_frame(kind, 0, bytes(20))) == []
    assert decoder.statistics.malformed == 1


@pytest.mark.parametrize("heard", range(1, 15))
def test_the_end_of_a_frame_that_began_before_anybody_listened_is_no_error(heard: int) -> None:
    cut, whole, damaged = (encode_message(Counts(sequence, 2000, 3, 4)) for sequence in (1, 2, 3))
    damaged = damaged[:-3] + bytes([damaged[-3] ^ 0x10]) + damaged[-2:]
    decoder = FrameDecoder()
    assert decoder.feed(cut[-heard:] + whole) == [Counts(2, 2000, 3, 4)]
    assert (decoder.statistics.crc_errors, decoder.statistics.malformed, decoder.statistics.resyncs) == (0, 0, 0)
    assert decoder.feed(damaged) == []
    assert decoder.statistics.crc_errors + decoder.statistics.malformed == 1


def test_types_of_a_later_protocol_are_counted_and_passed_over() -> None:
    decoder = FrameDecoder()
    messages = decoder.feed(encode_frame(0x7F, 0, b"new") + encode_message(Counts(1, 2, 3, 4)))
    assert messages == [Counts(1, 2, 3, 4)]
    assert (decoder.statistics.unknown, decoder.statistics.lost) == (1, 0)


def test_memory_stays_bounded_without_a_single_zero() -> None:
    decoder = FrameDecoder()
    tracemalloc.start()
    for _ in range(100):
        decoder.feed(b"\x01" * 10_000)
    kept_bytes, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert kept_bytes < 10_000
    assert decoder.feed(b"\0" + encode_message(Counts(1, 2, 3, 4))) == [Counts(1, 2, 3, 4)]
    assert (decoder.statistics.bytes, decoder.statistics.frames) == (1_000_019, 1)
