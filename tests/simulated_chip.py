"""The controller's program on a simulated ATmega8, steered from a test: see firmware/simulation/main.c."""

from __future__ import annotations

import subprocess
from pathlib import Path
from types import TracebackType
from typing import NamedTuple

from wheelsight.devices.protocol import Ack, Command, Counts, FrameDecoder, Message, Version, encode_command

CHIP_HZ = 14_745_600
FASTEST_PULSES_PER_S = 7833  # a motor of Trinh et al.: 4700 rpm, 100 pulses a turn
WATCHDOG_RESET = 1 << 3  # of the flags told with the version

Sent = list[tuple[int, int]]


class Reading(NamedTuple):
    """A PWM output: whether the chip drives it, whole periods seen, share of the time high, and frequency."""

    is_driven: bool
    periods: int
    duty: float
    hz: float


class Chip:
    """A running chip. Its time stands still but for `run`, `rest` and `live`.

    Args:
        simulator, program: what the Makefiles of firmware/ built.
    """

    def __init__(self, simulator: Path, program: Path) -> None:
        self._process = subprocess.Popen(
            [simulator, program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        self._decoder = FrameDecoder()
        self._sequence = 0

    def __enter__(self) -> Chip:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.communicate(timeout=10)

    def ask(self, command: str) -> list[str]:
        """The words of the answer to a command of the simulator."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(command + "\n")
        self._process.stdin.flush()
        status, *words = self._process.stdout.readline().split() or ["the simulator has ended"]
        assert status == "ok", f"{command[:60]}: {' '.join([status, *words])}"
        return words

    def run(self, seconds: float) -> None:
        self.ask(f"run {seconds:.9f}")

    def rest(self) -> None:
        """Run until both wheels have done what they were told, and a frame after that has been sent."""
        self.ask("rest")
        self.run(0.05)

    def turn(self, wheel: str, quarters: int, pulses_per_s: float) -> None:
        self.ask(f"turn {wheel} {quarters} {pulses_per_s!r}")

    def pulses(self) -> tuple[int, int]:
        """The truth: pulses of the left and right wheel, one for each place where A rises going forward."""
        left, right = map(int, self.ask("position"))
        return -(-left // 4), -(-right // 4)

    def send(self, data: bytes) -> None:
        self.ask(f"send {data.hex()}")

    def command(self, command: int, body: bytes = b"") -> int:
        """Send a command's frame; its sequence."""
        self._sequence = (self._sequence + 1) & 0xFF
        self.send(encode_command(command, self._sequence, body))  # type: ignore[arg-type]
        return self._sequence

    def sent(self) -> Sent:
        """The bytes that the chip has sent since last asked, each with the cycle at which it began."""
        return [(int(cycle), int(byte, 16)) for cycle, byte in (word.split(":") for word in self.ask("take"))]

    def messages(self) -> list[Message]:
        return self._decoder.feed(bytes(byte for _, byte in self.sent()))

    def counts(self) -> list[Counts]:
        return [message for message in self.messages() if isinstance(message, Counts)]

    def acks(self) -> list[Ack]:
        return [message for message in self.messages() if isinstance(message, Ack)]

    def version(self) -> Version:
        self.command(Command.GET_VERSION)
        self.run(0.01)
        (version,) = (message for message in self.messages() if isinstance(message, Version))
        return version

    @property
    def lost_frames(self) -> int:
        return self._decoder.statistics.lost + self._decoder.statistics.malformed + self._decoder.statistics.crc_errors

    def pwm(self, seconds: float = 0.01) -> tuple[Reading, Reading]:
        """The left and right output, measured for so long from now on."""
        self.ask("pwm")
        self.run(seconds)
        return self.pwm_until_now()

    def pwm_until_now(self) -> tuple[Reading, Reading]:
        """The left and right output since last asked."""
        words = self.ask("pwm")
        left, right = (
            Reading(driven == "1", int(periods), float(duty), float(hz))
            for driven, periods, duty, hz in (words[:4], words[4:])
        )
        return left, right

    def duties(self) -> tuple[float, float]:
        """Both outputs in permille of the command: -1000 at 0 V, 0 at half scale, 1000 at full scale."""
        left, right = self.pwm()
        return 2000 * left.duty - 1000, 2000 * right.duty - 1000
