"""Runs that close loops: by matches from outside, and by what the camera sees again."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from pipeline.made import FILES, metrics_in, names_in, wheel_recording
from room_drive import make_room_drive

from wheelsight.app.runs import run
from wheelsight.config import load_config
from wheelsight.core.errors import ConfigError
from wheelsight.core.trajectory import read_tum
from wheelsight.io.recordings import OpenOptions, open_recording
from wheelsight_report import sections as loop_figures

BY_MATCHES = load_config(overrides={"odometry": "wheels", "loops.source": "matches"})


def around(folder: Path, laps: int = 3, bias_rad_s: float = 0.01) -> Path:
    """Speeds on a circle with a bias, each fourth second matched with a round before, and as many wrong matches."""
    round_s, rng = 40.0, np.random.default_rng(1)
    stamps_s = np.arange(0, laps * round_s, 0.1)
    rate = 2 * np.pi / round_s
    lines = [f"odom2 {t:.2f} 1.0 0 {rate + bias_rad_s:.6f} 0.0025 0.0025 0.0025" for t in stamps_s]
    for t in np.arange(round_s + 2, laps * round_s - 1, 4):
        lines.append(f"loop {t:.2f} {t - round_s:.2f} 0.9")
        lines.append(f"loop {t:.2f} {t - round_s * rng.uniform(0.35, 0.65):.2f} 0.7")
        lines.append(f"loop {t:.2f} 0.0 0.1")
    radius_m = 1.0 / rate
    truth = [
        f"point2 {t:.2f} {radius_m * np.sin(rate * t):.6f} {radius_m * (1 - np.cos(rate * t)):.6f} 0 0 0 0\n"
        f"angle {t:.2f} {rate * t:.6f} 0"
        for t in stamps_s
    ]
    folder.mkdir()
    (folder / "A_Input.txt").write_text("\n".join(lines) + "\n")
    (folder / "A_GT.txt").write_text("\n".join(truth) + "\n")
    return folder


def test_a_run_leaves_both_ways_and_says_what_became_of_matches(tmp_path: Path) -> None:
    recording = open_recording(around(tmp_path / "drive"), OpenOptions())
    out = tmp_path / "out"
    record = run(recording, BY_MATCHES, out)
    assert names_in(out) == FILES | {"trajectory_corrected.txt", "loops_judged.csv"}
    lived, corrected = read_tum(out / "trajectory.txt"), read_tum(out / "trajectory_corrected.txt")
    assert (lived.frame, corrected.frame, len(lived), len(corrected)) == ("odom", "map", len(lived), len(lived))
    loops = metrics_in(out)["loops"]
    before = metrics_in(out)["evaluation"]["ate_m"]["rmse"]
    assert loops["evaluation"]["ate_m"]["rmse"] < 0.5 * before
    with (out / "loops_judged.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    kept = [float(row["stamp_b_s"]) - float(row["stamp_a_s"]) for row in rows if row["kept"] == "1"]
    assert all(abs(abs(gap_s) - 40.0) < 0.2 for gap_s in kept)
    assert (len(kept), len(rows)) == (loops["kept"], loops["kept"] + loops["refused"])
    assert loops["matches"] == 3 * len(rows) / 2
    assert loops["not_judged"] == {"its score is low": len(rows) / 2}
    assert record.correction is not None
    page = loop_figures.loop_section(record)
    assert all(part in page for part in ("as lived", "as known at the end", record.correction.sentence))
    ways = {trace.name for trace in loop_figures.loops_figure(record).data}
    assert {"ground truth", f"kept: {loops['kept']}", f"refused: {loops['refused']}"} <= ways
    run(recording, load_config(overrides={"odometry": "wheels"}), out, force=True)
    assert names_in(out) == FILES


def test_matches_may_be_a_file_of_ones_own(tmp_path: Path) -> None:
    path = tmp_path / "mine.csv"
    path.write_text("stamp_a_s,stamp_b_s\n2,42\n6,46\n10,50\n")
    recording = open_recording(around(tmp_path / "drive"), OpenOptions())
    config = load_config(overrides={"odometry": "wheels", "loops.source": str(path)})
    record = run(recording, config, tmp_path / "out")
    assert record.correction is not None
    assert record.correction.matches == 3


def test_no_matches_are_said_before_anything_is_written(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"no matches \(write loops\.csv"):
        run(wheel_recording(), BY_MATCHES, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_keyframes_need_a_camera(tmp_path: Path) -> None:
    config = load_config(overrides={"odometry": "wheels", "loops.source": "keyframes"})
    with pytest.raises(ConfigError, match="--loops keyframes needs a camera"):
        run(wheel_recording(), config, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_name_that_is_no_choice_and_no_file_is_refused(tmp_path: Path) -> None:
    config = load_config(overrides={"odometry": "wheels", "loops.source": "keyframe"})
    with pytest.raises(ConfigError, match=r"no such file \(keyframes, matches, none, or a file"):
        run(wheel_recording(), config, tmp_path / "out")


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("loops") / "room"
    make_room_drive(folder, frames=16)
    return folder


def test_loops_of_a_camera_are_closed_on_the_way_and_reported(room: Path, tmp_path: Path) -> None:
    overrides = {"odometry": "dense", "dense.keyframe_way_m": 0.05}
    loops = {"loops.source": "keyframes", "loops.apart_s": 0.3, "loops.latency_s": 0.2}
    out = tmp_path / "out"
    record = run(open_recording(room), load_config(overrides=overrides | loops), out)
    assert names_in(out) == FILES | {"trajectory_corrected.txt", "loops_judged.csv"}
    reported = metrics_in(out)["loops"]
    assert reported["kept"] > 0
    assert reported["not_compared"] == 0
    assert reported["evaluation"]["ate_m"]["rmse"] < 0.02
    with (out / "loops_judged.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == reported["matches"]
    assert all(float(row["stamp_b_s"]) - float(row["stamp_a_s"]) >= 0.3 for row in rows)
    assert record.correction is not None
    assert "as known at the end" in loop_figures.loop_section(record)
    # The same recording gives the same bytes, whatever the thread's pace was.
    run(open_recording(room), load_config(overrides=overrides | loops), tmp_path / "again")
    for name in ("trajectory.txt", "trajectory_corrected.txt", "loops_judged.csv"):
        assert (out / name).read_bytes() == (tmp_path / "again" / name).read_bytes()
