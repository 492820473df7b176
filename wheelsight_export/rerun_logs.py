"""RerunLog and DriveLog show a run, or a drive to goals, in Rerun: in a file, or in a viewer on this machine that
accepts only local connections. RerunScene holds what both share, with the blueprint of the viewer.
"""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from wheelsight.app.run.run_record import FrameRecord
from wheelsight.app.run.track import UNITS, RunTrack
from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import ConfigError
from wheelsight.core.estimates import Status
from wheelsight.core.files import check_name, output_error
from wheelsight.core.geometry import ByteArray, FloatArray, IntArray, se3
from wheelsight.core.keyframes import KeyframeId, KeyframeStore
from wheelsight.core.messages import Event, RgbdFrame
from wheelsight.core.runtime import needed
from wheelsight.core.settings import ViewerSettings
from wheelsight.mapping.plan import cloud_of
from wheelsight.navigation import (
    CellState,
    Costmap,
    Feedback,
    MonitorState,
    NavigationState,
    Navigator,
    Plan,
    StaticLayer,
    Transition,
)

_GREEN, _GREY = (0, 158, 115), (150, 150, 150)
_MS = 1e3
_IMAGE_WIDTH_PX, _JPEG_QUALITY = 320, 80  # wider images are reduced to it; of colour images


class RerunLog:
    """Shows a run in Rerun. Robot, keyframes and images are those of one track; the others show their paths.

    Args:
        stream: Rerun's recording stream.
        calibration: of the run.
        tracks: names of the run's tracks.
        settings: see `ViewerSettings`.

    Attributes:
        chief: the main track: joined sensors, else a camera's track, else the first.
    """

    def __init__(self, stream: Any, calibration: Calibration, tracks: Sequence[str], settings: ViewerSettings) -> None:
        self._settings = settings
        cameras = [name for name in tracks if UNITS[name] == "frame"]  # type: ignore[index]
        self.chief = "joined" if "joined" in tracks else (cameras or list(tracks))[0]
        self._scene = RerunScene(stream, calibration, settings)
        self._rr = self._scene.rr
        self._last: dict[str, tuple[str, str]] = {}  # of each track: status, words
        self._positions: dict[str, FloatArray] = {}  # of the other tracks
        self._revision, self._shown = -1, 0
        self._loops: IntArray = np.zeros((0, 2), np.int64)
        for name in tracks:
            self._scene.name_states(name, STATUS_COLOURS)

    def step(self, event: Event, answers: Mapping[str, FrameRecord], tracks: Sequence[RunTrack]) -> None:
        """Show the answers to an event."""
        self._scene.begin(event.stamp_s)
        for track in tracks:
            if track.odometry in answers and track.last is not None:
                estimate = track.last
                answer = answers[track.odometry]
                name = track.odometry
                self._scene.at(estimate.stamp_s)
                if estimate.T_odom_body is not None:
                    T_odom_body = estimate.T_odom_body
                    if name == self.chief:
                        self._scene.show_robot(T_odom_body, estimate.T_map_odom)
                    else:
                        place = f"{OTHERS}/{name}"
                        self._scene.log(f"{place}/body", self._scene.transform(T_odom_body))
                        self._scene.show_way(f"{place}/trail", self._positions.get(name), T_odom_body[:3, 3], _GREY)
                        self._positions[name] = T_odom_body[:3, 3]
                # Status and reason, if they change
                status, words = self._last.get(name, ("", ""))
                if status != estimate.status:
                    self._scene.show_state(name, estimate.status)
                said = "; ".join(filter(None, [str(answer.reason or ""), answer.note, *answer.flags]))
                if said != words and said:
                    self._scene.log(f"{WORDS}/{name}", self._rr.TextLog(said, level="WARN"))
                self._last[name] = (str(estimate.status), said)
                if UNITS[name] == "frame" and not answer.is_skipped and answer.matches:
                    self._scene.log(f"{CURVES}/{name}/inliers", self._rr.Scalars(answer.inliers))
                    self._scene.log(f"{CURVES}/{name}/ms", self._rr.Scalars(_MS * answer.seconds))
                if name == self.chief:
                    self._show_keyframes(track, until=-1)  # the last one may still be in the making
        if isinstance(event, RgbdFrame):
            self._scene.show_images(event)

    def finish(self, tracks: Sequence[RunTrack]) -> None:
        """Show the last keyframes, all keyframes after loop closing, and the finished map."""
        for track in tracks:
            if track.odometry == self.chief and track.last is not None:
                self._scene.at(track.last.stamp_s)
                self._show_keyframes(track, until=None)
                surfel_map = track.localizer.map
                cloud = (
                    None
                    if surfel_map is None
                    else cloud_of(partial(surfel_map.parts, "stable"), self._settings.map_points)
                )
                if cloud is not None:
                    radius_m = max(cloud.edge_m, 0.005) / 2
                    self._scene.log(SURFELS, self._rr.Points3D(cloud.position, colors=cloud.color, radii=radius_m))

    def _show_keyframes(self, track: RunTrack, until: int | None) -> None:
        """Show new keyframes with their points, and all poses after a loop has moved some."""
        store = track.localizer.keyframes
        if store is None:
            return
        numbers = range(len(store))[:until]
        is_moved = store.revision != self._revision
        for number in numbers if is_moved else numbers[self._shown :]:
            self._scene.log(f"{KEYFRAMES}/{number}", self._scene.transform(store.pose(KeyframeId(number))))
        for number in numbers[self._shown :]:
            self._show_points(store, KeyframeId(number))
        self._shown, self._revision = max(self._shown, len(numbers)), store.revision
        loops = None if track.localizer.loops is None else track.localizer.loops.accepted_loops
        if loops is not None and len(loops) and (is_moved or len(loops) != len(self._loops)):
            self._loops = loops
            ends = store.T_map_keyframe[loops][:, :, :3, 3]
            self._scene.log(LOOPS, self._rr.LineStrips3D(ends, colors=_GREEN, radii=self._scene.px(LINE_PX)))

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
        self._scene.log(
            f"{KEYFRAMES}/{number}/points", self._rr.Points3D(points, colors=colours, radii=self._scene.px(1.5))
        )


