from __future__ import annotations

import errno
import json
import os
import pickle
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from pipeline.made import (
    BY_FEATURES,
    FILES,
    frames_at,
    metrics_in,
    status_in,
)
from stand_ins import MemoryRecording, TrueOdometry
from synthetic import make_tum_recording

from wheelsight.app.run.track import DEPTH_MISPLACED, DEPTH_MISSING, DEPTH_SCARCE, RunTrack
from wheelsight.app.runs import run
from wheelsight.config import Config, load_config
from wheelsight.core.errors import OutputError, RecordingError
from wheelsight.core.estimates import Estimate, Reason, Status
from wheelsight.core.messages import Event, RgbdFrame, SkippedFrame, WheelTicks
from wheelsight.core.trajectory import Trajectory, read_tum
from wheelsight.io.recordings import open_recording
from wheelsight.io.recordings.recording import LeftOut
from wheelsight_report import summarise


def test_a_run_leaves_every_file_and_a_true_trajectory(tmp_path: Path, truth: Trajectory) -> None:
    record = run(MemoryRecording(frames_at(truth), truth), BY_FEATURES, tmp_path / "new" / "out")
    out = tmp_path / "new" / "out"
    assert {path.name for path in out.iterdir()} == FILES
    written = read_tum(out / "trajectory.txt")
    assert [float(row["stamp_s"]) for row in status_in(out)] == written.stamps_s.tolist()
    np.testing.assert_allclose(written.T_frame_body, truth.T_frame_body, atol=1e-8)
    assert (out / "trajectory.txt").read_text().startswith("# frames: T_map_camera")
    assert record.estimate.covariances is not None
    assert record.estimate.covariances.shape == (20, 6, 6)
    metrics = metrics_in(out)
    assert metrics["frame"] == "T_map_camera"
    assert metrics["evaluation"]["ate_m"]["rmse"] < 1e-9
    assert metrics["evaluation"]["frames_with_pose"] == 1
    assert not metrics["interrupted"]
    assert load_config(out / "config.yaml") == BY_FEATURES


def test_frames_are_counted_by_what_became_of_them(tmp_path: Path, truth: Trajectory) -> None:
    events = frames_at(truth, dark=(7, 8))
    events[3] = SkippedFrame(truth.stamps_s[3], "depth/3.png: image is cut off", 3)
    events.insert(5, WheelTicks(truth.stamps_s[4] + 0.001, 1, 1))
    run(MemoryRecording(events, truth), BY_FEATURES, tmp_path)
    frames = metrics_in(tmp_path)["frames"]
    assert (frames["listed"], frames["processed"], frames["with_pose"], frames["skipped"]) == (20, 20, 17, 1)
    assert frames["with_pose_share"] == pytest.approx(17 / 20)
    assert (frames["dropped_color_images"], frames["dropped_depth_images"]) == (2, 1)
    assert frames["status"] == {"failing": 3, "tracking": 17}
    assert frames["reasons"] == {"frame unusable": 1, "too few keypoints with depth": 2}
    rows = status_in(tmp_path)
    assert len(rows) == 20
    assert rows[3]["note"] == "depth/3.png: image is cut off"
    assert rows[3]["reason"] == "frame unusable"
    assert rows[7]["status"] == "failing"
    assert rows[9]["inliers"] == "2"
    assert [row["dropped"] for row in rows] == [*("0" * 3), "1", *("0" * 15), "1"]  # the last has what has no partner
    assert frames["dropped"]["total"] == 2
    assert len(read_tum(tmp_path / "trajectory.txt")) == 17


def test_readings_that_were_left_out_are_counted_by_reason(tmp_path: Path, truth: Trajectory) -> None:
    reported = LeftOut("/odom: 30 messages came twice, and were left out.", 30, 100, "/odom: messages came twice")
    few = LeftOut("wheels.csv:7: the last line is cut off", 1, 7000, "wheels.csv: the last line is cut off")
    record = run(replace(MemoryRecording(frames_at(truth), truth), warnings=(reported, few)), BY_FEATURES, tmp_path)
    assert record.left_out == {reported.reason: (30, 100), few.reason: (1, 7000)}
    rows = status_in(tmp_path)
    assert [row["left_out"] for row in rows[:-1]] == [""] * (len(rows) - 1)
    assert rows[-1]["left_out"] == f"30 of 100: {reported.reason}; 1 of 7000: {few.reason}"
    metrics = metrics_in(tmp_path)
    assert metrics["frames"]["left_out"][reported.reason] == {"count": 30, "of": 100}
    (finding,) = [one for one in metrics["verdict"]["findings"] if one["about"] == "left out"]
    assert finding["tone"] == "amber"
    assert f"30 of 100: {reported.reason}" in finding["sentence"]


