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
from collections.abc import Collection, Sequence
from enum import Enum
from operator import itemgetter
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
# Motion out of the plane of the floor that is usual over a piece, and how much larger a faulty camera's is.
_RISE_M, _RISE_SHARE, _TILT_RAD, _FAR_OFF = 0.03, 0.15, 0.06, 5.0
# Of a gyroscope's bias: its prior, its growth in a second, and the error of one piece.
_BIAS_SIGMA_RAD_S, _BIAS_WALK_RAD_S, _BIAS_PIECE_RAD_S = 0.05, 0.0003, 0.02
_RATIO_WAY_M, _RATIO_PRIOR_M, _RATIO_STEP = 20.0, 5.0, 0.1
# Sound way, time and, for a fault that turns show, turn after which a sensor is used again.
_AGAIN_WAY_M, _AGAIN_S, _AGAIN_RAD = 2.0, 3.0, 0.6
_KEPT_S = 5.0
# A wheel's speed over two such times jumps if it changes by more than this, and faster than this acceleration, which a
# tyre on the floor does not reach (a wheel that hits a wall at 0.5 m/s does). For how long it is suspected then.
_JUMP_S, _LONGEST_JUMP_S, _JUMP_M_S, _JUMP_M_S2, _JUMP_SUSPECT_S = 0.035, 0.15, 0.08, 3.0, 0.6
_DESCRIBED = 120  # pieces by which a fault is described


class Sensor(Enum):
    """A sensor that may be faulty; `WHEELS` are both, as on ice."""

    LEFT = "left wheel"
    RIGHT = "right wheel"
    WHEELS = "both wheels"
    CAMERA = "camera"
    GYRO = "gyroscope"


class Exclusion(NamedTuple):
    """A sensor that is left out from one stamp to another, by a fault (`is_sure`) or by a suspicion."""

    sensor: Sensor
    begin_s: float
    end_s: float = math.inf
    is_sure: bool = False


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


class Usual(NamedTuple):
    """What is usual in a drive.

    Attributes:
        ratios: (2,) of each wheel to the camera.
        bias_rad_s, bias_sigma_rad_s: of the gyroscope.
    """

    ratios: FloatArray
    bias_rad_s: float = 0.0
    bias_sigma_rad_s: float = 0.0


class Hypothesis(NamedTuple):
    """A way in which a sensor may be wrong.

    Attributes:
        sensor: the sensor.
        share: probability of this hypothesis, if the sensor is wrong.
        broken: places of the sensor's errors among x, y and yaw of the camera, left and right wheel, gyroscope, whose
            variance grows.
        scale: of that growth, as a share of way or turn.
        flips: what the sensor measures in place of the truth: (left wheel, right wheel, yaw and y of the camera,
            gyroscope) times these.
    """

    sensor: Sensor
    share: float
    broken: tuple[int, ...] = ()
    scale: float = 0.0
    flips: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0)


_ANY, _SOME, _NOTHING = 0.5, 0.1, 10.0
HYPOTHESES = (
    Hypothesis(Sensor.LEFT, 0.4, (3,), _ANY),
    Hypothesis(Sensor.LEFT, 0.4, (3,), _SOME),
    Hypothesis(Sensor.LEFT, 0.1, flips=(0.0, 1.0, 1.0, 1.0)),
    Hypothesis(Sensor.LEFT, 0.1, flips=(-1.0, 1.0, 1.0, 1.0)),
    Hypothesis(Sensor.RIGHT, 0.4, (4,), _ANY),
    Hypothesis(Sensor.RIGHT, 0.4, (4,), _SOME),
    Hypothesis(Sensor.RIGHT, 0.1, flips=(1.0, 0.0, 1.0, 1.0)),
    Hypothesis(Sensor.RIGHT, 0.1, flips=(1.0, -1.0, 1.0, 1.0)),
    Hypothesis(Sensor.WHEELS, 0.8, (3, 4), _ANY),
    Hypothesis(Sensor.WHEELS, 0.1, flips=(0.0, 0.0, 1.0, 1.0)),
    Hypothesis(Sensor.WHEELS, 0.1, flips=(-1.0, -1.0, 1.0, 1.0)),
    Hypothesis(Sensor.CAMERA, 0.7, (0, 1, 2), _ANY),
    Hypothesis(Sensor.CAMERA, 0.2, (0,), _SOME),
    Hypothesis(Sensor.CAMERA, 0.1, flips=(1.0, 1.0, -1.0, 1.0)),
    Hypothesis(Sensor.GYRO, 0.6, (6,), _ANY),
    Hypothesis(Sensor.GYRO, 0.2, flips=(1.0, 1.0, 1.0, 0.0)),
    Hypothesis(Sensor.GYRO, 0.2, flips=(1.0, 1.0, 1.0, -1.0)),
)
_PLACES = {Sensor.LEFT: [3], Sensor.RIGHT: [4], Sensor.WHEELS: [3, 4], Sensor.CAMERA: [0, 1, 2], Sensor.GYRO: [6]}
_SCALES = np.array([[one.scale if place in one.broken else 0.0 for place in range(7)] for one in HYPOTHESES])
_FLIPS = np.array([one.flips for one in HYPOTHESES])
_LOG_SHARES = np.log([one.share for one in HYPOTHESES])
_OF_SENSOR = {sensor: [n for n, one in enumerate(HYPOTHESES) if one.sensor is sensor] for sensor in Sensor}


