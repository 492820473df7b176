"""How far a robot goes over floor that no camera has looked at, and since it last saw anything."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
import shapely
from navigation.rooms import StandInLocalization
from navigation.test_collision_monitor import NOTHING, Ride
from navigation.unicycle import CHAIR, Camera

from benchmarks.plain_rooms import CALIBRATION, CELL_M, RoomRobot, Walls
from wheelsight.core.messages import STOP, RgbdFrame, VelocityCommand
from wheelsight.mapping import CellKind, OccupancyGrid
from wheelsight.navigation import CellState, CostmapSettings, KnownFloor, NavigationSettings
from wheelsight.navigation.collision_monitor import AIR_M, CollisionMonitor, MonitorReason
from wheelsight.navigation.costmap import LiveObstacles
from wheelsight.navigation.senses import Senses
from wheelsight.navigation.settings import MonitorSettings

SETTINGS, MEMORY_CELL_M = MonitorSettings(), 0.03
KINECT = Camera(half_angle_rad=0.47, near_m=1.9)
# A cell's diagonal: middles of cells stand for all of them.
OFF_M = 1.5 * MEMORY_CELL_M


@pytest.mark.parametrize(("speed_m_s", "most_age_s"), [(1.0, 0.25), (0.7, 0.3), (0.2, 0.3)])
def test_how_old_a_frame_may_be_is_by_the_way_driven_since(speed_m_s: float, most_age_s: float) -> None:
    """With 0.05 s until the next check, no more than 0.3 m are driven at any speed; who is slow may wait for frames."""
    ride = Ride(NOTHING, Camera())
    ride.drive(VelocityCommand(speed_m_s), 4.0)
    assert ride.base.forward_m_s == pytest.approx(speed_m_s, abs=0.01)
    newest_s = ride.time_s - 0.1
    while ride.drive(VelocityCommand(speed_m_s), 0.05, sees=False).reason is not MonitorReason.NO_FRAME:
        assert ride.time_s < newest_s + 1.0
    stopped_s = ride.time_s - 0.05
    assert most_age_s - 1e-6 <= stopped_s - newest_s <= most_age_s + 0.05 + 1e-6
    assert speed_m_s * (stopped_s - newest_s) <= 0.3


def sector(camera: Camera, near_m: float) -> shapely.Polygon:
    """What a camera at the origin's base looks at."""
    bearings = np.linspace(-camera.half_angle_rad, camera.half_angle_rad, 50)
    ends = np.stack([np.cos(bearings), np.sin(bearings)], axis=-1)
    return shapely.Polygon(np.concatenate([near_m * ends, camera.far_m * ends[::-1]]) + (camera.x_m, 0.0))


@pytest.mark.parametrize("deep_m", [0.1, 0.3])
def test_hidden_is_what_lies_deep_enough_beside_all_that_was_looked_at(deep_m: float) -> None:
    """Looked at: over the floor from half a metre on, and where it stands; within 1.4 m, against plain polygons."""
    monitor, reach_m = CollisionMonitor(CHAIR), 1.4
    monitor.add_reading(0.0, 0.0, 0.0)
    monitor.add_view(KINECT.view(NOTHING, np.zeros(3), 0.0))
    reported = monitor.memory.hidden(reach_m, deep_m)
    looked = sector(KINECT, AIR_M).union(shapely.Polygon(CHAIR.corners))
    away_m = shapely.distance(looked, shapely.points(reported))
    assert away_m.min() > deep_m - OFF_M
    places = np.stack(np.meshgrid(*2 * [np.arange(-1.3, 1.3, 0.05)]), axis=-1).reshape(-1, 2)
    places = places[np.hypot(*places.T) < reach_m - OFF_M]
    is_hidden = shapely.distance(looked, shapely.points(places)) > deep_m + OFF_M
    assert 0.1 < is_hidden.mean() < 0.9
    off_m = shapely.distance(shapely.MultiPoint(reported), shapely.points(places[is_hidden]))
    assert off_m.max() < MEMORY_CELL_M


