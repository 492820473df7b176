"""The paper's script: its table, its figures, its errors."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import cv2
import numpy as np
import pytest
from matplotlib.text import Text
from synthetic import make_tum_recording

from wheelsight.core.geometry import se3
from wheelsight.core.trajectory import Trajectory, read_tum, write_tum

pytest.importorskip("matplotlib", reason="the papers' scripts need the extra 'papers'")


@pytest.fixture(scope="module")
def zhang_hsr(project_folder: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location("zhang_hsr", project_folder / "papers" / "zhang_hsr.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path]:
    """A ground-truth file of a loop with a gap in it, and an estimate that drifts."""
    stamps_s = np.concatenate([np.arange(0, 6, 0.02), np.arange(8, 12, 0.02)])
    phase = 2 * np.pi * stamps_s / 12
    xi = np.stack([np.cos(phase), 0.7 * np.sin(phase), 0.1 * phase, *np.zeros((2, len(phase))), phase / 4], axis=1)
    truth = Trajectory(stamps_s, se3.exp(xi))
    drift = se3.exp(np.cumsum(np.random.default_rng(0).normal(0, 0.003, (len(xi), 6)), axis=0))
    write_tum(truth, tmp_path / "loop-groundtruth.txt")
    write_tum(Trajectory(stamps_s, truth.T_frame_body @ drift), tmp_path / "estimate.txt")
    return tmp_path / "loop-groundtruth.txt", tmp_path / "estimate.txt"


def colours(path: Path) -> set[tuple[int, ...]]:
    image = cv2.imread(str(path))
    assert image is not None
    assert min(image.shape[:2]) > 600
    return set(map(tuple, image.reshape(-1, 3)[:, ::-1].tolist()))


@pytest.mark.slow
def test_prints_the_table_and_draws_both_figures(
    zhang_hsr: ModuleType, files: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    truth, estimate = files
    out = tmp_path / "figures"
    assert zhang_hsr.main([str(truth), "--estimate", str(estimate), "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "Table 2: loop\n" in printed
    assert "Zhang" not in printed
    assert f"{read_tum(truth).length_m:.3f} m" in printed
    assert "Errors of 500 poses" in printed
    assert len(colours(out / "ground_truth.png")) > 100
    drawn = colours(out / "absolute_error.png")
    for colour in (zhang_hsr.INK, zhang_hsr.BLUE, zhang_hsr.RED):
        assert tuple(bytes.fromhex(colour[1:])) in drawn


def test_a_ground_truth_file_alone_gives_one_figure(
    zhang_hsr: ModuleType, files: tuple[Path, Path], tmp_path: Path
) -> None:
    assert zhang_hsr.main([str(files[0]), "--out", str(tmp_path / "figures")]) == 0
    assert [path.name for path in (tmp_path / "figures").iterdir()] == ["ground_truth.png"]


@pytest.mark.slow
def test_a_recording_is_tracked_where_no_estimate_is_given(
    zhang_hsr: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    make_tum_recording(tmp_path / "room", frames=12)
    out = tmp_path / "figures"
    assert zhang_hsr.main([str(tmp_path / "room"), "--out", str(out)]) == 0
    assert "Errors of 12 poses" in capsys.readouterr().out
    assert {path.name for path in out.iterdir()} == {"ground_truth.png", "absolute_error.png", "run"}
    assert (out / "run" / "report.html").is_file()


def test_of_the_papers_sequence_all_stand_beside_published_systems(
    zhang_hsr: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    make_tum_recording(tmp_path / "rgbd_dataset_freiburg1_desk", frames=6)
    out = tmp_path / "figures"
    assert zhang_hsr.main([str(tmp_path / "rgbd_dataset_freiburg1_desk"), "--out", str(out)]) == 0
    rows = [line.split() for line in capsys.readouterr().out.split("others have published\n")[1].splitlines()[1:8]]
    assert [row[-1] for row in rows[:3]] == ["6"] * 3
    assert [" ".join(row[:-3]) for row in rows[:3]] == ["features", "dense", "dense with surfels"]
    assert all(0 < float(row[-3]) < 0.01 for row in rows[:3])
    assert rows[3] == ["ORB-SLAM2,", "published", "0.0160", "m"]
    assert {path.name for path in (out / "run").iterdir()} >= {"report.html", "dense", "dense_with_surfels"}


def test_lines_break_where_nothing_is_known(zhang_hsr: ModuleType) -> None:
    broken = zhang_hsr.broken_at_gaps(np.array([0.0, 0.1, 3.0, 3.1]), np.arange(8.0).reshape(4, 2))
    assert np.isnan(broken[:, 0]).tolist() == [False, False, True, False, False]


def test_a_robot_that_stood_still_can_be_drawn(zhang_hsr: ModuleType, tmp_path: Path) -> None:
    write_tum(Trajectory(np.arange(30) / 10, np.tile(np.eye(4), (30, 1, 1))), tmp_path / "still.txt")
    assert zhang_hsr.main([str(tmp_path / "still.txt"), "--out", str(tmp_path / "figures")]) == 0


def test_the_title_of_a_tall_path_is_not_cut(zhang_hsr: ModuleType) -> None:
    T = np.tile(np.eye(4), (50, 1, 1))
    T[:, 2, 3] = np.linspace(0, 3, 50)
    figure = zhang_hsr.ground_truth_figure(Trajectory(np.arange(50) / 10, T), "a_sequence_of_a_usual_name")
    figure.draw_without_rendering()
    words = figure.axes[0].get_title(loc="left")
    (title,) = [text.get_window_extent() for text in figure.findobj(Text) if text.get_text() == words]
    assert figure.bbox.x0 <= title.x0
    assert title.x1 <= figure.bbox.x1


def test_errors_are_one_line_and_code_2(
    zhang_hsr: ModuleType, files: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "empty").mkdir()
    other = tmp_path / "other_time.txt"
    other.write_text("".join(f"{k} {k} 0 0 0 0 0 1\n" for k in range(900, 905)))
    for arguments, says in (
        ([str(tmp_path / "absent.txt")], "absent.txt: cannot be read: No such file or directory"),
        ([str(tmp_path / "empty")], "has no groundtruth.txt (give a TUM folder or a ground-truth file)"),
        ([str(files[0]), "--out", str(tmp_path)], "is not empty"),
        ([str(files[0]), "--estimate", str(other), "--out", str(tmp_path / "o")], "do not overlap in time"),
    ):
        assert zhang_hsr.main(arguments) == 2
        error = capsys.readouterr().err
        assert says in error
        assert error.count("\n") == 1


@pytest.mark.data
def test_freiburg1_desk_stands_beside_the_papers_figures(
    zhang_hsr: ModuleType, data_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    truth = data_folder / "trajectories" / "tum_ground_truth" / "freiburg1_desk.txt"
    assert zhang_hsr.main([str(truth), "--out", str(tmp_path / "figures")]) == 0
    rows = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["Avg.", "angular", "velocity", "23.327", "°/s", "23.327", "°/s"] in rows
    assert ["Avg.", "translational", "velocity", "0.413", "m/s", "0.413", "m/s"] in rows
    assert ["Duration", "with", "ground", "truth", "23.35", "s", "23.35", "s"] in rows
