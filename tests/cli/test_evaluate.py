from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from room_drive import make_room_drive
from synthetic import wobbling_trajectory
from typer.testing import Result

from wheelsight.core.trajectory import Trajectory, read_tum, write_tum

Command = Callable[..., Result]


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path]:
    """An estimate 1 % too large, and the truth."""
    truth = wobbling_trajectory(90)
    T = truth.T_frame_body.copy()
    T[:, :3, 3] *= 1.01
    write_tum(Trajectory(truth.stamps_s, T), tmp_path / "estimate.txt")
    write_tum(truth, tmp_path / "truth.txt")
    return tmp_path / "estimate.txt", tmp_path / "truth.txt"


def test_the_table_shows_all_errors(wheelsight: Command, files: tuple[Path, Path]) -> None:
    result = wheelsight("evaluate", *files)
    assert result.exit_code == 0
    for name in ("ATE, position", "RPE a frame, rotation", "RPE a second, position", "RMSE", "median"):
        assert name in result.stdout
    assert "90 pairs of poses; 100 % of the truth's time covered" in result.stdout
    assert "\x1b" not in result.stdout


def test_json_holds_figures_with_units(wheelsight: Command, files: tuple[Path, Path]) -> None:
    figures = json.loads(wheelsight("evaluate", *files, "--json").stdout)
    assert 0 < figures["ate_m"]["rmse"] < 0.01
    assert figures["scale"] is None
    assert figures["frame"] == "T_map_camera"


def test_the_frame_is_reported_and_what_headers_leave_out_can_be_said(
    wheelsight: Command, refusal: Callable[..., str], files: tuple[Path, Path]
) -> None:
    estimate, truth = files
    assert "T_map_camera: 90 pairs" in wheelsight("evaluate", *files).stdout
    estimate.write_text(estimate.read_text().replace("T_map_camera", "T_map_base"))
    assert "move differently" in refusal("evaluate", *files)
    truth.write_text("\n".join(line for line in truth.read_text().splitlines() if not line.startswith("#")))
    assert "move differently" in refusal("evaluate", *files)
    assert "T_map_base: 90 pairs" in wheelsight("evaluate", *files, "--body", "base").stdout


def test_scale_is_fitted_when_asked(wheelsight: Command, files: tuple[Path, Path]) -> None:
    figures = json.loads(wheelsight("evaluate", *files, "--json", "--scale").stdout)
    assert figures["scale"] == pytest.approx(1 / 1.01)
    assert figures["ate_m"]["rmse"] < 1e-6
    assert "estimate scaled by 0.9901" in wheelsight("evaluate", *files, "--scale").stdout


def test_max_gap_decides_what_is_compared(wheelsight: Command, files: tuple[Path, Path]) -> None:
    estimate, truth = files
    shifted = wobbling_trajectory(90)
    write_tum(Trajectory(shifted.stamps_s + 0.012, shifted.T_frame_body), estimate)
    assert json.loads(wheelsight("evaluate", estimate, truth, "--json").stdout)["pairs"] == 90
    result = wheelsight("evaluate", estimate, truth, "--max-gap", "0.005")
    assert result.exit_code == 2
    assert "within 0.005 s of a true one" in result.stderr


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("1 0 0 0 0 0 0 2", ":3: quaternion has length 2, not 1 ("),
        ("1 nan 0 0 0 0 0 1", ":3: a value is not finite ("),
        ("1 0 0 0 0 0 1", ":3: 7 values where 8 are expected (stamp tx ty tz qx qy qz qw a line)"),
        ("0.5 0 0 0 0 0 0 1", ":3: stamp 0.500000"),
    ],
)
def test_a_wrong_line_is_named(refusal: Callable[..., str], tmp_path: Path, line: str, expected: str) -> None:
    path = tmp_path / "wrong.txt"
    path.write_text(f"# a comment\n1.0 0 0 0 0 0 0 1\n{line}\n")
    if line.startswith("1 "):
        path.write_text(path.read_text().replace("\n1 ", "\n2 "))
    assert refusal("evaluate", path, path).startswith(f"{path}{expected}")


def test_comments_and_windows_line_ends_are_no_matter(wheelsight: Command, files: tuple[Path, Path]) -> None:
    estimate, truth = files
    text = "# written elsewhere\n" + estimate.read_text().replace("\n", " # so\n")
    estimate.write_bytes(text.replace("\n", "\r\n").encode())
    assert json.loads(wheelsight("evaluate", estimate, truth, "--json").stdout)["pairs"] == 90


