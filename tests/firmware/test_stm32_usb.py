"""The STM32F4's serial port over USB, asked by a host on a model of the chip's USB core."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from firmware.simulation.simulated_stm32 import SERIAL_NUMBER, Stm32
from firmware.simulation.stm32_usb import UsbError, UsbHost
from wheelsight.io.devices.wire_formats import (
    Ack,
    Counts,
    FrameDecoder,
    LinkCommand,
    Message,
    drive_body,
    encode_command,
)

VENDOR, PRODUCT = 0x1209, 0x0001


@pytest.fixture
def host(board: Stm32) -> UsbHost:
    """A computer into which the board is plugged, and no program has opened the port."""
    host = UsbHost(board.peripherals.usb, board.run)
    host.plug()
    return host


@pytest.fixture
def decoder() -> FrameDecoder:
    return FrameDecoder()


def heard(board: Stm32, host: UsbHost, decoder: FrameDecoder, seconds: float) -> list[Message]:
    """What the board says over USB in so long."""
    messages: list[Message] = []
    for _ in range(round(seconds / 0.02)):
        board.run(0.02)
        messages += decoder.feed(host.read())
    return messages


def descriptors(data: bytes) -> Iterator[bytes]:
    """The parts of a configuration, each of which begins with its length."""
    while data:
        assert 2 <= data[0] <= len(data)
        yield data[: data[0]]
        data = data[data[0] :]


def test_it_says_that_it_is_a_serial_port(board: Stm32) -> None:
    host = UsbHost(board.peripherals.usb, board.run)
    device, configuration = host.plug()
    assert len(device) == device[0] == 18
    assert device[2:4] == b"\x00\x02"
    assert (int.from_bytes(device[8:10], "little"), int.from_bytes(device[10:12], "little")) == (VENDOR, PRODUCT)
    assert int.from_bytes(configuration[2:4], "little") == len(configuration)
    parts = list(descriptors(configuration))
    interfaces = [part for part in parts if part[1] == 4]
    assert [part[5:7] for part in interfaces] == [b"\x02\x02", b"\x0a\x00"]  # control of a modem, and its data
    assert configuration[4] == len(interfaces)
    endpoints = {part[2]: (part[3], int.from_bytes(part[4:6], "little")) for part in parts if part[1] == 5}
    assert endpoints == {0x82: (3, 8), 0x01: (2, 64), 0x81: (2, 64)}
    assert [part[4] for part in interfaces] == [1, 2]
    assert host.string(1) == "wheelsight"
    number = b"".join(
        SERIAL_NUMBER[at : at + 4][::-1] for at in range(0, 12, 4)
    )  # words, of which the first byte is least
    assert host.string(3) == number.hex().upper()


def test_nothing_is_said_until_a_program_opens_the_port(board: Stm32, host: UsbHost, decoder: FrameDecoder) -> None:
    assert heard(board, host, decoder, 0.2) == []
    host.open_port()
    first, *others = heard(board, host, decoder, 0.2)
    assert isinstance(first, Counts)
    assert first.clock_us > 300_000  # nothing from before
    assert len([message for message in others if isinstance(message, Counts)]) == pytest.approx(9, abs=2)
    host.open_port(False)
    host.read()
    assert heard(board, host, decoder, 0.2) == []


def test_a_program_gets_nothing_that_an_earlier_one_left(board: Stm32, host: UsbHost, decoder: FrameDecoder) -> None:
    host.open_port()
    board.run(0.3)  # it reads nothing
    host.open_port(False)
    board.run(0.1)
    host.open_port()
    first = next(message for message in heard(board, host, decoder, 0.1) if isinstance(message, Counts))
    assert first.clock_us > 500_000


def test_no_count_is_lost_over_usb_at_twice_400_khz(board: Stm32, host: UsbHost, decoder: FrameDecoder) -> None:
    host.open_port()
    board.turn("left", 200_000, 400_000)
    board.turn("right", -200_000, 399_000)
    counts = [reported for reported in heard(board, host, decoder, 0.7) if isinstance(reported, Counts)]
    assert (counts[-1].left, counts[-1].right) == board.positions() == (200_000, -200_000)
    assert (decoder.statistics.lost, decoder.statistics.crc_errors, decoder.statistics.malformed) == (0, 0, 0)


def test_commands_are_obeyed_and_answered_on_both_lines(board: Stm32, host: UsbHost, decoder: FrameDecoder) -> None:
    host.open_port()
    host.write(encode_command(LinkCommand.DRIVE, 77, drive_body(0.5, -0.25)))
    reported = heard(board, host, decoder, 0.04)
    assert [(ack.command, ack.command_sequence) for ack in reported if isinstance(ack, Ack)] == [
        (LinkCommand.DRIVE, 77)
    ]
    assert board.duties() == pytest.approx((500, -250), abs=0.1)
    assert [ack.command_sequence for ack in board.acks()] == [77]
    # Halves of commands that come over both lines at once are not mixed.
    first, second = encode_command(LinkCommand.STOP, 78), encode_command(LinkCommand.DRIVE, 79, drive_body(0.1, 0.1))
    host.write(first[:4])
    board.send(second)
    board.run(0.01)
    host.write(first[4:])
    board.run(0.01)
    assert [ack.command_sequence for ack in board.acks()] == [79, 78]


def test_a_host_that_writes_without_end_waits_and_loses_nothing(
    board: Stm32, host: UsbHost, decoder: FrameDecoder
) -> None:
    host.open_port()
    acks: list[Ack] = []
    for n in range(0, 180, 30):  # 390 bytes at a time, of which the board keeps 255
        host.write(b"".join(encode_command(LinkCommand.DRIVE, n + k, drive_body(0.1, 0.1)) for k in range(30)))
        acks += [reported for reported in heard(board, host, decoder, 0.02) if isinstance(reported, Ack)]
    acks += [reported for reported in heard(board, host, decoder, 0.1) if isinstance(reported, Ack)]
    assert [ack.command_sequence for ack in acks] == list(range(180))


def test_noise_on_usb_does_nothing(
    board: Stm32, host: UsbHost, decoder: FrameDecoder, rng: np.random.Generator
) -> None:
    host.open_port()
    for _ in range(20):
        host.write(rng.bytes(int(rng.integers(1, 200))))
        board.run(0.005)
    assert board.duties() == pytest.approx((0, 0), abs=0.1)
    host.write(encode_command(LinkCommand.STOP, 5))
    acks = [reported.command_sequence for reported in heard(board, host, decoder, 0.1) if isinstance(reported, Ack)]
    assert acks == [5]


@pytest.mark.parametrize(
    "request_of_host",
    [(0x80, 6, 0x0600, 0, 10), (0x80, 6, 0x0304, 0x0409, 255), (0x21, 0x99, 0, 0, 0), (0x80, 12, 0, 0, 2)],
)
def test_what_it_does_not_know_is_refused_and_the_next_request_is_not(
    host: UsbHost, request_of_host: tuple[int, int, int, int, int]
) -> None:
    with pytest.raises(UsbError, match="stalled"):
        host.control(*request_of_host)
    assert host.control(0x80, 8, 0, 0, 1) == b"\1"  # the configuration in use
    assert host.control(0xA1, 0x21, 0, 0, 7)[:4] == (115_200).to_bytes(4, "little")


def test_any_request_is_answered_or_refused(
    board: Stm32, host: UsbHost, decoder: FrameDecoder, rng: np.random.Generator
) -> None:
    for _ in range(100):
        board.peripherals.usb.setup(rng.bytes(8))
        board.run(0.001)
    board.peripherals.usb.reset_bus()
    host.plug()
    host.open_port()
    assert heard(board, host, decoder, 0.1)
    assert board.resets == 0


def test_plugged_in_again(board: Stm32, host: UsbHost, decoder: FrameDecoder) -> None:
    host.open_port()
    heard(board, host, decoder, 0.1)
    board.run(0.5)  # no one takes what is said
    host.plug()
    assert host.read() == b""
    host.open_port()
    first = next(message for message in heard(board, host, decoder, 0.1) if isinstance(message, Counts))
    assert first.clock_us > 600_000


def test_a_board_that_begins_again_is_seen_to_go_and_come(board: Stm32, host: UsbHost, decoder: FrameDecoder) -> None:
    board.hang()
    board.run(0.06)
    assert board.resets == 1
    assert not board.peripherals.usb.is_connected
    board.run(0.05)
    assert not board.peripherals.usb.is_connected
    board.run(0.1)
    host.plug()
    host.open_port()
    assert heard(board, host, decoder, 0.1)


def test_a_board_without_usb_talks_on_its_other_line(built_stm32: Path) -> None:
    with Stm32(built_stm32 / "controller.bin") as board:
        board.run(0.5)
        assert len(board.counts()) >= 23
