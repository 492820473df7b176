"""MotionClock: by how much the stamps of camera and wheels are apart, as the turns of both show.

A robot that turns moves the image sideways. Where camera and wheels count from one moment, images move while the wheels
turn the robot; else they do so earlier or later, by the difference of the clocks.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.events import Event, OdometryReading, RgbdFrame, WheelSpeeds, WheelTicks, YawRate
from wheelsight.geometry import ByteArray, Float32Array, FloatArray

# The largest difference of clocks that is looked for, and its steps, seconds. Larger ones show in the receipts.
_MOST_S, _STEP_S, _FINE_S = 3.5, 0.02, 0.002
# Images are compared this wide, and so long after each other at least: less shows no turn.
_WIDTH_PX, _APART_S = 160, 0.06
# Peaks of phase correlation below this are of views that have little in common.
_LEAST_RESPONSE = 0.1
# How well turns agree at the best difference; and how much more of them any other leaves unexplained that is so far
# from it, seconds. A robot that turns at one speed all along shows no difference.
_LEAST_AGREEMENT, _LEAST_RATIO, _OTHER_S = 0.8, 1.5, 0.3
# What must have been turned, radians, and be compared, pairs of frames.
_LEAST_TURN_RAD, _FEWEST = 0.6, 20
# A camera whose optical axis is within 30° of the vertical sees turns about it, not to the side.
_LEAST_SIDEWAYS = 0.5
# One reading does not turn a robot further: such a step is a counter's that rolled over.
_LARGEST_STEP_RAD = 1.0
# Over a longer gap nothing is known of the rate, seconds.
_LONGEST_STEP_S = 1.0
# Stamps are of different clocks where they are further apart than a driver delays a message.
LEAST_OFFSET_S = 0.05


@dataclass(frozen=True, slots=True)
class MotionOffset:
    """How the clocks of camera and another sensor lie to each other, by the turns that both have seen.

    Attributes:
        offset_s: how far the camera's stamps are ahead of the other's; None where the turns do not show it.
        sigma_s: its standard deviation, by how well turns fit.
        agreement: correlation of the turns at it, 0 to 1.
        turned_rad: how far the other sensor turned in the time that was compared, both ways added.
        why_not: why it is not known; empty where it is.
    """

    offset_s: float | None
    sigma_s: float = 0.0
    agreement: float = 0.0
    turned_rad: float = 0.0
    why_not: str = ""

    @property
    def is_apart(self) -> bool:
        """Whether the clocks are apart by more than a driver delays a message, and surely so."""
        return self.offset_s is not None and abs(self.offset_s) > max(LEAST_OFFSET_S, 3 * self.sigma_s)

    def __str__(self) -> str:
        if self.offset_s is None:
            return f"the turns of both do not show it: {self.why_not}"
        side = "ahead" if self.offset_s > 0 else "behind"
        found = f"{abs(self.offset_s):.3f} s {side} (σ {self.sigma_s:.3f} s, correlation {self.agreement:.2f}"
        return f"{found} over {self.turned_rad:.1f} rad of turns)"


class MotionClock:
    """Compares as events come, in any order of sensors.

    Args:
        calibration: of the cameras, and of two wheels where ticks or speeds tell of them.
    """

    def __init__(self, calibration: Calibration) -> None:
        self._wheels = calibration.wheels
        color, T_base_camera = calibration.color, calibration.T_base_camera
        self._focal_px = None if color is None else (color.fx / color.width, color.fy / color.width)
        up = np.array([0.0, -1.0, 0.0])  # of a camera that looks ahead
        if T_base_camera is not None and color is not None:
            up = calibration.T_color_camera[:3, :3] @ T_base_camera[:3, :3].T[:, 2]
        # How far the middle of the image moves, right and down, in a turn by a radian: in tangents.
        self._moves = np.array([-up[1], up[0]])
        self._last: tuple[float, Float32Array] | None = None
        self._shifts: list[tuple[float, float, float]] = []
        self._headings: dict[str, list[tuple[float, float]]] = {"wheels": [], "gyroscope": []}
        self._reading: WheelTicks | WheelSpeeds | OdometryReading | None = None
        self._rate: YawRate | None = None
        self._hanning: Float32Array | None = None

    @property
    def turned_rad(self) -> float:
        """How far the wheels have turned the robot by now, both ways added."""
        turned = np.array([rad for _, rad in self._headings["wheels"]])
        return float(np.abs(np.diff(turned)).sum())

    def add(self, event: Event) -> None:
        """Take a frame or a reading; frames sooner than shows a turn are passed over."""
        if isinstance(event, RgbdFrame):
            self.see(event.stamp_s, event.color)
        elif isinstance(event, YawRate):
            self._turn(event)
        elif isinstance(event, WheelTicks | WheelSpeeds | OdometryReading):
            self._read(event)

    def wants(self, stamp_s: float) -> bool:
        """Whether an image of a stamp is long enough after the last one."""
        return self._last is None or stamp_s - self._last[0] >= _APART_S

    def see(self, stamp_s: float, color: ByteArray) -> None:
        """Take a colour image (H, W, 3)."""
        if self._focal_px is None or not self.wants(stamp_s):
            return
        grey = np.asarray(cv2.cvtColor(color, cv2.COLOR_RGB2GRAY))
        size = (_WIDTH_PX, max(1, round(_WIDTH_PX * grey.shape[0] / grey.shape[1])))
        now = np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), np.float32)
        last, self._last = self._last, (stamp_s, now)
        if last is None or last[1].shape != now.shape:
            return
        if self._hanning is None or self._hanning.shape != now.shape:
            self._hanning = np.asarray(cv2.createHanningWindow(now.shape[::-1], cv2.CV_32F), np.float32)
        shift_px, response = cv2.phaseCorrelate(last[1], now, self._hanning)
        if response < _LEAST_RESPONSE:
            return
        moved = np.array(shift_px) / _WIDTH_PX / self._focal_px
        self._shifts.append((last[0], stamp_s, float(self._moves @ moved)))

    def offset(self, sensor: str = "wheels") -> MotionOffset:
        """Of the camera against the "wheels" or the "gyroscope", by all that came."""
        headings, shifts = np.array(self._headings[sensor]).reshape(-1, 2), np.array(self._shifts).reshape(-1, 3)
        if len(headings) < 2 or len(shifts) < _FEWEST:
            return MotionOffset(None, why_not=f"{len(shifts)} pairs of images and {len(headings)} readings tell of it")
        if np.linalg.norm(self._moves) < _LEAST_SIDEWAYS:
            return MotionOffset(None, why_not="the camera looks along the axis of the turns")
        headings = headings[np.concatenate([[True], np.diff(headings[:, 0]) > 0])]
        lags_s = np.arange(-_MOST_S, _MOST_S + _STEP_S / 2, _STEP_S)
        found = np.array([_agreement(headings, shifts, lag_s) for lag_s in lags_s])
        best = int(found.argmax())
        near_s = lags_s[best] + np.arange(-_STEP_S, _STEP_S + _FINE_S / 2, _FINE_S)
        offset_s = float(near_s[np.argmax([_agreement(headings, shifts, lag_s) for lag_s in near_s])])
        turned = _turned(headings, shifts, offset_s)
        turned_rad = float(np.abs(turned[0]).sum())
        others = found[np.abs(lags_s - offset_s) > _OTHER_S]
        shown = 0.0, float(found[best]), turned_rad
        if turned_rad < _LEAST_TURN_RAD or len(turned[0]) < _FEWEST:
            return MotionOffset(None, *shown, f"{turned_rad:.2f} rad were turned, {_LEAST_TURN_RAD:g} show it")
        if found[best] < _LEAST_AGREEMENT:
            why_not = f"turns agree by {found[best]:.2f} at best, {_LEAST_AGREEMENT:g} would show it"
            return MotionOffset(None, *shown, why_not)
        if 1 - max(others.max(initial=0.0), 0.0) ** 2 < _LEAST_RATIO * (1 - found[best] ** 2):
            return MotionOffset(None, *shown, "they agree at other differences nearly as well")
        return MotionOffset(offset_s, _sigma_s(headings, shifts, offset_s), *shown[1:])

    def _read(self, reading: WheelTicks | WheelSpeeds | OdometryReading) -> None:
        before, self._reading = self._reading, reading
        if isinstance(reading, OdometryReading):
            last = reading if not isinstance(before, OdometryReading) else before
            step_rad = float(np.remainder(reading.yaw_rad - last.yaw_rad + np.pi, 2 * np.pi) - np.pi)
            self._step(reading.stamp_s, step_rad)
            return
        of = self._wheels
        if of is None:
            return
        if isinstance(reading, WheelSpeeds):  # from its stamp until the next one
            was = before if isinstance(before, WheelSpeeds) else reading
            rate = (was.right_rad_s * of.right_radius_m - was.left_rad_s * of.left_radius_m) / of.track_width_m
            self._step(reading.stamp_s, rate * (reading.stamp_s - was.stamp_s))
            return
        start = before if isinstance(before, WheelTicks) else reading
        left, right = reading.left - start.left, reading.right - start.right
        turns_m = (right * of.right_radius_m - left * of.left_radius_m) * 2 * np.pi / of.ticks_per_turn
        self._step(reading.stamp_s, turns_m / of.track_width_m)

    def _step(self, stamp_s: float, step_rad: float) -> None:
        headings = self._headings["wheels"]
        delay_s = 0.0 if self._wheels is None else self._wheels.delay_s
        last_rad = headings[-1][1] if headings else 0.0
        headings.append((stamp_s - delay_s, last_rad + (step_rad if abs(step_rad) < _LARGEST_STEP_RAD else 0.0)))

    def _turn(self, rate: YawRate) -> None:
        """Take a gyroscope's reading; between two the rate is their mean."""
        headings, before = self._headings["gyroscope"], self._rate or rate
        last_rad = headings[-1][1] if headings else 0.0
        step_s = min(max(rate.stamp_s - before.stamp_s, 0.0), _LONGEST_STEP_S)
        mean_rad_s = (before.yaw_rate_rad_s + rate.yaw_rate_rad_s) / 2
        headings.append((rate.stamp_s, last_rad + mean_rad_s * step_s))
        self._rate = rate


