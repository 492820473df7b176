"""Simulated depth cameras. `CameraUnit` is one of a model, with its own errors; `Carriage` gives its true pose."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.core.calibration_parts import DepthNoise
from wheelsight.core.errors import ConfigError
from wheelsight.core.geometry import ByteArray, Float32Array, FloatArray, PinholeCamera, se3
from wheelsight.core.inputs import read_yaml
from wheelsight.core.trajectory import Trajectory
from wheelsight_sim import depth_sensor
from wheelsight_sim.body_motion import BodyMotion, LiveBodyMotion, mounted
from wheelsight_sim.color_sensor import Lens, as_delivered, lens_of
from wheelsight_sim.robot import RobotModel
from wheelsight_sim.scene import View
from wheelsight_sim.settings import Realism, refuse_unknown, stream
from wheelsight_sim.world import World

_LARGEST_PX = 4096


@dataclass(frozen=True, slots=True)
class CameraModel:
    """A depth camera whose depth images are registered to its colour images.

    `camera` is of colour and depth alike, without distortion: as drivers deliver registered images. The rolling shutter
    takes from the first row's time to the last row's. `depth_noise` is what the owner believes of `depth`.
    """

    name: str
    description: str
    camera: PinholeCamera
    rate_hz: float
    rolling_shutter_s: float
    depth: depth_sensor.DepthSensor
    depth_noise: DepthNoise

    @property
    def is_exact(self) -> bool:
        """Whether it has no errors at all: what remains of an error is then not the camera's."""
        return isinstance(self.depth, depth_sensor.IdealDepth)

    def resized(self, width: int, height: int) -> CameraModel:
        """The same camera with other pixels over the same field of view.

        What sensors say in pixels is in pixels of the native image, and they scale it by the focal length.

        Raises:
            ConfigError: a size no image has.
        """
        if not (1 <= width <= _LARGEST_PX and 1 <= height <= _LARGEST_PX):
            raise ConfigError(f"images of {width}×{height} pixels cannot be made", fix=f"1 to {_LARGEST_PX} each way")
        c = self.camera
        a, b = width / c.width, height / c.height
        # Pixel centres lie at integers: an image's edge is at -0.5, and that is what must stay.
        lens = PinholeCamera(
            width, height, c.fx * a, c.fy * b, (c.cx + 0.5) * a - 0.5, (c.cy + 0.5) * b - 0.5, c.distortion
        )
        return replace(self, camera=lens)


def camera_names() -> tuple[str, ...]:
    """Of the cameras there are, sorted."""
    return tuple(sorted(_models()))


def camera_model(name: str, size: tuple[int, int] | None = None) -> CameraModel:
    """A camera by its name; `size` (width, height) in pixels replaces its own.

    Raises:
        ConfigError: a name that is none, listing those there are, or an impossible size.
    """
    refuse_unknown(name, camera_names(), f"camera {name!r} is not known")
    model = _models()[name]
    return model if size is None else model.resized(*size)


_SENSORS: dict[str, depth_sensor.DepthSensor] = {
    "ideal": depth_sensor.IdealDepth(),
    "kinect-v1": depth_sensor.StructuredLight(),
    "kinect-v2": depth_sensor.TimeOfFlight(),
    "realsense-d455": depth_sensor.StructuredLight(446.8, 0.095, 32.0, 1.9e-3, near_m=0.4, edge_sigma_px=0.5),
}


@cache
def _models() -> dict[str, CameraModel]:
    """The cameras of `cameras.yaml`, whose principal points are the middles of their images."""
    found = {}
    for name, of in read_yaml(Path(__file__).with_name("cameras.yaml"), ConfigError).items():
        (width, height), focal_px = of["size"], of["focal_px"]
        camera = PinholeCamera(width, height, focal_px, focal_px, (width - 1) / 2, (height - 1) / 2)
        rates, noise = (of["rate_hz"], of["rolling_shutter_s"]), DepthNoise(**of["depth_noise"])
        found[name] = CameraModel(name, of["description"], camera, *rates, _SENSORS[name], noise)
    return found


