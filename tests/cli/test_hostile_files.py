"""Every option that takes a file refuses, in one line and at once, what is no ordinary file or far too large."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import Result

Refusal = Callable[..., str]

pytestmark = pytest.mark.timeout(60)


def a_pipe(path: Path) -> str:
    os.mkfifo(path)
    return "is a pipe, not a file"


def ten_gigabytes(path: Path) -> str:
    with path.open("wb") as stream:
        stream.truncate(10 << 30)
    return "holds 10240 MB, more than"


def a_device(path: Path) -> str:
    path.symlink_to("/dev/zero")
    return "is a device, not a file"


def a_folder(path: Path) -> str:
    path.mkdir()
    return "is a folder, not a file"


HOSTILE = [a_pipe, ten_gigabytes, a_device, a_folder]


@pytest.mark.parametrize("make", HOSTILE)
@pytest.mark.parametrize(
    "arguments",
    [
        ("info", "ROOM", "--camera", "FILE"),
        ("run", "ROOM", "--out", "OUT", "--calibration", "FILE"),
        ("run", "ROOM", "--out", "OUT", "--config", "FILE"),
        ("run", "WHEELS", "--out", "OUT", "--odometry", "wheels", "--calibration", "FILE"),
        ("evaluate", "FILE", "ROOM/groundtruth.txt"),
        ("evaluate", "ROOM/groundtruth.txt", "FILE"),
        ("places", "train", "ROOM", "--labels", "FILE", "--out", "OUT"),
        ("places", "train", "ROOM", "--areas", "FILE", "--out", "OUT"),
        ("places", "test", "FILE", "ROOM"),
        ("places", "predict", "FILE", "ROOM", "--out", "OUT"),
        ("wheels", "serve", "none", "--calibration", "FILE", "--pipe", "OUT"),
    ],
    ids=lambda arguments: " ".join(arguments),
)
def test_options_that_take_a_file(
    refusal: Refusal, room: Path, wheels: Path, tmp_path: Path, make: Callable[[Path], str], arguments: tuple[str, ...]
) -> None:
    path = tmp_path / "hostile"
    problem = make(path)
    places = {
        "FILE": path,
        "ROOM": room,
        "WHEELS": wheels,
        "OUT": tmp_path / "out",
        "ROOM/groundtruth.txt": room / "groundtruth.txt",
    }
    assert refusal(*(places.get(word, word) for word in arguments)).startswith(f"{path}: {problem}")


@pytest.mark.parametrize("make", HOSTILE)
@pytest.mark.parametrize("name", ["rgb.txt", "depth.txt", "groundtruth.txt", "calibration.yaml", "associations.txt"])
def test_files_of_a_recording(refusal: Refusal, room: Path, make: Callable[[Path], str], name: str) -> None:
    (room / name).unlink(missing_ok=True)
    problem = make(room / name)
    assert refusal("info", room).startswith(f"{room / name}: {problem}")


@pytest.mark.parametrize("make", HOSTILE)
@pytest.mark.parametrize("name", ["wheels.csv", "gyro.csv", "groundtruth_base.txt"])
def test_files_of_a_recording_of_wheels(refusal: Refusal, wheels: Path, make: Callable[[Path], str], name: str) -> None:
    (wheels / name).unlink(missing_ok=True)
    problem = make(wheels / name)
    assert refusal("info", wheels).startswith(f"{wheels / name}: {problem}")


@pytest.mark.parametrize("name", ["[/]", "[/bold]", "[red]x", "\\[x]", "a[", "{0}"])
def test_folders_whose_names_look_like_markup(
    wheelsight: Callable[..., Result], wheels: Path, tmp_path: Path, name: str
) -> None:
    recording, out = tmp_path / "recordings" / name, tmp_path / "results" / name
    recording.parent.mkdir(parents=True)
    wheels.rename(recording)
    reported = wheelsight("info", recording)
    assert reported.exit_code == 0, reported.output
    assert Path(name).name in reported.stdout
    run = wheelsight("run", recording, "--odometry", "wheels", "--out", out)
    assert run.exit_code == 0, run.output
    assert f"report: {out / 'report.html'}" in run.stdout


@pytest.mark.parametrize("pipe", ["/", ".", "..", "FOLDER"])
def test_a_pipe_where_a_folder_is(refusal: Refusal, wheels: Path, tmp_path: Path, pipe: str) -> None:
    pipe = str(tmp_path) if pipe == "FOLDER" else pipe
    message = refusal("wheels", "serve", "none", "--pipe", pipe, "--calibration", wheels / "calibration.yaml")
    assert message.startswith((f"{pipe}: is ", f"{pipe}: exists and is not a pipe"))
    assert message.endswith("(choose another path for the pipe)")


@pytest.mark.parametrize(("seed", "fix"), [(2**32, "4294967296"), (10**30, "4294967296"), (-1, "0")])
def test_seeds_have_bounds(refusal: Refusal, room: Path, tmp_path: Path, seed: int, fix: str) -> None:
    message = refusal("run", room, "--out", tmp_path / "out", "--seed", seed)
    assert message.startswith(f"--seed is {seed}")
    assert fix in message


@pytest.mark.parametrize(
    ("setting", "bound"),
    [
        (
            "dense: {kept_keyframes: 100000}",
            "dense.kept_keyframes is 100000, which should be less than",
        ),
        ("surfels: {far_m: 1.0e+9}", "surfels.far_m is 1000000000.0, which should be less than or equal to 40"),
        ("surfels: {max_surfels: 1000000000}", "surfels.max_surfels is 1000000000, which should be less than"),
        ("report: {pictures: 1000000}", "report.pictures is 1000000, which should be less than or equal to 100"),
        ("features: {keypoints: 10000000000}", "features.keypoints is 10000000000, which should be"),
        ("recording: {max_gap_s: 1.0e+9}", "recording.max_gap_s is 1000000000.0, which should be less than"),
    ],
)
def test_settings_have_the_bounds_that_sense_has(
    refusal: Refusal, room: Path, tmp_path: Path, setting: str, bound: str
) -> None:
    (tmp_path / "c.yaml").write_text(setting)
    message = refusal("run", room, "--out", tmp_path / "out", "--config", tmp_path / "c.yaml")
    assert message.startswith(f"{tmp_path / 'c.yaml'}:1: {bound}")


@pytest.mark.parametrize(
    "arguments",
    [
        ("run", "ROOM", "--out", "LONG"),
        ("info", "LONG"),
        ("info", "ROOM", "--camera", "LONG"),
        ("export", "LONG", "--ply"),
    ]
    + [
        ("evaluate", "LONG", "LONG"),
        ("places", "train", "ROOM", "--out", "LONG"),
        ("calibrate", "base", "ROOM", "--out", "LONG"),
    ]
    + [("calibrate", "base", "ROOM", "--out", "/"), ("places", "train", "ROOM", "--out", "/")],
    ids=lambda arguments: " ".join(arguments),
)
def test_names_that_no_file_can_have(refusal: Refusal, room: Path, arguments: tuple[str, ...]) -> None:
    words = {"ROOM": str(room), "LONG": "a" * 400}
    message = refusal(*(words.get(word, word) for word in arguments))
    assert "a" * 400 in message or message.startswith("/: is a folder")
