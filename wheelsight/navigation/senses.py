"""Senses: distributes sensor data to all of navigation, and keeps the surroundings derived from it.

`WhereNow` is the current pose between two estimates; `HeldPlace` holds a more certain one for a moment.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import shapely
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from wheelsight.core.calibration import Calibration
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.errors import ArgumentError
from wheelsight.core.estimates import Estimate, FusedEstimate, Status
from wheelsight.core.geometry import BoolArray, FloatArray, se2, se3
from wheelsight.core.messages import Event, RgbdFrame, VelocityCommand, WheelSpeeds, WheelTicks
from wheelsight.core.robots import Localization
from wheelsight.navigation.behaviours import OpenWay, keeps_clear, open_way
from wheelsight.navigation.collision_monitor import AIR_M, CollisionMonitor
from wheelsight.navigation.controllers import MotionState
from wheelsight.navigation.costmap import CellState, Costmap, Floor, FloorNow, LiveObstacles
from wheelsight.navigation.costmap_kernels import Eye
from wheelsight.navigation.perception import (
    LIVE_SIZE_M,
    SETTLED_S,
    DepthView,
    DepthViewer,
    LiveLayer,
    PeopleTracker,
    Person,
)
from wheelsight.navigation.settings import COASTING_S, SILENT_M, SILENT_S, Footprint, NavigationSettings, outline_of
from wheelsight.wheels import WheelOdometry

# Views that wait for the pose of their frame: two seconds of a Kinect.
_VIEWS = 60
# Poses stored while the place in the map is unknown: three minutes of a search.
_PLACES = 3600
# Side of the controller's costmap around the robot: twice its lookahead.
LOCAL_M = 8.0
# Length of the path ahead that is checked: what the camera sees reliably.
CHECK_M = 3.0
# Distance beyond the circle of its corners within which floor unknown to map and camera is an obstacle to controllers,
# if unknown floor is costly, unless no other path exists: floor farther away becomes visible on the way.
HIDDEN_M = 0.3
# Depth in such floor from which it counts: cells and depth err by less. A view of 54°, which a corner of the front
# precedes by 0.07 m, does not show what that corner sweeps in a tight curve.
_HIDDEN_DEEP_M = 0.1
# The same for floor that is free in the map: slightly less than `monitor.blind_m`, as the collision monitor, which
# knows no map, lets no part of the robot deeper into it.
_HIDDEN_KNOWN_M = 0.25
# Distance to an obstacle of the map within which an object is that obstacle, and no person: the error of a pose.
_BESIDE_M = 0.15
# Time back along a person's path that is removed from the costmap, as long as the detection takes, since no image from
# nearby sees through the heights that were seen from afar; and the margin around the circle: cells and errors.
_TRAIL_S, _TRAIL_M = 1.0, 0.15


# Floor without depth carries the robot where its axle stood on it, within the width of a bearing and a bin; and as far
# beside its outline as poses and paths err.
_STOOD_M, _BESIDE_TRACK_M = 0.1, 0.15


def watch_floor(
    monitor: CollisionMonitor,
    events: Sequence[Event],
    where: WhereNow,
    viewer: DepthViewer,
    carries: Callable[[FloatArray], BoolArray] | None = None,
) -> DepthView | None:
    """Give the collision monitor the wheel readings of a period and its newest frame; return the view of that frame.

    Args:
        carries: as in `DepthViewer.view`.
    """
    newest, view = next((event for event in reversed(events) if isinstance(event, RgbdFrame)), None), None
    for event in events:
        if isinstance(event, WheelTicks | WheelSpeeds):
            speed = where.roll(event)
            if speed is not None:
                monitor.add_reading(speed.stamp_s, speed.forward_m_s, speed.turn_rad_s, speed.rolled)
        elif event is newest and isinstance(event, RgbdFrame):
            view = viewer.view(event.depth_m, event.stamp_s, carries)
            monitor.add_view(view)
    return view


class Senses:
    """Sensor data and surroundings of one robot. The collision monitor gets wheel readings and frames first.

    Args:
        calibration: of the robot; with wheels and a mounted depth camera.

    Attributes:
        near_m: distance from the axle to the nearest floor that the camera sees.
        half_view_rad: half of the camera's horizontal field of view.
        eye: the camera, as it observes the floor along a path.
        avoids_hidden: whether unseen floor beside the robot counts as an obstacle. False if no path exists otherwise,
            as at a bend of a narrow corridor.

    Raises ArgumentError, MapError, CalibrationError if there are no wheels, no camera, or no mount of the camera.
    """

    def __init__(
        self,
        calibration: Calibration,
        localization: Localization,
        floor: Floor,
        monitor: CollisionMonitor,
        footprint: Footprint,
        settings: NavigationSettings,
    ) -> None:
        if calibration.wheels is None:
            fix = "a robot with two driven wheels, calibrated: docs/wheel-calibration.md"
            raise ArgumentError(f"the calibration {calibration.lacks_two_wheels}", fix=fix)
        self.localization, self.floor, self._monitor = localization, floor, monitor
        self._footprint, self._settings, self._outline = footprint, settings, outline_of(footprint)
        self._viewer = DepthViewer(calibration, footprint, settings.live)
        self.near_m, self.half_view_rad = self._viewer.near_m, self._viewer.half_rad
        self.eye = Eye(*self._viewer.camera, self.half_view_rad, AIR_M, CHECK_M)
        self._live = LiveLayer(calibration, footprint, settings.live)
        self.where = WhereNow(calibration.wheels)
        self.avoids_hidden = True
        self._people = PeopleTracker(settings.live.far_m)
        self._views: deque[DepthView] = deque(maxlen=_VIEWS)
        # Poses in `odom` from the start until the place in the map is known; None from then on.
        self._unplaced: deque[FloatArray] | None = deque(maxlen=_PLACES)
        self._local: dict[bool, tuple[object, Costmap]] = {}  # with what each depends on
        self._stays: tuple[float | None, FloatArray] = (None, np.empty((0, 2)))
        self._track = floor.driven  # places (N, 2) of the axle in the map, on this drive and the one of the map

    def update(self, events: Sequence[Event], now_s: float) -> None:
        """Process all events of a period that ends now. Raises what the localization raises.

        The monitor gets only the newest frame of a period, so that a late program does not become later.
        """
        view = watch_floor(self._monitor, events, self.where, self._viewer, self.carries)
        if view is not None:
            self._views.append(view)
        for event in events:
            self.where.ask(event.stamp_s)
        for event, estimate in self.localization.process(events):
            self.where.processed(event.stamp_s)
            if estimate is None:
                continue
            self.where.answer(estimate)
            if isinstance(event, RgbdFrame) and estimate.T_odom_body is not None:
                pose = planar_pose(estimate.T_odom_body)
                if self._live.is_due(event.stamp_s):
                    self._live.update(event.depth_m, pose, event.stamp_s)
                self._follow_people(event.stamp_s, pose)
        self._update_floor(now_s)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences of the localization about faults of sensors, if it has such a property."""
        return getattr(self.localization, "warnings", ())

    def _update_floor(self, now_s: float) -> None:
        """Update the floor with the robot's pose. Once the place in the map is known, earlier poses follow."""
        state, odom_pose = self.where.state, self.where.odom_pose
        if state is None:
            if self._unplaced is not None and odom_pose is not None:
                self._unplaced.append(odom_pose)
            self.floor.update(None, now_s)
            return
        T_map_odom = se2.from_parts(*self.where.T_map_odom)
        for before in self._unplaced or ():
            self.floor.update(np.array(se2.to_parts(T_map_odom @ se2.from_parts(*before))), now_s)
        # A robot that gets lost later may have been carried, so its wheels do not give its path to where it is found.
        self._unplaced = None
        self.floor.update(state.pose, now_s)
        if not len(self._track) or np.hypot(*(self._track[-1] - state.pose[:2])) > _STOOD_M / 2:
            self._track = np.concatenate([self._track, state.pose[None, :2]])

    def carries(self, points: FloatArray) -> BoolArray:
        """Return which points (N, 2) in `base`, from where no depth comes back, are floor.

        They are so by the word of a person, or as the robot crossed them: its axle stood on such floor near to them. A
        robot that drove beside a hole does not prove that there is floor in it.
        """
        pose, found = self.where.odom_pose, np.zeros(len(points), bool)
        if pose is None or self.where.state is None:
            return found
        at = se2.apply(se2.from_parts(*self.where.T_map_odom) @ se2.from_parts(*pose), points)
        for polygon in self.floor.declared:
            found |= shapely.contains_xy(shapely.Polygon(polygon).buffer(_STOOD_M), *at.T)
        tree = cKDTree(at)
        near = self._track[np.isfinite(tree.query(self._track, distance_upper_bound=_STOOD_M)[0])]
        if len(near):
            most_m = self._footprint.inscribed_m + _BESIDE_TRACK_M
            found |= np.isfinite(cKDTree(near).query(at, distance_upper_bound=most_m)[0])
        return found

    def _follow_people(self, stamp_s: float, pose: FloatArray) -> None:
        """Track people with the frame that was taken at (3,) in `odom`, and remove them from the live layer."""
        while self._views and self._views[0].stamp_s < stamp_s:
            self._views.popleft()
        if not self._settings.people.is_predicted or not self._views or self._views[0].stamp_s != stamp_s:
            return
        if self.where.state is None:
            self._people.forget()
            return
        view = self._views[0]
        # Whether the points lie on free floor of the map, away from its obstacles.
        T = se2.from_parts(*self.where.T_map_odom) @ se2.from_parts(*pose)
        near = self.floor.layer.window(T[:2, 2], 2 * LIVE_SIZE_M)
        reach = math.ceil(_BESIDE_M / near.resolution_m)
        beside = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
        is_thing = cv2.dilate((near.state == CellState.OCCUPIED).astype(np.uint8), beside) > 0
        cells = (se2.apply(T, view.points) - near.origin) / near.resolution_m
        column, row = np.clip(np.floor(cells).astype(int), 0, len(near.state) - 1).T
        is_on_floor = (near.state == CellState.FREE)[row, column] & ~is_thing[row, column]
        self._people.update(view, pose, np.asarray(is_on_floor))
        for person in self._people.people(stamp_s):
            behind = person.position - _TRAIL_S * person.velocity
            self._live.wipe([person.position, behind], person.radius_m + _TRAIL_M)

    def people(self, now_s: float) -> tuple[Person, ...]:
        """Return the people around the robot, with their places in the map now."""
        T_map_odom = self.where.T_map_odom
        return tuple(person.carried(T_map_odom) for person in self._people.people(now_s))

    def keeps_clear(self, command: VelocityCommand) -> bool:
        """Return whether a command keeps clear of the map's obstacles, as far as the pose is known.

        In a fixed map a backward command must also avoid unknown floor, as no camera looks there.
        """
        local, state = self.local(), self.where.state
        if local is None or state is None:
            return True
        is_blind = self.floor.is_fixed and command.forward_m_s < 0
        return keeps_clear(local, self._outline, state.pose, command, minds_unknown=is_blind)

    def open_way(self) -> OpenWay | None:
        """Return the direction to search for the pose in; None if the robot must stay.

        It stays if the map has a keep-out zone, which may be anywhere around it.
        """
        pose, s = self.where.odom_pose, self._settings
        if pose is None or self.floor.has_keep_out or not s.behaviours.search_m:
            return None
        costmap = Costmap.of_live(self._obstacles(), self._footprint, s.costmap)
        return open_way(costmap, self._outline, pose, s.drivable.wanted_margin_m)

    def clear(self, *, only_ahead: bool = False) -> None:
        """Remove recent obstacles, all of them or those in view only. Real ones return with the next images."""
        pose = self.where.odom_pose
        if not only_ahead:
            self._live.clear(SETTLED_S)
        elif pose is not None:
            eye = se2.from_parts(*pose) @ se2.from_parts(self.eye.x, self.eye.y, 0.0)
            self._live.clear_ahead(SETTLED_S, se2.to_parts(eye), self.half_view_rad)

    def clear_near(self, xy_map: ArrayLike, radius_m: float) -> None:
        """Remove the obstacles near a place (2,) in the map, because a person sees none there."""
        pose = self.where.odom_pose
        if pose is None:
            return
        at = np.asarray(xy_map, float).reshape(1, 2)
        at_odom = se2.apply(se2.invert(se2.from_parts(*self.where.T_map_odom)), at)
        self._live.wipe(np.repeat(at_odom, 2, axis=0), radius_m)
        self._monitor.memory.forget_near(se2.apply(se2.invert(se2.from_parts(*pose)), at_odom)[0], radius_m)
        self._local.clear()

    def what_stays(self) -> FloatArray | None:
        """Return (2,) in the map of the nearest obstacle in view without depth on or behind it; None without any."""
        pose = self.where.odom_pose
        if pose is None:
            return None
        stamp_s = self._live.obstacles().stamp_s
        if self._stays[0] != stamp_s:
            near_m = self.near_m - self.eye.x
            T_odom_eye = se2.from_parts(*pose) @ se2.from_parts(self.eye.x, self.eye.y, 0.0)
            places = self._live.not_seen_through(se2.to_parts(T_odom_eye), self.half_view_rad, near_m)
            self._stays = stamp_s, places
        places = self._stays[1]
        if not len(places):
            return None
        nearest = places[int(np.argmin(np.hypot(*(places - pose[:2]).T)))]
        return np.asarray(se2.apply(se2.from_parts(*self.where.T_map_odom), nearest[None])[0])

    def floor_now(self) -> FloorNow:
        """Return all that is known of the floor now, without people who pass by."""
        obstacles = self._obstacles()
        obstacles = obstacles.standing() if self.floor.is_fixed else obstacles
        T_map_odom = self.where.T_map_odom
        return FloorNow(self.floor.layer, obstacles, T_map_odom, self.hidden(), self._footprint, self._settings.costmap)

    def hidden(self, reach_m: float = math.inf) -> FloatArray:
        """Return floor near the robot that no camera has seen.

        Returns:
            (N, 3) x and y in the map, and how near the camera must look to observe it. For floor that the map knows,
            that is as near as the monitor lets the robot drive.
        """
        pose = self.where.odom_pose
        if pose is None:
            return np.empty((0, 3))
        T_map_base = se2.from_parts(*self.where.T_map_odom) @ se2.from_parts(*pose)
        kinds = [(CellState.FREE, _HIDDEN_KNOWN_M)]
        # If unknown floor is forbidden, all of it is an obstacle already.
        if self._settings.costmap.unknown != "forbidden":
            kinds.append((CellState.UNKNOWN, _HIDDEN_DEEP_M))
        found = []
        for state, deep_m in kinds:
            points = se2.apply(T_map_base, self._monitor.memory.hidden(reach_m, deep_m))
            points = points[self.floor.layer.state_at(points) == state]
            found.append(np.column_stack([points, np.full(len(points), deep_m)]))
        return np.concatenate(found)

    def _obstacles(self, hidden: FloatArray | None = None) -> LiveObstacles:
        """Return the live layer with the obstacles that the monitor remembers, and with hidden floor (N, 3)."""
        live, pose = self._live.obstacles(), self.where.odom_pose
        if pose is None:
            return live
        T_odom_base = se2.from_parts(*pose)
        things = self._monitor.memory.remembered(self._footprint.circumscribed_m + HIDDEN_M)
        refused = [se2.apply(T_odom_base, things)]
        if hidden is not None:
            T_odom_map = se2.invert(se2.from_parts(*self.where.T_map_odom))
            refused.append(se2.apply(T_odom_map, hidden[:, :2]))
        return live.with_points(np.concatenate(refused))

    def local(self, *, for_plans: bool = False) -> Costmap | None:
        """Return the costmap around the robot, cached until its inputs change; None while the pose is unknown.

        Args:
            for_plans: leave out people who pass by and unseen floor. A growing map keeps all recent obstacles, as most
                of them stand.
        """
        state = self.where.state
        if state is None:
            return None
        layer, T_map_odom = self.floor.layer, self.where.T_map_odom
        # The window moves in steps of a quarter: the controller looks ahead by half of it.
        x, y = (round(float(at) / (LOCAL_M / 4)) for at in state.pose[:2])
        stamp_s = self._live.obstacles().stamp_s
        made = stamp_s, self.avoids_hidden, self.floor.revision, x, y, *T_map_odom.tolist()
        known = self._local.get(for_plans)
        if known is None or known[0] != made:
            window = layer.window((x * LOCAL_M / 4, y * LOCAL_M / 4), 1.5 * LOCAL_M)
            near_m = self._footprint.circumscribed_m + HIDDEN_M
            live = self._obstacles(self.hidden(near_m) if self.avoids_hidden and not for_plans else None)
            live = live.standing() if for_plans and self.floor.is_fixed else live
            costmap = Costmap.of(window, self._footprint, self._settings.costmap, live, T_map_odom)
            outline = self._footprint.padded(self._settings.follow.margin_m + 2 * layer.resolution_m)
            known = self._local[for_plans] = (made, costmap.standing_at(outline, state.pose))
        return known[1]


