"""The host clock of all stamps: seconds since 1970 that never run backwards. `ClockMap` maps a controller's clock
onto it, and `CameraClock` that of a camera.
"""

from __future__ import annotations

import math
import time
from collections import deque
from dataclasses import dataclass
from functools import cache
from itertools import pairwise

from wheelsight.core.settings import LiveCameraSettings

# The one host clock that stamps of all devices are told in: seconds since 1970 that never run backwards.


@cache
def unix_offset_s() -> float:
    """Seconds since 1970 at which the monotonic clock was 0, as the system had it when first asked for.

    Kept for the life of the program: where a time server sets the system's clock meanwhile, stamps of two devices
    would else differ by that step.
    """
    return time.time() - time.monotonic()


def now_s() -> float:
    """Now."""
    return unix_offset_s() + time.monotonic()


# What the controller's clock means in host time: offset and drift, found beneath the delays of the transport.
#
# A frame arrives when it was sent plus a delay that is never negative, often small, and sometimes large. Plotted over
# the controller's clock, arrivals lie on or above a line whose slope is the drift and whose height is the offset: the
# line beneath all points with the least distance to them in sum. That is the edge of their lower convex hull above
# which their mean lies (Moon, Skelly & Towsley, *Estimation and removal of clock skew from network delay
# measurements*, INFOCOM 1999). What no observer of one-way arrivals can tell is the smallest delay itself; it stays
# in the offset.


WINDOW_S = 60.0
_BUCKET_S = 0.5
_SHORTEST_SPAN_S = 4.0
_LARGEST_DRIFT = 0.01
_LEAST_PROGRESS = 0.5
_TICK_S = 1e-6

_Point = tuple[float, float]


class ClockMap:
    """Maps seconds of the controller's clock to seconds of the host's, from the arrivals of its frames.

    Only the earliest arrival of each half second of the last minute is kept, so an update takes constant time.
    Before four seconds have passed, the drift is taken for zero; it is held within ±`largest_drift`.
    """

    def __init__(self, largest_drift: float = _LARGEST_DRIFT) -> None:
        self._largest_drift = largest_drift
        self._points: deque[_Point] = deque()
        self._slope, self._offset_s = 1.0, 0.0
        self._last: _Point | None = None

    @property
    def drift_ppm(self) -> float:
        """How much faster than the host's the controller's clock runs, in millionths."""
        return (1 / self._slope - 1) * 1e6

    @property
    def is_begun(self) -> bool:
        """Whether it has learned of any arrival since it began, or began anew."""
        return bool(self._points)

    def sigma_s(self, first_s: float) -> float:
        """Standard deviation of `host_s`, beside the smallest delay, which nobody can tell.

        How far the kept arrivals lie above the line, on average, tells how much delays vary. A line through `n` points
        that vary by σ is known to 2σ/√n at its end. `first_s` is that of one arrival alone.
        """
        if not self._points:
            return first_s
        late_s = sum(arrival_s - self.host_s(clock_s) for clock_s, arrival_s in self._points) / len(self._points)
        count = float(len(self._points))
        return max(2 * late_s / math.sqrt(count), first_s / (count * math.sqrt(count)))

    def host_s(self, clock_s: float) -> float:
        """Host time at which the controller's clock showed `clock_s`, later by the smallest delay of the transport."""
        return self._offset_s + self._slope * clock_s

    def update(self, clock_s: float, arrival_s: float) -> None:
        """Learn that what was sent at `clock_s` arrived at `arrival_s`; `clock_s` must not decrease."""
        early_s = self.host_s(clock_s) - arrival_s if self._points else 0.0
        bucket = self._points[-1] if self._points else None
        if bucket is None or clock_s // _BUCKET_S > bucket[0] // _BUCKET_S:
            self._points.append((clock_s, arrival_s))
            while self._points[0][0] < clock_s - WINDOW_S:
                self._points.popleft()
            self._fit()
        elif arrival_s - self.host_s(clock_s) < bucket[1] - self.host_s(bucket[0]):
            self._points[-1] = (clock_s, arrival_s)
            if early_s > 0:
                self._fit()

    def stamp_s(self, clock_s: float) -> float:
        """As `host_s`, for stamps in a row: when the estimate is corrected downwards, they slow down but go on."""
        stamp_s = self.host_s(clock_s)
        if self._last is not None:
            passed_s = self._slope * (clock_s - self._last[0])
            stamp_s = max(stamp_s, self._last[1] + max(_LEAST_PROGRESS * passed_s, _TICK_S))
        self._last = (clock_s, stamp_s)
        return stamp_s

    def restart(self) -> None:
        """Forget everything but the last stamp: the controller's clock began anew."""
        self._points.clear()
        self._slope, self._offset_s = 1.0, 0.0
        if self._last is not None:
            self._last = (float("inf"), self._last[1])

    def _fit(self) -> None:
        points = self._points
        if points[-1][0] - points[0][0] >= _SHORTEST_SPAN_S:
            slope = slope_beneath(list(points))
            self._slope = min(max(slope, 1 - self._largest_drift), 1 + self._largest_drift)
        self._offset_s = min(arrival_s - self._slope * clock_s for clock_s, arrival_s in points)