def test_what_was_left_out_is_copied_with_its_counts() -> None:
    reported = LeftOut("a sentence", 3, 9, "why")
    again = pickle.loads(pickle.dumps(reported))
    assert (again, again.gone, again.of, again.reason) == ("a sentence", 3, 9, "why")


@pytest.mark.parametrize(
    ("share", "why", "remedy"),
    [
        (0.0, DEPTH_MISSING, "uncover the camera"),
        (0.05, DEPTH_SCARCE, "uncover the camera"),
        (0.83, DEPTH_MISPLACED, "calibrate camera"),  # as by a lens whose coefficients are in the thousands
    ],
)
def test_too_little_depth_names_its_true_cause(
    tmp_path: Path, truth: Trajectory, monkeypatch: pytest.MonkeyPatch, share: float, why: str, remedy: str
) -> None:
    def without_depth(self: TrueOdometry, frame: RgbdFrame, *others: object) -> Estimate:
        return Estimate(frame.stamp_s, Status.INITIALIZING, reason=Reason.TOO_LITTLE_DEPTH)

    monkeypatch.setattr(TrueOdometry, "process", without_depth)
    events: list[Event | BaseException] = []
    for event in frames_at(truth):
        assert isinstance(event, RgbdFrame)
        depth_m = event.depth_m.ravel().copy()
        depth_m[round(share * depth_m.size) :] = 0
        events.append(replace(event, depth_m=depth_m.reshape(event.depth_m.shape)))
    record = run(MemoryRecording(events, truth), load_config(overrides={"odometry": "features"}), tmp_path)
    assert {row["note"] for row in status_in(tmp_path)} == {why}
    (found,) = (one for one in metrics_in(tmp_path)["verdict"]["findings"] if one["about"] == "poses")
    assert (found["tone"], found["sentence"]) == ("red", f"0 of 20 frames (0 %) have a pose: {why} (20).")
    assert remedy in found["remedy"]
    assert summarise(record).failures == ((why, 20),)


def test_images_that_came_before_are_no_frames_but_counted_and_reported(
    tmp_path: Path, truth: Trajectory, rng: np.random.Generator
) -> None:
    noisy = [
        replace(event, color=rng.integers(1, 256, event.color.shape, np.uint8), index=2 * event.index)
        for event in frames_at(truth)
        if isinstance(event, RgbdFrame)
    ]
    again = [replace(event, stamp_s=event.stamp_s + 0.001, index=event.index + 1) for event in noisy]
    record = run(
        MemoryRecording([e for pair in zip(noisy, again, strict=True) for e in pair], truth), BY_FEATURES, tmp_path
    )
    frames = metrics_in(tmp_path)["frames"]
    assert (frames["listed"], frames["processed"], frames["with_pose"]) == (40, 20, 20)
    assert (frames["with_pose_share"], frames["repeated_images"], frames["status"]) == (1.0, 20, {"tracking": 20})
    assert metrics_in(tmp_path)["evaluation"]["frames_with_pose"] == 1
    assert [row["reason"] for row in status_in(tmp_path)] == ["", "the same image as before"] * 20
    assert "20 of 40 listed frames show the same image as the frame before and were skipped" in record.warnings[-1]
    summary = summarise(record)
    assert (summary.frames, summary.posed, summary.skips) == (20, 20, (("the same image as before", 20),))


@pytest.mark.usefixtures("drawn_pages")
def test_without_ground_truth_the_rest_is_written(tmp_path: Path, truth: Trajectory) -> None:
    record = run(MemoryRecording(frames_at(truth)), BY_FEATURES, tmp_path)
    assert record.evaluation is None
    assert metrics_in(tmp_path)["evaluation_problem"] == "the recording has no ground truth"
    assert (tmp_path / "report.html").stat().st_size > 0


