"""`odom` moves as the robot does, whatever leaps a filter makes, and nothing else is moved by that."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from localizer.joined_drives import BEND, Drive, Sight, answers_to, drive, joined, spinning
from narrowing import not_none

from wheelsight.core.estimates import Estimate, OdomFrame, Reason, Status, WheelEstimate
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.estimation import FusedEstimate
from wheelsight.estimation.fusion_localizer import FusedOdom

LEGS = (*BEND, (4.0, 0.6, 0.1))
# What a camera that fails, or a slip that is reported once a frame, may be off in one frame of 0.04 s, at these speeds.
POSSIBLE_M = 0.05


def only(when: tuple[float, float], sight: Sight) -> Callable[[float], Sight]:
    """Frames between these seconds show so much."""
    return lambda seconds: sight if when[0] < seconds < when[1] else Sight()


# The filter leaps where slip is over and no one says which was right, and where a camera that went astray is believed
# after all; and where the camera comes back after a slip in the dark.
LEAPING = {
    "slow slip": lambda: spinning(drive(LEGS), 2.0, 4.5, 0.15),
    "camera astray": lambda: drive(LEGS, only((2.0, 5.0), Sight(wrong=(0.3, 0.0, 0.2)))),
    "slip in the dark": lambda: spinning(drive(LEGS, only((2.0, 4.0), Sight(Reason.TOO_LITTLE_DEPTH))), 2.5, 3.0, 0.6),
}


def answers_of(made: Drive, monkeypatch: pytest.MonkeyPatch) -> list[FusedEstimate]:
    found = [answer for _, answer in answers_to(joined(monkeypatch, made.eye())[0], made.events())]
    return [answer for answer in found if answer.T_odom_body is not None]


def off_m(answers: list[FusedEstimate], made: Drive, name: str) -> FloatArray:
    """By how much steps between answers are off the true ones, metres."""
    T = np.array([getattr(answer, name) for answer in answers])
    stamps_s = np.clip([answer.stamp_s for answer in answers], *made.truth.stamps_s[[0, -1]])
    true = made.truth.at(stamps_s)
    steps, true_steps = (se3.invert(way[:-1]) @ way[1:] for way in (T, true))
    return np.asarray(np.linalg.norm((steps - true_steps)[:, :2, 3], axis=1))


@pytest.mark.parametrize("name", LEAPING)
def test_where_the_filter_leaps_odom_moves_as_the_robot_does(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    made = LEAPING[name]()
    answers = answers_of(made, monkeypatch)
    assert off_m(answers, made, "T_filter_body").max() > 2 * POSSIBLE_M
    assert off_m(answers, made, "T_odom_body").max() < POSSIBLE_M


def test_what_is_known_of_the_pose_is_the_same_with_and_without(monkeypatch: pytest.MonkeyPatch) -> None:
    """In the map, in the filter's frame, and relative to keyframes; heights, tilts and covariances, too."""
    made = LEAPING["camera astray"]()
    smooth = answers_of(made, monkeypatch)
    monkeypatch.setattr(FusedOdom, "frame_at", lambda *_: OdomFrame())
    plain = answers_of(made, monkeypatch)
    assert len(smooth) == len(plain)
    for ours, theirs in zip(smooth, plain, strict=True):
        np.testing.assert_allclose(not_none(ours.T_map_body), not_none(theirs.T_map_body), atol=1e-9)
        np.testing.assert_allclose(not_none(ours.T_filter_body), not_none(theirs.T_odom_body), atol=1e-9)
        np.testing.assert_allclose(not_none(ours.filter_covariance), not_none(theirs.covariance), atol=1e-9)
        np.testing.assert_allclose(not_none(ours.T_odom_body)[2], not_none(theirs.T_odom_body)[2], atol=1e-9)
        assert (ours.status, ours.slip, ours.doubtful) == (theirs.status, theirs.slip, theirs.doubtful)


