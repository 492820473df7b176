"""`wheelsight drive`: what is refused before anything moves, and what is asked; and drives in a flat."""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hand_fed_camera import HandFedCamera
from rehearsed_drive import CALIBRATION
from sessions.kept_views import write_map
from typer.testing import CliRunner, Result

from wheelsight.app.cli import app
from wheelsight.core.calibration import Calibration, save_calibration
from wheelsight.core.calibration_parts import HolonomicWheels
from wheelsight.core.errors import DeviceError
from wheelsight.core.runtime import why_missing
from wheelsight.core.settings import LiveCameraSettings
from wheelsight.core.trajectory import read_tum
from wheelsight.io.devices.cameras import ANY, LIVE_CAMERAS, open_robot_camera
from wheelsight.io.devices.simulated_controller import SimulatedController
from wheelsight.io.devices.wire_formats import LinkCommand as Commanded

Command = Callable[..., Result]
Refusal = Callable[..., str]


@pytest.fixture
def kept(wheelsight: Command, tmp_path: Path) -> Path:
    """A map with two names."""
    write_map(tmp_path / "home", 5)
    for name in ("kitchen", "desk"):
        assert wheelsight("map", "name", tmp_path / "home", name, "--at", "0.5,0,90").exit_code == 0
    return tmp_path / "home"


@pytest.fixture
def calibration(tmp_path: Path) -> Path:
    save_calibration(CALIBRATION, tmp_path / "robot.yaml")
    return tmp_path / "robot.yaml"


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        ((), "no robot is named (one of --sim WORLD and --robot PORT)"),
        (("--sim", "flat", "--robot", "p"), "a robot is either simulated or real (one of --sim"),
        (("--sim", "flat", "--yes"), "--yes is of a real robot"),
        (("--robot", "/dev/null", "--calibration", "c.yaml", "--drive-model", "c.yaml"), "--drive-model is of a sim"),
        (("--sim", "flat", "--calibration", "c.yaml"), "--calibration is of a real robot"),
        (("--robot", "p"), "--robot needs to know how the robot is built (--calibration FILE)"),
        (("--robot", "p", "--calibration", "c.yaml", "--start", "1,2,3"), "--start is of a simulated robot"),
        (("--sim", "nowhere"), "--sim is 'nowhere', no world and no file (floor4, flat,"),
        (("--sim", "flat", "--resolution", "0.05"), "--resolution means nothing without a plan"),
        (("--sim", "flat", "--start", "1,2"), "--start is '1,2' (X,Y,YAW_DEG"),
        (("--sim", "flat", "--known-start", "1,2"), "--known-start is '1,2', which should be 3 numbers"),
        (("--sim", "flat", "--set", "navigation"), "--set is 'navigation' (NAME=VALUE"),
        (("--sim", "flat", "--set", "navigation.limits.forward_m_s=9"), "--set navigation.limits.forward_m_s is 9"),
        (("--sim", "flat", "--set", "navigation.limit.forward_m_s=1"), "unknown setting navigation.limit"),
        (("--sim", "flat", "--to", "3;4"), "no place of the map is called '3;4'"),
        (("--sim", "flat", "--to", "3,x"), "--to is '3,x' (X,Y,YAW_DEG in metres and degrees"),
        (("--sim", "flat", "--to", "nan,1"), "--to is 'nan,1'"),
        (("--sim", "flat", "--realism", "false"), "--realism is false"),
        (("--sim", "flat", "--people", "-1"), "--people is -1 (0 to 100)"),
    ],
)
def test_what_means_nothing_is_refused_in_a_line(
    refusal: Refusal, kept: Path, tmp_path: Path, options: tuple[str, ...], problem: str
) -> None:
    reported = refusal("drive", "--map", kept, "--to", "kitchen", "--out", tmp_path / "out", *options)
    assert problem in reported
    assert not (tmp_path / "out").exists()


