"""The controller's program for the STM32F4 Discovery on a simulated processor (unicorn), with the chip's peripherals.

The processor is slower here than the real one, so that a test ends soon and nothing that passes depends on its speed:
it does `INSTRUCTIONS` in each slice of `SLICE_S`, 2.5 million a second, where the real one does 168 million at best.
"""

from __future__ import annotations

import os
import shutil
import tty
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from types import TracebackType
from typing import Any

from firmware.simulation.framed_chip import FramedChip
from firmware.simulation.stm32_peripherals import CORE_HZ, Peripherals

FLASH_BEGIN, FLASH_SIZE = 0x08000000, 1 << 20
RAM_BEGIN, RAM_SIZE = 0x20000000, 128 << 10
DATA_SIZE = 4096  # more than the program's data take
IO_BEGIN, IO_SIZE = 0x40000000, 0x40000
USB_BEGIN, USB_SIZE = 0x50000000, 0x40000
UNIQUE_ID = 0x1FFF7A10
SERIAL_NUMBER = bytes(range(0x31, 0x3D))
SLICE_S, INSTRUCTIONS = 40e-6, 100
_GARBAGE = b"\xa5"
_ENDLESS_LOOP = b"\xfe\xe7"  # b .


def missing_stm32_tools() -> list[str]:
    """What is not installed of what building and running need; on Debian: gcc-arm-none-eabi; by pip: unicorn."""
    tools = ("make", "arm-none-eabi-gcc", "arm-none-eabi-size")
    missing = [tool for tool in tools if shutil.which(tool) is None]
    return missing if find_spec("unicorn") is not None else [*missing, "unicorn"]


