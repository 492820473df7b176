"""ColorCheck: detects colour images that are older than the depth images of the same frame.

When the robot turns, both images shift sideways in proportion to the turn of the wheels. The shift lags by the delay of
the camera's clock, which both share, and for colour by its delay in frames. If colour lags by whole frames more than
depth, surfaces and grey values contradict each other at the begin and end of a turn.
"""

from __future__ import annotations

from collections import deque
from itertools import takewhile

import cv2
import numpy as np

from wheelsight.core.geometry import Float32Array, FloatArray
from wheelsight.core.messages import RgbdFrame
from wheelsight.core.settings import ColorCheckSettings


class ColorCheck:
    """Compares the shifts of colour and depth with the turns of the wheels, until the result is certain.

    Args:
        settings: None for the defaults.

    Attributes:
        late: likely delay of colour in frames; else 0.
        is_sure: whether the delay is certain.
        is_sound: whether it is certain that colour is not late.
    """

    def __init__(self, settings: ColorCheckSettings | None = None) -> None:
        self.settings = of = settings or ColorCheckSettings()
        # Beyond the last lag, so that rounding does not exclude it.
        end_s = of.last_lag_s + of.lag_step_s / 20
        self._lags_s: FloatArray = np.arange(of.first_lag_s, end_s, of.lag_step_s)
        self.late, self.is_sure, self.is_sound = 0, False, False
        self._last: tuple[float, Float32Array, Float32Array] | None = None
        # For each pair of frames: both stamps, and the shifts of colour and depth in pixels.
        self._shifts: deque[tuple[float, float, float, float]] = deque(maxlen=of.most_shifts)
        self._hanning: Float32Array | None = None
        self._headings: deque[tuple[float, float]] = deque(maxlen=of.most_readings)

    def add_heading(self, stamp_s: float, heading_rad: float) -> None:
        """Add the robot's heading by the wheels."""
        if self._headings:
            before_s, before_rad = self._headings[-1]
            if not stamp_s > before_s:
                return
            heading_rad = before_rad + float(np.remainder(heading_rad - before_rad + np.pi, 2 * np.pi) - np.pi)
        self._headings.append((stamp_s, heading_rad))
        first_s = min(self._shifts[0][0] if self._shifts else stamp_s, stamp_s)
        while self._headings[0][0] < first_s - self.settings.turning_s:
            self._headings.popleft()

    def add_frame(self, frame: RgbdFrame) -> None:
        """Add a frame, in order of time."""
        if self.is_sound or self.is_sure:
            return
        of = self.settings
        whole = np.asarray(cv2.cvtColor(frame.color, cv2.COLOR_RGB2GRAY))
        size = (of.width_px, max(1, round(of.width_px * whole.shape[0] / whole.shape[1])))
        grey = np.asarray(cv2.resize(whole, size, interpolation=cv2.INTER_AREA), np.float32)
        height_px, width_px = frame.depth_m.shape
        size = (of.width_px, max(1, round(of.width_px * height_px / width_px)))
        thin = np.asarray(cv2.resize(frame.depth_m, size, interpolation=cv2.INTER_NEAREST))
        near = np.where(thin > 0, 1 / np.maximum(thin, np.float32(of.nearest_m)), np.float32(0)).astype(np.float32)
        last, self._last = self._last, (frame.stamp_s, grey, near)
        now_s = self._headings[-1][0] if self._headings else 0.0
        newest_first = takewhile(lambda heading: heading[0] > now_s - of.turning_s, reversed(self._headings))
        recent = [rad for _, rad in newest_first]
        is_turning = bool(recent) and max(recent) - min(recent) > of.turning_rad
        if not is_turning or last is None or last[1].shape != grey.shape or last[2].shape != near.shape:
            return
        if self._hanning is None or self._hanning.shape != grey.shape:
            self._hanning = np.asarray(cv2.createHanningWindow(grey.shape[::-1], cv2.CV_32F), np.float32)
        (shift_px, _), alike = cv2.phaseCorrelate(last[1], grey, self._hanning)
        by_depth_px = _shift_of(last[2], near, of)
        self._shifts.append((last[0], frame.stamp_s, shift_px if alike > of.alike else np.nan, by_depth_px))
        if len(self._shifts) % of.every_frames == 0:
            self._judge()

    def _judge(self) -> None:
        """Compare the likelihoods of all delays in frames, each at the best lag of the clock."""
        of, lags_s = self.settings, self._lags_s
        begin_s, end_s, color, depth = np.array(self._shifts).T
        period_s = float(np.median(end_s - begin_s))
        if not self._headings:
            return
        is_known = end_s < self._headings[-1][0] + lags_s[0]
        stamps_s, headings_rad = np.array(self._headings).T
        begin_s, end_s = begin_s[is_known], end_s[is_known]
        turned = np.array(  # (L, N) by the wheels, at each lag
            [
                np.interp(end_s - lag_s, stamps_s, headings_rad) - np.interp(begin_s - lag_s, stamps_s, headings_rad)
                for lag_s in lags_s
            ]
        )
        if not turned.size or np.abs(turned).sum(axis=1).min() < of.least_turn_rad:
            return
        (by_color, color_share), (by_depth, depth_share) = (_misfits(x[is_known], turned, of) for x in (color, depth))
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


def _shift_of(before: Float32Array, now: Float32Array, of: ColorCheckSettings) -> float:
    """Return the shift to the right of an image of inverse depth, in pixels; NaN if none fits."""
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
    """Return χ² (L,) of shifts (N,) as multiples of turns (L, N) at each lag, and the share that turns explain.

    χ² is relative to the scatter at the best lag. The share is that at the best lag; 1 if there are too few shifts.
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
