"""Scene: what every log for Rerun shows alike: one timeline, the robot and its way, what its camera sees, statuses."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.estimates import Status
from wheelsight.events import RgbdFrame
from wheelsight.extras import needed
from wheelsight.geometry import FloatArray, PinholeCamera, se3
from wheelsight.settings import ViewerSettings
from wheelsight.viewer import blueprint as at

STATUS_COLOURS: Mapping[str, int] = {
    Status.TRACKING: 0x009E73FF,
    Status.COASTING: 0xF0E442FF,
    Status.FAILING: 0xD55E00FF,
    Status.LOST: 0x992200FF,
    Status.INITIALIZING: 0x808080FF,
}
ROBOT_COLOUR = (230, 159, 0)
LINE_PX = 2.0
_DEPTH_UNITS_PER_M = 5000.0


class Scene:
    """See the module. It keeps nothing but what was shown last.

    Args:
        stream: Rerun's, which knows where to write.
        calibration: of the robot.
        settings: see `ViewerSettings`.
    """

    def __init__(self, stream: Any, calibration: Calibration, settings: ViewerSettings) -> None:
        self.rr, self._stream, self._settings = needed("rerun"), stream, settings
        self._start_s: float | None = None
        self._image_s = -np.inf
        self._T_map_odom: FloatArray | None = None
        self._position: FloatArray | None = None
        self._show_fixed(calibration)

    def begin(self, stamp_s: float) -> None:
        """The timeline begins at the first stamp that is told."""
        if self._start_s is None:
            self._start_s = stamp_s
            self._stream.send_property("recording", self.rr.AnyValues(start_s=stamp_s))

    def at(self, stamp_s: float) -> None:
        """What is logged from now on is of this time."""
        self._stream.set_time(at.TIMELINE, duration=stamp_s - (self._start_s or 0.0))

    def log(self, place: str, *what: Any, static: bool = False) -> None:
        """Rerun's archetypes, at an entity."""
        self._stream.log(place, *what, static=static)

    def show_robot(self, T_odom_body: FloatArray, T_map_odom: FloatArray) -> None:
        """The robot (4, 4), a piece of its way, and odom (4, 4) where it has moved in the map."""
        if self._T_map_odom is None or (T_map_odom != self._T_map_odom).any():
            self._T_map_odom = np.array(T_map_odom)
            self.log(at.ODOM, self.transform(T_map_odom))
        self.log(at.ROBOT, self.transform(T_odom_body))
        self.show_way(at.TRAIL, self._position, T_odom_body[:3, 3], ROBOT_COLOUR)
        self._position = T_odom_body[:3, 3]

    def end_way(self) -> None:
        """What comes next of the robot's way does not go on from here: it is carried elsewhere, or in another map."""
        self._position = None

    def show_way(self, place: str, begin: FloatArray | None, end: FloatArray, colour: tuple[int, int, int]) -> None:
        """A piece of a way, if it has a begin."""
        if begin is not None:
            self.log(place, self.rr.LineStrips3D([[begin, end]], colors=[colour], radii=self.px(LINE_PX)))

    def show_images(self, frame: RgbdFrame) -> None:
        """Colour and depth, so many times a second as the settings say."""
        rate_hz = self._settings.image_rate_hz
        if not rate_hz or frame.stamp_s - self._image_s < 1 / rate_hz - 1e-4:
            return
        self._image_s = frame.stamp_s
        self.at(frame.stamp_s)
        color = _narrowed(frame.color, self._settings.image_width_px, cv2.INTER_AREA)
        quality = [cv2.IMWRITE_JPEG_QUALITY, self._settings.jpeg_quality]
        jpeg = cv2.imencode(".jpg", np.ascontiguousarray(color[..., ::-1]), quality)[1].tobytes()
        self.log(at.COLOR, self.rr.EncodedImage(contents=jpeg, media_type="image/jpeg"))
        depth_m = _narrowed(frame.depth_m, self._settings.image_width_px, cv2.INTER_NEAREST)
        units = np.clip(np.rint(depth_m * _DEPTH_UNITS_PER_M), 0, np.iinfo(np.uint16).max).astype(np.uint16)
        png = cv2.imencode(".png", units)[1].tobytes()
        self.log(at.DEPTH, self.rr.EncodedDepthImage(png, media_type="image/png", meter=_DEPTH_UNITS_PER_M))

    def name_states(self, name: str, colours: Mapping[str, int]) -> None:
        """The states that `show_state` will show, 0xRRGGBBAA each."""
        values, colors = [str(state) for state in colours], np.array(list(colours.values()), np.uint32)
        self.log(f"{at.STATUS}/{name}", self.rr.StateConfiguration(values=values, colors=colors), static=True)

    def show_state(self, name: str, state: str) -> None:
        """A state from now on."""
        self.log(f"{at.STATUS}/{name}", self.rr.StateChange(state=str(state)))

    def transform(self, T: FloatArray) -> Any:
        """Of (4, 4)."""
        return self.rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3])

    def px(self, width: float) -> Any:
        """A width on the screen."""
        return self.rr.Radius.ui_points(width)

    def _show_fixed(self, calibration: Calibration) -> None:
        rr = self.rr
        has_base = calibration.T_base_camera is not None or calibration.any_wheels is not None
        self.log(at.MAP, rr.ViewCoordinates.FLU if has_base else rr.ViewCoordinates.RDF, static=True)
        self.log(at.ROBOT, rr.TransformAxes3D(0.3), static=True)
        if calibration.color is None or calibration.depth is None:
            return
        mount = np.eye(4) if calibration.T_base_camera is None else calibration.T_base_camera
        depth_color = np.eye(4) if calibration.T_color_depth is None else se3.invert(calibration.T_color_depth)
        self.log(at.CAMERA, self.transform(mount), static=True)
        for place, camera, T in (
            (at.COLOR, calibration.color, depth_color),
            (at.DEPTH, calibration.depth, np.eye(4)),
        ):
            self.log(place, self.transform(T), self._pinhole(camera), static=True)

    def _pinhole(self, camera: PinholeCamera) -> Any:
        scale = min(1.0, self._settings.image_width_px / camera.width)
        K = np.array([[camera.fx, 0, camera.cx + 0.5], [0, camera.fy, camera.cy + 0.5], [0, 0, 1 / scale]]) * scale
        size = [round(scale * camera.width), round(scale * camera.height)]
        return self.rr.Pinhole(image_from_camera=K, resolution=size, image_plane_distance=0.5)


def _narrowed(image: Any, width: int, how: int) -> Any:
    if image.shape[1] <= width:
        return image
    return cv2.resize(image, (width, max(1, round(image.shape[0] * width / image.shape[1]))), interpolation=how)
