"""A wheelchair's body against its base, while nobody knows yet how the drive goes on."""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.geometry import FloatArray, se3
from wheelsight.simulation.realism.body import BodySettings, jolts, spring, trembling
from wheelsight.simulation.realism.floor import Floor
from wheelsight.simulation.robot import Robot

_SMOOTH_S = 0.02
_TREMBLES_ANEW_S = 600.0  # its spectrum has no edges, so that the end goes on as the beginning
_KEPT_S = 1.0


class LiveBodyMotion:
    """`BodyMotion`, known up to the last `step`.

    Speeds are smoothed over the past alone, so that pitch comes 20 ms later than in `BodyMotion`.

    Args:
        period_s: from one step to the next.
        robot: whose wheels meet the floor.
        floor: what they meet.
        settings: how the body moves.
        rng: of the drive.
    """

    def __init__(
        self, period_s: float, robot: Robot, floor: Floor, settings: BodySettings, rng: np.random.Generator
    ) -> None:
        self._period_s, self._robot, self._floor, self._settings = period_s, robot, floor, settings
        rates = settings.roll_rad_s, settings.pitch_rad_s, settings.yaw_rad_s
        count = round(_TREMBLES_ANEW_S / period_s)
        self._trembling = np.stack([trembling(count, period_s, settings.bands_hz, rate, rng) for rate in rates])
        self._springs = [_Spring(settings, period_s) for _ in range(3)]
        self._before: FloatArray | None = None
        self._smoothed = self._speeds = np.zeros(2)
        self._angles: deque[FloatArray] = deque(maxlen=round(_KEPT_S / period_s))
        self._steps = 0

    def step(self, T_world_base: FloatArray) -> None:
        """The base is here one period after the last step."""
        settings, before_m_s = self._settings, self._speeds[0]
        self._speeds = self._speeds_of(T_world_base)
        speed_m_s, turn_rad_s = self._speeds
        pitch, roll, up_m = (float(jolt[0]) for jolt in jolts(T_world_base[None], self._robot, self._floor))
        pitch -= settings.pitch_rad_s2_m * (speed_m_s - before_m_s) / self._period_s
        roll += settings.roll_rad_s2_m * speed_m_s * turn_rad_s
        rim_m_s = abs(speed_m_s) + abs(turn_rad_s) * self._robot.track_width_m / 2
        strength = math.sqrt(rim_m_s / settings.speed_m_s)
        angles = strength * self._trembling[:, self._steps % self._trembling.shape[1]]
        sprung = [spring.step(goal) for spring, goal in zip(self._springs, (roll, pitch, up_m), strict=True)]
        self._angles.append(np.array([angles[0] + sprung[0], angles[1] + sprung[1], angles[2], sprung[2]]))
        self._before = T_world_base
        self._steps += 1

    def T_base_body(self, stamps_s: ArrayLike) -> FloatArray:
        """(N, 4, 4) where the body is, at times (N,) of the last second, from where it is on a level floor at rest."""
        stamps_s = np.atleast_1d(np.asarray(stamps_s, float))
        known_s = self._period_s * (self._steps - len(self._angles) + np.arange(len(self._angles)))
        known = np.array(self._angles)
        xi = np.zeros((len(stamps_s), 6))
        for axis, column in zip((3, 4, 5, 2), known.T, strict=True):
            xi[:, axis] = np.interp(stamps_s, known_s, column)
        return np.asarray(se3.exp(xi))

    def _speeds_of(self, T: FloatArray) -> FloatArray:
        """(2,) forward speed in m/s and yaw rate in rad/s, smoothed twice over half of the time each."""
        if self._before is None:
            return np.zeros(2)
        moved = se3.compose(se3.invert(self._before), T)
        now = np.array([moved[0, 3], math.atan2(moved[1, 0], moved[0, 0])]) / self._period_s
        share = 1 - math.exp(-self._period_s / (_SMOOTH_S / 2))
        self._smoothed = self._smoothed + share * (now - self._smoothed)
        return np.asarray(self._speeds + share * (self._smoothed - self._speeds))


class _Spring:
    """A mass on a spring, at rest at the first goal."""

    def __init__(self, settings: BodySettings, period_s: float) -> None:
        self._b, self._a = spring(settings, period_s)
        self._z = [0.0, 0.0]
        self._rest: float | None = None

    def step(self, goal: float) -> float:
        """Where the mass is once its rest position is `goal`."""
        self._rest = goal if self._rest is None else self._rest
        (b0, b1, b2), (_, a1, a2), (z0, z1) = self._b, self._a, self._z
        x = goal - self._rest
        y = b0 * x + z0
        self._z = [b1 * x - a1 * y + z1, b2 * x - a2 * y]
        return float(y + self._rest)