# As in all plans (Okabe & Ito 2008).
_BLUE, _PURPLE, _SKY = (0, 114, 178), (204, 121, 167), (86, 180, 233)
_FREE, _UNKNOWN, _WALL = (255, 255, 255), (200, 200, 200), (40, 40, 40)
_CHEAP, _COSTLY = np.array([255.0, 255, 255]), np.array([213.0, 94, 0])
_STATES = {
    NavigationState.IDLE: 0x808080FF,
    NavigationState.PLANNING: 0x56B4E9FF,
    NavigationState.DRIVING: 0x009E73FF,
    NavigationState.RECOVERING: 0xF0E442FF,
    NavigationState.ARRIVED: 0x0072B2FF,
    NavigationState.FAILED: 0xD55E00FF,
}
_MONITOR = {MonitorState.FREE: 0x009E73FF, MonitorState.SLOWED: 0xF0E442FF, MonitorState.STOPPED: 0xD55E00FF}
_LOCALIZATION, _NAVIGATOR, _MONITORED = "localization", "navigator", "monitor"
# Above each other, so that none hides another; the robot's way is in the plane itself.
_FLOOR_M, _COSTMAP_M, _LINES_M = -0.02, -0.01, 0.02


class DriveLog:
    """Shows a drive in Rerun. It has the poses of periods with a known place in the map."""

    def __init__(self, stream: Any, calibration: Calibration, settings: ViewerSettings) -> None:
        self._scene, self._settings = RerunScene(stream, calibration, settings), settings
        self._rr = self._scene.rr
        self._said: dict[str, str] = {}
        self._plan: Plan | None = None
        self._goal: FloatArray | None = None
        self._costmap: Costmap | None = None
        self._revision, self._maps_s = -1, -np.inf
        self._navigator: Navigator | None = None
        for name, colours in ((_LOCALIZATION, STATUS_COLOURS), (_NAVIGATOR, _STATES), (_MONITORED, _MONITOR)):
            self._scene.name_states(name, {str(state): colour for state, colour in colours.items()})

    def on_events(self, events: Sequence[Event]) -> None:
        """Show events of the robot's sensors."""
        for event in events:
            self._scene.begin(event.stamp_s)
            if isinstance(event, RgbdFrame):
                self._scene.show_images(event)

    def note(self, transition: Transition) -> None:
        """Show a change of the navigator's state."""
        self._scene.begin(transition.stamp_s)
        self._scene.at(transition.stamp_s)
        self._scene.log(f"{WORDS}/{_NAVIGATOR}", self._rr.TextLog(str(transition)))

    def step(self, feedback: Feedback, navigator: Navigator) -> None:
        """Show a control period."""
        self._scene.begin(feedback.stamp_s)
        self._scene.at(feedback.stamp_s)
        # A new map: nothing is known yet, and the path does not continue.
        if self._navigator is not None and navigator is not self._navigator:
            self._revision, self._costmap, self._maps_s = -1, None, -np.inf
            self._scene.end_way()
            for place in (FLOOR, COSTMAP):
                self._scene.log(place, self._rr.Clear(recursive=False))
        self._navigator = navigator
        odom_pose = navigator.senses.where.odom_pose
        if feedback.pose is not None and odom_pose is not None:
            self._scene.show_robot(se3.from_plane(*odom_pose), se3.from_plane(*navigator.senses.where.T_map_odom))
        curves = {"forward_m_s": feedback.forward_m_s, "turn_rad_s": feedback.turn_rad_s, "to_go_m": feedback.to_go_m}
        for name, value in curves.items():
            if value is not None:
                self._scene.log(f"{CURVES}/{name}", self._rr.Scalars(value))
        self._show_statuses(feedback)
        # Plan and goal if they change; the prediction of the controller
        if feedback.plan is not self._plan:
            self._plan = feedback.plan
            self._show_line(PLAN, None if self._plan is None else self._plan.poses, _BLUE)
        goal = feedback.goal
        if (goal is None) != (self._goal is None) or (goal is not None and (goal != self._goal).any()):
            self._goal = goal
            arrow = self._rr.Clear(recursive=False)
            if goal is not None:
                x, y, yaw = goal.tolist()
                ahead = [0.0, 0.0, 0.5] if np.isnan(yaw) else [0.5 * np.cos(yaw), 0.5 * np.sin(yaw), 0.0]
                arrow = self._rr.Arrows3D(origins=[[x, y, _LINES_M]], vectors=[ahead], colors=[_PURPLE])
            self._scene.log(GOAL, arrow)
        self._show_line(PREDICTED, feedback.predicted if len(feedback.predicted) else None, _SKY)
        self._show_maps(feedback.stamp_s, navigator)

    def _show_statuses(self, feedback: Feedback) -> None:
        """Show statuses that have changed."""
        monitor = feedback.monitor
        states = {_LOCALIZATION: str(feedback.status), _NAVIGATOR: str(feedback.state)}
        states |= {} if monitor is None else {_MONITORED: str(monitor.state)}
        for name, state in states.items():
            if self._has_changed(f"state of {name}", state):
                self._scene.show_state(name, state)
        why = "" if monitor is None or monitor.reason is None else str(monitor.reason)
        if self._has_changed("reason", why) and why:
            self._scene.log(f"{WORDS}/{_MONITORED}", self._rr.TextLog(why, level="WARN"))

    def _show_line(self, place: str, poses: FloatArray | None, colour: tuple[int, int, int]) -> None:
        if poses is not None:
            points = np.column_stack([poses[:, :2], np.full(len(poses), _LINES_M)])
            self._scene.log(place, self._rr.LineStrips3D([points], colors=[colour], radii=self._scene.px(LINE_PX)))
        elif self._said.get(place):
            self._scene.log(place, self._rr.Clear(recursive=False))
        self._said[place] = "" if poses is None else "there"

    def _show_maps(self, stamp_s: float, navigator: Navigator) -> None:
        """Show floor and local costmap if they have changed, at a limited rate."""
        rate_hz, senses = self._settings.costmap_rate_hz, navigator.senses
        if not rate_hz or stamp_s - self._maps_s < 1 / rate_hz - 1e-4:
            return
        self._maps_s = stamp_s
        if senses.floor.revision != self._revision:
            self._revision, floor = senses.floor.revision, senses.floor.layer
            # (H, W, 3); row 0 is the least y
            colours = np.full((*floor.state.shape, 3), _UNKNOWN, np.uint8)
            colours[floor.state == CellState.FREE] = _FREE
            colours[floor.state == CellState.OCCUPIED] = _WALL
            self._scene.log(FLOOR, self._texture(floor, colours, _FLOOR_M))
        local = senses.local()
        if local is not None and local is not self._costmap:
            self._costmap = local
            # (H, W, 3): from white (free) to orange (the centre of the robot cannot be here); lethal cells are dark.
            share = local.cost[..., None].astype(float)
            cost_colours = np.asarray(np.rint((1 - share) * _CHEAP + share * _COSTLY), np.uint8)
            cost_colours[local.is_lethal] = _WALL
            self._scene.log(COSTMAP, self._texture(local, cost_colours, _COSTMAP_M))

    def _texture(self, cells: StaticLayer | Costmap, colours: ByteArray, z_m: float) -> Any:
        """Cells as a textured rectangle in the map."""
        rows, columns = colours.shape[:2]
        x, y = cells.origin
        right, top = x + columns * cells.resolution_m, y + rows * cells.resolution_m
        return self._rr.Mesh3D(
            vertex_positions=[[x, y, z_m], [right, y, z_m], [right, top, z_m], [x, top, z_m]],
            triangle_indices=[[0, 1, 2], [0, 2, 3]],
            vertex_texcoords=[[0, 0], [1, 0], [1, 1], [0, 1]],
            albedo_texture=colours,
        )

    def _has_changed(self, name: str, said: str) -> bool:
        before, self._said[name] = self._said.get(name), said
        return before != said


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