def log_ratios(piece: Piece, half_m: float, usual: Usual, faulty: Collection[Sensor] = ()) -> dict[Sensor, float]:
    """Return the log-likelihood ratio of each sensor's fault to no other fault, nats.

    Args:
        piece: of the drive.
        half_m: half of the track.
        usual: in this drive.
        faulty: sensors whose measurements do not count.
    """
    x, y, z, roll, pitch, yaw = piece.camera
    ways_m, seconds = piece.ways_m, piece.end_s - piece.begin_s
    turn = None if piece.turn_rad is None else piece.turn_rad - usual.bias_rad_s * seconds
    wheel_yaw, rolled_m = (ways_m[1] - ways_m[0]) / (2 * half_m), float(np.abs(ways_m).max())
    way_m = max(rolled_m, abs(x) + half_m * abs(yaw), abs(y))
    turn_rad = max(abs(wheel_yaw), abs(yaw), 0.0 if turn is None else abs(turn))
    rows = 3 if turn is None else 4
    J = np.zeros((4, 7))
    J[:2, 0], J[:2, 2], J[:2, 3:5] = -1, (half_m, -half_m), np.eye(2)
    J[2, [1, 5]], J[3, [2, 6]] = 1, (-1, 1)
    J = J[:rows]
    camera_m, wheel_m = _CAMERA_M + _CAMERA_SHARE * way_m, _WHEEL_M + _WHEEL_SHARE * way_m
    camera_rad = _CAMERA_RAD + _CAMERA_TURN_SHARE * turn_rad
    side_m, gyro_rad = _SIDE_M + _SIDE_SHARE * rolled_m, _GYRO_RAD + _GYRO_SHARE * turn_rad
    gyro_rad += math.hypot(_GYRO_RAD_S, usual.bias_sigma_rad_s) * seconds
    sound = np.square([camera_m, camera_m, camera_rad, wheel_m, wheel_m, side_m, gyro_rad])
    sizes = np.array([way_m, way_m, turn_rad, way_m, way_m, 0.0, turn_rad])
    for sensor in faulty:
        sound[_PLACES[sensor]] += np.square(_NOTHING * sizes[_PLACES[sensor]] + 1.0)
    flips = np.vstack([np.ones(4), _FLIPS])
    variances = sound + np.square(np.vstack([np.zeros(7), _SCALES]) * sizes)
    true_yaw = flips[:, 2] * yaw  # a mirrored camera measures the opposite of the truth
    by_camera = usual.ratios * np.stack([x - half_m * true_yaw, x + half_m * true_yaw], axis=-1)
    apart = np.empty((len(flips), 4))
    apart[:, :2] = ways_m - flips[:, :2] * by_camera
    apart[:, 2] = flips[:, 2] * y
    apart[:, 3] = 0.0 if turn is None else turn - flips[:, 3] * true_yaw
    apart = apart[:, :rows]
    C = (J * variances[:, None, :]) @ J.T
    chi2 = (apart * np.linalg.solve(C, apart[:, :, None])[:, :, 0]).sum(axis=1)
    logs = -0.5 * (np.linalg.slogdet(C)[1] + chi2)
    sound_log, logs = logs[0], logs[1:] + _LOG_SHARES
    found = {
        sensor: float(np.logaddexp.reduce(logs[places]))
        for sensor, places in _OF_SENSOR.items()
        if sensor is not Sensor.GYRO or turn is not None
    }
    # The camera's motion out of the plane of the floor: a faulty camera has one in half of the cases.
    usual_off = np.array([_RISE_M + _RISE_SHARE * rolled_m, _TILT_RAD, _TILT_RAD])
    off = np.array([z, roll, pitch]) / usual_off
    out = float((0.5 * (1 - 1 / _FAR_OFF**2) * off**2 - math.log(_FAR_OFF)).sum())
    found[Sensor.CAMERA] += math.log(0.5) + float(np.logaddexp(0.0, out))
    sound_log = max(sound_log, max(found.values()) - _PIECE_NATS)
    return {sensor: float(max(one - sound_log, _LEAST_NATS)) for sensor, one in found.items() if sensor not in faulty}


