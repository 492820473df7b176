"""Whether a camera will have looked at the floor that a plan leads over, by the time the robot is there."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from navigation.floors import CHAIR, costmap_of

from wheelsight.core.geometry import FloatArray
from wheelsight.navigation.costmap import Costmap
from wheelsight.navigation.costmap_kernels import Eye
from wheelsight.navigation.planning import PlanView

EYE = Eye(x=0.35, y=0.0, half_rad=0.47, near_m=0.5, far_m=3.0)
VIEW = PlanView(CHAIR, EYE)
OPEN = costmap_of(np.zeros((160, 160), bool))
START = np.array([3.0, 3.0, 0.0])
SLACK_M, CELL_M = 0.1, 0.05


def moved(start: FloatArray, ways: list[tuple[float, float, int]]) -> FloatArray:
    """(N, 3) poses by steps of metres and radians, so many times each."""
    poses = [np.asarray(start, float)]
    for way_m, turn_rad, times in ways:
        for _ in range(times):
            x, y, yaw = poses[-1]
            middle = yaw + turn_rad / 2
            poses.append(np.array([x + way_m * np.cos(middle), y + way_m * np.sin(middle), yaw + turn_rad]))
    return np.array(poses)


def patch(x: float, y: float, half_m: float = 0.1, slack_m: float = SLACK_M) -> FloatArray:
    """(M, 3) hidden floor about a place."""
    steps = np.arange(-half_m, half_m + 1e-9, 0.05)
    places = np.stack(np.meshgrid(x + steps, y + steps), axis=-1).reshape(-1, 2)
    return np.column_stack([places, np.full(len(places), slack_m)])


STRAIGHT = moved(START, [(0.05, 0.0, 60)])
LEFT_ON_THE_SPOT = moved(START, [(0.0, 0.05, 31)])
BACK_AND_ROUND = moved(START, [(-0.05, 0.0, 30), (0.0, 0.05, 8), (0.05, 0.0, 60)])


@pytest.mark.parametrize(
    ("poses", "at", "is_blind"),
    [
        (STRAIGHT, (5.0, 3.0), False),  # it drives up to it
        (STRAIGHT, (3.0, 4.5), False),  # it goes past it
        (LEFT_ON_THE_SPOT, (3.0, 3.6), True),  # its front sweeps what is beside it
        (LEFT_ON_THE_SPOT, (3.0, 1.6), False),  # on the other side
        (BACK_AND_ROUND, (3.0, 3.6), False),  # it backs up, and looks there first
        (moved(START, [(-0.05, 0.0, 30)]), (2.2, 3.0), True),  # it backs over it
    ],
)
def test_what_is_beside_is_no_wall_for_who_looks_there_first(
    poses: FloatArray, at: tuple[float, float], is_blind: bool
) -> None:
    assert (VIEW.first_blind(poses, patch(*at), OPEN) is not None) == is_blind


def test_it_is_the_same_floor_that_it_goes_over_in_the_end() -> None:
    for poses in (LEFT_ON_THE_SPOT, BACK_AND_ROUND):
        outlines = shapely.union_all([shapely.Polygon(CHAIR.at(pose)) for pose in poses])
        assert outlines.intersects(shapely.MultiPoint(patch(3.0, 3.6)[:, :2]))


def test_the_pose_is_the_first_that_would_hold_some_of_it() -> None:
    hidden = patch(3.1, 3.6)
    number = VIEW.first_blind(LEFT_ON_THE_SPOT, hidden, OPEN)
    assert number is not None
    holds = [
        shapely.Polygon(CHAIR.at(pose)).buffer(1e-9).contains(shapely.points(hidden[:, :2])).any()
        for pose in LEFT_ON_THE_SPOT
    ]
    assert number == int(np.argmax(holds)) > 0


def test_no_one_looks_through_a_wall() -> None:
    hidden, is_wall = patch(3.0, 3.6), np.zeros((160, 160), bool)
    assert VIEW.first_blind(BACK_AND_ROUND, hidden, costmap_of(is_wall)) is None
    is_wall[66:79, 54:67] = True  # all round it
    is_wall[69:76, 57:64] = False
    assert VIEW.first_blind(BACK_AND_ROUND, hidden, costmap_of(is_wall)) is not None


def test_without_hidden_floor_or_way_nothing_is_blind() -> None:
    assert VIEW.first_blind(STRAIGHT, np.empty((0, 3)), OPEN) is None
    assert VIEW.first_blind(START[None], patch(5.0, 3.0), OPEN) is None


def plainly(poses: FloatArray, point: FloatArray, costmap: Costmap) -> int | None:
    """The first pose that holds a point which none looks at that is two before it or more, by polygons."""
    where, bearings = shapely.Point(point), np.linspace(-EYE.half_rad, EYE.half_rad, 200)
    ends = np.stack([np.cos(bearings), np.sin(bearings)], axis=-1)
    sector = np.concatenate([EYE.near_m * ends, EYE.far_m * ends[::-1]]) + (EYE.x, EYE.y)
    seen_at = len(poses)
    for number, (x, y, yaw) in enumerate(poses):
        c, s = np.cos(yaw), np.sin(yaw)
        if seen_at == len(poses) and shapely.Polygon(sector @ np.array([[c, s], [-s, c]]) + (x, y)).contains(where):
            seen_at = number
        if shapely.Polygon(CHAIR.at((x, y, yaw))).contains(where):
            return number if seen_at > number - 2 else None
    return None


@settings(max_examples=60, deadline=None)
@given(
    ways=st.lists(
        st.tuples(st.sampled_from([0.05, -0.05, 0.0]), st.floats(-0.06, 0.06), st.integers(5, 40)),
        min_size=1,
        max_size=4,
    ),
    away=st.tuples(st.floats(-1.5, 3.0), st.floats(-1.5, 1.5)),
)
def test_it_is_as_polygons_say(ways: list[tuple[float, float, int]], away: tuple[float, float]) -> None:
    poses, point = moved(START, ways), START[:2] + away
    # What lies on an outline, or on the edge of a view, is neither in nor out.
    off = [abs(shapely.Polygon(CHAIR.at(pose)).exterior.distance(shapely.Point(point))) for pose in poses]
    if min(off) < 0.005:
        return
    found = VIEW.first_blind(poses, np.array([[*point, 0.0]]), OPEN)
    wider = VIEW.first_blind(poses, np.array([[*point, 0.02]]), OPEN)
    if (found is None) == (wider is None):
        assert found == plainly(poses, point, OPEN)
