from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from pipeline.made import (
    BY_FEATURES,
    BY_WHEELS,
    FILES,
    WHEELS,
    frames_at,
    metrics_in,
    status_in,
    wheel_recording,
)
from stand_ins import MemoryRecording

from wheelsight.app.runs import run
from wheelsight.core.errors import CalibrationError, ConfigError
from wheelsight.core.estimates import Status
from wheelsight.core.messages import WheelTicks
from wheelsight.core.trajectory import Trajectory, read_tum


def test_wheels_leave_every_file_too(tmp_path: Path) -> None:
    heard: list[Status] = []
    record = run(wheel_recording(), BY_WHEELS, tmp_path, on_frame=lambda frame: heard.append(frame.status))
    assert {path.name for path in tmp_path.iterdir()} == FILES
    assert heard == [Status.TRACKING] * 300
    written = read_tum(tmp_path / "trajectory.txt")
    assert (written.frame, written.body, len(written)) == ("odom", "base", 300)
    metrics = metrics_in(tmp_path)
    assert metrics["frame"] == "T_odom_base"
    assert "frames" not in metrics
    readings = metrics["wheel_readings"]
    assert (readings["listed"], readings["processed"], readings["with_pose"]) == (300, 300, 300)
    assert metrics["evaluation"]["ate_m"]["rmse"] < 1e-6
    assert record.unit == "reading"
    assert [row["status"] for row in status_in(tmp_path)] == ["tracking"] * 300


def test_refused_readings_are_counted_and_have_no_pose(tmp_path: Path) -> None:
    recording = wheel_recording()
    events = list(recording.given)
    del events[100:150]
    events[200] = WheelTicks(events[200].stamp_s, 10**6, 10**6)  # type: ignore[union-attr]
    run(MemoryRecording(events, calibration=recording.calibration), BY_WHEELS, tmp_path)
    readings = metrics_in(tmp_path)["wheel_readings"]
    assert readings["reasons"] == {"gap between readings": 1, "implausible motion": 2}
    assert readings["status"] == {"failing": 3, "tracking": 247}
    assert len(read_tum(tmp_path / "trajectory.txt")) == 247


def test_frames_and_wheels_of_one_recording_do_not_mix(tmp_path: Path, truth: Trajectory) -> None:
    events = sorted([*frames_at(truth), *wheel_recording(20).given], key=lambda event: event.stamp_s)  # type: ignore[union-attr]
    both = replace(MemoryRecording([]).calibration, wheels=WHEELS)
    run(MemoryRecording(events, calibration=both), BY_WHEELS, tmp_path / "wheels")
    run(MemoryRecording(events, calibration=both), BY_FEATURES, tmp_path / "frames")
    assert len(status_in(tmp_path / "wheels")) == len(status_in(tmp_path / "frames")) == 20
    assert "T_odom_base" in (tmp_path / "wheels" / "trajectory.txt").read_text()
    assert "T_map_camera" in (tmp_path / "frames" / "trajectory.txt").read_text()


def test_truth_of_a_camera_says_nothing_of_a_base_that_is_nowhere(tmp_path: Path, truth: Trajectory) -> None:
    both = replace(MemoryRecording([]).calibration, wheels=WHEELS)
    recording = MemoryRecording(wheel_recording(20).given, truth, calibration=both)
    record = run(recording, BY_WHEELS, tmp_path)
    assert record.evaluation is None
    assert "give T_base_camera" in (record.evaluation_problem or "")


def test_what_cannot_be_run_leaves_nothing_behind(tmp_path: Path, truth: Trajectory) -> None:
    out = tmp_path / "out"
    with pytest.raises(ConfigError, match="no wheel readings"):
        run(
            MemoryRecording(frames_at(truth), calibration=replace(MemoryRecording([]).calibration, wheels=WHEELS)),
            BY_WHEELS,
            out,
        )
    with pytest.raises(CalibrationError, match="has no wheels"):
        run(MemoryRecording(wheel_recording().given), BY_WHEELS, out)
    with pytest.raises(ConfigError, match=r"no images .--odometry wheels"):
        run(wheel_recording(), BY_FEATURES, out)
    assert not out.exists()


def test_wheels_that_broke_off_are_kept_until_then(tmp_path: Path) -> None:
    recording = wheel_recording()
    events = [*recording.given[:100], KeyboardInterrupt(), *recording.given[100:]]
    with pytest.raises(KeyboardInterrupt):
        run(MemoryRecording(events, calibration=recording.calibration), BY_WHEELS, tmp_path)
    assert len(read_tum(tmp_path / "trajectory.txt")) == 100
    assert any("after 100 of 300 readings" in warning for warning in metrics_in(tmp_path)["warnings"])
