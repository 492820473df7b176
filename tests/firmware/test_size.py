from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from firmware.simulation.simulated_chip import FASTEST_PULSES_PER_S, Chip
from wheelsight.io.devices.wire_formats import LinkCommand, drive_body

FLASH, RAM = 8192, 1024


def test_the_build_prints_a_size_that_leaves_room(built: Path) -> None:
    size = (built / "size.txt").read_text()
    flash = int(re.search(r"Program:\s+(\d+) bytes", size)[1])  # type: ignore[index]
    ram = int(re.search(r"Data:\s+(\d+) bytes", size)[1])  # type: ignore[index]
    assert 0 < flash < FLASH // 2
    assert 0 < ram < RAM // 2


def test_the_stack_stays_far_from_the_data(chip: Chip, rng: np.random.Generator) -> None:
    for wheel in ("left", "right"):
        chip.turn(wheel, 4 * FASTEST_PULSES_PER_S, FASTEST_PULSES_PER_S)
    for _ in range(50):
        chip.command(LinkCommand.DRIVE, drive_body(0.5, -0.5))
        chip.send(rng.bytes(20))
        chip.run(0.02)
    (untouched,) = map(int, chip.ask("memory"))
    assert RAM // 2 < untouched < RAM
