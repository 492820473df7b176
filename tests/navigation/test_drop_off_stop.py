"""The collision monitor stops a robot before floor that is missing, as at a stair down, at full speed too."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from narrowing import not_none
from navigation.rooms import Ride
from navigation.unguarded import FULL, Asks, without_monitor

from benchmarks.plain_rooms import EYE, SENSES_M, DepthEye, Walls, walls_about
from wheelsight.core.geometry import FloatArray
from wheelsight.navigation import MonitorReason, MonitorState, NavigationSettings
from wheelsight.navigation.controllers import ControlResult
from wheelsight.navigation.perception import LiveLayer
from wheelsight.navigation.settings import PeopleSettings

SIZE_M = (9.0, 6.0)
ROOM = walls_about(*SIZE_M)
EDGE_M, LOWER_M = 5.2, 1.0
BEGIN, GOAL = (1.5, 3.0, 0.0), (8.0, 3.0, 0.0)
# No one walks here, and looking for people takes time.
SETTINGS = NavigationSettings(people=PeopleSettings(is_predicted=False))


@dataclass
class Stair(Walls):
    """Walls as the others, and a floor that ends at an edge, beyond which it is lower."""

    # The edge lies at right angles to (cos, sin) of this, through the point straight ahead of where the robot begins.
    slant_rad: float

    def beyond_m(self, points: FloatArray) -> FloatArray:
        """(...) of points (..., 2): how far beyond the edge they are; less than 0 where there is floor."""
        c, s = np.cos(self.slant_rad), np.sin(self.slant_rad)
        return np.asarray((points[..., 0] - EDGE_M) * c + (points[..., 1] - BEGIN[1]) * s)

    def depth_m(self, T_map_camera: FloatArray, eye: DepthEye = EYE) -> FloatArray:
        rays, origin = eye.camera.rays() @ T_map_camera[:3, :3].T, T_map_camera[:3, 3]
        seen = super().depth_m(T_map_camera)
        with np.errstate(divide="ignore", invalid="ignore"):
            floor = np.where(rays[..., 2] < 0, -origin[2] / rays[..., 2], np.inf)
            lower = np.where(rays[..., 2] < 0, (-LOWER_M - origin[2]) / rays[..., 2], np.inf)
            is_beyond = np.isfinite(floor) & (self.beyond_m(origin[:2] + floor[..., None] * rays[..., :2]) > 0)
        # Walls are seen as they are; rays that met floor there, near or beyond the senses, go on to the lower floor.
        is_floor = np.isclose(seen, floor) | (seen == 0)
        lower = np.where((lower >= SENSES_M[0]) & (lower <= SENSES_M[1]), lower, 0.0)
        return np.where(is_beyond & is_floor, lower, seen)


def farthest_m(slant_rad: float, monkeypatch: pytest.MonkeyPatch, *, is_checked: bool) -> tuple[float, float, Ride]:
    """How far the outline came beyond the edge, and how fast it was, of a ride that nothing but the monitor ends."""
    stair = Stair(Walls.of(*ROOM).ends, slant_rad)
    # The map does not know of it, nor does any costmap.
    monkeypatch.setattr(LiveLayer, "update", lambda layer, *seen: None)
    ride = Ride.of(stair, BEGIN, SIZE_M, Walls.of(*ROOM), SETTINGS)
    ride.navigator._controller = Asks(ControlResult(FULL))  # noqa: SLF001
    if not is_checked:
        without_monitor(monkeypatch, ride)
    most_m, fastest_m_s = -np.inf, 0.0

    def looks() -> bool:
        nonlocal most_m, fastest_m_s
        outline = ride.navigator.footprint.at(ride.robot.base.pose)
        most_m = max(most_m, float(stair.beyond_m(outline).max()))
        fastest_m_s = max(fastest_m_s, ride.robot.base.forward_m_s)
        return most_m > 0.3

    ride.navigator.go_to_pose(GOAL)
    ride.go(7.0, looks)
    return most_m, fastest_m_s, ride


@pytest.mark.parametrize("slant_rad", [0.0, 0.6, -0.6])
def test_it_stops_before_a_stair_down(slant_rad: float, monkeypatch: pytest.MonkeyPatch) -> None:
    beyond_m, fastest_m_s, ride = farthest_m(slant_rad, monkeypatch, is_checked=True)
    assert fastest_m_s > 0.9
    assert beyond_m < 0
    assert ride.robot.base.stands
    checked = not_none(ride.navigator.feedback.monitor)
    assert (checked.state, checked.reason) == (MonitorState.STOPPED, MonitorReason.OBSTACLE)
    # It came near to the edge, and did not stand for some other reason before.
    assert beyond_m > -0.15


@pytest.mark.parametrize("slant_rad", [0.0, 0.6, -0.6])
def test_without_the_monitor_it_drives_down(slant_rad: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """So that the edge is one that the ride before would have gone over."""
    beyond_m, _, _ = farthest_m(slant_rad, monkeypatch, is_checked=False)
    assert beyond_m > 0.2
