"""One keyframe is moved in the store: references, surfels and the trajectory move with it, and tracking goes on."""

from __future__ import annotations

import numpy as np
import pytest
import synthetic
from grids import mostly_slow
from narrowing import not_none
from stand_ins import CAMERA

from wheelsight.config import load_config
from wheelsight.core.calibration import Calibration
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.estimates import Estimate, Status
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.keyframes import KeyframeId
from wheelsight.core.messages import RgbdFrame
from wheelsight.estimation import Localizer

TRUTH = synthetic.wobbling_trajectory(24)
FAR = se3.exp([3.0, -2.0, 1.0, 0.4, -0.6, 0.8])
NUDGE = se3.exp([0.05, -0.02, 0.03, 0.01, -0.02, 0.01])
SETTINGS = {
    "dense": {"odometry": "dense", "map": "surfels", "surfels.fused_way_m": 0.0, "dense.keyframe_way_m": 0.05},
    "features": {"odometry": "features", "features.keyframe_share": 0.95},
}


@pytest.fixture(scope="module")
def frames() -> list[RgbdFrame]:
    poses = zip(TRUTH.stamps_s, TRUTH.T_frame_body, strict=True)
    return [RgbdFrame(float(stamp_s), *synthetic.render_room(T)) for stamp_s, T in poses]


def localizer(odometry: str) -> Localizer:
    return Localizer(Calibration.registered_camera(synthetic.CAMERA), load_config(overrides=SETTINGS[odometry]))


def answers(subject: Localizer, frames: list[RgbdFrame]) -> list[Estimate]:
    found = [subject.process(frame) for frame in frames]
    return [estimate for estimate in found if estimate is not None]


def off_m(T: FloatArray | None, expected: FloatArray) -> float:
    assert T is not None
    return float(np.linalg.norm((se3.invert(expected) @ T)[:3, 3]))


@pytest.mark.parametrize("odometry", mostly_slow(["dense", "features"], quick=["features"]))
def test_a_moved_keyframe_takes_along_all_that_hangs_on_it(frames: list[RgbdFrame], odometry: str) -> None:
    still, subject = localizer(odometry), localizer(odometry)
    expected, before = answers(still, frames), answers(subject, frames[:12])
    store = subject.keyframes
    assert store is not None
    moved = before[-1].keyframe
    assert moved is not None
    assert moved >= 1
    where = [estimate.pose_in(store) for estimate in before]
    store.move([moved], [NUDGE @ store.pose(moved)])
    for estimate, T_before in zip(before, where, strict=True):
        assert T_before is not None
        T = NUDGE @ T_before if estimate.keyframe == moved else T_before
        np.testing.assert_allclose(not_none(estimate.pose_in(store)), T, atol=1e-9)
    after = answers(subject, frames[12:])
    assert all(estimate.status is Status.TRACKING for estimate in after)
    # What is in view hangs on several keyframes, so the next pose lies between where they were and where one is now.
    assert off_m(after[0].T_odom_body, not_none(expected[12].T_odom_body)) < 0.1
    assert off_m(after[0].T_odom_body, NUDGE @ not_none(expected[12].T_odom_body)) < 0.1


@pytest.mark.parametrize("odometry", mostly_slow(["dense", "features"], quick=["features"]))
def test_where_all_keyframes_are_moved_the_way_goes_on_from_there(frames: list[RgbdFrame], odometry: str) -> None:
    still, subject = localizer(odometry), localizer(odometry)
    expected, _ = answers(still, frames), answers(subject, frames[:12])
    store = subject.keyframes
    assert store is not None
    store.move(list(store), FAR @ store.T_map_keyframe)
    for estimate, as_before in zip(answers(subject, frames[12:]), expected[12:], strict=True):
        assert estimate.status is Status.TRACKING
        assert off_m(estimate.T_odom_body, FAR @ not_none(as_before.T_odom_body)) < 2e-3


def test_surfels_of_a_moved_keyframe_move_and_no_others(frames: list[RgbdFrame]) -> None:
    subject = localizer("dense")
    last = answers(subject, frames[:12])[-1]
    surfel_map, store, moved = subject.map, subject.keyframes, last.keyframe
    assert surfel_map is not None
    assert store is not None
    assert moved is not None
    before = surfel_map.surfels("all")
    hang = before.keyframe == moved
    assert 0 < np.count_nonzero(hang) < len(hang)
    store.move([KeyframeId(int(moved))], [NUDGE @ store.pose(moved)])
    after = surfel_map.surfels("all")
    there = after.position[after.keyframe == moved]
    np.testing.assert_allclose(there.mean(axis=0), se3.apply(NUDGE, before.position[hang]).mean(axis=0), atol=1e-5)
    assert sorted(map(tuple, after.position[after.keyframe != moved])) == sorted(map(tuple, before.position[~hang]))


def test_wheels_alone_have_no_keyframes() -> None:
    wheels = Wheels(0.17, 0.17, 0.52, 3200.0)
    config = load_config(overrides={"odometry": "wheels"})
    assert Localizer(Calibration.registered_camera(CAMERA, wheels=wheels), config).keyframes is None
