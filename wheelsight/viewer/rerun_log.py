"""RerunLog: shows a run to Rerun as it goes, and keeps nothing of it but where keyframes were shown last."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.estimates import Estimate
from wheelsight.events import Event, RgbdFrame
from wheelsight.geometry import FloatArray, IntArray
from wheelsight.keyframes import KeyframeId, KeyframeStore
from wheelsight.mapping.cloud import cloud_of
from wheelsight.pipeline.run_record import FrameRecord
from wheelsight.pipeline.track import UNITS, Track
from wheelsight.settings import ViewerSettings
from wheelsight.viewer import blueprint as at
from wheelsight.viewer.scene import LINE_PX, STATUS_COLOURS, Scene

_GREEN, _GREY = (0, 158, 115), (150, 150, 150)
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
        self._settings = settings
        cameras = [name for name in tracks if UNITS[name] == "frame"]  # type: ignore[index]
        self.chief = "joined" if "joined" in tracks else (cameras or list(tracks))[0]
        self._scene = Scene(stream, calibration, settings)
        self._rr = self._scene.rr
        self._last: dict[str, tuple[str, str]] = {}  # of each track: status, words
        self._positions: dict[str, FloatArray] = {}  # of the other tracks
        self._revision, self._shown = -1, 0
        self._loops: IntArray = np.zeros((0, 2), np.int64)
        for name in tracks:
            self._scene.name_states(name, STATUS_COLOURS)

    def step(self, event: Event, answers: Mapping[str, FrameRecord], tracks: Sequence[Track]) -> None:
        """Show what an event was answered with."""
        self._scene.begin(event.stamp_s)
        for track in tracks:
            if track.odometry in answers and track.last is not None:
                self._show_answer(track, track.last, answers[track.odometry])
        if isinstance(event, RgbdFrame):
            self._scene.show_images(event)

    def finish(self, tracks: Sequence[Track]) -> None:
        """Show the last keyframes, where loops have laid all of them, and the finished map."""
        for track in tracks:
            if track.odometry == self.chief and track.last is not None:
                self._scene.at(track.last.stamp_s)
                self._show_keyframes(track, until=None)
                self._show_surfels(track)

    def _show_answer(self, track: Track, estimate: Estimate, answer: FrameRecord) -> None:
        name = track.odometry
        self._scene.at(estimate.stamp_s)
        if estimate.T_odom_body is not None:
            self._show_pose(name, estimate.T_odom_body, estimate.T_map_odom)
        self._show_words(name, estimate, answer)
        if UNITS[name] == "frame" and not answer.is_skipped and answer.matches:
            self._log(f"{at.CURVES}/{name}/inliers", self._rr.Scalars(answer.inliers))
            self._log(f"{at.CURVES}/{name}/ms", self._rr.Scalars(_MS * answer.seconds))
        if name == self.chief:
            self._show_keyframes(track, until=-1)  # the last one may still be in the making

    def _show_pose(self, name: str, T_odom_body: FloatArray, T_map_odom: FloatArray) -> None:
        if name == self.chief:
            self._scene.show_robot(T_odom_body, T_map_odom)
            return
        place = f"{at.OTHERS}/{name}"
        self._log(f"{place}/body", self._scene.transform(T_odom_body))
        self._scene.show_way(f"{place}/trail", self._positions.get(name), T_odom_body[:3, 3], _GREY)
        self._positions[name] = T_odom_body[:3, 3]

    def _show_words(self, name: str, estimate: Estimate, answer: FrameRecord) -> None:
        """Status, and why; only where they change."""
        status, words = self._last.get(name, ("", ""))
        if status != estimate.status:
            self._scene.show_state(name, estimate.status)
        said = "; ".join(filter(None, [str(answer.reason or ""), answer.note, *answer.flags]))
        if said != words and said:
            self._log(f"{at.WORDS}/{name}", self._rr.TextLog(said, level="WARN"))
        self._last[name] = (str(estimate.status), said)

    def _show_keyframes(self, track: Track, until: int | None) -> None:
        """New ones with what they saw, and all where they lie once loops have moved some."""
        store = track.localizer.keyframes
        if store is None:
            return
        numbers = range(len(store))[:until]
        is_moved = store.revision != self._revision
        for number in numbers if is_moved else numbers[self._shown :]:
            self._log(f"{at.KEYFRAMES}/{number}", self._scene.transform(store.pose(KeyframeId(number))))
        for number in numbers[self._shown :]:
            self._show_points(store, KeyframeId(number))
        self._shown, self._revision = max(self._shown, len(numbers)), store.revision
        loops = None if track.localizer.loops is None else track.localizer.loops.kept
        if loops is not None and len(loops) and (is_moved or len(loops) != len(self._loops)):
            self._loops = loops
            ends = store.T_map_keyframe[loops][:, :, :3, 3]
            self._log(at.LOOPS, self._rr.LineStrips3D(ends, colors=_GREEN, radii=self._scene.px(LINE_PX)))

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
        self._log(
            f"{at.KEYFRAMES}/{number}/points", self._rr.Points3D(points, colors=colours, radii=self._scene.px(1.5))
        )

    def _show_surfels(self, track: Track) -> None:
        surfel_map = track.localizer.map
        cloud = None if surfel_map is None else cloud_of(partial(surfel_map.parts, "stable"), self._settings.map_points)
        if cloud is not None:
            radius_m = max(cloud.edge_m, 0.005) / 2
            self._log(at.SURFELS, self._rr.Points3D(cloud.position, colors=cloud.color, radii=radius_m))

    def _log(self, place: str, *what: Any) -> None:
        self._scene.log(place, *what)
