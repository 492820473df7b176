"""Yaw rates of a gyroscope at the times of wheel readings, and `GyroCheck`, which compares them with the wheels' turns.

The check splits both into blocks of a quarter of a second. Over the blocks of the last turns, the gyroscope's rate is a
line over that of the wheels, with slope 1 and the bias at rate 0. The fit gives the scale between both with its
uncertainty, the remaining scatter, and the lag of the best fit. Blocks with spinning wheels are outliers, and count
little (Huber 1964).

Wheels that slip in every turn, as those of a skid-steered robot, turn it less than they measure, and never twice alike.
A constant scale is not slip: then the scale of one sensor is wrong, and the data do not show which.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.core.geometry import FloatArray
from wheelsight.core.messages import WheelReading, YawRate
from wheelsight.io.recordings import Recording
from wheelsight.wheels.holonomic import odometry_of
from wheelsight.wheels.odometry import WheelSettings

_GAP_S = WheelSettings().gyro_gap_s

# Chosen, unless the line says otherwise.
_BLOCK_S = 0.25  # length of the blocks in which turns are compared
_LAGS_S = np.linspace(-0.4, 0.4, 17)  # lags that are tried; an odd number, so that 0 is one of them
_NO_LAG, _MOST_LAG_S = 8, 0.4
_TURNING_RAD_S = 0.05  # turns of the wheels that count; of slower ones, rounding of counts is most (computed)
_LAST_TURNS, _LAST_BLOCKS = 40, 400  # turning blocks in a fit, 10 s, within the last 100 s
_TRUST_AFTER, _ACCUSE_AFTER = 8, 20  # turning blocks before a decision: 2 s and 5 s (found on the simulator alone)
# The gyroscope's turns over the wheels': data sheets and tape measures are good to some percent.
_SCALES = (0.85, 1.15)
_SLIPPING_SCALES = (0.5, 1.3)  # likewise, for wheels that slip in turns (one real skid-steered robot)
# Relative scatter of wheels that slip in turns: 0.03 to 0.09 on a real skid-steered robot; below 0.01 for wheels that
# grip (found on the simulator alone).
_SLIPPING_SCATTER = 0.015
_SIGMAS = 3.0  # margin of a scale outside the limits
_RELATED_SHARE = 0.8  # of the rates' variance that the line explains, for trust (found on the simulator alone)
_UNRELATED_SHARE = 0.5  # below it, the gyroscope measures other turns (found on the simulator alone)
_LATE_S = 0.1  # lag that is reported; wheels are 0.05 s late where their delay was not measured (computed)
_CLEARER = 2.0  # ratio of residuals without a lag and at the best one (found on the simulator alone)
_RECENT_BLOCKS = 4  # in which a trusted gyroscope must agree: one second
_STUCK_S = 1.0  # a rate that stays the same for this long is stuck,
_STUCK_RAD = 0.2  # if the wheels turned by this much in between, more than they slip (found on the simulator alone)
_STUCK_BLOCKS = 40  # in at most 10 s
_GYRO_WAIT_S = 1.0  # longest wait of a block for the gyroscope


class YawRateMeter:
    """Mean yaw rate from one wheel reading to the next.

    The rate is interpolated linearly between readings, and constant after the newest one. The next mean corrects the
    error of that, so that the yaw over many steps is exact.

    Args:
        gap_s: over a longer gap of the gyroscope there is no mean.
    """

    def __init__(self, gap_s: float = _GAP_S) -> None:
        self.gap_s = gap_s
        self._angles: deque[tuple[float, float, float]] = deque()  # stamps, yaw angles and rates
        self._before: tuple[float, float] | None = None

    def add(self, stamp_s: float, yaw_rate_rad_s: float) -> None:
        """Add a reading of the gyroscope; ignored if it is not newer than the last one, or not finite."""
        if not (math.isfinite(stamp_s) and math.isfinite(yaw_rate_rad_s)):
            return
        if not self._angles:
            self._angles.append((stamp_s, 0.0, yaw_rate_rad_s))
            return
        last_s, angle_rad, rate_rad_s = self._angles[-1]
        if stamp_s > last_s:
            angle_rad += (stamp_s - last_s) * (rate_rad_s + yaw_rate_rad_s) / 2
            self._angles.append((stamp_s, angle_rad, yaw_rate_rad_s))

    def mean_until(self, stamp_s: float) -> float | None:
        """Return the mean rate since the stamp of the last call, rad/s; None in a gap of the gyroscope."""
        before, now_rad = self._before, self._angle_at(stamp_s)
        self._before = None if now_rad is None else (stamp_s, now_rad)
        if before is None or now_rad is None or not stamp_s > before[0]:
            return None
        return (now_rad - before[1]) / (stamp_s - before[0])

    def _angle_at(self, stamp_s: float) -> float | None:
        """Return the yaw angle at a stamp; None in a gap. Older readings are dropped."""
        angles = self._angles
        while len(angles) > 1 and angles[1][0] <= stamp_s:
            angles.popleft()
        if not angles or stamp_s < angles[0][0]:
            return None
        start_s, angle_rad, rate_rad_s = angles[0]
        if len(angles) == 1:
            return angle_rad + rate_rad_s * (stamp_s - start_s) if stamp_s - start_s <= self.gap_s else None
        end_s, end_rad, _ = angles[1]
        if end_s - start_s > self.gap_s:
            return None
        return angle_rad + (end_rad - angle_rad) * (stamp_s - start_s) / (end_s - start_s)


def mean_yaw_rates(
    stamps_s: ArrayLike, gyro_stamps_s: ArrayLike, yaw_rates_rad_s: ArrayLike, gap_s: float = _GAP_S
) -> FloatArray:
    """Return the mean yaw rate (N,) from each wheel stamp (N,) to the next, at the later one; NaN in a gap.

    `yaw_rates_rad_s` (M,) have growing stamps (M,). A gap is an interval of these over `gap_s`.
    """
    stamps, at, rates = (np.asarray(values, float) for values in (stamps_s, gyro_stamps_s, yaw_rates_rad_s))
    means = np.full(len(stamps), np.nan)
    if len(at) < 2:
        return means
    angles = np.concatenate([[0.0], np.cumsum(np.diff(at) * (rates[1:] + rates[:-1]) / 2)])
    turned = np.interp(stamps, at, angles, left=np.nan, right=np.nan)
    after = np.searchsorted(at, stamps, side="right").clip(1, len(at) - 1)
    turned[at[after] - at[after - 1] > gap_s] = np.nan
    steps_s = np.diff(stamps)
    forward = steps_s > 0
    means[1:][forward] = np.diff(turned)[forward] / steps_s[forward]
    return means


class GyroCheck:
    """Compares a gyroscope with the turns of the wheels; see the module.

    Attributes:
        is_trusted: whether the gyroscope has agreed with the wheels, and not contradicted them since.
        agrees_now: whether it also agrees in the last second.
        problem: how it contradicts the wheels, without a full stop; empty if it does not. It stays once set.
        is_open: whether the problem may as well be that of the wheels.
        is_final: whether a gyroscope that is trusted stays so, because another check watches all sensors. With a dead
            wheel it would be accused, too.
        readings: number of readings of the gyroscope.
    """

    def __init__(self) -> None:
        self.is_trusted = self.agrees_now = False
        self.problem, self.is_open, self.is_final = "", False, False
        self.readings = 0
        self._gyro: deque[tuple[float, float]] = deque()  # stamps and angles
        self._rate = self._angle_rad = 0.0
        # Stamps and turns of the wheels while the gyroscope's rate has not changed.
        self._same: deque[tuple[float, float]] = deque(maxlen=_STUCK_BLOCKS)
        self._spans_s: dict[str, tuple[float, float]] = {}
        self._begin: tuple[float, float] | None = None  # stamp and turn of the wheels at the begin of a block
        self._turn_rad = 0.0
        self._waiting: deque[tuple[float, float, float]] = deque()  # blocks: begin, end, rate of the wheels
        self._wheels: deque[float] = deque(maxlen=_LAST_BLOCKS)  # rates of the blocks
        self._rates: deque[FloatArray] = deque(maxlen=_LAST_BLOCKS)  # rates of the gyroscope at each lag

    def add_rate(self, stamp_s: float, yaw_rate_rad_s: float) -> None:
        """Add a reading of the gyroscope; ignored if it is not finite, or not newer than the last one."""
        if not (math.isfinite(stamp_s) and math.isfinite(yaw_rate_rad_s)):
            return
        self.readings += 1
        self._extend_span("gyroscope", stamp_s)
        if self._gyro and not stamp_s > self._gyro[-1][0]:
            return
        if self._gyro:
            self._angle_rad += (stamp_s - self._gyro[-1][0]) * (self._rate + yaw_rate_rad_s) / 2
        if yaw_rate_rad_s != self._rate or not self._gyro:
            self._same.clear()
        self._rate = yaw_rate_rad_s
        self._gyro.append((stamp_s, self._angle_rad))
        while self._gyro[0][0] < stamp_s - 4 * _GYRO_WAIT_S:
            self._gyro.popleft()

    def add_turn(self, stamp_s: float, turn_rad: float, is_sound: bool = True) -> None:
        """Add a step of the wheels that ends at a stamp; `is_sound` is False for a refused one."""
        self._extend_span("wheels", stamp_s)
        if not is_sound or (self._begin is not None and not stamp_s > self._begin[0]):
            self._begin = None
        if self._begin is None:
            self._begin = (stamp_s, self._turn_rad)
            return
        self._turn_rad += turn_rad
        begin_s, begin_rad = self._begin
        if stamp_s - begin_s < _BLOCK_S:
            return
        if stamp_s - begin_s < 2 * _BLOCK_S:
            self._waiting.append((begin_s, stamp_s, (self._turn_rad - begin_rad) / (stamp_s - begin_s)))
        self._begin = (stamp_s, self._turn_rad)
        self._same.append(self._begin)
        if self._add_blocks(stamp_s):
            self._compare()

    @property
    def warnings(self) -> tuple[str, ...]:
        """One sentence for each problem, after all readings."""
        if self.problem:
            return (f"The gyroscope is left out: {self.problem}.",)
        if not self.readings or self._rates or "wheels" not in self._spans_s:
            return ()
        (first_s, last_s), (begin_s, end_s) = self._spans_s["gyroscope"], self._spans_s["wheels"]
        # At the begin of a drive one sensor starts before the other.
        is_early = min(last_s - first_s, end_s - begin_s) < _GYRO_WAIT_S
        if is_early or (last_s >= begin_s and first_s <= end_s):
            return ()
        return (
            f"The gyroscope is left out: its stamps, {first_s:.10g} to {last_s:.10g} s, do not overlap those of the "
            f"wheels, {begin_s:.10g} to {end_s:.10g} s.",
        )

    def _extend_span(self, whose: str, stamp_s: float) -> None:
        if math.isfinite(stamp_s):
            first_s, last_s = self._spans_s.get(whose, (stamp_s, stamp_s))
            self._spans_s[whose] = (min(first_s, stamp_s), max(last_s, stamp_s))

    def _add_blocks(self, now_s: float) -> bool:
        """Take the rates of blocks that the gyroscope covers at all lags; drop blocks after the longest wait for it.

        Returns:
            Whether there are new ones.
        """
        is_new = False
        while self._waiting and not self.problem:
            begin_s, end_s, rate_rad_s = self._waiting[0]
            is_covered = bool(self._gyro) and self._gyro[-1][0] >= end_s + _MOST_LAG_S
            if not is_covered and now_s < end_s + _GYRO_WAIT_S:
                break
            self._waiting.popleft()
            if is_covered and self._gyro[0][0] <= begin_s - _MOST_LAG_S:
                stamps_s, angles_rad = np.array(self._gyro).T
                ends_s, begins_s = end_s + _LAGS_S, begin_s + _LAGS_S
                turned = np.interp(ends_s, stamps_s, angles_rad) - np.interp(begins_s, stamps_s, angles_rad)
                self._wheels.append(rate_rad_s)
                self._rates.append(turned / (end_s - begin_s))
                is_new = True
        return is_new

    def _compare(self) -> None:
        """Update trust and problem by the rates of the last turns."""
        if len(self._same) > 1 and self._same[-1][0] - self._same[0][0] > _STUCK_S:
            # The gyroscope's rate stays; the wheels may turn at a constant rate too.
            stamps_s, turned_rad = np.array(self._same).T
            even = np.interp(stamps_s, stamps_s[[0, -1]], turned_rad[[0, -1]])
            if np.abs(turned_rad - even).max() > _STUCK_RAD:
                self._accuse(f"it stays at {self._rate + 0.0:.3g} rad/s while the wheels turn the robot")
                return
        wheels, rates = np.array(self._wheels), np.array(self._rates)  # (N,), (N, lags)
        turning = np.flatnonzero(np.abs(wheels) > _TURNING_RAD_S)
        if len(turning) < _TRUST_AFTER:
            return
        first = turning[max(0, len(turning) - _LAST_TURNS)]
        # Blocks before the turns separate the bias from the slope.
        begin = max(0, min(first, len(wheels) - 2 * _LAST_TURNS))
        wheels, rates = wheels[begin:], rates[begin:]
        lines = [RateLine.through(wheels, at_lag) for at_lag in rates.T]
        best = int(np.argmax([line.share for line in lines]))
        line, late_s, now = lines[best], float(_LAGS_S[best]), lines[_NO_LAG]
        is_late = abs(late_s) > _LATE_S and now.left > _CLEARER * line.left
        if len(turning) >= _ACCUSE_AFTER:
            self._accuse(*_contradiction(line, late_s if is_late else 0.0))
        is_sure = now.share > _RELATED_SHARE and now.lies_within() and 3 * now.sigma < 0.15
        if not self.problem and not is_late and is_sure:
            self.is_trusted = True
        last = np.s_[-_RECENT_BLOCKS:]
        off = np.abs(rates[last, _NO_LAG] - now.bias_rad_s - now.slope * wheels[last])
        usual = 4 * math.sqrt(now.left) + 0.1 * np.abs(wheels[last])
        self.agrees_now = self.is_trusted and bool((off < usual).all())

    def _accuse(self, problem: str, is_open: bool = False) -> None:
        if problem and not (self.is_final and self.is_trusted):
            self.problem, self.is_open, self.is_trusted, self.agrees_now = problem, is_open, False, False


def gyro_warnings(recording: Recording) -> tuple[str, ...]:
    """Return the problems of a recording's gyroscope, one sentence each. Decodes no images.

    Raises RecordingError if the recording cannot be read.
    """
    check = GyroCheck()
    if recording.calibration.any_wheels is None:
        return ()
    odometry = odometry_of(recording.calibration)
    for event in recording.events(images=False):
        if isinstance(event, YawRate):
            check.add_rate(event.stamp_s, event.yaw_rate_rad_s)
        elif isinstance(event, WheelReading):
            answer = odometry.process(event)
            check.add_turn(answer.stamp_s, odometry.turned_rad, answer.reason is None)
    return check.warnings


@dataclass(frozen=True, slots=True)
class RateLine:
    """A line of the gyroscope's rate over the wheels'.

    Attributes:
        slope: of the line.
        sigma: standard deviation of the slope.
        bias_rad_s: rate of the gyroscope at rest.
        left: variance of the residuals, (rad/s)².
        share: share of the rates' variance that the line explains.
        scatter: median residual relative to the median rate of the line.
    """

    slope: float
    sigma: float
    bias_rad_s: float
    left: float
    share: float
    scatter: float

    @classmethod
    def through(cls, wheels_rad_s: FloatArray, gyro_rad_s: FloatArray) -> RateLine:
        """Fit a line to blocks (N,), at least three, robustly."""
        x, y = wheels_rad_s, gyro_rad_s
        weights, slope, bias = np.ones(len(x)), 0.0, 0.0
        for _ in range(6):
            total = weights.sum()
            mean_x, mean_y = weights @ x / total, weights @ y / total
            spread = weights @ (x - mean_x) ** 2
            slope = float(weights @ ((x - mean_x) * (y - mean_y)) / max(spread, 1e-12))
            bias = float(mean_y - slope * mean_x)
            off = np.abs(y - bias - slope * x)
            usual = max(1.5 * float(np.median(off)) * 1.4826, 1e-6)
            weights = np.minimum(1.0, usual / np.maximum(off, 1e-12))
        left = float(weights @ off**2 / weights.sum())
        variance = float(weights @ (y - mean_y) ** 2 / weights.sum())
        turning = np.abs(x) > _TURNING_RAD_S
        typical = abs(slope) * np.median(np.abs(x[turning])) if turning.any() else 0.0
        scatter = float(np.median(off[turning]) / typical) if typical > 0 else math.inf
        sigma = math.sqrt(left / max(spread, 1e-12))
        return cls(slope, sigma, bias, left, 1 - left / variance if variance > 0 else 0.0, scatter)

    def lies_within(self, sigmas: float = 0.0) -> bool:
        """Whether the slope is within the limits for wheels that grip or slip, with a margin in sigmas."""
        lowest, highest = _SLIPPING_SCALES if self.scatter > _SLIPPING_SCATTER else _SCALES
        return lowest - sigmas * self.sigma <= self.slope <= highest + sigmas * self.sigma


def _contradiction(line: RateLine, late_s: float) -> tuple[str, bool]:
    """Return how the gyroscope contradicts the wheels, or "", and whether the wheels may as well be wrong."""
    if line.share < _UNRELATED_SHARE and abs(line.slope) < _SIGMAS * line.sigma + 0.3:
        return "it does not measure the turns of the wheels", True
    if line.slope < 0 and line.share > _UNRELATED_SHARE:
        why = "counter-clockwise from above is positive: mounted upside down?"
        return f"it turns the other way than the wheels ({why})", False
    if line.share > _UNRELATED_SHARE and not line.lies_within(_SIGMAS):
        in_degrees = abs(line.slope / math.degrees(1) - 1) < 0.3
        why = "degrees instead of radians?" if in_degrees else "the scale of one of both is wrong"
        return f"it measures turns {line.slope:.3g} times as fast as the wheels ({why})", not in_degrees
    if late_s:
        text = f"its stamps are {abs(late_s):.2g} s {'late' if late_s > 0 else 'early'} against those of the wheels"
        return text, False
    return "", False
