from __future__ import annotations

import csv
import json
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from synthetic import make_tum_recording, wobbling_trajectory
from typer.testing import Result

from wheelsight.core.trajectory import Trajectory, read_tum

Command = Callable[..., Result]


@pytest.mark.usefixtures("drawn_pages")
def test_results_are_written_and_summed_up(wheelsight: Command, room: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    result = wheelsight("run", room, "--out", out)
    assert result.exit_code == 0, result.output
    assert "10 of 10 with a pose (100 %)" in result.stdout
    assert "ATE, position" in result.stdout
    assert "\nverdict: green, Followed in every frame\n" in result.stdout
    assert result.stdout.splitlines()[-1] == f"report: {out / 'report.html'}"
    assert "\x1b" not in result.output
    assert len(read_tum(out / "trajectory.txt")) == 10
    assert (out / "report.html").is_file()


def test_a_trace_shows_each_frame_and_is_not_written_over(wheelsight: Command, room: Path, tmp_path: Path) -> None:
    trace = tmp_path / "trace.json"
    result = wheelsight("run", room, "--out", tmp_path / "out", "--trace", trace)
    assert result.exit_code == 0, result.output
    events = json.loads(trace.read_text())["traceEvents"]
    frames = [event["args"]["stamp_s"] for event in events if event.get("cat") == "frame"]
    assert len(frames) == 10
    assert frames == sorted(frames)
    before = trace.read_bytes()
    again = wheelsight("run", room, "--out", tmp_path / "again", "--trace", trace)
    assert again.exit_code == 2
    assert "is there already (choose another --trace, or add --force to overwrite)" in again.stderr
    assert trace.read_bytes() == before
    assert not (tmp_path / "again").exists()
    elsewhere = wheelsight("run", room, "--out", tmp_path / "again", "--trace", room / "rgb.txt" / "trace.json")
    assert elsewhere.exit_code == 2
    assert "rgb.txt: is a file, not a folder (choose another name)" in elsewhere.stderr


def test_a_terminal_sees_frame_rate_and_status_pass_by(
    wheelsight: Command, room: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TTY_COMPATIBLE", "1")
    monkeypatch.setenv("COLUMNS", "120")
    result = wheelsight("run", room, "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    assert "10/10" in result.stderr
    assert "frames/s" in result.stderr
    assert "tracking" in result.stderr


def test_options_win_over_the_settings_file_and_both_are_written_resolved(
    wheelsight: Command, room: Path, tmp_path: Path
) -> None:
    settings = tmp_path / "settings.yaml"
    settings.write_text("features: {seed: 4, reference: keyframes}\nreport: {pictures: 1}\n")
    options = ("--seed", "5", "--reference", "previous", "--max-gap", "0.004")
    result = wheelsight("run", room, "--out", tmp_path / "out", "--config", settings, *options)
    assert result.exit_code == 0, result.output
    written = yaml.safe_load((tmp_path / "out" / "config.yaml").read_text())
    assert (written["features"]["seed"], written["features"]["reference"]) == (5, "previous")
    assert written["report"]["pictures"] == 1
    assert written["recording"]["max_gap_s"] == 0.004


def test_force_overwrites(wheelsight: Command, room: Path, tmp_path: Path) -> None:
    assert wheelsight("run", room, "--out", tmp_path / "out").exit_code == 0
    assert wheelsight("run", room, "--out", tmp_path / "out").exit_code == 2
    assert wheelsight("run", room, "--out", tmp_path / "out", "--force").exit_code == 0


def test_one_seed_gives_one_trajectory_to_the_byte(wheelsight: Command, room: Path, tmp_path: Path) -> None:
    written = []
    for name in ("first", "second"):
        assert wheelsight("run", room, "--out", tmp_path / name, "--seed", "3").exit_code == 0
        written.append((tmp_path / name / "trajectory.txt").read_bytes())
    assert written[0] == written[1]


def test_damaged_and_absent_images_are_skipped_and_counted(wheelsight: Command, room: Path, tmp_path: Path) -> None:
    depth, color = (sorted((room / name).iterdir()) for name in ("depth", "rgb"))
    depth[3].write_bytes(depth[3].read_bytes()[:2000])
    color[6].unlink()
    result = wheelsight("run", room, "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    assert "1 × depth image is cut off" in result.stdout
    assert "1 × listed colour image is absent" in result.stdout
    frames = json.loads((tmp_path / "out" / "metrics.json").read_text())["frames"]
    assert (frames["skipped"], frames["with_pose"]) == (2, 8)


@pytest.mark.slow
@pytest.mark.usefixtures("drawn_pages")
def test_dropped_frames_are_one_number_everywhere(wheelsight: Command, room: Path, tmp_path: Path) -> None:
    depth = sorted((room / "depth").iterdir())
    depth[3].write_bytes(depth[3].read_bytes()[:2000])
    lines = (room / "depth.txt").read_text().splitlines()
    stamp_s, path = lines[-1].split()
    (room / "depth.txt").write_text("\n".join([*lines[:-1], f"{float(stamp_s) + 0.4:.6f} {path}"]) + "\n")
    said = "2 of 10 frames dropped (20 %): 1 without a partner, 1 unreadable"
    assert re.search(rf"^dropped +{re.escape(said)} *$", wheelsight("info", room).stdout, re.MULTILINE)
    informed = json.loads(wheelsight("info", room, "--json").stdout)["dropped"]
    result = wheelsight("run", room, "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())
    with (tmp_path / "out" / "status.csv").open() as stream:
        rows = sum(int(row["dropped"]) for row in csv.DictReader(stream))
    assert metrics["frames"]["dropped"] == informed
    assert (informed["total"], rows) == (2, 2)
    assert re.search(rf"^dropped +{re.escape(said)} *$", result.stdout, re.MULTILINE)
    assert metrics["verdict"]["tone"] == "amber"
    assert f"  amber {said}. To do: " in result.stdout
    assert f"{said}. <b>To do:</b>" in (tmp_path / "out" / "report.html").read_text()


def test_windows_line_ends_and_comments_are_no_matter(wheelsight: Command, room: Path, tmp_path: Path) -> None:
    for path in room.glob("*.txt"):
        text = "# first\n" + path.read_text().replace("\n", "\n# between\n", 3)
        path.write_bytes(text.replace("\n", "\r\n").encode())
    result = wheelsight("run", room, "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    assert "10 of 10 with a pose" in result.stdout


def test_truth_that_covers_a_part_is_evaluated_there_and_said_so(
    wheelsight: Command, room: Path, tmp_path: Path
) -> None:
    path = room / "groundtruth.txt"
    path.write_text("\n".join(path.read_text().splitlines()[:7]) + "\n")
    result = wheelsight("run", room, "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    assert "warning: The ground truth covers 5 of 10 frames" in result.stderr
    assert "5 pairs of poses" in result.stdout


def test_one_frame_is_a_recording(wheelsight: Command, tmp_path: Path) -> None:
    make_tum_recording(tmp_path / "room", frames=1)
    result = wheelsight("run", tmp_path / "room", "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    assert "1 of 1 with a pose" in result.stdout
    assert "not evaluated" in result.stdout


def test_a_blank_wall_gives_no_pose_and_says_why(wheelsight: Command, tmp_path: Path) -> None:
    make_tum_recording(tmp_path / "room", frames=6, blank=range(6))
    result = wheelsight("run", tmp_path / "room", "--odometry", "features", "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    assert "0 of 6 with a pose" in result.stdout
    assert "6 × too few keypoints" in result.stdout
    assert "verdict: red, Do not rely on it: no pose was found" in result.stdout
    assert "(6). To do: give it more light" in result.stdout


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["dark", "covered"])
def test_a_blackout_of_two_seconds_is_lost_and_found_again(wheelsight: Command, tmp_path: Path, kind: str) -> None:
    away = range(10, 70)
    there_and_back = wobbling_trajectory(80)
    T = there_and_back.T_frame_body.copy()
    T[70:] = T[9::-1]  # what is seen after the blackout was seen before it
    stamps_s = there_and_back.stamps_s
    how: dict[str, Any] = {kind: away}
    make_tum_recording(tmp_path / "room", trajectory=Trajectory(stamps_s, T), **how)
    # Dense odometry goes on by depth in the dark.
    result = wheelsight("run", tmp_path / "room", "--odometry", "features", "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    assert re.search(r"^lost +once, for 1\.\d+ s in all", result.stdout, re.MULTILINE)
    with (tmp_path / "out" / "status.csv").open() as stream:
        status = [row["status"] for row in csv.DictReader(stream)]
    assert status[9] == "tracking"
    assert set(status[10:70]) == {"failing", "lost"}
    assert status[69] == "lost"
    assert status[79] == "tracking"
    estimate = read_tum(tmp_path / "out" / "trajectory.txt")
    invented = (estimate.stamps_s > stamps_s[9] + 1e-3) & (estimate.stamps_s < stamps_s[70] - 1e-3)
    assert not invented.any()
    assert json.loads((tmp_path / "out" / "metrics.json").read_text())["evaluation"]["ate_m"]["max"] < 0.02


@pytest.mark.slow
def test_ctrl_c_keeps_what_was_found(tmp_path: Path) -> None:
    make_tum_recording(tmp_path / "room", frames=20)
    out = tmp_path / "out"
    code = (
        "import os, signal\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"  # ignored where tests run in the background
        "from wheelsight.estimation import localizer\n"
        "process, seen = localizer.Localizer.process, []\n"
        "def counted(self, event):\n"
        "    seen.append(event)\n"
        "    if len(seen) == 6:\n"
        "        os.kill(os.getpid(), signal.SIGINT)\n"
        "    return process(self, event)\n"
        "localizer.Localizer.process = counted\n"
        "from wheelsight.app.cli import main\n"
        "main()\n"
    )
    answer = subprocess.run(
        [sys.executable, "-c", code, "run", str(tmp_path / "room"), "--out", str(out)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert answer.returncode == 130, answer.stderr
    assert answer.stderr.splitlines()[-1] == f"interrupted; what was found until then is in {out}"
    assert "Traceback" not in answer.stderr
    metrics = json.loads((out / "metrics.json").read_text())
    assert metrics["interrupted"]
    assert 5 <= metrics["frames"]["processed"] < 10
    assert len(read_tum(out / "trajectory.txt")) == metrics["frames"]["with_pose"]
