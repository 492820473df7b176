"""What the camera sees along a drive: frames rendered when asked for, each by itself, so that any can be first."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.errors import ConfigError
from wheelsight.events import RgbdFrame
from wheelsight.geometry import Float32Array, FloatArray, PinholeCamera
from wheelsight.simulation.appearance import Painter
from wheelsight.simulation.cameras import CameraModel
from wheelsight.simulation.color_sensor import ColorSensor, Exposure
from wheelsight.simulation.doors import Doors
from wheelsight.simulation.drive import Drive
from wheelsight.simulation.passersby import Passersby
from wheelsight.simulation.realism import CameraUnit, Carriage, Realism, carriage_of, realism_of, stream, unit_of
from wheelsight.simulation.realism.control import balance_of, exposure_of, response
from wheelsight.simulation.realism.lights import Lights
from wheelsight.simulation.realism.shadows import Shadows
from wheelsight.simulation.realism.stamps import FrameTimes, exact_times, frame_times
from wheelsight.simulation.realism.sunlight import Sunlight
from wheelsight.simulation.scene import Scene
from wheelsight.simulation.settings import SimulationSettings
from wheelsight.simulation.view import View
from wheelsight.simulation.world import World

Result = TypeVar("Result")

_THREADS = 2
_STREAM = 17
_METERED_FRAMES = 12
_METER_SIZE = (32, 24)
_BRIGHTEST = 1.5  # that counts in a mean colour: lamps in view do not make a picture theirs


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
        self._world, self._drive, self._settings, self._camera = world, drive, settings, camera
        self._realism = realism_of(settings.realism)
        self.rate_hz = settings.rate_hz or camera.rate_hz
        count = int(np.floor((drive.duration_s - camera.rolling_shutter_s / 2) * self.rate_hz + 1e-9)) + 1
        if count < 1:
            raise ConfigError(f"a drive of {drive.duration_s:.3f} s is too short for a frame")
        self.unit = unit_of(camera, self._realism, settings.seed)
        self._has_robot = carriage is None
        self.carriage = carriage or carriage_of(drive.truth, world, settings.robot, self._realism, settings.seed)
        self._times = _times(count, self.rate_hz, self._realism, settings.day_seed)
        self._meter = camera.resized(*_METER_SIZE).camera
        self._sensor = _sensor(settings, self.unit)
        self._passersby = (
            Passersby(world, drive, settings.passersby, settings.day_seed, settings.robot)
            if settings.passersby
            else None
        )
        self.doors = (
            Doors(world, drive, settings.doors, settings.day_seed, settings.robot, self._passersby)
            if settings.doors
            else None
        )
        self._metered: dict[int, tuple[float, FloatArray]] = {}
        self._idle_eyes: deque[_Eye] = deque()

    @property
    def frame_count(self) -> int:
        """How many frames arrive."""
        return len(self._times)

    @property
    def calibration(self) -> Calibration:
        """Of the camera alone, as its owner has it."""
        return self._calibration(self.unit.lens.nominal)

    @property
    def true_calibration(self) -> Calibration:
        """Of the camera alone, as it is."""
        return self._calibration(self.unit.lens.true)

    def _calibration(self, lens: PinholeCamera) -> Calibration:
        camera = self._camera
        # Without errors of a unit of its own, a camera's pixels share none.
        shared = {"frame_sigma_m": 0.0, "frame_sigma_rad": 0.0} if self.unit.realism is None else {}
        return Calibration.registered_camera(
            lens,
            depth_noise=camera.depth_noise,
            rolling_shutter_s=camera.rolling_shutter_s,
            source=camera.name,
            **shared,
        )

    def stamp_s(self, index: int) -> float:
        """The stamp of a frame: what the host takes for the time of its middle row."""
        return float(self._times.told_s[index])

    def taken_s(self, index: int) -> float:
        """The true time of a frame's middle row."""
        return float(self._times.taken_s[index])

    def row_poses(self, taken_s: float) -> FloatArray:
        """(H, 4, 4) T_world_camera as each row of a frame is read; before the drive begins the robot stands."""
        height, shutter_s = self._camera.camera.height, self._camera.rolling_shutter_s
        rows_s = taken_s + shutter_s * np.linspace(-0.5, 0.5, height) if shutter_s else np.array([taken_s])
        return np.broadcast_to(self.carriage.T_world_camera(rows_s), (height, 4, 4))

    def frame(self, index: int) -> RgbdFrame:
        """One frame, the same whatever was rendered before. Safe to be called by several threads at a time."""
        try:
            eye = self._idle_eyes.pop()
        except IndexError:
            scene = Scene(self._world, self._passersby, threads=1, doors=self.doors)
            eye = _Eye(scene, self._settings, self.unit, self._drive, self._has_robot)
        try:
            return self._frame(index, eye)
        finally:
            self._idle_eyes.append(eye)

    def frames(self) -> Generator[RgbdFrame]:
        """All frames in order, two of them made at a time while the caller is busy with the one before."""
        yield from in_order(self.frame, self.frame_count, _THREADS)

    def _frame(self, index: int, eye: _Eye) -> RgbdFrame:
        taken_s, unit = self.taken_s(index), self.unit
        depth_rng, color_rng = np.random.default_rng([self._settings.day_seed, _STREAM, index]).spawn(2)
        exposure, balance = self._exposure(index, eye)
        view = eye.look(unit.lens.true, self.row_poses(taken_s), taken_s)
        twist = self.carriage.twist_camera(taken_s)
        radiance, sun = eye.radiance(view, taken_s, has_outlines=True)
        seen = unit.seen_by_depth(view, sun, eye.distortion, twist, taken_s)
        depth_m = self._camera.depth.measure(seen, unit.lens.true, eye.infrared, eye.shine, depth_rng)
        if balance is not None:
            radiance *= balance.astype(np.float32)
        color = unit.delivered(self._sensor.expose(radiance, view, exposure, color_rng, twist))
        return RgbdFrame(self.stamp_s(index), color, depth_m, index)

    def _exposure(self, index: int, eye: _Eye) -> tuple[Exposure, FloatArray | None]:
        """What the camera's control sets for a frame, after what it metered in this one and the ones before.

        The sensor's control follows with inertia, so each frame's exposure would depend on all before. Here it sees the
        last `_METERED_FRAMES` only, in small pictures, with the weights the inertia gives them. A real one has weights
        of its own, and factors (3,) for red, green and blue.
        """
        ages = np.arange(min(index + 1, _METERED_FRAMES))
        metered = [self._meter_of(index - int(age), eye) for age in ages]
        products_s = [product_s for product_s, _ in metered]
        if self.unit.realism is not None:
            control, period_s = self.unit.realism.control, 1 / self.rate_hz
            weights = response(control, period_s, _METERED_FRAMES)
            exposure = exposure_of(control, products_s, weights, self._sensor.highest_gain)
            return exposure, balance_of(control, np.array([color for _, color in metered]), period_s)
        aged = self._sensor.inertia**ages
        product_s = float(np.exp(np.average(np.log(products_s), weights=aged)))
        time_s = min(product_s, self._sensor.longest_s)
        return Exposure(time_s, product_s / time_s), None

    def _meter_of(self, index: int, eye: _Eye) -> tuple[float, FloatArray]:
        """Time times gain that a frame alone would ask for, and its mean colour; remembered for the next frames."""
        if index not in self._metered:
            taken_s = self.taken_s(index)
            height = self._camera.camera.height
            view = eye.look(self._meter, self.row_poses(taken_s)[height // 2], taken_s)
            radiance, _ = eye.radiance(view, taken_s, has_outlines=False)
            color = np.minimum(radiance, _BRIGHTEST).mean(axis=(0, 1))
            self._metered[index] = self._sensor.meter(radiance).product_s, np.asarray(color, float)
        return self._metered[index]


class _Eye:
    """A scene and its paint, for one frame at a time: people and doors in it are moved before each look."""

    def __init__(
        self, scene: Scene, settings: SimulationSettings, unit: CameraUnit, drive: Drive, has_robot: bool
    ) -> None:
        seed = settings.day_seed
        self._scene = scene
        self._painter = Painter(self._scene.geoms, self._scene.surfaces, settings.seed, light_seed=seed, threads=1)
        surfaces = [self._scene.surfaces[material] for material in self._scene.geoms.materials]
        self.infrared = np.array([surface.infrared for surface in surfaces])
        self.shine = np.array([surface.shine for surface in surfaces])
        self.distortion = unit.distortion(self.infrared * (1 - self.shine))
        self._lighting, realism = self._painter.lighting, unit.realism
        self._sun: Sunlight | None = None
        self._lights: Lights | None = None
        self._shadows: Shadows | None = None
        self._truth = drive.truth if has_robot else None
        if realism is not None:
            self._sun = Sunlight(realism.sunlight, self._scene, self._lighting.sun, stream(seed, "sunlight"))
            self._lights = Lights(realism.lights, drive.duration_s, stream(seed, "lights"))
            self._shadows = Shadows(realism.shadows, scene, self._lighting, has_robot=has_robot)

    def look(self, camera: PinholeCamera, T_world_camera: FloatArray, stamp_s: float) -> View:
        """What a camera sees at a time."""
        self._scene.move_to(stamp_s)
        return self._scene.cast(camera, T_world_camera)

    def radiance(self, view: View, stamp_s: float, *, has_outlines: bool) -> tuple[Float32Array, Float32Array | None]:
        """Radiance (H, W, 3) of the last look, and the sunlight (H, W) in it; with or without more rays at outlines."""
        level = 1.0
        if self._lights is not None:
            level = self._lights.level_at(stamp_s)
            self._painter.lighting = self._lights.lit(self._lighting, stamp_s)
        outlines = self._scene.outlines(view) if has_outlines else None
        radiance = self._painter.paint(view, outlines=outlines)
        if self._sun is None or self._shadows is None:
            return radiance, None
        kept = self._shadows.kept(view, level, self._T_world_base(stamp_s))
        sun = self._sun.on(view)
        radiance *= (kept + np.float32(self._sun.brightness) * sun)[..., None]
        return radiance, sun

    def _T_world_base(self, stamp_s: float) -> FloatArray | None:
        if self._truth is None:
            return None
        return np.asarray(self._truth.at(np.clip(stamp_s, *self._truth.stamps_s[[0, -1]]))[0])


def _times(count: int, rate_hz: float, realism: Realism | None, seed: int) -> FrameTimes:
    if realism is None:
        return exact_times(count, rate_hz)
    return frame_times(count, rate_hz, realism.stamps, stream(seed, "camera stamps"))


def _sensor(settings: SimulationSettings, unit: CameraUnit) -> ColorSensor:
    if unit.realism is None:
        return ColorSensor(motion_blur=settings.has_motion_blur)
    control = unit.realism.control
    level = float(stream(unit.seed, "exposure").uniform(*control.level))
    return ColorSensor(motion_blur=True, longest_s=control.longest_s, target=level)


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
