"""Snapshot: the state that pages show, as a value. Driven is what a session drives with. Makes the images of the
page.
"""

from __future__ import annotations

import json
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import cv2
import numpy as np

from wheelsight.app.run.drive_record import TimeCause, monitor_words, status_words, time_cause
from wheelsight.core.estimates import Status
from wheelsight.core.geometry import ByteArray, FloatArray, se2, se3
from wheelsight.core.messages import Event
from wheelsight.core.robots import Robot, WatchedRobot
from wheelsight.core.settings import LivePageSettings
from wheelsight.navigation import CellState, Costmap, Feedback, Navigator, StaticLayer, Transition
from wheelsight.navigation.senses import Senses

_WAY_STEP_M, _WAY_POINTS, _PATH_POINTS = 0.1, 300, 80  # the newest of the driven path; of the planned one
_JPEG_QUALITY = 60  # of the camera's image, of 100: about 10 kB
_SIGMAS = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """An image that pages fetch.

    Attributes:
        body: PNG or JPEG.
        number: changes with the image.
        place: x, y of its lower left corner, width and height in `map`, metres; None for the camera.
    """

    body: bytes
    number: int
    place: tuple[float, float, float, float] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Snapshot:
    """The state of a session at one moment.

    Attributes:
        made_s: by `time.monotonic`.
        text: JSON of everything but the images.
        pictures: "plan", "costmap", "camera", if available.
        is_driving: whether a task runs.
    """

    made_s: float
    text: str
    pictures: Mapping[str, Picture] = field(default_factory=dict)
    is_driving: bool = False


