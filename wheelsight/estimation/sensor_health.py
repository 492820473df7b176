"""SensorHealth: detects, during the whole drive, which sensor stops following the motion of the base.

Wheels, camera and gyroscope measure the same planar motion. Over each piece of about half a second, their differences
have a Gaussian distribution. A fault of one sensor adds a large variance to that sensor alone, so each sensor is a
hypothesis with its own covariance. The log-likelihood ratio of each to "all sound" accumulates in a one-sided CUSUM
(Page 1954, Biometrika 41). A fault is found when one sum passes `_ALARM_NATS` and leads all others by `_MARGIN_NATS`.
It began where its sum was last zero. Two sensors that agree with each other therefore name the third.

A chair cannot move sideways, rise, or tilt as fast as it drives. The camera's motion in these directions counts against
the camera. A camera that turns the other way than both wheels is mirrored, since slip does not reverse a turn.

Slow differences are calibration: the ratio of each wheel to the camera is learned along 20 m, and its changes count.
"""

from __future__ import annotations

import math
from collections import deque
from enum import Enum
from typing import NamedTuple

import numpy as np

from wheelsight.core.geometry import FloatArray
from wheelsight.core.geometry import motion_kernels as motions

# Sums that find a fault (false alarms: none in the drives of docs/benchmarks/sensor-health.md), that mark estimates as
# doubtful, and below which ratios are learned, nats.
_ALARM_NATS, _MARGIN_NATS, _SUSPECT_NATS, _SOUND_NATS = 12.0, 3.0, 6.0, 2.0
# One piece counts at most this much, since errors have longer tails than a Gaussian; sums end at the largest one.
_PIECE_NATS, _LEAST_NATS, _LARGEST_NATS = 8.0, -6.0, 60.0
_PIECE_S, _LONGEST_PIECE_S, _SHORTEST_PIECE_S = 0.25, 2.0, 0.15
# Errors of a sound camera over a piece (metres, and share of the way; radians, and share of the turn), of a sound
# wheel, of the way to the side, and of a gyroscope, also per second for its bias. Found on the simulator.
_CAMERA_M, _CAMERA_SHARE, _CAMERA_RAD, _CAMERA_TURN_SHARE = 0.008, 0.03, 0.004, 0.012
_WHEEL_M, _WHEEL_SHARE, _SIDE_M, _SIDE_SHARE = 0.003, 0.01, 0.01, 0.15
_GYRO_RAD, _GYRO_SHARE, _GYRO_RAD_S = 0.003, 0.01, 0.004
_FAULT_LEAST, _FAULT_SHARE = 0.05, 0.5  # errors of a faulty sensor: metres or radians, and share of way or turn
_RISE_M, _RISE_SHARE, _TILT_RAD = 0.03, 0.15, 0.06  # motion out of the plane of the floor that is usual over a piece
_MIRROR_NATS, _MIRROR_RAD, _MIRROR_SHARE = 3.0, 0.03, 0.3
_RATIO_WAY_M, _RATIO_PRIOR_M, _RATIO_STEP = 20.0, 5.0, 0.1
_AGAIN_WAY_M, _AGAIN_S = 2.0, 3.0  # sound way and time after which a sensor is used again
_KEPT_S = 5.0


class Sensor(Enum):
    """A sensor that may be faulty; `WHEELS` are both, as on ice."""

    LEFT = "left wheel"
    RIGHT = "right wheel"
    WHEELS = "both wheels"
    CAMERA = "camera"
    GYRO = "gyroscope"


class SensorFault(NamedTuple):
    """A fault of one sensor: since when, when it was found, and the measured share of the true motion, or None."""

    sensor: Sensor
    begin_s: float
    found_s: float
    share: float | None


class Exclusion(NamedTuple):
    """A sensor that is left out from one stamp to another."""

    sensor: Sensor
    begin_s: float
    end_s: float = math.inf


