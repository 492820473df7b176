"""What the wheel controller's program takes of the chip, and how fast wheels it counts, on the simulated one."""

from __future__ import annotations

import re
import tempfile
from dataclasses import dataclass
from pathlib import Path

from firmware.simulation.simulated_chip import build, highest_exact_rate, missing_tools


@dataclass(frozen=True, slots=True)
class FirmwareFigures:
    """What was measured; None where the tools are missing.

    Attributes:
        flash_bytes, ram_bytes: of the program, without its stack.
        pulses_per_s: the highest rate, in steps of 500, of both wheels at once before a count was lost.
        missing: what is not installed.
    """

    flash_bytes: int | None = None
    ram_bytes: int | None = None
    pulses_per_s: int | None = None
    missing: tuple[str, ...] = ()


def measure_firmware() -> FirmwareFigures:
    """Build the program and drive it faster and faster; takes about a minute. Raises BuildError."""
    if missing := missing_tools():
        return FirmwareFigures(missing=tuple(missing))
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        build("simulation", folder)
        said = build("atmega8", folder)
        rate = highest_exact_rate(folder / "chip", folder / "controller.elf")
    return FirmwareFigures(_bytes(said, "Program"), _bytes(said, "Data"), rate)


def _bytes(said: str, what: str) -> int:
    found = re.search(rf"{what}:\s+(\d+) bytes", said)
    if found is None:
        raise ValueError(f"avr-size does not tell of {what}")
    return int(found[1])
