"""Every bad input is one line that names file, line and fix, with exit code 2, for `info` and `run` alike."""

from __future__ import annotations

import errno
import os
import re
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

Refusal = Callable[..., str]


@pytest.fixture(params=["info", "run"])
def refused(request: pytest.FixtureRequest, refusal: Refusal, tmp_path: Path) -> Refusal:
    """`info` or `run` on a recording that must be refused."""
    out = ["--out", tmp_path / "out"] if request.param == "run" else []
    return lambda *arguments: refusal(request.param, *arguments, *out)


def rewrite(path: Path, change: Callable[[str], str]) -> None:
    path.write_text(change(path.read_text()))


def change_depth(room: Path, change: Callable[[np.ndarray], np.ndarray]) -> None:
    for path in (room / "depth").iterdir():
        image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        assert image is not None
        cv2.imwrite(str(path), change(image))


def test_no_such_folder(refused: Refusal, tmp_path: Path) -> None:
    assert refused(tmp_path / "none") == f"{tmp_path / 'none'}: there is no such folder (check the path)"


def test_a_folder_that_is_no_recording(refused: Refusal, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    assert "rgb.txt and depth.txt" in refused(tmp_path / "empty")


@pytest.mark.parametrize("name", ["rgb.txt", "depth.txt"])
def test_a_missing_list(refused: Refusal, room: Path, name: str) -> None:
    (room / name).unlink()
    assert refused(room) == f"{room / name}: is missing (each recording needs it)"


@pytest.mark.parametrize("name", ["rgb.txt", "depth.txt"])
def test_an_empty_list(refused: Refusal, room: Path, name: str) -> None:
    (room / name).write_text("# nothing but a comment\n")
    assert refused(room) == f"{room / name}: lists no images (one `stamp file` a line is expected)"


def test_a_list_line_without_a_file(refused: Refusal, room: Path) -> None:
    rewrite(room / "rgb.txt", lambda text: text + "200.0\n")
    assert refused(room).startswith(f"{room / 'rgb.txt'}:12: a stamp and a file are expected")


def test_stamps_out_of_order(refused: Refusal, room: Path) -> None:
    rewrite(room / "depth.txt", lambda text: "\n".join(reversed(text.splitlines())) + "\n")
    assert re.match(r".*depth\.txt:\d+: stamp .* out of order \(sort the lines by stamp", refused(room))


def test_repeated_stamps(refused: Refusal, room: Path) -> None:
    rewrite(room / "rgb.txt", lambda text: text + text.splitlines()[-1] + "\n")
    assert re.match(r".*rgb\.txt:\d+: stamp .* repeats another", refused(room))


def test_images_that_are_not_there(refused: Refusal, room: Path) -> None:
    for path in (room / "depth").iterdir():
        path.unlink()
    assert refused(room).startswith(f"{room / 'depth'}")


def test_clocks_that_do_not_agree(refused: Refusal, room: Path) -> None:
    rewrite(room / "depth.txt", lambda text: re.sub(r"^10", "90", text, flags=re.MULTILINE))
    assert "check that both lists use one clock, or raise --max-gap" in refused(room)


def test_depth_of_8_bits(refused: Refusal, room: Path) -> None:
    change_depth(room, lambda depth: (depth >> 8).astype(np.uint8))
    message = refused(room)
    assert message.startswith(f"{room / 'depth'}/100.0")
    assert message.endswith("(depth must be a 16-bit greyscale PNG)")


def test_depth_of_another_size(refused: Refusal, room: Path) -> None:
    change_depth(room, lambda depth: depth[::2, ::2])
    assert "depth image is 160×120, its colour image 320×240 (register depth to colour" in refused(room)


def test_depth_that_measured_nothing(refused: Refusal, room: Path) -> None:
    change_depth(room, np.zeros_like)
    assert "no pixel is valid" in refused(room)


@pytest.mark.parametrize("factor", ["10", "1000000"])
def test_an_absurd_depth_scale(refused: Refusal, room: Path, factor: str) -> None:
    assert re.search(
        r"median depth is .* m at .*\(give the right number .* --depth-factor", refused(room, "--depth-factor", factor)
    )


@pytest.mark.parametrize(
    ("quaternion", "problem"),
    [("nan 0 0 1", "a value is not finite"), ("0 0 0 1.5", "quaternion has length 1.5, not 1")],
)
def test_ground_truth_with_impossible_rotations(refused: Refusal, room: Path, quaternion: str, problem: str) -> None:
    path = room / "groundtruth.txt"
    rewrite(path, lambda text: text + f"300.0 0 0 0 {quaternion}\n")
    line = len(path.read_text().splitlines())
    assert refused(room).startswith(f"{path}:{line}: {problem}")


def test_a_camera_that_nothing_names(refused: Refusal, room: Path) -> None:
    (room / "calibration.yaml").unlink()
    assert "say which with --camera: bonn, freiburg1, freiburg2, freiburg3" in refused(room)


def test_an_unknown_camera(refused: Refusal, room: Path) -> None:
    message = refused(room, "--camera", "webcam")
    assert message.startswith("no camera is called 'webcam'")
    assert "freiburg1" in message


@pytest.mark.parametrize(("option", "value"), [("--max-gap", "-1"), ("--depth-factor", "0"), ("--depth-factor", "nan")])
def test_impossible_options_name_themselves(refused: Refusal, room: Path, option: str, value: str) -> None:
    assert refused(room, option, value).startswith(f"{option} is ")


@pytest.mark.parametrize(("option", "value"), [("--odometry", "sonar"), ("--reference", "tomorrow")])
def test_unknown_names_are_answered_with_the_known(refusal: Refusal, room: Path, option: str, value: str) -> None:
    message = refusal("run", room, "--out", room.parent / "out", option, value)
    assert message.startswith(f"{option} is '{value}' (known: ")


def test_an_unknown_setting(refusal: Refusal, room: Path, tmp_path: Path) -> None:
    settings = tmp_path / "settings.yaml"
    settings.write_text("report:\n  picture: 3\n")
    message = refusal("run", room, "--out", tmp_path / "out", "--config", settings)
    assert message == f"{settings}:2: unknown setting report.picture (did you mean pictures?)"


def test_results_that_would_be_overwritten(refusal: Refusal, room: Path) -> None:
    assert refusal("run", room, "--out", room) == (
        f"{room}: is not empty (choose another --out, or add --force to overwrite)"
    )


def test_an_output_folder_that_is_a_file(refusal: Refusal, room: Path) -> None:
    assert (
        refusal("run", room, "--out", room / "rgb.txt")
        == f"{room / 'rgb.txt'}: is a file, not a folder (choose another name)"
    )


def test_an_output_folder_without_permission(
    refusal: Refusal, room: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Anyone who runs the tests may be root, who may write anywhere; so the system's answer is given for it."""

    def denied(**_: object) -> None:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))

    monkeypatch.setattr("tempfile.TemporaryFile", denied)
    out = tmp_path / "out"
    assert refusal("run", room, "--out", out) == f"{out}: no permission to write here (choose a folder you own)"


def test_a_full_disk(refusal: Refusal, room: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    message = refusal("run", room, "--odometry", "features", "--out", tmp_path / "out")
    assert message.startswith(f"{tmp_path / 'out'}")
    assert message.endswith(": no space left on the disk (free some space, or choose another folder)")