def _turned(headings: FloatArray, shifts: FloatArray, lag_s: float) -> tuple[FloatArray, FloatArray]:
    """(M,) turns by the sensor between the images that lie within its readings, and (M,) those that images show."""
    begin_s, end_s = shifts[:, 0] - lag_s, shifts[:, 1] - lag_s
    inside = (begin_s >= headings[0, 0]) & (end_s <= headings[-1, 0])
    ends = (np.interp(at_s[inside], headings[:, 0], headings[:, 1]) for at_s in (end_s, begin_s))
    return np.subtract(*ends), shifts[inside, 2]


def _agreement(headings: FloatArray, shifts: FloatArray, lag_s: float) -> float:
    """Correlation of the turns at a difference of clocks; 0 where fewer than half of the images are compared."""
    turned, seen = _turned(headings, shifts, lag_s)
    if len(turned) < max(_FEWEST, len(shifts) / 2):
        return 0.0
    size = float(np.sqrt(np.sum(turned**2) * np.sum(seen**2)))
    return float(turned @ seen) / size if size > 0 else 0.0


def _sigma_s(headings: FloatArray, shifts: FloatArray, offset_s: float) -> float:
    """Of a difference of clocks, by what turns leave unexplained there, over how fast they change with it."""
    turned, seen = _turned(headings, shifts, offset_s)
    gain = float(turned @ seen) / max(float(turned @ turned), 1e-12)
    ends = [_turned(headings, shifts, offset_s + side * _STEP_S)[0] for side in (-1, 1)]
    count = min(len(turned), *map(len, ends))
    slope = gain * (ends[1][:count] - ends[0][:count]) / (2 * _STEP_S)
    scatter = float(np.mean((seen - gain * turned) ** 2))
    return float(np.sqrt(scatter / max(float(slope @ slope), 1e-12)))
