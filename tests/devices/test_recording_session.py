"""A camera and wheels recorded side by side: what ends it, what does not, and what is reported."""

from __future__ import annotations

import shutil
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from hand_fed_camera import CALIBRATION, HandFedCamera, live_frame

from wheelsight.core.errors import OutputError
from wheelsight.core.settings import RecorderSettings
from wheelsight.io.devices import WheelLink, host_clock
from wheelsight.io.devices.live_camera import CameraStatus
from wheelsight.io.devices.recorder import LiveRecorder, RecordingSession, SessionStatus
from wheelsight.io.devices.simulated_controller import SimulatedController
from wheelsight.io.recordings import RecordingWriter, open_recording

DEFAULTS = RecorderSettings()


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("wheelsight.io.devices.recorder._CHECK_S", 0.02)
    monkeypatch.setattr("wheelsight.io.devices.recorder._RATE_SPAN_S", 0.5)


class Session:
    """A session on a thread; `stop` ends it."""

    def __init__(self, recorder: LiveRecorder, folder: Path, camera: HandFedCamera, link: WheelLink | None) -> None:
        self.notes: list[str] = []
        self.looks: list[SessionStatus] = []
        self.problem: OutputError | None = None
        self.recorder, self.camera = recorder, camera
        self._is_over = threading.Event()
        self._session = RecordingSession(recorder, folder, camera, link, self.notes.append)
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        try:
            self._session.run(self._is_over.is_set, self.looks.append)
        except OutputError as error:
            self.problem = error

    def stop(self) -> None:
        self._is_over.set()
        self.join()

    def join(self) -> None:
        self._thread.join(60)
        assert not self._thread.is_alive()


@contextmanager
def recording(folder: Path, link: WheelLink | None = None, settings: RecorderSettings = DEFAULTS) -> Iterator[Session]:
    with LiveRecorder(RecordingWriter(folder, CALIBRATION), settings) as recorder:
        session = Session(recorder, folder, HandFedCamera(), link)
        try:
            yield session
        finally:
            session.stop()


def wait(is_so: Callable[[], bool]) -> None:
    ends_s = time.monotonic() + 60
    while not is_so():
        assert time.monotonic() < ends_s, "it did not come"
        time.sleep(0.005)


def test_a_camera_that_goes_away_is_reported_and_the_wheels_go_on(tmp_path: Path) -> None:
    with SimulatedController(tmp_path) as controller, WheelLink(str(controller.port)) as link:
        controller.speeds = (6, 5)
        with recording(tmp_path / "r", link) as session:
            session.camera.put(live_frame(0, host_clock.now_s()))
            wait(lambda: session.recorder.report().frames == 1)
            session.camera.tell(CameraStatus.UNPLUGGED, detail="the cable")
            wait(lambda: bool(session.notes))
            readings = session.recorder.report().readings
            wait(lambda: session.recorder.report().readings > readings + 10)
            session.camera.tell(CameraStatus.STREAMING, reconnects=1, detail="")
            session.camera.put(live_frame(1, host_clock.now_s()))
            wait(lambda: session.recorder.report().frames == 2)
            wait(lambda: len(session.notes) > 1)
    assert session.notes[0] == "fake 1: unplugged: waiting for it (the cable)"
    assert "fake 1: is back" in session.notes
    recorded = open_recording(tmp_path / "r")
    assert (recorded.frame_count, recorded.wheel_count) == (2, session.recorder.report().readings)


def test_a_clock_that_leaps_is_reported(tmp_path: Path) -> None:
    with recording(tmp_path / "r") as session:
        wait(lambda: bool(session.looks))
        session.camera.tell(clock_jumps=1)
        wait(lambda: bool(session.notes))
    assert session.notes == ["fake 1: its clock jumped; the mapping of its stamps restarts"]


def test_a_stamp_that_goes_back_is_left_out_and_reported_once(tmp_path: Path) -> None:
    with recording(tmp_path / "r") as session:
        begin_s = host_clock.now_s()
        for number, after_s in enumerate((0.0, 1.0, 0.5, 0.6, 2.0)):
            session.camera.put(live_frame(number, begin_s + after_s))
        wait(lambda: session.recorder.report().frames == 3)
        wait(lambda: any(look.drops == {"refused": 2} for look in session.looks))
    assert len(session.notes) == 1
    assert session.notes[0].startswith("left out a frame or reading that cannot be stored: stamp ")


def test_it_ends_with_a_camera_that_has_ended(tmp_path: Path) -> None:
    with recording(tmp_path / "r") as session:
        session.camera.put(live_frame(0, host_clock.now_s()))
        wait(lambda: session.recorder.report().frames == 1)
        session.camera.tell(CameraStatus.ENDED)
        session.join()
    assert session.problem is None
    assert session.notes == ["fake 1: the recording it plays has ended"]


def test_it_ends_before_the_disk_is_full(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    used = shutil.disk_usage(tmp_path)
    with recording(tmp_path / "r", settings=DEFAULTS.model_copy(update={"least_free_mb": 150.0})) as session:
        wait(lambda: bool(session.looks))
        monkeypatch.setattr(shutil, "disk_usage", lambda _: used._replace(free=149_000_000))
        session.join()
    assert str(session.problem) == (
        f"{tmp_path / 'r'}: only 149 MB are left on the disk: recording stopped, and is complete "
        "(free some space, then continue with --resume)"
    )


def test_it_ends_where_nothing_more_can_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> int:
        raise OutputError("no space left on the disk")

    monkeypatch.setattr("wheelsight.io.recordings.native.write_units", full)
    with recording(tmp_path / "r") as session:
        session.camera.put(live_frame(0, host_clock.now_s()))
        session.join()
    assert "no space left on the disk" in str(session.problem)


def test_a_look_shows_rates_drops_and_room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    used = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: used._replace(free=1_200_000_000))
    with recording(tmp_path / "r") as session:
        for number in range(20):
            session.camera.put(live_frame(number, host_clock.now_s()))
            time.sleep(0.02)
        wait(lambda: session.recorder.report().frames == 20)
        session.camera.tell(device_drops=2, host_drops=3, stale=0)
        wait(lambda: any(look.drops for look in session.looks))
        look = next(look for look in session.looks if look.recorder.frames >= 5)
    assert session.looks[-1].drops == {"camera": 2, "busy computer": 3}
    assert 0 < look.frames_per_s < 70
    assert look.full_after_s == pytest.approx(1_000_000_000 / look.bytes_per_s)
