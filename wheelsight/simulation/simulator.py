"""Simulator: a robot to command, in a world that goes on while it is commanded."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from itertools import count
from types import TracebackType

import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.commands import VelocityCommand
from wheelsight.errors import ArgumentError, ConfigError
from wheelsight.events import Event
from wheelsight.extras import needed
from wheelsight.geometry import FloatArray
from wheelsight.robot_limits import RobotLimits
from wheelsight.robots import STOPPED
from wheelsight.simulation.contacts import Contact
from wheelsight.simulation.delays import Delays
from wheelsight.simulation.drivers import COMMAND_PERIOD_S
from wheelsight.simulation.live_camera import LiveCamera
from wheelsight.simulation.live_passersby import LivePeopleSettings
from wheelsight.simulation.live_world import LiveWorld
from wheelsight.simulation.motors import Motors
from wheelsight.simulation.realism import realism_of, stream
from wheelsight.simulation.settings import SimulationSettings
from wheelsight.simulation.simulated_recording import as_owned
from wheelsight.simulation.stepping import TRUTH_PERIOD_S, Reading, SteppedRobot, floor_of, ticks_of
from wheelsight.simulation.world import World
from wheelsight.threads import OneCaller, one_at_a_time
from wheelsight.wheel_control import Duties, VelocityControl, WheelControlSettings

PERIOD_S = 0.05
LONGEST_S = 4 * 3600.0

_FALLEN = 0.7  # cosine of the lean from which on a chair does not come back


class Simulator(OneCaller):
    """A `Robot`: each step obeys a command for one control period, and answers what the sensors said in it.

    Time stands still between steps. Wheels are held at their speeds by the loop that a real robot has, over encoders
    as they are read; motors follow late. Frames are rendered in the step in which their last row is taken, with all
    that recorded drives have. What is stamped later than a frame that is not there yet waits for it, so that events
    come in the order of stamps. Equal arguments and commands, equal events, to the last bit.

    Of the settings, those of a way or a driver mean nothing here: laps, speed, duration, direction, velocities. People
    and doors see the robot as it drives. People are not solid: a robot drives through them, and `contacts` tells.

    Args:
        settings: world, camera, robot, faults, people, doors, realism, seed.
        start: x, y in metres and yaw in radians in the frame `map` where the base begins; None for the world's own.
        world: in place of the one the settings name.
        people: how they mind the robot.
        limits: which commands are held to.
        control: of the wheels' loop.
        period_s: of a step, a multiple of 5 ms.
        has_camera: whether frames are rendered.
        threads: how many render a frame.

    Raises:
        ConfigError: what `simulate` raises, a start where something stands, or a period that cannot be.
    """

    def __init__(
        self,
        settings: SimulationSettings,
        *,
        start: tuple[float, float, float] | None = None,
        world: World | None = None,
        people: LivePeopleSettings | None = None,
        limits: RobotLimits | None = None,
        control: WheelControlSettings | None = None,
        period_s: float = PERIOD_S,
        has_camera: bool = True,
        threads: int = 1,
    ) -> None:
        needed("mujoco")
        self._steps = _checked_steps(period_s)
        self.settings, self._has_camera = settings, has_camera
        self._live = LiveWorld(settings, start, world, people)
        self._robot = _stepped(settings, self._live)
        self._camera = LiveCamera(self._live.surroundings, settings, LONGEST_S, threads)
        self._calibration = as_owned(settings, self._camera.calibration)
        self._drive = _WheelDrive(settings, self._calibration, limits, control)
        realism, seed = realism_of(settings.realism), settings.day_seed
        stamps = None if realism is None else realism.stamps
        self._wheel_delays = Delays(stamps, stream(seed, "live wheel stamps"))
        self._gyro_delays = Delays(stamps, stream(seed, "live gyro stamps"))
        self._waiting: list[tuple[float, int, Event]] = []
        self._order = count()
        self._broken, self._is_closed = "", False

    @property
    def world(self) -> World:
        """Without people."""
        return self._live.world

    @property
    def calibration(self) -> Calibration:
        """What the robot's owner measured, as of recordings."""
        return self._calibration

    @property
    def time_s(self) -> float:
        """Simulated seconds since the start."""
        return self._robot.time_s

    @property
    def now_s(self) -> float:
        """As `Robot` has it: `time_s`."""
        return self.time_s

    @property
    def stop_reason(self) -> str:
        """As `Robot` has it."""
        return self._broken or self._drive.control.reason

    @property
    def T_world_base(self) -> FloatArray:
        """(4, 4) the truth of now, for judging."""
        return self._robot.chair.T_world_base

    @property
    def T_world_camera(self) -> FloatArray:
        """(4, 4) the truth of the last 5 ms, for judging."""
        return self._camera.T_world_camera

    @property
    def people_m(self) -> FloatArray:
        """(N, 2) where people truly stand, metres, for judging."""
        return self._live.people_at(self.time_s)

    def clearance_m(self, T_world_base: FloatArray | None = None) -> float:
        """True distance from the robot's outline, here or at (4, 4), to the nearest thing, or door; not people."""
        return self._live.clearance_m(self.T_world_base if T_world_base is None else T_world_base, self.time_s)

    def people_clearance_m(self) -> float:
        """True distance from the robot's outline to the nearest person's."""
        return self._live.people_clearance_m(self.T_world_base, self.time_s)

    @property
    def contacts(self) -> tuple[Contact, ...]:
        """All that robot and others have come to touch so far, each once when it began, for judging."""
        return tuple(self._live.contacts)

    @property
    def contact(self) -> Contact | None:
        """The last of them."""
        return self._live.contacts[-1] if self._live.contacts else None

    @one_at_a_time
    def step(self, command: VelocityCommand) -> list[Event]:
        """Obey a command for one control period; what the sensors said, in the order of stamps.

        Raises:
            ArgumentError: it is closed, or has run for four hours.
        """
        if self._is_closed or self.time_s >= LONGEST_S:
            problem = "is closed" if self._is_closed else f"has run for {LONGEST_S:g} s"
            raise ArgumentError(f"the simulator {problem}", fix="make a new one")
        for _ in range(self._steps):
            if not self._broken:
                self._tick(command)
        return list(self._due())

    def stop(self) -> None:
        """Take the motors' voltage; the chair brakes by itself in the steps to come, until it is commanded to stand."""
        self._drive.stop()

    def close(self) -> None:
        """Stop; nothing more can be asked of it but the truth."""
        self.stop()
        self._is_closed = True

    def __enter__(self) -> Simulator:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _tick(self, command: VelocityCommand) -> None:
        robot, tick = self._robot, self._robot.tick
        reading = robot.read()
        self._camera.follow(reading)
        self._take(reading)
        if tick % ticks_of(COMMAND_PERIOD_S) == 0:
            robot.chair.turn_wheels(self._drive.rims_m_s(reading, command))
        self._live.step(tick, robot)
        robot.advance()
        if robot.chair.is_broken:
            self._broken = f"the physics became unstable at {self.time_s:.1f} s"
        elif robot.chair.T_world_base[2, 2] < _FALLEN:
            self._broken = f"the wheelchair fell over at {self.time_s:.1f} s"

    def _take(self, reading: Reading) -> None:
        if reading.ticks is not None:
            self._put(self._wheel_delays.stamped(reading.ticks))
        if reading.yaw_rate is not None:
            self._put(self._gyro_delays.stamped(reading.yaw_rate))
        for frame in self._camera.frames() if self._has_camera else ():
            self._put(frame)

    def _put(self, event: Event) -> None:
        heapq.heappush(self._waiting, (event.stamp_s, next(self._order), event))

    def _due(self) -> Iterator[Event]:
        """What is stamped up to now, and before any frame that is still to come."""
        until_s = min(self.time_s, self._camera.next_stamp_s if self._has_camera else np.inf)
        while self._waiting and self._waiting[0][0] < until_s:
            yield heapq.heappop(self._waiting)[2]


