"""The controller's program on a simulated ATmega8, for tests and benchmarks: building it, and steering it (main.c)."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import NamedTuple

from firmware.simulation.framed_chip import FramedChip
from wheelsight.io.devices.wire_formats import LinkCommand, drive_body

FIRMWARE = Path(__file__).resolve().parents[1]
CHIP_HZ = 14_745_600
FASTEST_PULSES_PER_S = 7833  # a motor of Trinh et al.: 4700 rpm, 100 pulses a turn
WATCHDOG_RESET = 1 << 3  # of the flags told with the version

Sent = list[tuple[int, int]]


class BuildError(Exception):
    """The compiler refused; the message is what make said."""


def missing_tools() -> list[str]:
    """What is not installed of what building and running need; on Debian: gcc-avr, avr-libc, libsimavr-dev, gcc."""
    missing = [tool for tool in ("make", "cc", "avr-gcc", "avr-size") if shutil.which(tool) is None]
    return missing if Path("/usr/include/simavr/sim_avr.h").is_file() else [*missing, "libsimavr"]


def build(part: str, folder: Path, *settings: str) -> str:
    """What make says when it builds a part of firmware/, `atmega8` or `simulation`, in a folder. Raises BuildError."""
    command = ["make", "-C", str(FIRMWARE / part), f"BUILD={folder}", *settings]
    made = subprocess.run(command, capture_output=True, text=True, check=False)
    if made.returncode != 0:
        raise BuildError(made.stdout + made.stderr)
    return made.stdout


class Reading(NamedTuple):
    """A PWM output: whether the chip drives it, whole periods seen, share of the time high, and frequency."""

    is_driven: bool
    periods: int
    duty: float
    hz: float


def sent_of(words: Sequence[str]) -> Sent:
    """The bytes of an answer to `take`."""
    return [(int(cycle), int(byte, 16)) for cycle, byte in (word.split(":") for word in words)]


def outputs_of(words: Sequence[str]) -> tuple[Reading, Reading]:
    """Both outputs of an answer to `pwm`."""
    left, right = (
        Reading(driven == "1", int(periods), float(duty), float(hz))
        for driven, periods, duty, hz in (words[:4], words[4:])
    )
    return left, right


class Chip(FramedChip):
    """A running chip. Its time stands still but for `run`, `rest` and `live`.

    Args:
        simulator, program: what the Makefiles of firmware/ built.
    """

    def __init__(self, simulator: Path, program: Path) -> None:
        super().__init__()
        self._process = subprocess.Popen(
            [simulator, program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )

    def __enter__(self) -> Chip:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.communicate(timeout=10)

    def ask(self, command: str) -> list[str]:
        """The words of the answer to a command of the simulator."""
        (words,) = self.ask_all([command])
        return words

    def ask_all(self, commands: Sequence[str]) -> list[list[str]]:
        """The words of the answers to commands that are sent together, which takes less time."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write("".join(f"{command}\n" for command in commands))
        self._process.stdin.flush()
        answers = []
        for command in commands:
            status, *words = self._process.stdout.readline().split() or ["the simulator has ended"]
            assert status == "ok", f"{command[:60]}: {' '.join([status, *words])}"
            answers.append(words)
        return answers

    def run(self, seconds: float) -> None:
        """Let the chip's time pass."""
        self.ask(f"run {seconds:.9f}")

    def rest(self) -> None:
        """Run until both wheels have done what they were told, and a frame after that has been sent."""
        self.ask("rest")
        self.run(0.05)

    def turn(self, wheel: str, quarters: int, pulses_per_s: float) -> None:
        """Turn a wheel, `left` or `right`, by quarters of a pulse, after what it was told before."""
        self.ask(f"turn {wheel} {quarters} {pulses_per_s!r}")

    def pulses(self) -> tuple[int, int]:
        """The truth: pulses of the left and right wheel, one for each place where A rises going forward."""
        left, right = map(int, self.ask("position"))
        return -(-left // 4), -(-right // 4)

    def echo(self, ranger: int, seconds: float) -> None:
        """From the next ping on a ranger's pulse lasts so long; 0 for one without power, as at the start."""
        self.ask(f"echo {ranger} {round(1e6 * seconds)}")

    def bumper(self, number: int, is_pressed: bool) -> None:
        """Press a bumper, whose switch then opens, or let it go."""
        self.ask(f"bumper {number} {int(is_pressed)}")

    def send(self, data: bytes) -> None:
        """Put bytes on the line to the chip, at its pace."""
        self.ask(f"send {data.hex()}")

    def sent(self) -> Sent:
        """The bytes that the chip has sent since last asked, each with the cycle at which it began."""
        return sent_of(self.ask("take"))

    def pwm(self, seconds: float = 0.01) -> tuple[Reading, Reading]:
        """The left and right output, measured for so long from now on."""
        self.ask("pwm")
        self.run(seconds)
        return self.pwm_until_now()

    def pwm_until_now(self) -> tuple[Reading, Reading]:
        """The left and right output since last asked."""
        return outputs_of(self.ask("pwm"))

    def duties(self) -> tuple[float, float]:
        """Both outputs in permille of the command: -1000 at 0 V, 0 at half scale, 1000 at full scale."""
        left, right = self.pwm()
        return 2000 * left.duty - 1000, 2000 * right.duty - 1000


def is_exact_at(simulator: Path, program: Path, pulses_per_s: float) -> bool:
    """Whether no pulse is lost in a second of both wheels at this rate, in opposite directions and then reversed.

    The host commands all the while.
    """
    with Chip(simulator, program) as chip:
        chip.run(0.05)
        for direction in (1, -2):
            chip.turn("left", round(direction * 2 * pulses_per_s), pulses_per_s)
            chip.turn("right", round(-direction * 2 * pulses_per_s), 1.00137 * pulses_per_s)
        for _ in range(75):
            chip.command(LinkCommand.DRIVE, drive_body(1, -1))
            chip.run(0.02)
        chip.rest()
        return chip.counts()[-1][2:] == chip.pulses()


def highest_exact_rate(simulator: Path, program: Path, step: int = 500) -> int:
    """The highest rate in pulses a second, in steps, up to which no pulse is lost; from the paper's fastest on."""
    rate = FASTEST_PULSES_PER_S // step * step
    while is_exact_at(simulator, program, rate + step):
        rate += step
    return rate