class RerunScene:
    """Common entities of all logs. It keeps only what was shown last."""

    def __init__(self, stream: Any, calibration: Calibration, settings: ViewerSettings) -> None:
        self.rr, self._stream, self._settings = needed("rerun"), stream, settings
        self._start_s: float | None = None
        self._image_s = -np.inf
        self._T_map_odom: FloatArray | None = None
        self._position: FloatArray | None = None
        rr = self.rr
        has_base = calibration.T_base_camera is not None or calibration.any_wheels is not None
        self.log(MAP, rr.ViewCoordinates.FLU if has_base else rr.ViewCoordinates.RDF, static=True)
        self.log(ROBOT, rr.TransformAxes3D(0.3), static=True)
        if calibration.color is None or calibration.depth is None:
            return
        mount = np.eye(4) if calibration.T_base_camera is None else calibration.T_base_camera
        depth_color = np.eye(4) if calibration.T_color_depth is None else se3.invert(calibration.T_color_depth)
        self.log(CAMERA, self.transform(mount), static=True)
        for place, camera, T in ((COLOR, calibration.color, depth_color), (DEPTH, calibration.depth, np.eye(4))):
            scale = min(1.0, _IMAGE_WIDTH_PX / camera.width)
            K = np.array([[camera.fx, 0, camera.cx + 0.5], [0, camera.fy, camera.cy + 0.5], [0, 0, 1 / scale]]) * scale
            size = [round(scale * camera.width), round(scale * camera.height)]
            pinhole = self.rr.Pinhole(image_from_camera=K, resolution=size, image_plane_distance=0.5)
            self.log(place, self.transform(T), pinhole, static=True)

    def begin(self, stamp_s: float) -> None:
        """Begin the timeline at the first stamp."""
        if self._start_s is None:
            self._start_s = stamp_s
            self._stream.send_property("recording", self.rr.AnyValues(start_s=stamp_s))

    def at(self, stamp_s: float) -> None:
        """Set the time of what is logged next."""
        self._stream.set_time(TIMELINE, duration=stamp_s - (self._start_s or 0.0))

    def log(self, place: str, *what: Any, static: bool = False) -> None:
        """Log Rerun's archetypes at an entity."""
        self._stream.log(place, *what, static=static)

    def show_robot(self, T_odom_body: FloatArray, T_map_odom: FloatArray) -> None:
        """Show the robot (4, 4), a piece of its path, and odom (4, 4) after it has moved in the map."""
        if self._T_map_odom is None or (T_map_odom != self._T_map_odom).any():
            self._T_map_odom = np.array(T_map_odom)
            self.log(ODOM, self.transform(T_map_odom))
        self.log(ROBOT, self.transform(T_odom_body))
        self.show_way(TRAIL, self._position, T_odom_body[:3, 3], ROBOT_COLOUR)
        self._position = T_odom_body[:3, 3]

    def end_way(self) -> None:
        """Break the path here: the robot was carried, or the map changes."""
        self._position = None

    def show_way(self, place: str, begin: FloatArray | None, end: FloatArray, colour: tuple[int, int, int]) -> None:
        """Show a piece of a path, if it has a beginning."""
        if begin is not None:
            self.log(place, self.rr.LineStrips3D([[begin, end]], colors=[colour], radii=self.px(LINE_PX)))

    def show_images(self, frame: RgbdFrame) -> None:
        """Show colour and depth at the rate of the settings."""
        rate_hz = self._settings.image_rate_hz
        if not rate_hz or frame.stamp_s - self._image_s < 1 / rate_hz - 1e-4:
            return
        self._image_s = frame.stamp_s
        self.at(frame.stamp_s)
        color = _narrowed(frame.color, _IMAGE_WIDTH_PX, cv2.INTER_AREA)
        quality = [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY]
        jpeg = cv2.imencode(".jpg", np.ascontiguousarray(color[..., ::-1]), quality)[1].tobytes()
        self.log(COLOR, self.rr.EncodedImage(contents=jpeg, media_type="image/jpeg"))
        depth_m = _narrowed(frame.depth_m, _IMAGE_WIDTH_PX, cv2.INTER_NEAREST)
        units = np.clip(np.rint(depth_m * _DEPTH_UNITS_PER_M), 0, np.iinfo(np.uint16).max).astype(np.uint16)
        png = cv2.imencode(".png", units)[1].tobytes()
        self.log(DEPTH, self.rr.EncodedDepthImage(png, media_type="image/png", meter=_DEPTH_UNITS_PER_M))

    def name_states(self, name: str, colours: Mapping[str, int]) -> None:
        """Register the states of `show_state`, with colours 0xRRGGBBAA."""
        values, colors = [str(state) for state in colours], np.array(list(colours.values()), np.uint32)
        self.log(f"{STATUS}/{name}", self.rr.StateConfiguration(values=values, colors=colors), static=True)

    def show_state(self, name: str, state: str) -> None:
        """Show a state from now on."""
        self.log(f"{STATUS}/{name}", self.rr.StateChange(state=str(state)))

    def transform(self, T: FloatArray) -> Any:
        """Rerun's transform of (4, 4)."""
        return self.rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3])

    def px(self, width: float) -> Any:
        """A width in pixels of the screen."""
        return self.rr.Radius.ui_points(width)


