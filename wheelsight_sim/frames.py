"""Frames of a camera that is carried through a world, each by itself; `Renderer` makes those of a recorded drive."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.depth_errors import PointErrors
from wheelsight.core.errors import ConfigError
from wheelsight.core.geometry import Float32Array, FloatArray, PinholeCamera
from wheelsight.core.messages import RgbdFrame
from wheelsight_sim.appearance import Lights, Painter, Shadows, Sunlight
from wheelsight_sim.cameras import CameraModel, CameraUnit, Carriage, Moment, carriage_of, unit_of
from wheelsight_sim.color_sensor import ColorSensor, ExposureSetting, balance_of, exposure_of, response
from wheelsight_sim.doors import Doors, Leaves
from wheelsight_sim.people import Cylinders, Passersby
from wheelsight_sim.readings import FrameTimes, exact_times, frame_times
from wheelsight_sim.robot import Drive
from wheelsight_sim.scene import Scene, View
from wheelsight_sim.settings import Realism, SimulationSettings, realism_of, stream
from wheelsight_sim.world import World

_STREAM = 17
_METERED_FRAMES = 12
_METER_SIZE = (32, 24)
_BRIGHTEST = 1.5  # that counts in a mean colour: lamps in view do not make a picture theirs


@dataclass(frozen=True, slots=True, eq=False)
class Surroundings:
    """What there is to see: a world, who walks in it, and which doors swing."""

    world: World
    people: Cylinders | None = None
    doors: Leaves | None = None


class FrameMaker:
    """Makes frames; each has random numbers of its own, from the seed and its index.

    `carriage` may be replaced as time goes on, if it knows the times that are asked for and those of the frames before,
    as far back as exposure is metered; what was metered once is kept. Lamps are switched within `duration_s`; `threads`
    work at one frame.
    """

    def __init__(
        self,
        surroundings: Surroundings,
        settings: SimulationSettings,
        unit: CameraUnit,
        carriage: Carriage,
        times: FrameTimes,
        *,
        duration_s: float,
        has_robot: bool = True,
        threads: int = 1,
    ) -> None:
        self.unit, self.carriage, self.times = unit, carriage, times
        self._surroundings, self._settings, self._threads = surroundings, settings, threads
        self._duration_s, self._has_robot = duration_s, has_robot
        self._rate_hz = settings.rate_hz or unit.model.rate_hz
        self._meter = unit.model.resized(*_METER_SIZE).camera
        self._sensor = ColorSensor(motion_blur=settings.has_motion_blur)
        if unit.realism is not None:
            control = unit.realism.control
            level = float(stream(unit.seed, "exposure").uniform(*control.level))
            self._sensor = ColorSensor(motion_blur=True, longest_s=control.longest_s, target=level)
        self._metered: dict[int, tuple[float, FloatArray]] = {}
        self._idle_eyes: deque[_Eye] = deque()

    def moment(self, taken_s: float) -> Moment:
        """How the camera moves as a frame is taken, with a pose for each row; before the drive the robot stands."""
        height, shutter_s = self.unit.model.camera.height, self.unit.model.rolling_shutter_s
        rows_s = taken_s + shutter_s * np.linspace(-0.5, 0.5, height) if shutter_s else np.array([taken_s])
        moment = self.carriage.moment(rows_s, taken_s)
        return moment._replace(T_world_camera=np.broadcast_to(moment.T_world_camera, (height, 4, 4)))

    def frame(self, index: int) -> RgbdFrame:
        """One frame, the same whatever was rendered before. Safe to be called by several threads at a time."""
        try:
            eye = self._idle_eyes.pop()
        except IndexError:
            around, threads = self._surroundings, self._threads
            scene = Scene(around.world, around.people, threads=threads, doors=around.doors)
            eye = _Eye(scene, self._settings, self.unit, self._duration_s, self._has_robot, threads)
        try:
            taken_s, unit = float(self.times.taken_s[index]), self.unit
            depth_rng, color_rng = np.random.default_rng([self._settings.day_seed, _STREAM, index]).spawn(2)
            moment = self.moment(taken_s)
            exposure, balance = self._exposure(index, eye, moment)
            view = eye.look(unit.lens.true, moment.T_world_camera, taken_s)
            radiance, sun = eye.radiance(
                view, taken_s, moment.T_world_base if self._has_robot else None, has_outlines=True
            )
            seen = unit.seen_by_depth(view, sun, eye.distortion, moment.twist, taken_s)
            depth_m = unit.model.depth.measure(seen, unit.lens.true, eye.infrared, eye.shine, depth_rng)
            if balance is not None:
                radiance *= balance.astype(np.float32)
            color = unit.delivered(self._sensor.expose(radiance, view, exposure, color_rng, moment.twist))
            return RgbdFrame(float(self.times.reported_s[index]), color, depth_m, index)
        finally:
            self._idle_eyes.append(eye)

    def forget_before(self, index: int) -> None:
        """What was metered for frames that are no longer asked for."""
        for old in [known for known in self._metered if known <= index - _METERED_FRAMES]:
            del self._metered[old]

    def _exposure(self, index: int, eye: _Eye, moment: Moment) -> tuple[ExposureSetting, FloatArray | None]:
        """What the camera's control sets for a frame, after what it metered in this one and the ones before.

        The sensor's control follows with inertia, so each frame's exposure would depend on all before. Here it sees the
        last `_METERED_FRAMES` only, in small pictures, with the weights the inertia gives them. A real one has weights
        of its own, and factors (3,) for red, green and blue.
        """
        ages = np.arange(min(index + 1, _METERED_FRAMES))
        metered = [self._meter_of(index - int(age), eye, None if age else moment) for age in ages]
        products_s = [product_s for product_s, _ in metered]
        if self.unit.realism is not None:
            control, period_s = self.unit.realism.control, 1 / self._rate_hz
            weights = response(control, period_s, _METERED_FRAMES)
            exposure = exposure_of(control, products_s, weights, self._sensor.highest_gain)
            return exposure, balance_of(control, np.array([color for _, color in metered]), period_s)
        aged = self._sensor.inertia**ages
        product_s = float(np.exp(np.average(np.log(products_s), weights=aged)))
        time_s = min(product_s, self._sensor.longest_s)
        return ExposureSetting(time_s, product_s / time_s), None

    def _meter_of(self, index: int, eye: _Eye, moment: Moment | None) -> tuple[float, FloatArray]:
        """Time times gain that a frame alone would ask for, and its mean colour; remembered for the next frames."""
        if index not in self._metered:
            taken_s = float(self.times.taken_s[index])
            moment = moment or self.moment(taken_s)
            view = eye.look(self._meter, moment.T_world_camera[self.unit.model.camera.height // 2], taken_s)
            radiance, _ = eye.radiance(
                view, taken_s, moment.T_world_base if self._has_robot else None, has_outlines=False
            )
            color = np.minimum(radiance, _BRIGHTEST).mean(axis=(0, 1))
            self._metered[index] = self._sensor.meter(radiance).product_s, np.asarray(color, float)
        return self._metered[index]


class _Eye:
    """A scene and its paint, for one frame at a time: people and doors in it are moved before each look."""

    def __init__(
        self,
        scene: Scene,
        settings: SimulationSettings,
        unit: CameraUnit,
        duration_s: float,
        has_robot: bool,
        threads: int,
    ) -> None:
        seed = settings.day_seed
        self._scene = scene
        self._painter = Painter(
            self._scene.geoms, self._scene.surfaces, settings.seed, light_seed=seed, threads=threads
        )
        surfaces = [self._scene.surfaces[material] for material in self._scene.geoms.materials]
        self.infrared = np.array([surface.infrared for surface in surfaces])
        self.shine = np.array([surface.shine for surface in surfaces])
        self.distortion = unit.distortion(self.infrared * (1 - self.shine))
        self._lighting, realism = self._painter.lighting, unit.realism
        self._sun: Sunlight | None = None
        self._lights: Lights | None = None
        self._shadows: Shadows | None = None
        if realism is not None:
            self._sun = Sunlight(realism.sunlight, self._scene, self._lighting.sun, stream(seed, "sunlight"))
            self._lights = Lights(realism.lights, duration_s, stream(seed, "lights"))
            self._shadows = Shadows(realism.shadows, scene, self._lighting, has_robot=has_robot)

    def look(self, camera: PinholeCamera, T_world_camera: FloatArray, stamp_s: float) -> View:
        """What a camera sees at a time."""
        self._scene.move_to(stamp_s)
        return self._scene.cast(camera, T_world_camera)

    def radiance(
        self, view: View, stamp_s: float, T_world_base: FloatArray | None, *, has_outlines: bool
    ) -> tuple[Float32Array, Float32Array | None]:
        """Radiance (H, W, 3) of the last look, and the sunlight (H, W) in it; with or without more rays at outlines.

        The robot stands at T_world_base (4, 4); None where it throws no shadow.
        """
        level = 1.0
        if self._lights is not None:
            level = self._lights.level_at(stamp_s)
            self._painter.lighting = self._lights.lit(self._lighting, stamp_s)
        outlines = self._scene.outlines(view) if has_outlines else None
        radiance = self._painter.paint(view, outlines=outlines)
        if self._sun is None or self._shadows is None:
            return radiance, None
        kept = self._shadows.kept(view, level, T_world_base)
        sun = self._sun.on(view)
        radiance *= (kept + np.float32(self._sun.brightness) * sun)[..., None]
        return radiance, sun


Result = TypeVar("Result")

_THREADS = 2


class Renderer(FrameMaker):
    """Makes the RGB-D frames of a drive, the first at 0 s.

    Every frame has random numbers of its own, from the seed and its index, and depends on no other: rendered alone, in
    another order or by several threads, it is the same to the last bit.

    `carriage` says how the camera moves; None for one on the robot.

    Raises:
        ConfigError: the drive is too short for a single frame, or the world has fewer doors.
    """

    def __init__(
        self,
        world: World,
        drive: Drive,
        settings: SimulationSettings,
        camera: CameraModel,
        carriage: Carriage | None = None,
    ) -> None:
        realism, seed, robot = realism_of(settings.realism), settings.day_seed, settings.robot
        self.rate_hz = settings.rate_hz or camera.rate_hz
        count = int(np.floor((drive.duration_s - camera.rolling_shutter_s / 2) * self.rate_hz + 1e-9)) + 1
        if count < 1:
            raise ConfigError(f"a drive of {drive.duration_s:.3f} s is too short for a frame")
        people = Passersby(world, drive, settings.passersby, seed, robot) if settings.passersby else None
        self.doors = Doors(world, drive, settings.doors, seed, robot, people) if settings.doors else None
        super().__init__(
            Surroundings(world, people, self.doors),
            settings,
            unit_of(camera, realism, settings.seed),
            carriage or carriage_of(drive.truth, world, robot, realism, settings.seed),
            times_of(count, self.rate_hz, realism, seed),
            duration_s=drive.duration_s,
            has_robot=carriage is None,
        )

    @property
    def frame_count(self) -> int:
        """How many frames arrive."""
        return len(self.times)

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
        return float(self.times.reported_s[index])

    def taken_s(self, index: int) -> float:
        """The true time of a frame's middle row."""
        return float(self.times.taken_s[index])

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
    """True times and stamps of `count` frames of a drive."""
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
