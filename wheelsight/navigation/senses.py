"""Senses: distributes sensor data to all of navigation, and keeps the surroundings derived from it."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike

from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import ArgumentError
from wheelsight.core.geometry import BoolArray, FloatArray, se2
from wheelsight.core.keyframes import KeyframeStore
from wheelsight.core.messages import Event, RgbdFrame, VelocityCommand, WheelSpeeds, WheelTicks
from wheelsight.navigation.behaviours import OpenWay, keeps_clear, open_way
from wheelsight.navigation.collision_monitor import CollisionMonitor
from wheelsight.navigation.costmap import CellState, Costmap, FloorNow, LiveLayer, LiveObstacles
from wheelsight.navigation.footprint import Footprint, outline_of
from wheelsight.navigation.localization import Localization, WhereNow, planar_pose
from wheelsight.navigation.people import PeopleTracker, Person
from wheelsight.navigation.settings import NavigationSettings
from wheelsight.navigation.static_map import Floor
from wheelsight.navigation.surroundings import DepthView, DepthViewer
from wheelsight.navigation.view_kernels import Eye

# Views that wait for the pose of their frame: two seconds of a Kinect.
_VIEWS = 60
# Poses stored while the place in the map is unknown: three minutes of a search.
_PLACES = 3600


@dataclass(frozen=True, slots=True)
class _LocalKey:
    """What a local costmap depends on; an equal key means an equal costmap."""

    frame_s: float | None
    avoids_hidden: bool
    revision: int
    cell: tuple[int, int]
    T_map_odom: tuple[float, float, float]


class Senses:
    """Sensor data and surroundings of one robot. The collision monitor gets wheel readings and frames first.

    Args:
        calibration: of the robot; with wheels and a mounted depth camera.
        localization: source of the pose.
        floor: the known part of the building.
        monitor: gets all sensor data.
        footprint, settings: of the robot.

    Attributes:
        where: pose of the robot.
        avoids_hidden: whether unseen floor beside the robot counts as an obstacle. False if no path exists otherwise,
            as at a bend of a narrow corridor.

    Raises:
        ArgumentError, MapError, CalibrationError: there are no wheels, no camera, or no mount of the camera.
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
        self._localization, self._floor, self._monitor = localization, floor, monitor
        self._footprint, self._settings, self._outline = footprint, settings, outline_of(footprint)
        self._viewer = DepthViewer(calibration, footprint, settings.view, settings.live)
        self._live = LiveLayer(calibration, footprint, settings.live)
        self.where = WhereNow(calibration.wheels, settings.hold)
        self.avoids_hidden = True
        self._people = PeopleTracker(settings.people, settings.live.far_m)
        self._views: deque[DepthView] = deque(maxlen=_VIEWS)
        # Poses in `odom` from the start until the place in the map is known; None from then on.
        self._unplaced: deque[FloatArray] | None = deque(maxlen=_PLACES)
        self._local: dict[bool, tuple[_LocalKey, Costmap]] = {}
        self._stays: tuple[float | None, FloatArray] = (None, np.empty((0, 2)))

    @property
    def near_m(self) -> float:
        """Distance from the axle to the nearest floor that the camera sees."""
        return self._viewer.near_m

    @property
    def half_view_rad(self) -> float:
        """Half of the camera's horizontal field of view."""
        return self._viewer.half_rad

    @property
    def eye(self) -> Eye:
        """The camera, as it observes the floor along a path."""
        x, y = self._viewer.camera
        return Eye(x, y, self.half_view_rad, self._settings.monitor.air_m, self._settings.navigator.check_m)

    @property
    def floor(self) -> Floor:
        """The known part of the building."""
        return self._floor

    @property
    def keyframes(self) -> KeyframeStore | None:
        """Keyframes of the localization."""
        return self._localization.keyframes

    @property
    def recognised(self) -> int | None:
        """Number of recognitions of an earlier map by the localization."""
        return self._localization.recognised

    def hear(self, events: Sequence[Event], now_s: float) -> None:
        """Process all events of a period that ends now. Raises what the localization raises.

        The monitor gets only the newest frame of a period, so that a late program does not become later.
        """
        newest = next((event for event in reversed(events) if isinstance(event, RgbdFrame)), None)
        for event in events:
            if isinstance(event, WheelTicks | WheelSpeeds):
                speed = self.where.roll(event)
                if speed is not None:
                    self._monitor.hear(speed.stamp_s, speed.forward_m_s, speed.turn_rad_s, speed.rolled)
            elif event is newest and isinstance(event, RgbdFrame):
                self._views.append(self._viewer.view(event.depth_m, event.stamp_s))
                self._monitor.see(self._views[-1])
        for event in events:
            self.where.ask(event.stamp_s)
        for event, estimate in self._localization.hear(events):
            self.where.processed(event.stamp_s)
            if estimate is None:
                continue
            self.where.answer(estimate, self._localization.recognised)
            if isinstance(event, RgbdFrame) and estimate.T_odom_body is not None:
                pose = planar_pose(estimate.T_odom_body)
                if self._live.is_due(event.stamp_s):
                    self._live.update(event.depth_m, pose, event.stamp_s)
                self._follow_people(event.stamp_s, pose)
        self._update_floor(now_s)

    def _update_floor(self, now_s: float) -> None:
        """Update the floor with the robot's pose. Once the place in the map is known, earlier poses follow."""
        state, odom_pose = self.where.state, self.where.odom_pose
        if state is None:
            if self._unplaced is not None and odom_pose is not None:
                self._unplaced.append(odom_pose)
            self._floor.update(None, now_s)
            return
        T_map_odom = se2.from_parts(*self.where.T_map_odom)
        for before in self._unplaced or ():
            self._floor.update(np.array(se2.to_parts(T_map_odom @ se2.from_parts(*before))), now_s)
        # A robot that gets lost later may have been carried, so its wheels do not give its path to where it is found.
        self._unplaced = None
        self._floor.update(state.pose, now_s)

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
        self._people.update(view, pose, self._is_on_floor(view, se2.from_parts(*pose)))
        s = self._settings.people
        for person in self._people.people(stamp_s):
            behind = person.position - s.trail_s * person.velocity
            self._live.wipe([person.position, behind], person.radius_m + s.trail_m)

    def _is_on_floor(self, view: DepthView, T_odom_base: FloatArray) -> BoolArray:
        """Return (N,) whether a view's points lie on free floor of the map, away from its obstacles."""
        T = se2.from_parts(*self.where.T_map_odom) @ T_odom_base
        near = self._floor.layer.window(T[:2, 2], 2 * self._settings.live.size_m)
        reach = math.ceil(self._settings.people.beside_m / near.resolution_m)
        beside = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
        is_thing = cv2.dilate((near.state == CellState.OCCUPIED).astype(np.uint8), beside) > 0
        cells = (se2.apply(T, view.points) - near.origin) / near.resolution_m
        column, row = np.clip(np.floor(cells).astype(int), 0, len(near.state) - 1).T
        return np.asarray((near.state == CellState.FREE)[row, column] & ~is_thing[row, column])

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
        is_blind = self._floor.is_fixed and command.forward_m_s < 0
        how = self._outline, state.pose, command, self._settings.behaviours
        return keeps_clear(local, *how, minds_unknown=is_blind)

    def open_way(self) -> OpenWay | None:
        """Return the direction to search for the pose in; None if the robot must stay.

        It stays if the map has a keep-out zone, which may be anywhere around it.
        """
        pose, s = self.where.odom_pose, self._settings
        if pose is None or self._floor.has_keep_out or not s.behaviours.search_m:
            return None
        costmap = Costmap.of_live(self._obstacles(), self._footprint, s.costmap)
        return open_way(costmap, self._outline, pose, s.drivable.wanted_margin_m)

    def clear(self, *, only_ahead: bool = False) -> None:
        """Remove recent obstacles, all of them or those in view only. Real ones return with the next images."""
        pose, stood_s = self.where.odom_pose, self._settings.live.settled_s
        if not only_ahead:
            self._live.clear(stood_s)
        elif pose is not None:
            eye = se2.from_parts(*pose) @ se2.from_parts(self.eye.x, self.eye.y, 0.0)
            self._live.clear_ahead(stood_s, se2.to_parts(eye), self.half_view_rad)

    def clear_near(self, xy_map: ArrayLike, radius_m: float) -> None:
        """Remove the obstacles near a place (2,) in the map, because a person sees none there."""
        pose = self.where.odom_pose
        if pose is None:
            return
        at = np.asarray(xy_map, float).reshape(1, 2)
        at_odom = se2.apply(se2.invert(se2.from_parts(*self.where.T_map_odom)), at)
        self._live.wipe(np.repeat(at_odom, 2, axis=0), radius_m)
        self._monitor.forget_near(se2.apply(se2.invert(se2.from_parts(*pose)), at_odom)[0], radius_m)
        self._local.clear()

    def what_stays(self) -> FloatArray | None:
        """Return (2,) in the map of the nearest obstacle in view without depth on or behind it; None without any."""
        pose = self.where.odom_pose
        if pose is None:
            return None
        stamp_s = self._live.obstacles().stamp_s
        if self._stays[0] != stamp_s:
            near_m = self._viewer.near_m - self.eye.x
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
        obstacles = obstacles.standing() if self._floor.is_fixed else obstacles
        T_map_odom = self.where.T_map_odom
        return FloorNow(
            self._floor.layer, obstacles, T_map_odom, self.hidden(), self._footprint, self._settings.costmap
        )

    def hidden(self, reach_m: float = math.inf) -> FloatArray:
        """Return floor near the robot that no camera has seen.

        Returns:
            (N, 3) x and y in the map, and how near the camera must look to observe it. For floor that the map knows,
            that is as near as the monitor lets the robot drive.
        """
        pose, s = self.where.odom_pose, self._settings
        if pose is None:
            return np.empty((0, 3))
        T_map_base = se2.from_parts(*self.where.T_map_odom) @ se2.from_parts(*pose)
        kinds = [(CellState.FREE, s.navigator.hidden_known_m)]
        # If unknown floor is forbidden, all of it is an obstacle already.
        if s.costmap.unknown != "forbidden":
            kinds.append((CellState.UNKNOWN, s.navigator.hidden_deep_m))
        found = []
        for state, deep_m in kinds:
            points = se2.apply(T_map_base, self._monitor.hidden(reach_m, deep_m))
            points = points[self._floor.layer.state_at(points) == state]
            found.append(np.column_stack([points, np.full(len(points), deep_m)]))
        return np.concatenate(found)

    def _obstacles(self, hidden: FloatArray | None = None) -> LiveObstacles:
        """Return the live layer with the obstacles that the monitor remembers, and with hidden floor (N, 3)."""
        live, pose = self._live.obstacles(), self.where.odom_pose
        if pose is None:
            return live
        s, T_odom_base = self._settings.navigator, se2.from_parts(*pose)
        things = self._monitor.remembered(self._footprint.circumscribed_m + s.hidden_m)
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
        layer, side_m = self._floor.layer, self._settings.navigator.local_m
        T_map_odom = self.where.T_map_odom
        # The window moves in steps of a quarter: the controller looks ahead by half of it.
        x, y = (round(float(at) / (side_m / 4)) for at in state.pose[:2])
        stamp_s = self._live.obstacles().stamp_s
        made = _LocalKey(stamp_s, self.avoids_hidden, self._floor.revision, (x, y), tuple(T_map_odom.tolist()))
        known = self._local.get(for_plans)
        if known is None or known[0] != made:
            window = layer.window((x * side_m / 4, y * side_m / 4), 1.5 * side_m)
            near_m = self._footprint.circumscribed_m + self._settings.navigator.hidden_m
            live = self._obstacles(self.hidden(near_m) if self.avoids_hidden and not for_plans else None)
            live = live.standing() if for_plans and self._floor.is_fixed else live
            costmap = Costmap.of(window, self._footprint, self._settings.costmap, live, T_map_odom)
            outline = self._footprint.padded(self._settings.follow.margin_m + 2 * layer.resolution_m)
            known = self._local[for_plans] = (made, costmap.standing_at(outline, state.pose))
        return known[1]
