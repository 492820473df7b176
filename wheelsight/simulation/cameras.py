"""Which depth cameras can be simulated, with their sizes, lenses, shutters and sensors."""

from __future__ import annotations

from dataclasses import dataclass, replace

from wheelsight.calibration import DepthNoise
from wheelsight.errors import ConfigError
from wheelsight.geometry import PinholeCamera
from wheelsight.simulation.depth_sensors import DepthSensor, IdealDepth, StructuredLight, TimeOfFlight

_LARGEST_PX = 4096


@dataclass(frozen=True, slots=True)
class CameraModel:
    """A depth camera whose depth images are registered to its colour images.

    Attributes:
        name: what `--camera` calls it.
        description: one line for `--list`.
        camera: of colour and depth alike, without distortion: as drivers deliver registered images.
        rate_hz: frames a second.
        rolling_shutter_s: from the first row's time to the last row's; 0 for a global shutter.
        depth: how it measures.
        depth_noise: what its owner believes of that, for the calibration.
    """

    name: str
    description: str
    camera: PinholeCamera
    rate_hz: float
    rolling_shutter_s: float
    depth: DepthSensor
    depth_noise: DepthNoise

    @property
    def is_exact(self) -> bool:
        """Whether it has no errors at all: what remains of an error is then not the camera's."""
        return isinstance(self.depth, IdealDepth)

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
    return tuple(sorted(_MODELS))


def camera_model(name: str, size: tuple[int, int] | None = None) -> CameraModel:
    """A camera by its name; `size` (width, height) in pixels replaces its own.

    Raises:
        ConfigError: a name that is none, listing those there are, or an impossible size.
    """
    if name not in _MODELS:
        raise ConfigError(f"camera {name!r} is not known", fix=f"choose from {', '.join(camera_names())}")
    model = _MODELS[name]
    return model if size is None else model.resized(*size)


def _centred(width: int, height: int, focal_px: float) -> PinholeCamera:
    return PinholeCamera(width, height, focal_px, focal_px, (width - 1) / 2, (height - 1) / 2)


_MODELS = {
    model.name: model
    for model in (
        CameraModel(
            "ideal",
            "640×480, no noise, all pixels at once",
            _centred(640, 480, 586.0),
            rate_hz=30.0,
            rolling_shutter_s=0.0,
            depth=IdealDepth(),
            depth_noise=DepthNoise(constant_m=0.001, quadratic_per_m=0.0, near_m=0.05, far_m=20.0),
        ),
        # Khoshelham & Elberink's focal length: 57.3° × 44.5°. The shutter is the one that feature odometry finds in
        # recordings of two real cameras.
        CameraModel(
            "kinect-v1",
            "640×480, structured light, 0.8 to 3.5 m, rolling shutter",
            _centred(640, 480, 586.0),
            rate_hz=30.0,
            rolling_shutter_s=0.026,
            depth=StructuredLight(),
            depth_noise=DepthNoise(constant_m=0.001, quadratic_per_m=1.425e-3, near_m=0.45, far_m=10.0),
        ),
        # 70.0° × 60.2°: focal lengths of depth cameras read out of several units lie around 365.5 px. Depth is timed in
        # all pixels at once, and a frame has one set of rays, so that colour, registered to it, is of one moment too.
        CameraModel(
            "kinect-v2",
            "512×424, time of flight, 0.5 to 4.5 m, flying pixels at edges",
            _centred(512, 424, 365.5),
            rate_hz=30.0,
            rolling_shutter_s=0.0,
            depth=TimeOfFlight(),
            depth_noise=DepthNoise(constant_m=1.5e-3, quadratic_per_m=0.2e-3, near_m=0.5, far_m=8.0),
        ),
    )
}
