"""DriveLog: shows a drive to goals to Rerun as it goes: floor, costmap, plan, goal, robot, camera and statuses."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.events import Event, RgbdFrame
from wheelsight.geometry import ByteArray, FloatArray, se3
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
from wheelsight.navigation.localization import WhereNow
from wheelsight.settings import ViewerSettings
from wheelsight.viewer import blueprint as at
from wheelsight.viewer.scene import LINE_PX, STATUS_COLOURS, Scene

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
    """See the module. Poses are those of each period in which it is known where in the map the robot is.

    Args:
        stream: Rerun's, which knows where to write.
        calibration: of the robot.
        settings: see `ViewerSettings`.
    """

    def __init__(self, stream: Any, calibration: Calibration, settings: ViewerSettings) -> None:
        self._scene, self._settings = Scene(stream, calibration, settings), settings
        self._rr = self._scene.rr
        self._said: dict[str, str] = {}
        self._plan: Plan | None = None
        self._goal: FloatArray | None = None
        self._costmap: Costmap | None = None
        self._revision, self._maps_s = -1, -np.inf
        self._navigator: Navigator | None = None
        for name, colours in ((_LOCALIZATION, STATUS_COLOURS), (_NAVIGATOR, _STATES), (_MONITORED, _MONITOR)):
            self._scene.name_states(name, {str(state): colour for state, colour in colours.items()})

    def hear(self, events: Sequence[Event]) -> None:
        """What the robot's sensors said."""
        for event in events:
            self._scene.begin(event.stamp_s)
            if isinstance(event, RgbdFrame):
                self._scene.show_images(event)

    def note(self, transition: Transition) -> None:
        """A change of the navigator's state."""
        self._scene.begin(transition.stamp_s)
        self._scene.at(transition.stamp_s)
        self._scene.log(f"{at.WORDS}/{_NAVIGATOR}", self._rr.TextLog(str(transition)))

    def step(self, feedback: Feedback, navigator: Navigator) -> None:
        """A period is over."""
        self._scene.begin(feedback.stamp_s)
        self._scene.at(feedback.stamp_s)
        self._begin_map(navigator)
        self._show_robot(feedback, navigator.senses.where)
        self._show_statuses(feedback)
        self._show_plan(feedback)
        self._show_maps(feedback.stamp_s, navigator)

    def _begin_map(self, navigator: Navigator) -> None:
        """Of another map than before nothing is known yet; the way does not go on from where the robot was in that."""
        if self._navigator is not None and navigator is not self._navigator:
            self._revision, self._costmap, self._maps_s = -1, None, -np.inf
            self._scene.end_way()
            for place in (at.FLOOR, at.COSTMAP):
                self._scene.log(place, self._rr.Clear(recursive=False))
        self._navigator = navigator

    def _show_robot(self, feedback: Feedback, where: WhereNow) -> None:
        odom_pose = where.odom_pose
        if feedback.pose is not None and odom_pose is not None:
            self._scene.show_robot(se3.from_plane(*odom_pose), se3.from_plane(*where.T_map_odom))
        curves = {"forward_m_s": feedback.forward_m_s, "turn_rad_s": feedback.turn_rad_s, "to_go_m": feedback.to_go_m}
        for name, value in curves.items():
            if value is not None:
                self._scene.log(f"{at.CURVES}/{name}", self._rr.Scalars(value))

    def _show_statuses(self, feedback: Feedback) -> None:
        """Where they change."""
        monitor = feedback.monitor
        states = {_LOCALIZATION: str(feedback.status), _NAVIGATOR: str(feedback.state)}
        states |= {} if monitor is None else {_MONITORED: str(monitor.state)}
        for name, state in states.items():
            if self._has_changed(f"state of {name}", state):
                self._scene.show_state(name, state)
        why = "" if monitor is None or monitor.reason is None else str(monitor.reason)
        if self._has_changed("reason", why) and why:
            self._scene.log(f"{at.WORDS}/{_MONITORED}", self._rr.TextLog(why, level="WARN"))

    def _show_plan(self, feedback: Feedback) -> None:
        """Plan and goal where they change, nothing of them once there are none; what the controller expects."""
        if feedback.plan is not self._plan:
            self._plan = feedback.plan
            self._show_line(at.PLAN, None if self._plan is None else self._plan.poses, _BLUE)
        goal = feedback.goal
        if (goal is None) != (self._goal is None) or (goal is not None and (goal != self._goal).any()):
            self._goal = goal
            self._scene.log(at.GOAL, self._rr.Clear(recursive=False) if goal is None else self._arrow(goal))
        self._show_line(at.PREDICTED, feedback.predicted if len(feedback.predicted) else None, _SKY)

    def _show_line(self, place: str, poses: FloatArray | None, colour: tuple[int, int, int]) -> None:
        if poses is not None:
            points = np.column_stack([poses[:, :2], np.full(len(poses), _LINES_M)])
            self._scene.log(place, self._rr.LineStrips3D([points], colors=[colour], radii=self._scene.px(LINE_PX)))
        elif self._said.get(place):
            self._scene.log(place, self._rr.Clear(recursive=False))
        self._said[place] = "" if poses is None else "there"

    def _show_maps(self, stamp_s: float, navigator: Navigator) -> None:
        """The floor and the costmap about the robot, so many times a second, where they have changed."""
        rate_hz, senses = self._settings.costmap_rate_hz, navigator.senses
        if not rate_hz or stamp_s - self._maps_s < 1 / rate_hz - 1e-4:
            return
        self._maps_s = stamp_s
        if senses.floor.revision != self._revision:
            self._revision, floor = senses.floor.revision, senses.floor.layer
            self._scene.log(at.FLOOR, self._texture(floor, _floor_colours(floor), _FLOOR_M))
        local = senses.local()
        if local is not None and local is not self._costmap:
            self._costmap = local
            self._scene.log(at.COSTMAP, self._texture(local, _cost_colours(local), _COSTMAP_M))

    def _texture(self, cells: StaticLayer | Costmap, colours: ByteArray, z_m: float) -> Any:
        """Cells as a picture that lies in the map."""
        rows, columns = colours.shape[:2]
        x, y = cells.origin
        right, top = x + columns * cells.resolution_m, y + rows * cells.resolution_m
        return self._rr.Mesh3D(
            vertex_positions=[[x, y, z_m], [right, y, z_m], [right, top, z_m], [x, top, z_m]],
            triangle_indices=[[0, 1, 2], [0, 2, 3]],
            vertex_texcoords=[[0, 0], [1, 0], [1, 1], [0, 1]],
            albedo_texture=colours,
        )

    def _arrow(self, goal: FloatArray) -> Any:
        x, y, yaw = goal.tolist()
        ahead = [0.0, 0.0, 0.5] if np.isnan(yaw) else [0.5 * np.cos(yaw), 0.5 * np.sin(yaw), 0.0]
        return self._rr.Arrows3D(origins=[[x, y, _LINES_M]], vectors=[ahead], colors=[_PURPLE])

    def _has_changed(self, name: str, said: str) -> bool:
        before, self._said[name] = self._said.get(name), said
        return before != said


def _floor_colours(floor: StaticLayer) -> ByteArray:
    """(H, W, 3); row 0 is the least y."""
    colours = np.full((*floor.state.shape, 3), _UNKNOWN, np.uint8)
    colours[floor.state == CellState.FREE] = _FREE
    colours[floor.state == CellState.OCCUPIED] = _WALL
    return colours


def _cost_colours(costmap: Costmap) -> ByteArray:
    """(H, W, 3): from white, free, to orange, where the robot's middle can never be; lethal cells are dark."""
    share = costmap.cost[..., None].astype(float)
    colours = np.asarray(np.rint((1 - share) * _CHEAP + share * _COSTLY), np.uint8)
    colours[costmap.is_lethal] = _WALL
    return colours
