from __future__ import annotations

import csv
import errno
import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from room_drive import make_room_drive
from stand_ins import MemoryRecording, TrueOdometry, frame
from synthetic import make_tum_recording, wobbling_trajectory

from wheelsight.calibration import Calibration, Wheels
from wheelsight.config import Config, load_config
from wheelsight.errors import CalibrationError, ConfigError, OutputError, RecordingError
from wheelsight.estimates import Status
from wheelsight.events import Event, SkippedFrame, WheelTicks
from wheelsight.geometry import se3
from wheelsight.odometry.wheels import integrate_log
from wheelsight.pipeline import run, run_each
from wheelsight.recordings import _image_recording, open_recording
from wheelsight.trajectory import Trajectory, read_tum

FILES = {"trajectory.txt", "status.csv", "metrics.json", "config.yaml", "report.html"}


@pytest.fixture
def truth() -> Trajectory:
    return wobbling_trajectory(20)


@pytest.fixture(autouse=True)
def true_odometry(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch, truth: Trajectory) -> None:
    if "real_odometry" not in request.fixturenames:
        TrueOdometry.truth = truth
        monkeypatch.setattr("wheelsight.localizer.FeatureOdometry", TrueOdometry)


@pytest.fixture
def real_odometry() -> None:
    """Asked for by tests that want no stand-in."""


def frames_at(truth: Trajectory, dark: tuple[int, ...] = ()) -> list[Event | BaseException]:
    return [frame(index, stamp_s, dark=index in dark) for index, (stamp_s, _) in enumerate(truth)]


def metrics_in(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "metrics.json").read_text())  # type: ignore[no-any-return]


def status_in(folder: Path) -> list[dict[str, str]]:
    with (folder / "status.csv").open() as stream:
        return list(csv.DictReader(stream))


def test_a_run_leaves_every_file_and_a_true_trajectory(tmp_path: Path, truth: Trajectory) -> None:
    record = run(MemoryRecording(frames_at(truth), truth), Config(), tmp_path / "new" / "out")
    out = tmp_path / "new" / "out"
    assert {path.name for path in out.iterdir()} == FILES
    written = read_tum(out / "trajectory.txt")
    assert [float(row["stamp_s"]) for row in status_in(out)] == written.stamps_s.tolist()
    np.testing.assert_allclose(written.T_world_body, truth.T_world_body, atol=1e-8)
    assert (out / "trajectory.txt").read_text().startswith("# frames: T_world_camera")
    assert record.estimate.covariances is not None
    assert record.estimate.covariances.shape == (20, 6, 6)
    metrics = metrics_in(out)
    assert metrics["frame"] == "T_world_camera"
    assert metrics["evaluation"]["ate_m"]["rmse"] < 1e-9
    assert metrics["evaluation"]["frames_with_pose"] == 1
    assert not metrics["interrupted"]
    assert load_config(out / "config.yaml") == Config()


def test_frames_are_counted_by_what_became_of_them(tmp_path: Path, truth: Trajectory) -> None:
    events = frames_at(truth, dark=(7, 8))
    events[3] = SkippedFrame(truth.stamps_s[3], "depth/3.png: image is cut off", 3)
    events.insert(5, WheelTicks(truth.stamps_s[4] + 0.001, 1, 1))
    run(MemoryRecording(events, truth), Config(), tmp_path)
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
    assert len(read_tum(tmp_path / "trajectory.txt")) == 17


def test_without_ground_truth_the_rest_is_written(tmp_path: Path, truth: Trajectory) -> None:
    record = run(MemoryRecording(frames_at(truth)), Config(), tmp_path)
    assert record.evaluation is None
    assert metrics_in(tmp_path)["evaluation_problem"] == "the recording has no ground truth"
    assert (tmp_path / "report.html").stat().st_size > 0


def test_ground_truth_of_another_time_is_told_not_raised(tmp_path: Path, truth: Trajectory) -> None:
    elsewhen = Trajectory(truth.stamps_s + 1000, truth.T_world_body)
    record = run(MemoryRecording(frames_at(truth), elsewhen), Config(), tmp_path)
    assert record.evaluation is None
    assert "do not overlap in time" in (record.evaluation_problem or "")


def test_a_recording_in_which_nothing_can_be_followed_is_still_reported(tmp_path: Path, truth: Trajectory) -> None:
    record = run(MemoryRecording(frames_at(truth, dark=tuple(range(20))), truth), Config(), tmp_path)
    assert len(record.estimate) == 0
    assert {path.name for path in tmp_path.iterdir()} == FILES
    assert metrics_in(tmp_path)["frames"]["with_pose"] == 0


