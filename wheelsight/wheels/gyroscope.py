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
from wheelsight.wheels.odometry import GyroCheckSettings, WheelSettings

_GAP_S = WheelSettings().gyro_gap_s


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


_DEGREES = 180 / math.pi


@dataclass(frozen=True, slots=True)
class Line:
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
    def through(cls, wheels_rad_s: FloatArray, gyro_rad_s: FloatArray, turning_rad_s: float) -> Line:
        """Fit a line to blocks (N,), at least three, robustly. Only rates over `turning_rad_s` count as turns."""
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
        turning = np.abs(x) > turning_rad_s
        typical = abs(slope) * np.median(np.abs(x[turning])) if turning.any() else 0.0
        scatter = float(np.median(off[turning]) / typical) if typical > 0 else math.inf
        sigma = math.sqrt(left / max(spread, 1e-12))
        return cls(slope, sigma, bias, left, 1 - left / variance if variance > 0 else 0.0, scatter)

    def lies_within(self, settings: GyroCheckSettings, sigmas: float = 0.0) -> bool:
        """Whether the slope is within the limits for wheels that grip or slip, with a margin in sigmas."""
        of, room = settings, sigmas * self.sigma
        if self.scatter > of.slipping_scatter:
            return of.lowest_slipping_scale - room <= self.slope <= of.highest_slipping_scale + room
        return of.lowest_scale - room <= self.slope <= of.highest_scale + room


