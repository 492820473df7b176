"""Loops closed while driving: keyframes go where they belong, odom stays, and a recording gives the same each time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from narrowing import not_none
from places.seen_room import EXACT, kept, ring, seen

from wheelsight.core.errors import MapError
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.keyframes import Keyframe, KeyframeId, KeyframeStore
from wheelsight.core.trajectory import Trajectory
from wheelsight.slam.drive_graph import OdometryKeyframe, PoseUpdate, Revisit
from wheelsight.slam.graph import RelativePose
from wheelsight.slam.loop_closing import LiveLoops, corrected_by
from wheelsight.slam.settings import LoopSettings

# Half round the room and the same way again, some centimetres aside; a keyframe a second.
WAY = [T for lap in (0.0, 0.06) for T in (pose @ se3.exp([lap, 0, 0, 0, 0, 0]) for pose in ring(16)[:8])]
# Odometry errs alike in each step, by what it states.
DRIFT = np.array([0.02, -0.01, 0.01, 0.004, -0.006, 0.01])
SETTINGS = LoopSettings(latency_s=0.5, apart_s=5.0)


@pytest.fixture(scope="module")
def keyframes() -> list[Keyframe]:
    return [replace(kept(seen(T)), stamp_s=float(second)) for second, T in enumerate(WAY)]


def lived() -> list[OdometryKeyframe]:
    T, C, found = WAY[0], np.zeros((6, 6)), []
    for second in range(len(WAY)):
        if second:
            step = se3.invert(WAY[second - 1]) @ WAY[second]
            Ad = se3.adjoint(T @ step)
            T, C = T @ step @ se3.exp(DRIFT), C + Ad @ np.diag(DRIFT**2) @ Ad.T
        found.append(OdometryKeyframe(KeyframeId(second), float(second), T, C))
    return found


def driven(keyframes: list[Keyframe], settings: LoopSettings = SETTINGS) -> tuple[LiveLoops, list[PoseUpdate | None]]:
    """All keyframes, one after the other; and what was answered right after each."""
    store = KeyframeStore()
    live, reported = LiveLoops(store, EXACT, settings, waits=True), []
    for keyframe, way in zip(keyframes, lived(), strict=True):
        store.add(keyframe, way.T_odom_keyframe)
        reported.append(live.due(way.stamp_s))
        live.add(way)
    return live, reported


def off_m(T: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(T[:, :3, 3] - np.array(WAY)[: len(T), :3, 3], axis=1))


def test_keyframes_go_to_where_loops_have_them(keyframes: list[Keyframe]) -> None:
    live, reported = driven(keyframes)
    found = live.finish()
    before, after = off_m(found.T_odom_keyframe), off_m(found.T_map_keyframe)
    assert before[-1] > 0.2
    assert after[-1] < before[-1] / 4
    assert len(found.loops.kept) >= 6
    assert not found.loops.refused
    np.testing.assert_array_equal(found.stamps_s, np.arange(len(WAY)))
    # On the way, too, some keyframes late: what is reported is of all keyframes that were judged by then.
    moved = [update.T_map_keyframe for update in reported if update is not None]
    assert moved
    assert len(moved[-1]) < len(WAY)
    assert off_m(moved[-1]).max() < 0.1
    last = [update for update in reported if update is not None][-1]
    assert len(last.loops) > 1
    assert (last.loops[:, 0] + 5 < last.loops[:, 1]).all()  # the first lap's, and the second's


def test_what_is_due_is_waited_for_and_comes_as_late_each_time(keyframes: list[Keyframe]) -> None:
    (first, reported), (second, again) = driven(keyframes), driven(keyframes)
    assert [update is None for update in reported] == [update is None for update in again]
    for one, other in zip(reported, again, strict=True):
        if one is not None and other is not None:
            np.testing.assert_array_equal(one.T_map_keyframe, other.T_map_keyframe)
    np.testing.assert_array_equal(first.finish().T_map_keyframe, second.finish().T_map_keyframe)


def test_nothing_is_reported_where_nothing_is_seen_again(keyframes: list[Keyframe]) -> None:
    live, reported = driven(keyframes, LoopSettings(latency_s=0.0, apart_s=100.0))
    assert all(update is None for update in reported)
    found = live.finish()
    np.testing.assert_allclose(found.T_map_keyframe, found.T_odom_keyframe, atol=1e-9)


def test_a_robot_that_drives_does_not_wait_and_says_what_it_had_no_time_for(keyframes: list[Keyframe]) -> None:
    store, ways = KeyframeStore(), lived()
    for keyframe, way in zip(keyframes, ways, strict=True):
        store.add(keyframe, way.T_odom_keyframe)
    live = LiveLoops(store, EXACT, SETTINGS.model_copy(update={"most_waiting": 1}))
    for way in ways:
        live.add(way)
    found = live.finish()
    assert found.unseen > 0
    assert len(found.T_map_keyframe) == len(WAY)


def test_what_goes_wrong_in_the_thread_is_raised_where_it_is_asked_for(keyframes: list[Keyframe]) -> None:
    store = KeyframeStore()
    store.add(replace(keyframes[0], depth_png=b"no image"), np.eye(4))
    live = LiveLoops(store, EXACT, SETTINGS, waits=True)
    live.add(lived()[0])
    with pytest.raises(MapError, match="cannot be decoded"):
        live.due(10.0)


def test_a_trajectory_goes_with_its_keyframes(keyframes: list[Keyframe]) -> None:
    found = driven(keyframes)[0].finish()
    ways = lived()
    at = Trajectory(found.stamps_s, np.array([way.T_odom_keyframe for way in ways]), None, "camera", "odom")
    corrected = corrected_by(found, at)
    assert corrected.corrected.frame == "map"
    np.testing.assert_allclose(corrected.corrected.T_frame_body, found.T_map_keyframe, atol=1e-9)


@pytest.mark.parametrize("is_reported", [False, True])
def test_a_keyframe_goes_to_where_odometry_saw_it_from_one_that_it_had_come_back_to(is_reported: bool) -> None:
    """Though no one recognises anything: nothing is to be seen here. Odometry has drifted by 0.3 m since."""
    store, blank, C = KeyframeStore(), np.ones((24, 32), np.float32), 1e-4 * np.eye(6)
    live = LiveLoops(store, EXACT, SETTINGS, waits=True)
    back = RelativePose(KeyframeId(0), KeyframeId(3), se3.from_plane(0.1, 0.0, 0.0), 0.01 * C, is_loop=True)
    for number, x_m in enumerate([0.0, 1.0, 2.0, 0.4]):
        T_odom, seen_from = se3.from_plane(x_m, 0.0, 0.0), back if is_reported and number == 3 else None
        store.add(Keyframe.of_images(number, np.array([30.0, 30.0, 16.0, 12.0]), blank, blank), T_odom)
        covariance = (1 + 100 * number) * C
        live.add(OdometryKeyframe(KeyframeId(number), float(number), T_odom, covariance, seen_from=seen_from))
    live.due(10.0)
    assert [store.loop_span(number) for number in store] == ([3, 0, 0, 3] if is_reported else [0, 0, 0, 0])
    found = live.finish()
    assert len(found.loops.kept) == is_reported
    assert found.T_map_keyframe[3, 0, 3] == pytest.approx(0.1 if is_reported else 0.4, abs=0.01)


def test_one_that_is_seen_again_is_placed_again() -> None:
    store, blank, C = KeyframeStore(), np.ones((24, 32), np.float32), 1e-4 * np.eye(6)
    live = LiveLoops(store, EXACT, SETTINGS, waits=True)
    for number in range(2):
        T_odom = se3.from_plane(float(number), 0.0, 0.0)
        store.add(Keyframe.of_images(number, np.array([30.0, 30.0, 16.0, 12.0]), blank, blank), T_odom)
        live.add(OdometryKeyframe(KeyframeId(number), float(number), T_odom, (1 + number) * C))
    live.request_place(Revisit(KeyframeId(0), 3.0, np.eye(4), 9 * C, C))
    live.due(2.0)
    assert not_none(live.place).number == 1
    live.due(4.0)
    place = not_none(live.place)
    assert (place.number, place.newest) == (0, 1)
    np.testing.assert_allclose(place.covariance, C, atol=1e-7)
    live.close()