def test_floor_that_it_was_led_over_is_not_hidden_and_what_is_beside_it_still_is() -> None:
    ride = Ride(NOTHING, KINECT)
    ride.monitor.trust_floor(1.0)
    ride.drive(VelocityCommand(0.3, 0.5), 6.0)
    outline, hidden = shapely.Polygon(CHAIR.corners).buffer(-OFF_M), ride.monitor.memory.hidden(1.5, 0.1)
    assert len(hidden) > 0
    assert not shapely.intersects(outline, shapely.points(hidden)).any()


def test_what_is_hidden_stays_so_until_somebody_looks_there() -> None:
    monitor, reach_m = CollisionMonitor(CHAIR), 1.4
    monitor.add_reading(0.0, 0.0, 0.0)
    monitor.add_view(KINECT.view(NOTHING, np.zeros(3), 0.0))
    near = monitor.memory.hidden(reach_m, 0.1)
    aside = near[(near[:, 0] > 0.3) & (near[:, 1] > 0.6)]
    assert len(aside) > 50
    for step in range(1, 21):  # a metre straight on by the wheels, which the next frame does not show
        monitor.add_reading(0.05 * step, 1.0, 0.0)
    later = monitor.memory.hidden(3.0, 0.1)
    moved = aside - (1.0 - 0.5 * 0.05, 0.0)
    assert shapely.distance(shapely.MultiPoint(later), shapely.points(moved)).max() < MEMORY_CELL_M
    # From behind, and 1.2 m back, it looks at all of that.
    pose = np.array([-2.6, 0.0, 0.3])
    monitor.add_view(replace(KINECT.view(NOTHING, pose, 1.0), camera=(-3.0, 1.0), first_rad=-0.2, step_rad=1.0 / 64))
    assert len(monitor.memory.hidden(3.0, 0.1)) < len(later)


@pytest.mark.parametrize("turn_rad_s", [0.0, 0.1, -0.3])
def test_no_one_is_led_on_and_on_over_floor_that_no_camera_has_looked_at(turn_rad_s: float) -> None:
    """Floor that it was led over counts as seen: once the next piece of it was as little deep as the last."""
    ride, asked = Ride(NOTHING, KINECT), VelocityCommand(0.3, turn_rad_s)
    ride.monitor.trust_floor(1.0)
    shows_no_floor = replace(KINECT.view(NOTHING, np.zeros(3), 0.0), seen_m=np.full(64, 0.01))
    for _ in range(300):
        ride.monitor.add_view(replace(shows_no_floor, stamp_s=ride.time_s))
        ride.drive(asked, 0.05, sees=False)
    assert ride.results[-1].reason is MonitorReason.NEVER_SEEN
    assert ride.base.stands
    corners = CHAIR.at(ride.base.pose)
    # The front is led 0.3 m on, and may then be as deep again.
    assert 0.0 < np.hypot(*corners.T).max() - 1.0 < 2 * SETTINGS.blind_m


def test_points_are_obstacles_in_the_cells_that_they_lie_in() -> None:
    none = np.zeros((4, 6), bool)
    live = LiveObstacles(none, 0.1, (1.0, -0.2), "odom", 0.0, none)
    found = live.with_points(np.array([[1.05, -0.15], [1.59, 0.19], [1.61, 0.0], [0.99, 0.0]]))
    assert np.argwhere(found.is_occupied).tolist() == [[0, 0], [3, 5]]
    np.testing.assert_array_equal(found.standing().is_occupied, found.is_occupied)
    assert not live.is_occupied.any()