class SnapshotMaker:
    """Makes the snapshots of a robot that drives in one map after another.

    Args:
        robot: the robot with the camera.
        settings: rate and size of images.
        wants_costmap: whether any page shows the costmap.
    """

    def __init__(self, robot: WatchedRobot, settings: LivePageSettings, wants_costmap: Callable[[], bool]) -> None:
        self._robot, self._settings, self._wants_costmap = robot, settings, wants_costmap
        self._way: deque[FloatArray] = deque(maxlen=_WAY_POINTS)
        self._pictures: dict[str, Picture] = {}
        self._made_of: dict[str, object] = {}
        self._number, self._pictured_s = 0, -np.inf
        self._was_tracked = False

    def begin(self) -> None:
        """Discard everything shown of the previous map."""
        self._was_tracked = False
        self._way.clear()
        self._pictures.clear()
        self._made_of.clear()

    def of_words(self, facts: Mapping[str, Any]) -> Snapshot:
        """A snapshot without a map."""
        return Snapshot(time.monotonic(), json.dumps(facts), dict(self._pictures))

    def of(self, driven: Driven, feedback: Feedback, facts: Mapping[str, Any]) -> Snapshot:
        """A snapshot of one period, with facts of the session."""
        senses = driven.navigator.senses
        # Wheels alone begin at the map's origin until the first frame or a known start gives the pose.
        self._was_tracked = self._was_tracked or feedback.status in (Status.TRACKING, Status.UNCONFIRMED)
        pose = feedback.pose if self._was_tracked else None
        if pose is not None and (not self._way or np.hypot(*(pose[:2] - self._way[-1])) >= _WAY_STEP_M):
            self._way.append(pose[:2].copy())
        # Redraw the images that have changed, at most at `images_hz`
        now_s, s = time.monotonic(), self._settings
        if not (now_s - self._pictured_s < 1 / s.images_hz):
            self._pictured_s = now_s
            layer, frame = senses.floor.layer, self._robot.frame
            self._keep("plan", layer, lambda: Picture(plan_png(layer), 0, _place(layer)))
            if frame is not None:
                self._keep("camera", frame, lambda: Picture(camera_jpeg(frame.color, s.image_px, _JPEG_QUALITY), 0))
            costmap = senses.local() if self._wants_costmap() else None
            if costmap is not None:
                self._keep("costmap", costmap, lambda: Picture(costmap_png(costmap), 0, _place(costmap)))
        pace = time_cause(feedback, driven.navigator.settings.limits)
        task = {
            "stamp_s": round(feedback.stamp_s, 3),
            "state": str(feedback.state),
            "doing": feedback.doing,
            "status": status_words(feedback),
            "monitor": monitor_words(feedback),
            "held": "" if feedback.monitor is None or feedback.monitor.reason is None else monitor_words(feedback),
            "pace": "" if pace in (TimeCause.FULL_SPEED, TimeCause.GAINS_SPEED) else str(pace),
            "wheels_off": feedback.has_wheel_fault,
            "stays": None if feedback.stays_at is None else [round(float(at), 2) for at in feedback.stays_at],
            "speed_m_s": round(feedback.forward_m_s, 2),
            "turn_rad_s": round(feedback.turn_rad_s, 2),
            "to_go_m": None if feedback.to_go_m is None else round(feedback.to_go_m, 1),
            "goal": None if feedback.goal is None else _pose(feedback.goal),
        }
        path = []
        if feedback.plan is not None:
            poses = feedback.plan.poses
            path = _rounded(np.concatenate([poses[:: max(1, len(poses) // _PATH_POINTS), :2], poses[-1:, :2]]))
        state = {
            **facts,
            **task,
            "pose": _rounded(pose),
            "ellipse": None if pose is None else _ellipse(senses),
            "footprint": _rounded(driven.navigator.footprint.corners),
            "path": path,
            "way": _rounded(np.array(self._way).reshape(-1, 2)),
            "places": [{"name": name, "pose": _pose(at)} for name, at in driven.places.where().items()],
            "pictures": {
                name: {"number": one.number, "place": one.place and [round(v, 3) for v in one.place]}
                for name, one in self._pictures.items()
            },
        }
        is_driving = not driven.navigator.is_task_complete()
        return Snapshot(time.monotonic(), json.dumps(state), dict(self._pictures), is_driving)

    def _keep(self, name: str, of: object, make: Callable[[], Picture]) -> None:
        if self._made_of.get(name) is of:
            return
        self._number += 1
        self._made_of[name], self._pictures[name] = of, replace(make(), number=self._number)


def _place(of: StaticLayer | Costmap) -> tuple[float, float, float, float]:
    height, width = of.state.shape
    return of.origin[0], of.origin[1], width * of.resolution_m, height * of.resolution_m


def _ellipse(senses: Senses) -> list[float] | None:
    """Half axes of two standard deviations, metres, and the direction of the longer one in `map`; None if unknown."""
    estimate = senses.where.estimate
    if estimate is None or estimate.filter_covariance is None or estimate.T_filter_body is None:
        return None
    if estimate.covariance_map is not None and estimate.T_map_body is not None:
        C = se3.position_covariance(estimate.T_map_body, estimate.covariance_map)[:2, :2]
    else:
        R = se2.from_parts(*senses.where.T_map_odom)[:2, :2] @ se3.invert(estimate.T_filter_odom)[:2, :2]
        C = R @ se3.position_covariance(estimate.T_filter_body, estimate.filter_covariance)[:2, :2] @ R.T
    values, vectors = np.linalg.eigh(C)
    small, large = _SIGMAS * np.sqrt(np.maximum(values, 0))
    return [round(float(v), 3) for v in (large, small, np.arctan2(vectors[1, 1], vectors[0, 1]))]


def _pose(pose: FloatArray) -> list[float | None]:
    """x, y, yaw for JSON; the yaw of any heading is None, since JSON has no NaN."""
    return [None if np.isnan(value) else round(float(value), 3) for value in pose]


def _rounded(values: FloatArray | Sequence[FloatArray] | None) -> Any:
    return None if values is None else np.round(np.asarray(values, float), 2).tolist()


class NamedPlaces(Protocol):
    """Named places of a map."""

    def where(self) -> Mapping[str, FloatArray]:
        """Current pose (3,) of x, y, yaw of each place by its name."""

    def name(self, name: str, pose: FloatArray) -> None:
        """Name a pose (3,). Raises MapError, OutputError."""


@dataclass(frozen=True, slots=True, eq=False)
class Driven:
    """A map with its navigator.

    Attributes:
        navigator: drives the robot in the map.
        places: of the map.
        is_new: whether the map is new; else it is a known one.
    """

    navigator: Navigator
    places: NamedPlaces
    is_new: bool


class Maps(Protocol):
    """Maps that a session can drive in."""

    @property
    def first(self) -> str:
        """Name of the first map."""

    def names(self) -> tuple[str, ...]:
        """Names of all maps that can be driven in now."""

    def last_saved(self) -> str:
        """Name of the last saved map."""

    def opened(
        self, name: str, robot: Robot, pose: FloatArray | None, on_transition: Callable[[Transition], None]
    ) -> AbstractContextManager[Driven]:
        """Open a map for a robot at (3,) in it, or at an unknown pose. Raises WheelsightError."""


class Watch(Protocol):
    """A listener to all drives of a session, such as `wheelsight_export.DriveLog`."""

    def on_events(self, events: Sequence[Event]) -> None:
        """Events of the robot's sensors."""

    def note(self, transition: Transition) -> None:
        """A change of the navigator's state."""

    def step(self, feedback: Feedback, navigator: Navigator) -> None:
        """The end of a period; another navigator than before means another map."""


# Blue, green, red, as OpenCV has them; distinguishable with red-green colour blindness (Okabe & Ito 2008).
_PLAN = np.zeros((3, 3), np.uint8)
_PLAN[CellState.FREE] = 255, 255, 255
_PLAN[CellState.UNKNOWN] = 214, 207, 201
_PLAN[CellState.OCCUPIED] = 40, 40, 40
_COST, _LETHAL = (0, 159, 230), (0, 94, 213)
_COST_ALPHA, _LETHAL_ALPHA = 150, 190


def plan_png(layer: StaticLayer) -> bytes:
    """Free, occupied and unknown cells; a pixel a cell, y up."""
    return _encoded(".png", _PLAN[np.minimum(layer.state[::-1], CellState.OCCUPIED)])


def costmap_png(costmap: Costmap) -> bytes:
    """The costmap as an overlay of the plan: opaque where cost is high; a pixel a cell, y up."""
    image = np.zeros((*costmap.cost.shape, 4), np.uint8)
    image[..., :3] = _COST
    image[..., 3] = np.clip(costmap.cost, 0, 1) * _COST_ALPHA
    image[costmap.is_lethal] = (*_LETHAL, _LETHAL_ALPHA)
    # Unknown cells are transparent: the plan shows them already.
    image[costmap.state == CellState.UNKNOWN] = 0
    return _encoded(".png", image[::-1])


def camera_jpeg(rgb: ByteArray, width_px: int, quality: int) -> bytes:
    """An image (h, w, 3), reduced to the maximum width."""
    height, width = rgb.shape[:2]
    if width > width_px:
        size = width_px, max(1, round(height * width_px / width))
        rgb = np.asarray(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA), np.uint8)
    return _encoded(".jpg", rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])


def _encoded(kind: str, image: ByteArray, how: list[int] | None = None) -> bytes:
    return bytes(cv2.imencode(kind, np.ascontiguousarray(image), how or [])[1])
