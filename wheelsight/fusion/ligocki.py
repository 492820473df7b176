"""LigockiFilter: wheels and vision joined with a constant weight, by eq. 2 of Ligocki's paper.

The paper's: the state of one axis, x_k = (wheel_k, visual_k, wheel_k-1, visual_k-1); the matrix H of eq. 2, which makes
of it the joined position and velocity, z_k = H x_k, with a weight C, 0 ≪ C < 1; and what this is for: "larger weight on
short-term accurate data from Wheel Odometry and smaller weight on the longer term reliable data from Visual Odometry".

Ours, because the paper is silent: the process. No sensor measures z, so z is what the filter answers, and x has to be
told by the sensors. Were wheel_k where the wheels alone believe to be, the answer would keep the share C of their drift
for ever, and nothing would be long-term reliable. So the wheels go on from the last answer, wheel_k = z_k-1 + Δwheel:

    x_k = A x_k-1 + (Δwheel, Δvisual, 0, 0) + w_k,   A = ((C, 1-C, 0, 0), (0, 1, 0, 0), (C, 1-C, 0, 0), (0, 1, 0, 0)),

with P_k = A P_k-1 Aᵀ + Q, the time update of Welch & Bishop. The first row of A is that of H. The steps of the wheels
are turned by the yaw between their frame and the answer's; yaw is not wrapped; without a visual pose vision moves as
the wheels do. The answer then follows wheels at once and vision with the time constant -Δt / log C.

What it cannot do: the weight is constant, whatever the sensors know of their errors; a slip or a leap of vision goes
into the answer as it comes; both must begin in the same frame; it is planar; its covariance is that of Q, not of the
sensors.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.errors import ConfigError
from wheelsight.estimates import Estimate, Reason, Status
from wheelsight.geometry import FloatArray, se2, se3
from wheelsight.settings import CHOSEN, Settings, setting

_PLANE = np.array([0, 1, 5])


class LigockiSettings(Settings):
    """What the paper leaves open; unknown names are refused."""

    weight: float = setting(
        0.95,
        "C of eq. 2, of the wheels in each frame; the paper asks for 0 ≪ C < 1",
        "Ligocki's paper, eq. 2: 0 ≪ C < 1; the figure is chosen",
        ge=0.5,
        lt=1,
    )
    wheel_sigma_m_per_sqrt_s: float = setting(0.02, "how wheels drift, for the covariance only", CHOSEN, ge=0, le=100)
    wheel_sigma_rad_per_sqrt_s: float = setting(0.02, "likewise in yaw", CHOSEN, ge=0, le=100)
    visual_sigma_m_per_sqrt_s: float = setting(
        0.005, "how vision drifts, for the covariance only", CHOSEN, ge=0, le=100
    )
    visual_sigma_rad_per_sqrt_s: float = setting(0.003, "likewise in yaw", CHOSEN, ge=0, le=100)


@dataclass(frozen=True, slots=True, eq=False)
class JoinedEstimate(Estimate):
    """The joined pose, and how fast it moves.

    Attributes:
        velocity: (3,) of x, y in m/s in the map frame and of yaw in rad/s: the second rows of eq. 2. Or None.
        velocity_covariance: (3, 3), or None.
    """

    velocity: FloatArray | None = None
    velocity_covariance: FloatArray | None = None


def measurement_matrix(weight: float, dt_s: float) -> FloatArray:
    """H (2, 4) of eq. 2, for one axis."""
    C = weight
    return np.array([[C, 1 - C, 0, 0], np.array([C, 1 - C, -C, C - 1]) / dt_s])


def process_matrix(weight: float) -> FloatArray:
    """A (4, 4): wheels go on from the last answer, vision from where it was, and both are remembered."""
    C = weight
    return np.array([[C, 1 - C, 0, 0], [0, 1, 0, 0], [C, 1 - C, 0, 0], [0, 1, 0, 0]])


class LigockiFilter:
    """Poses of wheels and vision in, the joined pose out; the same input gives the same answer to the last bit.

    Args:
        settings: see there.
    """

    def __init__(self, settings: LigockiSettings | None = None) -> None:
        self.settings = settings or LigockiSettings()
        s = self.settings
        wheel = np.array([s.wheel_sigma_m_per_sqrt_s] * 2 + [s.wheel_sigma_rad_per_sqrt_s])
        visual = np.array([s.visual_sigma_m_per_sqrt_s] * 2 + [s.visual_sigma_rad_per_sqrt_s])
        self._Q = np.zeros((3, 4, 4))
        self._Q[:, 0, 0], self._Q[:, 1, 1] = wheel**2, visual**2
        self._x, self._P = np.zeros((3, 4)), np.zeros((3, 4, 4))  # x, y, yaw; each the state of eq. 2
        self._stamp_s: float | None = None
        self._wheels = np.zeros(3)

    def update(self, stamp_s: float, T_odom_base: ArrayLike, T_map_base_visual: ArrayLike | None) -> JoinedEstimate:
        """The joined pose at a stamp at which both are known.

        Args:
            stamp_s: later than the last one.
            T_odom_base: (4, 4) or (3, 3) by the wheels alone.
            T_map_base_visual: (4, 4) or (3, 3) by vision alone, in the frame that began where odom did; or None.

        Returns:
            `Status.TRACKING` with the pose, `COASTING` without vision; `FAILING` with `CLOCK_BACKWARDS`, and the pose
            left as it was, at a stamp that is not later.

        Raises:
            ConfigError: a pose or stamp that is none.
        """
        wheels = _planar(T_odom_base)
        visual = None if T_map_base_visual is None else _planar(T_map_base_visual)
        if not np.isfinite(stamp_s):
            raise ConfigError(f"stamp_s is {stamp_s}", fix="seconds")
        status = Status.TRACKING if visual is not None else Status.COASTING
        if self._stamp_s is None:
            self._stamp_s, self._wheels = stamp_s, wheels
            begin = wheels if visual is None else wheels + _unwrapped(visual - wheels)
            self._x[:] = np.stack([wheels, begin] * 2, axis=-1)
            return self._estimate(status, None)
        dt_s = stamp_s - self._stamp_s
        if dt_s <= 0:
            return self._estimate(Status.FAILING, None, Reason.CLOCK_BACKWARDS)
        self._go_on(wheels, visual, dt_s)
        self._stamp_s = stamp_s
        return self._estimate(status, dt_s)

    def _go_on(self, wheels: FloatArray, visual: FloatArray | None, dt_s: float) -> None:
        H, A = measurement_matrix(self.settings.weight, dt_s), process_matrix(self.settings.weight)
        turned = _rotation((self._x @ H[0])[2] - self._wheels[2])
        wheel_step = turned @ _unwrapped(wheels - self._wheels)
        visual_step = wheel_step if visual is None else _unwrapped(visual - self._x[:, 1])
        self._x = self._x @ A.T
        self._x[:, 0] += wheel_step
        self._x[:, 1] += visual_step
        self._P = A @ self._P @ A.T + self._Q * dt_s
        self._wheels = wheels

    def _estimate(self, status: Status, dt_s: float | None, reason: Reason | None = None) -> JoinedEstimate:
        assert self._stamp_s is not None
        H = measurement_matrix(self.settings.weight, dt_s or 1.0)
        joined, spread = self._x @ H.T, H @ self._P @ H.T
        x, y, yaw = joined[:, 0]
        # From x, y, yaw to the perturbation from the left, which turns about the map's origin.
        J = np.array([[1.0, 0.0, y], [0.0, 1.0, -x], [0.0, 0.0, 1.0]])
        covariance = np.zeros((6, 6))
        covariance[np.ix_(_PLANE, _PLANE)] = J @ np.diag(spread[:, 0, 0]) @ J.T
        moving = (None, None) if dt_s is None else (joined[:, 1], np.diag(spread[:, 1, 1]))
        pose = (se3.from_plane(x, y, yaw), covariance, reason, "base", 0, 0)
        return JoinedEstimate(self._stamp_s, status, *pose, *moving)


def _planar(T: ArrayLike) -> FloatArray:
    """x, y, yaw (3,) of a motion (4, 4) or (3, 3)."""
    T = np.asarray(T, float)
    if T.shape == (3, 3) and np.isfinite(T).all():
        T = se3.from_plane(*se2.to_parts(T)) if np.allclose(T[:2, :2] @ T[:2, :2].T, np.eye(2), atol=1e-6) else T
    if T.shape != (4, 4) or not se3.is_valid(T):
        raise ConfigError("a pose to join is none", fix="a rigid motion, (4, 4) or (3, 3)")
    return np.array([T[0, 3], T[1, 3], np.arctan2(T[1, 0], T[0, 0])])


def _unwrapped(step: FloatArray) -> FloatArray:
    return np.array([step[0], step[1], float(se2.wrap_angle(step[2]))])


def _rotation(yaw_rad: float) -> FloatArray:
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