class Sums:
    """CUSUM of each sensor over pieces of one length.

    Attributes:
        nats: sum of each sensor.
        zero_s: where it was last zero.
        begin: stamp and pose (4, 4) of the camera at the begin of the current piece.
    """

    def __init__(self, piece_s: float) -> None:
        self.piece_s, self.begin = piece_s, (math.nan, np.eye(4))
        self.nats, self.zero_s = dict.fromkeys(Sensor, 0.0), dict.fromkeys(Sensor, math.nan)

    def add(self, ratio: dict[Sensor, float], piece: Piece) -> None:
        """Add the ratios of a piece."""
        for sensor, one in ratio.items():
            if math.isnan(self.zero_s[sensor]):
                self.zero_s[sensor] = piece.begin_s
            self.nats[sensor] = max(self.nats[sensor] + one, 0.0)
            if self.nats[sensor] == 0.0:
                self.zero_s[sensor] = piece.end_s
        over = max(0.0, max(self.nats.values()) - _LARGEST_NATS)
        self.nats = {sensor: max(one - over, 0.0) for sensor, one in self.nats.items()}

    def leads(self, least_nats: float) -> Sensor | None:
        """Return the sensor whose sum passes a value and leads all others; None without one."""
        (first_nats, sensor), (second_nats, _) = sorted(
            ((nats, sensor) for sensor, nats in self.nats.items()), key=itemgetter(0), reverse=True
        )[:2]
        return sensor if first_nats > least_nats and first_nats - second_nats > _MARGIN_NATS else None

    def clear(self, now_s: float) -> None:
        """Start over."""
        self.nats, self.zero_s = dict.fromkeys(Sensor, 0.0), dict.fromkeys(Sensor, now_s)