def test_ground_truth_of_another_time_is_reported_not_raised(tmp_path: Path, truth: Trajectory) -> None:
    elsewhen = Trajectory(truth.stamps_s + 1000, truth.T_frame_body)
    record = run(MemoryRecording(frames_at(truth), elsewhen), BY_FEATURES, tmp_path)
    assert record.evaluation is None
    assert "do not overlap in time" in (record.evaluation_problem or "")


def test_a_recording_in_which_nothing_can_be_followed_is_still_reported(tmp_path: Path, truth: Trajectory) -> None:
    record = run(MemoryRecording(frames_at(truth, dark=tuple(range(20))), truth), BY_FEATURES, tmp_path)
    assert len(record.estimate) == 0
    assert {path.name for path in tmp_path.iterdir()} == FILES - {"covariances.csv"}
    assert metrics_in(tmp_path)["frames"]["with_pose"] == 0


def test_a_recording_of_one_frame_is_reported(tmp_path: Path, truth: Trajectory) -> None:
    run(MemoryRecording(frames_at(truth)[:1], truth), BY_FEATURES, tmp_path)
    metrics = metrics_in(tmp_path)
    assert metrics["frames"]["with_pose"] == 1
    assert metrics["timing"]["frame_median_ms"] is None
    assert metrics["timing"]["first_frame_ms"] > 0


def test_results_are_not_overwritten_unless_asked(tmp_path: Path, truth: Trajectory) -> None:
    run(MemoryRecording(frames_at(truth), truth), BY_FEATURES, tmp_path)
    with pytest.raises(OutputError, match="--force"):
        run(MemoryRecording(frames_at(truth)[:5], truth), BY_FEATURES, tmp_path)
    assert metrics_in(tmp_path)["frames"]["processed"] == 20
    run(MemoryRecording(frames_at(truth)[:5], truth), BY_FEATURES, tmp_path, force=True)
    assert metrics_in(tmp_path)["frames"]["processed"] == 5