# History of wheel odometry. Estimates of frames arrive within it, unless the localization hangs.
_TRACK_S = 3.0
# Window of a speed, and the least of it: until the first readings span that, the speed is 0.
_SPEED_S, _LEAST_S = 0.04, 0.01
# Growth of a position's standard deviation by wheels alone at which it is unknown: half a robot's width.
_UNSURE_M = 0.3
# Hold of a more certain pose: its longest time, as a person who passes fills the view for one or two seconds, and way;
# the standard deviation of an estimate that is used as it is, a cell; and the error of wheels, as a share of the way.
_HOLD_S, _HOLD_M, _SURE_M, _WHEELS_SHARE = 3.0, 1.0, 0.05, 0.05
# Standard deviations within which 95 % of errors lie, in two dimensions and in one.
_95_IN_PLANE, _95_OF_ONE = 2.45, 1.96


@dataclass(frozen=True, slots=True)
class WheelSpeed:
    """Velocity of the base by its encoders.

    Attributes:
        forward_m_s, turn_rad_s: means over a short time until then.
        rolled: metres along the arc and radians since the reading before. Integrated means of speeds would lag behind
            by half of their window.
    """

    stamp_s: float
    forward_m_s: float
    turn_rad_s: float
    rolled: tuple[float, float] = (0.0, 0.0)