def test_a_recording_of_one_frame_is_reported(tmp_path: Path, truth: Trajectory) -> None:
    run(MemoryRecording(frames_at(truth)[:1], truth), Config(), tmp_path)
    metrics = metrics_in(tmp_path)
    assert metrics["frames"]["with_pose"] == 1
    assert metrics["timing"]["frame_median_ms"] is None
    assert metrics["timing"]["first_frame_ms"] > 0


def test_results_are_not_overwritten_unless_asked(tmp_path: Path, truth: Trajectory) -> None:
    run(MemoryRecording(frames_at(truth), truth), Config(), tmp_path)
    with pytest.raises(OutputError, match="--force"):
        run(MemoryRecording(frames_at(truth)[:5], truth), Config(), tmp_path)
    assert metrics_in(tmp_path)["frames"]["processed"] == 20
    run(MemoryRecording(frames_at(truth)[:5], truth), Config(), tmp_path, force=True)
    assert metrics_in(tmp_path)["frames"]["processed"] == 5


def test_the_output_is_tried_before_the_long_work(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    untouched = MemoryRecording([AssertionError("frames were read")])
    with pytest.raises(OutputError):
        run(untouched, Config(), tmp_path / "file" / "out")


@pytest.mark.parametrize("stop", [KeyboardInterrupt(), RecordingError("the disk went away", path="depth")])
def test_what_was_tracked_survives_an_interruption(tmp_path: Path, truth: Trajectory, stop: BaseException) -> None:
    recording = MemoryRecording([*frames_at(truth)[:12], stop, *frames_at(truth)[12:]], truth)
    with pytest.raises(type(stop)):
        run(recording, Config(), tmp_path)
    assert recording.was_closed
    assert {path.name for path in tmp_path.iterdir()} == FILES
    assert len(read_tum(tmp_path / "trajectory.txt")) == 12
    metrics = metrics_in(tmp_path)
    assert metrics["interrupted"]
    assert any("after 12 of 20 frames" in warning for warning in metrics["warnings"])


def test_an_error_of_ours_is_not_hidden(tmp_path: Path, truth: Trajectory) -> None:
    with pytest.raises(ZeroDivisionError):
        run(MemoryRecording([*frames_at(truth)[:2], ZeroDivisionError()]), Config(), tmp_path)


def test_a_full_disk_is_one_line(tmp_path: Path, truth: Trajectory, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OutputError, match="no space left on the disk") as refused:
        run(MemoryRecording(frames_at(truth), truth), Config(), tmp_path)
    assert "\n" not in str(refused.value)
    assert not list(tmp_path.iterdir())


def test_time_a_frame_leaves_decoding_out(tmp_path: Path, truth: Trajectory) -> None:
    run(MemoryRecording(frames_at(truth), truth, decoding_s=0.02), Config(), tmp_path)
    timing = metrics_in(tmp_path)["timing"]
    assert timing["frame_median_ms"] < 10
    assert timing["elapsed_s"] >= 20 * 0.02
    assert timing["throughput_frames_per_s"] == pytest.approx(20 / timing["elapsed_s"])
    assert timing["stages_median_ms"] == {"extract": 2.0, "align": 1.0}


def test_on_frame_hears_of_every_frame(tmp_path: Path, truth: Trajectory) -> None:
    heard: list[Status] = []
    recording = MemoryRecording(frames_at(truth, dark=(4,)), truth)
    run(recording, Config(), tmp_path, on_frame=lambda frame: heard.append(frame.status))
    assert len(heard) == 20
    assert heard[4] is Status.FAILING


@pytest.mark.parametrize("wanted", [0, 1, 4])
def test_pictures_show_the_two_frames_that_were_matched(tmp_path: Path, truth: Trajectory, wanted: int) -> None:
    config = load_config(overrides={"report.pictures": wanted})
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
    run(MemoryRecording([], truth), Config(), tmp_path)
    json.loads((tmp_path / "metrics.json").read_text(), parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))


def test_written_settings_are_the_resolved_ones(tmp_path: Path, truth: Trajectory) -> None:
    run(MemoryRecording(frames_at(truth), truth), load_config(overrides={"features.seed": 11}), tmp_path)
    settings = yaml.safe_load((tmp_path / "config.yaml").read_text())
    assert settings["features"]["seed"] == 11
    assert settings["evaluation"] == {"with_scale": False, "max_gap_s": 0.02}


@pytest.mark.usefixtures("real_odometry")
def test_two_runs_with_one_seed_write_the_same_trajectory(tmp_path: Path) -> None:
    make_tum_recording(tmp_path / "room", frames=12)
    for name in ("first", "second"):
        run(open_recording(tmp_path / "room"), Config(), tmp_path / name)
    first, second = ((tmp_path / name / "trajectory.txt").read_bytes() for name in ("first", "second"))
    assert first == second
    assert first.count(b"\n") == 2 + 12


