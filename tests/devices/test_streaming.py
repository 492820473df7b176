"""StreamingCamera against a driver that is unplugged, stalls, repeats itself, and whose clock leaps."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest
from devices.fake_camera import CAMERA, QUICK, FakeDriver, images

from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import CalibrationError, DeviceError
from wheelsight.core.geometry import PinholeCamera
from wheelsight.core.messages import AngularVelocity, RgbdFrame, SkippedFrame
from wheelsight.io.devices import host_clock
from wheelsight.io.devices.camera_driver import DeviceAngularVelocity
from wheelsight.io.devices.live_camera import (
    CameraStatus,
    HasGyro,
    LiveCamera,
    LiveFrame,
    StreamingCamera,
    take_angular_velocities,
)


def eventually(holds: Callable[[], bool], seconds: float = 5.0) -> float:
    """How long it took until `holds`."""
    began_s = time.monotonic()
    while not holds():
        assert time.monotonic() - began_s < seconds, "it did not come"
        time.sleep(0.002)
    return time.monotonic() - began_s


@pytest.fixture
def driver() -> FakeDriver:
    return FakeDriver()


@pytest.fixture
def camera(driver: FakeDriver) -> Iterator[StreamingCamera]:
    with StreamingCamera(driver, QUICK) as camera:
        yield camera


def read(camera: StreamingCamera) -> LiveFrame:
    found = camera.read(5.0)
    assert found is not None
    return found


def number_of(found: RgbdFrame | SkippedFrame) -> int:
    assert isinstance(found, RgbdFrame)
    return int(found.color[0, 0, 0])


def test_frames_come_in_order_each_once_with_age_and_sequence(driver: FakeDriver, camera: StreamingCamera) -> None:
    assert isinstance(camera, LiveCamera)
    before_s = host_clock.now_s()
    driver.give(*(images(number) for number in range(3)))
    found = [read(camera) for _ in range(3)]
    assert [frame.sequence for frame in found] == [0, 1, 2]
    assert [number_of(frame.frame) for frame in found] == [frame.frame.index for frame in found] == [0, 1, 2]
    assert camera.read(0.05) is None
    for frame in found:
        assert before_s - 0.5 < frame.frame.stamp_s <= frame.arrived_s <= host_clock.now_s()
        assert frame.age_s(frame.arrived_s + 1) >= 1
        assert frame.stamp_sigma_s > 0
        assert frame.frame.depth_late_s == pytest.approx(0.004)
    assert np.all(np.diff([frame.frame.stamp_s for frame in found]) > 0)
    report = camera.report()
    assert report.status is CameraStatus.STREAMING
    assert (report.frames, report.device_drops, report.host_drops, report.refused) == (3, 0, 0, 0)
    assert report.last_stamp_s == found[-1].frame.stamp_s
    assert camera.warnings == ("it is made by hand",)


def test_what_the_device_lost_is_counted_by_its_numbers(driver: FakeDriver, camera: StreamingCamera) -> None:
    driver.give(images(10), images(11), images(15))
    eventually(lambda: camera.report().frames == 3)
    assert camera.report().device_drops == 3
    assert [frame.index for frame in camera.take()] == [0, 1, 5]


def test_a_count_that_leaps_is_no_loss_of_millions(driver: FakeDriver, camera: StreamingCamera) -> None:
    driver.give(images(1), replace(images(2), sequence=4_000_000_000), replace(images(3), sequence=7))
    eventually(lambda: camera.report().frames == 3)
    assert camera.report().device_drops == 0


def test_the_newest_are_kept_and_the_others_counted(driver: FakeDriver) -> None:
    with StreamingCamera(driver, QUICK.model_copy(update={"kept_frames": 2})) as camera:
        driver.give(*(images(number) for number in range(7)))
        eventually(lambda: camera.report().frames == 7)
        assert camera.report().host_drops == 5
        assert [number_of(frame) for frame in camera.take()] == [5, 6]
        assert camera.take() == []


def test_what_is_too_old_when_it_is_fetched_is_not_handed_out(driver: FakeDriver) -> None:
    with StreamingCamera(driver, QUICK.model_copy(update={"oldest_s": 0.15})) as camera:
        driver.give(images(0))
        eventually(lambda: camera.report().frames == 1)
        time.sleep(0.2)
        assert camera.take() == []
        assert camera.report().stale == 1
        driver.give(images(7))
        assert read(camera).sequence == 7


def test_a_stalled_camera_yields_nothing_and_says_since_when(driver: FakeDriver) -> None:
    with StreamingCamera(driver, QUICK.model_copy(update={"reopen_s": 60.0})) as camera:
        driver.give(images(0))
        arrived_s = read(camera).arrived_s
        eventually(lambda: camera.report().status is CameraStatus.STALLED)
        assert camera.report().since_s == pytest.approx(arrived_s, abs=1e-3)
        assert camera.take() == []
        assert driver.opened == 1
        driver.give(images(1))
        read(camera)
        assert camera.report().status is CameraStatus.STREAMING


def test_a_library_that_hangs_is_reported_as_stalled_and_closing_does_not_wait_for_it(
    driver: FakeDriver, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("wheelsight.io.devices.live_camera._CLOSING_S", 0.1)
    camera = StreamingCamera(driver, QUICK)
    driver.give(images(0))
    read(camera)
    driver.hangs.set()
    eventually(lambda: camera.report().status is CameraStatus.STALLED)
    began_s = time.monotonic()
    camera.close()
    assert time.monotonic() - began_s < 1


def test_a_camera_that_stays_silent_is_opened_again(driver: FakeDriver, camera: StreamingCamera) -> None:
    driver.give(images(0))
    read(camera)
    eventually(lambda: driver.opened == 2)
    assert driver.closed == 1
    eventually(lambda: camera.report().reconnects == 1)


def test_it_reconnects_by_itself_and_says_so(driver: FakeDriver) -> None:
    reported: list[CameraStatus] = []
    with StreamingCamera(driver, QUICK, on_status=reported.append) as camera:
        driver.give(images(500))
        before = read(camera)
        driver.is_there.clear()
        eventually(lambda: camera.report().status is CameraStatus.UNPLUGGED)
        assert camera.take() == []
        eventually(lambda: camera.report().detail == "no camera is plugged in (plug it in)")
        driver.is_there.set()
        driver.give(images(0))  # the device begins again, clock and numbers too
        assert eventually(lambda: camera.report().frames == 2) < 2.0
        after = read(camera)
        assert after.sequence == 0
        assert after.frame.index == before.frame.index + 1
        assert before.frame.stamp_s < after.frame.stamp_s <= after.arrived_s
        report = camera.report()
        assert (report.reconnects, report.device_drops, report.clock_jumps, report.refused) == (1, 0, 0, 0)
    expected = [CameraStatus.STREAMING, CameraStatus.UNPLUGGED, CameraStatus.STARTING, CameraStatus.STREAMING]
    assert reported == [*expected, CameraStatus.CLOSED]


def test_another_camera_does_not_take_its_place(driver: FakeDriver, camera: StreamingCamera) -> None:
    driver.is_there.clear()
    eventually(lambda: camera.report().status is CameraStatus.UNPLUGGED)
    driver.name = "fake 2"
    driver.is_there.set()
    eventually(lambda: "another camera is there: fake 2, not fake 1" in camera.report().detail)
    driver.name = "fake 1"
    eventually(lambda: camera.report().reconnects == 1)


def test_a_duplicate_and_a_frame_out_of_order_are_refused(driver: FakeDriver, camera: StreamingCamera) -> None:
    driver.give(images(0), images(1), images(1), images(3), images(2), images(4))
    eventually(lambda: camera.report().frames == 4)
    assert [number_of(frame) for frame in camera.take()] == [0, 1, 3, 4]
    assert camera.report().refused == 2
    assert camera.report().clock_jumps == 0


@pytest.mark.parametrize("leap_s", [-100.0, 100.0])
def test_a_clock_that_leaps_costs_no_frame_and_stamps_go_on(
    driver: FakeDriver, camera: StreamingCamera, leap_s: float
) -> None:
    for number in range(20):
        driver.give(images(number, 200.0 + number / 30))
        time.sleep(1 / 60)
    for number in range(20, 30):
        driver.give(images(number, 200.0 + number / 30 + leap_s))
        time.sleep(1 / 60)
    found = [read(camera) for _ in range(30)]
    assert camera.report().clock_jumps >= 1
    assert camera.report().refused == 0
    assert np.all(np.diff([frame.frame.stamp_s for frame in found]) > 0)
    assert max(frame.arrived_s - frame.frame.stamp_s for frame in found[20:]) < 0.5
    assert min(frame.arrived_s - frame.frame.stamp_s for frame in found) >= -1e-3


def test_images_of_another_size_or_kind_are_skipped_with_the_reason(
    driver: FakeDriver, camera: StreamingCamera
) -> None:
    driver.give(images(0), images(1, size=(24, 32)), replace(images(2), depth_m=np.ones((48, 64))), images(3))  # type: ignore[arg-type]
    eventually(lambda: camera.report().frames == 2)
    found = camera.take()
    reasons = [event.reason for event in found if isinstance(event, SkippedFrame)]
    assert reasons == ["colour image is 24×32×3, not 48×64×3 (rows first)", "depth image is of float64, not float32"]
    assert [event.index for event in found] == [0, 1, 2, 3]
    assert camera.report().refused == 2


def test_a_played_file_that_ends_hands_out_its_last_frames(driver: FakeDriver, camera: StreamingCamera) -> None:
    driver.give(images(0), images(1))
    driver.end()
    eventually(lambda: camera.report().status is CameraStatus.ENDED)
    assert [read(camera).sequence, read(camera).sequence] == [0, 1]
    assert camera.read(5.0) is None
    assert driver.closed == 1


def test_a_fault_of_a_driver_is_reported_to_anyone_who_asks(driver: FakeDriver, camera: StreamingCamera) -> None:
    driver.give(ValueError("a bug"))
    eventually(lambda: camera.report().status is CameraStatus.CLOSED)
    with pytest.raises(DeviceError, match="driver failed: a bug"):
        camera.take()


def test_a_closed_camera_gives_nothing_and_closes_again(driver: FakeDriver) -> None:
    camera = StreamingCamera(driver, QUICK)
    driver.give(images(0))
    eventually(lambda: camera.report().frames == 1)
    camera.close()
    camera.close()
    assert camera.read(5.0) is None
    assert camera.report().status is CameraStatus.CLOSED
    assert driver.closed == 1


def test_a_given_calibration_must_be_of_the_images(driver: FakeDriver) -> None:
    larger = Calibration.registered_camera(PinholeCamera(128, 96, 120.0, 120.0, 63.5, 47.5))
    with pytest.raises(CalibrationError, match="calibration's colour image is 128×96, the camera's 64×48"):
        StreamingCamera(driver, QUICK, larger)
    assert driver.closed == 1
    T = np.eye(4)
    T[0, 3] = 0.025
    with pytest.raises(CalibrationError, match=r"has a T_color_depth, but the camera registers .*registered: false"):
        StreamingCamera(driver, QUICK, Calibration(CAMERA, CAMERA, T))
    finer = Calibration.registered_camera(replace(CAMERA, fx=61.0))
    with StreamingCamera(driver, QUICK, finer) as camera:
        assert camera.calibration is finer


class TurningDriver(FakeDriver):
    """Has a gyroscope, which shows what a test puts into `turns`."""

    def __init__(self) -> None:
        super().__init__()
        self.turns: deque[DeviceAngularVelocity] = deque()

    def take_angular_velocities(self) -> list[DeviceAngularVelocity]:
        return [self.turns.popleft() for _ in range(len(self.turns))]


def test_a_gyroscope_is_stamped_by_the_clock_that_frames_have_reported_of() -> None:
    driver = TurningDriver()
    driver.turns.append(DeviceAngularVelocity(0.0, 9.0, 9.0, 9.0))  # no frame has reported the clock yet
    with StreamingCamera(driver, QUICK) as camera:
        assert isinstance(camera, HasGyro)
        eventually(lambda: not driver.turns)
        driver.give(images(0, 100.0))
        first = read(camera)
        driver.turns.extend(DeviceAngularVelocity(at_s, 0.1, 0.2, at_s) for at_s in (100.01, 100.015, 100.012, 100.02))
        turns: list[AngularVelocity] = []

        def have_come() -> bool:
            turns.extend(camera.take_angular_velocities())
            return len(turns) >= 3

        eventually(have_come)
        assert [turn.z_rad_s for turn in turns] == [100.01, 100.015, 100.02]  # one was set back
        later_s = [turn.stamp_s - first.frame.stamp_s for turn in turns]
        assert later_s == pytest.approx([0.01, 0.015, 0.02], abs=1e-6)
        assert take_angular_velocities(camera) == []


def test_a_camera_without_a_gyroscope_shows_no_turns(driver: FakeDriver, camera: StreamingCamera) -> None:
    driver.give(images(0))
    read(camera)
    assert camera.take_angular_velocities() == []
    assert take_angular_velocities(None) == ()
