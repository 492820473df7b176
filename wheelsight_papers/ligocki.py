"""Fusion of wheel and visual odometry with a constant weight, after Ligocki: the localizer and its filter.

From the paper: the state of one axis, x_k = (wheel_k, visual_k, wheel_k-1, visual_k-1); the matrix H of eq. 2, which
gives the fused position and velocity, z_k = H x_k, with a weight C, 0 ≪ C < 1; and its purpose: "larger weight on
short-term accurate data from Wheel Odometry and smaller weight on the longer term reliable data from Visual Odometry".

Ours, because the paper does not describe it: the process. No sensor measures z, so z is the estimate and the sensors
drive x. If wheel_k were the pose of the wheels alone, the estimate would keep the share C of their drift for ever, and
nothing would be reliable in the long term. So the wheels continue from the last estimate, wheel_k = z_k-1 + Δwheel:

    x_k = A x_k-1 + (Δwheel, Δvisual, 0, 0) + w_k,  A = ((C, 1-C, 0, 0), (0, 1, 0, 0), (C, 1-C, 0, 0), (0, 1, 0, 0)),

with P_k = A P_k-1 Aᵀ + Q, the time update of Welch & Bishop. The first row of A is that of H. Steps of the wheels are
rotated by the yaw between their frame and the estimate's. Yaw is not wrapped. Without a visual pose, vision moves as
the wheels do. The estimate follows the wheels at once, and vision with the time constant -Δt / log C.

Limits: the weight is constant, whatever the errors of the sensors; slip and jumps of vision enter the estimate; both
sensors must start in the same frame; it is planar; its covariance is that of Q, not of the sensors.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.config import Config
from wheelsight.core.calibration import Calibration
from wheelsight.core.checks import Untimed
from wheelsight.core.errors import ConfigError
from wheelsight.core.estimates import NO_DECISION, Estimate, PoseDecision, PoseEvidence, PoseFinding, Reason, decide
from wheelsight.core.geometry import FloatArray, se2, se3
from wheelsight.core.messages import Event, RgbdFrame, SkippedFrame
from wheelsight.core.settings.fusion import LigockiSettings
from wheelsight.estimation.camera_localizer import ByFrames, mount_of
from wheelsight.estimation.odometry_choice import NO_PARTS, OwnParts
from wheelsight.estimation.wheel_localizer import ByWheels
from wheelsight.vision.features import MatchedPixels


class ByLigocki:
    """Answers frames by eq. 2. Both sensors start at the identity at the first tracked frame.

    Attributes:
        odometry: of the camera.
        keyframes: of the camera.
        mapper: builds a map of the camera alone, if the settings ask for one.
        T_odom_map: (4, 4) pose of that map at the last frame with poses of both sensors.
    """

    body, frame, answers = "base", "map", (RgbdFrame, SkippedFrame)
    last_place = loops = None

    def __init__(self, calibration: Calibration, settings: Config, parts: OwnParts = NO_PARTS) -> None:
        mount_of(calibration)  # raises if it is not known
        self._wheels = ByWheels(calibration, settings.wheels)
        self.hears: tuple[type[Event], ...] = (*self._wheels.hears, *self.answers)
        self._camera = ByFrames(calibration, settings, parts=parts)
        self.odometry, self.mapper = self._camera.odometry, self._camera.mapper
        self.keyframes, self.watch = self._camera.keyframes, self._camera.watch
        assert calibration.any_wheels is not None  # ByWheels has refused it
        self._max_gap_s = calibration.any_wheels.max_gap_s
        self._filter = LigockiFilter(settings.fusion.ligocki)
        self._rolled: Estimate | None = None
        self._answer: Estimate | None = None
        self._T_begin_odom: FloatArray | None = None
        self.T_odom_map: FloatArray = np.eye(4)

    @property
    def last_matches(self) -> MatchedPixels | None:
        """Pixels by which the last frame was aligned."""
        return self._camera.last_matches

    @property
    def warnings(self) -> tuple[str, ...]:
        """Fault of the gyroscope, as a sentence."""
        return self._wheels.warnings

    def process(self, event: Event) -> tuple[Estimate | None, str]:
        """Return the fused estimate at a frame, None at any other event, and a note on the frame."""
        rolled, _ = self._wheels.process(event)
        if rolled is not None:
            self._rolled = rolled
        seen, note = self._camera.process(event)
        return None if seen is None else self._joined(seen), note

    def refuse(self, event: Event, why: Untimed) -> tuple[Estimate | None, str]:
        """Return the fused estimate at a frame with an invalid stamp, None at any other event."""
        if not isinstance(event, RgbdFrame | SkippedFrame):
            return None, ""
        seen, note = self._camera.refuse(event, why)
        return self._joined(seen), note

    def _joined(self, seen: Estimate) -> Estimate:
        if not math.isfinite(seen.stamp_s):
            return seen
        if seen.reason is Reason.REPEATED and self._answer is not None:
            return replace(self._answer, reason=Reason.REPEATED)
        if self._rolled is None or self._rolled.T_odom_body is None:
            return replace(seen, T_odom_body=None, covariance=None, status=NO_DECISION.status)
        # The wheels' velocity predicts the pose at the frame, for at most the longest gap.
        seconds = min(max(seen.stamp_s - self._rolled.stamp_s, 0.0), self._max_gap_s)
        T_odom_base = self._rolled.T_odom_body @ self._wheels.odometry.motion_in(seconds)
        if self._T_begin_odom is None:
            if seen.T_odom_body is None:
                return seen
            self._T_begin_odom = seen.T_odom_body @ se3.invert(T_odom_base)
        T_visual = None if seen.T_odom_body is None else se3.nearest(seen.T_odom_body)
        joined = self._filter.update(seen.stamp_s, se3.nearest(self._T_begin_odom @ T_odom_base), T_visual)
        reason = joined.reason or seen.reason
        if T_visual is not None and joined.T_odom_body is not None:
            self.T_odom_map = se3.nearest(joined.T_odom_body @ se3.invert(T_visual))
        self._answer = replace(joined, reason=reason, matches=seen.matches, inliers=seen.inliers)
        return self._answer


_BY_BOTH, _BY_WHEELS, _NOT_LATER = (
    decide([PoseEvidence(finding)])
    for finding in (PoseFinding.TRACKED, PoseFinding.WHEELS_ALONE, PoseFinding.NOT_LATER)
)
_PLANE = np.array([0, 1, 5])
# σ of the drift of x, y and yaw, in metres and radians per √s, for the covariance alone.
_WHEEL_DRIFT, _VISUAL_DRIFT = np.array([0.02, 0.02, 0.02]), np.array([0.005, 0.005, 0.003])


@dataclass(frozen=True, slots=True, eq=False)
class JoinedEstimate(Estimate):
    """The fused pose and its velocity.

    Attributes:
        velocity: (3,) of x, y in m/s in the map frame and of yaw in rad/s, by the second rows of eq. 2; or None.
        velocity_covariance: (3, 3), or None.
    """

    velocity: FloatArray | None = None
    velocity_covariance: FloatArray | None = None


def measurement_matrix(weight: float, dt_s: float) -> FloatArray:
    """Return H (2, 4) of eq. 2, for one axis."""
    C = weight
    return np.array([[C, 1 - C, 0, 0], np.array([C, 1 - C, -C, C - 1]) / dt_s])


def process_matrix(weight: float) -> FloatArray:
    """Return A (4, 4): wheels continue from the last estimate and vision from its pose; both are remembered."""
    C = weight
    return np.array([[C, 1 - C, 0, 0], [0, 1, 0, 0], [C, 1 - C, 0, 0], [0, 1, 0, 0]])


class LigockiFilter:
    """Fuses poses of wheels and vision. The same input gives the same result bit for bit.

    Args:
        settings: of the filter; None for the defaults.
    """

    def __init__(self, settings: LigockiSettings | None = None) -> None:
        self._weight = (settings or LigockiSettings()).weight
        self._Q = np.zeros((3, 4, 4))
        self._Q[:, 0, 0], self._Q[:, 1, 1] = _WHEEL_DRIFT**2, _VISUAL_DRIFT**2
        self._x, self._P = np.zeros((3, 4)), np.zeros((3, 4, 4))  # x, y, yaw; each the state of eq. 2
        self._stamp_s: float | None = None
        self._wheels = np.zeros(3)

    def update(self, stamp_s: float, T_odom_base: ArrayLike, T_map_base_visual: ArrayLike | None) -> JoinedEstimate:
        """Return the fused pose at a stamp at which both poses are known.

        Args:
            stamp_s: later than the last one.
            T_odom_base: (4, 4) or (3, 3) by the wheels alone.
            T_map_base_visual: (4, 4) or (3, 3) by vision alone, in a frame that starts with odom; or None.

        Returns:
            `Status.TRACKING` with the pose, `COASTING` without vision. At a stamp that is not later: `FAILING` with
            `CLOCK_BACKWARDS` and the previous pose.

        Raises:
            ConfigError: an invalid pose or stamp.
        """
        wheels = _planar(T_odom_base)
        visual = None if T_map_base_visual is None else _planar(T_map_base_visual)
        if not np.isfinite(stamp_s):
            raise ConfigError(f"stamp_s is {stamp_s}", fix="seconds")
        decided = _BY_WHEELS if visual is None else _BY_BOTH
        if self._stamp_s is None:
            self._stamp_s, self._wheels = stamp_s, wheels
            begin = wheels if visual is None else wheels + _unwrapped(visual - wheels)
            self._x[:] = np.stack([wheels, begin] * 2, axis=-1)
            return self._estimate(decided, None)
        dt_s = stamp_s - self._stamp_s
        if dt_s <= 0:
            return self._estimate(_NOT_LATER, None)
        H, A = measurement_matrix(self._weight, dt_s), process_matrix(self._weight)
        yaw_rad = (self._x @ H[0])[2] - self._wheels[2]
        c, s = np.cos(yaw_rad), np.sin(yaw_rad)
        turned = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        wheel_step = turned @ _unwrapped(wheels - self._wheels)
        visual_step = wheel_step if visual is None else _unwrapped(visual - self._x[:, 1])
        self._x = self._x @ A.T
        self._x[:, 0] += wheel_step
        self._x[:, 1] += visual_step
        self._P = A @ self._P @ A.T + self._Q * dt_s
        self._wheels = wheels
        self._stamp_s = stamp_s
        return self._estimate(decided, dt_s)

    def _estimate(self, decided: PoseDecision, dt_s: float | None) -> JoinedEstimate:
        assert self._stamp_s is not None
        H = measurement_matrix(self._weight, dt_s or 1.0)
        joined, spread = self._x @ H.T, H @ self._P @ H.T
        x, y, yaw = joined[:, 0]
        # From x, y, yaw to the left perturbation, which rotates about the map's origin.
        J = np.array([[1.0, 0.0, y], [0.0, 1.0, -x], [0.0, 0.0, 1.0]])
        covariance = np.zeros((6, 6))
        covariance[np.ix_(_PLANE, _PLANE)] = J @ np.diag(spread[:, 0, 0]) @ J.T
        moving = (None, None) if dt_s is None else (joined[:, 1], np.diag(spread[:, 1, 1]))
        pose = (se3.from_plane(x, y, yaw), covariance, decided.reason, "base", 0, 0)
        return JoinedEstimate(self._stamp_s, decided.status, *pose, *moving)


def _planar(T: ArrayLike) -> FloatArray:
    """Return x, y, yaw (3,) of a motion (4, 4) or (3, 3)."""
    T = np.asarray(T, float)
    if T.shape == (3, 3) and np.isfinite(T).all():
        T = se3.from_plane(*se2.to_parts(T)) if np.allclose(T[:2, :2] @ T[:2, :2].T, np.eye(2), atol=1e-6) else T
    if T.shape != (4, 4) or not se3.is_valid(T):
        raise ConfigError("a pose to fuse is invalid", fix="a rigid motion, (4, 4) or (3, 3)")
    return np.array([T[0, 3], T[1, 3], np.arctan2(T[1, 0], T[0, 0])])


def _unwrapped(step: FloatArray) -> FloatArray:
    return np.array([step[0], step[1], float(se2.wrap_angle(step[2]))])
