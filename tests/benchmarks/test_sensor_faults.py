"""Faults of sensors in mid-drive: what they change, and the table of their figures."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.clock_rows import drive_of
from benchmarks.sensor_faults import BEGIN_S, CASES, FaultFigures, SensorFaultCase, drive, faults_sheet, planar_nees
from wheelsight import RgbdFrame, SimulationSettings, WheelTicks
from wheelsight.core.geometry import se3
from wheelsight.core.messages import YawRate


def case_of(name: str) -> SensorFaultCase:
    return next(one for one in CASES if one.name == name)


def counts(case: SensorFaultCase) -> list[tuple[int, int]]:
    """Ticks of a drive ahead, ten a reading, whose fault lasts from the third reading to the fifth."""
    change, found = case.make(), []
    for n in range(8):
        ticks = change(WheelTicks(float(n), 10 * n, 10 * n), 3 <= n < 6)
        assert isinstance(ticks, WheelTicks)
        found.append((ticks.left, ticks.right))
    return found


@pytest.mark.parametrize(
    ("name", "left"),
    [
        ("clean", [0, 10, 20, 30, 40, 50, 60, 70]),
        ("left encoder dies", [0, 10, 20, 20, 20, 20, 30, 40]),
        ("left encoder reversed", [0, 10, 20, 10, 0, -10, 0, 10]),
        ("left wheel counts 10 % more", [0, 10, 20, 31, 42, 53, 63, 73]),
    ],
)
def test_a_wheel_goes_on_from_where_its_fault_left_it(name: str, left: list[int]) -> None:
    found = counts(case_of(name))
    assert [ticks[0] for ticks in found] == left
    assert [ticks[1] for ticks in found] == list(range(0, 80, 10))


def test_images_change_while_the_fault_is_there() -> None:
    rng = np.random.default_rng(1)
    frame = RgbdFrame(1.0, rng.integers(0, 255, (4, 6, 3), dtype=np.uint8), rng.random((4, 6)).astype(np.float32))
    change = case_of("images mirrored for 10 s").make()
    mirrored = change(frame, True)
    assert isinstance(mirrored, RgbdFrame)
    np.testing.assert_array_equal(mirrored.depth_m, frame.depth_m[:, ::-1])
    np.testing.assert_array_equal(mirrored.color, frame.color[:, ::-1])
    assert change(frame, False) is frame


def test_a_gyroscope_changes_alone() -> None:
    change, ticks = case_of("gyroscope's sign swaps").make(), WheelTicks(1.0, 3, 4)
    assert change(YawRate(1.0, 0.5), True) == YawRate(1.0, -0.5)
    assert change(ticks, True) is ticks


def test_the_table_has_the_worst_and_what_was_named() -> None:
    one = FaultFigures(
        "left encoder dies", "flat", 3, 0.4, 0.1, 0.1, 400, 0, 4, 1.5, ("the left wheel was left out",), 90.0, 0.7, 1.5
    )
    other = FaultFigures("left encoder dies", "flat", 4, 0.2, 0.9, 0.1, 400, 2, 0, math.nan, (), 70.0, nees=0.25)
    clean = FaultFigures("clean", "flat", 3, 0.1, 0.1, 0.1, 400, 0, 0, math.nan, (), 60.0)
    late = replace(other, warnings=one.warnings, found_s=3.5, found_m=1.2)
    (row, sound) = faults_sheet([one, other, late, clean], "Faults").rows
    assert row[:5] == ("left encoder dies", "0.40 0.20 0.20", "0.10 0.90 0.90", "2, 1 of 3", "4")
    assert row[5:] == ("0 %", "2 of 3", "1", "2.5 (3.5)", "1.5 0.25 0.25", "90")
    assert sound[6] == "0 alarms"
    assert case_of("left encoder dies").begin_s == BEGIN_S


def test_normalised_errors_are_one_where_the_covariance_is_right() -> None:
    rng = np.random.default_rng(2)
    root = rng.normal(0.0, 0.02, (6, 6))
    T, C = se3.exp(np.array([3.0, -2.0, 0.1, 0.0, 0.0, 0.8])), root @ root.T + 1e-6 * np.eye(6)
    errors = rng.multivariate_normal(np.zeros(6), C, 4000)
    found = [planar_nees(se3.exp(error) @ T, T, C) for error in errors]
    assert np.mean(found) == pytest.approx(1.0, abs=0.05)
    assert np.mean([planar_nees(se3.exp(error) @ T, T, 4 * C) for error in errors]) == pytest.approx(0.25, abs=0.02)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("world", "faults"),
    [
        ("flat", {"left encoder dies": "left wheel", "images mirrored for 10 s": "camera", "clean": ""}),
        # A straight corridor, in which the calibration of turns was never compared.
        ("floor4", {"left encoder reversed": "left wheel"}),
    ],
)
def test_a_sensor_that_fails_is_named_and_its_harm_undone(world: str, faults: dict[str, str], tmp_path: Path) -> None:
    recording = drive_of(3, tmp_path, SimulationSettings(world, size=(320, 240), rate_hz=10.0, duration_s=24.0))
    for name, named in faults.items():
        run = drive(recording, case_of(name), "wheels,dense")
        assert run.sure_wrong == 0
        assert max(run.odom_m, run.map_m) < 0.35
        assert [warning for warning in run.warnings if "left out" in warning and named not in warning] == []
        assert len(run.warnings) == bool(named)
        assert not named or run.found_s < 2.5
        assert not named or 0.1 < run.found_m < 1.5