def _narrowed(image: Any, width: int, how: int) -> Any:
    if image.shape[1] <= width:
        return image
    return cv2.resize(image, (width, max(1, round(image.shape[0] * width / image.shape[1]))), interpolation=how)


TIMELINE = "time"
MAP, ODOM, OTHERS = "map", "map/odom", "map/others"
ROBOT, TRAIL, KEYFRAMES, LOOPS, SURFELS = f"{ODOM}/robot", f"{ODOM}/trail", "map/keyframes", "map/loops", "map/surfels"
CAMERA = f"{ROBOT}/camera"
COLOR, DEPTH = f"{CAMERA}/color", f"{CAMERA}/depth"
FLOOR, COSTMAP, PLAN, GOAL, PREDICTED = "map/floor", "map/costmap", "map/plan", "map/goal", "map/predicted"
STATUS, CURVES, WORDS = "status", "curves", "words"


def _blueprint(trails: Sequence[str], curves: str) -> Any:
    """The blueprint of a log with these trails, which end at the shown moment."""
    rrb = needed("rerun.blueprint")
    until_now = rrb.VisibleTimeRange(
        TIMELINE, start=rrb.TimeRangeBoundary.infinite(), end=rrb.TimeRangeBoundary.cursor_relative()
    )
    overrides = {trail: rrb.VisibleTimeRanges([until_now]) for trail in trails}
    side = [
        rrb.Horizontal(rrb.Spatial2DView(origin=COLOR, name="Camera"), rrb.Spatial2DView(origin=DEPTH, name="Depth")),
        rrb.StateTimelineView(origin=STATUS, name="Status"),
        rrb.TimeSeriesView(origin=CURVES, name=curves),
        rrb.TextLogView(origin=WORDS, name="What was said"),
    ]
    view = rrb.Spatial3DView(origin=MAP, name="Map", overrides=overrides)
    return rrb.Blueprint(
        rrb.Horizontal(view, rrb.Vertical(*side, row_shares=[3, 1.5, 2, 1.5]), column_shares=[3, 2]),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="collapsed"),
    )