class WhereNow:
    """Current pose of the robot: the last estimate, or a slightly earlier one, carried on by wheel odometry.

    Wheels carry it for a limited time and way; `is_silent` becomes true if the localization does not answer by then.

    The wheels are integrated here and in the localizer. Beside a robot, a reading waits in the localizer for the frame
    before it: 40 ms, 90 ms in one of twenty (`docs/benchmarks/peers.md`). The collision monitor needs the speed in each
    period of 50 ms, also from a localizer that is silent. The integration takes 0.01 ms a reading.
    """

    def __init__(self, wheels: Wheels) -> None:
        self._wheels = WheelOdometry(wheels)
        self._held: HeldPlace | None = None
        self._track: deque[tuple[float, FloatArray]] = deque()
        self._received_s = self._answered_s = -math.inf
        self._unanswered_m = 0.0
        self.estimate: Estimate | None = None
        self._known_sigma_m = 0.0
        self.speed = WheelSpeed(-math.inf, 0.0, 0.0)

    def roll(self, reading: WheelTicks | WheelSpeeds) -> WheelSpeed | None:
        """Process a wheel reading. Return the speed of the base, or None if the reading gives none."""
        try:
            answer = self._wheels.process(reading)
        except ArgumentError:
            return None
        if answer.reason is not None:
            return None
        T_now = se2.from_parts(*self._wheels.pose)
        way = se2.log(se2.invert(self._track[-1][1]) @ T_now) if self._track else np.zeros(3)
        self._unanswered_m += abs(float(way[0]))
        self._track.append((answer.stamp_s, T_now))
        while len(self._track) > 2 and self._track[1][0] < answer.stamp_s - _TRACK_S:
            self._track.popleft()
        # A mean over a short time, as stamps jitter, and two may be 0.1 ms apart.
        before = [(then_s, T) for then_s, T in self._track if then_s <= answer.stamp_s - _SPEED_S]
        then_s, T_then = before[-1] if before else self._track[0]
        forward = turn = 0.0
        if answer.stamp_s - then_s >= _LEAST_S:
            speeds = se2.log(np.linalg.inv(T_then) @ T_now) / (answer.stamp_s - then_s)
            forward, turn = float(speeds[0]), float(speeds[2])
        self.speed = WheelSpeed(answer.stamp_s, forward, turn, rolled=(float(way[0]), float(way[2])))
        return self.speed

    def ask(self, stamp_s: float) -> None:
        """Record that the localization got an event with this stamp."""
        self._received_s = max(self._received_s, stamp_s)

    def processed(self, stamp_s: float) -> None:
        """Record that the localization has processed an event with this stamp, with or without an estimate."""
        if stamp_s > self._answered_s:
            self._answered_s = stamp_s
            self._unanswered_m = float(np.hypot(*self._since(stamp_s)[:2, 2]))

    @property
    def silent_s(self) -> float:
        """Seconds of events that the localization has not processed; 0 before its first answer."""
        return max(self._received_s - self._answered_s, 0.0) if math.isfinite(self._answered_s) else 0.0

    @property
    def is_silent(self) -> bool:
        """Whether the localization is silent for longer, or for more way, than wheels may carry the pose."""
        return self.silent_s > SILENT_S or (self.silent_s > COASTING_S and self._unanswered_m > SILENT_M)

    def answer(self, estimate: Estimate) -> None:
        """Process an estimate."""
        self.estimate = estimate
        if estimate.status in (Status.TRACKING, Status.UNCONFIRMED):
            self._known_sigma_m = _sigma_m(estimate)
        if estimate.T_map_body is None or estimate.status in (Status.LOST, Status.FAILING):
            self._held = None
            return
        T_wheels, sigma_m = self._rolled_at(estimate.stamp_s), math.inf
        if estimate.covariance_map is not None:
            sigma_m = _worse_sigma_m(estimate.T_map_body, estimate.covariance_map)
        slips = isinstance(estimate, FusedEstimate) and estimate.slip
        if self._held is None or slips or not self._held.holds(sigma_m, T_wheels, estimate.stamp_s):
            self._held = HeldPlace(_planar(estimate.T_map_body), T_wheels, sigma_m, estimate.stamp_s)

    @property
    def status(self) -> Status:
        """Status of the last estimate, or `INITIALIZING` before it.

        Late estimates limit it to `COASTING`; silence limits it to `FAILING`.
        """
        if self.estimate is None:
            return Status.INITIALIZING
        if self.is_silent:
            return Status.FAILING
        is_late = self.silent_s > COASTING_S
        return Status.COASTING if is_late and self.estimate.status is Status.TRACKING else self.estimate.status

    @property
    def is_rolling(self) -> bool:
        """Whether the motion in `odom` is known, even without a place in the map."""
        return self.estimate is not None and self.estimate.T_odom_body is not None and self.status is not Status.LOST

    @property
    def grown_sigma_m(self) -> float:
        """Growth of the position's standard deviation since the last tracked estimate, metres."""
        known, answer = self._known_sigma_m, self.estimate
        return 0.0 if answer is None else math.sqrt(max(_sigma_m(answer) ** 2 - known**2, 0.0))

    @property
    def driving_status(self) -> Status:
        """Status for the collision monitor: a robot without a place in the map, but with a known motion, may search."""
        is_searching = self.status is Status.INITIALIZING and self.is_rolling
        return Status.COASTING if is_searching else self.status

    @property
    def is_known(self) -> bool:
        """Whether the pose in the map is known, with at most `_UNSURE_M` more deviation than when tracked."""
        return not self.why_unknown

    @property
    def why_unknown(self) -> str:
        """Why the pose in the map is unknown, as of `is_known`; empty if it is known."""
        if self.is_silent:
            return f"the localization has not answered for {self.silent_s:.1f} s"
        if self.state is None:
            return "it is not known where it is"
        if self.grown_sigma_m > _UNSURE_M:
            return f"its place is known to {self.grown_sigma_m:.1f} m only"
        return ""

    @property
    def accuracy(self) -> tuple[float, float] | None:
        """Errors of the pose in the map, metres and radians, within which 95 % of poses lie.

        None if the localization states none in the map, as without loops. Infinite for an unknown or unconfirmed place.
        """
        held, estimate = self._held, self.estimate
        if held is None or estimate is None or estimate.status is Status.UNCONFIRMED:
            return math.inf, math.inf
        if estimate.covariance_map is None or not math.isfinite(held.sigma_m):
            return None
        sigma_rad = math.sqrt(max(float(estimate.covariance_map[5, 5]), 0.0))
        return _95_IN_PLANE * held.sigma_m_at(self._rolled_at(math.inf)), _95_OF_ONE * sigma_rad

    @property
    def odom_pose(self) -> FloatArray | None:
        """(3,) x, y, yaw of the base in `odom` now; None while unknown."""
        answer = self.estimate
        if answer is None or answer.T_odom_body is None:
            return None
        return _pose(_planar(answer.T_odom_body) @ self._since(answer.stamp_s))

    @property
    def T_map_odom(self) -> FloatArray:
        """(3,) x, y, yaw of `odom` in `map`."""
        held, odom_pose = self._held, self.odom_pose
        if held is None or odom_pose is None:
            return np.zeros(3) if self.estimate is None else _pose(_planar(self.estimate.T_map_odom))
        return _pose(held.carried(self._rolled_at(math.inf)) @ se2.invert(se2.from_parts(*odom_pose)))

    @property
    def state(self) -> MotionState | None:
        """Pose and speed in the map now; None while the pose in the map is unknown."""
        if self._held is None:
            return None
        pose = _pose(self._held.carried(self._rolled_at(math.inf)))
        return MotionState(pose, self.speed.forward_m_s, self.speed.turn_rad_s)

    def _since(self, stamp_s: float) -> FloatArray:
        """Return (3, 3), the motion of the base since a stamp by the wheels; the identity if the stamp is too old."""
        return np.asarray(se2.invert(self._rolled_at(stamp_s)) @ self._rolled_at(math.inf))

    def _rolled_at(self, stamp_s: float) -> FloatArray:
        """Return (3, 3), the wheels' own pose at a stamp; the newest one if the stamp is too old."""
        before = [T for track_s, T in self._track if track_s <= stamp_s]
        if before:
            return before[-1]
        return self._track[-1][1] if self._track else np.eye(3)


