"""A recording as a live camera: each frame once, in its time, and none while no one asks."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from hand_fed_camera import CALIBRATION, live_frame

from wheelsight.core.messages import AngularVelocity, RgbdFrame
from wheelsight.core.settings import LiveCameraSettings
from wheelsight.io.devices import host_clock
from wheelsight.io.devices.cameras import PlayedCamera
from wheelsight.io.devices.live_camera import CameraStatus, HasGyro, LiveCamera, LiveFrame
from wheelsight.io.recordings import RecordingWriter


def film(count: int, rate_hz: float = 50.0) -> Iterator[RgbdFrame]:
    return (live_frame(number, number / rate_hz).frame for number in range(count))


def wait(is_so: Callable[[], bool]) -> None:
    ends_s = time.monotonic() + 60
    while not is_so():
        assert time.monotonic() < ends_s, "it did not come"
        time.sleep(0.005)


def all_of(camera: PlayedCamera) -> list[LiveFrame]:
    found: list[LiveFrame] = []
    while camera.report().status is not CameraStatus.ENDED:
        if (live := camera.read(0.05)) is not None:
            found.append(live)
    return [*found, *iter(lambda: camera.read(0), None)]


def test_frames_come_once_in_order_and_in_their_time() -> None:
    with PlayedCamera("film", CALIBRATION, film(20), LiveCameraSettings(kept_frames=100)) as camera:
        assert isinstance(camera, LiveCamera)
        began_s = host_clock.now_s()
        found = all_of(camera)
        report = camera.report()
    assert [live.frame.color[0, 0, 0] for live in found] == list(range(20))
    assert [live.frame.index for live in found] == list(range(20))
    assert (report.status, report.frames, report.host_drops) == (CameraStatus.ENDED, 20, 0)
    assert host_clock.now_s() - began_s >= 19 / 50
    for live in found:
        assert live.frame.stamp_s <= live.arrived_s
        assert live.device_s == pytest.approx(live.frame.index / 50)


def test_it_stands_still_until_it_is_asked() -> None:
    with PlayedCamera("film", CALIBRATION, film(3)) as camera:
        time.sleep(0.2)
        assert camera.report().frames == 0
        assert len(all_of(camera)) == 3


def test_what_no_one_fetches_is_dropped_and_counted() -> None:
    with PlayedCamera("film", CALIBRATION, film(10), LiveCameraSettings(kept_frames=2, oldest_s=60)) as camera:
        first = camera.read(30)
        wait(lambda: camera.report().status is CameraStatus.ENDED)
        rest = camera.take()
        report = camera.report()
    assert first is not None
    assert [frame.index for frame in rest] == [8, 9]
    assert report.host_drops == 10 - 1 - 2


def test_an_old_frame_is_not_handed_out_as_new() -> None:
    with PlayedCamera("film", CALIBRATION, film(2), LiveCameraSettings(oldest_s=0.05)) as camera:
        assert camera.read(0) is None
        wait(lambda: camera.report().status is CameraStatus.ENDED)
        time.sleep(0.1)
        assert camera.read(0) is None
        assert camera.report().stale == 2


def test_a_closed_camera_gives_nothing_and_keeps_no_one_waiting() -> None:
    camera = PlayedCamera("film", CALIBRATION, film(1000))
    assert camera.read(30) is not None
    camera.close()
    camera.close()
    camera.take()
    began_s = time.monotonic()
    assert camera.read(20) is None
    assert time.monotonic() - began_s < 10
    assert camera.report().status is CameraStatus.CLOSED


def turned(stamp_s: float) -> AngularVelocity:
    return AngularVelocity(stamp_s, stamp_s, 0.5, -0.25)


def test_its_gyroscope_shows_with_the_frames_and_by_their_clock() -> None:
    turns = [turned(k / 200) for k in range(-10, 60)]  # frames are taken from 0 to 0.18 s
    with PlayedCamera("film", CALIBRATION, film(10), LiveCameraSettings(kept_frames=100), turns=turns) as camera:
        assert isinstance(camera, HasGyro)
        frames, reported = all_of(camera), camera.take_angular_velocities()
        assert camera.take_angular_velocities() == []
    assert [one.x_rad_s for one in reported] == pytest.approx([k / 200 for k in range(37)])
    stamps_s = [one.stamp_s for one in reported]
    assert stamps_s == sorted(stamps_s)
    by_frame = {round(live.device_s or 0.0, 6): live.frame.stamp_s for live in frames}
    for one in reported:
        if (at_s := round(one.x_rad_s, 6)) in by_frame:
            assert one.stamp_s == pytest.approx(by_frame[at_s], abs=1e-6)


def test_a_recordings_gyroscope_is_played_unless_it_is_not_wanted(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "film", CALIBRATION) as writer:
        for frame in film(3):
            writer.add(frame)
    lines = [f"{k / 200},0.1,0.2,{k / 200}" for k in range(8)]
    (tmp_path / "film" / "imu.csv").write_text("\n".join(["stamp_s,x_rad_s,y_rad_s,z_rad_s", *lines, ""]))
    reported = {}
    for gyro in (True, False):
        with PlayedCamera.opened(str(tmp_path / "film"), LiveCameraSettings(gyro=gyro), None) as camera:
            assert len(all_of(camera)) == 3
            reported[gyro] = [one.z_rad_s for one in camera.take_angular_velocities()]
    assert reported == {True: pytest.approx([k / 200 for k in range(8)]), False: []}
