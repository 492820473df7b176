"""ColorCheck: whether colour images are of an earlier time than the depth images that they come with.

Both move sideways in the image as the robot turns, by what the wheels tell of the time between two frames, at some lag:
that of the camera's clock, which both share, and for colour that of the frames by which it is late. Where colour lags
by whole frames more than depth, surfaces and grey values contradict each other where a turn begins or ends.
"""

from __future__ import annotations

from collections import deque
from itertools import takewhile

import cv2
import numpy as np

from wheelsight.core.geometry import ByteArray, Float32Array, FloatArray
from wheelsight.core.messages import RgbdFrame
from wheelsight.core.settings import ColorCheckSettings


class ColorCheck:
    """Compares as frames come, until so many are known.

    Args:
        settings: of None, the defaults.

    Attributes:
        late: by how many frames colour is late, as far as it is likely; else 0.
        is_sure: whether that is sure. is_sound: whether it surely is not late.
    """

    def __init__(self, settings: ColorCheckSettings | None = None) -> None:
        self.settings = of = settings or ColorCheckSettings()
        # A little farther than the last one, which rounding would leave out.
        end_s = of.last_lag_s + of.lag_step_s / 20
        self._lags_s: FloatArray = np.arange(of.first_lag_s, end_s, of.lag_step_s)
        self.late, self.is_sure, self.is_sound = 0, False, False
        self._last: tuple[float, Float32Array, Float32Array] | None = None
        # Of pairs of frames: when both were, and by how many pixels colour and depth moved.
        self._shifts: deque[tuple[float, float, float, float]] = deque(maxlen=of.most_shifts)
        self._hanning: Float32Array | None = None
        self._headings: deque[tuple[float, float]] = deque(maxlen=of.most_readings)

    def hear(self, stamp_s: float, heading_rad: float) -> None:
        """Take where the wheels say that the robot heads."""
        if self._headings:
            before_s, before_rad = self._headings[-1]
            if not stamp_s > before_s:
                return
            heading_rad = before_rad + float(np.remainder(heading_rad - before_rad + np.pi, 2 * np.pi) - np.pi)
        self._headings.append((stamp_s, heading_rad))
        first_s = min(self._shifts[0][0] if self._shifts else stamp_s, stamp_s)
        while self._headings[0][0] < first_s - self.settings.turning_s:
            self._headings.popleft()

    @property
    def _turns(self) -> bool:
        """Whether the robot turned lately, so that an image that is late may show it."""
        now_s = self._headings[-1][0] if self._headings else 0.0
        newest_first = takewhile(lambda told: told[0] > now_s - self.settings.turning_s, reversed(self._headings))
        recent = [rad for _, rad in newest_first]
        return bool(recent) and max(recent) - min(recent) > self.settings.turning_rad

    def see(self, frame: RgbdFrame) -> None:
        """Take a frame, in order of time."""
        if self.is_sound or self.is_sure:
            return
        of = self.settings
        grey, near = _small(frame.color, of.width_px), _nearness(frame, of)
        last, self._last = self._last, (frame.stamp_s, grey, near)
        if not self._turns or last is None or last[1].shape != grey.shape or last[2].shape != near.shape:
            return
        if self._hanning is None or self._hanning.shape != grey.shape:
            self._hanning = np.asarray(cv2.createHanningWindow(grey.shape[::-1], cv2.CV_32F), np.float32)
        (shift_px, _), alike = cv2.phaseCorrelate(last[1], grey, self._hanning)
        by_depth_px = _shift_of(last[2], near, of)
        self._shifts.append((last[0], frame.stamp_s, shift_px if alike > of.alike else np.nan, by_depth_px))
        if len(self._shifts) % of.every_frames == 0:
            self._judge()

    def _judge(self) -> None:
        """How much likelier each number of frames is than none, at whatever lag of the clock."""
        of, lags_s = self.settings, self._lags_s
        begin_s, end_s, color, depth = np.array(self._shifts).T
        period_s = float(np.median(end_s - begin_s))
        if not self._headings:
            return
        told = end_s < self._headings[-1][0] + lags_s[0]
        turned = self._turned(begin_s[told], end_s[told])
        if not turned.size or np.abs(turned).sum(axis=1).min() < of.least_turn_rad:
            return
        (by_color, color_share), (by_depth, depth_share) = (_misfits(x[told], turned, of) for x in (color, depth))
        if min(color_share, depth_share) < of.followed_share:
            self.late, self.is_sure = 0, False
            return
        clock = (lags_s / of.clock_s) ** 2
        best = [np.inf] * (of.latest_frames + 1)
        for late in range(of.latest_frames + 1):
            at = np.interp(lags_s + late * period_s, lags_s, by_color, right=np.inf)
            best[late] = float(np.min(at + by_depth + clock))
        likeliest = int(np.argmin(best))
        more = best[0] - best[likeliest]
        self.is_sound = likeliest == 0 and min(best[1:]) - best[0] > of.sure
        is_late = likeliest * period_s > of.least_lag_s and more > (0.0 if self.late else of.likely)
        self.late, self.is_sure = (likeliest, more > of.sure) if is_late else (0, False)

    def _turned(self, begin_s: FloatArray, end_s: FloatArray) -> FloatArray:
        """By how much the wheels turned (L, N) between stamps (N,), at each lag."""
        stamps_s, headings_rad = np.array(self._headings).T
        return np.array(
            [
                np.interp(end_s - lag_s, stamps_s, headings_rad) - np.interp(begin_s - lag_s, stamps_s, headings_rad)
                for lag_s in self._lags_s
            ]
        )


