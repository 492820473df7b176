"""What the camera sees along a drive: frames rendered when asked for, each by itself, so that any can be first."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, TypeVar

import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.errors import ConfigError
from wheelsight.events import RgbdFrame
from wheelsight.geometry import FloatArray, PinholeCamera
from wheelsight.point_errors import PointErrors
from wheelsight.simulation.cameras import CameraModel
from wheelsight.simulation.doors import Doors
from wheelsight.simulation.drive import Drive
from wheelsight.simulation.frames import FrameMaker, Surroundings
from wheelsight.simulation.passersby import Passersby
from wheelsight.simulation.realism import CameraUnit, Carriage, Realism, carriage_of, realism_of, stream, unit_of
from wheelsight.simulation.realism.stamps import FrameTimes, exact_times, frame_times
from wheelsight.simulation.settings import SimulationSettings
from wheelsight.simulation.world import World

Result = TypeVar("Result")

_THREADS = 2


class Renderer:
    """Makes the RGB-D frames of a drive, the first at 0 s.

    Every frame has random numbers of its own, from the seed and its index, and depends on no other: rendered alone, in
    another order or by several threads, it is the same to the last bit.

    Args:
        world: what there is to see.
        drive: along whose truth the camera moves.
        settings: seed, day, robot, images a second, passers-by, doors, motion blur, realism.
        camera: the model, in the size wanted.
        carriage: how the camera moves, or None for one on the robot.

    Raises:
        ConfigError: the drive is too short for a single frame, or the world has not so many doors.
    """

    def __init__(
        self,
        world: World,
        drive: Drive,
        settings: SimulationSettings,
        camera: CameraModel,
        carriage: Carriage | None = None,
    ) -> None:
        realism = realism_of(settings.realism)
        self.rate_hz = settings.rate_hz or camera.rate_hz
        count = int(np.floor((drive.duration_s - camera.rolling_shutter_s / 2) * self.rate_hz + 1e-9)) + 1
        if count < 1:
            raise ConfigError(f"a drive of {drive.duration_s:.3f} s is too short for a frame")
        self.unit = unit_of(camera, realism, settings.seed)
        has_robot = carriage is None
        self.carriage = carriage or carriage_of(drive.truth, world, settings.robot, realism, settings.seed)
        self._times = times_of(count, self.rate_hz, realism, settings.day_seed)
        seed, robot = settings.day_seed, settings.robot
        people = Passersby(world, drive, settings.passersby, seed, robot) if settings.passersby else None
        self.doors = Doors(world, drive, settings.doors, seed, robot, people) if settings.doors else None
        self._maker = FrameMaker(
            Surroundings(world, people, self.doors),
            settings,
            self.unit,
            self.carriage,
            self._times,
            duration_s=drive.duration_s,
            has_robot=has_robot,
        )

    @property
    def frame_count(self) -> int:
        """How many frames arrive."""
        return len(self._times)

    @property
    def calibration(self) -> Calibration:
        """Of the camera alone, as its owner has it."""
        return camera_calibration(self.unit, self.unit.lens.nominal)

    @property
    def true_calibration(self) -> Calibration:
        """Of the camera alone, as it is."""
        return camera_calibration(self.unit, self.unit.lens.true)

    def stamp_s(self, index: int) -> float:
        """The stamp of a frame: what the host takes for the time of its middle row."""
        return float(self._times.told_s[index])

    def taken_s(self, index: int) -> float:
        """The true time of a frame's middle row."""
        return float(self._times.taken_s[index])

    def row_poses(self, taken_s: float) -> FloatArray:
        """(H, 4, 4) T_world_camera as each row of a frame is read; before the drive begins the robot stands."""
        return self._maker.row_poses(taken_s)

    def frame(self, index: int) -> RgbdFrame:
        """One frame, the same whatever was rendered before. Safe to be called by several threads at a time."""
        return self._maker.frame(index)

    def frames(self) -> Generator[RgbdFrame]:
        """All frames in order, two of them made at a time while the caller is busy with the one before."""
        yield from in_order(self.frame, self.frame_count, _THREADS)


def camera_calibration(unit: CameraUnit, lens: PinholeCamera) -> Calibration:
    """Of a camera alone, with a lens of its own: the nominal or the true one."""
    camera = unit.model
    # Without errors of a unit of its own, a camera's pixels share none, and its points are known.
    exact: dict[str, Any] = {"frame_sigma_m": 0.0, "frame_sigma_rad": 0.0, "point_errors": PointErrors()}
    return Calibration.registered_camera(
        lens,
        depth_noise=camera.depth_noise,
        rolling_shutter_s=camera.rolling_shutter_s,
        source=camera.name,
        **(exact if unit.realism is None else {}),
    )


def times_of(count: int, rate_hz: float, realism: Realism | None, seed: int) -> FrameTimes:
    """When so many frames of a drive are taken, and when they are said to be."""
    if realism is None:
        return exact_times(count, rate_hz)
    return frame_times(count, rate_hz, realism.stamps, stream(seed, "camera stamps"))


def in_order(make: Callable[[int], Result], count: int, threads: int) -> Generator[Result]:
    """What `make` makes of 0 to count - 1, in that order; `threads` work at a time, at most one result ahead of each.

    What `make` raises is raised here, at its place. Closing this generator waits for what is being made and drops it.
    """
    with ThreadPoolExecutor(threads, thread_name_prefix="wheelsight-render") as pool:
        pending: deque[Future[Result]] = deque()
        try:
            for index in range(count):
                pending.append(pool.submit(make, index))
                if len(pending) > 2 * threads:
                    yield pending.popleft().result()
            while pending:
                yield pending.popleft().result()
        finally:
            for future in pending:
                future.cancel()
