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
from wheelsight.geometry import FloatArray, PinholeCamera, se3
from wheelsight.simulation.appearance import Painter
from wheelsight.simulation.cameras import CameraModel
from wheelsight.simulation.color_sensor import ColorSensor, Exposure
from wheelsight.simulation.drive import Drive
from wheelsight.simulation.passersby import Passersby
from wheelsight.simulation.scene import Scene
from wheelsight.simulation.settings import SimulationSettings
from wheelsight.simulation.view import Outlines, View
from wheelsight.simulation.world import World

Result = TypeVar("Result")

_THREADS = 2
_STAMP_DECIMALS = 6
_STREAM = 17
_METERED_FRAMES = 12
_METER_SIZE = (32, 24)
_TWIST_S = 0.01


class Renderer:
    """Makes the RGB-D frames of a drive, the first at 0 s.

    Every frame has random numbers of its own, from the seed and its index, and depends on no other: rendered alone, in
    another order or by several threads, it is the same to the last bit.

    Args:
        world: what there is to see.
        drive: along whose truth the camera moves.
        settings: seed, robot, images a second, passers-by, motion blur.
        camera: the model, in the size wanted.

    Raises:
        ConfigError: the drive is too short for a single frame.
    """

    def __init__(self, world: World, drive: Drive, settings: SimulationSettings, camera: CameraModel) -> None:
        self._world, self._drive, self._settings, self._camera = world, drive, settings, camera
        self.rate_hz = settings.rate_hz or camera.rate_hz
        self.frame_count = int(np.floor((drive.duration_s - camera.rolling_shutter_s / 2) * self.rate_hz + 1e-9)) + 1
        if self.frame_count < 1:
            raise ConfigError(f"a drive of {drive.duration_s:.3f} s is too short for a frame")
        self._meter = camera.resized(*_METER_SIZE).camera
        self._sensor = ColorSensor(motion_blur=settings.has_motion_blur)
        self._passersby = (
            Passersby(world, drive, settings.passersby, settings.seed, settings.robot) if settings.passersby else None
        )
        self._products_s: dict[int, float] = {}
        self._idle_eyes: deque[_Eye] = deque()

    @property
    def calibration(self) -> Calibration:
        """Of the camera alone, as its maker gives it."""
        camera = self._camera
        return Calibration.registered_camera(
            camera.camera,
            depth_noise=camera.depth_noise,
            rolling_shutter_s=camera.rolling_shutter_s,
            source=camera.name,
        )

    def stamp_s(self, index: int) -> float:
        """The time of a frame's middle row."""
        return round(index / self.rate_hz, _STAMP_DECIMALS)

    def row_poses(self, stamp_s: float) -> FloatArray:
        """(H, 4, 4) T_world_camera as each row of a frame is read; before the drive begins the robot stands."""
        height, shutter_s = self._camera.camera.height, self._camera.rolling_shutter_s
        rows_s = stamp_s + shutter_s * np.linspace(-0.5, 0.5, height) if shutter_s else np.array([stamp_s])
        truth = self._drive.truth
        T_world_base = truth.at(rows_s.clip(truth.stamps_s[0], truth.stamps_s[-1]))
        return np.broadcast_to(se3.compose(T_world_base, self._settings.robot.T_base_camera), (height, 4, 4))

    def frame(self, index: int) -> RgbdFrame:
        """One frame, the same whatever was rendered before. Safe to be called by several threads at a time."""
        try:
            eye = self._idle_eyes.pop()
        except IndexError:
            eye = _Eye(self._world, self._passersby, self._settings.seed)
        try:
            return self._frame(index, eye)
        finally:
            self._idle_eyes.append(eye)

    def frames(self) -> Generator[RgbdFrame]:
        """All frames in order, two of them made at a time while the caller is busy with the one before."""
        yield from in_order(self.frame, self.frame_count, _THREADS)

    def _frame(self, index: int, eye: _Eye) -> RgbdFrame:
        stamp_s = self.stamp_s(index)
        depth_rng, color_rng = np.random.default_rng([self._settings.seed, _STREAM, index]).spawn(2)
        exposure = self._exposure(index, eye)
        view = eye.look(self._camera.camera, self.row_poses(stamp_s), stamp_s)
        radiance = eye.painter.paint(view, outlines=eye.outlines(view))
        depth_m = self._camera.depth.measure(view, self._camera.camera, eye.infrared, eye.shine, depth_rng)
        twist = self._twist(stamp_s) if self._sensor.motion_blur else None
        color = self._sensor.expose(radiance, view, exposure, color_rng, twist)
        return RgbdFrame(stamp_s, color, depth_m, index)

    def _exposure(self, index: int, eye: _Eye) -> Exposure:
        """What the camera's control sets for a frame, after what it metered in this one and the ones before.

        The sensor's control follows with inertia, so each frame's exposure would depend on all before. Here it sees the
        last `_METERED_FRAMES` only, in small pictures, with the weights the inertia gives them.
        """
        ages = np.arange(min(index + 1, _METERED_FRAMES))
        weights = self._sensor.inertia**ages
        products_s = [self._metered_s(index - int(age), eye) for age in ages]
        product_s = float(np.exp(np.average(np.log(products_s), weights=weights)))
        time_s = min(product_s, self._sensor.longest_s)
        return Exposure(time_s, product_s / time_s)

    def _metered_s(self, index: int, eye: _Eye) -> float:
        """Time times gain that a frame alone would ask for; remembered, for the next frames ask again."""
        if index not in self._products_s:
            stamp_s = self.stamp_s(index)
            height = self._camera.camera.height
            view = eye.look(self._meter, self.row_poses(stamp_s)[height // 2], stamp_s)
            self._products_s[index] = self._sensor.meter(eye.painter.paint(view)).product_s
        return self._products_s[index]

    def _twist(self, stamp_s: float) -> FloatArray:
        """(6,) velocity (v, ω) of the camera in its own frame, m/s and rad/s."""
        truth = self._drive.truth
        ends_s = np.clip([stamp_s - _TWIST_S / 2, stamp_s + _TWIST_S / 2], truth.stamps_s[0], truth.stamps_s[-1])
        before, after = se3.compose(truth.at(ends_s), self._settings.robot.T_base_camera)
        return np.asarray(se3.log(se3.compose(se3.invert(before), after)) / (ends_s[1] - ends_s[0]))


class _Eye:
    """A scene and its paint, for one frame at a time: people in it are moved before each look."""

    def __init__(self, world: World, passersby: Passersby | None, seed: int) -> None:
        self._scene = Scene(world, passersby, threads=1)
        self.painter = Painter(self._scene.geoms, self._scene.surfaces, seed, threads=1)
        surfaces = [self._scene.surfaces[material] for material in self._scene.geoms.materials]
        self.infrared = np.array([surface.infrared for surface in surfaces])
        self.shine = np.array([surface.shine for surface in surfaces])

    def look(self, camera: PinholeCamera, T_world_camera: FloatArray, stamp_s: float) -> View:
        """What a camera sees at a time."""
        self._scene.move_to(stamp_s)
        return self._scene.cast(camera, T_world_camera)

    def outlines(self, view: View) -> Outlines:
        """More rays through the pixels at outlines of the last look."""
        return self._scene.outlines(view)


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
