"""The STM32F407's peripherals that the controller's program uses, as far as it uses them, after ST's manual RM0090.

A register that the program sets wrongly has its consequence: a peripheral without a clock keeps nothing, a pin that was
not given to a timer brings it no edges, a wrong divider makes noise of the line, and what is unknown here raises.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from firmware.simulation.stm32_usb import UsbCore

CORE_HZ = 168_000_000
HSE_HZ = 8_000_000
LSI_HZ = 32_000  # of the watchdog; 17 000 to 47 000 on real chips
BAUD = 115_200

RCC, FLASH, IWDG, DMA1, USART2 = 0x40023800, 0x40023C00, 0x40003000, 0x40026000, 0x40004400
TIM1, TIM2, TIM3, TIM5 = 0x40010000, 0x40000000, 0x40000400, 0x40000C00
USB = 0x50000000
GPIOA, GPIOB, GPIOD, GPIOE = 0x40020000, 0x40020400, 0x40020C00, 0x40021000
_RCC_CR, _PLLCFGR, _CFGR, _AHB1ENR, _AHB2ENR, _APB1ENR, _APB2ENR, _CSR = (
    RCC + at for at in (0, 4, 8, 0x30, 0x34, 0x40, 0x44, 0x74)
)
_STREAM5 = DMA1 + 0x10 + 5 * 0x18
# Which bit of which register gives a peripheral its clock.
_CLOCKS = {
    GPIOA: (_AHB1ENR, 0),
    GPIOB: (_AHB1ENR, 1),
    GPIOD: (_AHB1ENR, 3),
    GPIOE: (_AHB1ENR, 4),
    DMA1: (_AHB1ENR, 21),
    TIM2: (_APB1ENR, 0),
    TIM3: (_APB1ENR, 1),
    TIM5: (_APB1ENR, 3),
    USART2: (_APB1ENR, 17),
    USB: (_AHB2ENR, 7),
    TIM1: (_APB2ENR, 0),
}
_PING_DELAY_S = 450e-6  # from the trigger to a ranger's pulse
_ALWAYS = (RCC, FLASH, IWDG)
_CSR_POWER_ON, _CSR_WATCHDOG, _CSR_PIN = 0b1110 << 24, 1 << 29, 1 << 26
# Of the filter's sixteen codes, clocks of the timer that a level must last: samples by their divider.
_FILTER_CLOCKS = (1, 2, 4, 8, 12, 16, 24, 32, 48, 64, 80, 96, 128, 160, 192, 256)


class UnknownAccessError(Exception):
    """The program uses what this simulation does not know."""


@dataclass
class Wheel:
    """An encoder: quadrature counts, four a line, at a rate from one place to the next."""

    position: int = 0
    turns: deque[tuple[int, float]] = field(default_factory=deque)
    since_s: float = 0.0

    def turn(self, counts: int, counts_per_s: float, now_s: float) -> None:
        """Turn by so many counts, after what it was told before."""
        if not self.turns:
            self.since_s = now_s
        self.turns.append((counts, counts_per_s))

    def move(self, now_s: float, shortest_level_s: float) -> int:
        """Go where it is at a time; the counts on the way that a filter of so long lets through."""
        seen = 0
        while self.turns:
            counts, rate = self.turns[0]
            done = min(abs(counts), int((now_s - self.since_s) * rate))
            step = done if counts > 0 else -done
            self.position += step
            if 2 / rate > shortest_level_s:  # a channel's level lasts for two counts
                seen += step
            self.since_s += done / rate
            if done < abs(counts):
                self.turns[0] = (counts - step, rate)
                break
            self.turns.popleft()
        return seen


@dataclass
class Encoder:
    """A timer in encoder mode: which pins and which width it has."""

    timer: int
    bits: int
    pins: tuple[tuple[int, int], tuple[int, int]]
    function: int
    wheel: Wheel = field(default_factory=Wheel)
    count: int = 0


class Peripherals:
    """All of them, at the chip's time `cycle`, of `CORE_HZ` a second.

    Args:
        write_memory: puts a byte into the chip's memory, as the DMA does.
        has_crystal: whether one is soldered in.

    Attributes:
        cycle: now.
        usb: the USB core.
        sent: bytes on the line from the chip, each with the second at which it began.
        is_bitten: whether the watchdog has just bitten.
        garbled: bytes that the wrong baud rate made noise, or that were lost for another reason.
        longest_unread_s: for which the program did not look at the encoder of 16 bits.
        echoes_s: length of each ranger's pulse after a ping; 0 for one without power.
        is_pressed: of each bumper, whose switch opens when pressed.
    """

    def __init__(self, write_memory: Callable[[int, int], None], has_crystal: bool = True) -> None:
        self.cycle = 0
        self.sent: list[tuple[float, int]] = []
        self.garbled = 0
        self.longest_unread_s = 0.0
        self.echoes_s, self.is_pressed = [0.0] * 4, [False] * 2
        self._trigger_s, self._pinged_s = math.inf, -math.inf
        self.encoders = {
            "left": Encoder(TIM2, 32, ((GPIOA, 15), (GPIOB, 3)), 1),
            "right": Encoder(TIM3, 16, ((GPIOB, 4), (GPIOB, 5)), 2),
        }
        self.usb = UsbCore(lambda: all(self._has_pin(GPIOA, pin, 10) for pin in (11, 12)))
        self._write_memory, self._has_crystal = write_memory, has_crystal
        self._coming: deque[tuple[float, int]] = deque()
        self._line_free_s = 0.0
        self.reset(_CSR_POWER_ON)

    @property
    def now_s(self) -> float:
        """Seconds since power came on."""
        return self.cycle / CORE_HZ

    def reset(self, cause: int = _CSR_PIN) -> None:
        """All registers as after a reset; wheels and what is on the line stay as they are."""
        self._registers: dict[int, int] = {_CSR: cause, TIM1 + 0x2C: 0xFFFF, IWDG + 8: 0xFFF}
        self._registers |= {TIM3 + 0x2C: 0xFFFF, TIM2 + 0x2C: 0xFFFFFFFF, TIM5 + 0x2C: 0xFFFFFFFF}
        self.usb.reset()
        self.is_bitten, self._is_watched, self._is_unlocked, self._bites_s = False, False, False, 0.0
        self._clock_zero_s, self._ring = self.now_s, 0
        self._wiring: dict[str, tuple[bool, float]] = {}  # of each encoder: whether it counts, and its filter
        self._looked_s = self.now_s
        for encoder in self.encoders.values():
            encoder.count = 0

    def bite(self) -> None:
        """Reset by the watchdog."""
        self.reset(_CSR_WATCHDOG | _CSR_PIN)

    def receive(self, data: bytes) -> None:
        """Put bytes on the line to the chip, one after the other."""
        begins_s = max(self.now_s, self._coming[-1][0] if self._coming else 0.0)
        self._coming += [(begins_s + 10 * (n + 1) / BAUD, byte) for n, byte in enumerate(data)]

    def advance(self, cycles: int) -> None:
        """Let the time pass: wheels turn, bytes arrive, the watchdog may bite."""
        self.cycle += cycles
        for name, encoder in self.encoders.items():
            if name not in self._wiring:
                self._wiring[name] = self._counts(encoder), self._filter_s(encoder)
            is_counted, filter_s = self._wiring[name]
            seen = encoder.wheel.move(self.now_s, filter_s)
            encoder.count = (encoder.count + is_counted * seen) % (1 << encoder.bits)
        while self._coming and self._coming[0][0] <= self.now_s:
            self._deliver(self._coming.popleft()[1])
        self.is_bitten |= self._is_watched and self.now_s > self._bites_s

    def read(self, address: int) -> int:
        """What the program reads there."""
        if not self._is_clocked(address):
            return 0
        if address >= USB:
            return self.usb.read(address - USB)
        value = self._registers.get(address, 0)
        if address == _RCC_CR:
            return value | (value & 1 << 16 and self._has_crystal) << 17 | (value & 1 << 24) << 1
        if address == _CFGR:
            return value | (value & 3) << 2
        if address == TIM5 + 0x24:
            return self._microseconds()
        for encoder in self.encoders.values():
            if address == encoder.timer + 0x24:
                self._note_look(encoder)
                return encoder.count
        if address == GPIOD + 0x10:
            return self._nearby_levels()
        if address == USART2:
            is_free = self.now_s >= self._line_free_s - self._byte_s()
            return 0x40 | is_free << 7
        return value

    def _note_look(self, encoder: Encoder) -> None:
        if encoder.bits == 16:
            self.longest_unread_s = max(self.longest_unread_s, self.now_s - self._looked_s)
            self._looked_s = self.now_s

    def _nearby_levels(self) -> int:
        """Levels of echoes (pins 0 to 3) and bumpers (6, 7) of port D; open ends are high by the pull-ups alone."""
        since_s, levels = self.now_s - self._pinged_s - _PING_DELAY_S, 0
        for pin, length_s in enumerate(self.echoes_s):
            levels |= (0 <= since_s < length_s if length_s else self._is_pulled_up(pin)) << pin
        for number, is_open in enumerate(self.is_pressed):
            levels |= (is_open and self._is_pulled_up(6 + number)) << 6 + number
        return levels

    def _is_pulled_up(self, pin: int) -> bool:
        return self._registers.get(GPIOD + 0xC, 0) >> 2 * pin & 3 == 1

    def _trigger(self, bits: int) -> None:
        """Port D's bits are set and reset: the trigger (pin 8) must be an output, and high for 10 µs."""
        if bits & 1 << 8:
            self._trigger_s = self.now_s
        elif bits & 1 << 24:
            is_output = self._registers.get(GPIOD, 0) >> 16 & 3 == 1
            if is_output and self.now_s - self._trigger_s >= 10e-6:
                self._pinged_s = self.now_s
            self._trigger_s = math.inf

    def write(self, address: int, value: int) -> None:
        """What the program writes there."""
        if not self._is_clocked(address):
            return
        if address >= USB:
            self.usb.write(address - USB, value)
        elif address & ~0x3FF == IWDG:
            self._watch(address - IWDG, value)
        elif address == _CSR:
            self._registers[_CSR] = 0 if value & 1 << 24 else self._registers[_CSR]
        elif address == USART2 + 4:
            self._send(value & 0xFF)
        elif address == GPIOD + 0x18:
            self._trigger(value)
        else:
            if address in (TIM2 + 0x24, TIM3 + 0x24, TIM5 + 0x24):
                raise UnknownAccessError(f"a count is written, at {address:#x}")
            self._registers[address] = value
            self._wiring.clear()
            if address == _STREAM5 + 4:
                self._ring = value
            if address == TIM5 + 0x14:
                self._clock_zero_s = self.now_s

    def pwm(self) -> tuple[float, float] | None:
        """The share of the time that the left and right motor's pin is high; None where they are not driven."""
        get = self._registers.get
        is_on = get(TIM1, 0) & 1 and get(TIM1 + 0x44, 0) & 1 << 15 and get(TIM1 + 0x20, 0) & 0x11 == 0x11
        if not is_on or get(TIM1 + 0x18, 0) & 0x7070 != 0x6060:
            return None
        if not all(self._has_pin(GPIOE, pin, 1) for pin in (9, 11)):
            return None
        steps = get(TIM1 + 0x2C, 0) + 1
        left, right = (min(get(TIM1 + at, 0), steps) / steps for at in (0x34, 0x38))
        return left, right

    def pwm_hz(self) -> float:
        """How often a period of both outputs begins, a second."""
        prescaler, top = self._registers.get(TIM1 + 0x28, 0), self._registers.get(TIM1 + 0x2C, 0)
        return self._timer_hz(13) / (prescaler + 1) / (top + 1)

    def filter_s(self, wheel: str) -> float:
        """How long a level of an encoder's channel must last to be seen."""
        return self._filter_s(self.encoders[wheel])

    def _is_clocked(self, address: int) -> bool:
        base = address & ~0x3FF if address < USB else USB
        if base in _ALWAYS:
            return True
        if base not in _CLOCKS:
            raise UnknownAccessError(f"no peripheral is known at {address:#x}")
        register, bit = _CLOCKS[base]
        return bool(self._registers.get(register, 0) & 1 << bit)

    def _core_hz(self) -> float:
        if self._registers.get(_CFGR, 0) & 3 != 2:
            return 16e6
        pll = self._registers.get(_PLLCFGR, 0)
        source_hz = HSE_HZ if pll & 1 << 22 else 16e6
        return source_hz / (pll & 63) * (pll >> 6 & 511) / (2 * (pll >> 16 & 3) + 2)

    def _bus_divider(self, shift: int) -> int:
        code = self._registers.get(_CFGR, 0) >> shift & 7
        return 1 if code < 4 else 2 << (code & 3)

    def _timer_hz(self, shift: int) -> float:
        divider = self._bus_divider(shift)
        return self._core_hz() / divider * (2 if divider > 1 else 1)

    def _microseconds(self) -> int:
        """TIM5's count, which is of microseconds where its divider is right."""
        if not self._registers.get(TIM5, 0) & 1:
            return 0
        hz = self._timer_hz(10) / (self._registers.get(TIM5 + 0x28, 0) + 1)
        return int((self.now_s - self._clock_zero_s) * hz) & 0xFFFFFFFF

    def _has_pin(self, port: int, pin: int, function: int) -> bool:
        mode = self._registers.get(port, 0) >> 2 * pin & 3
        given = self._registers.get(port + 0x20 + 4 * (pin // 8), 0) >> pin % 8 * 4 & 15
        return mode == 2 and given == function

    def _counts(self, encoder: Encoder) -> bool:
        get, timer = self._registers.get, encoder.timer
        is_on = get(timer, 0) & 1 and get(timer + 8, 0) & 7 == 3 and get(timer + 0x18, 0) & 0x0303 == 0x0101
        is_plain = (
            get(timer + 0x20, 0) == 0 and get(timer + 0x28, 0) == 0 and get(timer + 0x2C, 0) == (1 << encoder.bits) - 1
        )
        return bool(is_on and is_plain) and all(self._has_pin(*pin, encoder.function) for pin in encoder.pins)

    def _filter_s(self, encoder: Encoder) -> float:
        codes = self._registers.get(encoder.timer + 0x18, 0)
        return _FILTER_CLOCKS[max(codes >> 4 & 15, codes >> 12 & 15)] / self._timer_hz(10)

    def _byte_s(self) -> float:
        return 10 * max(self._registers.get(USART2 + 8, 0), 16) / (self._core_hz() / self._bus_divider(10))

    def _line_works(self, enables: int, pin: int) -> bool:
        control = self._registers.get(USART2 + 0xC, 0)
        is_on = control & enables == enables and not control & ~0x200C
        return is_on and abs(self._byte_s() * BAUD / 10 - 1) < 0.02 and self._has_pin(GPIOA, pin, 7)

    def _send(self, byte: int) -> None:
        if self.now_s < self._line_free_s - self._byte_s():
            raise UnknownAccessError("a byte is sent before the last has gone")
        begins_s = max(self.now_s, self._line_free_s)
        self._line_free_s = begins_s + self._byte_s()
        if self._line_works(0x2008, 2):
            self.sent.append((begins_s, byte))
        else:
            self.garbled += 1

    def _deliver(self, byte: int) -> None:
        """A byte has arrived: the DMA takes it into memory."""
        get = self._registers.get
        control, left = get(_STREAM5, 0), get(_STREAM5 + 4, 0)
        is_taken = self._line_works(0x2004, 3) and get(USART2 + 0x14, 0) & 1 << 6 and get(_STREAM5 + 8, 0) == USART2 + 4
        if not is_taken or control != 4 << 25 | 1 << 10 | 1 << 8 | 1 or not self._is_clocked(DMA1) or not left:
            self.garbled += 1
            return
        self._write_memory(get(_STREAM5 + 12, 0) + self._ring - left, byte)
        self._registers[_STREAM5 + 4] = left - 1 or self._ring

    def _watch(self, at: int, value: int) -> None:
        if at == 0:
            self._is_watched |= value == 0xCCCC
            self._is_unlocked = value == 0x5555
            if value in (0xCCCC, 0xAAAA):
                divider = 4 << self._registers.get(IWDG + 4, 0)
                self._bites_s = self.now_s + divider * (self._registers[IWDG + 8] + 1) / LSI_HZ
        elif self._is_unlocked:
            self._registers[IWDG + at] = value