class GyroCheck:
    """Compares a gyroscope with the turns of the wheels; see the module.

    Args:
        settings: None for the defaults.

    Attributes:
        is_trusted: whether the gyroscope has agreed with the wheels, and not contradicted them since.
        agrees_now: whether it also agrees in the last second.
        problem: how it contradicts the wheels, without a full stop; empty if it does not. It stays once set.
        readings: number of readings of the gyroscope.
    """

    def __init__(self, settings: GyroCheckSettings | None = None) -> None:
        self.settings = of = settings or GyroCheckSettings()
        self._lags_s = np.linspace(-of.most_lag_s, of.most_lag_s, of.lags)
        self.is_trusted = self.agrees_now = False
        self.problem = ""
        self.readings = 0
        self._gyro: deque[tuple[float, float]] = deque()  # stamps and angles
        self._rate = self._angle_rad = 0.0
        # Stamps and turns of the wheels while the gyroscope's rate has not changed.
        self._same: deque[tuple[float, float]] = deque(maxlen=of.stuck_blocks)
        self._spans_s: dict[str, tuple[float, float]] = {}
        self._begin: tuple[float, float] | None = None  # stamp and turn of the wheels at the begin of a block
        self._turn_rad = self._moved_s = 0.0
        self._waiting: deque[tuple[float, float, float]] = deque()  # blocks: begin, end, rate of the wheels
        self._wheels: deque[float] = deque(maxlen=of.last_blocks)  # rates of the blocks
        self._rates: deque[FloatArray] = deque(maxlen=of.last_blocks)  # rates of the gyroscope at each lag

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
        while self._gyro[0][0] < stamp_s - 4 * self.settings.unheard_s:
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
        if stamp_s - begin_s < self.settings.block_s:
            return
        if stamp_s - begin_s < 2 * self.settings.block_s:
            self._waiting.append((begin_s, stamp_s, (self._turn_rad - begin_rad) / (stamp_s - begin_s)))
        self._begin = (stamp_s, self._turn_rad)
        self._same.append(self._begin)
        self._compare_blocks(stamp_s)

    @property
    def warnings(self) -> tuple[str, ...]:
        """One sentence for each problem, after all readings."""
        if self.problem:
            return (f"The gyroscope is left out: {self.problem}.",)
        if not self.readings or self._rates or "wheels" not in self._spans_s:
            return ()
        (first_s, last_s), (begin_s, end_s) = self._spans_s["gyroscope"], self._spans_s["wheels"]
        if last_s >= begin_s and first_s <= end_s:
            return ()
        return (
            f"The gyroscope is left out: its stamps, {first_s:.10g} to {last_s:.10g} s, do not overlap those of the "
            f"wheels, {begin_s:.10g} to {end_s:.10g} s.",
        )

    def _extend_span(self, whose: str, stamp_s: float) -> None:
        if math.isfinite(stamp_s):
            first_s, last_s = self._spans_s.get(whose, (stamp_s, stamp_s))
            self._spans_s[whose] = (min(first_s, stamp_s), max(last_s, stamp_s))

    def _compare_blocks(self, now_s: float) -> None:
        """Compare the blocks that the gyroscope covers at all lags; drop blocks after the longest wait for it."""
        is_new, latest_s = False, self.settings.most_lag_s
        while self._waiting and not self.problem:
            begin_s, end_s, rate_rad_s = self._waiting[0]
            is_covered = bool(self._gyro) and self._gyro[-1][0] >= end_s + latest_s
            if not is_covered and now_s < end_s + self.settings.unheard_s:
                break
            self._waiting.popleft()
            if is_covered and self._gyro[0][0] <= begin_s - latest_s:
                stamps_s, angles_rad = np.array(self._gyro).T
                ends_s, begins_s = end_s + self._lags_s, begin_s + self._lags_s
                turned = np.interp(ends_s, stamps_s, angles_rad) - np.interp(begins_s, stamps_s, angles_rad)
                self._wheels.append(rate_rad_s)
                self._rates.append(turned / (end_s - begin_s))
                is_new = True
        if is_new:
            self._judge()

    def _judge(self) -> None:
        of = self.settings
        if self._is_stuck():
            self._accuse(f"it stays at {self._rate + 0.0:.3g} rad/s while the wheels turn the robot")
            return
        wheels, rates = np.array(self._wheels), np.array(self._rates)
        turning = np.flatnonzero(np.abs(wheels) > of.turning_rad_s)
        if len(turning) < of.trust_after:
            return
        first = turning[max(0, len(turning) - of.last_turns)]
        # Blocks before the turns separate the bias from the slope.
        begin = max(0, min(first, len(wheels) - 2 * of.last_turns))
        self._compare(wheels[begin:], rates[begin:], len(turning))

    def _compare(self, wheels: FloatArray, rates: FloatArray, turns: int) -> None:
        """Update trust and problem by rates of the wheels (N,) and of the gyroscope at all lags (N, L)."""
        of, no_lag = self.settings, len(self._lags_s) // 2
        lines = [Line.through(wheels, at_lag, of.turning_rad_s) for at_lag in rates.T]
        best = int(np.argmax([line.share for line in lines]))
        line, late_s, now = lines[best], float(self._lags_s[best]), lines[no_lag]
        is_late = abs(late_s) > of.late_s and now.left > of.clearer * line.left
        if turns >= of.accuse_after:
            self._accuse(_contradiction(line, late_s if is_late else 0.0, of))
        is_sure = now.share > of.followed_share and now.lies_within(of) and 3 * now.sigma < 0.15
        if not self.problem and not is_late and is_sure:
            self.is_trusted = True
        last = np.s_[-of.recent_blocks :]
        off = np.abs(rates[last, no_lag] - now.bias_rad_s - now.slope * wheels[last])
        usual = 4 * math.sqrt(now.left) + 0.1 * np.abs(wheels[last])
        self.agrees_now = self.is_trusted and bool((off < usual).all())

    def _is_stuck(self) -> bool:
        """Whether the gyroscope's rate stays while the wheels deviate from a constant rate."""
        if len(self._same) < 2 or not self._same[-1][0] - self._same[0][0] > self.settings.stuck_s:
            return False
        stamps_s, turned_rad = np.array(self._same).T
        even = np.interp(stamps_s, stamps_s[[0, -1]], turned_rad[[0, -1]])
        return bool(np.abs(turned_rad - even).max() > self.settings.stuck_rad)

    def _accuse(self, problem: str) -> None:
        if problem:
            self.problem, self.is_trusted, self.agrees_now = problem, False, False


def gyro_warnings(recording: Recording, settings: GyroCheckSettings | None = None) -> tuple[str, ...]:
    """Return the problems of a recording's gyroscope, one sentence each. Decodes no images.

    Raises RecordingError if the recording cannot be read.
    """
    check = GyroCheck(settings)
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


def _contradiction(line: Line, late_s: float, of: GyroCheckSettings) -> str:
    """Return how the gyroscope contradicts the wheels, or ""."""
    if line.share < of.deaf_share and abs(line.slope) < of.sigmas * line.sigma + 0.3:
        return "it does not measure the turns of the wheels"
    if line.slope < 0 and line.share > of.deaf_share:
        return "it turns the other way than the wheels (counter-clockwise from above is positive: mounted upside down?)"
    if line.share > of.deaf_share and not line.lies_within(of, of.sigmas):
        in_degrees = abs(line.slope / _DEGREES - 1) < 0.3
        why = "degrees instead of radians?" if in_degrees else "the scale of one of both is wrong"
        return f"it measures turns {line.slope:.3g} times as fast as the wheels ({why})"
    if late_s:
        return f"its stamps are {abs(late_s):.2g} s {'late' if late_s > 0 else 'early'} against those of the wheels"
    return ""