def _small(color: ByteArray, width_px: int) -> Float32Array:
    grey = np.asarray(cv2.cvtColor(color, cv2.COLOR_RGB2GRAY))
    size = (width_px, max(1, round(width_px * grey.shape[0] / grey.shape[1])))
    return np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), np.float32)


def _nearness(frame: RgbdFrame, of: ColorCheckSettings) -> Float32Array:
    depth_m = frame.depth_m
    size = (of.width_px, max(1, round(of.width_px * depth_m.shape[0] / depth_m.shape[1])))
    thin = np.asarray(cv2.resize(depth_m, size, interpolation=cv2.INTER_NEAREST))
    return np.where(thin > 0, 1 / np.maximum(thin, np.float32(of.nearest_m)), np.float32(0)).astype(np.float32)


def _shift_of(before: Float32Array, now: Float32Array, of: ColorCheckSettings) -> float:
    """By how many pixels an image of nearness moved to the right; NaN where none fits."""
    costs = np.full(2 * of.most_px + 1, 0.1)
    width = before.shape[1]
    known_before, known_now = before > 0, now > 0
    for place, shift in enumerate(range(-of.most_px, of.most_px + 1)):
        first, then = slice(max(0, -shift), width - max(0, shift)), slice(max(0, shift), width - max(0, -shift))
        both = known_before[:, first] & known_now[:, then]
        if np.count_nonzero(both) > 0.05 * both.size:
            costs[place] = np.minimum(np.abs(before[:, first] - now[:, then])[both], 0.1).mean()
    i = int(costs.argmin())
    if not 0 < i < len(costs) - 1 or 1 - costs[i] / np.median(costs) < of.alike:
        return np.nan
    left, middle, right = costs[i - 1 : i + 2]
    return float(i - of.most_px + (left - right) / (2 * max(left - 2 * middle + right, 1e-9)))


def _misfits(shifts_px: FloatArray, turned_rad: FloatArray, of: ColorCheckSettings) -> tuple[FloatArray, float]:
    """χ² (L,) of shifts (N,) as multiples of turns (L, N) at each lag, by their own scatter at the best one.

    And the share of the shifts that turns explain there; 1 where too little is known.
    """
    known = np.isfinite(shifts_px)
    if np.count_nonzero(known) < of.fewest_shifts:
        return np.zeros(len(turned_rad)), 1.0
    x, w = shifts_px[known], turned_rad[:, known]
    weights = np.ones_like(w)
    for _ in range(4):
        gain = np.sum(weights * w * x, axis=1) / np.maximum(np.sum(weights * w * w, axis=1), 1e-12)
        off = np.abs(x - gain[:, None] * w)
        weights = np.minimum(1.0, of.shift_px / np.maximum(off, 1e-9))
    cost = np.sum(weights * off**2, axis=1)
    unexplained = np.sum(np.minimum(np.abs(x), of.shift_px) * np.abs(x))
    share = 1 - float(cost.min() / max(unexplained, 1e-12))
    return np.asarray((cost / max(cost.min(), 1e-12) - 1) * len(x)), share
