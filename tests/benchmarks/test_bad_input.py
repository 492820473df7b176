"""The table of bad input counts what it says it counts."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks.bad_drives import Case
from benchmarks.bad_input import (
    Answer,
    bad_input_sheet,
    judge_bad_input,
    measure_case,
)
from wheelsight.core.estimates import Estimate, Reason, Status
from wheelsight.core.geometry import FloatArray, se3, so3
from wheelsight.core.messages import Event, RgbdFrame, WheelTicks
from wheelsight.core.trajectory import Trajectory
from wheelsight.estimation import FusedEstimate
from wheelsight_sim.faults import CableOut

FRAMES = 60
STAMPS_S = np.arange(FRAMES) / 10
VARIANCE = 0.02**2
Span = tuple[float, float]


@pytest.fixture(scope="module")
def truth() -> Trajectory:
    """T_odom_camera along a straight line, turned somehow, at 0.5 m/s."""
    positions_m = np.stack([1 + 0.5 * STAMPS_S, np.full(FRAMES, 2.0), np.full(FRAMES, 0.9)], axis=1)
    R = np.broadcast_to(so3.exp([0.3, -0.2, 0.5]), (FRAMES, 3, 3))
    return Trajectory(STAMPS_S, se3.from_parts(R, positions_m), body="camera")


@pytest.fixture(scope="module")
def events() -> list[Event]:
    blank = np.zeros((2, 2, 3), np.uint8), np.zeros((2, 2), np.float32)
    frames = [RgbdFrame(float(stamp_s), *blank, index) for index, stamp_s in enumerate(STAMPS_S)]
    return sorted([*frames, WheelTicks(0.01, 1, 1)], key=lambda event: event.stamp_s)


class Tracker:
    """Knows the truth from its own start, but for the errors that it is given."""

    def __init__(
        self,
        truth: Trajectory,
        *,
        off_m: float = 0.0,
        off_rad: float = 0.0,
        wrong_s: Span = (9, 9),
        silent_s: Span = (9, 9),
        fuses: bool = False,
    ) -> None:
        self._T_start_world = se3.invert(truth.T_frame_body[0])
        self.truth, self._fuses = truth, fuses
        self._wrong_s, self._silent_s = wrong_s, silent_s
        self._T_off = se3.from_parts(so3.exp([0, 0, off_rad]), [0, off_m, 0])

    def __call__(self, frame: Event) -> Answer | None:
        if not isinstance(frame, RgbdFrame):
            return None
        if self._silent_s[0] <= frame.stamp_s < self._silent_s[1]:
            return Answer(Estimate(frame.stamp_s, Status.LOST, reason=Reason.TOO_LITTLE_DEPTH), self._fuses)
        T = self._T_start_world @ self.truth.at(frame.stamp_s)[0]
        if self._wrong_s[0] <= frame.stamp_s < self._wrong_s[1]:
            T = T @ self._T_off
        return Answer(Estimate(frame.stamp_s, Status.TRACKING, T, VARIANCE * np.eye(6)), self._fuses)


def test_what_is_right_is_right_wherever_its_world_begins(truth: Trajectory, events: list[Event]) -> None:
    figures = measure_case(Case("clean"), "dense", Tracker(truth), events, truth)
    assert (figures.frames, figures.with_pose, figures.wrong, figures.back_s) == (FRAMES, FRAMES, 0, None)
    assert figures.statuses == (("tracking", FRAMES),)
    assert max(figures.rmse_m, figures.worst_m) < 1e-9
    assert figures.within == 1.0


def test_a_failure_that_is_said_is_no_wrong_pose(truth: Trajectory, events: list[Event]) -> None:
    case = Case("covered", 2.0, 4.0)
    figures = measure_case(case, "dense", Tracker(truth, silent_s=(2.0, 4.5)), events, truth)
    assert (figures.with_pose, figures.wrong) == (FRAMES - 25, 0)
    assert figures.statuses == (("lost", 20),)
    assert figures.back_s == pytest.approx(0.5)


def test_a_failure_unsaid_is_counted_as_long_as_it_lasts(truth: Trajectory, events: list[Event]) -> None:
    case = Case("person", 2.0, 4.0)
    beyond: list[dict[str, Any]] = [{"off_m": 0.11}, {"off_rad": math.radians(5.1)}]
    within: list[dict[str, Any]] = [{"off_m": 0.09}, {"off_rad": math.radians(4.9)}]
    for off in beyond:
        figures = measure_case(case, "dense", Tracker(truth, wrong_s=(3.0, 5.0), **off), events, truth)
        assert (figures.with_pose, figures.wrong, figures.back_s) == (FRAMES, 20, 0.0)
    for off in within:
        assert measure_case(case, "dense", Tracker(truth, wrong_s=(3.0, 5.0), **off), events, truth).wrong == 0


@pytest.mark.parametrize("reported", [{"status": Status.COASTING}, {"doubtful": True}])
def test_a_wrong_pose_that_is_reported_as_such_is_not_unsaid(
    truth: Trajectory, events: list[Event], reported: dict[str, Any]
) -> None:
    tracker, case = Tracker(truth, off_m=0.5, wrong_s=(3.0, 5.0)), Case("person", 2.0, 4.0)

    def telling(event: Event) -> Answer | None:
        answer = tracker(event)
        return None if answer is None else Answer(FusedEstimate(**(_fields(answer.estimate) | reported)))

    assert measure_case(case, "wheels, dense", tracker, events, truth).wrong == 20
    assert measure_case(case, "wheels, dense", telling, events, truth).wrong == 0


def _fields(estimate: Estimate) -> dict[str, Any]:
    names = ("stamp_s", "status", "T_odom_body", "covariance")
    return {name: getattr(estimate, name) for name in names}


def test_what_went_wrong_before_the_fault_is_not_laid_to_it(truth: Trajectory, events: list[Event]) -> None:
    tracker = Tracker(truth, off_m=0.3, wrong_s=(1.0, 9.0))
    figures = measure_case(Case("covered", 2.0, 4.0), "dense", tracker, events, truth)
    assert figures.wrong == 0
    assert figures.worst_m == pytest.approx(0.3)
    assert measure_case(Case("clean"), "dense", tracker, events, truth).wrong == FRAMES - 10


def test_positions_within_three_sigma_are_counted(truth: Trajectory, events: list[Event]) -> None:
    # 3.76 standard deviations of 2 cm are what three dimensions exceed as rarely as one exceeds three.
    for off_m, share in ((0.074, 1.0), (0.077, 0.5)):
        tracker = Tracker(truth, off_m=off_m, wrong_s=(3.0, 9.0))
        # The covariance is that of a perturbation about the world's origin: near it, position's alone.
        close = replace(truth, T_frame_body=_standing(truth))
        assert measure_case(Case("x"), "dense", _on(tracker, close), events, close).within == share


def _standing(truth: Trajectory) -> FloatArray:
    return np.broadcast_to(truth.T_frame_body[0], truth.T_frame_body.shape).copy()


def _on(tracker: Tracker, truth: Trajectory) -> Tracker:
    tracker.truth = truth
    return tracker


def test_what_a_map_learned_of_failed_and_of_wrong_frames_is_counted(truth: Trajectory, events: list[Event]) -> None:
    case = Case("covered", 2.0, 4.0)
    tracker = Tracker(truth, silent_s=(2.0, 3.0), off_m=0.5, wrong_s=(3.0, 3.5), fuses=True)
    figures = measure_case(case, "surfels", tracker, events, truth)
    assert (figures.fused_failed, figures.fused_wrong, figures.wrong) == (10, 5, 5)


def test_a_case_spoils_events_and_shows_frames_that_never_came(truth: Trajectory, events: list[Event]) -> None:
    case = Case("cable out", 2.0, 4.0, (CableOut(begin_s=2.0, end_s=4.0),))
    figures = measure_case(case, "dense", Tracker(truth), events, truth)
    assert (figures.frames, figures.statuses, figures.back_s) == (FRAMES - 20, (), 0.0)


def test_no_failure_may_go_unsaid_nor_reach_the_map(truth: Trajectory, events: list[Event]) -> None:
    good = measure_case(Case("clean"), "dense", Tracker(truth), events, truth)
    bad = replace(good, tracker="surfels", wrong=3, fused_failed=2, fused_wrong=3)
    verdicts = [target.is_met for target in judge_bad_input([replace(bad, tracker="features"), good, bad])]
    assert verdicts == [True, False, False]
    sheet = bad_input_sheet([good, bad])
    assert {len(row) for row in sheet.rows} == {len(sheet.header)}
    assert [row[8] for row in sheet.rows] == ["—", "3"]


def test_a_frame_beyond_the_truths_end_counts_as_no_pose_that_is_right_or_wrong(
    truth: Trajectory, events: list[Event]
) -> None:
    short = replace(truth, stamps_s=truth.stamps_s[:-2], T_frame_body=truth.T_frame_body[:-2])
    figures = measure_case(Case("clean"), "dense", Tracker(truth, off_m=0.5, wrong_s=(5.7, 9.0)), events, short)
    assert (figures.frames, figures.with_pose, figures.wrong) == (FRAMES, FRAMES - 2, 1)
