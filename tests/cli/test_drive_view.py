"""What a drive shows: a plan in half blocks, and facts in words."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from wheelsight.app.cli.drive_view import Sign, SoFar, as_text, line_of, plan_signs
from wheelsight.core.estimates import Status
from wheelsight.core.messages import STOP
from wheelsight.mapping import CellKind, OccupancyGrid
from wheelsight.navigation import (
    Feedback,
    Footprint,
    MonitorReason,
    MonitorResult,
    MonitorState,
    NavigationState,
    StaticLayer,
)

CHAIR = Footprint.rectangle(0.8, 0.3, 0.6)
HERE = np.array([1.0, 0.0, 0.0])
STILL = Feedback(
    stamp_s=12.34,
    state=NavigationState.DRIVING,
    status=Status.TRACKING,
    pose=HERE,
    forward_m_s=0.5,
    turn_rad_s=0.0,
    goal=None,
    to_go_m=3.44,
    plan=None,
    predicted=np.empty((0, 3)),
    monitor=MonitorResult(STOP, MonitorState.FREE),
    doing="kitchen",
    goals_left=1,
)


@pytest.fixture
def floor() -> StaticLayer:
    """Free from -2 to 4 m, with a wall one cell thick at x = 2.5 m."""
    kind = np.full((80, 120), CellKind.FREE, np.uint8)
    kind[:, 90] = CellKind.OBSTACLE
    return StaticLayer.of(OccupancyGrid.of_kinds(kind, np.zeros(kind.shape, bool), 0.05, (-2.0, -2.0)))


def test_the_plan_shows_robot_front_wall_and_goal(floor: StaticLayer) -> None:
    feedback = replace(STILL, goal=np.array([0.0, 1.5, 0.0]))
    signs = plan_signs(floor, feedback, CHAIR, (40, 40), 0.15)
    assert signs.shape == (40, 40)
    middle = np.argwhere(signs >= Sign.ROBOT).mean(axis=0)
    # The robot reaches from 0.3 m behind the middle to 0.8 m ahead of it: to the right of the screen.
    assert middle == pytest.approx([19.5, 19.5 + 0.25 / 0.15], abs=0.5)
    assert np.argwhere(signs == Sign.FRONT)[:, 1].mean() > middle[1] + 2
    walls = np.argwhere(signs == Sign.WALL)
    assert len(walls) >= 25  # the floor's height, 4 m: no row of it is missed
    assert set(walls[:, 1]) == {int(20 + 1.5 / 0.15)}
    goal = np.argwhere(signs == Sign.GOAL).mean(axis=0)
    assert goal == pytest.approx([19.5 - 1.5 / 0.15, 19.5 - 1.0 / 0.15], abs=1)
    assert signs[0, 0] == Sign.UNKNOWN  # beyond the floor
    turned = plan_signs(floor, replace(STILL, pose=np.array([1.0, 0.0, np.pi / 2])), CHAIR, (40, 40), 0.15)
    assert np.argwhere(turned == Sign.FRONT)[:, 0].mean() < 17  # up the screen


def test_of_a_robot_that_is_lost_the_map_is_shown(floor: StaticLayer) -> None:
    signs = plan_signs(floor, replace(STILL, pose=None), CHAIR, (20, 40), 0.15)
    assert not (signs >= Sign.ROBOT).any()
    assert (signs == Sign.WALL).any()


def test_two_cells_are_a_letter_and_without_colours_the_higher_one(floor: StaticLayer) -> None:
    signs = np.array([[Sign.FREE, Sign.WALL], [Sign.ROBOT, Sign.UNKNOWN]], np.uint8)
    text = as_text(signs)
    assert text.plain == "▀▀"
    assert {str(span.style) for span in text.spans} == {"#e9e9e9 on #009e73", "#202020 on #9a9a9a"}
    assert as_text(signs, in_colour=False).plain == "o#"


def test_a_line_shows_state_status_speed_way_and_why() -> None:
    held = replace(STILL, monitor=MonitorResult(STOP, MonitorState.STOPPED, MonitorReason.OBSTACLE))
    so_far, at_s = SoFar(), 10.0
    for _ in range(5):
        so_far.add(replace(held, stamp_s=at_s))
        at_s += 1.0
    assert (so_far.seconds, so_far.way_m) == (4.0, 2.0)
    reported = line_of(held, so_far, 24.3)
    assert reported.startswith(
        "12.3 s state: driving, kitchen; status: knows where it is; place: 1.00, 0.00 m, 0°; speed: 0.50 m/s; "
        "so far: 0:04, 2.0 m, 24 m² seen; rate: "
    )
    assert reported.endswith("; to go: 3.4 m, 0:07 left; monitor: holds it: something in the way")
    lost = replace(STILL, pose=None, to_go_m=None, status=Status.LOST, turn_rad_s=-0.5, doing="")
    reported = line_of(lost, SoFar(), 0.0)
    assert reported.startswith(
        "12.3 s state: driving; status: lost; speed: 0.50 m/s, -29°/s; so far: 0:00, 0.0 m, 0 m²"
    )
    assert reported.endswith(" times real time; monitor: lets it drive")
