"""FusedCamera: camera odometry beside a filter, which tells it what to expect."""

from __future__ import annotations

import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.config import Config
from wheelsight.estimates import CameraEstimate, Estimate, Reason
from wheelsight.events import RgbdFrame
from wheelsight.fusion import FusedEstimate
from wheelsight.geometry import FloatArray, se3
from wheelsight.geometry import motion_kernels as motions
from wheelsight.localizer._camera import CameraOdometry, camera_odometry
from wheelsight.localizer._frame_gate import FrameGate
from wheelsight.localizer.choice import NO_PARTS, OwnParts
from wheelsight.odometry.dense import DenseOdometry
from wheelsight.odometry.features import FeatureEstimate, MatchedPixels
from wheelsight.slam.known import KnownMap

BLIND = (Reason.TOO_LITTLE_DEPTH, Reason.FRAME_UNUSABLE, Reason.TOO_FEW_KEYPOINTS)


class FusedCamera:
    """See the module.

    Attributes:
        odometry: the camera's.
        mapper: builds a map, where one is asked for.
        gate: which frames are worth being aligned.
        unknown: so many frames in a row showed nothing known.
        last_matches: what the last frame was aligned by; dense odometry matches no pixels.
    """

    def __init__(
        self,
        calibration: Calibration,
        settings: Config,
        T_base_camera: FloatArray,
        known: KnownMap | None = None,
        parts: OwnParts = NO_PARTS,
    ) -> None:
        self.odometry, self.mapper = camera_odometry(calibration, settings, known, parts)
        self._of = calibration, settings, None, parts
        self._settings = settings.fusion.joining
        self.gate = FrameGate(settings.localizer.frame_gate)
        self.unknown = 0
        self.last_matches: MatchedPixels | None = None
        self._Ad_camera_base = motions.inverse_adjoint(T_base_camera)
        self._pace = Pace(settings.localizer.pace_s)
        self._slips = False

    @property
    def is_lost(self) -> bool:
        """Whether so many frames showed nothing known that the camera had better start again."""
        return self.unknown >= self._settings.restart_after

    def another(self) -> CameraOdometry:
        """Odometry of the same camera that knows nothing yet."""
        return camera_odometry(*self._of)[0]

    def forget_frame(self) -> None:
        """The last frame is over."""
        self.last_matches = None

    def twist(self, answer: FusedEstimate) -> FloatArray | None:
        """The camera's velocity (6,) in its own frame, by the wheels; None where they slip or tell nothing."""
        if self._slips or answer.twist is None:
            return None
        return np.asarray(self._Ad_camera_base @ np.array([*answer.twist[:2], 0.0, 0.0, 0.0, answer.twist[2]]))

    def process(
        self, frame: RgbdFrame, by_wheels: FloatArray | None, twist: FloatArray | None, *, ask_wheels: bool
    ) -> CameraEstimate:
        """T_map_camera at a frame, where `by_wheels` (4, 4) is its motion since the last one, if they may be asked."""
        expected = self._expected(frame.stamp_s, by_wheels) if ask_wheels else (None,)
        seen = self.odometry.process(frame, *expected, twist=twist)
        self.last_matches = seen.matched if isinstance(seen, FeatureEstimate) else None
        if seen.T_odom_body is not None:
            self._pace.tell(frame.stamp_s, seen.T_odom_body)
        return seen

    def begin_at(self, T_map_camera: FloatArray) -> None:
        """Where the camera is (4, 4), if the next frame is the first one that shows enough."""
        self.odometry.begin_at(T_map_camera)

    def moved(self, T_new_old: FloatArray) -> None:
        """Loops have moved the map by (4, 4), from the left, where the camera is."""
        self._pace.moved(T_new_old)

    def restart(self, frame: RgbdFrame, T_map_camera: FloatArray, covariance: FloatArray) -> CameraEstimate:
        """T_map_camera at a frame that shows nothing known, from which the camera goes on where others have it."""
        self.unknown = 0
        return self.odometry.restart(frame, T_map_camera, covariance)

    def miss(self, seen: Estimate) -> bool:
        """Take a frame that gave no pose; whether it showed anything, which then is nothing known."""
        if seen.reason in BLIND:
            return False
        self.unknown += 1
        return True

    def lead(self, answer: FusedEstimate) -> None:
        """Who is asked what to expect of the next frame: the wheels or, where these slip, the last motion.

        What slips expects what is not so.
        """
        self._slips = answer.slip

    def _expected(self, stamp_s: float, by_wheels: FloatArray | None) -> tuple[FloatArray | None, ...]:
        """The camera's motion since the last frame; and what it may be instead, for wheels that slip may grip again."""
        if not self._slips:
            return (by_wheels,)
        by_pace = self._pace.expect(stamp_s)
        return (by_pace, by_wheels) if isinstance(self.odometry, DenseOdometry) else (by_pace,)


class Pace:
    """Where a camera would be that goes on as it went last, for when the wheels cannot be asked.

    Args:
        longest_step_s: over a longer gap the velocity is unknown.
    """

    def __init__(self, longest_step_s: float) -> None:
        self.longest_step_s = longest_step_s
        self._before: tuple[float, FloatArray] | None = None
        self._last: tuple[float, FloatArray] | None = None

    def tell(self, stamp_s: float, T_map_camera: FloatArray) -> None:
        """A tracked frame's pose (4, 4)."""
        self._before, self._last = self._last, (stamp_s, T_map_camera)

    def moved(self, T_new_old: FloatArray) -> None:
        """The map has moved by (4, 4), from the left."""
        self._before, self._last = (told and (told[0], T_new_old @ told[1]) for told in (self._before, self._last))

    def expect(self, stamp_s: float) -> FloatArray | None:
        """T_last_current (4, 4) at constant velocity; None where that is unknown or too long ago."""
        if self._before is None or self._last is None:
            return None
        seconds, since_s = self._last[0] - self._before[0], stamp_s - self._last[0]
        if not (0 < seconds <= self.longest_step_s and 0 < since_s <= self.longest_step_s):
            return None
        return se3.exp(se3.log(se3.invert(self._before[1]) @ self._last[1]) * (since_s / seconds))
