"""A drive to a goal shown to Rerun, read back by Rerun's own reader."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rehearsed_drive import CALIBRATION, rehearsed_drive

from wheelsight.app.run.drives import GoalDrive, NamedGoal
from wheelsight.core.geometry import se2
from wheelsight.core.settings import ViewerSettings
from wheelsight.navigation import Feedback, NavigationState
from wheelsight_export import open_drive_log

pytest.importorskip("rerun", reason="rerun-sdk is not installed")
from viewer.shown import Shown

GOAL = NamedGoal.of((-0.7, -0.4), "the middle")


@pytest.fixture(scope="module")
def driven(tmp_path_factory: pytest.TempPathFactory) -> tuple[Shown, list[Feedback], GoalDrive]:
    path = tmp_path_factory.mktemp("shown") / "drive.rrd"
    with open_drive_log(str(path), CALIBRATION, ViewerSettings(image_rate_hz=2.0, costmap_rate_hz=1.0)) as log:
        drive, _, _ = rehearsed_drive(on_events=log.on_events, on_transition=log.note)
        reported: list[Feedback] = []

        def step(feedback: Feedback) -> None:
            reported.append(feedback)
            log.step(feedback, drive.navigator)

        assert drive.go_to(GOAL, step)
    return Shown(path), reported, drive


def test_the_robot_is_in_the_map_where_the_drive_has_it(driven: tuple[Shown, list[Feedback], GoalDrive]) -> None:
    shown, reported, _ = driven
    start_s = shown.rows["/__properties/recording"]["start_s"][0][0]
    known = [feedback for feedback in reported if feedback.pose is not None]
    np.testing.assert_allclose(shown.times_s("/map/odom/robot") + start_s, [one.stamp_s for one in known], atol=1e-6)
    # The pose of odom by the map's walls is logged when it changes, before the robot's pose of that time.
    reported_s, at_s = shown.times_s("/map/odom"), shown.times_s("/map/odom/robot")
    T_map_odom = shown.transforms("/map/odom")[np.searchsorted(reported_s, at_s, side="right") - 1]
    T = T_map_odom @ shown.transforms("/map/odom/robot")
    found = np.stack([T[:, 0, 3], T[:, 1, 3], np.arctan2(T[:, 1, 0], T[:, 0, 0])], axis=1)
    off = found - np.array([one.pose for one in known])
    np.testing.assert_allclose(np.column_stack([off[:, :2], se2.wrap_angle(off[:, 2])]), 0, atol=1e-5)
    assert shown.timelines == {"time"}


def test_plan_goal_and_statuses_are_reported_where_they_change(driven: tuple[Shown, list[Feedback], GoalDrive]) -> None:
    shown, reported, drive = driven
    plans = {id(one.plan): one.plan for one in reported if one.plan is not None}
    strips = [strip for strip in shown.rows["/map/plan"]["LineStrips3D:strips"] if strip]
    assert len(strips) == len(plans)
    for (strip,), plan in zip(strips, plans.values(), strict=True):
        np.testing.assert_allclose(np.array(strip)[:, :2], plan.poses[:, :2], atol=1e-5)
    (goal,) = [row for row in shown.rows["/map/goal"]["Arrows3D:origins"] if row]
    np.testing.assert_allclose(goal[0][:2], GOAL.pose[:2], atol=0.05)
    states = [state for (state,) in shown.rows["/status/navigator"]["StateChange:state"]]
    expected = [str(reported[0].state)]
    for one in reported:
        expected += [str(one.state)] * (str(one.state) != expected[-1])
    assert states == expected
    assert states[-1] == NavigationState.ARRIVED
    assert [state for (state,) in shown.rows["/status/localization"]["StateChange:state"]][-1] == "tracking"
    assert shown.rows["/status/monitor"]["StateChange:state"]
    words = [text for (text,) in shown.rows["/words/navigator"]["TextLog:text"]]
    result = drive.navigator.result
    assert result is not None
    assert words == [str(one) for one in result.transitions]
    # Once it has arrived nothing of the plan is left to be seen.
    assert shown.rows["/map/plan"]["Clear:is_recursive"][-1] == [False]


def test_floor_and_costmaps_lie_in_the_map_as_pictures(driven: tuple[Shown, list[Feedback], GoalDrive]) -> None:
    shown, reported, drive = driven
    layer = drive.navigator.senses.floor.layer
    assert len(shown.times_s("/map/floor")) == 1
    corners = np.array(shown.rows["/map/floor"]["Mesh3D:vertex_positions"][0])
    size = np.array(layer.state.shape[::-1]) * layer.resolution_m
    origin = np.array(layer.origin)
    np.testing.assert_allclose(corners[[0, 2], :2], np.stack([origin, origin + size]), atol=1e-4)
    costmaps = shown.rows["/map/costmap"]["Mesh3D:albedo_texture_buffer"]
    lasted_s = reported[-1].stamp_s - reported[0].stamp_s
    assert 2 <= len(costmaps) <= lasted_s + 1.5
    colours = np.array(costmaps[-1][0], np.uint8).reshape(-1, 3)
    assert (colours == (40, 40, 40)).all(axis=1).any()  # a wall
    assert (colours == (255, 255, 255)).all(axis=1).any()


def test_the_camera_comes_as_often_as_asked_and_speeds_in_each_period(
    driven: tuple[Shown, list[Feedback], GoalDrive],
) -> None:
    shown, reported, _ = driven
    images = shown.rows["/map/odom/robot/camera/color"]["EncodedImage:blob"]
    lasted_s = reported[-1].stamp_s - reported[0].stamp_s
    assert lasted_s <= len(images) <= 2 * lasted_s + 2
    speeds = [speed for (speed,) in shown.rows["/curves/forward_m_s"]["Scalars:scalars"]]
    np.testing.assert_allclose(speeds, [one.forward_m_s for one in reported], atol=1e-9)
    assert max(speeds) > 0.2


def test_nothing_of_a_robot_that_does_not_know_where_it_is(tmp_path: Path) -> None:
    path = tmp_path / "drive.rrd"
    with open_drive_log(str(path), CALIBRATION, ViewerSettings(costmap_rate_hz=0, image_rate_hz=0)) as log:
        drive, _, _ = rehearsed_drive(on_events=log.on_events)
        log.step(drive.navigator.feedback, drive.navigator)
    shown = Shown(path)
    assert not any(
        "Transform3D:translation" in shown.rows[place] and len(shown.rows[place]["time"])
        for place in ("/map/odom", "/map/odom/robot")
    )
    assert "/map/costmap" not in shown.rows
    assert [state for (state,) in shown.rows["/status/localization"]["StateChange:state"]] == ["initializing"]


def test_in_another_map_floor_and_way_begin_again(tmp_path: Path) -> None:
    path = tmp_path / "drive.rrd"
    with open_drive_log(str(path), CALIBRATION, ViewerSettings(costmap_rate_hz=1.0, image_rate_hz=0)) as log:
        for _ in range(2):
            drive, _, _ = rehearsed_drive(on_events=log.on_events)
            for _ in range(5):
                log.step(drive.navigator.step(), drive.navigator)
    rows = Shown(path).rows
    assert len(rows["/map/floor"]["Mesh3D:vertex_positions"]) == 2
    assert rows["/map/floor"]["Clear:is_recursive"] == [[False]]
    known = len(rows["/map/odom/robot"]["Transform3D:translation"])
    # No line from where the robot was in the first map to where it is in the second.
    assert known >= 4
    assert len(rows["/map/odom/trail"]["LineStrips3D:strips"]) == known - 2
