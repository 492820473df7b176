"""An `.oni` file in a process of its own: whatever OpenNI2 does there, this process goes on and says what it was."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from devices.oni_files import needs_openni2, record_dummy

from wheelsight.core.errors import DeviceError, InputError, RecordingError
from wheelsight.core.settings import LiveCameraSettings
from wheelsight.io.devices.camera_driver import PlaybackEndedError
from wheelsight.io.devices.cameras import open_live_camera
from wheelsight.io.devices.live_camera import CameraStatus
from wheelsight.io.devices.oni_player import OniPlayer

SMALL = LiveCameraSettings(width_px=320, height_px=240, kept_frames=100)
# Stands in for OpenNI2, which cannot be made to hang at will: it answers as the player does, as long as a test wants.
STAND_IN = """
import json, os, struct, sys, time
def say(answer, data=b""):
    text = json.dumps(answer).encode()
    os.write(1, struct.pack("<I", len(text)) + text + data)
FRAME = {"images": {"color": [2, 4], "depth_m": [2, 4]}, "color_s": 0.5, "depth_s": 0.25, "sequence": 7}
def opened():
    say({})
    say({"name": "stand-in", "calibration": sys.argv[1], "warnings": ["odd"]})
"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    file = tmp_path / "a.oni"
    file.write_bytes(b"NI10")
    return file


@pytest.fixture
def player(path: Path, monkeypatch: pytest.MonkeyPatch):
    """Makes a player whose process runs a script; the calibration is handed to it in place of the file."""
    made: list[OniPlayer] = []

    def playing(script: str) -> OniPlayer:
        monkeypatch.setattr("wheelsight.io.devices.oni_player._HANGING_S", 1.0)
        command = [sys.executable, "-c", STAND_IN + script, calibration_text(path.parent)]
        monkeypatch.setattr("wheelsight.io.devices.oni_player._COMMAND", command)
        made.append(OniPlayer(str(path), SMALL))
        return made[-1]

    yield playing
    for each in made:
        each.close()


def calibration_text(folder: Path) -> str:
    from wheelsight.core.calibration import Calibration, save_calibration
    from wheelsight.core.geometry import PinholeCamera

    save_calibration(Calibration.registered_camera(PinholeCamera(4, 2, 3.0, 3.0, 1.5, 0.5)), folder / "c.yaml")
    return (folder / "c.yaml").read_text()


def test_answers_become_images(player) -> None:
    subject = player("opened()\nsay(FRAME, bytes(range(24)) + bytes(32))\nsay({'is_over': True})\ntime.sleep(60)")
    device = subject.open()
    assert (device.name, device.warnings) == ("stand-in", ("odd",))
    assert device.calibration.cameras[0].width == 4
    images = subject.read(30.0)
    assert images is not None
    assert images.color.tolist() == np.arange(24).reshape(2, 4, 3).tolist()
    assert images.depth_m.shape == (2, 4)
    assert (images.color_s, images.depth_s, images.sequence, images.infrared) == (0.5, 0.25, 7, None)
    with pytest.raises(PlaybackEndedError):
        subject.read(30.0)


@pytest.mark.parametrize(
    ("script", "problem"),
    [
        ("os.kill(os.getpid(), 11)", "OpenNI2 crashed by SIGSEGV on this file"),
        ("sys.exit(3)", "OpenNI2 ended with exit code 3 on this file"),
        pytest.param("time.sleep(60)", "OpenNI2 hung on this file and was ended", marks=pytest.mark.slow),
        ("os.write(1, b'\\xff' * 64)", "OpenNI2 sends an invalid message: a text of 4294967295 bytes"),
        ("os.write(1, struct.pack('<I', 2) + b'[]')\ntime.sleep(60)", "sends an invalid message: no message"),
        ("say({'images': {'color': [-1, 4]}})\ntime.sleep(60)", "sends an invalid message: an image of -1 rows"),
        ("say({'images': {'color': [99999, 99999]}})\ntime.sleep(60)", "an image of 99999×99999 pixels"),
        ("say({'images': {'color': 'x'}})\ntime.sleep(60)", "sends an invalid message"),
        ("say({'images': {'color': [0, 0]}})\ntime.sleep(60)", "sends an invalid message"),
        ("say({'error': 'reads no frame', 'fix': ''})\ntime.sleep(60)", "reads no frame"),
    ],
)
def test_what_the_process_does_is_said_in_one_line(player, path: Path, script: str, problem: str) -> None:
    for begin, error in (("say({})\n", DeviceError), ("opened()\n", RecordingError)):
        subject = player(begin + script)
        if error is RecordingError:
            subject.open()
        elif "[0, 0]" in script:
            continue
        with pytest.raises(error, match=problem) as caught:
            _ = subject.open() if error is DeviceError else [subject.read(0.3) for _ in range(100)]
        assert str(caught.value).startswith(f"{path}: ")