def test_trajectories_of_different_times_are_refused(refusal: Callable[..., str], files: tuple[Path, Path]) -> None:
    estimate, truth = files
    later = wobbling_trajectory(90, start_s=500.0)
    write_tum(later, estimate)
    assert "they do not overlap in time" in refusal("evaluate", estimate, truth)


def test_a_missing_file_is_named(refusal: Callable[..., str], files: tuple[Path, Path]) -> None:
    missing = files[0].with_name("none.txt")
    assert refusal("evaluate", missing, files[1]) == f"{missing}: cannot be read: No such file or directory"


def test_a_folder_is_no_trajectory_but_may_hold_it(refusal: Callable[..., str], files: tuple[Path, Path]) -> None:
    estimate, truth = files
    folder = estimate.parent
    assert refusal("evaluate", folder, truth) == f"{folder}: is a folder, not a file (give the file)"
    truth.rename(folder / "groundtruth.txt")
    reported = refusal("evaluate", estimate, folder)
    assert reported == f"{folder}: is a folder, not a file (did you mean {folder / 'groundtruth.txt'}?)"


def test_doubts_are_reported_after_the_table_and_in_json(wheelsight: Command, files: tuple[Path, Path]) -> None:
    estimate, truth = files
    sound = read_tum(truth)
    for path, scale in ((estimate, 1.0), (truth, 1e3)):
        write_tum(Trajectory(scale * (sound.stamps_s - sound.stamps_s[0]), sound.T_frame_body), path)
    result = wheelsight("evaluate", estimate, truth, "--max-gap", "100")
    assert result.exit_code == 0, result.output
    assert "look like milliseconds" in " ".join(result.stderr.split())
    (reported, few) = json.loads(wheelsight("evaluate", estimate, truth, "--max-gap", "100", "--json").stdout)[
        "warnings"
    ]
    assert "look like milliseconds" in reported
    assert few.startswith("Only ")


def test_the_truth_of_the_estimates_body_is_taken_where_it_lies_beside(
    wheelsight: Command, refusal: Callable[..., str], files: tuple[Path, Path]
) -> None:
    estimate, truth = files
    of_base = estimate.read_text().replace("T_map_camera", "T_map_base")
    estimate.write_text(of_base)
    truth = truth.rename(truth.with_name("groundtruth.txt"))
    assert "move differently" in refusal("evaluate", estimate, truth)
    truth.with_name("groundtruth_base.txt").write_text(of_base)
    result = wheelsight("evaluate", estimate, truth)
    assert result.exit_code == 0, result.output
    assert "T_map_base: 90 pairs" in result.stdout
    assert "groundtruth_base.txt beside it, of the base, is taken" in result.stderr


def test_the_truth_of_the_body_that_was_estimated_is_taken(wheelsight: Callable[..., Result], tmp_path: Path) -> None:
    """A run shows the base, a recording's groundtruth.txt of the camera: groundtruth_base.txt lies beside it."""
    make_room_drive(tmp_path / "drive", frames=8)
    beside = tmp_path / "drive" / "groundtruth_base.txt"
    result = wheelsight("evaluate", beside, tmp_path / "drive" / "groundtruth.txt")
    assert result.exit_code == 0, result.output
    assert "groundtruth_base.txt beside it, of the base, is taken" in result.stderr
    positions = result.stdout.partition("[°]")[0]
    assert positions.count("[m]") == 4
    assert positions.count(" 0.0000") == 12  # of 4 rows of positions, the last too short for a metre
    beside.rename(tmp_path / "elsewhere.txt")
    assert wheelsight("evaluate", tmp_path / "elsewhere.txt", tmp_path / "drive" / "groundtruth.txt").exit_code == 2


@pytest.mark.parametrize("encoding", ["ascii", pytest.param("cp1252", marks=pytest.mark.slow)])
def test_any_encoding_takes_the_output(encoding: str, files: tuple[Path, Path], project_folder: Path) -> None:
    truth = str(files[1])
    environment = {**os.environ, "PYTHONIOENCODING": encoding, "PYTHONPATH": str(project_folder)}
    command = [sys.executable, "-m", "wheelsight", "evaluate", truth, truth]
    answer = subprocess.run(command, env=environment, capture_output=True, check=False)
    assert answer.returncode == 0, answer.stderr
    assert "ATE, rotation" in answer.stdout.decode(encoding)
    wrong = subprocess.run([*command[:-1], "σ→missing.txt"], env=environment, capture_output=True, check=False)
    assert wrong.returncode == 2
    reported = wrong.stderr.decode(encoding)
    assert reported.startswith("error: σ→missing.txt" if encoding == "utf-8" else "error: sigma->missing.txt")