@dataclass(frozen=True, slots=True, eq=False)
class CameraUnit:
    """A camera of a model in the size wanted, with the errors that its seed gives it.

    `realism` is None where there are no errors but the sensors' noise, `registration` where depth fits to colour.
    """

    model: CameraModel
    lens: Lens
    realism: Realism | None
    registration: depth_sensor.Registration | None
    seed: int

    def distortion(self, scattered: FloatArray) -> depth_sensor.DepthDistortion | None:
        """Of depth, among geoms that scatter the shares (G,) of infrared light; None where there is none."""
        if self.realism is None:
            return None
        rng = stream(self.seed, "depth distortion")
        if isinstance(self.model.depth, depth_sensor.StructuredLight):
            return depth_sensor.DisparityDistortion(depth_sensor.DisparityDistortionSettings(), self.lens.true, rng)
        if isinstance(self.model.depth, depth_sensor.TimeOfFlight):
            return depth_sensor.PhaseDistortion(depth_sensor.PhaseDistortionSettings(), self.lens.true, scattered, rng)
        return None

    def seen_by_depth(
        self,
        view: View,
        sun: Float32Array | None,
        distortion: depth_sensor.DepthDistortion | None,
        twist: FloatArray,
        stamp_s: float,
    ) -> View:
        """What the depth sensor has to measure, whose colour image shows `view`, in sunlight `sun` (H, W)."""
        if self.registration is None or self.realism is None:
            return view
        seen = self.registration.seen_by_depth(view, twist, stamp_s)
        depth_m = seen.depth_m if distortion is None else distortion.distorted(seen)
        geom = seen.geom
        if sun is not None:
            blinded = sun > self.realism.sunlight.blinds_from
            depth_m, geom = np.where(blinded, np.float32(0), depth_m), np.where(blinded, np.int32(-1), geom)
        return View(depth_m, geom, seen.normal_world, seen.T_world_camera, seen.rays)

    def delivered(self, color: ByteArray) -> ByteArray:
        """A colour image (H, W, 3) as the host gets it."""
        return color if self.realism is None else as_delivered(color, self.realism.pixels)


def unit_of(model: CameraModel, realism: Realism | None, seed: int) -> CameraUnit:
    """The unit of a camera that a seed gives. A model without noise has no errors of its own either."""
    if realism is None or model.is_exact:
        return CameraUnit(model, Lens(model.camera, model.camera), None, None, seed)
    lens = lens_of(model.camera, realism.lens, stream(seed, "lens"))
    registration = depth_sensor.Registration(realism.registration, model.camera.width, stream(seed, "registration"))
    return CameraUnit(model, lens, realism, registration, seed)


_TWIST_S = 0.01


class Moment(NamedTuple):
    """Poses (N, 4, 4) as rows are read, the camera's velocity (v, ω) in its own frame, and the base's pose."""

    T_world_camera: FloatArray
    twist: FloatArray
    T_world_base: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Carriage:
    """A camera on a robot: T_world_base, the true mount (4, 4) of a body at rest, and how that moves, if it does."""

    truth: Trajectory
    T_base_camera: FloatArray
    body: BodyMotion | LiveBodyMotion | None = None

    def at(self, stamps_s: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """T_world_base and T_world_camera (N, 4, 4) at times (N,); before the drive and after it the robot stands."""
        within_s = np.atleast_1d(np.clip(stamps_s, self.truth.stamps_s[0], self.truth.stamps_s[-1]))
        T_world_base = self.truth.at(within_s)
        if self.body is None:
            return T_world_base, np.asarray(se3.compose(T_world_base, self.T_base_camera))
        T_base_camera = se3.compose(self.body.T_base_body(within_s), self.T_base_camera)
        return T_world_base, np.asarray(se3.compose(T_world_base, T_base_camera))

    def T_world_camera(self, stamps_s: ArrayLike) -> FloatArray:
        """(N, 4, 4) at times (N,), as `at` has it."""
        return self.at(stamps_s)[1]

    def moment(self, rows_s: FloatArray, stamp_s: float) -> Moment:
        """The moment of a frame whose middle row is read at a time, and its rows at times (N,)."""
        # In one go: interpolation takes as long for a pose as for hundreds.
        ends_s = np.clip(
            [stamp_s - _TWIST_S / 2, stamp_s + _TWIST_S / 2], self.truth.stamps_s[0], self.truth.stamps_s[-1]
        )
        T_world_base, T_world_camera = self.at(np.concatenate([rows_s, ends_s, [stamp_s]]))
        before, after = T_world_camera[-3:-1]
        twist = np.asarray(se3.log(se3.compose(se3.invert(before), after)) / (ends_s[1] - ends_s[0]))
        return Moment(T_world_camera[:-3], twist, T_world_base[-1])


def carriage_of(truth: Trajectory, world: World, robot: RobotModel, realism: Realism | None, seed: int) -> Carriage:
    """How a robot carries its camera along a drive."""
    if realism is None:
        return Carriage(truth, robot.T_base_camera)
    floor = realism.floor_of(world, seed)
    body = BodyMotion(truth, robot, floor, realism.body, stream(seed, "body"))
    return Carriage(truth, mounted(robot.T_base_camera, realism.mount, stream(seed, "mount")), body)
