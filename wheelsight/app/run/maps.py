"""The known map of a run, and the record of the run's own map with its plan and views."""

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
from wheelsight.core.geometry import ByteArray, Float32Array, FloatArray, PinholeCamera, se3
from wheelsight.core.keyframes import KeyframeId
from wheelsight.core.messages import RgbdFrame
from wheelsight.core.trajectory import Trajectory
from wheelsight.mapping import SurfelMap
from wheelsight.mapping.plan import MapPlan, cloud_of, plan_of, upward
from wheelsight.mapping.surfels import Parts
from wheelsight.places.recognition import Recognizer
from wheelsight.slam.loop_closing import ClosedLoops, corrected_by
from wheelsight.slam.maps import MapFolder, find_map, in_largest_piece
from wheelsight.slam.place_recognition import KnownMap

MAP_FILE = "map.surfels"
_WIDTHS_PX = (640, 320, 160)
_FAR_M = 100.0
# A plan is cut so far above the camera: lamps and shelves that hang there would hide the floor.
_ABOVE_CAMERA_M = 0.3
_WHITE = 255.0
_CLOUD_POINTS = 50_000  # of the page, 12 bytes each: with 60 000, pages stay under 3 MB
_LEVEL_SIGMA = 0.02  # of height, roll and pitch at a known start, metres and radians: bases stand on a floor (chosen)


@dataclass(frozen=True, slots=True, eq=False)
class Stop:
    """A frame with T_map_camera (4, 4), from which a view of the finished map is rendered."""

    stamp_s: float
    color: ByteArray
    T_map_camera: FloatArray


@dataclass
class Stops:
    """A few frames with poses, evenly spread over a recording, at or after the `due` indices.

    Attributes:
        due: frame indices.
        found: the frames.
        stamps_s: of all frames with a pose.
        T_map_body: their poses (4, 4) in the map.
        T_odom_map: (4, 4) the map's frame in the trajectory's frame at each of these frames.
    """

    due: list[int]
    found: list[Stop] = field(default_factory=list)
    stamps_s: list[float] = field(default_factory=list)
    T_map_body: list[FloatArray] = field(default_factory=list)
    T_odom_map: list[FloatArray] = field(default_factory=list)

    def look(
        self, frame: RgbdFrame, estimate: Estimate, T_odom_map: FloatArray, T_base_camera: FloatArray | None
    ) -> None:
        """Store the pose of a frame, if it has one, and the frame itself if one is due."""
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
        """Move the finished map and all its poses into the frame of the whole trajectory.

        With wheels, poses are corrected during the run and the map is not, so that its offset changes from frame to
        frame. The map moves by the mean offset.
        """
        if not self.T_odom_map or all((np.eye(4) == T).all() for T in self.T_odom_map):
            return
        # The motion that fits all T_odom_map at once: their mean rotation, and the mean translation of the poses.
        T_odom_map = np.array(self.T_odom_map)
        T_map_body = np.array(self.T_map_body)
        R = Rotation.from_matrix(T_odom_map[:, :3, :3]).mean().as_matrix()
        p_odom, p_map = (T_odom_map @ T_map_body)[:, :3, 3], T_map_body[:, :3, 3]
        T_new_old = se3.from_parts(R, (p_odom - p_map @ R.T).mean(axis=0))
        surfel_map.move(T_new_old)
        self.T_map_body = [T_new_old @ T for T in self.T_map_body]
        self.found = [replace(stop, T_map_camera=T_new_old @ stop.T_map_camera) for stop in self.found]
        self.T_odom_map = [np.eye(4)] * len(self.T_map_body)

    def follow(self, closed: ClosedLoops) -> None:
        """Move all poses to where loop closing has them at the end, like the map. Drop poses of unknown position.

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


def map_record_of(
    surfel_map: SurfelMap,
    stops: Sequence[Stop],
    T_map_body: FloatArray,
    calibration: Calibration,
    cloud_points: int = _CLOUD_POINTS,
) -> MapRecord:
    """The record of a run's map.

    Args:
        surfel_map: at the end of the run.
        stops: viewpoints.
        T_map_body: (n, 4, 4) the whole path in the map.
        calibration: has the colour camera, and with `T_base_camera` the direction of gravity.
        cloud_points: maximum number of points for the page.
    """
    is_levelled = calibration.T_base_camera is not None
    pictures = tuple(MapPicture(stop.stamp_s, stop.color, _seen(surfel_map, stop, calibration)) for stop in stops)
    status = surfel_map.status()
    surest = partial(surfel_map.parts, "stable" if status.stable else "all")
    plan = _plan(surest, T_map_body, calibration) if status.surfels else None
    return MapRecord(status, surfel_map.frames, MAP_FILE, plan, pictures, is_levelled, cloud_of(surest, cloud_points))


def camera_of(T_map_body: FloatArray, T_base_camera: FloatArray | None) -> FloatArray:
    """T_map_camera (..., 4, 4) of a body, which is the base where `T_base_camera` is known, else the camera."""
    return T_map_body if T_base_camera is None else T_map_body @ T_base_camera


def _plan(parts: Parts, T_map_body: FloatArray, calibration: Calibration) -> MapPlan | None:
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
    """The map rendered as the colour camera without distortion sees it, (h, w, 3) uint8; white without surfels.

    Gaps between surfels that were seen from farther away are filled from a coarser view.
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
    """(h, width, 3) from 0 to 255: grey where the colour is unknown, -1 without surfels."""
    scale = width / camera.width
    # Pixel centres lie at integers, so that an image begins half a pixel before its first.
    cx, cy = scale * (np.array([camera.cx, camera.cy]) + 0.5) - 0.5
    intrinsics = np.array([scale * camera.fx, scale * camera.fy, cx, cy])
    shape = (max(1, round(scale * camera.height)), width)
    view = surfel_map.render(T_map_color, intrinsics, shape, far_m=_FAR_M)
    image = np.where(view.color[..., :1] < 0, view.grey[..., None], view.color)
    return np.where(view.depth_m[..., None] > 0, image, np.float32(-1))


