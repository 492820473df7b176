"""`wheelsight run --live`: what it needs, what it leaves, and how it ends."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from hand_fed_camera import CALIBRATION, HandFedCamera
from typer.testing import Result

from wheelsight.core.calibration import Calibration, save_calibration
from wheelsight.core.calibration_parts import Wheels
from wheelsight.io.devices.cameras import LIVE_CAMERAS
from wheelsight.io.devices.live_camera import CameraStatus
from wheelsight.io.devices.simulated_controller import SimulatedController
from wheelsight.io.recordings import open_recording

Command = Callable[..., Result]
Refusal = Callable[..., str]
ROBOT = Calibration(wheels=Wheels(0.17, 0.17, 0.52, 3200.0))


@pytest.mark.parametrize(
    ("words", "reported"),
    [
        ((), "no recording is named (wheelsight run RECORDING, or --live --camera NAME)"),
        (("--live",), "there is nothing to listen to (--camera NAME, --wheels PORT, or both)"),
        (("drive", "--live", "--wheels", "p"), "--live follows sensors, no recording (leave one of them out)"),
        (("drive", "--wheels", "p"), "--wheels is of a live run (add --live, or leave it out)"),
        (("drive", "--seconds", "3"), "--seconds is of a live run (add --live, or leave it out)"),
        (("drive", "--record", "d"), "--record is of a live run (add --live, or leave it out)"),
        (("--live", "--wheels", "p", "--realtime"), "--realtime plays a recording (with --live, --wheels PORT alone)"),
        (("--live", "--wheels", "p"), "nothing says how large the wheels are (--calibration FILE)"),
        (("--live", "--camera", "kinet"), f"no camera is called 'kinet' (one of {', '.join(LIVE_CAMERAS)})"),
    ],
)
def test_what_means_nothing_is_refused_in_a_line(
    refusal: Refusal, tmp_path: Path, words: tuple[str, ...], reported: str
) -> None:
    assert refusal("run", *words, "--out", tmp_path / "out") == reported
    assert not (tmp_path / "out").exists()


def test_wheels_are_followed_for_so_long_after_ready_and_recorded(wheelsight: Command, tmp_path: Path) -> None:
    save_calibration(ROBOT, tmp_path / "robot.yaml")
    with SimulatedController(tmp_path) as controller:
        controller.speeds = (60, 50)
        sensors = ("--live", "--wheels", controller.port, "--calibration", tmp_path / "robot.yaml")
        kept = ("--out", tmp_path / "out", "--record", tmp_path / "kept")
        result = wheelsight("run", *sensors, *kept, "--seconds", 1)
    assert result.exit_code == 0, result.output
    assert "ready; following for 1 s" in result.stderr
    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert metrics["wheel_readings"]["processed"] == metrics["realtime"]["readings"]
    assert metrics["recording"] == {"name": str(controller.port), "format": "live", "path": None}
    assert (metrics["realtime"]["is_live"], metrics["realtime"]["wheels_from"]) == (True, str(controller.port))
    assert metrics["realtime"]["played_s"] == pytest.approx(1.0, abs=0.5)
    assert metrics["interrupted"] is False
    assert "Live: " in result.stdout
    assert open_recording(tmp_path / "kept").wheel_count == metrics["realtime"]["readings"] > 5


def test_a_camera_that_ends_at_once_is_reported_and_given_back(
    wheelsight: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera = HandFedCamera(CALIBRATION)
    camera.tell(CameraStatus.ENDED)
    monkeypatch.setattr(camera, "read", lambda timeout_s: None)
    monkeypatch.setitem(LIVE_CAMERAS, "fake", lambda *_: camera)
    result = wheelsight("run", "--live", "--camera", "fake", "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    assert "No frame came from fake 1: the recording it plays has ended." in result.stderr + result.stdout
    assert camera.is_closed
