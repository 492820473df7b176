"""The known map that a run is to find itself in. Says what its own map comes to, with plan and views."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from wheelsight.app.run.run_record import MapPicture, MapRecord
from wheelsight.config import Config
from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import ConfigError, MapError
from wheelsight.core.estimates import Estimate
from wheelsight.core.geometry import BoolArray, ByteArray, Float32Array, FloatArray, PinholeCamera, se3
from wheelsight.core.keyframes import KeyframeId
from wheelsight.core.messages import RgbdFrame
from wheelsight.core.trajectory import Trajectory
from wheelsight.mapping import SurfelMap
from wheelsight.mapping.export import Plan, cloud_of, plan_of, upward
from wheelsight.mapping.surfels import Parts
from wheelsight.places.recognition import Recognizer
from wheelsight.slam.loop_closing import ClosedLoops, corrected_by
from wheelsight.slam.maps import MapFolder, find_map, lie_together
from wheelsight.slam.place_recognition import KnownMap

# What a run's map comes to: how it stands, its plan, and views along the way.


MAP_FILE = "map.surfels"
_WIDTHS_PX = (640, 320, 160)
_FAR_M = 100.0
# A plan is cut so far above the camera: lamps and shelves that hang there would hide the floor.
_ABOVE_CAMERA_M = 0.3
_WHITE = 255.0


@dataclass(frozen=True, slots=True, eq=False)
class Stop:
    """A frame from whose pose in the map, T_map_camera (4, 4), the finished map is to be looked at."""

    stamp_s: float
    color: ByteArray
    T_map_camera: FloatArray


@dataclass
class Stops:
    """A few frames, evenly spread over a recording: those at or after `due` indices that have a pose.

    Attributes:
        due: indices.
        found: the frames.
        stamps_s: of all frames that have a pose.
        T_map_body: their poses (4, 4) in the map.
        T_odom_map: (4, 4) where the map lay at each of these frames in the frame of the trajectory, by what was known
            then.
    """

    due: list[int]
    found: list[Stop] = field(default_factory=list)
    stamps_s: list[float] = field(default_factory=list)
    T_map_body: list[FloatArray] = field(default_factory=list)
    T_odom_map: list[FloatArray] = field(default_factory=list)

    def look(
        self, frame: RgbdFrame, estimate: Estimate, T_odom_map: FloatArray, T_base_camera: FloatArray | None
    ) -> None:
        """Keep where a frame is, if its pose is known, and all of it if one is due."""
        if estimate.T_odom_body is None:
            return
        T_map_body = se3.invert(T_odom_map) @ estimate.T_odom_body
        self.stamps_s.append(frame.stamp_s)
        self.T_map_body.append(T_map_body)
        self.T_odom_map.append(estimate.T_filter_odom @ T_odom_map)
        if not self.due or frame.index < self.due[0]:
            return
        self.found.append(Stop(frame.stamp_s, frame.color, camera_of(T_map_body, T_base_camera)))
        self.due = [index for index in self.due if index > frame.index]

    def lay(self, surfel_map: SurfelMap) -> None:
        """Move the finished map, and all poses in it, to where the whole trajectory has them.

        Beside wheels, poses are corrected on the way and the map is not: it lies a little elsewhere at each frame. What
        is written is laid to the mean of that, which is nearer to the trajectory than where it lay first or last.
        """
        if not self.T_odom_map or all((np.eye(4) == T).all() for T in self.T_odom_map):
            return
        T_new_old = _mean_motion(np.array(self.T_odom_map), np.array(self.T_map_body))
        surfel_map.move(T_new_old)
        self.T_map_body = [T_new_old @ T for T in self.T_map_body]
        self.found = [replace(stop, T_map_camera=T_new_old @ stop.T_map_camera) for stop in self.found]
        self.T_odom_map = [np.eye(4)] * len(self.T_map_body)

    def follow(self, closed: ClosedLoops) -> None:
        """Put all poses to where loops have them at the end, as the map is; those drop out that lie nobody knows where.

        The map itself stays: its keyframes lie where the corrected trajectory has them.
        """
        if not (self.stamps_s and len(closed.stamps_s)):
            return
        T_odom_body = np.array(self.T_odom_map) @ np.array(self.T_map_body)
        corrected = corrected_by(closed, Trajectory(np.array(self.stamps_s), T_odom_body)).corrected
        old = dict(zip(self.stamps_s, self.T_map_body, strict=True))
        new = dict(zip(corrected.stamps_s.tolist(), corrected.T_frame_body, strict=True))
        self.found = [
            replace(stop, T_map_camera=new[stop.stamp_s] @ se3.invert(old[stop.stamp_s]) @ stop.T_map_camera)
            for stop in self.found
            if stop.stamp_s in new
        ]
        self.stamps_s, self.T_map_body = list(new), list(new.values())
        self.T_odom_map = [np.eye(4)] * len(new)


def _mean_motion(T_odom_map: FloatArray, T_map_body: FloatArray) -> FloatArray:
    """The motion (4, 4) that brings poses (N, 4, 4) nearest to where motions (N, 4, 4), each its own, bring them."""
    R = Rotation.from_matrix(T_odom_map[:, :3, :3]).mean().as_matrix()
    p_odom, p_map = (T_odom_map @ T_map_body)[:, :3, 3], T_map_body[:, :3, 3]
    return se3.from_parts(R, (p_odom - p_map @ R.T).mean(axis=0))


def map_record_of(
    surfel_map: SurfelMap,
    stops: Sequence[Stop],
    T_map_body: FloatArray,
    calibration: Calibration,
    cloud_points: int = 0,
) -> MapRecord:
    """The record of a run's map.

    Args:
        surfel_map: as it is at the end.
        stops: where to look at it from.
        T_map_body: (n, 4, 4) of the whole way, in the map.
        calibration: tells the colour camera, and which way is up where it has `T_base_camera`.
        cloud_points: how many points of it at most a page is to turn.
    """
    is_levelled = calibration.T_base_camera is not None
    pictures = tuple(MapPicture(stop.stamp_s, stop.color, _seen(surfel_map, stop, calibration)) for stop in stops)
    status = surfel_map.status()
    surest = partial(surfel_map.parts, "stable" if status.stable else "all")
    plan = _plan(surest, T_map_body, calibration) if status.surfels else None
    return MapRecord(status, surfel_map.frames, MAP_FILE, plan, pictures, is_levelled, cloud_of(surest, cloud_points))


def camera_of(T_map_body: FloatArray, T_base_camera: FloatArray | None) -> FloatArray:
    """T_map_camera (..., 4, 4) of a body that is the base where `T_base_camera` is known, else the camera."""
    return T_map_body if T_base_camera is None else T_map_body @ T_base_camera


def _plan(parts: Parts, T_map_body: FloatArray, calibration: Calibration) -> Plan | None:
    if not len(T_map_body):
        return None
    T_map_camera = camera_of(T_map_body, calibration.T_base_camera)
    up = np.array([0.0, 0.0, 1.0])
    if calibration.T_base_camera is None:
        up = upward(parts, T_map_camera[0, :3, :3])
    below_m = float((T_map_camera[:, :3, 3] @ up).max()) + _ABOVE_CAMERA_M
    # x points forward from where a base was, and to the right from where a camera was.
    return plan_of(parts, up, below_m, T_map_body[:, :3, 3], right=np.array([1.0, 0.0, 0.0]))


def _seen(surfel_map: SurfelMap, stop: Stop, calibration: Calibration) -> ByteArray:
    """The map (h, w, 3) uint8 as the colour camera, free of distortion, would show it; white where it has nothing.

    Pixels that fall between surfels, which may have been seen from farther off, are those of a coarser view.
    """
    camera, _ = calibration.cameras
    T_map_color = stop.T_map_camera
    if calibration.T_color_depth is not None:
        T_map_color = T_map_color @ se3.invert(calibration.T_color_depth)
    fine, *coarser = (_rendered(surfel_map, T_map_color, camera, width) for width in _WIDTHS_PX)
    for image in coarser:
        wider = cv2.resize(image, (fine.shape[1], fine.shape[0]), interpolation=cv2.INTER_NEAREST)
        fine = np.where(fine < 0, wider, fine)
    return np.asarray(np.clip(np.rint(np.where(fine < 0, _WHITE, fine)), 0, 255), np.uint8)


def _rendered(surfel_map: SurfelMap, T_map_color: FloatArray, camera: PinholeCamera, width: int) -> Float32Array:
    """(h, width, 3) from 0 to 255, grey where colour is unknown, -1 where the map has nothing."""
    scale = width / camera.width
    # Pixel centres lie at integers, so that an image begins half a pixel before its first.
    cx, cy = scale * (np.array([camera.cx, camera.cy]) + 0.5) - 0.5
    intrinsics = np.array([scale * camera.fx, scale * camera.fy, cx, cy])
    shape = (max(1, round(scale * camera.height)), width)
    view = surfel_map.render(T_map_color, intrinsics, shape, far_m=_FAR_M)
    image = np.where(view.color[..., :1] < 0, view.grey[..., None], view.color)
    return np.where(view.depth_m[..., None] > 0, image, np.float32(-1))


# The map of before in which a run is to find itself: opened, checked, and made ready to be recognised.


def open_known(
    calibration: Calibration, config: Config, on_keyframe: Callable[[int, int], None] = lambda done, total: None
) -> tuple[KnownMap, MapFolder] | None:
    """The map that settings name, and its folder; None where they name none.

    Keyframes that damage took, or of which nobody knows how they lie to the others, are not recognised.

    Args:
        calibration: of the robot: its camera has to be the map's.
        config: of the run.
        on_keyframe: called with how many codes are made, and of how many, where their file is missing.

    Raises:
        MapError: it is none, damaged, of another camera or version, or written by another run.
        ConfigError: a start is given, and the calibration does not say where the camera sits.
        OutputError: it is to be extended and cannot be written.
    """
    given = config.known_map
    if given.path is None:
        return None
    folder = MapFolder.open(find_map(given.path), read_only=not given.extend, settings=config.sessions)
    try:
        folder.check_camera(calibration, config.recording.depth_factor)
        together = lie_together(folder)
        if not together.any():
            raise MapError("has no keyframes", path=folder.path, fix="make a map by a run with --map surfels")
        recognizer = _of_these(folder.recognizer(config.recognition, on_keyframe), folder, together, config)
        start = _start(calibration, config)
        edges = folder.edges if given.extend else ()
        return KnownMap(folder.store, recognizer, edges, *start), folder
    except BaseException:
        folder.close()
        raise


def _of_these(found: Recognizer, folder: MapFolder, together: BoolArray, config: Config) -> Recognizer:
    """The recognizer, of keyframes that lie together alone."""
    if all(together[number] for number in found.keyframes):
        return found
    made = Recognizer(config.recognition)
    for number in np.flatnonzero(together):
        made.add(KeyframeId(int(number)), folder.store[KeyframeId(int(number))])
    return made


def _start(calibration: Calibration, config: Config) -> tuple[FloatArray | None, FloatArray | None]:
    """T_map_camera where the drive begins, and its covariance; None where nobody says."""
    given = config.known_map
    if given.start is None:
        return None, None
    if calibration.T_base_camera is None:
        problem = "--start says where the base is, and the calibration does not say where the camera sits on it"
        raise ConfigError(problem, fix="wheelsight calibrate base, or no --start")
    T_map_base = given.start.T_odom_base
    xy, level = given.start_sigma_m, given.level_sigma
    Ad = se3.adjoint(T_map_base)
    C = Ad @ np.diag(np.square([xy, xy, level, level, level, given.start_sigma_rad])) @ Ad.T
    return se3.nearest(T_map_base @ calibration.T_base_camera), C