class Stm32(FramedChip):
    """A running chip. Its time stands still but for `run`, `rest` and `serve`.

    Args:
        program: controller.bin, as its Makefile built it.
        has_crystal: whether one is soldered in.
        slice_s: time that `INSTRUCTIONS` take; longer ones let a long time pass sooner.

    Attributes:
        resets: how often the watchdog has bitten.
    """

    def __init__(self, program: Path, has_crystal: bool = True, slice_s: float = SLICE_S) -> None:
        import unicorn
        from unicorn.arm_const import UC_ARM_REG_PC, UC_ARM_REG_SP

        super().__init__()
        self._pc, self._sp = UC_ARM_REG_PC, UC_ARM_REG_SP
        self._processor: Any = unicorn.Uc(unicorn.UC_ARCH_ARM, unicorn.UC_MODE_THUMB | unicorn.UC_MODE_MCLASS)
        self._processor.mem_map(FLASH_BEGIN, FLASH_SIZE)
        self._processor.mem_map(RAM_BEGIN, RAM_SIZE)
        self._processor.mem_map(UNIQUE_ID & ~0xFFF, 0x1000)
        self._processor.mem_write(UNIQUE_ID, SERIAL_NUMBER)
        for begin, size in ((IO_BEGIN, IO_SIZE), (USB_BEGIN, USB_SIZE)):
            self._processor.mmio_map(begin, size, self._read, begin, self._write, begin)
        self._processor.mem_write(FLASH_BEGIN, program.read_bytes())
        self.peripherals = Peripherals(self._write_memory, has_crystal)
        self.resets, self._cycles = 0, round(slice_s * CORE_HZ)
        self._problem: Exception | None = None
        self._terminal: tuple[int, int] | None = None
        self._processor.mem_write(RAM_BEGIN, _GARBAGE * RAM_SIZE)
        self._boot()

    def __enter__(self) -> Stm32:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for end in self._terminal or ():
            os.close(end)

    def run(self, seconds: float) -> None:
        """Let the chip's time pass."""
        ends = self.peripherals.cycle + round(seconds * CORE_HZ)
        while self.peripherals.cycle < ends:
            self._slice()

    def rest(self) -> None:
        """Run until both wheels have done what they were told, and a frame after that has been sent."""
        while any(encoder.wheel.turns for encoder in self.peripherals.encoders.values()):
            self._slice()
        self.run(0.05)

    def turn(self, wheel: str, counts: int, counts_per_s: float) -> None:
        """Turn a wheel, `left` or `right`, by counts, four a line of its encoder, after what it was told before."""
        self.peripherals.encoders[wheel].wheel.turn(counts, counts_per_s, self.peripherals.now_s)

    def positions(self) -> tuple[int, int]:
        """The truth: counts of the left and the right wheel since power came on."""
        return self.peripherals.encoders["left"].wheel.position, self.peripherals.encoders["right"].wheel.position

    def echo(self, ranger: int, seconds: float) -> None:
        """From the next ping on a ranger's pulse lasts so long; 0 for one without power, as at the start."""
        self.peripherals.echoes_s[ranger] = seconds

    def bumper(self, number: int, is_pressed: bool) -> None:
        """Press a bumper, whose switch then opens, or let it go."""
        self.peripherals.is_pressed[number] = is_pressed

    def send(self, data: bytes) -> None:
        """Put bytes on the line to the chip, at its pace."""
        self.peripherals.receive(data)

    def sent(self) -> list[tuple[float, int]]:
        """The bytes that the chip has sent since last asked, each with the second at which it began."""
        sent, self.peripherals.sent = self.peripherals.sent, []
        return sent

    def duties(self) -> tuple[float, float] | None:
        """Both outputs in permille of the command, -1000 low to 1000 high; None where the pins are not driven."""
        shares = self.peripherals.pwm()
        return None if shares is None else (2000 * shares[0] - 1000, 2000 * shares[1] - 1000)

    def reset(self) -> None:
        """Press the button: registers begin anew, memory stays."""
        self.peripherals.reset()
        self._boot()

    def hang(self) -> None:
        """The program loops for ever from now on, until it is started anew."""
        at = FLASH_BEGIN + FLASH_SIZE - 2
        self._processor.mem_write(at, _ENDLESS_LOOP)
        self._processor.reg_write(self._pc, at | 1)

    def terminal(self) -> str:
        """From now on the chip's line is a pseudo-terminal; its path."""
        self._terminal = os.openpty()
        tty.setraw(self._terminal[1])
        os.set_blocking(self._terminal[0], False)
        return os.ttyname(self._terminal[1])

    def serve(self, seconds: float) -> None:
        """Let the time pass, with what programs say and hear on the pseudo-terminal."""
        assert self._terminal is not None
        with suppress(BlockingIOError):
            self.send(os.read(self._terminal[0], 256))
        self.run(seconds)
        data = bytes(byte for _, byte in self.sent())
        with suppress(BlockingIOError):  # nobody reads; a line does not wait
            os.write(self._terminal[0], data)

    def poke(self, address: int, word: int) -> None:
        """Put four bytes into memory behind the program's back."""
        self._processor.mem_write(address, (word & 0xFFFFFFFF).to_bytes(4, "little"))

    def stack_used(self) -> int:
        """Bytes from the end of memory that were ever written, its first kilobytes aside, where the data are."""
        memory = bytes(self._processor.mem_read(RAM_BEGIN + DATA_SIZE, RAM_SIZE - DATA_SIZE))
        return len(memory.lstrip(_GARBAGE))

    def _boot(self) -> None:
        vectors = bytes(self._processor.mem_read(FLASH_BEGIN, 8))
        self._processor.reg_write(self._sp, int.from_bytes(vectors[:4], "little"))
        self._processor.reg_write(self._pc, int.from_bytes(vectors[4:], "little"))

    def _slice(self) -> None:
        at = self._processor.reg_read(self._pc)
        self._processor.emu_start(at | 1, 0, count=INSTRUCTIONS)
        if self._problem is not None:
            raise self._problem
        self.peripherals.advance(self._cycles)
        if self.peripherals.is_bitten:
            self.resets += 1
            self.peripherals.bite()
            self._boot()

    def _read(self, processor: Any, offset: int, size: int, begin: int) -> int:
        try:
            return self.peripherals.read(begin + offset)
        except Exception as error:
            self._stop(error)
            return 0

    def _write(self, processor: Any, offset: int, size: int, value: int, begin: int) -> None:
        try:
            self.peripherals.write(begin + offset, value)
        except Exception as error:
            self._stop(error)

    def _stop(self, error: Exception) -> None:
        """An error in a call from the processor would be lost there: it is raised after it."""
        self._problem = self._problem or error
        self._processor.emu_stop()

    def _write_memory(self, address: int, byte: int) -> None:
        self._processor.mem_write(address, bytes([byte]))