class SensorHealth:
    """Compares the sensors piece by piece.

    Args:
        track_m: distance between the wheels.
        T_base_camera: (4, 4).

    Attributes:
        faults: begin of the current fault of each faulty sensor, stamp.
        exclusions: sensors that are left out, now or earlier; see `update`.
        warnings: a sentence for each fault so far.
        is_suspicious: whether a sensor may be wrong, without certainty.
        accused: the sensor that is most likely wrong, without certainty; None if all are likely sound.
    """

    def __init__(self, track_m: float, T_base_camera: FloatArray) -> None:
        self.faults: dict[Sensor, float] = {}
        self.exclusions: tuple[Exclusion, ...] = ()
        self.warnings: tuple[str, ...] = ()
        self.is_suspicious, self._has_news = False, False
        self.accused: Sensor | None = None
        self._half_m = track_m / 2
        self._T_base_camera, self._T_camera_base = T_base_camera, motions.inverse(T_base_camera)
        self._first_s: float | None = None
        self._rolled: deque[tuple[float, float, float]] = deque()  # stamp, and way of both wheels, m
        self._turned: deque[tuple[float, float]] = deque()  # stamp, and angle of the gyroscope, rad
        self._scales = tuple(Sums(piece_s) for piece_s in _PIECES_S)
        self._waiting: deque[tuple[float, FloatArray]] = deque(maxlen=8)
        self._pieces: deque[Piece] = deque(maxlen=_DESCRIBED)
        self._usual = Usual(np.ones(2), 0.0, _BIAS_SIGMA_RAD_S)
        self._weights = np.full(2, _RATIO_PRIOR_M)
        self._jumped: dict[Sensor, tuple[float, float]] = {}  # wheels whose speed jumped: suspected from and until
        self._unproven_s: float | None = None  # since when a restarted camera has not agreed yet
        self._sound = {sensor: np.zeros(3) for sensor in Sensor}  # way, time and turn over which it agrees again

    def update(self, stamp_s: float) -> float | None:
        """Update the exclusions at a frame; return the stamp since which they changed, or None.

        A sensor is left out since its fault began. So is one that leads before that is certain, a wheel whose speed has
        just jumped, and a camera that has just restarted. One that turns out to be sound counts as if nothing had
        happened.
        """
        if not self._has_news:
            return None
        self._has_news = bool(self._jumped)
        past = tuple(one for one in self.exclusions if one.is_sure and one.end_s < math.inf)
        current = {one.sensor: one for one in self.exclusions if one.end_s == math.inf}
        wanted = {sensor: Exclusion(sensor, begin_s, is_sure=True) for sensor, begin_s in self.faults.items()}
        suspects = {sensor: begin_s for sensor, (begin_s, end_s) in self._jumped.items() if stamp_s < end_s}
        for scale in self._scales:
            leader = scale.leads(_SUSPECT_NATS)
            if leader is not None:
                suspects.setdefault(leader, scale.zero_s[leader])
        if self._unproven_s is not None:
            suspects.setdefault(Sensor.CAMERA, self._unproven_s)
        for sensor, begin_s in suspects.items():
            known = current.get(sensor)
            wanted.setdefault(sensor, Exclusion(sensor, begin_s) if known is None or known.is_sure else known)
        largest = max((one for scale in self._scales for one in scale.nats.items()), key=itemgetter(1))
        self.accused = largest[0] if largest[1] > _SOUND_NATS else None
        self.is_suspicious = not all(one.is_sure for one in wanted.values()) or largest[1] > _ALARM_NATS
        since_s = stamp_s
        for sensor in {*wanted, *current}:
            now, before = wanted.get(sensor), current.get(sensor)
            if before is not None and before.is_sure and now is None:
                past = (*past, before._replace(end_s=stamp_s))
            elif now != before:
                since_s = min([since_s, *[one.begin_s for one in (now, before) if one is not None]])
        self.exclusions = (*past, *wanted.values())
        return None if wanted == current else since_s

    def add_wheels(self, stamp_s: float, way_m: float, turn_rad: float) -> None:
        """Add a step of the wheels."""
        last_s, left_m, right_m = self._rolled[-1] if self._rolled else (-math.inf, 0.0, 0.0)
        if stamp_s > last_s:
            aside_m = self._half_m * turn_rad
            self._rolled.append((stamp_s, left_m + way_m - aside_m, right_m + way_m + aside_m))
            while self._rolled[0][0] < stamp_s - _KEPT_S:
                self._rolled.popleft()
            self._find_jump(stamp_s)

    def _find_jump(self, now_s: float) -> None:
        """Suspect a wheel for a moment whose speed changed faster than a wheel on the floor can."""
        middle: tuple[float, float, float] | None = None
        for one in reversed(self._rolled):
            if middle is None and now_s - one[0] >= _JUMP_S:
                middle = one
            elif middle is not None and middle[0] - one[0] >= _JUMP_S:
                before, after = middle[0] - one[0], now_s - middle[0]
                if max(before, after) > _LONGEST_JUMP_S:
                    return
                newest = self._rolled[-1]
                most_m_s = _JUMP_M_S + _JUMP_M_S2 * (before + after) / 2
                jumps = [
                    abs((newest[i] - middle[i]) / after - (middle[i] - one[i]) / before) > most_m_s for i in (1, 2)
                ]
                if any(jumps):
                    sensor = Sensor.WHEELS if all(jumps) else Sensor.LEFT if jumps[0] else Sensor.RIGHT
                    self._has_news = True
                    self._jumped.setdefault(sensor, (one[0], 0.0))
                    self._jumped[sensor] = self._jumped[sensor][0], now_s + _JUMP_SUSPECT_S
                elif self._jumped and now_s > max(end_s for _, end_s in self._jumped.values()):
                    self._jumped.clear()
                return

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
        self._has_news = True
        for scale in self._scales:
            scale.begin = math.nan, scale.begin[1]
        if restarted_s is not None and self._unproven_s is None and self._rolled:
            self._unproven_s = restarted_s

    def add_frame(self, stamp_s: float, T_map_camera: FloatArray) -> None:
        """Add the camera's pose (4, 4) by itself at a frame. A piece is compared once the wheels cover it."""
        self._first_s = stamp_s if self._first_s is None else self._first_s
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
        ratio, is_first = log_ratios(piece, self._half_m, self._usual, self.faults), scale is self._scales[0]
        self._has_news = True
        if is_first:
            self._pieces.append(piece)
            if ratio.get(Sensor.CAMERA, 0.0) <= 0.0:
                self._unproven_s = None
            self._end_faults(piece)
        scale.add(ratio, piece)
        if is_first and not self.faults and all(max(one.nats.values()) < _SOUND_NATS for one in self._scales):
            self._learn(piece)
        sensor = scale.leads(_ALARM_NATS)
        if sensor is None:
            return
        begin_s = scale.zero_s[sensor]
        self.faults[sensor] = begin_s
        self._sound[sensor][:] = 0.0
        if sensor is Sensor.CAMERA:
            self._unproven_s = None
        for one in self._scales:  # what this fault explains accuses no other sensor
            one.clear(piece.end_s)
        cause = cause_of(sensor, [one for one in self._pieces if one.end_s > begin_s], self._half_m, self._usual)
        after_s = begin_s - (self._first_s or 0.0)
        self.warnings += (f"{_name(sensor)} left out from {after_s:.1f} s after the first frame on: {cause}",)

    def _learn(self, piece: Piece) -> None:
        """Update what is usual."""
        ratios, (_, bias, sigma), seconds = self._usual.ratios.copy(), self._usual, piece.end_s - piece.begin_s
        by_camera = piece.camera[0] + self._half_m * piece.camera[5] * np.array([-1, 1])
        for i, way_m in enumerate(np.abs(by_camera)):
            if way_m > 0.03:
                self._weights[i] = self._weights[i] * math.exp(-way_m / _RATIO_WAY_M) + way_m
                step = np.clip(piece.ways_m[i] / by_camera[i] - ratios[i], -_RATIO_STEP, _RATIO_STEP)
                ratios[i] += way_m / self._weights[i] * step
        if piece.turn_rad is not None:
            variance = sigma**2 + _BIAS_WALK_RAD_S**2 * seconds
            gain = variance / (variance + _BIAS_PIECE_RAD_S**2)
            bias += gain * ((piece.turn_rad - piece.camera[5]) / seconds - bias)
            sigma = math.sqrt((1 - gain) * variance)
        self._usual = Usual(ratios, bias, sigma)

    def _end_faults(self, piece: Piece) -> None:
        """End each fault whose sensor has agreed with the others for long enough."""
        for sensor in list(self.faults):
            others = self.faults.keys() - {sensor}
            sound = self._sound[sensor]
            if log_ratios(piece, self._half_m, self._usual, others).get(sensor, 0.0) > 0.0:
                sound[:] = 0.0
                continue
            way_m = max(float(np.abs(piece.ways_m).max()), abs(piece.camera[0]))
            sound += way_m, piece.end_s - piece.begin_s, abs(piece.camera[5])
            if (sound >= (_AGAIN_WAY_M, _AGAIN_S, _AGAIN_RAD)).all():
                del self.faults[sensor]
                for scale in self._scales:
                    scale.clear(piece.end_s)
                self.warnings += (f"{_name(sensor)} used again, since it agrees with the other sensors",)


