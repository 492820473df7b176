"""`simulate` from the command line: small drives, and every way to ask for one that cannot be."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import pytest
import yaml
from floor_plans import rooms_in_colours, two_rooms, write_plan
from narrowing import of_type
from typer.testing import Result

from wheelsight.app.cli.simulate import size_of
from wheelsight.core.areas import load_areas
from wheelsight.core.calibration import load_calibration
from wheelsight.core.messages import SkippedFrame
from wheelsight.io.recordings import open_recording
from wheelsight.io.recordings.image_recording import ImageRecording
from wheelsight_sim import camera_names, world_names

Command = Callable[..., Result]
Refusal = Callable[..., str]
TINY = ("--size", "64x48", "--rate", 10, "--duration", 0.5)
SMALL = (*TINY, "--realism", "ideal")


def test_a_drive_becomes_a_recording(wheelsight: Command, tmp_path: Path) -> None:
    out = tmp_path / "out"
    result = wheelsight("simulate", "square", *SMALL, "--gyro", "--out", out)
    assert result.exit_code == 0, result.output
    assert result.stdout == ""
    assert result.stderr == f"5 frames and 26 wheel readings are in {out}; plan: {out / 'plan.png'}\n"
    reported = json.loads(wheelsight("info", out, "--json").stdout)
    assert (reported["format"], reported["frames"], reported["wheel_readings"], reported["body"]) == (
        "wheelsight",
        5,
        26,
        "base",
    )
    assert reported["rate_hz"] == pytest.approx(10)
    assert (reported["skipped"], reported["gaps"], reported["warnings"]) == ([], [], [])
    assert reported["yaw_readings"] > 0
    assert 0.2 < reported["valid_depth_share"] < 1
    assert reported["ground_truth"]["duration_s"] == pytest.approx(0.5, abs=0.01)


def test_a_drive_is_real_unless_reported_otherwise(wheelsight: Command, tmp_path: Path) -> None:
    for name, options in (("real", ()), ("ideal", ("--realism", "ideal"))):
        result = wheelsight("simulate", "square", *TINY, *options, "--out", tmp_path / name)
        assert result.exit_code == 0, result.output
        reported = yaml.safe_load((tmp_path / name / "truth" / "settings.yaml").read_text())["settings"]
        assert reported["realism"] == name
    real, ideal = (of_type(ImageRecording, open_recording(tmp_path / name)) for name in ("real", "ideal"))
    true = load_calibration(tmp_path / "real" / "truth" / "calibration.yaml")
    assert true.color != real.calibration.color
    assert ideal.calibration.color == load_calibration(tmp_path / "ideal" / "truth" / "calibration.yaml").color
    assert [tick.stamp_s for tick in ideal.wheels] == [round(0.02 * k, 6) for k in range(26)]
    assert [tick.stamp_s for tick in real.wheels] != [tick.stamp_s for tick in ideal.wheels]


@pytest.mark.parametrize(
    ("base", "columns"),
    [("mecanum", "front_left,front_right,rear_left,rear_right"), ("increments", "x_m,y_m,yaw_rad")],
)
def test_a_holonomic_base_has_a_column_for_each_of_its_numbers(
    wheelsight: Command, tmp_path: Path, base: str, columns: str
) -> None:
    out = tmp_path / "out"
    result = wheelsight("simulate", "square", *SMALL, "--base", base, "--out", out)
    assert result.exit_code == 0, result.output
    assert (out / "wheels.csv").read_text().splitlines()[0] == f"stamp_s,{columns}"
    owned, true = (load_calibration(path) for path in (out / "calibration.yaml", out / "truth/calibration.yaml"))
    assert owned.holonomic == true.holonomic
    assert owned.wheels is None
    assert open_recording(out).wheel_count == 26


def test_an_unknown_realism_is_refused(refusal: Refusal, tmp_path: Path) -> None:
    reported = refusal("simulate", "square", *TINY, "--realism", "reel", "--out", tmp_path / "out")
    assert reported.rstrip() == "--realism is reel (did you mean real? choose from ideal, real)"


def test_options_reach_the_settings(wheelsight: Command, tmp_path: Path) -> None:
    robot = ("--left-radius", 0.168, "--right-radius", 0.171, "--track", 0.53, "--no-slip")
    faults = ("--dropout", "0.1:0.2", "--dropout", "0.3:0.4", "--unplug", "0.2:0.25", "--ice", "-1,2,0.5")
    ways = ("--laps", 2, "--reverse", "--stop-and-turn", "--seed", 5, "--speed", 0.4, "--motion-blur")
    more = (*ways, *robot, *faults, "--lift", "0.1:0.15", "--cover", "0.15:0.25", "--camera", "kinect-v2")
    result = wheelsight("simulate", "square", *SMALL, *more, "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    reported = yaml.safe_load((tmp_path / "out" / "truth" / "settings.yaml").read_text())["settings"]
    assert (reported["camera"], reported["laps"], reported["seed"], reported["speed_m_s"]) == ("kinect-v2", 2, 5, 0.4)
    assert (reported["is_reverse"], reported["stops_to_turn"], reported["has_slip"], reported["has_motion_blur"]) == (
        1,
        1,
        0,
        1,
    )
    robot_reported = reported["robot"]
    assert [robot_reported[key] for key in ("left_radius_m", "right_radius_m", "track_width_m")] == [0.168, 0.171, 0.53]
    assert reported["faults"] == {
        "dropouts_s": [[0.1, 0.2], [0.3, 0.4]],
        "unplugged_s": [[0.2, 0.25]],
        "patches": [{"x_m": -1.0, "y_m": 2.0, "radius_m": 0.5, "friction": 0.05}],
        "lifted_s": [[0.1, 0.15]],
    }
    recording = of_type(ImageRecording, open_recording(tmp_path / "out"))
    assert not [tick for tick in recording.wheels if 0.1 < tick.stamp_s < 0.2]
    assert reported["covered_s"] == [[0.15, 0.25]]
    skipped = {event.stamp_s: event.reason for event in recording.events() if isinstance(event, SkippedFrame)}
    assert skipped == {0.2: "depth image measured nothing: no pixel is valid"}


def test_a_floor_plan_becomes_a_recording_with_areas(wheelsight: Command, tmp_path: Path) -> None:
    plan = write_plan(tmp_path, two_rooms())
    cv2.imwrite(str(tmp_path / "rooms.png"), rooms_in_colours())
    options = ("--areas", tmp_path / "rooms.png", "--start", "3,5.5,90", "--way", 20)
    result = wheelsight("simulate", "--plan", plan, *options, *SMALL, "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    out = tmp_path / "out"
    reported = yaml.safe_load((out / "truth" / "settings.yaml").read_text())["settings"]
    assert (reported["world"], reported["plan"]["path"], reported["plan"]["way_m"]) == ("house", "house.yaml", 20)
    assert len(load_areas(out / "areas.yaml")) == 3
    truth = open_recording(out).ground_truth
    assert truth is not None
    assert truth.positions_m[0, :2] == pytest.approx((3.0, 5.5), abs=0.01)
    assert (out / "plan.png").is_file()


def test_the_list_shows_all_worlds_and_cameras(wheelsight: Command) -> None:
    result = wheelsight("simulate", "--list")
    assert result.exit_code == 0
    first_words = [line.split()[0] for line in result.stdout.splitlines() if line.strip()]
    assert first_words == ["Worlds", *world_names(), "Cameras", *camera_names()]


@pytest.mark.parametrize(
    ("camera", "size", "expected"),
    [
        ("kinect-v1", "half", (320, 240)),
        ("kinect-v2", "half", (256, 212)),
        ("kinect-v2", "full", None),
        ("ideal", "80X60", (80, 60)),
    ],
)
def test_sizes_keep_the_shape_of_the_cameras_images(camera: str, size: str, expected: tuple[int, int] | None) -> None:
    assert size_of(size, camera) == expected


def test_help_shows_examples(wheelsight: Command) -> None:
    text = wheelsight("simulate", "--help").stdout
    assert "wheelsight simulate floor4 --out floor" in text
    assert "wheelsight simulate --plan office.yaml --duration 60 --out office" in text
    assert "--passers-by" in text


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        ((), "a WORLD is missing (wheelsight simulate floor4 --out DIR, or --list)"),
        (("nowhere",), "there is no world nowhere (choose from floor4, "),
        (
            ("square", "--camera", "eye"),
            "camera 'eye' is not known (choose from ideal, kinect-v1, kinect-v2, realsense-d455)",
        ),
        (("square", "--size", "big"), "--size is 'big' (write it as 320x240, half or full)"),
        (("square", "--size", "1x1"), "--size is 1x1 (16 to 4096 pixels)"),
        (("square", "--speed", 3), "--speed is 3 m/s (over 0, up to 1.2 m/s)"),
        (("square", "--dropout", "5"), "--dropout is '5' (FROM:TO in seconds, such as 12:15.5)"),
        (("square", "--lift", "5:4"), "--lift is '5:4' (FROM:TO in seconds, such as 12:15.5; the second after"),
        (("square", "--cover", "now"), "--cover is 'now' (FROM:TO in seconds, such as 12:15.5)"),
        (("square", "--ice", "1,2"), "--ice is '1,2' (X,Y,R in metres, such as 4,2.5,0.6)"),
        (("square", "--ice", "1,2,0"), "--ice is '1,2,0' (the radius must be over 0)"),
        (("square", "--unplug", "nan:3"), "--unplug is 'nan:3' ("),
        (("square", "--left-radius", -0.1), "left_radius_m is -0.1, no wheelchair's ("),
        (("square", "--base", "tricycle"), "--base is 'tricycle' (one of differential, mecanum, omni-3, omni-4"),
        (("square", "--base", "mecanum", "--track", 0.5), "--base mecanum has no such wheels (--left-radius, --right"),
        (("square", "--base", "mecanum", "--lift", "0:1"), "--lift means nothing with --base mecanum (leave one of"),
        (("square", "--track", 20), "track_width_m is 20.0, no wheelchair's ("),
        (("square", "--drive", "absent.csv"), "absent.csv: is missing ("),
        (("square", "--doors", 3), "--doors is 3; in world square there is room for 0 to swing (choose flat, or"),
        (("square", "--duration", 1, "--cover", "5:6"), "--cover 5:6 never comes: the drive ends at 1.0 s ("),
        (("square", "--plan", "a.yaml"), "both the world square and a plan are given (leave one of them out)"),
        (("square", "--way", 30), "--way means nothing without a plan (--plan map.yaml)"),
        (("square", "--areas", "a.png"), "--areas means nothing without a plan (--plan map.yaml)"),
        (("--plan", "absent.yaml"), "absent.yaml: cannot be read: No such file or directory"),
        (("--plan", "absent.png"), "absent.png: is an image without a scale (give --resolution in metres, or its"),
        (("--plan", "a.yaml", "--start", "1,2"), "--start is '1,2' (X,Y,YAW_DEG in metres and degrees, such as"),
        (("--plan", "a.yaml", "--way", -3), "--way is -3 m (over 0, up to 20000 m)"),
    ],
)
def test_what_cannot_be_is_refused(
    refusal: Refusal, tmp_path: Path, arguments: tuple[object, ...], problem: str
) -> None:
    assert refusal("simulate", *arguments, "--out", tmp_path / "new" / "out").startswith(problem)
    assert not any(tmp_path.iterdir())


def test_what_is_refused_leaves_a_folder_of_mine_as_it_was(refusal: Refusal, tmp_path: Path) -> None:
    refusal("simulate", "square", "--doors", 3, "--out", tmp_path)
    assert tmp_path.is_dir()


def test_a_folder_is_needed_and_must_be_free(refusal: Refusal, tmp_path: Path) -> None:
    assert refusal("simulate", "square").startswith("--out DIR is missing")
    (tmp_path / "note.txt").write_text("mine")
    assert "is not empty" in refusal("simulate", "square", "--out", tmp_path)


def test_a_way_into_a_wall_is_refused_with_a_picture(refusal: Refusal, tmp_path: Path) -> None:
    (tmp_path / "v.csv").write_text("stamp_s,v_m_s,yaw_rate_rad_s\n0,1,0\n60,0,0\n")
    text = refusal("simulate", "square", "--drive", tmp_path / "v.csv", "--out", tmp_path / "out")
    picture = tmp_path / "out-refused.png"
    assert text.startswith(f"{tmp_path / 'v.csv'}: the way runs into ")
    assert text.endswith(f" m (see {picture})")
    assert picture.is_file()
    assert not (tmp_path / "out").exists()


def test_the_folder_is_not_in_the_way_of_a_second_try(wheelsight: Command, refusal: Refusal, tmp_path: Path) -> None:
    refusal("simulate", "square", "--camera", "eye", "--out", tmp_path / "out")
    assert wheelsight("simulate", "square", *SMALL, "--out", tmp_path / "out").exit_code == 0
    assert wheelsight("simulate", "square", *SMALL, "--force", "--out", tmp_path / "out").exit_code == 0


def test_without_mujoco_the_extra_is_named(refusal: Refusal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    text = refusal("simulate", "square", "--out", tmp_path / "out")
    assert text == "MuJoCo is missing (pip install mujoco matplotlib)"
    assert not (tmp_path / "out").exists()


def test_ctrl_c_keeps_what_is_there(wheelsight: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    advances = []

    def advance(self: object, status: str = "") -> None:
        advances.append(status)
        if len(advances) == 3:
            raise KeyboardInterrupt

    monkeypatch.setattr("wheelsight.app.cli.progress.FrameProgress.advance", advance)
    result = wheelsight("simulate", "square", *SMALL, "--out", tmp_path / "out")
    assert result.exit_code == 130
    assert result.stderr == f"interrupted; {tmp_path / 'out'} holds the drive up to there, 3 frames\n"
    assert open_recording(tmp_path / "out").frame_count == 3


def test_ctrl_c_before_the_first_frame_promises_nothing(
    wheelsight: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(self: object, index: int) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("wheelsight_sim.frames.Renderer.frame", interrupt)
    result = wheelsight("simulate", "square", *SMALL, "--out", tmp_path / "out")
    assert result.exit_code == 130
    assert result.stderr == "interrupted\n"


@pytest.mark.slow
def test_a_real_ctrl_c_keeps_what_is_there(tmp_path: Path) -> None:
    out = tmp_path / "out"
    command = [sys.executable, "-m", "wheelsight", "simulate", "square", "--size", "64x48", "--out", str(out)]
    # Anyone who runs tests in the background has SIGINT ignored, and so would the command.
    listening = lambda: signal.signal(signal.SIGINT, signal.SIG_DFL)  # noqa: E731
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, preexec_fn=listening) as process:
        lines = out / "rgb.txt"
        deadline = time.monotonic() + 120
        while not (lines.is_file() and len(lines.read_text().splitlines()) > 4):
            assert process.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=60)
    assert process.returncode == 130
    recording = open_recording(out)
    assert errors.splitlines()[-1] == f"interrupted; {out} holds the drive up to there, {recording.frame_count} frames"
    assert recording.frame_count >= 3
    assert recording.warnings == ()
    assert sum(1 for _ in recording.events()) > recording.frame_count
