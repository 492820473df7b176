"""Shared parts of all visual odometries: `TrackingState`, the velocity between two poses, `Stopwatch` for the stages of
a step, and undistortion maps.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import cv2
import numpy as np

from wheelsight.core.estimates import Status
from wheelsight.core.geometry import Float32Array, FloatArray, PinholeCamera, se3, so3

# Variance of the first pose. It is exact by definition of the map, but no covariance may be singular.
START_VARIANCE = 1e-12


@dataclass(frozen=True, slots=True)
class TrackingState:
    """The state of tracking: initializing, tracking, failing or lost (Zhang, Fig. 3).

    Attributes:
        lost_after: number of consecutive failed frames after which the state is lost, until a place is recognised.
        has_begun: whether any frame was tracked.
        failures: number of failed frames since the last tracked one.
    """

    lost_after: int
    has_begun: bool = False
    failures: int = 0

    @property
    def is_lost(self) -> bool:
        """Whether at least `lost_after` frames in a row failed."""
        return self.has_begun and self.failures >= self.lost_after

    @property
    def status(self) -> Status:
        """The status of the estimate at the last frame."""
        if not self.has_begun:
            return Status.INITIALIZING
        if self.is_lost:
            return Status.LOST
        return Status.FAILING if self.failures else Status.TRACKING

    def tracked(self) -> TrackingState:
        """The state after a tracked frame."""
        return replace(self, has_begun=True, failures=0)

    def failed(self) -> TrackingState:
        """The state after a failed frame."""
        return replace(self, failures=self.failures + 1)


# Over a longer gap in seconds the mean velocity says little about the velocity at the frame.
LONGEST_STEP_S = 0.35


def twist_between(T_map_before: FloatArray, T_map_now: FloatArray, seconds: float) -> FloatArray:
    """Mean velocity (6,) of a camera between two poses, (v, ω) per second in its own frame."""
    T_before_now = se3.invert(T_map_before) @ T_map_now
    return np.concatenate([T_before_now[:3, 3], so3.log(T_before_now[:3, :3])]) / seconds


class Stopwatch:
    """Adds up seconds by stage name, from one `restart` to the next."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    def restart(self) -> None:
        """Reset all times."""
        self.seconds = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Count the time of a block under `name`."""
        started = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - started


def maps_without_lens(camera: PinholeCamera) -> tuple[Float32Array, Float32Array]:
    """Column and row (h, w) in a camera's images of each pixel of the undistorted image, for `cv2.remap`."""
    size = (camera.width, camera.height)
    maps = cv2.initUndistortRectifyMap(camera.K, np.array(camera.distortion), None, camera.K, size, cv2.CV_32FC1)
    return np.asarray(maps[0], np.float32), np.asarray(maps[1], np.float32)