@pytest.mark.usefixtures("real_odometry")
def test_the_room_is_followed(tmp_path: Path) -> None:
    make_tum_recording(tmp_path / "room", frames=20)
    record = run(open_recording(tmp_path / "room"), Config(), tmp_path / "out")
    assert record.evaluation is not None
    assert record.evaluation.ate.translation.rmse < 0.01
    assert len(record.estimate) == 20
    assert len(record.pictures) == Config().report.pictures
    assert record.stage_seconds


WHEELS = Wheels(0.17, 0.17, 0.52, 3200.0)
BY_WHEELS = load_config(overrides={"odometry": "wheels"})


def wheel_recording(readings: int = 300, start_s: float = 0.0, **others: Any) -> MemoryRecording:
    """A drive through a bend, with its truth: the same path."""
    stamps_s = start_s + 0.02 * np.arange(readings)
    left, right = 30 * np.arange(readings), 40 * np.arange(readings)
    events = [WheelTicks(*reading) for reading in zip(stamps_s.tolist(), left.tolist(), right.tolist(), strict=True)]
    truth = integrate_log(WHEELS, stamps_s, left, right).trajectory()
    truth = Trajectory(stamps_s, se3.exp([1, 2, 0, 0, 0, 0.5]) @ truth.T_world_body, body="base")
    return MemoryRecording(events, truth, **{"calibration": Calibration(wheels=WHEELS), **others})


def test_wheels_leave_every_file_too(tmp_path: Path) -> None:
    heard: list[Status] = []
    record = run(wheel_recording(), BY_WHEELS, tmp_path, on_frame=lambda frame: heard.append(frame.status))
    assert {path.name for path in tmp_path.iterdir()} == FILES
    assert heard == [Status.TRACKING] * 300
    written = read_tum(tmp_path / "trajectory.txt")
    assert (written.world, written.body, len(written)) == ("odom", "base", 300)
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
    run(MemoryRecording(events, calibration=both), Config(), tmp_path / "frames")
    assert len(status_in(tmp_path / "wheels")) == len(status_in(tmp_path / "frames")) == 20
    assert "T_odom_base" in (tmp_path / "wheels" / "trajectory.txt").read_text()
    assert "T_world_camera" in (tmp_path / "frames" / "trajectory.txt").read_text()


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
        run(wheel_recording(), Config(), out)
    assert not out.exists()


def test_wheels_that_broke_off_are_kept_until_then(tmp_path: Path) -> None:
    recording = wheel_recording()
    events = [*recording.given[:100], KeyboardInterrupt(), *recording.given[100:]]
    with pytest.raises(KeyboardInterrupt):
        run(MemoryRecording(events, calibration=recording.calibration), BY_WHEELS, tmp_path)
    assert len(read_tum(tmp_path / "trajectory.txt")) == 100
    assert any("after 100 of 300 readings" in warning for warning in metrics_in(tmp_path)["warnings"])


BOTH = load_config(overrides={"odometry": "wheels,features"})
OF_ONE = {"trajectory.txt", "status.csv", "metrics.json"}