def planar_pose(T: FloatArray) -> FloatArray:
    """Return (3,) x, y, yaw of a rigid motion (4, 4)."""
    return _pose(_planar(T))


def _planar(T: FloatArray) -> FloatArray:
    return se2.from_parts(T[0, 3], T[1, 3], np.arctan2(T[1, 0], T[0, 0]))


def _pose(T: FloatArray) -> FloatArray:
    return np.array(se2.to_parts(T), float)


def _sigma_m(estimate: Estimate) -> float:
    """Return the horizontal standard deviation of the filter along its larger axis; 0 if there is none."""
    if estimate.filter_covariance is None or estimate.T_filter_body is None:
        return 0.0
    return _worse_sigma_m(estimate.T_filter_body, estimate.filter_covariance)


def _worse_sigma_m(T: FloatArray, covariance: FloatArray) -> float:
    """Return the deviation along the larger horizontal axis, of a pose (4, 4) with covariance (6, 6)."""
    C = se3.position_covariance(T, covariance)
    # Rounding may make it negative.
    return float(np.sqrt(max(np.linalg.eigvalsh(C[:2, :2])[-1], 0.0)))


@dataclass(frozen=True, slots=True, eq=False)
class HeldPlace:
    """A pose in the map that wheels carry on for a moment, while the localization is less certain than it was.

    A person who passes close to the camera contradicts the wheels for a second. During that time the estimate has a
    deviation of tens of centimetres, and jumps as far. Wheels without slip are off by millimetres in that time.

    Attributes:
        T_map_base: (3, 3) pose of the base.
        T_wheels: (3, 3) the wheels' own pose at the same time, in a frame of its own.
        sigma_m: standard deviation along the larger horizontal axis, by the localization.
    """

    T_map_base: FloatArray
    T_wheels: FloatArray
    sigma_m: float
    stamp_s: float

    def carried(self, T_wheels: FloatArray) -> FloatArray:
        """Return (3, 3), the pose of the base when the wheels' own pose is (3, 3)."""
        return np.asarray(self.T_map_base @ se2.invert(self.T_wheels) @ T_wheels)

    def _way_m(self, T_wheels: FloatArray) -> float:
        x, y, _ = se2.to_parts(se2.invert(self.T_wheels) @ T_wheels)
        return float(np.hypot(x, y))

    def sigma_m_at(self, T_wheels: FloatArray) -> float:
        """Return the standard deviation of the carried pose when the wheels' own pose is (3, 3)."""
        return float(np.hypot(self.sigma_m, _WHEELS_SHARE * self._way_m(T_wheels)))

    def holds(self, sigma_m: float, T_wheels: FloatArray, stamp_s: float) -> bool:
        """Return whether it is still better than a new estimate with the deviation `sigma_m`."""
        is_late = stamp_s - self.stamp_s > _HOLD_S or self._way_m(T_wheels) > _HOLD_M
        is_sure = sigma_m <= max(self.sigma_m_at(T_wheels), _SURE_M)
        return not is_late and not is_sure and np.isfinite(sigma_m)
