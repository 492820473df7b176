"""The STM32F407's USB core (OTG_FS) as a full-speed device, after ST's manual RM0090, and a host to ask it things."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import partial
from typing import TypeVar

PACKET = 64
_GRSTCTL, _GINTSTS, _GRXSTSP, _DIEPTXF0, _GCCFG, _DCFG, _DCTL = 0x10, 0x14, 0x20, 0x28, 0x38, 0x800, 0x804
_RXFLVL, _USBRST, _ENUMDNE = 1 << 4, 1 << 12, 1 << 13
_STALL, _CNAK, _SNAK, _DISABLE, _ENABLE = 1 << 21, 1 << 26, 1 << 27, 1 << 30, 1 << 31
_ACTIVE, _WRITE_ONLY = 1 << 15, 0xF << 26
_DATA, _DATA_DONE, _SETUP_DONE, _SETUP = 2, 3, 4, 6
_IN, _OUT = 0x900, 0xB00

Answer = TypeVar("Answer")


class UsbError(Exception):
    """The device does what a host takes for a fault."""


@dataclass
class _Endpoint:
    """One direction of an endpoint."""

    control: int = 0
    is_enabled: bool = False
    naks: bool = True
    size: int = 0
    fifo: bytearray = field(default_factory=bytearray)

    def command(self, value: int) -> None:
        self.control = value & ~(_WRITE_ONLY | _ENABLE | _DISABLE)
        self.naks = (self.naks or bool(value & _SNAK)) and not value & _CNAK
        self.is_enabled = (self.is_enabled or bool(value & _ENABLE)) and not value & _DISABLE


class UsbCore:
    """What the program sees of it; what a host does to it are `reset_bus`, `setup`, `take` and `give`."""

    def __init__(self, has_pins: Callable[[], bool]) -> None:
        self._has_pins = has_pins
        self.reset()

    def reset(self) -> None:
        """All as after the chip's reset."""
        self._registers: dict[int, int] = {}
        self._events: deque[tuple[int, int, bytes]] = deque()
        self._reading: deque[int] = deque()
        self._flags = 0
        self._ins = [_Endpoint() for _ in range(4)]
        self._outs = [_Endpoint() for _ in range(4)]

    @property
    def is_connected(self) -> bool:
        """Whether a host sees that a device is plugged in."""
        is_on = self._registers.get(_GCCFG, 0) & 1 << 16 and not self._registers.get(_DCTL, 2) & 2
        return bool(is_on) and self._registers.get(_DCFG, 0) & 3 == 3 and self._has_pins()

    @property
    def address(self) -> int:
        """The one that the device answers to."""
        return self._registers.get(_DCFG, 0) >> 4 & 127

    def read(self, offset: int) -> int:
        """What the program reads there."""
        if offset >= 0x1000:
            return self._reading.popleft() if self._reading else 0
        if offset == _GRSTCTL:
            return 1 << 31
        if offset == _GINTSTS:
            return self._flags | (_RXFLVL if self._events else 0)
        if offset == _GRXSTSP:
            return self._pop()
        if (endpoint := self._endpoint(offset)) is not None and offset & 0x1F == 0:
            return endpoint.control | endpoint.naks << 17 | endpoint.is_enabled << 31
        return self._registers.get(offset, 0)

    def write(self, offset: int, value: int) -> None:
        """What the program writes there."""
        if offset >= 0x1000:
            self._fill(offset // 0x1000 - 1, value)
        elif offset == _GINTSTS:
            self._flags &= ~value
        elif offset == _GRSTCTL:
            self._restart(value)
        elif (endpoint := self._endpoint(offset)) is not None:
            if offset & 0x1F == 0:
                endpoint.command(value)
            elif offset & 0x1F == 0x10:
                endpoint.size = value & (0x7F if offset & 0xE0 == 0 else 0x7FFFF)
        else:
            self._registers[offset] = value

    def reset_bus(self) -> None:
        """The host resets the bus, and finds out the device's speed."""
        self._flags |= _USBRST | _ENUMDNE
        for endpoint in (*self._ins, *self._outs):
            endpoint.is_enabled, endpoint.naks, endpoint.control = False, True, 0
            endpoint.fifo.clear()

    def setup(self, data: bytes) -> None:
        """A SETUP packet, which the core always takes; it ends a stall."""
        for endpoint in (self._ins[0], self._outs[0]):
            endpoint.is_enabled, endpoint.naks = False, True
            endpoint.control &= ~_STALL
        self._ins[0].fifo.clear()
        self._events += [(_SETUP, 0, data), (_SETUP_DONE, 0, b"")]

    def take(self, number: int) -> bytes | None:
        """A packet from the device; None where it has none yet."""
        endpoint = self._ins[number]
        if endpoint.control & _STALL:
            raise UsbError("stalled")
        if number and not endpoint.control & _ACTIVE:
            return None
        length = min(endpoint.size, PACKET)
        if not endpoint.is_enabled or endpoint.naks or len(endpoint.fifo) < length:
            return None
        packet = bytes(endpoint.fifo[:length])
        del endpoint.fifo[: -(-length // 4) * 4]
        endpoint.size -= length
        endpoint.is_enabled = endpoint.size > 0
        return packet

    def give(self, number: int, data: bytes) -> bool:
        """A packet to the device; false where it takes none yet."""
        endpoint = self._outs[number]
        is_ready = endpoint.is_enabled and not endpoint.naks and (number == 0 or endpoint.control & _ACTIVE)
        if not is_ready or endpoint.size < len(data):
            return False
        endpoint.is_enabled, endpoint.naks = False, True
        self._events += [(_DATA, number, data), (_DATA_DONE, number, b"")]
        return True

    def _endpoint(self, offset: int) -> _Endpoint | None:
        for begin, endpoints in ((_IN, self._ins), (_OUT, self._outs)):
            if begin <= offset < begin + 0x80:
                return endpoints[(offset - begin) // 0x20]
        return None

    def _pop(self) -> int:
        if not self._events:
            return 0
        if self._reading:
            raise UsbError("a packet was not read to its end")
        kind, number, data = self._events.popleft()
        padded = data + bytes(-len(data) % 4)
        self._reading = deque(int.from_bytes(padded[at : at + 4], "little") for at in range(0, len(padded), 4))
        return number | len(data) << 4 | kind << 17

    def _fill(self, number: int, word: int) -> None:
        endpoint = self._ins[number]
        room = self._registers.get(_DIEPTXF0 if number == 0 else 0x100 + 4 * number, 0) >> 16
        if not endpoint.is_enabled or len(endpoint.fifo) >= 4 * room:
            raise UsbError(f"endpoint {number} is given more than it has room for")
        endpoint.fifo += word.to_bytes(4, "little")

    def _restart(self, value: int) -> None:
        if value & 1:
            self.reset()
        if value & 1 << 5:
            which = value >> 6 & 31
            for endpoint in self._ins if which == 16 else [self._ins[which]]:
                endpoint.fifo.clear()
        if value & 1 << 4:
            self._events.clear()
            self._reading.clear()


class UsbHost:
    """Asks the device as a computer does when it is plugged in.

    Args:
        core: of the chip.
        run: lets the chip's time pass, seconds.
    """

    def __init__(self, core: UsbCore, run: Callable[[float], None]) -> None:
        self._core, self._run = core, run

    def plug(self) -> tuple[bytes, bytes]:
        """Wait for the device, number it and configure it; its descriptors, of itself and of its configuration."""
        self._until(lambda: self._core.is_connected or None)
        self._core.reset_bus()
        self._run(0.01)
        if self._core.address != 0:
            raise UsbError("the device keeps its address")
        device = self.control(0x80, 6, 0x0100, 0, 64)
        self.control(0x00, 5, 42, 0, 0)
        if self._core.address != 42:
            raise UsbError("the device did not take its address")
        configuration = self.control(0x80, 6, 0x0200, 0, 255)
        self.control(0x00, 9, 1, 0, 0)
        return device, configuration

    def string(self, index: int) -> str:
        """A text that the device has."""
        return self.control(0x80, 6, 0x0300 | index, 0x0409, 255)[2:].decode("utf-16-le")

    def open_port(self, is_open: bool = True) -> None:
        """What the system does when a program opens the serial port, or closes it."""
        if is_open:
            self.control(0x21, 0x20, 0, 0, 7, bytes([0, 0xC2, 1, 0, 0, 0, 8]))
        self.control(0x21, 0x22, 3 * is_open, 0, 0)

    def control(self, kind: int, what: int, value: int, index: int, length: int, data: bytes = b"") -> bytes:
        """A request: its answer, where it has one. Raises UsbError where the device refuses it."""
        self._core.setup(bytes([kind, what]) + b"".join(n.to_bytes(2, "little") for n in (value, index, length)))
        if kind & 0x80:
            answer = b"".join(self._packets(length))
            self._until(partial(self._given, 0, b""))
            return answer
        if data:
            self._until(partial(self._given, 0, data))
        if self._until(lambda: self._core.take(0)) != b"":
            raise UsbError("a request ends with data")
        return b""

    def write(self, data: bytes) -> None:
        """Send bytes to the serial port, and wait until they are taken."""
        for at in range(0, len(data), PACKET):
            self._until(partial(self._given, 1, data[at : at + PACKET]))

    def read(self) -> bytes:
        """What the serial port has said since last asked."""
        packets = []
        while (packet := self._core.take(1)) is not None:
            packets.append(packet)
            self._run(0.001)
        return b"".join(packets)

    def _given(self, number: int, data: bytes) -> bool | None:
        return self._core.give(number, data) or None

    def _packets(self, most: int) -> Iterable[bytes]:
        received = 0
        while received < most:
            packet = self._until(lambda: self._core.take(0))
            received += len(packet)
            yield packet
            if len(packet) < PACKET:
                return

    def _until(self, ask: Callable[[], Answer | None]) -> Answer:
        for _ in range(500):
            if (answer := ask()) is not None:
                return answer
            self._run(0.001)
        raise UsbError("the device does not answer")