_BROKEN = {Sensor.LEFT: (3,), Sensor.RIGHT: (4,), Sensor.WHEELS: (3, 4), Sensor.CAMERA: (0, 1, 2), Sensor.GYRO: (6,)}
# Rows: left wheel, right wheel, side, gyroscope, each minus the camera; columns: errors of the camera's x, y and yaw,
# of the wheels, of the side, and of the gyroscope. The first columns of the wheels' rows depend on the track.


class SensorHealth:
    """Compares the sensors piece by piece.

    Args:
        track_m: distance between the wheels.
        T_base_camera: (4, 4).

    Attributes:
        fault: the current fault, or None.
    """

    def __init__(self, track_m: float, T_base_camera: FloatArray) -> None:
        self.fault: SensorFault | None = None
        self._half_m = track_m / 2
        self._T_base_camera, self._T_camera_base = T_base_camera, motions.inverse(T_base_camera)
        self._rolled: deque[tuple[float, float, float]] = deque()  # stamp, and way of both wheels, m
        self._turned: deque[tuple[float, float]] = deque()  # stamp, and angle of the gyroscope, rad
        self._begin: tuple[float, FloatArray] | None = None
        self._waiting: deque[tuple[float, FloatArray]] = deque(maxlen=8)
        self._sums = dict.fromkeys(_BROKEN, 0.0)
        self._zero_s = dict.fromkeys(_BROKEN, -math.inf)
        self._ratios, self._weights = np.ones(2), np.full(2, _RATIO_PRIOR_M)
        self._sound_m, self._sound_s = 0.0, 0.0
        self._sound_rad, self._needs_turn, self._turned_against = 0.0, False, False

    @property
    def is_suspicious(self) -> bool:
        """Whether some sensor is probably faulty, before it is known which."""
        return self.fault is None and max(self._sums.values()) > _SUSPECT_NATS

    @property
    def exclusion(self) -> Exclusion | None:
        """The faulty sensor, or the one that leads before a fault is certain; None if all count."""
        if self.fault is not None:
            return Exclusion(self.fault.sensor, self.fault.begin_s)
        first, second = sorted(self._sums.values())[-1:-3:-1]
        if first > _SUSPECT_NATS and first - second > _MARGIN_NATS:
            sensor = max(self._sums, key=lambda sensor: self._sums[sensor])
            return Exclusion(sensor, self._zero_s[sensor])
        return None

    def add_wheels(self, stamp_s: float, way_m: float, turn_rad: float) -> None:
        """Add a step of the wheels."""
        _, left_m, right_m = self._rolled[-1] if self._rolled else (0.0, 0.0, 0.0)
        if self._rolled and stamp_s <= self._rolled[-1][0]:
            return
        aside_m = self._half_m * turn_rad
        self._rolled.append((stamp_s, left_m + way_m - aside_m, right_m + way_m + aside_m))
        while self._rolled[0][0] < stamp_s - _KEPT_S:
            self._rolled.popleft()

    def add_yaw_rate(self, stamp_s: float, rate_rad_s: float) -> None:
        """Add a reading of the gyroscope, the mean since its last one."""
        last_s, angle_rad = self._turned[-1] if self._turned else (stamp_s, 0.0)
        if stamp_s < last_s:
            return
        self._turned.append((stamp_s, angle_rad + rate_rad_s * (stamp_s - last_s)))
        while self._turned[0][0] < stamp_s - _KEPT_S:
            self._turned.popleft()

    def interrupt(self) -> bool:
        """Note that the next pose of the camera does not continue the previous ones; return whether `fault` changed."""
        changed, last = False, None
        while self._waiting and self._rolled and self._waiting[0][0] <= self._rolled[-1][0]:
            last = self._waiting.popleft()
        if last is not None and self._begin is not None and _SHORTEST_PIECE_S <= last[0] - self._begin[0] < _LONGEST_PIECE_S:
            changed = self._compare(*self._begin, *last)
        self._begin = None
        self._waiting.clear()
        return changed

    def add_frame(self, stamp_s: float, T_map_camera: FloatArray) -> bool:
        """Add the camera's pose (4, 4) by itself at a frame; return whether `fault` changed.

        A piece is compared once the wheels cover it.
        """
        self._waiting.append((stamp_s, T_map_camera))
        changed = False
        while self._waiting and self._rolled and self._waiting[0][0] <= self._rolled[-1][0]:
            now_s, T = self._waiting.popleft()
            if self._begin is None or now_s - self._begin[0] > _LONGEST_PIECE_S:
                self._begin = now_s, T
            elif now_s - self._begin[0] >= _PIECE_S:
                changed = self._compare(*self._begin, now_s, T) or changed
                self._begin = now_s, T
        return changed

    def _compare(self, begin_s: float, T_begin: FloatArray, end_s: float, T_end: FloatArray) -> bool:
        """Compare all sensors over a piece; return whether the fault changed."""
        if not self._rolled[0][0] <= begin_s:
            return False
        T = motions.times(self._T_base_camera, motions.times(motions.times(motions.inverse(T_begin), T_end), self._T_camera_base))
        x, y, z, roll, pitch, yaw = motions.log(motions.renormalized(T))
        stamps_s, *sums_m = np.array(self._rolled).T
        ways_m = np.array([np.diff(np.interp((begin_s, end_s), stamps_s, one))[0] for one in sums_m])
        turn = self._gyro_turn(begin_s, end_s)
        by_camera = np.array([x - self._half_m * yaw, x + self._half_m * yaw])
        wheel_yaw, rolled_m = (ways_m[1] - ways_m[0]) / (2 * self._half_m), float(np.abs(ways_m).max())
        way_m = max(rolled_m, abs(x) + self._half_m * abs(yaw))
        turn_rad = max(abs(wheel_yaw), abs(yaw), 0.0 if turn is None else abs(turn))
        seconds, half = end_s - begin_s, self._half_m
        J = np.array(
            [[-1, 0, half, 1, 0, 0, 0], [-1, 0, -half, 0, 1, 0, 0], [0, 1, 0, 0, 0, 1, 0], [0, 0, -1, 0, 0, 0, 1]], float
        )
        rows = 3 if turn is None else 4
        J = J[:rows]
        apart = np.array([*(ways_m - self._ratios * by_camera), y, 0.0 if turn is None else turn - yaw])[:rows]
        wheel_m = _WHEEL_M + _WHEEL_SHARE * way_m
        sound = np.square(
            [
                _CAMERA_M + _CAMERA_SHARE * way_m,
                _CAMERA_M + _CAMERA_SHARE * way_m,
                _CAMERA_RAD + _CAMERA_TURN_SHARE * turn_rad,
                wheel_m,
                wheel_m,
                _SIDE_M + _SIDE_SHARE * rolled_m,
                _GYRO_RAD + _GYRO_SHARE * turn_rad + _GYRO_RAD_S * seconds,
            ]
        )
        far_m, far_rad = (_FAULT_LEAST + _FAULT_SHARE * way_m) ** 2, (_FAULT_LEAST + _FAULT_SHARE * turn_rad) ** 2
        broken = np.array([far_m, far_m, far_rad, far_m, far_m, 0.0, far_rad])

        def log_likelihood(variances: FloatArray) -> float:
            C = (J * variances) @ J.T
            return float(-0.5 * np.linalg.slogdet(C)[1] - 0.5 * apart @ np.linalg.solve(C, apart))

        found = {}
        for sensor, places in _BROKEN.items():
            if sensor is Sensor.GYRO and turn is None:
                continue
            more = np.zeros(7)
            more[list(places)] = broken[list(places)]
            found[sensor] = log_likelihood(sound + more)
        usual = max(log_likelihood(sound), max(found.values()) - _PIECE_NATS)
        ratio = {sensor: min(max(one - usual, _LEAST_NATS), _PIECE_NATS) for sensor, one in found.items()}
        out = 0.0
        for off, usually in ((z, _RISE_M + _RISE_SHARE * rolled_m), (roll, _TILT_RAD), (pitch, _TILT_RAD)):
            out += max(0.0, -0.5 * math.log(26.0) + 0.5 * (off / usually) ** 2 * (1 - 1 / 26.0))
        ratio[Sensor.CAMERA] += min(out, _PIECE_NATS)
        mirrored = yaw * wheel_yaw < 0 and abs(wheel_yaw) > _MIRROR_RAD and abs(yaw) > _MIRROR_SHARE * abs(wheel_yaw)
        self._turned_against = self._turned_against or mirrored
        if mirrored:
            ratio[Sensor.CAMERA] += _MIRROR_NATS
            ratio[Sensor.WHEELS] -= _MIRROR_NATS
        if self.fault is not None:
            return self._follow(ratio, end_s, seconds, way_m, turn_rad, mirrored)
        for sensor, one in ratio.items():
            self._sums[sensor] = max(self._sums[sensor] + one, 0.0)
            if self._sums[sensor] == 0.0:
                self._zero_s[sensor] = end_s
        over = max(self._sums.values()) - _LARGEST_NATS
        if over > 0:
            self._sums = {sensor: max(one - over, 0.0) for sensor, one in self._sums.items()}
        first, second = sorted(self._sums, key=lambda sensor: -self._sums[sensor])[:2]
        if self._sums[first] < _SOUND_NATS:
            self._turned_against = False
            self._learn(ways_m, by_camera)
        if self._sums[first] > _ALARM_NATS and self._sums[first] - self._sums[second] > _MARGIN_NATS:
            self.fault = SensorFault(first, self._zero_s[first], end_s, None)
            self._sound_m = self._sound_s = self._sound_rad = 0.0
            self._needs_turn = self._turned_against or first is Sensor.GYRO
            return True
        return False

    def _gyro_turn(self, begin_s: float, end_s: float) -> float | None:
        """Return the turn of the gyroscope, radians; None if its readings do not cover the piece."""
        turned = self._turned
        if not turned or not (turned[0][0] <= begin_s and end_s <= turned[-1][0] + 0.1):
            return None
        stamps_s, angles_rad = np.array(turned).T
        return float(np.diff(np.interp((begin_s, end_s), stamps_s, angles_rad))[0])

    def _learn(self, ways_m: FloatArray, by_camera: FloatArray) -> None:
        """Update the ratio of each wheel to the camera."""
        for i in range(2):
            way_m = abs(by_camera[i])
            if way_m > 0.03:
                self._weights[i] = self._weights[i] * math.exp(-way_m / _RATIO_WAY_M) + way_m
                step = np.clip(ways_m[i] / by_camera[i] - self._ratios[i], -_RATIO_STEP, _RATIO_STEP)
                self._ratios[i] += way_m / self._weights[i] * step

    def _follow(
        self,
        ratio: dict[Sensor, float],
        end_s: float,
        seconds: float,
        way_m: float,
        turn_rad: float,
        mirrored: bool,
    ) -> bool:
        """Return whether the fault has ended: over some way, the sensor agreed with the others all along."""
        assert self.fault is not None
        if ratio.get(self.fault.sensor, 0.0) > 0.0:
            self._sound_m = self._sound_s = self._sound_rad = 0.0
            self._needs_turn = self._needs_turn or mirrored
            return False
        self._sound_m, self._sound_s = self._sound_m + way_m, self._sound_s + seconds
        self._sound_rad += turn_rad
        if self._sound_m < _AGAIN_WAY_M or self._sound_s < _AGAIN_S or (self._needs_turn and self._sound_rad < 0.6):
            return False
        self.fault = None
        self._sums = dict.fromkeys(_BROKEN, 0.0)
        self._zero_s = dict.fromkeys(_BROKEN, end_s)
        return True
