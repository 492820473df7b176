"""SensorHealth: detects, during the whole drive, which sensor stops following the motion of the base.

Wheels, camera and gyroscope measure the same planar motion. Over a piece of the drive their differences have a Gaussian
distribution. A fault of one sensor adds a large variance to that sensor alone, so each sensor is a hypothesis with its
own covariance. The log-likelihood ratio of each to "all sound" accumulates in a one-sided CUSUM (Page 1954, Biometrika
41), over short pieces for large errors and over longer ones for small errors. A fault is found when one sum passes
`_ALARM_NATS` and leads all others by `_MARGIN_NATS`. It began where its sum was last zero. Two sensors that agree with
each other therefore name the third.

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

# Sums that find a fault, by which it leads, that leave a sensor out for the moment, and below which ratios are learned.
_ALARM_NATS, _MARGIN_NATS, _SUSPECT_NATS, _SOUND_NATS = 12.0, 3.0, 6.0, 2.0
# One piece counts at most this much, since errors have longer tails than a Gaussian; sums end at the largest one.
_PIECE_NATS, _LEAST_NATS, _LARGEST_NATS = 8.0, -6.0, 60.0
_PIECES_S, _SHORTEST_S, _GAP_S = (0.25, 1.25), 0.15, 2.0
# Errors of a sound camera over a piece (metres, and share of the way; radians, and share of the turn), of a sound
# wheel, of the way to the side, and of a gyroscope, also per second for its bias. Found on the simulator.
_CAMERA_M, _CAMERA_SHARE, _CAMERA_RAD, _CAMERA_TURN_SHARE = 0.008, 0.03, 0.004, 0.012
_WHEEL_M, _WHEEL_SHARE, _SIDE_M, _SIDE_SHARE = 0.003, 0.01, 0.01, 0.15
_GYRO_RAD, _GYRO_SHARE, _GYRO_RAD_S = 0.003, 0.01, 0.004
_FAULT_LEAST, _FAULT_SHARE = 0.05, 0.5  # errors of a faulty sensor: metres or radians, and share of way or turn
_RISE_M, _RISE_SHARE, _TILT_RAD = 0.03, 0.15, 0.06  # motion out of the plane of the floor that is usual over a piece
_MIRROR_NATS, _MIRROR_RAD, _MIRROR_SHARE = 3.0, 0.03, 0.3
_RATIO_WAY_M, _RATIO_PRIOR_M, _RATIO_STEP = 20.0, 5.0, 0.1
# Sound way, time and, for a fault that turns show, turn after which a sensor is used again.
_AGAIN_WAY_M, _AGAIN_S, _AGAIN_RAD = 2.0, 3.0, 0.6
_KEPT_S = 5.0


class Sensor(Enum):
    """A sensor that may be faulty; `WHEELS` are both, as on ice."""

    LEFT = "left wheel"
    RIGHT = "right wheel"
    WHEELS = "both wheels"
    CAMERA = "camera"
    GYRO = "gyroscope"


class SensorFault(NamedTuple):
    """A fault of one sensor: since when, and when it was found."""

    sensor: Sensor
    begin_s: float
    found_s: float


class Exclusion(NamedTuple):
    """A sensor that is left out from one stamp to another."""

    sensor: Sensor
    begin_s: float
    end_s: float = math.inf


class Piece(NamedTuple):
    """Motions over a piece of a drive.

    Attributes:
        begin_s, end_s: stamps.
        camera: (6,) motion of the base by the camera, ξ.
        ways_m: (2,) of the left and the right wheel.
        turn_rad: of the gyroscope, or None.
    """

    begin_s: float
    end_s: float
    camera: FloatArray
    ways_m: FloatArray
    turn_rad: float | None


# Places of a sensor's errors among: x, y and yaw of the camera, left and right wheel, way to the side, gyroscope.
_BROKEN = {Sensor.LEFT: [3], Sensor.RIGHT: [4], Sensor.WHEELS: [3, 4], Sensor.CAMERA: [0, 1, 2], Sensor.GYRO: [6]}


def log_ratios(piece: Piece, half_m: float, ratios: FloatArray) -> tuple[dict[Sensor, float], bool]:
    """Return the log-likelihood ratio of each sensor's fault to no fault, nats, and whether the camera is mirrored.

    Args:
        piece: of the drive.
        half_m: half of the track.
        ratios: (2,) usual ratio of each wheel to the camera.
    """
    x, y, z, roll, pitch, yaw = piece.camera
    ways_m, turn, seconds = piece.ways_m, piece.turn_rad, piece.end_s - piece.begin_s
    wheel_yaw, rolled_m = (ways_m[1] - ways_m[0]) / (2 * half_m), float(np.abs(ways_m).max())
    way_m = max(rolled_m, abs(x) + half_m * abs(yaw))
    turn_rad = max(abs(wheel_yaw), abs(yaw), 0.0 if turn is None else abs(turn))
    rows = 3 if turn is None else 4
    J = np.array(
        [[-1, 0, half_m, 1, 0, 0, 0], [-1, 0, -half_m, 0, 1, 0, 0], [0, 1, 0, 0, 0, 1, 0], [0, 0, -1, 0, 0, 0, 1]], float
    )[:rows]
    by_camera = ratios * (x + half_m * yaw * np.array([-1, 1]))
    apart = np.array([*(ways_m - by_camera), y, 0.0 if turn is None else turn - yaw])[:rows]
    camera_m, wheel_m = _CAMERA_M + _CAMERA_SHARE * way_m, _WHEEL_M + _WHEEL_SHARE * way_m
    camera_rad = _CAMERA_RAD + _CAMERA_TURN_SHARE * turn_rad
    side_m, gyro_rad = _SIDE_M + _SIDE_SHARE * rolled_m, _GYRO_RAD + _GYRO_SHARE * turn_rad + _GYRO_RAD_S * seconds
    sound = np.square([camera_m, camera_m, camera_rad, wheel_m, wheel_m, side_m, gyro_rad])
    far_m, far_rad = _FAULT_LEAST + _FAULT_SHARE * way_m, _FAULT_LEAST + _FAULT_SHARE * turn_rad
    broken = np.square([far_m, far_m, far_rad, far_m, far_m, 0.0, far_rad])

    def log_likelihood(places: list[int]) -> float:
        variances = sound.copy()
        variances[places] += broken[places]
        C = (J * variances) @ J.T
        return float(-0.5 * np.linalg.slogdet(C)[1] - 0.5 * apart @ np.linalg.solve(C, apart))

    found = {one: log_likelihood(at) for one, at in _BROKEN.items() if one is not Sensor.GYRO or turn is not None}
    usual = max(log_likelihood([]), max(found.values()) - _PIECE_NATS)
    ratio = {sensor: min(max(one - usual, _LEAST_NATS), _PIECE_NATS) for sensor, one in found.items()}
    out = 0.0
    for off, usually in ((z, _RISE_M + _RISE_SHARE * rolled_m), (roll, _TILT_RAD), (pitch, _TILT_RAD)):
        out += max(0.0, -0.5 * math.log(26.0) + 0.5 * (off / usually) ** 2 * (1 - 1 / 26.0))
    ratio[Sensor.CAMERA] += min(out, _PIECE_NATS)
    is_mirrored = yaw * wheel_yaw < 0 and abs(wheel_yaw) > _MIRROR_RAD and abs(yaw) > _MIRROR_SHARE * abs(wheel_yaw)
    if is_mirrored:
        ratio[Sensor.CAMERA] += _MIRROR_NATS
        ratio[Sensor.WHEELS] -= _MIRROR_NATS
    return ratio, bool(is_mirrored)


class Sums:
    """CUSUM of each sensor over pieces of one length.

    Attributes:
        nats: sum of each sensor.
        zero_s: where it was last zero.
    """

    def __init__(self, piece_s: float) -> None:
        self.piece_s, self.begin = piece_s, (math.nan, np.eye(4))
        self.nats, self.zero_s = dict.fromkeys(_BROKEN, 0.0), dict.fromkeys(_BROKEN, -math.inf)

    def add(self, ratio: dict[Sensor, float], end_s: float) -> None:
        """Add the ratios of a piece."""
        for sensor, one in ratio.items():
            self.nats[sensor] = max(self.nats[sensor] + one, 0.0)
            if self.nats[sensor] == 0.0:
                self.zero_s[sensor] = end_s
        over = max(0.0, max(self.nats.values()) - _LARGEST_NATS)
        self.nats = {sensor: max(one - over, 0.0) for sensor, one in self.nats.items()}

    def leads(self, least_nats: float) -> Sensor | None:
        """Return the sensor whose sum passes a value and leads all others; None without one."""
        first, second = sorted(self.nats.values())[-1:-3:-1]
        if first <= least_nats or first - second <= _MARGIN_NATS:
            return None
        return max(self.nats, key=lambda sensor: self.nats[sensor])

    def clear(self, now_s: float) -> None:
        """Start over."""
        self.nats, self.zero_s = dict.fromkeys(_BROKEN, 0.0), dict.fromkeys(_BROKEN, now_s)


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
        self._scales = tuple(Sums(piece_s) for piece_s in _PIECES_S)
        self._waiting: deque[tuple[float, FloatArray]] = deque(maxlen=8)
        self._ratios, self._weights = np.ones(2), np.full(2, _RATIO_PRIOR_M)
        self._unproven_s: float | None = None  # since when a restarted camera has not agreed yet
        self._sound = np.zeros(3)  # way, time and turn over which a faulty sensor agrees again
        self._needs_turn = self._was_mirrored = False

    @property
    def exclusion(self) -> Exclusion | None:
        """The sensor to leave out: faulty, or leading before that is certain, or restarted; None if all count."""
        if self.fault is not None:
            return Exclusion(self.fault.sensor, self.fault.begin_s)
        for scale in self._scales:
            sensor = scale.leads(_SUSPECT_NATS)
            if sensor is not None:
                return Exclusion(sensor, scale.zero_s[sensor])
        return None if self._unproven_s is None else Exclusion(Sensor.CAMERA, self._unproven_s)

    def add_wheels(self, stamp_s: float, way_m: float, turn_rad: float) -> None:
        """Add a step of the wheels."""
        last_s, left_m, right_m = self._rolled[-1] if self._rolled else (-math.inf, 0.0, 0.0)
        if stamp_s > last_s:
            aside_m = self._half_m * turn_rad
            self._rolled.append((stamp_s, left_m + way_m - aside_m, right_m + way_m + aside_m))
            while self._rolled[0][0] < stamp_s - _KEPT_S:
                self._rolled.popleft()

    def add_yaw_rate(self, stamp_s: float, rate_rad_s: float) -> None:
        """Add a reading of the gyroscope, the mean since its last one."""
        last_s, angle_rad = self._turned[-1] if self._turned else (stamp_s, 0.0)
        if stamp_s >= last_s:
            self._turned.append((stamp_s, angle_rad + rate_rad_s * (stamp_s - last_s)))
            while self._turned[0][0] < stamp_s - _KEPT_S:
                self._turned.popleft()

    def interrupt(self, restarted_s: float | None = None) -> None:
        """Note that the next pose of the camera does not continue the previous ones.

        A camera that restarted shows a view that it does not know, and has to agree with the wheels first.
        """
        self._waiting.clear()
        for scale in self._scales:
            scale.begin = math.nan, scale.begin[1]
        if restarted_s is not None and self._unproven_s is None and self._rolled:
            self._unproven_s = restarted_s

    def add_frame(self, stamp_s: float, T_map_camera: FloatArray) -> None:
        """Add the camera's pose (4, 4) by itself at a frame. A piece is compared once the wheels cover it."""
        self._waiting.append((stamp_s, T_map_camera))
        while self._waiting and self._rolled and self._waiting[0][0] <= self._rolled[-1][0]:
            now_s, T = self._waiting.popleft()
            for scale in self._scales:
                begin_s, T_begin = scale.begin
                if not now_s - begin_s <= _GAP_S:
                    scale.begin = now_s, T
                elif now_s - begin_s >= (scale.piece_s if self._unproven_s is None else _SHORTEST_S):
                    scale.begin = now_s, T
                    piece = self._piece(begin_s, T_begin, now_s, T)
                    if piece is not None:
                        self._compare(scale, piece)

    def _piece(self, begin_s: float, T_begin: FloatArray, end_s: float, T_end: FloatArray) -> Piece | None:
        """Return the motions between two frames; None where the wheels do not cover them."""
        if self._rolled[0][0] > begin_s:
            return None
        T_begin_end = motions.times(motions.inverse(T_begin), T_end)
        T = motions.times(self._T_base_camera, motions.times(T_begin_end, self._T_camera_base))
        stamps_s, *sums_m = np.array(self._rolled).T
        ends = begin_s, end_s
        ways_m = np.array([np.diff(np.interp(ends, stamps_s, one))[0] for one in sums_m])
        turn = None
        if self._turned and self._turned[0][0] <= begin_s and end_s <= self._turned[-1][0] + 0.1:
            turn = float(np.diff(np.interp(ends, *np.array(self._turned).T))[0])
        return Piece(begin_s, end_s, motions.log(motions.renormalized(T)), ways_m, turn)

    def _compare(self, scale: Sums, piece: Piece) -> None:
        ratio, is_mirrored = log_ratios(piece, self._half_m, self._ratios)
        if self.fault is not None:
            if scale is self._scales[0]:
                self._follow(self.fault, ratio, is_mirrored, piece)
            return
        self._was_mirrored = self._was_mirrored or is_mirrored
        if scale is self._scales[0] and ratio[Sensor.CAMERA] <= 0.0:
            self._unproven_s = None
        scale.add(ratio, piece.end_s)
        if all(max(one.nats.values()) < _SOUND_NATS for one in self._scales):
            self._was_mirrored = False
            if scale is self._scales[0]:
                self._learn(piece)
        sensor = scale.leads(_ALARM_NATS)
        if sensor is not None:
            self.fault = SensorFault(sensor, scale.zero_s[sensor], piece.end_s)
            self._sound[:], self._unproven_s = 0.0, None
            self._needs_turn = self._was_mirrored or sensor is Sensor.GYRO

    def _learn(self, piece: Piece) -> None:
        """Update the ratio of each wheel to the camera."""
        by_camera = piece.camera[0] + self._half_m * piece.camera[5] * np.array([-1, 1])
        for i, way_m in enumerate(np.abs(by_camera)):
            if way_m > 0.03:
                self._weights[i] = self._weights[i] * math.exp(-way_m / _RATIO_WAY_M) + way_m
                step = np.clip(piece.ways_m[i] / by_camera[i] - self._ratios[i], -_RATIO_STEP, _RATIO_STEP)
                self._ratios[i] += way_m / self._weights[i] * step

    def _follow(self, fault: SensorFault, ratio: dict[Sensor, float], is_mirrored: bool, piece: Piece) -> None:
        """End the fault once its sensor has agreed with the others for long enough."""
        if ratio.get(fault.sensor, 0.0) > 0.0:
            self._sound[:], self._needs_turn = 0.0, self._needs_turn or is_mirrored
            return
        self._sound += np.abs(piece.ways_m).max(), piece.end_s - piece.begin_s, abs(piece.camera[5])
        if (self._sound >= (_AGAIN_WAY_M, _AGAIN_S, _AGAIN_RAD if self._needs_turn else 0.0)).all():
            self.fault = None
            for scale in self._scales:
                scale.clear(piece.end_s)
