"""`AvrBoard` and `Stm32Board`: the simulated chips as parts of a simulated robot, advanced in short steps."""

from __future__ import annotations

import atexit
import shutil
import tempfile
from functools import cache
from pathlib import Path
from typing import Protocol

from firmware.simulation.simulated_chip import CHIP_HZ, Chip, build, missing_tools, outputs_of, sent_of
from firmware.simulation.simulated_stm32 import Stm32, missing_stm32_tools
from wheelsight.core.errors import ConfigError

Pair = tuple[int, int]
Duties = tuple[float, float]

# Share of a tick within which the edges of a wheel come, so that the last one does not fall into the next tick.
_WITHIN = 0.98
# A step of `Stm32`, longer than in tests, so that a simulated second takes about one of a slow core. Beyond 0.1 ms the
# program's main loop is so slow that counts come late: 3 of 290 at 0.16 ms.
_STM32_SLICE_S = 100e-6
_POWER_UP_S = 0.1


class Board(Protocol):
    """A controller board with encoders, a line and two PWM outputs; its time passes in `advance` alone.

    Attributes:
        edges_per_tick: steps of an encoder that make one count.
    """

    edges_per_tick: int

    def advance(self, edges: Pair, seconds: float, to_chip: bytes) -> tuple[bytes, Duties | None]:
        """Turn the wheels and send bytes to the chip.

        Args:
            edges: steps of the left and the right encoder within the time.
            seconds: that pass.
            to_chip: bytes that are put on the line first.

        Returns:
            The bytes that the chip sent, and both duties from -1 to 1; None where its outputs are not driven.
        """

    def reset(self) -> None:
        """Reset the chip: its program begins again."""

    def hang(self) -> None:
        """Let the chip's program stand still; its watchdog remains."""

    def close(self) -> None:
        """End the simulation of the chip; may be called twice."""


@cache
def _built(*parts: str) -> Path:
    """A folder with parts of the firmware, compiled once a process and removed at its end. Raises BuildError."""
    folder = tempfile.mkdtemp(prefix="wheelsight-firmware-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    for part in parts:
        build(part, Path(folder))
    return Path(folder)


class AvrBoard:
    """The ATmega8 with its program. Raises BuildError where it cannot be compiled."""

    edges_per_tick = 4

    def __init__(self) -> None:
        folder = _built("simulation", "atmega8")
        self._chip = Chip(folder / "chip", folder / "controller.elf")
        self._is_open = True
        # An instruction that lasts beyond the end of a step counts for the next one.
        self._cycles = self._end = int(self._chip.ask(f"run {_POWER_UP_S}")[0])

    def advance(self, edges: Pair, seconds: float, to_chip: bytes) -> tuple[bytes, Duties | None]:
        """See `Board`."""
        asked = [f"send {to_chip.hex()}"] if to_chip else []
        asked += [
            f"turn {wheel} {count} {abs(count) / 4 / (_WITHIN * seconds)!r}"
            for wheel, count in zip(("left", "right"), edges, strict=True)
            if count
        ]
        self._end += round(seconds * CHIP_HZ)
        asked += [f"run {(self._end - self._cycles) / CHIP_HZ:.9f}", "take", "pwm"]
        *_, passed, sent, outputs = self._chip.ask_all(asked)
        self._cycles = int(passed[0])
        readings = outputs_of(outputs)
        left, right = (2 * reading.duty - 1 for reading in readings)
        is_driven = all(reading.is_driven for reading in readings)
        return bytes(byte for _, byte in sent_of(sent)), (left, right) if is_driven else None

    def reset(self) -> None:
        """See `Board`."""
        self._chip.ask("reset")

    def hang(self) -> None:
        """See `Board`."""
        self._chip.ask("hang")

    def close(self) -> None:
        """See `Board`."""
        if self._is_open:
            self._is_open = False
            self._chip.__exit__(None, None, None)


class Stm32Board:
    """The STM32F4 Discovery with its program, on its serial line. Raises BuildError where it cannot be compiled."""

    edges_per_tick = 1

    def __init__(self) -> None:
        self._chip = Stm32(_built("stm32f4") / "controller.bin", slice_s=_STM32_SLICE_S)
        self._end_s = _POWER_UP_S
        self._chip.run(self._end_s)

    def advance(self, edges: Pair, seconds: float, to_chip: bytes) -> tuple[bytes, Duties | None]:
        """See `Board`."""
        if to_chip:
            self._chip.send(to_chip)
        for wheel, count in zip(("left", "right"), edges, strict=True):
            if count:
                self._chip.turn(wheel, count, abs(count) / (_WITHIN * seconds))
        self._end_s += seconds
        self._chip.run(self._end_s - self._chip.peripherals.now_s)
        duties = self._chip.duties()
        sent = bytes(byte for _, byte in self._chip.sent())
        return sent, None if duties is None else (duties[0] / 1000, duties[1] / 1000)

    def reset(self) -> None:
        """See `Board`."""
        self._chip.reset()

    def hang(self) -> None:
        """See `Board`."""
        self._chip.hang()

    def close(self) -> None:
        """See `Board`."""
        self._chip.__exit__(None, None, None)


BOARDS: dict[str, type[AvrBoard] | type[Stm32Board]] = {"atmega8": AvrBoard, "stm32": Stm32Board}


def check_board(name: str) -> None:
    """Raise ConfigError for an unknown name, or where compilers or libraries are missing."""
    if name not in BOARDS:
        raise ConfigError(f"--hardware is {name!r}", fix=f"one of {', '.join(BOARDS)}")
    missing = missing_tools() if name == "atmega8" else missing_stm32_tools()
    if missing:
        packages = "gcc-arm-none-eabi; by pip: unicorn" if name == "stm32" else "gcc gcc-avr avr-libc libsimavr-dev"
        raise ConfigError(
            f"--hardware {name} compiles and runs the firmware, and this is missing: {', '.join(missing)}",
            fix=f"on Debian: apt-get install make {packages}",
        )