class _WheelDrive:
    """Wheel controller and motors: a command every 20 ms becomes speeds of the wheels' rims."""

    def __init__(
        self,
        settings: SimulationSettings,
        calibration: Calibration,
        limits: RobotLimits | None,
        control: WheelControlSettings | None,
    ) -> None:
        assert calibration.wheels is not None
        self.control = VelocityControl(calibration.wheels, limits, control)
        is_exact = realism_of(settings.realism) is None
        self._motors = Motors(rng=None if is_exact else stream(settings.seed, "motors"))

    def rims_m_s(self, reading: Reading, command: VelocityCommand) -> tuple[float, float]:
        """Of the left and right wheel, called every `COMMAND_PERIOD_S`."""
        duties = self.control.update(reading.stamp_s, reading.ticks, command)
        return self._motors.after(duties, COMMAND_PERIOD_S)

    def stop(self) -> None:
        """Begin anew from a stand."""
        self.control.stop(STOPPED)
        self._motors.after(Duties(), np.inf)


def _stepped(settings: SimulationSettings, live: LiveWorld) -> SteppedRobot:
    return SteppedRobot(
        live.world,
        settings.robot,
        live.T_world_start,
        faults=settings.faults,
        slip=settings.has_slip,
        seed=settings.day_seed,
        floor=floor_of(live.world, realism_of(settings.realism), settings.seed),
        doors=live.doors,
    )


def _checked_steps(period_s: float) -> int:
    steps = round(period_s / TRUTH_PERIOD_S) if np.isfinite(period_s) else 0
    if not (1 <= steps <= 1000 and abs(steps * TRUTH_PERIOD_S - period_s) < 1e-9):
        raise ConfigError(f"period_s is {period_s}", fix=f"a multiple of {TRUTH_PERIOD_S} s, up to 5 s")
    return steps
