"""`wheelsight board`, `calibrate camera` and `calibrate robot`: from a printed board to a robot's file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from browser import open_page
from camera_calibration.drawn_boards import pose, write_views
from drives import simulate, write_recording
from typer.testing import Result

from wheelsight.calibration import Calibration, Wheels, load_calibration, read_layer, save_calibration
from wheelsight.camera_calibration.board import board_from
from wheelsight.geometry import PinholeCamera

Command = Callable[..., Result]
Refusal = Callable[..., str]

BOARD = board_from("9x6:35mm")
CAMERA = PinholeCamera(640, 480, 530.0, 530.0, 322.0, 236.0)
WHEELS = Wheels(left_radius_m=0.17, right_radius_m=0.17, track_width_m=0.58, ticks_per_turn=3200)
POSES = [
    pose(BOARD, z, tilt, at)
    for z, tilt, at in (
        (0.50, (0, 0), (0.0, 0.0)),
        (0.55, (28, 0), (-0.12, -0.08)),
        (0.55, (-28, 0), (0.12, 0.08)),
        (0.60, (0, 30), (0.14, -0.1)),
        (0.60, (0, -30), (-0.14, 0.1)),
        (0.80, (20, 20), (0.25, 0.15)),
        (0.80, (-20, 20), (-0.25, -0.15)),
        (1.00, (20, -25), (0.3, -0.2)),
        (1.00, (-15, -25), (-0.3, 0.2)),
        (1.20, (10, 10), (0.0, 0.25)),
    )
]


@pytest.fixture(scope="module")
def views(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("boards") / "views"
    write_views(folder, BOARD, CAMERA, POSES)
    return folder


def test_a_board_is_written_as_pdf_and_svg(wheelsight: Command, tmp_path: Path) -> None:
    for name, start in (("board.pdf", b"%PDF-1.4"), ("board.svg", b"<svg")):
        result = wheelsight("board", "--out", tmp_path / name)
        assert result.exit_code == 0, result.output
        assert "wheelsight calibrate camera VIEWS --board 9x6:25mm" in " ".join(result.stdout.split())
        assert (tmp_path / name).read_bytes().startswith(start)


def test_what_is_no_board_or_paper_is_refusal(refusal: Refusal, tmp_path: Path) -> None:
    assert "end --out with .pdf" in refusal("board", "--out", tmp_path / "board.doc")
    assert "choose from A4" in refusal("board", "--out", tmp_path / "b.pdf", "--paper", "B5")
    assert "9x6:25mm" in refusal("board", "--out", tmp_path / "b.pdf", "--board", "chess")


def test_views_give_a_file_with_a_history_and_a_page(wheelsight: Command, views: Path, tmp_path: Path) -> None:
    out = tmp_path / "robot.yaml"
    save_calibration(Calibration(wheels=WHEELS), out)
    options = ("--board", str(BOARD), "--sensor", "stereo", "--registered", "--plate", "--force")
    result = wheelsight("calibrate", "camera", views, *options, "--out", out)
    assert result.exit_code == 0, result.output
    for word in ("colour fx", "± σ", "colour corners, RMS", "distance", "kept in it: wheels"):
        assert word in result.stdout
    found = load_calibration(out)
    assert found.color is not None
    assert found.color.fx == pytest.approx(CAMERA.fx, rel=0.01)
    assert found.is_registered
    assert found.wheels == WHEELS
    (entry,) = read_layer(out)["history"]
    assert entry["command"] == "calibrate camera"
    assert entry["figures"]["views"] == len(POSES)
    page = (tmp_path / "robot.html").read_text(encoding="utf-8")
    for word in ("Where boards were seen", "By distance", "By place in the image", "The views"):
        assert word in page


@pytest.mark.slow
@pytest.mark.browser
def test_the_page_opens(wheelsight: Command, views: Path, chromium: str, tmp_path: Path) -> None:
    options = ("--board", str(BOARD), "--sensor", "stereo", "--registered", "--plate")
    assert wheelsight("calibrate", "camera", views, *options, "--out", tmp_path / "robot.yaml").exit_code == 0
    document, complaints = open_page(chromium, tmp_path / "robot.html")
    assert complaints == []
    assert document.count('class="plot js-plotly-plot"') == 5
    assert "NaN" not in document.split("<script")[0]


def test_bad_views_are_refused_in_a_line(refusal: Refusal, views: Path, tmp_path: Path) -> None:
    out = ("--out", tmp_path / "robot.yaml")
    assert "VIEW-color" in refusal("calibrate", "camera", tmp_path, "--board", str(BOARD), *out)
    frontal = tmp_path / "frontal"
    write_views(frontal, BOARD, CAMERA, [pose(BOARD, 0.5 + 0.05 * k) for k in range(8)])
    told = refusal("calibrate", "camera", frontal, "--board", str(BOARD), "--registered", *out)
    assert "all boards face the same way" in told
    assert not (tmp_path / "robot.yaml").exists()


def test_a_robot_is_led_through_all_steps(wheelsight: Command, views: Path, tmp_path: Path) -> None:
    out = tmp_path / "robot.yaml"
    first = wheelsight("calibrate", "robot", out)
    assert first.exit_code == 0, first.output
    assert "next: camera" in first.stdout
    assert "wheelsight board --out board.pdf" in first.stdout
    options = ("--board", str(BOARD), "--sensor", "stereo", "--registered", "--plate")
    assert wheelsight("calibrate", "camera", views, *options, "--out", out).exit_code == 0
    second = wheelsight("calibrate", "robot", out)
    assert "next: wheels" in second.stdout
    assert "calibrate camera" in second.stdout
    drive = tmp_path / "drive"
    write_recording(drive, WHEELS, simulate(WHEELS, rng=np.random.default_rng(0)))
    done = wheelsight("calibrate", "wheels", drive, "--out", out, "--force")
    assert done.exit_code == 0, done.output
    third = wheelsight("calibrate", "robot", out)
    assert "next: mount" in third.stdout
    assert [entry["command"] for entry in read_layer(out)["history"]] == ["calibrate camera", "calibrate wheels"]
    document = yaml.safe_load(out.read_text())
    document["T_base_camera"] = np.eye(4).tolist()
    document["history"].append({"date": "2026-11-26 12:00", "command": "calibrate base", "what": "T_base_camera"})
    out.write_text(yaml.safe_dump(document))
    assert "next: a loop" in wheelsight("calibrate", "robot", out).stdout


def test_a_loop_shows_wheels_that_are_right_and_wheels_that_are_not(wheelsight: Command, tmp_path: Path) -> None:
    from drives import square_legs

    truth = simulate(WHEELS, square_legs(WHEELS, WHEELS, 1), rng=np.random.default_rng(1))
    write_recording(tmp_path / "loop", WHEELS, truth)
    for name, wheels, word in (
        ("good", WHEELS, "of the way"),
        ("bad", Wheels(0.17, 0.17, 0.66, 3200), "does not close"),
    ):
        save_calibration(Calibration(wheels=wheels), tmp_path / f"{name}.yaml")
        result = wheelsight("calibrate", "robot", tmp_path / f"{name}.yaml", "--check", tmp_path / "loop")
        assert result.exit_code == 0, result.output
        assert word in result.output
        assert ("does not close" in result.output) == (name == "bad")


def test_a_history_that_is_none_is_refusal(refusal: Refusal, tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    save_calibration(Calibration(wheels=WHEELS), path)
    path.write_text(path.read_text() + "history: soon\n")
    assert "history must be a list" in refusal("calibrate", "robot", path)
    path.write_text(path.read_text().replace("history: soon", "history: [{figures: {views: many}}]"))
    assert "history.views is 'many'" in refusal("calibrate", "robot", path)


def test_corrupt_images_are_told(wheelsight: Command, views: Path, tmp_path: Path) -> None:
    import shutil

    folder = tmp_path / "views"
    shutil.copytree(views, folder)
    (folder / "00-color.png").write_bytes(b"\x89PNG\r\n\x1a\nno image")
    cv2.imwrite(str(folder / "01-color.png"), np.zeros((480, 640), np.uint8))
    options = ("--board", str(BOARD), "--sensor", "stereo", "--registered", "--plate")
    result = wheelsight("calibrate", "camera", folder, *options, "--out", tmp_path / "r.yaml")
    assert "00 is left out: 00-color.png: is damaged, or no image" in " ".join(result.output.split())
    assert "01 is left out: no whole board is seen" in " ".join(result.output.split())
