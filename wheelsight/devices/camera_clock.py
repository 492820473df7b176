"""CameraClock: when frames were taken in host time, how surely, and whether the camera's clock has leapt."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from wheelsight.devices.clock import ClockMap
from wheelsight.settings import LiveCameraSettings

_TICK_S = 1e-6


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
