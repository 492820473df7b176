"""Drives whose map is of another place, or that are reported a wrong start: the localizer is the real one."""

from __future__ import annotations

import numpy as np
import pytest
from narrowing import not_none
from navigation.rooms import Ride, is_near
from pipeline.painted_drives import Pose, painted_ride

from wheelsight.estimation import Localizer
from wheelsight.navigation import NavigationReason, NavigationState

pytestmark = pytest.mark.slow
BEGIN: Pose = (-1.8, 0.2, 0.0)
GOAL: Pose = (-0.3, 0.4, 0.0)
SEED_OF_THE_MAP, OTHER_SEED = 0, 3
LOST_S = 8.0
# So far off that no one means the same place.
FAR_OFF: Pose = (-0.6, -0.9, 1.5)


def driven(seed: int, start: Pose | None = None, goal: tuple[float, ...] = GOAL) -> Ride:
    """To its end."""
    localizers: list[Localizer] = []
    with painted_ride(seed, BEGIN, LOST_S, start, localizers) as ride:
        ride.navigator.go_to_pose(goal)
        ride.go(40.0)
    # What shows a start that is borne out from one that is believed alone.
    assert (not_none(localizers[0].recognised) > 0) is (seed == SEED_OF_THE_MAP)
    assert ride.navigator.is_task_complete()
    assert ride.robot.base.stands
    # The margin is 0.04 m, by what is remembered in cells of 0.03 m. On some processors it came to 0.027 m.
    assert ride.clearance_m > 0.02
    return ride


def test_in_the_room_of_the_map_it_knows_its_place_and_arrives() -> None:
    ride = driven(SEED_OF_THE_MAP)
    assert not_none(ride.navigator.result).has_arrived
    assert is_near(ride.robot.base.pose, GOAL)


def test_in_another_room_it_is_lost_and_does_not_drive_to_the_goal() -> None:
    """One of the same shape, whose walls look different."""
    ride = driven(OTHER_SEED)
    result = not_none(ride.navigator.result)
    assert (result.has_arrived, result.reason) == (False, NavigationReason.LOST)
    assert ride.navigator.state is NavigationState.FAILED
    assert ride.navigator.feedback.pose is None
    assert ride.robot.now_s == pytest.approx(LOST_S, abs=1.0)
    assert str(NavigationState.DRIVING) not in ride.states
    assert result.plans == 0
    assert np.hypot(*(ride.robot.base.pose[:2] - BEGIN[:2])) < 0.05


@pytest.mark.parametrize(
    ("start", "goal"), [((-1.4, 0.0, 0.25), GOAL), (FAR_OFF, (-1.8, 0.6))], ids=["a little", "altogether"]
)
def test_a_start_that_is_wrong_is_put_right_by_what_is_recognised(start: Pose, goal: tuple[float, ...]) -> None:
    ride = driven(SEED_OF_THE_MAP, start, goal)
    assert not_none(ride.navigator.result).has_arrived
    assert np.hypot(*(ride.robot.base.pose[:2] - goal[:2])) < 0.12
    np.testing.assert_allclose(not_none(ride.navigator.feedback.pose), ride.robot.base.pose, atol=0.05)


def test_a_start_in_another_room_is_refuted_and_no_goal_is_reached() -> None:
    """It drives slowly, then looks for its place and finds none; its way is checked by the camera alone."""
    ride = driven(OTHER_SEED, FAR_OFF)
    result = not_none(ride.navigator.result)
    assert (result.has_arrived, result.reason) == (False, NavigationReason.LOST)
    assert ride.transitions[1].after is NavigationState.DRIVING
    assert ride.navigator.feedback.pose is None
    assert ride.navigator.feedback.forward_m_s == pytest.approx(0.0, abs=0.02)
    assert np.hypot(*(ride.robot.base.pose[:2] - BEGIN[:2])) < 5.0