def test_a_process_that_does_not_even_begin_is_ended(player, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("wheelsight.io.devices.oni_player._OPENING_S", 1.0)
    with pytest.raises(DeviceError, match="hung on this file and was ended"):
        player("time.sleep(60)").open()


def test_a_camera_whose_file_crashes_the_library_ends_with_the_reason(player, path: Path) -> None:
    player("opened()\nos.kill(os.getpid(), 11)")
    with open_live_camera(f"openni2:{path}", SMALL) as camera:
        while camera.report().status not in (CameraStatus.ENDED, CameraStatus.CLOSED):
            time.sleep(0.01)
        with pytest.raises(DeviceError, match="OpenNI2 crashed by SIGSEGV on this file"):
            camera.read(1.0)
        assert camera.report().reconnects == 0


@pytest.mark.parametrize("how", ["folder", "pipe", "nowhere"])
def test_what_is_no_file_is_not_opened(tmp_path: Path, how: str) -> None:
    path = tmp_path / "a.oni"
    if how == "folder":
        path.mkdir()
    elif how == "pipe":
        os.mkfifo(path)
    with pytest.raises(DeviceError, match=r"is a (folder|pipe), not a file|there is no such file"):
        open_live_camera(f"openni2:{path}")


def pids_of_players(file: Path) -> list[int]:
    return [
        int(folder.name)
        for folder in Path("/proc").iterdir()
        if folder.name.isdigit() and str(file).encode() in _command(folder) and b"oni_player" in _command(folder)
    ]


def _command(folder: Path) -> bytes:
    try:
        return (folder / "cmdline").read_bytes()
    except OSError:
        return b""


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("oni") / "dummy.oni"
    record_dummy(path, 1.0)
    return path


@needs_openni2
@pytest.mark.slow
def test_the_process_ends_with_the_camera(recorded: Path) -> None:
    with open_live_camera(f"openni2:{recorded}", SMALL) as camera:
        assert camera.read(10.0) is not None
        assert len(pids_of_players(recorded)) == 1
    assert not pids_of_players(recorded)


@needs_openni2
@pytest.mark.slow
def test_the_process_ends_with_a_program_that_is_killed(recorded: Path) -> None:
    script = f"""
from wheelsight.io.devices.cameras import open_live_camera
import time
camera = open_live_camera("openni2:{recorded}")
print("open", flush=True)
time.sleep(60)
"""
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True) as program:
        assert program.stdout is not None
        assert program.stdout.readline() == "open\n"
        program.send_signal(signal.SIGKILL)
    ends_s = time.monotonic() + 30
    while pids_of_players(recorded) and time.monotonic() < ends_s:
        time.sleep(0.05)
    assert not pids_of_players(recorded)


@needs_openni2
@pytest.mark.slow
def test_damaged_files_are_played_or_refused(recorded: Path, tmp_path: Path, rng: np.random.Generator) -> None:
    """Some of them crash OpenNI2."""
    whole = np.frombuffer(recorded.read_bytes(), np.uint8)
    path = tmp_path / "damaged.oni"
    refusals: list[str] = []
    for _ in range(6):
        damaged = whole.copy()
        damaged[rng.integers(0, 5000, 20)] = rng.integers(0, 256, 20)
        path.write_bytes(damaged.tobytes())
        try:
            with open_live_camera(f"openni2:{path}", SMALL) as camera:
                while camera.report().status is not CameraStatus.ENDED and camera.report().frames < 5:
                    camera.read(0.2)
                    if camera.report().status in (CameraStatus.STALLED, CameraStatus.UNPLUGGED):
                        break
        except InputError as error:
            refusals.append(str(error))
    assert all(str(path) in refusal and "\n" not in refusal for refusal in refusals)
