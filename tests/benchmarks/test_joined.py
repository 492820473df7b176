"""The benchmark of wheels and camera joined counts what it says it counts."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from narrowing import not_none

from benchmarks import joined as benchmark
from benchmarks.joined import joined_sheet, judge_joined, measure_joined
from benchmarks.joined_cases import CASES, Case, Expected, Way, robot_of
from benchmarks.joined_figures import Accuracy, JoinedFigures, accuracy_of, figures_of, slip_spans_s
from benchmarks.joined_kept import KeptFigures
from benchmarks.joined_runs import CAMERA, JOINED, PAPER, WHEELS, Answers
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.errors import InputError
from wheelsight.core.estimates import Estimate, Status
from wheelsight.core.geometry import se3, so3
from wheelsight.core.messages import WheelTicks
from wheelsight.core.trajectory import Trajectory
from wheelsight.estimation import FusedEstimate
from wheelsight_sim import Drive, RobotModel

SECONDS = 10.0
STAMPS_S = np.arange(0, SECONDS + 1e-9, 0.02)
WHEELS_TRUE = Wheels(0.2, 0.2, 0.5, 2 * math.pi * 0.2 * 1000)  # a tick a millimetre
VARIANCE = 0.02**2


def drive(slip_s: tuple[float, float] = (9.9, 9.9), runs_on_m_s: float = 0.0) -> Drive:
    """Straight on at 0.5 m/s, turned somehow; while it slips the left wheel runs that much faster."""
    positions_m = np.stack([1 + 0.5 * STAMPS_S, np.full_like(STAMPS_S, 2.0), np.zeros_like(STAMPS_S)], axis=1)
    T = se3.from_parts(np.broadcast_to(np.eye(3), (len(STAMPS_S), 3, 3)), positions_m)
    T = np.asarray(se3.from_plane(3.0, -1.0, 0.8) @ T)
    rolled_m = 0.5 * STAMPS_S
    extra_m = runs_on_m_s * (STAMPS_S.clip(*slip_s) - slip_s[0])
    ticks = [
        WheelTicks(float(t), round(1000 * (way + more)), round(1000 * way))
        for t, way, more in zip(STAMPS_S, rolled_m, extra_m, strict=True)
    ]
    return Drive(Trajectory(STAMPS_S, T, body="base"), tuple(ticks))


def answers_to(
    drive: Drive,
    *,
    off_m: float = 0.0,
    status: Callable[[float], Status] = lambda t: Status.TRACKING,
    slip: Callable[[float], bool] = lambda t: False,
    known: Callable[[float], bool] = lambda t: True,
) -> Answers:
    """What somebody says who knows the truth, laid into a world of his own, and is off by so much to the left."""
    T_odom_true = se3.from_parts(so3.exp([0.1, -0.2, 0.3]), [5.0, 1.0, 0.2])
    said: list[Estimate] = []
    for index, (stamp_s, T) in enumerate(drive.truth):
        T_reported = T_odom_true @ T @ se3.from_parts(np.eye(3), [0, off_m * (index > 0), 0])
        reported = FusedEstimate(stamp_s, status(stamp_s), slip=slip(stamp_s))
        said.append(
            replace(reported, T_odom_body=T_reported, covariance=VARIANCE * np.eye(6)) if known(stamp_s) else reported
        )
    return Answers(said)


def figures(case: Case, drive: Drive, lasts_s: tuple[float, float] = (0.0, math.inf), **joined: Any) -> JoinedFigures:
    reported = {WHEELS: answers_to(drive, off_m=0.2), CAMERA: answers_to(drive, off_m=0.1)}
    reported |= {PAPER: answers_to(drive, off_m=0.15), JOINED: answers_to(drive, **joined)}
    return figures_of(case, 1, reported, drive, WHEELS_TRUE, lasts_s)


ORDINARY = Case("ordinary", Way.CLEAN)


def test_what_is_right_is_right_wherever_its_world_begins() -> None:
    found = figures(ORDINARY, drive())
    assert found.accuracy[JOINED].rmse_m < 1e-9
    assert found.accuracy[JOINED].end_share < 1e-9
    assert found.right == found.within == (len(STAMPS_S), len(STAMPS_S))
    assert found.back_s is None


def test_errors_are_those_after_the_first_pose() -> None:
    found = figures(ORDINARY, drive(), off_m=0.05)
    assert found.accuracy[JOINED].rmse_m == pytest.approx(0.05, rel=1e-2)
    assert found.accuracy[JOINED].end_share == pytest.approx(0.05 / 5.0)
    assert found.ratio == pytest.approx(0.5, rel=1e-6)
    # 5 cm are within three of 2 cm and what the heading adds far from the origin; 30 cm are not.
    assert found.within == (len(STAMPS_S), len(STAMPS_S))
    assert figures(ORDINARY, drive(), off_m=0.5).within[1] == 1


def test_a_heading_that_is_lost_is_an_error() -> None:
    straight = drive()
    T_turned = [
        T
        if i == 0
        else straight.truth.T_frame_body[0] @ se3.from_plane(0, 0, 0.1) @ se3.invert(straight.truth.T_frame_body[0]) @ T
        for i, (_, T) in enumerate(straight.truth)
    ]
    reported = Answers(
        [Estimate(float(t), Status.TRACKING, T, np.eye(6)) for t, T in zip(STAMPS_S, T_turned, strict=True)]
    )
    assert accuracy_of(reported, straight.truth).end_share == pytest.approx(2 * math.sin(0.05), rel=1e-3)


def test_a_camera_that_is_lost_for_good_is_no_better_sensor() -> None:
    seen = figures(ORDINARY, drive())
    assert seen.better_m == pytest.approx(0.1, rel=1e-2)
    lost = replace(seen, accuracy={**seen.accuracy, CAMERA: Accuracy(0.1, 0.0, 0.89)})
    assert lost.better_m == pytest.approx(0.2, rel=1e-2)


def test_a_blackout_asks_for_coasting_and_for_being_back() -> None:
    case = Case("camera covered", Way.CLEAN, Expected.COASTING, 2.0)

    def status(t: float) -> Status:
        return Status.COASTING if 4.3 <= t < 6.5 else Status.TRACKING

    found = figures(case, drive(), (4.0, 6.0), status=status)
    assert found.right == (75, 75)  # from 4.5 to 6 s
    assert found.back_s == pytest.approx(0.5)
    late = figures(case, drive(), (4.0, 6.0), status=lambda t: Status.COASTING if t > 5 else Status.TRACKING)
    assert late.right == (75, 49)
    assert late.back_s == math.inf


def test_slips_are_found_and_must_be_reported() -> None:
    slipping = drive((3.0, 5.0), 0.2)
    (span,) = slip_spans_s(slipping, WHEELS_TRUE)
    assert span == pytest.approx((3.0, 5.0), abs=1e-6)
    assert slip_spans_s(drive((3.0, 5.0), 0.04), WHEELS_TRUE) == []
    case = Case("lifted", Way.LIFTED, Expected.SLIP)
    reported = figures(case, slipping, slip=lambda t: 3.3 <= t < 5.4)
    assert reported.right == (75, 75)
    assert reported.false_slip == 0.0
    silent = figures(case, slipping)
    assert silent.right == (75, 0)
    assert figures(ORDINARY, drive(), slip=lambda t: t >= 5).false_slip == pytest.approx(0.5, abs=0.01)


def test_people_in_the_way_are_no_slip() -> None:
    case = Case("people", Way.PEOPLE, Expected.POSED)
    asked, right = figures(case, drive(), status=lambda t: Status.COASTING if t > 5 else Status.TRACKING).right
    assert asked == right == len(STAMPS_S)
    assert figures(case, drive(), slip=lambda t: t < 1).right == (asked, asked - 50)


def test_a_base_that_slides_sideways_slips() -> None:
    straight = drive()
    T = straight.truth.T_frame_body.copy()
    T[:, :3, 3] += 0.06 * STAMPS_S[:, None] * T[:, :3, 1]
    assert slip_spans_s(replace(straight, truth=Trajectory(STAMPS_S, T, body="base")), WHEELS_TRUE)


def test_robots_differ_as_reported() -> None:
    for seed in range(1, 11):
        robot, nominal = robot_of(seed), RobotModel()
        size = (robot.left_radius_m + robot.right_radius_m) / 2 / nominal.left_radius_m - 1
        assert 0.005 <= abs(size) <= 0.01
        assert 0.001 <= abs(robot.right_radius_m - robot.left_radius_m) / nominal.left_radius_m <= 0.0025
        assert 0.005 <= abs(robot.track_width_m / nominal.track_width_m - 1) <= 0.01
        assert np.linalg.norm(robot.T_base_camera[:3, 3] - nominal.T_base_camera[:3, 3]) < 0.02
    assert robot_of(3) == robot_of(3) != robot_of(4)


def test_a_row_a_case_and_its_targets() -> None:
    found = [figures(ORDINARY, drive(), off_m=off_m) for off_m in (0.02, 0.04)]
    sheet = joined_sheet(found)
    assert [len(row) for row in sheet.rows] == [len(sheet.header)]
    assert "0.30 (0.40)" in sheet.rows[0]
    assert [target.is_met for target in judge_joined(found)] == [True, True, True]
    covered = Case("camera covered, 5 s", Way.CLEAN, Expected.COASTING, 5)
    bad = replace(figures(covered, drive(), (3.0, 8.0), off_m=0.13), within=(100, 94))
    assert [target.is_met for target in judge_joined([bad])] == [False, True, False, False]
    assert len({case.name for case in CASES}) == len(CASES)


def test_a_case_that_was_measured_on_fewer_drives_says_so() -> None:
    found = [replace(figures(ORDINARY, drive()), seed=seed) for seed in (1, 2)]
    fewer = replace(figures(Case("long", Way.LONG), drive()), seed=1)
    known = next(case for case in CASES if case.way is Way.LONG)
    sheet = joined_sheet([*found, replace(fewer, case=known)])
    assert "2 drives a case" in sheet.title
    assert [row[0] for row in sheet.rows] == [ORDINARY.name, f"{known.name} (1 drive)"]


@pytest.mark.slow
def test_all_four_answer_and_the_paper_goes_by_the_camera_reported() -> None:
    pytest.importorskip("mujoco")
    from benchmarks.joined import measure_joined

    (found,) = measure_joined([ORDINARY], seeds=[2], duration_s=3.0, odometry="features")
    assert isinstance(found, JoinedFigures)
    assert set(found.accuracy) == {WHEELS, CAMERA, PAPER, JOINED}
    # Without a camera the paper's filter would have no pose.
    assert all(accuracy.rmse_m < 0.1 for accuracy in found.accuracy.values())


def test_figures_that_are_kept_are_those_that_were_measured(tmp_path: Path) -> None:
    kept = KeptFigures(tmp_path / "kept", {"duration_s": 45.0})
    case = next(case for case in CASES if case.name == "camera covered, 5 s")
    found = figures(case, drive(), (4.0, 6.0))
    assert kept.of(case, 1) is None
    kept.keep(found)
    again = not_none(kept.of(case, 1))
    assert again == found
    assert again.case is case
    assert kept.of(case, 2) is None
    with pytest.raises(InputError, match="measured otherwise"):
        KeptFigures(tmp_path / "kept", {"duration_s": 30.0}).of(case, 1)


def test_what_is_kept_is_not_measured_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    measured: list[tuple[str, int]] = []

    def measure(recording: object, cases: Sequence[Case], seed: int, *_: object) -> Iterator[JoinedFigures]:
        for case in cases:
            measured.append((case.name, seed))
            yield replace(figures(case, drive()), seed=seed)

    monkeypatch.setattr(benchmark, "_measure_drive", measure)
    monkeypatch.setattr(benchmark, "drive_of", lambda *_: None)
    cases = CASES[:3]
    first = measure_joined(cases[:2], [1, 2], keep=tmp_path)
    assert len(first) == len(measured) == 4
    every = measure_joined(cases, [1, 2, 3], keep=tmp_path)
    assert {(f.case.name, f.seed) for f in every} == {(case.name, seed) for case in cases for seed in (1, 2, 3)}
    assert sorted(measured) == sorted((case.name, seed) for case in cases for seed in (1, 2, 3))


def test_the_file_names_the_command_that_repeats_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(benchmark, "measure_joined", lambda *_: [figures(CASES[0], drive())])
    words = ["x", "--seeds", "1", "--cases", "ordinary", "--keep", str(tmp_path), "--out", str(tmp_path / "joined.md")]
    monkeypatch.setattr("sys.argv", words)
    benchmark.main()
    text = (tmp_path / "joined.md").read_text()
    assert '`python -m benchmarks.joined --seeds 1 --cases "ordinary" --out joined.md`' in text
    assert str(tmp_path) not in text
    assert "| ordinary |" in text
