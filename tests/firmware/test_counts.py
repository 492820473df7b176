from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from firmware.simulation.simulated_chip import FASTEST_PULSES_PER_S, Chip, is_exact_at
from wheelsight.io.devices.wire_formats import LinkCommand, drive_body


def last(chip: Chip) -> tuple[int, int]:
    """The counts of the chip's last frame."""
    counts = chip.counts()[-1]
    return counts.left, counts.right


@pytest.mark.parametrize("wheel", ["left", "right"])
def test_a_pulse_is_counted_forward_and_taken_back_backward(chip: Chip, wheel: str) -> None:
    position = 0
    for quarters in (4, 1, -1, -8, 3, 1, -2, 6):
        position += quarters
        chip.turn(wheel, quarters, 500)
        chip.rest()
        pulses = -(-position // 4)
        assert last(chip) == ((pulses, 0) if wheel == "left" else (0, pulses))


def test_both_wheels_at_full_speed_with_direction_changes(chip: Chip, rng: np.random.Generator) -> None:
    # The wheels run at slightly different rates, so that their edges meet in every phase, and turn about anywhere
    # within a pulse; the host commands all the while.
    for wheel, rate in (("left", FASTEST_PULSES_PER_S), ("right", 1.0007 * FASTEST_PULSES_PER_S)):
        quarters = rng.integers(1, 4000, 40) * np.where(np.arange(40) % 2, -1, 1)
        for turn in [4 * FASTEST_PULSES_PER_S, *quarters.tolist(), -8 * FASTEST_PULSES_PER_S]:
            chip.turn(wheel, turn, rate)
    for _ in range(200):
        chip.command(LinkCommand.DRIVE, drive_body(1, -1))
        chip.run(0.02)
    chip.rest()
    assert last(chip) == chip.pulses()
    assert min(map(abs, chip.pulses())) > FASTEST_PULSES_PER_S / 2
    assert chip.lost_frames == 0


@pytest.mark.parametrize("times", [1, 2])
def test_no_count_is_lost_up_to_twice_the_fastest_rate(built: Path, times: int) -> None:
    """Up to which rate is measured by `python -m benchmarks firmware`."""
    assert is_exact_at(built / "chip", built / "controller.elf", times * FASTEST_PULSES_PER_S)


def test_counts_belong_to_the_clock_they_come_with(chip: Chip) -> None:
    rate = 5000.0
    chip.turn("left", 40_000, rate)
    chip.turn("right", -40_000, rate)
    chip.rest()
    moving = [frame for frame in chip.counts() if 0 < frame.left < 10_000]
    seconds = 1e-6 * (np.array([frame.clock_us for frame in moving]) - moving[0].clock_us)
    for counts, sign in (([frame.left for frame in moving], 1), ([frame.right for frame in moving], -1)):
        expected = counts[0] + sign * rate * seconds
        assert np.abs(np.array(counts) - expected).max() < 1.1  # a pulse is whole, and 4 µs are 0.02 pulses


def test_a_wheel_that_trembles_on_an_edge_stays_where_it_is(chip: Chip) -> None:
    chip.turn("left", 1, 1000)
    for _ in range(500):
        chip.turn("left", -1, 1000)
        chip.turn("left", 1, 1000)
    chip.rest()
    assert last(chip) == (1, 0)


def test_rising_edges_alone_count_each_tremble(built: Path, rising_edges: Path) -> None:
    with Chip(built / "chip", rising_edges) as chip:
        chip.run(0.1)
        chip.turn("left", 4 * FASTEST_PULSES_PER_S, FASTEST_PULSES_PER_S)
        chip.rest()
        assert last(chip) == chip.pulses() == (FASTEST_PULSES_PER_S, 0)
        for _ in range(500):
            chip.turn("left", 1, 1000)
            chip.turn("left", -1, 1000)
        chip.rest()
        assert last(chip)[0] == chip.pulses()[0] + 500  # why the program counts both edges unless reported otherwise


@pytest.mark.parametrize("cycles", [3, 10, 20])
def test_spikes_are_no_pulses(chip: Chip, cycles: int) -> None:
    for _ in range(50):
        chip.ask(f"spike left {cycles}")
        chip.ask(f"spike right {cycles}")
        chip.run(0.0007)
    chip.run(0.05)
    assert last(chip) == (0, 0)


def test_reset_begins_again_in_the_middle_of_a_turn(chip: Chip) -> None:
    chip.turn("left", 4000, 4000)
    chip.turn("right", -4000, 4000)
    chip.run(0.1)
    chip.command(LinkCommand.RESET_COUNTS)
    chip.run(0.005)
    left, right = chip.pulses()
    chip.rest()
    counts = last(chip)
    assert counts[0] == pytest.approx(1000 - left, abs=25)
    assert counts[1] == pytest.approx(-1000 - right, abs=25)


def test_counts_are_wider_than_two_bytes_on_both_sides_of_zero(chip: Chip) -> None:
    chip.turn("left", -4 * 70_000, 20_000)
    chip.turn("right", 4 * 70_000, 20_000)
    chip.rest()
    frames = chip.counts()
    assert frames[-1][2:] == (-70_000, 70_000)
    assert np.all(np.diff([frame.left for frame in frames]) <= 0)
