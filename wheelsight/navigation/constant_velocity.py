"""Track: a Kalman filter of a thing that goes on as it goes, but for white noise in its acceleration."""

from __future__ import annotations

import numpy as np

from wheelsight.geometry import FloatArray

_SEEN = np.eye(2, 4)


class Track:
    """Where a thing is in the plane, and how it moves (Bar-Shalom, Li, Kirubarajan: Estimation, 6.2.2).

    Args:
        stamp_s: when it was seen first.
        position: (2,) where, metres.
        covariance: (2, 2) of that.
        speed_sigma_m_s: standard deviation of its speed, of which nothing is known, along each axis.
        change_m2_s3: power spectral density of its acceleration.

    Attributes:
        stamp_s: of what follows.
        state: (4,) x, y, vx, vy.
        covariance: (4, 4).
    """

    def __init__(
        self,
        stamp_s: float,
        position: FloatArray,
        covariance: FloatArray,
        speed_sigma_m_s: float,
        change_m2_s3: float,
    ) -> None:
        self.stamp_s = stamp_s
        self.state: FloatArray = np.array([*position, 0.0, 0.0], float)
        self.covariance: FloatArray = np.zeros((4, 4))
        self.covariance[:2, :2], self.covariance[2:, 2:] = covariance, speed_sigma_m_s**2 * np.eye(2)
        self._change = change_m2_s3

    def at(self, stamp_s: float) -> tuple[FloatArray, FloatArray]:
        """State (4,) and covariance (4, 4) at a time, by what is known now."""
        step_s = stamp_s - self.stamp_s
        F = np.kron(np.array([[1.0, step_s], [0.0, 1.0]]), np.eye(2))
        ahead_s = abs(step_s)
        noise = np.array([[ahead_s**3 / 3, step_s * ahead_s / 2], [step_s * ahead_s / 2, ahead_s]])
        return F @ self.state, F @ self.covariance @ F.T + self._change * np.kron(noise, np.eye(2))

    def predict(self, stamp_s: float) -> None:
        """Go on to a later time."""
        self.state, self.covariance = self.at(stamp_s)
        self.stamp_s = stamp_s

    def distance(self, position: FloatArray, covariance: FloatArray) -> float:
        """Squared Mahalanobis distance of something seen now, (2,) with (2, 2): χ² of two degrees of freedom."""
        off = position - self.state[:2]
        return float(off @ np.linalg.solve(self.covariance[:2, :2] + covariance, off))

    def correct(self, position: FloatArray, covariance: FloatArray) -> None:
        """Take what is seen of it now."""
        S = self.covariance[:2, :2] + covariance
        K = np.linalg.solve(S, self.covariance[:2]).T
        self.state = self.state + K @ (position - self.state[:2])
        left = np.eye(4) - K @ _SEEN
        # Joseph's form stays symmetric and positive.
        self.covariance = left @ self.covariance @ left.T + K @ covariance @ K.T

    @property
    def speed_m_s(self) -> float:
        """How fast it is."""
        return float(np.hypot(*self.state[2:]))

    @property
    def speed_distance(self) -> float:
        """Squared Mahalanobis distance of its velocity from none: χ² of two degrees of freedom where it stands."""
        return float(self.state[2:] @ np.linalg.solve(self.covariance[2:, 2:], self.state[2:]))