SPAWN = "spawn"
_APPLICATION = "wheelsight"
_LOOPBACK = "127.0.0.1"
_ADDRESS = "rerun+http://"
# A viewer that does not listen by then never will: one on a busy machine of two cores took 2 s.
_START_S = 20.0
VIEWER = (sys.executable, "-m", "rerun")


def is_file(target: str) -> bool:
    """Whether a target is a file rather than a viewer."""
    return target != SPAWN and not target.startswith(_ADDRESS)


@contextmanager
def open_rerun(
    target: str,
    calibration: Calibration,
    tracks: Sequence[str],
    settings: ViewerSettings | None = None,
    viewer: Sequence[str] = VIEWER,
) -> Iterator[RerunLog]:
    """A log of a run, for `watcher` of `run_each`. Closing it writes everything.

    Args:
        target: a file to write, .rrd; or "spawn": a new viewer, which stays after the run; or the address of a running
            one, rerun+http://….
        calibration: of the run.
        tracks: names of the run's tracks.
        settings: defaults if None.
        viewer: the command of Rerun's viewer.

    Raises:
        ConfigError: Rerun is not installed, or its viewer does not start.
        OutputError: the file cannot be written.
    """
    trails = [TRAIL, *(f"{OTHERS}/{name}/trail" for name in tracks)]
    with _opened(target, partial(_blueprint, trails, "Inliers and milliseconds"), viewer) as stream:
        yield RerunLog(stream, calibration, tracks, settings or ViewerSettings())