def open_known(
    calibration: Calibration, config: Config, on_keyframe: Callable[[int, int], None] = lambda done, total: None
) -> tuple[KnownMap, MapFolder] | None:
    """The known map of the settings, and its folder; None without one.

    Damaged keyframes, and keyframes of unknown position relative to the others, are not recognised.

    Args:
        calibration: of the robot; its camera must be that of the map.
        config: of the run.
        on_keyframe: called with the number of codes made and their total, where the map has no file of codes.

    Raises:
        MapError: no map, a damaged one, of another camera or version, or written by another run.
        ConfigError: a start is given, and the calibration has no mount of the camera.
        OutputError: it is to be extended and cannot be written.
    """
    given = config.known_map
    if given.path is None:
        return None
    folder = MapFolder.open(find_map(given.path), read_only=not given.extend, settings=config.sessions)
    try:
        folder.check_camera(calibration, config.recording.depth_factor)
        together = in_largest_piece(folder)
        if not together.any():
            raise MapError("has no keyframes", path=folder.path, fix="make a map by a run with --map surfels")
        # Only keyframes that are connected are recognised.
        found = folder.recognizer(config.recognition, on_keyframe)
        if all(together[number] for number in found.keyframes):
            recognizer = found
        else:
            made = Recognizer(config.recognition)
            for number in np.flatnonzero(together):
                made.add(KeyframeId(int(number)), folder.store[KeyframeId(int(number))])
            recognizer = made
        start = _start(calibration, config)
        edges = folder.edges if given.extend else ()
        return KnownMap(folder.store, recognizer, edges, *start), folder
    except BaseException:
        folder.close()
        raise


def _start(calibration: Calibration, config: Config) -> tuple[FloatArray | None, FloatArray | None]:
    """T_map_camera (4, 4) at the start of the drive and its covariance (6, 6); None where no start is given."""
    given = config.known_map
    if given.start is None:
        return None, None
    if calibration.T_base_camera is None:
        problem = "--start says where the base is, and the calibration does not say where the camera sits on it"
        raise ConfigError(problem, fix="wheelsight calibrate base, or no --start")
    T_map_base = given.start.T_odom_base
    xy, level = given.start_sigma_m, _LEVEL_SIGMA
    Ad = se3.adjoint(T_map_base)
    C = Ad @ np.diag(np.square([xy, xy, level, level, level, given.start_sigma_rad])) @ Ad.T
    return se3.nearest(T_map_base @ calibration.T_base_camera), C