def names_in(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def mixed_recording(truth: Trajectory, stop_after: int | None = None) -> MemoryRecording:
    """Frames of a camera that is nowhere on the base, and readings of wheels, in order of time."""
    given = [*frames_at(truth), *wheel_recording(30, start_s=float(truth.stamps_s[0])).given]
    events: list[Event | BaseException] = sorted(given, key=lambda event: event.stamp_s)  # type: ignore[union-attr]
    if stop_after is not None:
        events.insert(stop_after, KeyboardInterrupt())
    return MemoryRecording(events, truth, calibration=replace(MemoryRecording([]).calibration, wheels=WHEELS))


@pytest.mark.usefixtures("real_odometry")
def test_several_odometries_answer_one_pass_as_each_alone_would(tmp_path: Path) -> None:
    make_room_drive(tmp_path / "room")
    passes: list[bool] = []

    class Counted:
        """The recording, and how often its events were asked for."""

        def __init__(self) -> None:
            self.inner = open_recording(tmp_path / "room")

        def __getattr__(self, name: str) -> Any:
            return getattr(self.inner, name)

        def events(self, *, images: bool = True) -> Any:
            passes.append(images)
            return self.inner.events(images=images)

    records = run_each(Counted(), BOTH, tmp_path / "both")  # type: ignore[arg-type]
    assert passes == [True]
    assert [record.odometry for record in records] == ["wheels", "features"]
    assert names_in(tmp_path / "both") == {"wheels", "features", "metrics.json", "config.yaml", "report.html"}
    for record in records:
        assert names_in(tmp_path / "both" / record.odometry) == OF_ONE
        assert (record.estimate.body, record.evaluation is not None) == ("base", True)
        assert record.evaluation.ate.translation.rmse < 0.01  # type: ignore[union-attr]
        alone = BOTH.alone(record.odometry)  # type: ignore[arg-type]
        run(open_recording(tmp_path / "room"), alone, tmp_path / record.odometry)
        together, apart = (
            tmp_path / place / "trajectory.txt" for place in (f"both/{record.odometry}", record.odometry)
        )
        assert together.read_bytes() == apart.read_bytes()
    assert load_config(tmp_path / "both" / "config.yaml") == BOTH


def test_metrics_of_several_are_joined_below_their_names(tmp_path: Path, truth: Trajectory) -> None:
    run_each(mixed_recording(truth), BOTH, tmp_path)
    joint = metrics_in(tmp_path)
    assert list(joint["odometry"]) == ["wheels", "features"]
    assert joint["odometry"]["wheels"]["wheel_readings"]["processed"] == 30
    assert joint["odometry"]["features"]["frames"]["processed"] == 20
    for name, figures in joint["odometry"].items():
        alone = metrics_in(tmp_path / name)
        assert {key: alone[key] for key in ("frame", "trajectory", "evaluation")} == {
            key: figures[key] for key in ("frame", "trajectory", "evaluation")
        }
        assert alone["timing"]["elapsed_s"] == joint["elapsed_s"]


def test_wheels_alone_decode_no_image(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make_room_drive(tmp_path / "room", frames=4)
    recording = open_recording(tmp_path / "room")

    def refuse(path: Path) -> None:
        raise AssertionError(f"{path} was read")

    monkeypatch.setattr(_image_recording, "read_color", refuse)
    assert len(run(recording, BY_WHEELS, tmp_path / "out").estimate) == recording.wheel_count
    with pytest.raises(AssertionError, match="was read"):
        run(recording, BOTH.alone("features"), tmp_path / "features")


def test_what_happens_at_each_event_is_heard(tmp_path: Path, truth: Trajectory) -> None:
    heard: list[str] = []
    run_each(mixed_recording(truth), BOTH, tmp_path, on_event=lambda answers: heard.extend(answers))
    assert (heard.count("wheels"), heard.count("features"), len(heard)) == (30, 20, 50)


def test_several_keep_what_they_had_when_broken_off(tmp_path: Path, truth: Trajectory) -> None:
    with pytest.raises(KeyboardInterrupt):
        run_each(mixed_recording(truth, stop_after=25), BOTH, tmp_path)
    poses = {name: len(read_tum(tmp_path / name / "trajectory.txt")) for name in ("wheels", "features")}
    assert sum(poses.values()) == 25
    joint = metrics_in(tmp_path)
    assert joint["interrupted"]
    for name, unit, listed in (("wheels", "readings", 30), ("features", "frames", 20)):
        broken_off = f"Interrupted by the user after {poses[name]} of {listed} {unit}."
        assert broken_off in joint["odometry"][name]["warnings"]


def test_one_that_cannot_run_leaves_nothing_of_the_others(tmp_path: Path, truth: Trajectory) -> None:
    images_only = MemoryRecording(frames_at(truth), truth, calibration=mixed_recording(truth).calibration)
    with pytest.raises(ConfigError, match=r"no wheel readings .--odometry features"):
        run_each(images_only, BOTH, tmp_path / "out")
    with pytest.raises(ConfigError, match="run_each"):
        run(mixed_recording(truth), BOTH, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_results_of_other_odometries_do_not_stay_beside_those_of_a_new_run(tmp_path: Path, truth: Trajectory) -> None:
    out = tmp_path / "out"
    run_each(mixed_recording(truth), BOTH, out)
    (out / "wheels" / "mine.txt").write_text("keep")
    run_each(mixed_recording(truth), Config(), out, force=True)
    assert names_in(out) == FILES | {"wheels"}
    assert names_in(out / "wheels") == {"mine.txt"}
    run_each(mixed_recording(truth), BOTH, out, force=True)
    assert "trajectory.txt" not in names_in(out)
    assert names_in(out / "wheels") == OF_ONE | {"mine.txt"}


def test_a_folder_that_is_no_run_loses_nothing(tmp_path: Path, truth: Trajectory) -> None:
    (tmp_path / "trajectory.txt").write_text("somebody's own")
    run_each(mixed_recording(truth), BOTH, tmp_path, force=True)
    assert (tmp_path / "trajectory.txt").read_text() == "somebody's own"
