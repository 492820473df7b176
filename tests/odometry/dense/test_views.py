"""Views that are kept, and which of them a frame is aligned with."""

from __future__ import annotations

import numpy as np
import pytest
from odometry.dense.scenes import Plane, bench, frame_of

from wheelsight.core.estimates import MotionEstimate, TrackingState
from wheelsight.core.geometry import se3
from wheelsight.core.keyframes import KeyframeId
from wheelsight.core.threads import Stopwatch
from wheelsight.vision.dense import DenseSettings
from wheelsight.vision.dense.tracking import KnownView, Tracked, ViewCache

BENCH = bench()
GRID = BENCH.grid(frame_of([Plane((0, 0, 1), 2.0)], np.eye(4), 0.0))

STILL = MotionEstimate(np.eye(4), np.eye(6))
LAST = Tracked(GRID, se3.from_parts(np.eye(3), [7.0, 0, 0]), np.eye(6), STILL, KeyframeId(0))


def keyframe(x_m: float) -> KnownView:
    return KnownView(
        KeyframeId(int(x_m)), BENCH.maker.of_frame(GRID, se3.from_parts(np.eye(3), [x_m, 0, 0])), x_m * np.eye(6)
    )


@pytest.fixture
def views() -> ViewCache:
    """Four keyframes a metre apart, and room for no more."""
    made = ViewCache(DenseSettings(kept_keyframes=4), BENCH.gridder, BENCH.maker, Stopwatch())
    for x_m in range(4):
        made.keep(keyframe(float(x_m)))
    return made


def at(x_m: float) -> np.ndarray:
    return se3.from_parts(np.eye(3), [x_m, 0, 0])


def after(failures: int) -> TrackingState:
    return TrackingState(lost_after=3, has_begun=True, failures=failures)


def places(keyframes: list[KnownView]) -> list[float]:
    return [float(each.reference.T_map_reference[0, 3]) for each in keyframes]


def test_the_keyframe_used_longest_ago_goes_first(views: ViewCache) -> None:
    views.keep(views.keyframes[0])
    assert places(views.keyframes) == [1, 2, 3, 0]
    views.keep(keyframe(9.0))
    assert places(views.keyframes) == [2, 3, 0, 9]


def test_the_nearest_is_found_and_asked_after_a_failure(views: ViewCache) -> None:
    assert places([views.nearest(at(1.2))]) == [1]
    assert places(list(views.around(at(1.2), LAST, after(0)))) == [3, 7]
    assert places(list(views.around(at(1.2), LAST, after(1)))) == [3, 1]


def test_each_goes_with_the_keyframe_it_hangs_on(views: ViewCache) -> None:
    views.move(np.stack([np.eye(4), at(10.0), np.eye(4), np.eye(4)]))
    assert places(views.keyframes) == [0, 11, 2, 3]
    Ad = se3.adjoint(at(10.0))
    np.testing.assert_allclose(views.keyframes[1].covariance, Ad @ Ad.T, atol=1e-12)
    np.testing.assert_array_equal(views.keyframes[2].covariance, 2 * np.eye(6))


def test_once_lost_every_keyframe_has_its_turn(views: ViewCache) -> None:
    asked = {places(list(views.around(at(1.2), LAST, after(failures))))[-1] for failures in range(3, 7)}
    assert asked == {0, 1, 2, 3}
    recognised = {place for failures in range(3, 7) for place in places(views.candidates(at(1.2), after(failures)))}
    assert recognised == {0, 1, 2, 3}


def test_no_keyframe_is_asked_twice_for_one_frame(views: ViewCache) -> None:
    assert places(views.candidates(at(3.0), after(4))) == [3]


def test_keyframes_used_long_ago_take_little_room_and_come_back_alike() -> None:
    subject = ViewCache(DenseSettings(), BENCH.gridder, BENCH.maker, Stopwatch())
    keyframes = [keyframe(0.1 * number) for number in range(9)]
    before = [
        (one.reference.scales.levels[0].pixels.copy(), one.reference.scales.steep.normal.copy()) for one in keyframes
    ]
    for one in keyframes:
        subject.keep(one)
    list(subject.around(np.eye(4), LAST, after(0)))
    held = [one.reference.known_scales is not None for one in keyframes]
    assert held == [False] * 3 + [True] * 6
    for one, (pixels, normal) in zip(keyframes, before, strict=True):
        np.testing.assert_array_equal(one.reference.scales.levels[0].pixels, pixels)
        np.testing.assert_array_equal(one.reference.scales.steep.normal, normal)