def test_covariance_in_odom_contains_the_drift_that_odom_does_not_correct() -> None:
    frame, T = OdomFrame(), se3.from_plane(1.0, -2.0, 0.7)
    frame.align(T, se3.from_plane(4.0, 2.0, 0.8))  # the filter knows now that it is 5 m from where odom has it
    answer = estimate_at(T, FusedEstimate)
    framed = frame.framed(answer)
    off = not_none(framed.T_odom_body)[:2, 3] - T[:2, 3]
    of_filter = frame.framed(estimate_at(T))  # of no fused estimate, and so without drift
    drift = not_none(framed.covariance) - not_none(of_filter.covariance)
    P = se3.position_covariance(not_none(framed.T_odom_body), drift)
    assert off @ P[:2, :2] @ off == pytest.approx((off @ off) ** 2, rel=0.2)  # σ along the way is its length
    np.testing.assert_allclose(not_none(framed.filter_covariance), not_none(answer.covariance), atol=1e-9)


def test_whatever_way_is_thought_better_of_steps_in_odom_are_the_motions() -> None:
    rng = np.random.default_rng(5)
    frame, T_filter, last, before = OdomFrame(), np.eye(4), None, None
    for _ in range(50):
        step = se3.from_plane(*rng.normal(size=3) * [0.05, 0.01, 0.1])
        if before is not None:  # the filter has the pose before, and so the one now, elsewhere than it thought
            leap = se3.from_plane(*rng.normal(size=3))
            frame.align(leap @ before, frame.T_odom_filter @ before)
            T_filter = leap @ before
        T_filter = T_filter @ step
        T_odom = frame.T_odom_filter @ T_filter
        if last is not None:
            np.testing.assert_allclose(se3.invert(last) @ T_odom, step, atol=1e-9)
        last, before = T_odom, T_filter


def estimate_at(T: FloatArray, kind: type[Estimate] = Estimate, **more: Any) -> Estimate:
    A = np.random.default_rng(2).normal(size=(6, 6))
    return kind(1.0, Status.TRACKING, T, A @ A.T, T_map_odom=se3.exp([3.0, 1, 0.2, 0.1, -0.1, 2]), **more)


def test_an_answer_in_odom_is_the_same_pose_in_the_map() -> None:
    frame, T = OdomFrame(), se3.exp([1.0, -2, 0.3, 0.05, 0.1, 0.7])
    answer = estimate_at(T)
    assert frame.framed(answer) is answer  # nothing has leapt
    frame.align(T, se3.from_plane(0.5, 4.0, -1.0))
    framed = frame.framed(answer)
    np.testing.assert_allclose(
        framed.T_map_odom @ not_none(framed.T_odom_body), not_none(answer.T_map_body), atol=1e-12
    )
    np.testing.assert_allclose(not_none(framed.T_filter_body), T, atol=1e-12)
    np.testing.assert_allclose(not_none(framed.filter_covariance), not_none(answer.covariance), atol=1e-9)
    np.testing.assert_allclose(not_none(framed.T_odom_body)[:2, 3], [0.5, 4.0], atol=1e-12)
    np.testing.assert_allclose(not_none(framed.T_odom_body)[2], T[2], atol=1e-12)


def test_a_wheel_answer_in_odom_shows_the_same_step() -> None:
    frame, T = OdomFrame(), se3.from_plane(2.0, 1.0, 0.4)
    before = (0.9, se3.from_plane(1.9, 1.0, 0.38), 0.5 * np.eye(6))
    answer = WheelEstimate(1.0, Status.TRACKING, T, np.eye(6), body="base", before=before)
    frame.align(T, se3.from_plane(-7.0, 3.0, 2.0))
    step, framed = not_none(answer.step), not_none(frame.framed(answer).step)
    np.testing.assert_allclose(framed.T_before_now, step.T_before_now, atol=1e-12)
    np.testing.assert_allclose(framed.covariance, step.covariance, atol=1e-9)
