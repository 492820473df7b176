"""`record --camera`: what it writes, however it ends, and what it says; a recording is played as the camera."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hand_fed_camera import CALIBRATION, HandFedCamera, live_frame
from typer.testing import Result

from wheelsight.app.cli.record import line_of
from wheelsight.core.calibration import Calibration, load_calibration, save_calibration
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.errors import OutputError
from wheelsight.core.files import write_text
from wheelsight.core.messages import AngularVelocity, RgbdFrame
from wheelsight.io.devices import LineStatistics, LinkReport, LinkStatus, host_clock
from wheelsight.io.devices.cameras import LIVE_CAMERAS
from wheelsight.io.devices.live_camera import CameraReport, CameraStatus
from wheelsight.io.devices.recorder import RecorderReport, SessionStatus
from wheelsight.io.devices.simulated_controller import SimulatedController
from wheelsight.io.recordings import RecordingWriter, open_recording
from wheelsight.io.recordings.native import read_frame_clocks

Command = Callable[..., Result]
Refusal = Callable[..., str]
ROBOT = Wheels(0.17, 0.17, 0.6, 3200.0)


def frames_in(folder: Path) -> list[RgbdFrame]:
    return [event for event in open_recording(folder).events() if isinstance(event, RgbdFrame)]


def started(out: Path, *words: object) -> subprocess.Popen[str]:
    """`record` in a process of its own, once it has listed ten frames more than there were."""
    before = listed(out)
    command = [sys.executable, "-m", "wheelsight", "record", "--out", out, *words]
    process = subprocess.Popen([str(word) for word in command], stderr=subprocess.PIPE, text=True)
    ends_s = time.monotonic() + 120
    while listed(out) < before + 10:
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < ends_s, "it did not come"
        time.sleep(0.02)
    return process


def listed(out: Path) -> int:
    path = out / "depth.txt"
    return len(path.read_text().splitlines()) - 2 if path.exists() else 0


def test_what_was_recorded_until_a_kill_is_there_and_goes_on(film: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    process = started(out, "--camera", f"recording:{film}")
    killed_s = time.time()
    process.send_signal(signal.SIGKILL)
    process.communicate(timeout=60)
    frames = frames_in(out)
    assert killed_s - frames[-1].stamp_s < 1.0
    process = started(out, "--camera", f"recording:{film}", "--resume")
    process.send_signal(signal.SIGINT)
    _, reported = process.communicate(timeout=60)
    assert process.returncode == 0, reported
    assert "Traceback" not in reported
    after = frames_in(out)
    assert [frame.stamp_s for frame in after[: len(frames)]] == [frame.stamp_s for frame in frames]
    assert len(after) >= len(frames) + 10
    assert all(one.stamp_s < other.stamp_s for one, other in pairwise(after))
    assert f"{len(after)} frames and 0 wheel readings are in {out}" in reported
    assert [clock.stamp_s for clock in read_frame_clocks(out)] == [frame.stamp_s for frame in after]


def test_camera_and_wheels_side_by_side_with_the_robots_calibration(
    wheelsight: Command, film: Path, tmp_path: Path
) -> None:
    save_calibration(Calibration(wheels=ROBOT, source="our robot"), tmp_path / "robot.yaml")
    with SimulatedController(tmp_path) as controller:
        controller.speeds = (60, 50)
        sensors = ("--camera", f"recording:{film}", "--wheels", controller.port)
        words = ("--calibration", tmp_path / "robot.yaml", "--color", "jpeg", "--seconds", 3)
        result = wheelsight("record", *sensors, "--out", tmp_path / "out", *words)
    assert result.exit_code == 0, result.output
    recording = open_recording(tmp_path / "out")
    assert (recording.calibration.color, recording.calibration.wheels) == (CALIBRATION.color, ROBOT)
    assert recording.frame_count > 5
    assert recording.wheel_count > 20
    frames = frames_in(tmp_path / "out")
    assert {path.suffix for path in (tmp_path / "out" / "rgb").iterdir()} == {".jpg"}
    played = [round((frame.stamp_s - frames[0].stamp_s) * 15) for frame in frames]
    first = int(frames[0].color.mean().round())
    assert all(abs(frame.color.mean() - first - n) < 2.5 for frame, n in zip(frames, played, strict=True))
    ticks_s = [event.stamp_s for event in recording.events(images=False)]
    assert ticks_s[0] - 2 < frames[0].stamp_s < ticks_s[-1] + 0.1  # one clock


def test_info_shows_how_the_cameras_clock_was_mapped(wheelsight: Command, film: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert wheelsight("record", "--camera", f"recording:{film}", "--seconds", 2, "--out", out).exit_code == 0
    reported = " ".join(wheelsight("info", out).stdout.split())
    assert "camera clock host time less" in reported
    assert re.search(r"its mapping σ 0\.00 ms \(median\), 0\.00 ms at most, of \d+ frames", reported)
    assert "numbers missing" in reported
    figures = json.loads(wheelsight("info", out, "--json").stdout)["clock"]
    assert figures["frames"] == len(read_frame_clocks(out))
    assert "camera clock" not in wheelsight("info", film).stdout


def plug_in(monkeypatch: pytest.MonkeyPatch, camera: HandFedCamera) -> None:
    """Let it be a camera called fake."""
    monkeypatch.setitem(LIVE_CAMERAS, "fake", lambda *_: camera)


def test_the_cameras_gyroscope_is_recorded_for_a_run_that_knows_how_the_camera_sits(
    wheelsight: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera = HandFedCamera()
    plug_in(monkeypatch, camera)
    begin_s = host_clock.now_s()
    for number in range(20):
        camera.turn(AngularVelocity(begin_s + number / 200, 0.0, -0.25, 0.0))
    camera.put(live_frame(1, begin_s))
    result = wheelsight("record", "--camera", "fake", "--seconds", 1, "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    assert "1 frames and 0 wheel readings, and 20 of the camera's gyroscope, are in" in result.stderr
    assert "imu.csv are not used: T_base_camera" in " ".join(wheelsight("info", tmp_path / "out").stderr.split())
    mount = [[0.0, 0, 1, 0.2], [-1, 0, 0, 0], [0, -1, 0, 1.2], [0, 0, 0, 1]]
    save_calibration(replace(CALIBRATION, wheels=ROBOT, T_base_camera=np.array(mount)), tmp_path / "robot.yaml")
    reported = wheelsight("info", tmp_path / "out", "--calibration", tmp_path / "robot.yaml").stdout
    assert re.search(r"yaw rates +20", reported)


def test_it_is_reported_what_the_camera_warns_of_and_the_camera_is_given_back(
    wheelsight: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera = HandFedCamera()
    camera.put(live_frame(0, host_clock.now_s(), infrared=True))
    camera.tell(CameraStatus.UNPLUGGED)
    plug_in(monkeypatch, camera)
    result = wheelsight("record", "--camera", "fake", "--infrared", "--out", tmp_path / "out", "--seconds", 1)
    assert result.exit_code == 0, result.output
    assert "warning: It is made by hand." in result.stderr
    assert re.search(r"^\d\d:\d\d:\d\d fake 1: unplugged: waiting for it$", result.stderr, re.MULTILINE)
    assert camera.is_closed
    assert len((tmp_path / "out" / "infrared.txt").read_text().splitlines()) == 3


def test_a_full_disk_is_one_line_and_what_was_recorded_stays(
    wheelsight: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera = HandFedCamera()
    for number in range(2):
        camera.put(live_frame(number, host_clock.now_s() + number))
    plug_in(monkeypatch, camera)

    def fills(path: Path, *_: object) -> int:
        write_text(path, "x")
        raise OutputError("no space left on the disk", path=path, fix="free some space, or choose another folder")

    monkeypatch.setattr("wheelsight.io.recordings.native.write_units", fills)
    result = wheelsight("record", "--camera", "fake", "--out", tmp_path / "out", "--seconds", 60)
    assert result.exit_code == 2
    assert "no space left on the disk (free some space" in result.stderr.splitlines()[-1]
    assert result.stderr.splitlines()[-1].startswith("error: ")
    assert camera.is_closed
    assert (tmp_path / "out" / "depth.txt").read_text().count("\n") == 2


def test_what_cannot_be_recorded_is_refused_in_a_line_and_leaves_nothing(
    refusal: Refusal, film: Path, tmp_path: Path
) -> None:
    before, out = set(tmp_path.iterdir()), ("--out", tmp_path / "new" / "out")
    assert refusal("record", *out) == "there is nothing to record (--camera NAME, --wheels PORT, or both)"
    kinds = ", ".join(LIVE_CAMERAS)
    assert refusal("record", "--camera", "kinet", *out) == f"no camera is called 'kinet' (one of {kinds})"
    nowhere = refusal("record", "--camera", "recording", *out)
    assert nowhere == "no recording is named (--camera recording:DIR)"
    assert "there is no such folder" in refusal("record", "--camera", f"recording:{tmp_path / 'none'}", *out)
    sensor = ("--camera", f"recording:{film}")
    assert refusal("record", *sensor, *out, "--color", "gif") == "--color is 'gif' (one of png, jpeg)"
    assert refusal("record", *sensor, *out, "--force", "--resume").startswith("--force starts over")
    assert refusal("record", "--wheels", "p", *out, "--infrared") == "--infrared is of a camera (add --camera NAME)"
    (tmp_path / "wheel.yaml").write_text("wheels: 3")
    assert "wheel.yaml" in refusal("record", *sensor, *out, "--calibration", tmp_path / "wheel.yaml")
    (tmp_path / "wheel.yaml").unlink()
    assert set(tmp_path.iterdir()) == before


def test_a_folder_that_holds_something_else_or_may_not_be_written_is_refused(
    refusal: Refusal, film: Path, tmp_path: Path
) -> None:
    sensor = ("record", "--camera", f"recording:{film}", "--seconds", 0)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "letter.txt").write_text("dear")
    assert "is not empty" in refusal(*sensor, "--out", tmp_path / "out")
    assert "is a file, not a folder" in refusal(*sensor, "--out", tmp_path / "out" / "letter.txt")
    if os.getuid():
        (tmp_path / "locked").mkdir(mode=0o500)
        reported = refusal(*sensor, "--out", tmp_path / "locked")
        assert "no permission to write here (choose a folder you own)" in reported
    # A root may write anywhere but into the kernel's own folders.
    assert refusal(*sensor, "--out", Path("/proc/wheelsight")).startswith("/proc/wheelsight: ")


def resumed(refusal: Refusal, film: Path, out: Path, *more: object) -> str:
    """The last line of refused words; a played camera warns first."""
    return refusal("record", "--camera", f"recording:{film}", "--out", out, "--resume", "--seconds", 0, *more)


def test_resuming_goes_by_what_is_there(refusal: Refusal, film: Path, tmp_path: Path, wheelsight: Command) -> None:
    with RecordingWriter(tmp_path / "out", replace(CALIBRATION, source="before")) as writer:
        writer.add(live_frame(0, host_clock.now_s() + 3600).frame)
    reported = resumed(refusal, film, tmp_path / "out", "--calibration", "robot.yaml")
    assert reported == "--resume goes by the recording's own calibration (leave out --calibration)"
    words = ("record", "--camera", f"recording:{film}", "--out", tmp_path / "out", "--resume")
    late = wheelsight(*words)
    assert late.exit_code == 2
    assert re.search(r"its last stamp lies 3\d\d\d s in the future: the clock was set back", late.stderr)
    assert load_calibration(tmp_path / "out" / "calibration.yaml").source == "before"


LINK = LinkReport(LinkStatus.CONNECTED, None, LineStatistics(), 0, 0, 0, 0, 0.0, None, None)
LOOK = SessionStatus(
    seconds=725,
    recorder=RecorderReport(frames=21000, readings=36000, dropped=12, refused=1),
    camera=replace(CameraReport(CameraStatus.STREAMING, 0.0), device_drops=3),
    link=None,
    frames_per_s=29.97,
    readings_per_s=49.8,
    bytes_per_s=17.43e6,
    free_bytes=54_300_000_000,
    full_after_s=3104.0,
)


def test_the_line_is_as_long_as_the_terminal_is_wide() -> None:
    assert line_of(LOOK, 130) == (
        "12:05 · 21000 frames, 30.0/s · 16 dropped (slow disk 12, refused 1, camera 3) · 17.4 MB/s, 54 GB free, "
        "full in 52 min"
    )
    both = replace(LOOK, link=LINK)
    assert line_of(both, 90) == "12:05 21000 fr 30/s 50 wh/s dropped: disk 12 refused 1 camera 3 17 MB/s 54 GB=52 min"
    assert line_of(both, 60) == "12:05 21000 fr 30/s 50 wh/s 16 dropped 17 MB/s 54 GB=52 min"
    assert line_of(both, 58, 1200) == "12:05/20:00 21000 fr 30/s 50 wh/s 16 dropped 54 GB=52 min"
    for width in (130, 100, 80, 60, 40):
        assert len(line_of(both, width)) <= width


def test_nothing_is_dropped_is_said_too() -> None:
    calm = replace(LOOK, recorder=RecorderReport(frames=10), camera=CameraReport(CameraStatus.STREAMING, 0.0))
    assert line_of(calm, 80) == "12:05 · 10 frames, 30.0/s · 0 dropped · 17.4 MB/s, 54 GB free, full in 52 min"