def test_the_output_is_tried_before_the_long_work(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    untouched = MemoryRecording([AssertionError("frames were read")])
    with pytest.raises(OutputError):
        run(untouched, BY_FEATURES, tmp_path / "file" / "out")


@pytest.mark.parametrize("stop", [KeyboardInterrupt(), RecordingError("the disk went away", path="depth")])
def test_what_was_tracked_survives_an_interruption(tmp_path: Path, truth: Trajectory, stop: BaseException) -> None:
    recording = MemoryRecording([*frames_at(truth)[:12], stop, *frames_at(truth)[12:]], truth)
    with pytest.raises(type(stop)):
        run(recording, BY_FEATURES, tmp_path)
    assert recording.was_closed
    assert {path.name for path in tmp_path.iterdir()} == FILES
    assert len(read_tum(tmp_path / "trajectory.txt")) == 12
    metrics = metrics_in(tmp_path)
    assert metrics["interrupted"]
    assert any("after 12 of 20 frames" in warning for warning in metrics["warnings"])


def test_an_error_of_ours_is_not_hidden(tmp_path: Path, truth: Trajectory) -> None:
    with pytest.raises(ZeroDivisionError):
        run(MemoryRecording([*frames_at(truth)[:2], ZeroDivisionError()]), BY_FEATURES, tmp_path)


def test_a_full_disk_is_one_line(tmp_path: Path, truth: Trajectory, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OutputError, match="no space left on the disk") as refused:
        run(MemoryRecording(frames_at(truth), truth), BY_FEATURES, tmp_path)
    assert "\n" not in str(refused.value)
    assert not list(tmp_path.iterdir())


def test_time_a_frame_leaves_decoding_out(tmp_path: Path, truth: Trajectory, monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = [0.0]
    process = TrueOdometry.process

    def pass_time(seconds: float) -> None:
        now_s[0] += seconds

    def slow(self: TrueOdometry, *given: object) -> object:
        pass_time(0.003)
        return process(self, *given)  # type: ignore[arg-type]

    monkeypatch.setattr(time, "perf_counter", lambda: now_s[0])
    monkeypatch.setattr(time, "sleep", pass_time)
    monkeypatch.setattr(TrueOdometry, "process", slow)
    run(MemoryRecording(frames_at(truth), truth, decoding_s=0.02), BY_FEATURES, tmp_path)
    timing = metrics_in(tmp_path)["timing"]
    assert timing["frame_median_ms"] == pytest.approx(3)
    assert timing["elapsed_s"] == pytest.approx(20 * (0.02 + 0.003))
    assert timing["throughput_frames_per_s"] == pytest.approx(20 / timing["elapsed_s"])
    assert timing["stages_median_ms"] == pytest.approx({"check": 0.0, "track": 3.0, "decide": 0.0})


def test_on_frame_hears_of_every_frame(tmp_path: Path, truth: Trajectory) -> None:
    heard: list[Status] = []
    recording = MemoryRecording(frames_at(truth, dark=(4,)), truth)
    run(recording, BY_FEATURES, tmp_path, on_frame=lambda frame: heard.append(frame.status))
    assert len(heard) == 20
    assert heard[4] is Status.FAILING


@pytest.mark.parametrize("wanted", [0, 1, 4])
def test_pictures_show_the_two_frames_that_were_matched(tmp_path: Path, truth: Trajectory, wanted: int) -> None:
    config = load_config(overrides={"odometry": "features", "report.pictures": wanted})
    record = run(MemoryRecording(frames_at(truth, dark=(2,)), truth), config, tmp_path)
    assert len(record.pictures) == wanted
    for picture in record.pictures:
        index, reference = (
            int(np.argmin(abs(truth.stamps_s - s))) for s in (picture.stamp_s, picture.reference_stamp_s)
        )
        assert (picture.color == 1 + index).all()
        assert (picture.reference_color == 1 + reference).all()
        assert reference < index
    shown = [picture.stamp_s for picture in record.pictures]
    assert np.ptp(shown) > 0.5 * truth.duration_s if wanted > 1 else True


def test_metrics_are_strict_json(tmp_path: Path, truth: Trajectory) -> None:
    run(MemoryRecording([], truth), BY_FEATURES, tmp_path)
    json.loads((tmp_path / "metrics.json").read_text(), parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))


def test_written_settings_are_the_resolved_ones(tmp_path: Path, truth: Trajectory) -> None:
    seeded = load_config(overrides={"odometry": "features", "features.seed": 11})
    run(MemoryRecording(frames_at(truth), truth), seeded, tmp_path)
    settings = yaml.safe_load((tmp_path / "config.yaml").read_text())
    assert settings["features"]["seed"] == 11
    assert settings["evaluation"] == {"with_scale": False, "max_gap_s": 0.02}


@pytest.mark.usefixtures("real_odometry")
def test_two_runs_with_one_seed_write_the_same_trajectory(tmp_path: Path) -> None:
    make_tum_recording(tmp_path / "room", frames=12)
    for name in ("first", "second"):
        run(open_recording(tmp_path / "room"), BY_FEATURES, tmp_path / name)
    first, second = ((tmp_path / name / "trajectory.txt").read_bytes() for name in ("first", "second"))
    assert first == second
    assert first.count(b"\n") == 2 + 12


@pytest.mark.usefixtures("real_odometry")
def test_the_room_is_followed(tmp_path: Path) -> None:
    make_tum_recording(tmp_path / "room", frames=20)
    record = run(open_recording(tmp_path / "room"), BY_FEATURES, tmp_path / "out")
    assert record.evaluation is not None
    assert record.evaluation.ate.translation.rmse < 0.01
    assert len(record.estimate) == 20
    assert len(record.pictures) == Config().report.pictures
    assert record.stage_seconds


@pytest.mark.usefixtures("real_odometry")
def test_dense_odometry_follows_the_room_too(tmp_path: Path) -> None:
    make_tum_recording(tmp_path / "room", frames=8)
    record = run(open_recording(tmp_path / "room"), load_config(overrides={"odometry": "dense"}), tmp_path / "out")
    assert record.odometry == "dense"
    assert record.evaluation is not None
    assert record.evaluation.ate.translation.rmse < 0.01
    assert len(record.estimate) == 8
    assert record.stage_seconds
    assert record.pictures == ()


def test_ctrl_c_before_the_first_answer_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A trajectory without a pose could not be read again."""

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    make_tum_recording(tmp_path / "room", frames=3)
    monkeypatch.setattr(RunTrack, "step", interrupt)
    with pytest.raises(KeyboardInterrupt):
        run(open_recording(tmp_path / "room"), BY_FEATURES, tmp_path / "out")
    assert list((tmp_path / "out").iterdir()) == []
