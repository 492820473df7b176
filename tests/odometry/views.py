"""Frames of the synthetic room, what odometry says of them, and how far that is from the truth."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Protocol, TypeVar

import numpy as np
from narrowing import not_none
from synthetic import CAMERA, render_room

from wheelsight.core.calibration import Calibration
from wheelsight.core.estimates import Estimate
from wheelsight.core.geometry import FloatArray, PinholeCamera, se3, so3
from wheelsight.core.messages import RgbdFrame
from wheelsight.vision.features import FeatureOdometry, FeatureSettings

FRAME_S = 1 / 30
E_co = TypeVar("E_co", bound=Estimate, covariant=True)


def room_frame(
    T_map_camera: FloatArray,
    stamp_s: float,
    camera: PinholeCamera = CAMERA,
    seed: int = 0,
    *,
    depth_noise: bool = False,
    blank: bool = False,
) -> RgbdFrame:
    """The room as a registered camera sees it."""
    return RgbdFrame(stamp_s, *render_room(T_map_camera, camera, seed, depth_noise, blank))


def covered_frame(stamp_s: float, camera: PinholeCamera = CAMERA) -> RgbdFrame:
    """What a camera sees whose lens is covered: nothing."""
    size = (camera.height, camera.width)
    return RgbdFrame(stamp_s, np.zeros((*size, 3), np.uint8), np.zeros(size, np.float32))


def room_frames(trajectory: Iterable[tuple[float, FloatArray]], **how: Any) -> list[RgbdFrame]:
    """The room seen along a trajectory."""
    return [room_frame(T_map_camera, stamp_s, **how) for stamp_s, T_map_camera in trajectory]


def odometry(calibration: Calibration | None = None, **settings: Any) -> FeatureOdometry:
    """Feature odometry of the room's camera unless another is given."""
    return FeatureOdometry(calibration or Calibration.registered_camera(CAMERA), FeatureSettings(**settings))


class VisualOdometry(Protocol[E_co]):
    """What answers to the frames of a camera."""

    def process(self, frame: RgbdFrame, /) -> E_co: ...


def run(subject: VisualOdometry[E_co], frames: Iterable[RgbdFrame]) -> list[E_co]:
    """What it answers, frame by frame."""
    return [subject.process(frame) for frame in frames]


def from_start(T_map_camera: FloatArray) -> FloatArray:
    """Poses (N, 4, 4) in the frame of the first, which is odometry's world."""
    return se3.invert(T_map_camera[0]) @ T_map_camera


def error_of(estimate: Estimate, T_map_camera: FloatArray) -> tuple[float, float]:
    """Metres and radians between an estimate and the truth (4, 4) in its world."""
    assert estimate.T_odom_body is not None, f"no pose: {estimate.reason}"
    apart = se3.invert(T_map_camera) @ estimate.T_odom_body
    return float(np.linalg.norm(apart[:3, 3])), float(so3.angle(apart[:3, :3]))


def nees(estimate: Estimate, T_map_camera: FloatArray) -> float:
    """Normalised estimation error squared of a pose: chi-square with six degrees of freedom where it is honest."""
    error = se3.log(T_map_camera @ se3.invert(not_none(estimate.T_odom_body)))
    return float(error @ np.linalg.solve(not_none(estimate.covariance), error))
