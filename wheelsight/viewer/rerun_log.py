"""RerunLog: shows a run to Rerun as it goes, and keeps nothing of it but where keyframes were shown last."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.estimates import Estimate, Status
from wheelsight.events import Event, RgbdFrame
from wheelsight.extras import needed
from wheelsight.geometry import FloatArray, IntArray, PinholeCamera, se3
from wheelsight.keyframes import KeyframeId, KeyframeStore
from wheelsight.mapping.cloud import cloud_of
from wheelsight.pipeline.run_record import FrameRecord
from wheelsight.pipeline.track import UNITS, Track
from wheelsight.settings import ViewerSettings
from wheelsight.viewer import blueprint as at

_DEPTH_UNITS_PER_M = 5000.0
_COLOURS = {
    Status.TRACKING: 0x009E73FF,
    Status.COASTING: 0xF0E442FF,
    Status.FAILING: 0xD55E00FF,
    Status.LOST: 0x992200FF,
    Status.INITIALIZING: 0x808080FF,
}
_ORANGE, _GREEN, _GREY = (230, 159, 0), (0, 158, 115), (150, 150, 150)
_LINE_PX = 2.0
_MS = 1e3


class RerunLog:
    """See the module. The robot, its keyframes and images are those of one track; of others the way is shown.

    Args:
        stream: Rerun's, which knows where to write.
        calibration: of the run.
        tracks: names of what the run follows.
        settings: see `ViewerSettings`.

    Attributes:
        chief: the track that is shown whole: what joins sensors, else a camera's, else the first.
    """

    def __init__(self, stream: Any, calibration: Calibration, tracks: Sequence[str], settings: ViewerSettings) -> None:
        self._rr, self._stream = needed("rerun"), stream
        self._calibration, self._settings = calibration, settings
        cameras = [name for name in tracks if UNITS[name] == "frame"]  # type: ignore[index]
        self.chief = "joined" if "joined" in tracks else (cameras or list(tracks))[0]
        self._start_s: float | None = None
        self._image_s = -np.inf
        self._last: dict[str, tuple[FloatArray, str, str]] = {}  # of each track: position, status, words
        self._T_map_odom: FloatArray | None = None
        self._revision, self._shown = -1, 0
        self._loops: IntArray = np.zeros((0, 2), np.int64)
        self._show_fixed(tracks)

    def step(self, event: Event, answers: Mapping[str, FrameRecord], tracks: Sequence[Track]) -> None:
        """Show what an event was answered with."""
        if self._start_s is None:
            self._start_s = event.stamp_s
            self._stream.send_property("recording", self._rr.AnyValues(start_s=event.stamp_s))
        for track in tracks:
            if track.odometry in answers and track.last is not None:
                self._show_answer(track, track.last, answers[track.odometry])
        if isinstance(event, RgbdFrame):
            self._show_images(event)

    def finish(self, tracks: Sequence[Track]) -> None:
        """Show the last keyframes, where loops have laid all of them, and the finished map."""
        for track in tracks:
            if track.odometry == self.chief and track.last is not None:
                self._at(track.last.stamp_s)
                self._show_keyframes(track, until=None)
                self._show_surfels(track)

    def _show_answer(self, track: Track, estimate: Estimate, answer: FrameRecord) -> None:
        name = track.odometry
        self._at(estimate.stamp_s)
        if estimate.T_odom_body is not None:
            self._show_pose(name, estimate.T_odom_body, estimate.T_map_odom)
        self._show_words(name, estimate, answer)
        if UNITS[name] == "frame" and not answer.is_skipped and answer.matches:
            self._log(f"{at.CURVES}/{name}/inliers", self._rr.Scalars(answer.inliers))
            self._log(f"{at.CURVES}/{name}/ms", self._rr.Scalars(_MS * answer.seconds))
        if name == self.chief:
            self._show_keyframes(track, until=-1)  # the last one may still be in the making

    def _show_pose(self, name: str, T_odom_body: FloatArray, T_map_odom: FloatArray) -> None:
        place, trail = at.ROBOT, at.TRAIL
        if name != self.chief:
            place, trail = f"{at.OTHERS}/{name}", f"{at.OTHERS}/{name}/trail"
        elif self._T_map_odom is None or (T_map_odom != self._T_map_odom).any():
            self._T_map_odom = np.array(T_map_odom)
            self._log(at.ODOM, self._transform(T_map_odom))
        self._log(place if name == self.chief else f"{place}/body", self._transform(T_odom_body))
        p, last = T_odom_body[:3, 3], self._last.get(name)
        if last is not None and np.isfinite(last[0]).all():
            colour = _ORANGE if name == self.chief else _GREY
            self._log(trail, self._rr.LineStrips3D([[last[0], p]], colors=colour, radii=self._px(_LINE_PX)))
        self._last[name] = (p, *(last[1:] if last is not None else ("", "")))

    def _show_words(self, name: str, estimate: Estimate, answer: FrameRecord) -> None:
        """Status, and why; only where they change."""
        p, status, words = self._last.get(name, (np.full(3, np.nan), "", ""))
        if status != estimate.status:
            self._log(f"{at.STATUS}/{name}", self._rr.StateChange(state=str(estimate.status)))
        said = "; ".join(filter(None, [str(answer.reason or ""), answer.note, *answer.flags]))
        if said != words and said:
            self._log(f"{at.WORDS}/{name}", self._rr.TextLog(said, level="WARN"))
        self._last[name] = (p, str(estimate.status), said)

    def _show_images(self, frame: RgbdFrame) -> None:
        rate_hz = self._settings.image_rate_hz
        if not rate_hz or frame.stamp_s - self._image_s < 1 / rate_hz - 1e-4:
            return
        self._image_s = frame.stamp_s
        self._at(frame.stamp_s)
        color = _narrowed(frame.color, self._settings.image_width_px, cv2.INTER_AREA)
        quality = [cv2.IMWRITE_JPEG_QUALITY, self._settings.jpeg_quality]
        jpeg = cv2.imencode(".jpg", np.ascontiguousarray(color[..., ::-1]), quality)[1].tobytes()
        self._log(at.COLOR, self._rr.EncodedImage(contents=jpeg, media_type="image/jpeg"))
        depth_m = _narrowed(frame.depth_m, self._settings.image_width_px, cv2.INTER_NEAREST)
        units = np.clip(np.rint(depth_m * _DEPTH_UNITS_PER_M), 0, np.iinfo(np.uint16).max).astype(np.uint16)
        png = cv2.imencode(".png", units)[1].tobytes()
        self._log(at.DEPTH, self._rr.EncodedDepthImage(png, media_type="image/png", meter=_DEPTH_UNITS_PER_M))

    def _show_keyframes(self, track: Track, until: int | None) -> None:
        """New ones with what they saw, and all where they lie once loops have moved some."""
        store = track.localizer.keyframes
        if store is None:
            return
        numbers = range(len(store))[:until]
        is_moved = store.revision != self._revision
        for number in numbers if is_moved else numbers[self._shown :]:
            self._log(f"{at.KEYFRAMES}/{number}", self._transform(store.pose(KeyframeId(number))))
        for number in numbers[self._shown :]:
            self._show_points(store, KeyframeId(number))
        self._shown, self._revision = max(self._shown, len(numbers)), store.revision
        loops = None if track.localizer.loops is None else track.localizer.loops.kept
        if loops is not None and len(loops) and (is_moved or len(loops) != len(self._loops)):
            self._loops = loops
            ends = store.T_map_keyframe[loops][:, :, :3, 3]
            self._log(at.LOOPS, self._rr.LineStrips3D(ends, colors=_GREEN, radii=self._px(_LINE_PX)))

    def _show_points(self, store: KeyframeStore, number: KeyframeId) -> None:
        if not self._settings.keyframe_points:
            return
        keyframe = store[number]
        depth_m, grey = keyframe.depth_m, keyframe.grey
        step = max(1, int(np.ceil(np.sqrt(depth_m.size / self._settings.keyframe_points))))
        rows, columns = np.indices(depth_m.shape)[:, ::step, ::step]
        v, u = rows.ravel(), columns.ravel()
        z = depth_m[v, u]
        v, u, z = v[z > 0], u[z > 0], z[z > 0]
        fx, fy, cx, cy = keyframe.intrinsics
        points = np.stack([(u - cx) / fx * z, (v - cy) / fy * z, z], axis=-1)
        colours = np.repeat(grey[v, u].astype(np.uint8)[:, None], 3, axis=1)
        self._log(f"{at.KEYFRAMES}/{number}/points", self._rr.Points3D(points, colors=colours, radii=self._px(1.5)))

    def _show_surfels(self, track: Track) -> None:
        surfel_map = track.localizer.map
        cloud = None if surfel_map is None else cloud_of(surfel_map.surfels("stable"), self._settings.map_points)
        if cloud is not None:
            radius_m = max(cloud.edge_m, 0.005) / 2
            self._log(at.SURFELS, self._rr.Points3D(cloud.position, colors=cloud.color, radii=radius_m))

    def _show_fixed(self, tracks: Sequence[str]) -> None:
        rr = self._rr
        self._log(at.MAP, rr.ViewCoordinates.FLU if self._has_base else rr.ViewCoordinates.RDF, static=True)
        self._log(at.ROBOT, rr.TransformAxes3D(0.3), static=True)
        states = {"values": [str(s) for s in _COLOURS], "colors": list(_COLOURS.values())}
        for name in tracks:
            self._log(f"{at.STATUS}/{name}", rr.StateConfiguration(**states), static=True)
        calibration = self._calibration
        if calibration.color is None or calibration.depth is None:
            return
        mount = np.eye(4) if calibration.T_base_camera is None else calibration.T_base_camera
        depth_color = np.eye(4) if calibration.T_color_depth is None else se3.invert(calibration.T_color_depth)
        self._log(at.CAMERA, self._transform(mount), static=True)
        for place, camera, T in (
            (at.COLOR, calibration.color, depth_color),
            (at.DEPTH, calibration.depth, np.eye(4)),
        ):
            self._log(place, self._transform(T), self._pinhole(camera), static=True)

    @property
    def _has_base(self) -> bool:
        return self._calibration.T_base_camera is not None or self._calibration.wheels is not None

    def _pinhole(self, camera: PinholeCamera) -> Any:
        scale = min(1.0, self._settings.image_width_px / camera.width)
        K = np.array([[camera.fx, 0, camera.cx + 0.5], [0, camera.fy, camera.cy + 0.5], [0, 0, 1 / scale]]) * scale
        size = [round(scale * camera.width), round(scale * camera.height)]
        return self._rr.Pinhole(image_from_camera=K, resolution=size, image_plane_distance=0.5)

    def _transform(self, T: FloatArray) -> Any:
        return self._rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3])

    def _px(self, width: float) -> Any:
        return self._rr.Radius.ui_points(width)

    def _at(self, stamp_s: float) -> None:
        self._stream.set_time(at.TIMELINE, duration=stamp_s - (self._start_s or 0.0))

    def _log(self, place: str, *what: Any, static: bool = False) -> None:
        self._stream.log(place, *what, static=static)


def _narrowed(image: Any, width: int, how: int) -> Any:
    if image.shape[1] <= width:
        return image
    return cv2.resize(image, (width, max(1, round(image.shape[0] * width / image.shape[1]))), interpolation=how)
