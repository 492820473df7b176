"""Clocks of camera and wheels that are apart by less, or otherwise, than receipt shows: the turns of both show it."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from written_bags import COLOR, DEPTH, FOCAL_PX, HEIGHT, OPTICAL, START_S, WIDTH, camera_drive, depth_mm

from wheelsight.core.geometry import ByteArray, FloatArray
from wheelsight.core.messages import RgbdFrame, WheelSpeeds, YawRate
from wheelsight.io.recordings.inspection import inspect_recording

ODOM, IMU = "/odom", "/imu"
SECONDS = 20.0


def wandering(at_s: Any) -> Any:
    """The heading of a robot that turns now and then, radians."""
    return 0.5 * np.sin(0.7 * at_s) + 0.25 * np.sin(1.9 * at_s)


def straight(at_s: Any) -> Any:
    return 0.0 * at_s


def circling(at_s: Any) -> Any:
    """The rate is the same all along: no difference of clocks shows."""
    return 0.3 * at_s


def panorama() -> FloatArray:
    """(HEIGHT, W) grey values of what is around, smooth over some pixels."""
    rough = np.random.default_rng(3).integers(0, 256, (HEIGHT // 4, 400)).astype(float)
    return np.kron(rough, np.ones((4, 4)))


AROUND = panorama()


def view(heading_rad: float) -> ByteArray:
    columns = (np.arange(WIDTH) + 600 - FOCAL_PX * heading_rad) % AROUND.shape[1]
    low, share = columns.astype(int), columns % 1
    grey = (1 - share) * AROUND[:, low] + share * AROUND[:, (low + 1) % AROUND.shape[1]]
    return np.repeat(grey.astype(np.uint8)[..., None], 3, axis=2)


def drive(
    heading: Callable[[Any], Any], camera_ahead_s: float, *, is_converted: bool = False, imu_ahead_s: float = 0.0
) -> Any:
    """Of a robot that turns on the spot; the camera's headers are ahead. A converted bag has headers for receipts."""
    made = camera_drive(frames=0)
    make: Any = made.make
    made.add(0.0, "/camera/color/camera_info", make.info(OPTICAL))

    def received(at_s: float, header_s: float, late_s: float) -> float:
        return header_s if is_converted else at_s + late_s

    for number, at_s in enumerate(np.arange(0.05, SECONDS, 0.1).tolist()):
        header_s = at_s + camera_ahead_s
        made.add(received(at_s, header_s, 0.04), COLOR, make.image(header_s, OPTICAL, "rgb8", view(heading(at_s))))
        made.add(received(at_s, header_s, 0.05), DEPTH, make.image(header_s, OPTICAL, "16UC1", depth_mm(number)))
    for at_s in np.arange(0, SECONDS, 0.04).tolist():
        rate = float(heading(at_s + 0.02) - heading(at_s - 0.02)) / 0.04
        odometry = make.odometry(at_s, (0.0, 0.0, float(heading(at_s))), (0.0, rate))
        made.add(at_s + 0.002, ODOM, odometry)
        imu_s = at_s + imu_ahead_s
        made.add(received(at_s, imu_s, 0.002), IMU, make.imu(imu_s, "base_link", (0, 0, rate), (0, 0, 9.81)))
    return made


def begins_s(recording: Any) -> dict[type, float]:
    """When the first event of each kind is, seconds since the drive began."""
    first: dict[type, float] = {}
    for event in recording.events():
        first.setdefault(type(event), event.stamp_s - START_S)
    return first


@pytest.mark.parametrize("is_converted", [False, True])
@pytest.mark.parametrize("ahead_s", [0.1, 0.3, 1.0, -0.4])
def test_turns_show_how_far_clocks_are_apart(opened: Any, ahead_s: float, is_converted: bool) -> None:
    recording = opened(drive(wandering, ahead_s, is_converted=is_converted))
    (sentence,) = [w for w in recording.warnings if w.startswith(ODOM) and "by the turns" in w] or [""]
    begin = begins_s(recording)
    # A frame and readings of one moment have one stamp: the first frame is 0.05 s after the first readings.
    assert begin[RgbdFrame] - begin[WheelSpeeds] == pytest.approx(0.05, abs=0.01)
    assert begin[RgbdFrame] - begin[YawRate] == pytest.approx(0.05, abs=0.01)
    # Where receipt shows it, to within its delay of 0.04 s, turns find the rest.
    rest_s = ahead_s if is_converted or abs(ahead_s) < 0.5 else 0.038
    found = re.search(r"stamps are (\d\.\d+) s (ahead|behind) \(σ 0\.00\d s, correlation", sentence)
    assert found is not None, sentence
    assert float(found[1]) == pytest.approx(abs(rest_s), abs=0.01)
    assert found[2] == ("ahead" if rest_s > 0 else "behind")


def test_clocks_that_agree_stay(opened: Any) -> None:
    recording = opened(drive(wandering, 0.0))
    assert not [w for w in recording.warnings if "turns" in w]
    assert begins_s(recording) == pytest.approx({RgbdFrame: 0.05, WheelSpeeds: 0.0, YawRate: 0.0})


@pytest.mark.parametrize("heading", [straight, circling])
def test_without_turns_that_differ_nothing_is_claimed(opened: Any, heading: Callable[[Any], Any]) -> None:
    recording = opened(drive(heading, 0.3))
    assert not [w for w in recording.warnings if "turns" in w]
    assert begins_s(recording)[RgbdFrame] == pytest.approx(0.35)
    motion = inspect_recording(recording).motion
    assert motion is not None
    assert motion.offset_s is None
    assert "show it" in motion.why_not if heading is straight else "other differences" in motion.why_not