def _name(sensor: Sensor) -> str:
    return "both wheels are" if sensor is Sensor.WHEELS else f"the {sensor.value} is"


def cause_of(sensor: Sensor, pieces: Sequence[Piece], half_m: float, usual: Usual) -> str:
    """Return what is wrong with a sensor over some pieces, and what to check; see `log_ratios`."""
    camera = np.array([piece.camera for piece in pieces]).reshape(-1, 6)
    ways_m = np.array([piece.ways_m for piece in pieces]).reshape(-1, 2)
    turns = np.array([math.nan if piece.turn_rad is None else piece.turn_rad for piece in pieces])

    def times(measured: FloatArray, true: FloatArray) -> float:
        """Return the factor of a measurement, by least squares."""
        return float(measured @ true / max(float(true @ true), 1e-12))

    wheel_turns = (ways_m[:, 1] - ways_m[:, 0]) / (2 * half_m)
    if sensor in (Sensor.LEFT, Sensor.RIGHT):
        i = 0 if sensor is Sensor.LEFT else 1
        by_camera = camera[:, 0] + half_m * camera[:, 5] * (-1, 1)[i]
        factor = times(ways_m[:, i], usual.ratios[i] * by_camera)
        if abs(factor) < 0.1:
            return "it does not count while the robot moves; check its encoder and cable"
        if factor < -0.5:
            return "it counts backwards; check the channels of its encoder"
        return f"it counts {factor:.2f} times its way; check its tyre and encoder"
    if sensor is Sensor.WHEELS:
        factor = times(ways_m.mean(axis=1), camera[:, 0])
        return f"both count {factor:.2f} times their way; they slip, or the robot was lifted"
    if sensor is Sensor.GYRO:
        factor = times(turns[np.isfinite(turns)], camera[np.isfinite(turns), 5])
        return f"it measures {factor:.2f} times the turns of camera and wheels; check its mounting and scale"
    if times(camera[:, 5], wheel_turns) < -0.5:
        return "it turns the other way than the wheels; check whether its images are mirrored"
    if np.abs(camera[:, 1]).sum() > 0.3 * np.abs(ways_m).max(axis=1).sum():
        return "it moves sideways, which the robot cannot; something that moves may fill its view"
    factor = times(camera[:, 0], ways_m.mean(axis=1))
    return f"it moves {factor:.2f} times the way of the wheels; check its mount and depth"
