"""`HardwareRobot`, a simulated robot whose wheels are driven through the compiled firmware on a simulated chip."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np

from firmware.simulation.boards import BOARDS, Board, check_board
from wheelsight.core.drive_model import DriveModel, DriveResponse
from wheelsight.core.errors import ConfigError
from wheelsight.core.messages import Event, VelocityCommand
from wheelsight.core.robots import Duties, RobotLimits
from wheelsight.io.devices import LinkRobot, WheelLink
from wheelsight.io.devices.wheel_link import LinkHost
from wheelsight_sim import SimulationSettings
from wheelsight_sim.drivers import COMMAND_PERIOD_S
from wheelsight_sim.physics import TRUTH_PERIOD_S, ticks_of
from wheelsight_sim.robot import FULL_SPEED_M_S, Motors
from wheelsight_sim.settings import realism_of, stream
from wheelsight_sim.simulator import Simulator

FaultKind = Literal[
    "line cut",
    "line noise",
    "bytes lost",
    "commands out of order",
    "host frozen",
    "chip reset",
    "chip hangs",
    "brownout",
    "encoder dead",
    "motor stuck",
    "motor runs on",
]
FAULT_KINDS: tuple[FaultKind, ...] = get_args(FaultKind)

# Shares of damaged and of lost bytes. Chosen: a line of 18 bytes a frame then loses two frames of three.
_NOISE, _LOST = 0.06, 0.06


@dataclass(frozen=True, slots=True)
class HardwareFault:
    """A fault between the computer and the wheels.

    Attributes:
        kind: what fails. A chip that is reset or hangs does so at the begin; "motor runs on" keeps its speed whatever
            the outputs are.
        begin_s, end_s: times of the simulation.
        wheel: 0 for the left one, 1 for the right one, of an encoder or a motor.

    Raises:
        ConfigError: an unknown kind, or an end before the begin.
    """

    kind: FaultKind
    begin_s: float
    end_s: float = np.inf
    wheel: int = 0

    def __post_init__(self) -> None:
        if self.kind not in FAULT_KINDS:
            raise ConfigError(f"a fault of hardware is {self.kind!r}", fix=f"one of {', '.join(FAULT_KINDS)}")
        if not 0 <= self.begin_s < self.end_s or self.wheel not in (0, 1):
            raise ConfigError(
                f"the fault {self.kind} has begin, end or wheel wrong", fix="0 <= begin < end, wheel 0 or 1"
            )


class SimulatedLine:
    """The serial line between the link and a simulated chip, with its faults; the port of a `WheelLink`.

    Args:
        is_on: returns whether a fault is present.
    """

    def __init__(self, is_on: Callable[[FaultKind], bool], rng: np.random.Generator) -> None:
        self._is_on, self._rng = is_on, rng
        self._to_host, self._to_chip = bytearray(), bytearray()
        self._held: deque[bytes] = deque()

    @property
    def in_waiting(self) -> int:
        """Bytes that the host can read."""
        return len(self._to_host)

    def read(self, count: int) -> bytes:
        """Return up to `count` bytes; none if none are there."""
        taken = bytes(self._to_host[:count])
        del self._to_host[:count]
        return taken

    def write(self, data: bytes) -> None:
        """Send a frame to the chip."""
        if self._is_on("commands out of order"):
            # Every frame is overtaken by the two after it.
            self._held.append(data)
            if len(self._held) > 2:
                newest = self._held.pop()
                oldest = self._held.popleft()
                self._to_chip += self._damaged(newest) + self._damaged(oldest)
            return
        self._held.clear()
        self._to_chip += self._damaged(data)

    def close(self) -> None:
        """Do nothing; the robot closes the chip."""

    def take(self) -> bytes:
        """The bytes that reach the chip."""
        taken = bytes(self._to_chip)
        self._to_chip.clear()
        return taken

    def put(self, data: bytes) -> None:
        """Take bytes from the chip."""
        self._to_host += self._damaged(data)

    def _damaged(self, data: bytes) -> bytes:
        if self._is_on("line cut"):
            return b""
        if self._is_on("bytes lost"):
            data = bytes(byte for byte in data if self._rng.random() >= _LOST)
        if self._is_on("line noise"):
            noise = self._rng.integers(1, 256, len(data)) * (self._rng.random(len(data)) < _NOISE)
            data = bytes(byte ^ int(other) for byte, other in zip(data, noise, strict=True))
        return data


def _nothing() -> None:
    """No listener."""


class HardwareRobot(Simulator):
    """A `Simulator` whose commands go the way of a real robot, in step with simulated time.

    `LinkRobot` and `WheelLink` control the wheels over a simulated line by the serial protocol. The compiled firmware
    runs on a simulated chip, counts the edges of the encoders, and sets the motors by its PWM outputs. Wheels and chip
    exchange edges and duties every 5 ms. Equal arguments and commands give identical events.

    Args:
        hardware: `atmega8` or `stm32`.
        settings, start, limits, drive: see `Simulator`. The encoders of the stm32 count each edge, four times as many.
        faults: between computer and wheels.
        parts: further arguments of `Simulator`.

    Attributes:
        duties: outputs of the chip in the last 5 ms, -1 to 1; zeros where they are not driven.
        link: between computer and chip.
        on_tick: called after each 5 ms.

    Raises:
        ConfigError: as `Simulator`; an unknown chip, or missing compilers.
        BuildError: the firmware does not compile.
    """

    def __init__(
        self,
        hardware: str,
        settings: SimulationSettings,
        *,
        faults: Sequence[HardwareFault] = (),
        limits: RobotLimits | None = None,
        drive: DriveModel | None = None,
        **parts: Any,
    ) -> None:
        check_board(hardware)
        if (edges := BOARDS[hardware].edges_per_tick) == 1:
            robot = replace(settings.robot, counts_per_turn=4 * settings.robot.counts_per_turn)
            settings = replace(settings, robot=robot)
        super().__init__(settings, limits=limits, drive=drive, **parts)
        self._board: Board = BOARDS[hardware]()
        self._faults, self._begun = tuple(faults), set[HardwareFault]()
        self._ticks = 0
        per_turn = settings.robot.gear_ratio * settings.robot.counts_per_turn * edges
        rng = stream(settings.day_seed, "hardware")
        self._edges_per_rad, self._phase = per_turn / (2 * np.pi), rng.random(2)
        self._edges = np.floor(self._phase).astype(int)
        self._line = SimulatedLine(self.has_fault, rng)
        is_ideal = realism_of(settings.realism) is None
        self._driven_motors = Motors(rng=None if is_ideal else stream(settings.seed, "motors"))
        self._answers = None if drive is None else DriveResponse(drive)
        self._last_rims_m_s = (0.0, 0.0)
        self.duties, self.on_tick = (0.0, 0.0), _nothing
        host = LinkHost(lambda: self.host_s, lambda: 0.0, lambda _, __: self._line, self._pass)  # type: ignore[arg-type,return-value]
        self.link = WheelLink(f"the simulated {hardware}", host=host)
        self._linked = LinkRobot(self.link, self.calibration, limits)
        self._in_step, self._asked_to_stop = threading.Lock(), threading.Event()
        self._is_gone = False

    @property
    def host_s(self) -> float:
        """Time of the computer, which also passes after the physics became unstable."""
        return self._ticks * TRUTH_PERIOD_S

    @property
    def stop_reason(self) -> str:
        """See `Robot`."""
        return super().stop_reason or self._linked.stop_reason

    def has_fault(self, kind: FaultKind) -> bool:
        """Whether a fault is present now."""
        return any(fault.kind == kind and fault.begin_s <= self.host_s < fault.end_s for fault in self._faults)

    def step(self, command: VelocityCommand) -> list[Event]:
        """See `Simulator`; the commands pass the serial line. Raises DeviceError if the robot is closed."""
        with self._in_step:
            for event in self._linked.step(command):
                self.put(event)
            if self._asked_to_stop.is_set():
                self._asked_to_stop.clear()
                self._linked.stop()
        return self.due()

    def stop(self) -> None:
        """See `Robot`; in a step of another thread the motors are stopped at its end. Raises as `LinkRobot.stop`."""
        if not self._in_step.acquire(blocking=False):
            self._asked_to_stop.set()
            return
        try:
            self._linked.stop()
        finally:
            self._in_step.release()

    def close(self) -> None:
        """See `Robot`; only the truth remains available."""
        if self._is_gone:
            return
        self._is_gone = True
        try:
            self._linked.close()
        finally:
            self._board.close()

    def _pass(self, until_s: float) -> None:
        """Let 5 ms pass; more while the computer is frozen."""
        self._tick()
        self.on_tick()
        while self.has_fault("host frozen") and not super().stop_reason:
            self._tick()
            self.on_tick()

    def _tick(self) -> None:
        self._ticks += 1
        if super().stop_reason:
            return
        self.read()
        rims_m_s = None
        if self._ticks % ticks_of(COMMAND_PERIOD_S) == 0:
            rims_m_s = self._rims(self.duties)
        self.advance(rims_m_s)
        edges = np.floor(self.wheels_rad * self._edges_per_rad + self._phase).astype(int)
        moved, self._edges = edges - self._edges, edges
        for fault in self._faults:
            if fault.begin_s <= self.host_s < fault.end_s:
                if fault.kind == "encoder dead":
                    moved[fault.wheel] = 0
                elif fault.kind in ("chip reset", "chip hangs") and fault not in self._begun:
                    self._begun.add(fault)
                    (self._board.reset if fault.kind == "chip reset" else self._board.hang)()
        to_chip = self._line.take()
        if self.has_fault("brownout"):
            # Held in reset: the outputs float, and the resistors of the filters hold the motors' level in the middle.
            self._board.reset()
            self.duties = (0.0, 0.0)
            return
        sent, duties = self._board.advance((int(moved[0]), int(moved[1])), TRUTH_PERIOD_S, to_chip)
        self._line.put(sent)
        self.duties = duties or (0.0, 0.0)

    def _rims(self, duties: tuple[float, float]) -> tuple[float, float]:
        """Speeds of both rims in the next 20 ms."""
        if self._answers is None:
            rims = self._driven_motors.after(Duties(*duties), COMMAND_PERIOD_S)
        else:
            left, right = (FULL_SPEED_M_S * duty for duty in duties)
            rims = self._answers.after((left + right) / 2, (right - left) / 2, COMMAND_PERIOD_S)
        found = list(rims)
        for fault in self._faults:
            if fault.begin_s <= self.host_s < fault.end_s and fault.kind.startswith("motor"):
                found[fault.wheel] = 0.0 if fault.kind == "motor stuck" else self._last_rims_m_s[fault.wheel]
        self._last_rims_m_s = found[0], found[1]
        return self._last_rims_m_s