def slope_beneath(points: list[_Point]) -> float:
    """Slope of the lower convex hull's edge at the points' mean; `points` are sorted by their first coordinate."""
    hull: list[_Point] = []
    for point in points:
        while len(hull) >= 2 and _turn(hull[-2], hull[-1], point) <= 0:
            hull.pop()
        hull.append(point)
    mean = sum(x for x, _ in points) / len(points)
    left, right = next(edge for edge in pairwise(hull) if edge[1][0] >= mean)
    return (right[1] - left[1]) / (right[0] - left[0])


def _turn(a: _Point, b: _Point, c: _Point) -> float:
    """Positive where a, b, c turn to the left."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


# CameraClock: when frames were taken in host time, how surely, and whether the camera's clock has leapt.


@dataclass(frozen=True, slots=True)
class Stamp:
    """A time by the host's clock, and the standard deviation of the mapping it is from."""

    stamp_s: float
    sigma_s: float


class CameraClock:
    """Stamps in host time of frames whose device stamps grow; they grow strictly, whatever the device's clock does.

    A frame arrives after it was taken, so a mapped stamp that lies after its arrival tells that the device's clock
    leapt forward. Late arrivals are ordinary, but not all of them: where every one is late, the clock leapt back.
    """

    def __init__(self, settings: LiveCameraSettings) -> None:
        self.jumps = 0
        self._settings = settings
        self._map = ClockMap(settings.clock_drift)
        self._late: deque[tuple[float, float]] = deque()
        self._stamp_s = -float("inf")

    @property
    def drift_ppm(self) -> float:
        """How much faster than the host's the device's clock runs, in millionths."""
        return self._map.drift_ppm

    def stamp(self, device_s: float | None, arrival_s: float) -> Stamp:
        """The stamp of a frame that arrived at `arrival_s`; its arrival, where the device has no clock."""
        period_s = 1 / self._settings.rate_hz
        if device_s is None:
            return Stamp(self._growing(arrival_s), period_s)
        if self._has_leapt(device_s, arrival_s):
            self.jumps += 1
            self.restart()
        self._map.update(device_s, arrival_s)
        return Stamp(self._growing(min(self._map.host_s(device_s), arrival_s)), self._map.sigma_s(period_s))

    def host_s(self, device_s: float) -> float | None:
        """When the device's clock showed that, by the host's, for what is no frame; None before the first frame."""
        return self._map.host_s(device_s) if self._map.is_begun else None

    def restart(self) -> None:
        """The device's clock began anew: what was learned of it is forgotten."""
        self._map.restart()
        self._late.clear()

    def _has_leapt(self, device_s: float, arrival_s: float) -> bool:
        settings = self._settings
        if not self._map.is_begun:
            return False
        late_s = arrival_s - self._map.host_s(device_s)
        self._late.append((arrival_s, late_s))
        while arrival_s - self._late[0][0] > settings.clock_watch_s:
            self._late.popleft()
        # Three quarters of the time: frames that stop coming tell nothing of those that would have come.
        is_watched = arrival_s - self._late[0][0] > 0.75 * settings.clock_watch_s
        stays_late = is_watched and min(late for _, late in self._late) > settings.clock_late_s
        return late_s < -settings.clock_ahead_s or stays_late

    def _growing(self, stamp_s: float) -> float:
        self._stamp_s = max(stamp_s, self._stamp_s + _TICK_S)
        return self._stamp_s
