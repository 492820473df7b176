"""Colour that is later than depth is found from a panorama past which a robot turns."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from wheelsight.core.calibration import Calibration
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.estimates import Status, WheelEstimate
from wheelsight.core.geometry import Float32Array, FloatArray, PinholeCamera, se3
from wheelsight.core.messages import RgbdFrame
from wheelsight.estimation import ErrorStateFilter
from wheelsight.estimation.agreement import RobotSensor
from wheelsight.estimation.consistency_check import BaseCheck, ColorCheck

CAMERA = PinholeCamera(80, 60, 73.0, 73.0, 39.5, 29.5)
PERIOD_S, READING_S = 0.1, 0.02
_PX_PER_RAD, _BEGIN_PX = 73.0, 200.0


def heading_rad(stamps_s: FloatArray) -> FloatArray:
    """A robot that turns to and fro, with stops between."""
    rate = np.where(np.sin(stamps_s * 2.1) > 0.2, 0.6, 0.0) - np.where(np.sin(stamps_s * 2.1) < -0.3, 0.6, 0.0)
    return np.asarray(np.cumsum(rate) * np.diff(stamps_s, prepend=stamps_s[0] - 1e-3))


TIMES_S = np.arange(0.0, 30.0, 1e-3)
HEADING_RAD = heading_rad(TIMES_S)


def heading_at(stamp_s: float) -> float:
    return float(np.interp(stamp_s, TIMES_S, HEADING_RAD))


class Panorama:
    """What a camera sees sideways: a texture and, independently, boxes at several depths."""

    def __init__(self) -> None:
        rng = np.random.default_rng(3)
        self._grey = cv2.GaussianBlur(rng.uniform(0, 255, (60, 500)).astype(np.float32), (0, 0), 1.5) * 3 - 255
        self._depth_m = np.repeat(np.repeat(rng.uniform(1.0, 4.0, (4, 50)), 15, axis=0), 10, axis=1).astype(np.float32)
        self._rng = rng

    def frame(self, index: int, late: int) -> RgbdFrame:
        stamp_s = index * PERIOD_S
        grey = self._cut(self._grey, heading_at(stamp_s - late * PERIOD_S), cv2.INTER_LINEAR)
        depth_m = self._cut(self._depth_m, heading_at(stamp_s), cv2.INTER_NEAREST)
        grey = np.clip(grey + self._rng.normal(0, 3, grey.shape), 0, 255).astype(np.uint8)
        depth_m += self._rng.normal(0, 0.01, depth_m.shape).astype(np.float32)
        return RgbdFrame(stamp_s, np.repeat(grey[..., None], 3, axis=2), depth_m, index)

    def _cut(self, image: np.ndarray, heading: float, how: int) -> Float32Array:
        move = np.array([[1.0, 0, -(_BEGIN_PX - _PX_PER_RAD * heading)], [0, 1, 0]])
        return np.asarray(cv2.warpAffine(image, move, (80, 60), flags=how), np.float32)


def checked(late: int, wheels_late_s: float = 0.0, seconds: float = 25.0) -> ColorCheck:
    check, view = ColorCheck(), Panorama()
    for index in range(round(seconds / PERIOD_S)):
        for reading in range(5):
            stamp_s = index * PERIOD_S + reading * READING_S
            check.add_heading(stamp_s, heading_at(stamp_s - wheels_late_s))
        check.add_frame(view.frame(index, late))
    return check


@pytest.mark.parametrize("late", [1, 2])
def test_colour_that_is_late_is_reported_by_its_frames(late: int) -> None:
    check = checked(late)
    assert (check.late, check.is_sure, check.is_sound) == (late, True, False)


def test_colour_that_is_not_late_is_known_not_to_be() -> None:
    check = checked(0)
    assert (check.late, check.is_sure, check.is_sound) == (0, False, True)


def test_wheels_whose_clock_is_late_are_no_late_colour() -> None:
    check = checked(0, wheels_late_s=-0.1)
    assert (check.late, check.is_sure) == (0, False)


def test_without_turns_nothing_is_reported() -> None:
    check, view = ColorCheck(), Panorama()
    for index in range(100):
        check.add_heading(index * PERIOD_S, 0.0)
        check.add_frame(view.frame(0, 0))
    assert (check.late, check.is_sure, check.is_sound) == (0, False, False)


def test_a_camera_whose_colour_is_late_is_left_out() -> None:
    T_base_camera = np.array([[0.0, 0, 1, 0.2], [-1, 0, 0, 0], [0, -1, 0, 1.0], [0, 0, 0, 1]])
    wheels = Wheels(0.17, 0.17, 0.52, 3200.0)
    calibration = Calibration.registered_camera(CAMERA, wheels=wheels, T_base_camera=T_base_camera, source="test")
    check, view = BaseCheck(calibration, T_base_camera, ErrorStateFilter(T_base_camera)), Panorama()
    for index in range(250):
        for reading in range(5):
            stamp_s = index * PERIOD_S + reading * READING_S
            T = se3.from_plane(0.0, 0.0, heading_at(stamp_s))
            check.add_wheels(WheelEstimate(stamp_s, Status.TRACKING, T, 1e-6 * np.eye(6), body="base"))
        check.add_frame(view.frame(index, 2))
    assert check.verdict.left_out is RobotSensor.CAMERA
    (warning,) = check.verdict.warnings
    assert "its colour images are 2 frames later than the depth" in warning
