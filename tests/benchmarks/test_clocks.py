"""The benchmark of faults of stamps asks where its events truly were, and counts what it says it counts."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from benchmarks import clocks as benchmark
from benchmarks.clock_faults import ClockLeaps, Sensors
from benchmarks.clock_rows import DRIVE, ROWS, Row, TimedTicks, timed
from benchmarks.clock_runs import ClockFigures, Errors, measure_drive
from benchmarks.clocks import clocks_sheet, measure_clocks
from benchmarks.joined_runs import CAMERA, JOINED, WHEELS
from wheelsight.config import Config
from wheelsight.core.calibration import Calibration
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.estimates import Estimate, Reason, Status
from wheelsight.core.geometry import se3
from wheelsight.core.messages import Event, RgbdFrame, WheelTicks
from wheelsight.core.trajectory import Trajectory
from wheelsight.estimation import Localizer
from wheelsight.io.recordings import Recording

WHEELS_TRUE = Wheels(0.2, 0.2, 0.5, 2 * math.pi * 0.2 * 1000)  # a tick a millimetre
STAMPS_S = np.arange(0, 4 + 1e-9, 0.1)
LEAP = next(row for row in ROWS if row.name == "both clocks jump +60 s")
PIXEL = np.zeros((1, 1, 3), np.uint8), np.ones((1, 1), np.float32)


@dataclass
class Drive:
    """Straight on at 0.5 m/s from somewhere, a reading and a frame each tenth of a second."""

    calibration: Calibration = field(default_factory=lambda: Calibration(wheels=WHEELS_TRUE))

    @property
    def ground_truth(self) -> Trajectory:
        T = np.tile(se3.from_plane(3.0, -1.0, 0.8), (len(STAMPS_S), 1, 1))
        T = np.array([T_0 @ se3.from_plane(0.5 * t, 0, 0) for T_0, t in zip(T, STAMPS_S, strict=True)])
        return Trajectory(STAMPS_S, T, body="base")

    def events(self) -> Iterator[Event]:
        for index, stamp_s in enumerate(STAMPS_S.tolist()):
            yield WheelTicks(stamp_s, round(500 * stamp_s), round(500 * stamp_s))
            yield RgbdFrame(stamp_s, *PIXEL, index)


class Knows(Localizer):
    """Goes by the counts of readings, whatever their stamps: right but for `off_m`, at frames and readings."""

    off_m, behind_s = 0.0, 0.0
    reason: Reason | None = None

    def __init__(self, calibration: Calibration, config: Config) -> None:
        self.way_m = 0.0

    def process(self, event: Event) -> Estimate:
        if isinstance(event, WheelTicks):
            self.way_m = event.left / 1000
        T = se3.from_plane(self.way_m - 0.5 * self.behind_s, self.off_m, 0)
        covariance = np.diag([1e-4, 1e-4, 1e-4, 1e-9, 1e-9, 1e-9])
        return Estimate(event.stamp_s - self.behind_s, Status.TRACKING, T, covariance, self.reason, "base")


def measured(monkeypatch: pytest.MonkeyPatch, row: Row, **how: Any) -> ClockFigures:
    found: list[ClockFigures] = []
    monkeypatch.setattr("benchmarks.clock_runs.Localizer", type("Reported", (Knows,), how))
    measure_drive(cast(Recording, Drive()), [row], 1, found.append)
    (figures,) = found
    return figures


def leap(by_s: float, at_s: float = 2.0, sensors: Sensors = "both", **how: Any) -> Row:
    return Row("leap", (ClockLeaps(at_s, by_s, sensors),), **how)


@pytest.mark.parametrize("row", [ROWS[0], leap(60.0), leap(-60.0), leap(1.0, sensors="camera"), leap(0.2)])
def test_what_is_right_is_right_whatever_the_stamps_say(monkeypatch: pytest.MonkeyPatch, row: Row) -> None:
    figures = measured(monkeypatch, row)
    assert [e.posed for e in figures.errors.values()] == [1.0] * 3
    # The camera alone gets no readings, so Knows stands still there.
    assert figures.errors[JOINED].rmse_m < 1e-6 > figures.errors[WHEELS].rmse_m
    assert figures.errors[CAMERA].rmse_m > 0.5


def test_a_position_that_is_sure_and_wrong_is_counted_in_the_plane(monkeypatch: pytest.MonkeyPatch) -> None:
    assert measured(monkeypatch, ROWS[0], off_m=0.03).errors[JOINED].wrong == 0
    figures = measured(monkeypatch, ROWS[0], off_m=0.05)
    assert figures.errors[JOINED].wrong == len(STAMPS_S)
    assert figures.errors[JOINED].rmse_m == pytest.approx(0.05)
    assert figures.ratio == pytest.approx(0.05 / (1.2 * 0.05 + 0.005))


def test_an_answer_with_an_old_stamp_is_compared_there_only_where_it_says_that_clocks_are_apart(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    how = {"behind_s": 1.05, "reason": Reason.CLOCKS_APART}
    apart = measured(monkeypatch, ROWS[0], **how).errors[JOINED]
    assert apart.posed == pytest.approx(33 / 41)  # the first eight are older than all that was reported
    assert apart.rmse_m < 0.05  # the next three stood where the drive begins
    assert measured(monkeypatch, ROWS[0], behind_s=1.05).errors[JOINED].rmse_m == pytest.approx(0.525)


def test_readings_keep_their_true_time_and_are_reported_as_they_come() -> None:
    ticks = [event for event in leap(60.0).events(timed(Drive().events())) if isinstance(event, TimedTicks)]
    np.testing.assert_allclose([event.true_s for event in ticks], STAMPS_S)
    assert type(ticks[-1].plain) is WheelTicks
    assert ticks[-1].plain.stamp_s == pytest.approx(64.0)


def test_what_breaks_is_counted_and_not_met(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(self: Knows, event: Event) -> Estimate:
        raise KeyError(event.stamp_s)

    figures = measured(monkeypatch, ROWS[0], process=broken)
    assert len(figures.problems) == 3
    assert figures.problems[0].startswith("KeyError at test_clocks.py:")
    assert math.isinf(figures.ratio)
    assert not figures.is_met


def figures_of(
    joined_mm: float,
    *,
    camera: tuple[float, float] = (4.0, 1.0),
    wheels: tuple[float, float] = (15.0, 1.0),
    wrong: int = 0,
    row: str = "clean",
    seed: int = 1,
) -> ClockFigures:
    alone = {CAMERA: Errors(camera[0] / 1e3, camera[1], 0), WHEELS: Errors(wheels[0] / 1e3, wheels[1], 0)}
    return ClockFigures(row, seed, {**alone, JOINED: Errors(joined_mm / 1e3, 1.0, wrong)})


def test_a_sensor_without_poses_at_a_tenth_of_the_frames_is_none() -> None:
    assert figures_of(9.8).ratio == pytest.approx(1.0)
    assert figures_of(23.0, camera=(4.0, 0.89)).ratio == pytest.approx(1.0)
    assert figures_of(1e9, camera=(4.0, 0.5), wheels=(15.0, 0.5)).ratio == 0.0


def test_a_line_a_row_with_median_and_worst() -> None:
    sheet = clocks_sheet([figures_of(4.8, seed=1), figures_of(19.6, wrong=3, seed=2), figures_of(5.0, row=LEAP.name)])
    assert sheet.title.startswith("Faults of stamps, 2 drives")
    assert [row[0] for row in sheet.rows] == ["clean", LEAP.name]
    assert sheet.rows[0][4:] == ("12.2 (19.6)", "2.00", "100.0 %", "3", "0", "1 of 2")
    assert {len(row) for row in sheet.rows} == {len(sheet.header)}
    assert len({row.name for row in ROWS}) == len(ROWS)
    assert not any("," in row.name for row in ROWS)


def test_what_is_kept_is_not_measured_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[str, int]] = []

    def measure(recording: object, rows: Sequence[Row], seed: int, on_figures: Callable[[ClockFigures], None]) -> None:
        for row in rows:
            asked.append((row.name, seed))
            on_figures(figures_of(math.inf, row=row.name, seed=seed))

    monkeypatch.setattr(benchmark, "measure_drive", measure)
    monkeypatch.setattr(benchmark, "drive_of", lambda *_: None)
    first = measure_clocks(ROWS, [1], tmp_path, lambda _: None, tmp_path / "kept")
    again = measure_clocks(ROWS, [1, 2], tmp_path, lambda _: None, tmp_path / "kept")
    assert again[: len(ROWS)] == first
    assert len(asked) == len(again) == 2 * len(ROWS)


def test_the_file_names_the_command_that_repeats_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(benchmark, "measure_clocks", lambda *_: [figures_of(5.0)])
    words = ["x", "--seeds", "1", "--rows", "clean", "--images", str(tmp_path), "--out", str(tmp_path / "clocks.md")]
    monkeypatch.setattr("sys.argv", words)
    benchmark.main()
    text = (tmp_path / "clocks.md").read_text()
    assert '`python -m benchmarks.clocks --seeds 1 --rows "clean" --out clocks.md`' in text
    assert str(tmp_path) not in text
    assert "| clean |" in text


@pytest.mark.slow
def test_two_rows_on_a_tiny_drive_that_is_kept(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    tiny = replace(DRIVE, size=(160, 120), rate_hz=5.0, duration_s=2.0)
    rows = [ROWS[0], next(row for row in ROWS if row.name == "counters of 8 bits")]
    reported: list[ClockFigures] = []
    figures = measure_clocks(rows, [1], tmp_path, reported.append, settings=tiny)
    assert [f.row for f in figures] == [row.name for row in rows]
    assert figures == reported
    assert not any(f.problems for f in figures)
    assert figures[0].errors[CAMERA] == figures[1].errors[CAMERA]
    assert all(f.errors[JOINED].rmse_m < 0.02 for f in figures)
    assert figures[0].errors[WHEELS].rmse_m < 0.02
    assert [path.name for path in tmp_path.iterdir()] == ["flat-1"]
