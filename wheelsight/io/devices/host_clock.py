"""The host clock of all stamps: seconds since 1970 that never run backwards. `ClockMap` maps a controller's clock
onto it, and `CameraClock` that of a camera.
"""

from __future__ import annotations

import math
import time
from collections import deque
from functools import cache
from itertools import pairwise

from wheelsight.core.settings import LiveCameraSettings


@cache
def unix_offset_s() -> float:
    """Seconds from 1970 to zero of the monotonic clock, by the system clock at the first call.

    It is constant for the life of the program. Otherwise a step of the system clock would appear as an offset between
    the stamps of two devices.
    """
    return time.time() - time.monotonic()


def now_s() -> float:
    """The current time of the host clock."""
    return unix_offset_s() + time.monotonic()


WINDOW_S = 60.0
_BUCKET_S = 0.5
_SHORTEST_SPAN_S = 4.0
_LARGEST_DRIFT = 0.01
_LEAST_PROGRESS = 0.5
_TICK_S = 1e-6

_Point = tuple[float, float]


class ClockMap:
    """Maps seconds of a device's clock to the host's: estimates offset and drift from the arrivals of its messages.

    A message arrives after a delay that is never negative, often small, and sometimes large. Over the device's clock,
    arrivals lie on or above a line with the drift as slope and the offset as height. The estimate is the line below all
    points with the least sum of distances to them: the edge of their lower convex hull below their mean (Moon, Skelly &
    Towsley, *Estimation and removal of clock skew from network delay measurements*, INFOCOM 1999). The offset includes
    the smallest delay, which arrivals in one direction cannot show.

    Only the earliest arrival of each half second of the last minute is kept, so an update takes constant time. In the
    first four seconds the drift is zero; later it is limited to ±`largest_drift`.
    """

    def __init__(self, largest_drift: float = _LARGEST_DRIFT) -> None:
        self._largest_drift = largest_drift
        self._points: deque[_Point] = deque()
        self._slope, self._offset_s = 1.0, 0.0
        self._last: _Point | None = None

    @property
    def drift_ppm(self) -> float:
        """The drift of the device's clock in millionths; positive where it runs faster than the host's."""
        return (1 / self._slope - 1) * 1e6

    @property
    def is_begun(self) -> bool:
        """Whether there was an arrival since the start, or the last restart."""
        return bool(self._points)

    def sigma_s(self, first_s: float) -> float:
        """The standard deviation of `host_s`, without the unknown smallest delay.

        The mean distance of the kept arrivals above the line estimates the standard deviation σ of delays. A line
        through n such points has the standard deviation 2σ/√n at its end.

        Args:
            first_s: the standard deviation after one arrival.
        """
        if not self._points:
            return first_s
        late_s = sum(arrival_s - self.host_s(clock_s) for clock_s, arrival_s in self._points) / len(self._points)
        count = float(len(self._points))
        return max(2 * late_s / math.sqrt(count), first_s / (count * math.sqrt(count)))

    def host_s(self, clock_s: float) -> float:
        """The host time at which the device's clock showed `clock_s`, plus the smallest delay of the transport."""
        return self._offset_s + self._slope * clock_s

    def update(self, clock_s: float, arrival_s: float) -> None:
        """Add a message that was sent at `clock_s` and arrived at `arrival_s`. `clock_s` must not decrease."""
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
        """Like `host_s`, but strictly increasing from call to call, also when the estimate decreases."""
        stamp_s = self.host_s(clock_s)
        if self._last is not None:
            passed_s = self._slope * (clock_s - self._last[0])
            stamp_s = max(stamp_s, self._last[1] + max(_LEAST_PROGRESS * passed_s, _TICK_S))
        self._last = (clock_s, stamp_s)
        return stamp_s

    def restart(self) -> None:
        """Reset all but the last stamp, after the device's clock was reset."""
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
    """The slope of the lower convex hull's edge at the points' mean. `points` are sorted by their first coordinate."""
    hull: list[_Point] = []
    for point in points:
        while len(hull) >= 2:
            a, b = hull[-2:]
            if (b[0] - a[0]) * (point[1] - a[1]) - (b[1] - a[1]) * (point[0] - a[0]) > 0:
                break  # a, b and the point turn to the left
            hull.pop()
        hull.append(point)
    mean = sum(x for x, _ in points) / len(points)
    left, right = next(edge for edge in pairwise(hull) if edge[1][0] >= mean)
    return (right[1] - left[1]) / (right[0] - left[0])


_CLOCK_AHEAD_S = 0.1  # a stamp this long after its frame's arrival: the camera's clock jumped forward
CLOCK_LATE_S = 0.3  # all frames of `_CLOCK_WATCH_S` this long after their stamps: it jumped back
_CLOCK_WATCH_S = 2.0  # a busy host has caught up by then
_CLOCK_DRIFT = 5e-4  # five times what crystals of cameras differ by: a busy host's delays are no drift


class CameraClock:
    """Maps a camera's increasing stamps to strictly increasing stamps of the host's clock, over jumps of its clock.

    A frame arrives after it was taken. A mapped stamp later than its arrival therefore shows that the device's clock
    jumped forward. Late arrivals are normal, but where all are late the clock jumped back.
    """

    def __init__(self, settings: LiveCameraSettings) -> None:
        self.jumps = 0
        self._settings = settings
        self._map = ClockMap(_CLOCK_DRIFT)
        self._late: deque[tuple[float, float]] = deque()
        self._stamp_s = -float("inf")

    @property
    def drift_ppm(self) -> float:
        """See `ClockMap`."""
        return self._map.drift_ppm

    def stamp(self, device_s: float | None, arrival_s: float) -> tuple[float, float]:
        """The stamp of a frame by the host's clock, and its standard deviation; the arrival without a device clock."""
        period_s = 1 / self._settings.rate_hz
        if device_s is None:
            return self._growing(arrival_s), period_s
        if self._map.is_begun:
            late_s = arrival_s - self._map.host_s(device_s)
            self._late.append((arrival_s, late_s))
            while arrival_s - self._late[0][0] > _CLOCK_WATCH_S:
                self._late.popleft()
            # Arrivals must cover three quarters of the time: a pause of the frames does not count as late.
            is_watched = arrival_s - self._late[0][0] > 0.75 * _CLOCK_WATCH_S
            stays_late = is_watched and min(late for _, late in self._late) > CLOCK_LATE_S
            if late_s < -_CLOCK_AHEAD_S or stays_late:
                self.jumps += 1
                self.restart()
        self._map.update(device_s, arrival_s)
        return self._growing(min(self._map.host_s(device_s), arrival_s)), self._map.sigma_s(period_s)

    def host_s(self, device_s: float) -> float | None:
        """The host time of a time of the device's clock, for other readings than frames; None before a frame."""
        return self._map.host_s(device_s) if self._map.is_begun else None

    def restart(self) -> None:
        """Reset the mapping, after the device's clock was reset."""
        self._map.restart()
        self._late.clear()

    def _growing(self, stamp_s: float) -> float:
        """The stamp, or the smallest one after the last."""
        self._stamp_s = max(stamp_s, self._stamp_s + _TICK_S)
        return self._stamp_s
