"""The script of real wheels: its table and figures, on a drive whose wheels are known."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from wheelsight.core.calibration import Calibration
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.messages import WheelTicks, YawRate
from wheelsight.core.trajectory import Trajectory
from wheelsight.io.recordings import RecordingWriter
from wheelsight.wheels import integrate_log

pytest.importorskip("matplotlib", reason="the papers' scripts need the extra 'papers'")

TRUE = Wheels(0.17, 0.172, 0.55, 3200.0)
NOMINAL = Wheels(0.168, 0.168, 0.6, 3200.0)


@pytest.fixture(scope="module")
def wheels_real(project_folder: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location("wheels_real", project_folder / "papers" / "wheels_real.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["wheels_real"] = module  # its dataclasses look themselves up
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    """Three minutes of bends, straights and stops, by a robot of other sizes than its calibration says."""
    t = np.arange(0, 180, 0.02)
    speed = 60 * (np.sin(t / 15) > -0.8)
    turn = 18 * np.sin(t / 4) * np.sin(t / 11)
    left, right = (np.cumsum(np.rint(speed + sign * turn)).astype(int) for sign in (-1, 1))
    path = integrate_log(TRUE, t, left, right)
    truth = Trajectory(t, path.trajectory().T_frame_body, body="base")
    yaw = np.unwrap(path.poses[:, 2])
    with RecordingWriter(tmp_path / "drive", Calibration(wheels=NOMINAL)) as writer:
        writer.add_ground_truth(truth)
        rates = np.gradient(yaw, t) + 0.01
        for stamp, *ticks, rate in zip(t.tolist(), left.tolist(), right.tolist(), rates.tolist(), strict=True):
            writer.add(YawRate(stamp, rate))
            writer.add(WheelTicks(stamp, *ticks))
    return tmp_path / "drive"


def test_the_table_shows_each_way_of_reckoning_on_the_part_no_fit_has_seen(
    wheels_real: ModuleType, drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert wheels_real.main([str(drive), "--out", str(tmp_path / "out")]) == 0
    printed = capsys.readouterr().out
    rows = {row.split(" | ")[1]: row.split(" | ") for row in printed.splitlines() if row.startswith("| drive")}
    assert set(rows) == {
        "Euler, nominal",
        "midpoint, nominal",
        "arc, nominal",
        "arc with gyro, nominal",
        "arc, fitted",
        "arc with gyro, fitted",
    }
    ate_m = {way: float(row[3].removesuffix(" m")) for way, row in rows.items()}
    assert ate_m["arc, fitted"] < 0.05
    assert ate_m["arc with gyro, nominal"] < 0.5 * ate_m["arc, nominal"]
    assert ate_m["arc, nominal"] > 1.0
    assert (tmp_path / "out" / "drive.png").stat().st_size > 20_000


def test_errors_in_closed_form(wheels_real: ModuleType) -> None:
    """Wheels one per cent too small on a straight way: one per cent everywhere."""
    t = np.arange(0, 100, 0.1)
    x = 2.0 * t
    zero = np.zeros(len(t))
    truth = Trajectory(t, wheels_real.se3.from_plane(x, zero, zero), body="base")
    short = Trajectory(t, wheels_real.se3.from_plane(0.99 * x, zero, zero), body="base", frame="odom")
    errors = wheels_real.errors_of(short, truth)
    assert errors.way_m == pytest.approx(199.8)
    assert errors.end_m == pytest.approx(0.01 * 199.8)
    assert (errors.stretch_m, errors.drift_percent) == (50.0, pytest.approx(1.0, rel=0.01))
    assert errors.turn_deg == pytest.approx(0.0, abs=1e-6)
    assert errors.ate_m == pytest.approx(0.01 * 2.0 * np.std(t), rel=1e-6)


def test_a_recording_without_wheels_or_truth_is_one_line(
    wheels_real: ModuleType, drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (drive / "groundtruth_base.txt").unlink()
    assert wheels_real.main([str(drive), "--out", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err.startswith(f"error: {drive}: has no wheels, or no truth")
