"""LiveTopics: the messages of a robot that drives or is followed just now, from the types of bags."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from wheelsight.app.run.drive_record import monitor_words, status_words
from wheelsight.app.run.run_record import FrameRecord
from wheelsight.app.run.track import UNITS, RunTrack
from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import InputError
from wheelsight.core.estimates import Estimate, Status
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.messages import Event, RgbdFrame
from wheelsight.core.trajectory import Trajectory
from wheelsight.mapping.plan import cloud_of
from wheelsight.navigation import CellState, Costmap, DepthViewer, Feedback, MonitorState, NavigationSettings, Navigator
from wheelsight_export.bag_writing import Diagnosis, Messages, RobotTopics, Sent
from wheelsight_export.sources import body_frame, pose_covariances, upright, upright_points
from wheelsight_export.topics import (
    BASE,
    CLOCK_TOPIC,
    COLOR,
    COSTMAP_TOPIC,
    DEPTH,
    DIAGNOSTICS_TOPIC,
    MAP,
    MAP_TOPIC,
    MARKERS_TOPIC,
    ODOM,
    ODOM_TOPIC,
    PLAN_TOPIC,
    POINTS_TOPIC,
    POSE_TOPIC,
    REGISTERED,
    ROBOT_TOPIC,
    SCAN_FRAME,
    SCAN_TOPIC,
    STATUS_TOPIC,
    TF,
    TF_STATIC,
    TOPICS,
)
from wheelsight_ros2.urdf import urdf_of

# Least times between two messages of a kind, by stamps: of images, of maps that grow, and of words that stay the same.
_IMAGE_S, _MAP_S, _COSTMAP_S, _WORDS_S, _POINTS_S = 0.1, 1.0, 0.5, 1.0, 5.0
# Points of a surfel map in a message: 3 MB.
_MOST_POINTS = 200_000
_OK, _WARNING, _ERROR = 0, 1, 2
_LEVELS = {Status.TRACKING: _OK, Status.FAILING: _ERROR, Status.LOST: _ERROR}
_MONITOR_LEVELS = {MonitorState.FREE: _OK, MonitorState.SLOWED: _OK, MonitorState.STOPPED: _WARNING}
_CAMERAS = tuple(name for name in TOPICS if name.startswith((f"{COLOR}/", f"{DEPTH}/", f"{REGISTERED}/")))


class LiveTopics:
    """Makes the messages of one robot.

    Args:
        calibration: of the robot.
        wants: whether any peer takes a topic; what no peer takes is not made where that takes long.
        is_simulated: whether stamps are simulated time, which /clock gives.
        settings: footprint and heights of obstacles, for /scan.
    """

    def __init__(
        self,
        calibration: Calibration,
        wants: Callable[[str], bool],
        *,
        is_simulated: bool,
        settings: NavigationSettings | None = None,
    ) -> None:
        self.make = Messages(is_ros1=False)
        self._calibration, self._wants, self._is_simulated = calibration, wants, is_simulated
        self._robot = RobotTopics(self.make, calibration, "jpeg")
        self._viewer: DepthViewer | None = None
        s = settings or NavigationSettings()
        try:
            self._viewer = DepthViewer(calibration, s.footprint.outline, s.live)
        except InputError:  # no camera, or one whose mount is unknown: there is no scan
            self._viewer = None
        self._outline = (s.footprint.front_m, s.footprint.back_m, s.footprint.width_m)
        is_base = calibration.T_base_camera is not None or calibration.color is None
        self._body = "base" if is_base else "camera"
        self._begun = False
        self._said: dict[str, object] = {}
        self._sent_s: dict[str, float] = {}
        self._navigator: Navigator | None = None

    def of_events(self, events: Sequence[Event]) -> Iterator[Sent]:
        """Mounts with the first event; wheels, gyroscope, images and scan."""
        for event in events:
            if not self._begun:
                self._begun = True
                yield from self._mounts(event.stamp_s)
            if not isinstance(event, RgbdFrame):
                yield from self._robot.of_event(event)
                continue
            if any(map(self._wants, _CAMERAS)) and self._is_due("images", event.stamp_s, _IMAGE_S):
                yield from self._robot.of_frame(event)
            if self._viewer is not None and self._wants(SCAN_TOPIC):
                yield self._scan(self._viewer, event)

    def of_drive(self, feedback: Feedback, navigator: Navigator, words: Mapping[str, Any]) -> Iterator[Sent]:
        """A control period: transforms, pose, odometry, plan, surroundings and state; `words` join the state."""
        if navigator is not self._navigator:  # another map
            self._navigator = navigator
            for name in (MAP_TOPIC, PLAN_TOPIC, COSTMAP_TOPIC):
                self._said.pop(name, None)
                self._sent_s.pop(name, None)
        stamp_s, where = feedback.stamp_s, navigator.senses.where
        yield from self._clock(stamp_s)
        if where.odom_pose is not None and where.estimate is not None:
            T_odom_base = se3.from_plane(*where.odom_pose)
            joined = [(ODOM, BASE, T_odom_base)]
            if feedback.pose is not None:
                joined.insert(0, (MAP, ODOM, se3.from_plane(*where.T_map_odom)))
            yield Sent(stamp_s, TF, self.make.transforms(stamp_s, joined))
            twist = np.array([feedback.forward_m_s, 0, 0, 0, 0, feedback.turn_rad_s])
            yield self._odometry(stamp_s, *self._upright(T_odom_base, where.estimate.covariance), twist)
            if feedback.pose is not None:
                T_map, C_map = self._upright(se3.from_plane(*feedback.pose), covariance_in_map(where.estimate))
                yield Sent(stamp_s, POSE_TOPIC, self.make.posed(stamp_s, MAP, T_map, C_map))
        yield from self._surroundings(feedback, navigator)
        yield from self._words_of_drive(feedback, words)

    def of_run(self, event: Event, answers: Mapping[str, FrameRecord], tracks: Sequence[RunTrack]) -> Iterator[Sent]:
        """An answered event of a run: transforms, pose, odometry and state of its main track; and its map."""
        stamp_s = event.stamp_s
        yield from self._clock(stamp_s)
        yield from self.of_events([event])
        track = main_track(tracks)
        if track.odometry not in answers or track.last is None:
            return
        estimate, answer = track.last, answers[track.odometry]
        if estimate.T_odom_body is not None:
            at_s = estimate.stamp_s
            T_odom, C_odom = self._upright(estimate.T_odom_body, estimate.covariance)
            joined = [(ODOM, body_frame(self._body), T_odom)]
            if estimate.T_map_body is not None:
                T_map, C_map = self._upright(estimate.T_map_body, covariance_in_map(estimate))
                joined.insert(0, (MAP, ODOM, se3.compose(T_map, se3.invert(T_odom))))
                yield Sent(at_s, POSE_TOPIC, self.make.posed(at_s, MAP, T_map, C_map))
            yield Sent(at_s, TF, self.make.transforms(at_s, joined))
            yield self._odometry(at_s, T_odom, C_odom, self._twist(at_s, T_odom))
        reason = "; ".join(filter(None, [str(answer.reason or ""), answer.note, *answer.flags]))
        words = {"track": track.odometry, "status": str(answer.status), "reason": reason}
        level = _LEVELS.get(estimate.status, _WARNING)
        diagnosis = Diagnosis(level, "wheelsight: localization", f"{answer.status}: {reason}".removesuffix(": "))
        yield from self._words(stamp_s, words, [diagnosis])
        yield from self.points(stamp_s, track)

    def points(self, stamp_s: float, track: RunTrack, *, is_last: bool = False) -> Iterator[Sent]:
        """The surfels so far as /map_points, now and then; and the loops as markers."""
        surfels, store = track.localizer.map, track.localizer.keyframes
        is_due = is_last or (self._wants(POINTS_TOPIC) and self._is_due(POINTS_TOPIC, stamp_s, _POINTS_S))
        if surfels is not None and is_due:
            cloud = cloud_of(partial(surfels.parts, "stable"), _MOST_POINTS)
            if cloud is not None:
                p = upright_points(np.asarray(cloud.position, float), self._body)
                yield Sent(stamp_s, POINTS_TOPIC, self.make.points(stamp_s, MAP, p, cloud.color), is_latched=True)
        loops = None if track.localizer.loops is None else track.localizer.loops.accepted_loops
        if loops is not None and store is not None and self._has_changed(MARKERS_TOPIC, (len(loops), store.revision)):
            ends = upright_points(store.T_map_keyframe[loops][:, :, :3, 3].reshape(-1, 3), self._body)
            message = self.make.markers(stamp_s, MAP, np.empty((0, 3)), ends.reshape(-1, 2, 3))
            yield Sent(stamp_s, MARKERS_TOPIC, message)

    def _mounts(self, stamp_s: float) -> Iterator[Sent]:
        for sent in self._robot.mounts(stamp_s):
            if sent.topic == TF_STATIC and self._viewer is not None:
                T_base_scan = se3.from_plane(*self._viewer.camera, 0.0)
                sent.message.transforms.extend(
                    self.make.transforms(stamp_s, [(BASE, SCAN_FRAME, T_base_scan)]).transforms
                )
            yield sent
        robot = self.make.text(urdf_of(self._calibration, "robot", self._outline))
        yield Sent(stamp_s, ROBOT_TOPIC, robot, is_latched=True)

    def _clock(self, stamp_s: float) -> Iterator[Sent]:
        if self._is_simulated and self._has_changed(CLOCK_TOPIC, stamp_s):
            yield Sent(stamp_s, CLOCK_TOPIC, self.make.clock(stamp_s))

    def _odometry(self, stamp_s: float, T: FloatArray, C: FloatArray | None, twist: FloatArray) -> Sent:
        frames = (ODOM, body_frame(self._body))
        return Sent(stamp_s, ODOM_TOPIC, self.make.odometry(stamp_s, frames, T, twist, C))

    def _upright(self, T: FloatArray, C: FloatArray | None) -> tuple[FloatArray, FloatArray | None]:
        """A pose (4, 4) of base or camera in the axes of ROS, and its covariance (6, 6) in the convention of ROS."""
        rows = None if C is None else np.asarray(C)[None]
        one = upright(Trajectory(np.zeros(1), np.asarray(T)[None], rows, body=self._body))
        known = pose_covariances(one)
        return one.T_frame_body[0], None if known is None else known[0]

    def _twist(self, stamp_s: float, T: FloatArray) -> FloatArray:
        """(6,) the mean velocity since the last pose, in the body's axes; zero at the first."""
        before = self._said.get("twist")
        self._said["twist"] = (stamp_s, T)
        if not isinstance(before, tuple) or stamp_s <= before[0]:
            return np.zeros(6)
        return np.asarray(se3.log(se3.compose(se3.invert(before[1]), T)) / (stamp_s - before[0]))

    def _scan(self, viewer: DepthViewer, frame: RgbdFrame) -> Sent:
        """Obstacles above the floor by bearing around the camera, as the collision monitor sees them."""
        view = viewer.view(frame.depth_m, frame.stamp_s)
        ranges_m = np.where(view.seen_m > 0, np.inf, np.nan)
        away = view.points - view.camera
        bearing = (np.arctan2(away[:, 1], away[:, 0]) - view.first_rad + np.pi) % (2 * np.pi) - np.pi
        column = np.rint(bearing / view.step_rad).astype(int)
        inside = (column >= 0) & (column < len(ranges_m))
        nearest_m = np.full(len(ranges_m), np.inf)
        np.minimum.at(nearest_m, column[inside], np.hypot(*away[inside].T))
        ranges_m = np.where(np.isfinite(nearest_m), nearest_m, ranges_m)
        stamp_s = frame.stamp_s + frame.depth_late_s
        scan = self.make.scan(stamp_s, SCAN_FRAME, view.first_rad, view.step_rad, ranges_m)
        return Sent(stamp_s, SCAN_TOPIC, scan)

    def _surroundings(self, feedback: Feedback, navigator: Navigator) -> Iterator[Sent]:
        """Floor, local costmap, plan and people, where they have changed."""
        stamp_s, senses = feedback.stamp_s, navigator.senses
        if self._said.get(MAP_TOPIC) != senses.floor.revision and self._is_due(MAP_TOPIC, stamp_s, _MAP_S):
            self._said[MAP_TOPIC] = senses.floor.revision
            layer = senses.floor.layer
            cells = np.full(layer.state.shape, -1, np.int8)
            cells[layer.state == CellState.FREE] = 0
            cells[layer.state == CellState.OCCUPIED] = 100
            corner = se3.from_plane(*layer.origin, 0.0)
            grid = self.make.occupancy(stamp_s, MAP, cells, layer.resolution_m, corner)
            yield Sent(stamp_s, MAP_TOPIC, grid, is_latched=True)
        if self._is_due(COSTMAP_TOPIC, stamp_s, _COSTMAP_S):
            local = senses.local()
            if local is not None and self._has_changed(COSTMAP_TOPIC, local):
                corner = se3.from_plane(*local.origin, 0.0)
                grid = self.make.occupancy(stamp_s, MAP, costs_of(local), local.resolution_m, corner)
                yield Sent(stamp_s, COSTMAP_TOPIC, grid, is_latched=True)
        if self._has_changed(PLAN_TOPIC, feedback.plan):
            poses = np.empty((0, 3)) if feedback.plan is None else feedback.plan.poses
            T = np.array([se3.from_plane(*pose) for pose in poses]).reshape(-1, 4, 4)
            path = self.make.path(stamp_s, MAP, np.full(len(T), stamp_s), T)
            yield Sent(stamp_s, PLAN_TOPIC, path, is_latched=True)
        people = senses.people(stamp_s)
        if people or self._said.get(MARKERS_TOPIC):
            self._said[MARKERS_TOPIC] = bool(people)
            discs = np.array([(*one.position, one.radius_m) for one in people]).reshape(-1, 3)
            yield Sent(stamp_s, MARKERS_TOPIC, self.make.markers(stamp_s, MAP, discs, np.empty((0, 2, 3))))

    def _words_of_drive(self, feedback: Feedback, more: Mapping[str, Any]) -> Iterator[Sent]:
        monitor = feedback.monitor
        words = {
            "state": str(feedback.state),
            "doing": feedback.doing,
            "status": str(feedback.status),
            "monitor": "free" if monitor is None else str(monitor.state),
            "reason": "" if monitor is None else str(monitor.reason or ""),
            "robot_stop": feedback.robot_stop,
            "wheel_fault": feedback.has_wheel_fault,
            "warnings": list(feedback.warnings),
            **more,
        }
        is_held = monitor is not None and not feedback.stands
        held = _MONITOR_LEVELS[monitor.state] if is_held and monitor is not None else _OK
        level = _LEVELS.get(feedback.status, _WARNING)
        fault = _ERROR if feedback.has_wheel_fault else _WARNING if feedback.robot_stop else _OK
        diagnoses = [
            Diagnosis(level, "wheelsight: localization", status_words(feedback)),
            Diagnosis(
                fault, "wheelsight: navigator", feedback.robot_stop or f"{feedback.state} {feedback.doing}".strip()
            ),
            Diagnosis(held, "wheelsight: collision monitor", monitor_words(feedback)),
        ]
        if refused := str(more.get("refused", "")):
            counts = tuple((name, str(count)) for name, count in more.get("counts", {}).items())
            diagnoses.append(Diagnosis(_WARNING, "wheelsight: inputs", refused, counts))
        yield from self._words(feedback.stamp_s, words, diagnoses)

    def _words(self, stamp_s: float, words: Mapping[str, Any], diagnoses: Sequence[Diagnosis]) -> Iterator[Sent]:
        """State as JSON, and diagnoses: when they change, and once a second."""
        text = json.dumps(words)
        has_changed = self._has_changed(STATUS_TOPIC, text)
        if has_changed or self._is_due(STATUS_TOPIC, stamp_s, _WORDS_S):
            self._sent_s[STATUS_TOPIC] = stamp_s
            yield Sent(stamp_s, STATUS_TOPIC, self.make.text(text), is_latched=True)
            yield Sent(stamp_s, DIAGNOSTICS_TOPIC, self.make.diagnostics(stamp_s, diagnoses))

    def _is_due(self, kind: str, stamp_s: float, every_s: float) -> bool:
        """Whether `every_s` has passed since this last was so; a stamp that went back begins again."""
        before_s = self._sent_s.get(kind, -np.inf)
        if before_s <= stamp_s < before_s + every_s - 1e-6:
            return False
        self._sent_s[kind] = stamp_s
        return True

    def _has_changed(self, kind: str, value: object) -> bool:
        is_known = kind in self._said
        before, self._said[kind] = self._said.get(kind), value
        same = before is value or (isinstance(value, str | float | tuple) and before == value)
        return not (is_known and same)


def main_track(tracks: Sequence[RunTrack]) -> RunTrack:
    """The track whose poses are sent: joined sensors, else a camera's, else the first."""
    by_name = {track.odometry: track for track in tracks}
    if "joined" in by_name:
        return by_name["joined"]
    return next((track for track in tracks if UNITS[track.odometry] == "frame"), tracks[0])


def costs_of(costmap: Costmap) -> np.ndarray:
    """(H, W) int8 as Nav2 shows costmaps: 0 free to 99, 100 where the robot's centre can never be, -1 unknown."""
    cells = np.asarray(np.rint(99 * np.clip(costmap.cost, 0, 1)), np.int8)
    cells[costmap.state == CellState.UNKNOWN] = -1
    cells[costmap.is_lethal] = 100
    return cells


def covariance_in_map(estimate: Estimate) -> FloatArray | None:
    """(6, 6) of the left perturbation of the pose in the map; without one, that of the filter, carried there."""
    if estimate.covariance_map is not None:
        return estimate.covariance_map
    if estimate.filter_covariance is None:
        return None
    Ad = se3.adjoint(se3.compose(estimate.T_map_odom, se3.invert(estimate.T_filter_odom)))
    return np.asarray(Ad @ estimate.filter_covariance @ Ad.T)
