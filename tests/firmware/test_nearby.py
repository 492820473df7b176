"""Bumpers and rangers on the pins of both simulated chips, as the host reads them."""

from __future__ import annotations

import pytest

from firmware.simulation.simulated_chip import Chip
from firmware.simulation.simulated_stm32 import Stm32
from wheelsight.io.devices.wire_formats import LinkCommand, Nearby

M_PER_S = 343.0
NO_ANSWER = 0xFFFF


@pytest.fixture(params=["atmega8", "stm32f4"])
def any_chip(request: pytest.FixtureRequest) -> Chip | Stm32:
    return request.getfixturevalue("chip" if request.param == "atmega8" else "board")


def echoes_us(message: Nearby) -> tuple[int, ...]:
    return message[2:]


def test_rangers_measure_twenty_times_a_second_and_never_too_far(any_chip: Chip | Stm32) -> None:
    ranges_m = (0.05, 0.8, 2.5, 4.2)
    for ranger, range_m in enumerate(ranges_m):
        any_chip.echo(ranger, 2 * range_m / M_PER_S)
    any_chip.run(0.15)
    any_chip.messages()
    any_chip.run(1.0)
    found = any_chip.nearby()
    assert len(found) == pytest.approx(20, abs=1)
    for message in found:
        for us, range_m in zip(echoes_us(message), ranges_m, strict=True):
            off_m = us * 1e-6 * M_PER_S / 2 - range_m
            assert -0.06 < off_m <= 0.002
    assert any_chip.lost_frames == 0


def test_no_echo_and_a_cut_cable_differ(any_chip: Chip | Stm32) -> None:
    any_chip.echo(0, 0.038)  # what a ranger gives without an echo
    any_chip.echo(1, 0.01)
    any_chip.run(0.2)
    any_chip.messages()
    any_chip.run(0.1)
    none, some, *cut = echoes_us(any_chip.nearby()[-1])
    assert none == 0
    assert some == pytest.approx(10_000, abs=300)
    assert cut == [NO_ANSWER, NO_ANSWER]
    any_chip.echo(1, 0.0)
    any_chip.run(0.2)
    assert echoes_us(any_chip.nearby()[-1])[1] == NO_ANSWER


def test_a_pressed_bumper_is_sent_at_once(any_chip: Chip | Stm32) -> None:
    any_chip.run(0.1)
    assert [message.bumpers for message in any_chip.nearby()][-1] == 0
    any_chip.run(0.02)
    any_chip.messages()
    any_chip.bumper(1, True)
    any_chip.run(0.005)
    assert [message.bumpers for message in any_chip.nearby()] == [0b10]
    any_chip.bumper(0, True)
    any_chip.run(0.005)
    assert [message.bumpers for message in any_chip.nearby()] == [0b11]
    any_chip.bumper(1, False)
    any_chip.run(0.2)
    assert {message.bumpers for message in any_chip.nearby()} == {0b01}


def test_the_papers_format_has_no_room_for_it(any_chip: Chip | Stm32) -> None:
    if isinstance(any_chip, Stm32):
        pytest.skip("this board has no such format")
    any_chip.command(LinkCommand.SET_FORMAT, b"\1")
    any_chip.run(0.1)
    any_chip.sent()
    any_chip.run(1.0)
    assert len(any_chip.sent()) == pytest.approx(100, abs=4)