def test_a_world_that_is_none_is_refused_before_kernels_are_compiled(
    refusal: Refusal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def compile_missing(parts: object) -> None:
        raise AssertionError(parts)

    monkeypatch.setattr("wheelsight.app.cli.compiling.compile_missing", compile_missing)
    assert refusal("drive", "--sim", "nowhere", "--explore", "--out", tmp_path / "out").startswith("--sim is 'nowhere'")


def test_a_map_and_a_goal_are_needed(refusal: Refusal, kept: Path, tmp_path: Path) -> None:
    assert refusal("drive", "--sim", "flat", "--to", "kitchen").startswith("there is no map to drive in (--map DIR")
    assert refusal("drive", "--sim", "flat", "--map", kept).startswith("there is no goal (--to NAME")
    nowhere = refusal("drive", "--sim", "flat", "--map", tmp_path / "nowhere", "--to", "kitchen")
    assert "there is no such folder" in nowhere


def test_an_unknown_name_is_reported_with_the_nearest_and_all(refusal: Refusal, kept: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    reported = refusal("drive", "--sim", "flat", "--map", kept, "--to", "desk", "--to", "kichen", "--out", out)
    assert reported == "no place of the map is called 'kichen' (did you mean kitchen?) (known: desk, kitchen)"
    assert not out.exists()


def test_a_folder_that_holds_something_is_refused(refusal: Refusal, kept: Path, tmp_path: Path) -> None:
    reported = refusal("drive", "--sim", "flat", "--map", kept, "--to", "desk", "--out", kept)
    assert "is not empty" in reported


def test_a_file_for_rerun_that_is_there_is_refused(refusal: Refusal, kept: Path, tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="rerun-sdk is not installed")
    (tmp_path / "drive.rrd").write_text("mine")
    reported = refusal("drive", "--sim", "flat", "--map", kept, "--to", "desk", "--rerun", tmp_path / "drive.rrd")
    assert reported.startswith(f"{tmp_path / 'drive.rrd'}: is there already")
    assert (tmp_path / "drive.rrd").read_text() == "mine"


def unplugged(*_: Any) -> Any:
    raise DeviceError("there is none")


def test_a_real_robot_without_a_camera_is_refused(
    refusal: Refusal, kept: Path, calibration: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = ("drive", "--robot", "/dev/null", "--calibration", calibration, "--map", kept, "--to", "kitchen")
    for kind in tuple(LIVE_CAMERAS):
        monkeypatch.setitem(LIVE_CAMERAS, kind, unplugged)
    assert refusal(*asked).startswith("no depth camera is plugged in (plug one in; wheelsight devices lists")


def of_robot(port: object, calibration: Path, kept: Path, *more: object) -> tuple[object, ...]:
    return ("drive", "--robot", port, "--calibration", calibration, "--map", kept, "--to", "kitchen", *more)


def test_a_real_robot_without_its_camera_is_refused(refusal: Refusal, kept: Path, calibration: Path) -> None:
    reported = refusal(*of_robot("/dev/null", calibration, kept, "--camera", "kinet"))
    assert reported == f"no camera is called 'kinet' (one of {', '.join(LIVE_CAMERAS)})"


def test_a_holonomic_base_is_not_driven(
    refusal: Refusal, kept: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plug_in(monkeypatch, HandFedCamera())
    path = tmp_path / "mecanum.yaml"
    save_calibration(Calibration(holonomic=HolonomicWheels("increments")), path)
    reported = refusal(*of_robot("/dev/null", path, kept))
    why = "has the wheels of a holonomic base, and this needs two driven wheels"
    assert reported == f"{path}: {why} (wheelsight run localizes such a base)"


def test_a_robot_of_which_no_one_knows_how_it_is_built_is_refused(
    refusal: Refusal, kept: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera = HandFedCamera()
    plug_in(monkeypatch, camera)
    save_calibration(Calibration(wheels=CALIBRATION.wheels), tmp_path / "wheels.yaml")
    reported = refusal(*of_robot("/dev/null", tmp_path / "wheels.yaml", kept))
    assert reported.startswith(f"{tmp_path / 'wheels.yaml'}: has no T_base_camera (wheelsight calibrate base finds")
    assert camera.is_closed


def test_the_cameras_own_calibration_lies_under_the_robots(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = plug_in(monkeypatch, HandFedCamera())
    mount = Calibration(wheels=CALIBRATION.wheels, T_base_camera=CALIBRATION.T_base_camera)
    save_calibration(mount, tmp_path / "robot.yaml")
    _, found = open_robot_camera(ANY, LiveCameraSettings(), [tmp_path / "robot.yaml"])
    assert asked == [None]
    assert (found.color, found.wheels) == (HandFedCamera().calibration.color, CALIBRATION.wheels)
    np.testing.assert_array_equal(found.T_base_camera, CALIBRATION.T_base_camera)
    save_calibration(CALIBRATION, tmp_path / "robot.yaml")
    _, found = open_robot_camera(ANY, LiveCameraSettings(), [tmp_path / "robot.yaml"])
    assert asked[1].color == found.color == CALIBRATION.color


def plug_in(monkeypatch: pytest.MonkeyPatch, camera: HandFedCamera) -> list[Any]:
    """Let it be the only camera; the calibrations that it is asked to go by."""
    for kind in reversed(tuple(LIVE_CAMERAS)):  # what is put back last comes last, and their order is reported
        monkeypatch.delitem(LIVE_CAMERAS, kind)
    asked: list[Any] = []

    def opened(_: str | None, __: LiveCameraSettings, calibration: Calibration | None) -> HandFedCamera:
        asked.append(calibration)
        return camera

    monkeypatch.setitem(LIVE_CAMERAS, "fake", opened)
    return asked


def test_nothing_moves_where_the_question_is_answered_with_no(
    kept: Path, calibration: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera = HandFedCamera()
    plug_in(monkeypatch, camera)
    with SimulatedController(tmp_path) as controller:
        asked = of_robot(controller.port, calibration, kept, "--camera", "fake")
        result = CliRunner().invoke(app, [str(word) for word in asked], input="n\n")
        assert result.exit_code == 1, result.output
        assert "Is the floor around the robot free, and is somebody at the stop button? [y/N]" in result.output
        assert "nothing moved" in result.stderr
        assert camera.is_closed
        assert Commanded.DRIVE not in [kind for kind, _ in controller.commands]


def test_a_robot_whose_firmware_stops_too_late_is_refused(
    refusal: Refusal, kept: Path, calibration: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera = HandFedCamera()
    camera.warnings = ()
    plug_in(monkeypatch, camera)
    with SimulatedController(tmp_path) as controller:
        controller.version = (1, 1, 0, 0)
        reported = refusal(*of_robot(controller.port, calibration, kept, "--camera", "fake", "--yes"))
        assert (
            "the controller's firmware is 1.0, older than 1.1: it stops the motors too late (write the new" in reported
        )
        assert Commanded.DRIVE not in [kind for kind, _ in controller.commands]
    assert camera.is_closed


SMALL = ("--rate", "5", "--size", "320x240")
# Back, so that the camera sees the floor that is driven over next; then ahead, and round.
LEGS = """stamp_s,v_m_s,yaw_rate_rad_s
0,0,0
0.5,-0.4,0
4.2,0,0
4.7,0.5,0
12.2,0,0
12.7,0,0.5
19.0,0,0
19.4,0,0
"""


@pytest.fixture(scope="module")
def flat(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, np.ndarray, np.ndarray]:
    """The map of a short drive; where that ended, in the map and in the world."""
    folder = tmp_path_factory.mktemp("flat")
    (folder / "legs.csv").write_text(LEGS)
    how = ("--drive", folder / "legs.csv", *SMALL, "--seed", "5")
    for words in (
        ("simulate", "flat", *how, "--out", folder / "day"),
        ("run", folder / "day", "--map", "surfels", "--out", folder / "map"),
    ):
        result = CliRunner().invoke(app, [str(word) for word in words])
        assert result.exit_code == 0, result.output
    truth = read_tum(folder / "day" / "groundtruth_base.txt", "base")
    known = read_tum(folder / "map" / "joined" / "trajectory.txt", "base")
    return folder / "map", planar(known.T_frame_body[-1]), planar(truth.T_frame_body[-1])


def planar(T: np.ndarray) -> np.ndarray:
    return np.array([T[0, 3], T[1, 3], np.degrees(np.arctan2(T[1, 0], T[0, 0]))])


def ahead_of(pose: np.ndarray) -> np.ndarray:
    """(2,) where the outline is still on floor that the first drive has seen."""
    yaw = np.radians(pose[2])
    return pose[:2] + 0.4 * np.array([np.cos(yaw), np.sin(yaw)])


def words_of(pose: np.ndarray) -> str:
    return ",".join(f"{value:.3f}" for value in pose)


def begun(flat: tuple[Path, np.ndarray, np.ndarray]) -> list[str]:
    folder, known, true = flat
    where = ["--start", words_of(true), "--known-start", words_of(known)]
    return ["drive", "--sim", "flat", "--seed", "5", *SMALL, "--map", str(folder), *where]


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_robot_drives_to_a_place_of_a_flat_that_was_mapped_before(
    flat: tuple[Path, np.ndarray, np.ndarray], wheelsight: Command, drawn_pages: None, tmp_path: Path
) -> None:
    folder, known, _ = flat
    assert wheelsight("map", "name", folder, "table", "--at", words_of(ahead_of(known))).exit_code == 0
    shown = () if why_missing("rerun") else ("--rerun", tmp_path / "drive.rrd")
    result = wheelsight(*begun(flat), "--to", "table", "--out", tmp_path / "drive", *shown)
    assert result.exit_code == 0, result.output
    assert not shown or (tmp_path / "drive.rrd").stat().st_size > 100_000
    assert result.stdout.startswith("arrived at table: ")
    assert "idle → planning: to table" in result.stderr
    assert "status: knows where it is" in result.stderr
    reported = json.loads((tmp_path / "drive" / "drive.json").read_text())
    assert reported["has_arrived"] is True
    assert reported["goals"][0]["off_m"] < 0.15
    assert reported["truth"]["contacts"] == []
    assert reported["truth"]["clearance_m"] > 0
    assert 0.25 < reported["way_m"] < 1.0
    page = (tmp_path / "drive" / "drive.html").read_text()
    assert "To table in map" in page
    for name in ("drive.png", "trajectory.txt", "config.yaml"):
        assert (tmp_path / "drive" / name).stat().st_size > 1000


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_ctrl_c_stops_the_robot_first_and_says_so(
    flat: tuple[Path, np.ndarray, np.ndarray], wheelsight: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from wheelsight_sim.simulator import Simulator

    stopped: list[float] = []
    stop, step = Simulator.stop, Simulator.step

    def note(robot: Simulator) -> None:
        stopped.append(robot.time_s)
        stop(robot)

    monkeypatch.setattr(Simulator, "stop", note)
    steps: list[int] = []

    def press(robot: Simulator, command):
        steps.append(1)
        if len(steps) == 30:
            os.kill(os.getpid(), signal.SIGINT)
        return step(robot, command)

    monkeypatch.setattr(Simulator, "step", press)
    result = wheelsight(*begun(flat), "--to", words_of(ahead_of(flat[1])), "--out", tmp_path / "drive")
    assert result.exit_code == 130, result.output
    assert result.stderr.splitlines()[-1] == "interrupted; the robot was stopped first, and stands"
    assert stopped[0] == pytest.approx(1.5, abs=0.06)
    reported = json.loads((tmp_path / "drive" / "drive.json").read_text())
    assert reported["interrupted"] is True
    assert reported["goals"][0]["reason"] == "the task was canceled"


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_real_robot_stands_while_its_camera_shows_nothing(
    flat: tuple[Path, np.ndarray, np.ndarray], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, known, _ = flat
    camera, asked_s = HandFedCamera(), []
    interrupted: list[bool] = []

    def take():
        asked_s.append(time.monotonic())
        if asked_s[-1] - asked_s[0] > 3.0 and len(asked_s) > 20 and not interrupted:
            interrupted.append(True)  # once: a second Ctrl-C gives up the tidy end
            os.kill(os.getpid(), signal.SIGINT)
        return ()

    monkeypatch.setattr(camera, "take", take)
    plug_in(monkeypatch, camera)
    with SimulatedController(tmp_path) as controller:
        words = ["drive", "--robot", controller.port, "--calibration", folder.parent / "day" / "calibration.yaml"]
        words += ["--map", folder, "--known-start", words_of(known), "--to", words_of(ahead_of(known))]
        result = CliRunner().invoke(app, [str(word) for word in words], input="y\n")
        assert result.exit_code == 130, result.output
        assert "holds it: no fresh depth frame" in result.stderr
        assert result.stderr.splitlines()[-1] == "interrupted; the robot was stopped first, and stands"
        driven = [body for kind, body in controller.commands if kind == Commanded.DRIVE]
        assert not any(int.from_bytes(body, "little") for body in driven)
        assert camera.is_closed


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_goal_for_which_the_map_has_no_room_is_refused_before_anything_moves(
    flat: tuple[Path, np.ndarray, np.ndarray], wheelsight: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from wheelsight_sim.simulator import Simulator

    moved: list[object] = []
    monkeypatch.setattr(Simulator, "step", lambda robot, command: moved.append(command))
    near = words_of(ahead_of(flat[1]))
    result = wheelsight(*begun(flat), "--to", near, "--to", "60,60", "--out", tmp_path / "drive")
    assert result.exit_code == 2, result.output
    assert "(60.00, 60.00) m: the goal is outside the map: " in result.stderr
    assert not moved
