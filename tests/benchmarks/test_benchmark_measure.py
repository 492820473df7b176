"""Measuring: fresh processes, the same frames, figures that mean what they say."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from benchmarks.contenders import Contender, opencv_odometry
from benchmarks.measure import Feed, Passage, measure, peak_memory_mb, there_and_back
from benchmarks.run import child_environment, figures_of, run
from benchmarks.sequences import Sequence, find_sequences
from benchmarks.startup import measure_startup
from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import RecordingError
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.messages import RgbdFrame
from wheelsight.core.trajectory import Trajectory, write_tum
from wheelsight.io.recordings import open_recording


class Still:
    """Always at the origin, but lost where the frame's index is 3."""

    def __init__(self, calibration: Calibration) -> None:
        self.prepared: list[int] = []

    def prepare(self, frame: RgbdFrame) -> int:
        self.prepared.append(frame.index)
        return frame.index

    def track(self, prepared: int) -> FloatArray | None:
        return None if prepared == 3 else np.eye(4)


@pytest.mark.parametrize("feed", list(Feed))
def test_every_frame_is_timed_and_lost_ones_have_no_pose(bench_data: Path, feed: Feed) -> None:
    recording = open_recording(bench_data / "rgbd" / "room")
    passage, trajectory = measure(Still, recording, feed, limit=6)
    assert len(passage.stamps_s) == len(passage.seconds) == 6
    assert min(passage.seconds) >= 0
    np.testing.assert_allclose(trajectory.stamps_s, np.delete(passage.stamps_s, 3))


@pytest.mark.slow
def test_a_run_measures_a_contender_in_its_own_processes(bench_data: Path) -> None:
    (sequence,) = find_sequences(bench_data)
    figures = run(opencv_odometry.RGB_DEPTH, sequence, limit=7).figures
    assert figures is not None
    assert (figures.frames, figures.with_pose, figures.differing_poses) == (7, 7, 0)
    assert figures.accuracy.ate_m is not None
    assert figures.accuracy.ate_m < 0.005
    assert 0 < figures.median_ms <= figures.p95_ms
    assert figures.peak_memory_mb is not None
    assert 20 < figures.peak_memory_mb < 2000


def test_one_feed_on_one_thread_leaves_the_other_feeds_figures_open(bench_data: Path) -> None:
    (sequence,) = find_sequences(bench_data)
    figures = run(opencv_odometry.RGB_DEPTH, sequence, limit=3, threads=1, feeds=(Feed.DECODED,)).figures
    assert figures is not None
    assert figures.mean_ms > 0
    assert (figures.streamed_ms, figures.peak_memory_mb, figures.differing_poses) == (None, None, None)


def test_there_and_back_shows_every_frame_twice_in_order_of_time(bench_data: Path) -> None:
    recording = open_recording(bench_data / "rgbd" / "room")
    frames = [event for event in there_and_back(recording).events() if isinstance(event, RgbdFrame)]
    count = recording.frame_count
    assert len(frames) == 2 * count
    assert (np.diff([frame.stamp_s for frame in frames]) > 0.01).all()
    for k in range(count):
        np.testing.assert_array_equal(frames[k].depth_m, frames[-1 - k].depth_m)
    passage, _ = measure(Still, there_and_back(recording), Feed.STREAMED)
    assert len(passage.seconds) == 2 * count


def test_a_contender_that_fails_says_why_in_one_line(bench_data: Path) -> None:
    (sequence,) = find_sequences(bench_data)
    result = run(Contender("nobody", Still, "unknown to the registry"), sequence)
    assert result.figures is None
    assert result.problem == "KeyError: 'nobody'"


def leave_passage(folder: Path, T_odom_camera: FloatArray, seconds: list[float]) -> Path:
    folder.mkdir()
    stamps_s = np.arange(len(seconds)) / 10
    write_tum(Trajectory(stamps_s[: len(T_odom_camera)], T_odom_camera), folder / "trajectory.txt")
    (folder / "passage.json").write_text(json.dumps(asdict(Passage(stamps_s.tolist(), seconds, 123.0))))
    return folder


def test_figures_tell_poses_that_differ_and_frames_without_one(tmp_path: Path) -> None:
    positions_m = np.column_stack([np.linspace(0, 3, 21), np.sin(np.arange(21)), np.zeros(21)])
    T = se3.from_parts(np.broadcast_to(np.eye(3), (21, 3, 3)), positions_m)
    moved = T.copy()
    moved[5, 0, 3] += 1e-6
    first = leave_passage(tmp_path / "first", T[:20], [0.001] * 18 + [0.011] * 3)
    second = leave_passage(tmp_path / "second", moved, [0.002] * 21)
    figures = figures_of(Sequence("made", tmp_path, Trajectory(np.arange(21) / 10, T)), first, second)
    assert (figures.frames, figures.with_pose) == (21, 20)
    assert figures.differing_poses == 2  # the moved one, and the one that only the second has
    assert (figures.median_ms, figures.streamed_ms) == pytest.approx((1.0, 2.0))
    assert figures.p95_ms == pytest.approx(11.0)
    assert figures.accuracy.ate_m == pytest.approx(0, abs=1e-8)
    assert figures.accuracy.rpe_m == pytest.approx(0, abs=1e-8)


def test_without_any_pose_there_is_no_accuracy(tmp_path: Path) -> None:
    nothing = np.empty((0, 4, 4))
    folders = [leave_passage(tmp_path / name, nothing, [0.001] * 3) for name in ("first", "second")]
    figures = figures_of(Sequence("made", tmp_path, None), *folders)
    assert (figures.with_pose, figures.accuracy.ate_m, figures.differing_poses) == (0, None, 0)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="peak memory is read the POSIX way")
def test_peak_memory_grows_with_what_is_held() -> None:
    before = peak_memory_mb()
    held = np.ones(int(before * 1e6 / 8) + 10_000_000)
    assert peak_memory_mb() > before + held.nbytes / 2e6


def test_all_libraries_are_held_to_two_threads() -> None:
    environment = child_environment()
    assert {environment[f"{name}_NUM_THREADS"] for name in ("OMP", "NUMBA", "OPENBLAS", "MKL")} == {"2"}
    assert child_environment(1)["OMP_NUM_THREADS"] == "1"


def test_startup_is_measured_from_outside() -> None:
    startup = measure_startup(repeats=1)
    assert 0 < startup.bare_s < 5
    assert startup.import_alone_s == startup.import_s - startup.bare_s


def test_a_folder_without_recordings_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="holds no recordings"):
        find_sequences(tmp_path)


def test_the_truth_is_the_cameras(bench_data: Path) -> None:
    (sequence,) = find_sequences(bench_data)
    assert sequence.truth is not None
    assert sequence.truth.body == "camera"
    assert sequence.accuracy(sequence.truth).ate_m == pytest.approx(0, abs=1e-8)
