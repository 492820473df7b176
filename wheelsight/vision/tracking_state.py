"""`CameraOdometry`, the base of all visual odometries, with its `TrackingState` and the `Stopwatch` of its stages."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar

import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.checks import need_calibration, need_motion
from wheelsight.core.estimates import CameraEstimate, MotionEstimate, Reason, Status
from wheelsight.core.geometry import FloatArray, se3, so3
from wheelsight.core.keyframes import KeyframeStore
from wheelsight.core.stamps import StampCheck
from wheelsight.core.threads import OneCaller, one_at_a_time

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


Answer = TypeVar("Answer", bound=CameraEstimate)


class CameraOdometry(OneCaller, Generic[Answer]):
    """Base of the visual odometries: first pose, tracking state, failures and times.

    Args:
        calibration: of the cameras.
        estimate: the class of the estimates.
        lost_after: number of consecutive failed frames after which the state is lost.
        T_map_first: (4, 4) pose of the camera at the first tracked frame; default the map's origin.
        store: receives keyframes; default a new one.
    """

    def __init__(
        self,
        calibration: Calibration,
        estimate: type[Answer],
        lost_after: int,
        T_map_first: FloatArray | None,
        store: KeyframeStore | None,
    ) -> None:
        self._calibration, self._estimate = need_calibration(calibration), estimate
        self.store, self.watch = KeyframeStore() if store is None else store, Stopwatch()
        self._state, self._stamps = TrackingState(lost_after), StampCheck()
        self.begin_at(np.eye(4) if T_map_first is None else T_map_first)

    @property
    def stage_seconds(self) -> dict[str, float]:
        """Seconds the last frame spent in each stage."""
        return self.watch.seconds

    @one_at_a_time
    def begin_at(self, T_map_camera: FloatArray) -> None:
        """Set the pose (4, 4) of the camera at the first tracked frame. Raises ArgumentError for no rigid motion."""
        self._T_map_first = need_motion("T_map_first", T_map_camera)

    @one_at_a_time
    def miss(self, stamp_s: float) -> Answer:
        """Count a frame that is unusable, and so never reached `process`, as a failed one."""
        self._start_frame()
        return self._fail(stamp_s, MotionEstimate.failed(Reason.FRAME_UNUSABLE))

    def _start_frame(self) -> None:
        self.watch.restart()

    def _fail(self, stamp_s: float, failure: MotionEstimate, **more: Any) -> Answer:
        """The estimate of a failed frame."""
        self._state = self._state.failed()
        return self._estimate(
            stamp_s,
            self._state.status,
            reason=failure.reason,
            matches=failure.matches,
            inliers=failure.inliers,
            motion=failure,
            **more,
        )