@pytest.mark.parametrize("unknown", ["costly", "forbidden"])
def test_plans_and_controllers_keep_away_from_what_neither_map_nor_camera_knows(
    unknown: Literal["costly", "forbidden"],
) -> None:
    """A map that knows the floor right of y = 3 m alone; the robot stands there, and no one looks to its left."""
    kind = np.full((120, 160), CellKind.UNKNOWN, np.uint8)
    kind[:60] = CellKind.FREE
    floor = KnownFloor(OccupancyGrid.of_kinds(kind, kind == CellKind.FREE, CELL_M, (0.0, 0.0)))
    robot = RoomRobot(Walls.of(((7.99, 0.0), (7.99, 6.0))), (3.0, 2.8, 0.0))
    settings = NavigationSettings(costmap=CostmapSettings(unknown=unknown))
    senses = Senses(CALIBRATION, StandInLocalization(robot), floor, CollisionMonitor(CHAIR), CHAIR, settings)
    for _ in range(6):
        senses.update(robot.step(STOP), robot.now_s)
    beside, right, next_to, ahead, far = (3.0, 3.6), (3.0, 2.0), (3.0, 2.4), (4.5, 3.1), (3.0, 5.0)

    def state_at(*place: float) -> CellState:
        local = senses.local()
        assert local is not None
        return CellState(local.state[tuple(local.cells_at(place))])

    is_costly = unknown == "costly"
    assert state_at(*beside) == (CellState.OCCUPIED if is_costly else CellState.UNKNOWN)
    # The collision monitor, which knows no map, lets nothing sweep it; a little of it may be.
    assert state_at(*right) == CellState.OCCUPIED
    assert state_at(*next_to) == CellState.FREE
    assert state_at(*ahead) == state_at(*far) == CellState.UNKNOWN
    senses.avoids_hidden = False
    assert state_at(*beside) == CellState.UNKNOWN


def test_of_several_frames_in_a_period_the_monitor_sees_the_newest() -> None:
    floor = KnownFloor(Walls.of(((7.99, 0.0), (7.99, 6.0))).grid(8.0, 6.0))
    robot, monitor = RoomRobot(Walls.of(((7.99, 0.0), (7.99, 6.0))), (3.0, 3.0, 0.0)), CollisionMonitor(CHAIR)
    seen_s: list[float] = []
    senses = Senses(CALIBRATION, StandInLocalization(robot), floor, monitor, CHAIR, NavigationSettings())
    monitor.add_view = lambda view: seen_s.append(view.stamp_s)  # type: ignore[method-assign]
    late = [event for _ in range(8) for event in robot.step(STOP)]
    frames_s = [event.stamp_s for event in late if isinstance(event, RgbdFrame)]
    assert len(frames_s) > 1
    senses.update(late, robot.now_s)
    assert seen_s == [max(frames_s)]


def test_plans_and_controllers_keep_away_from_what_the_monitor_remembers() -> None:
    """Somebody stands before it, it turns away, and what its own layer knew is wiped, as of people who walk."""
    somebody = (((4.1, 2.9), (4.1, 3.1)), ((4.3, 2.9), (4.3, 3.1)), ((4.1, 2.9), (4.3, 2.9)), ((4.1, 3.1), (4.3, 3.1)))
    floor = KnownFloor(Walls.of(((7.99, 0.0), (7.99, 6.0))).grid(8.0, 6.0))
    robot = RoomRobot(Walls.of(*somebody), (3.0, 3.0, 0.0))
    monitor = CollisionMonitor(CHAIR)
    monitor.trust_floor(2.0)
    senses = Senses(CALIBRATION, StandInLocalization(robot), floor, monitor, CHAIR, NavigationSettings())
    while robot.base.pose[2] < 1.2:
        senses.update(robot.step(VelocityCommand(0.0, 0.5 if robot.now_s > 1.0 else 0.0)), robot.now_s)

    def is_there() -> bool:
        local = senses.local()
        assert local is not None
        row, column = local.cells_at((4.1, 3.0))
        return bool((local.state[row - 1 : row + 2, column - 1 : column + 2] == CellState.OCCUPIED).any())

    assert is_there()
    senses.clear()
    for avoids_hidden in (True, False):
        senses.avoids_hidden = avoids_hidden
        assert is_there()