@contextmanager
def open_drive_log(
    target: str, calibration: Calibration, settings: ViewerSettings | None = None, viewer: Sequence[str] = VIEWER
) -> Iterator[DriveLog]:
    """A log of a drive to goals; arguments and errors as of `open_rerun`."""
    with _opened(target, partial(_blueprint, [TRAIL], "Speeds and way to go"), viewer) as stream:
        yield DriveLog(stream, calibration, settings or ViewerSettings())


@contextmanager
def _opened(target: str, blueprint: Callable[[], Any], viewer: Sequence[str]) -> Iterator[Any]:
    """Rerun's stream to a target."""
    # With one timeline, that of the recording
    rerun = needed("rerun")
    stream = rerun.RecordingStream(_APPLICATION)
    stream.set_log_time_enabled(False)
    stream.set_log_tick_enabled(False)
    if target == SPAWN:
        target, _ = start_viewer(viewer)
    if is_file(target):
        path = Path(target)
        layout = blueprint()
        check_name(path)
        try:
            with path.open("wb"):
                pass  # Rerun itself says nothing of a file that cannot be written
        except OSError as error:
            raise output_error(error, path) from error
        stream.save(path, default_blueprint=layout)
    else:
        stream.connect_grpc(target, default_blueprint=blueprint())
    try:
        yield stream
    finally:
        stream.flush()
        stream.disconnect()


def start_viewer(viewer: Sequence[str] = VIEWER) -> tuple[str, subprocess.Popen[bytes]]:
    """Start a viewer on loopback; returns its address and its process. Raises ConfigError."""
    with socket.socket() as found:
        found.bind((_LOOPBACK, 0))
        port = found.getsockname()[1]
    command = [*viewer, "--bind", _LOOPBACK, "--port", str(port), "--expect-data-soon"]
    try:
        # An environment in which the viewer sends no analytics. On Linux this variable is the folder of its settings.
        # The user's own settings stay unchanged; the viewer writes the file itself.
        folder = Path(tempfile.gettempdir()) / f"wheelsight-rerun-{os.getuid() if hasattr(os, 'getuid') else 0}"
        environment = {**os.environ, "XDG_CONFIG_HOME": str(folder)}
        done = subprocess.run([*viewer, "analytics", "disable"], env=environment, capture_output=True, check=False)
        if done.returncode:
            raise ConfigError("Rerun's viewer does not let its analytics be switched off", fix="--rerun FILE.rrd")
        process = subprocess.Popen(command, env=environment, start_new_session=True)
    except OSError as error:
        raise ConfigError(f"Rerun's viewer cannot be started: {error}", fix="--rerun FILE.rrd") from error
    deadline_s = time.monotonic() + _START_S
    while time.monotonic() < deadline_s and process.poll() is None:
        with contextlib.suppress(OSError), socket.create_connection((_LOOPBACK, port), timeout=1):
            return f"{_ADDRESS}{_LOOPBACK}:{port}/proxy", process
        time.sleep(0.05)
    process.kill()
    raise ConfigError("Rerun's viewer did not start: it needs a screen", fix="--rerun FILE.rrd, and open that later")
