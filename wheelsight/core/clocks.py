"""`SessionClock` maps the stamps of all sensors to one continuous session time, even if their clocks leap.

Clocks are set during a drive (NTP, GPS), hosts sleep, and drivers restart their counters. Session time is the stamp of
a sensor minus an offset, which changes only when the clock of that sensor leaps:

- If all sensors leap together, or all have paused, session time continues `pause_s` later. If clocks were set back it
  continues at once. Differences between stamps of the sensors stay.
- If one sensor leaps alone, its events continue one period after its last one, or with the usual delay behind the
  others. A leap shorter than a stall is only visible once the others lag by the same time; then these are mapped.

A single outlier is no leap: the clock rejects it, and accepts a leap once further stamps follow. A sensor whose first
stamp is far from all others has another epoch; the clock rejects it by name until it comes near.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from statistics import median

from wheelsight.core.estimates import Reason
from wheelsight.core.messages import Event, RgbdFrame, SkippedFrame, WheelReading
from wheelsight.core.settings import Settings, setting

# A gyroscope is optional, so no other sensor is left out because of it.
_GYROSCOPE = "gyroscope"

# Derived from rates and stalls of sensors, not tuned.
_BACK_S = 0.1  # a stamp this far behind the sensor's last one is of a clock that was set back; less is jitter
_PAUSE_S = 0.4  # session time of a leap of all: over the delay of coasting (0.3 s), below bridged gaps (0.5 s)
_ALIKE_S = 1.0  # leaps of two sensors that differ by less are one
_STALL_S = 0.25  # by stamps of others, no reading is lost within this; smaller leaps of one clock are not noticed
_APART_S = 2.0  # clocks whose first stamps are farther apart have different epochs
_REMEMBERED = 15  # events for the median period, and the median delay behind the others (chosen)
_MOST_WARNINGS = 10  # of leaps, in a run (chosen)
_DERIVED = "derived from rates and stalls of sensors, not tuned"


class ClockSettings(Settings):
    """Thresholds of leaps of clocks."""

    leap_s: float = setting(
        1.0,
        "a stamp this far ahead of all sensors is a leap, or all have paused, seconds; longer than stalls of a busy "
        "host or of USB (half a second)",
        _DERIVED,
        gt=0,
        le=3600,
    )
    followers: int = setting(
        3, "number of consecutive stamps that make a leap; fewer are noise on a line", _DERIVED, ge=1, le=1000
    )
    active_s: float = setting(
        1.1,
        "a sensor with an event within this time before a leap may leap too, and is waited for as long, seconds; "
        "covers a camera at 1 Hz",
        _DERIVED,
        ge=0,
        le=3600,
    )


@dataclass(frozen=True, slots=True)
class Untimed:
    """The reason why a stamp has no session time.

    Attributes:
        reason: of the estimate.
        note: for the user.
    """

    reason: Reason
    note: str


@dataclass
class _Sensor:
    """The state of a sensor's clock.

    Attributes:
        offset_s: stamp minus session time.
        last_s: its newest session time.
        steps_s, behind_s: times of its events since its previous one, and behind the newest of all sensors.
        held_s: stamps minus the offset that may be a leap.
        has_continued: whether it had an event, at the expected time, since stamps of another sensor were held.
    """

    offset_s: float
    last_s: float
    steps_s: deque[float]
    behind_s: deque[float]
    held_s: list[float] = field(default_factory=list)
    has_continued: bool = False

    @property
    def period_s(self) -> float:
        """The median time between its events; 0 if unknown."""
        return median(self.steps_s) if self.steps_s else 0.0

    @property
    def leap_s(self) -> float:
        """The difference of the first held stamp from the expected one."""
        return self.held_s[0] - self.last_s - self.period_s


class SessionClock:
    """Maps stamps of all sensors to session time; see the module.

    Attributes:
        shift_s: stamp of the sensors minus session time.
    """

    def __init__(self, settings: ClockSettings | None = None) -> None:
        self.settings = settings or ClockSettings()
        self.shift_s = 0.0
        self._leaps: list[str] = []
        self._apart: dict[str, str] = {}
        self._sensors: dict[str, _Sensor] = {}
        self._newest_s = self._held_from_s = -math.inf
        # The sensor that was last ahead of all by more than usual, and by how many seconds.
        self._jump: tuple[str, float] | None = None

    @property
    def warnings(self) -> tuple[str, ...]:
        """A sentence for each of the first accepted leaps, and for each sensor with another epoch."""
        if not self._apart:
            return tuple(self._leaps)
        left_out = (
            f"The {name} {'are' if name == 'wheels' else 'is'} left out: {note}; stamp all sensors by one clock."
            for name, note in self._apart.items()
        )
        return (*left_out, *self._leaps)

    def time_of(self, event: Event) -> float | Untimed:
        """The session time of an event in seconds, or the reason why it has none. Events come in order of arrival."""
        is_camera = isinstance(event, RgbdFrame | SkippedFrame)
        name = "camera" if is_camera else "wheels" if isinstance(event, WheelReading) else _GYROSCOPE
        if not math.isfinite(event.stamp_s):
            return Untimed(Reason.INVALID, f"its stamp is {event.stamp_s}")
        sensor = self._sensors.get(name)
        if sensor is None:
            return self._first(name, event.stamp_s)
        time_s = event.stamp_s - sensor.offset_s
        # A single sensor may pause for any time.
        ahead = len(self._sensors) > 1 and time_s > self._newest_s + self.settings.leap_s
        if ahead or time_s < sensor.last_s - _BACK_S:
            if not self._has_leapt(sensor, time_s):
                by = _seconds(time_s - sensor.last_s)
                return Untimed(Reason.CLOCKS_APART, f"the clock of the {name} leaps by {by}")
            self._accept_leap(name, sensor)
            time_s = event.stamp_s - sensor.offset_s
        elif self._jump is not None and self._lags(name, sensor, time_s):
            sensor.held_s.append(time_s)
            if len(sensor.held_s) < self.settings.followers:
                return Untimed(Reason.CLOCKS_APART, "the clock of another sensor leaps")
            # Map this sensor, and all others that have not leapt, to the time of the one that has.
            assert self._jump is not None
            (leapt, by_s), self._jump = self._jump, None
            self._warn_of_leap([leapt], by_s)
            for other in (one for other, one in self._sensors.items() if other != leapt):
                other.offset_s -= by_s
                other.last_s += by_s
            time_s = event.stamp_s - sensor.offset_s
        sensor.held_s.clear()
        if time_s <= sensor.last_s:
            last = f"{sensor.last_s + self.shift_s:.6f} s"
            return Untimed(Reason.CLOCK_BACKWARDS, f"its stamp does not come after {last}")
        self._accept(name, sensor, time_s)
        return time_s

    def _first(self, name: str, stamp_s: float) -> float | Untimed:
        time_s = stamp_s - self.shift_s
        apart_s = time_s - self._newest_s
        if self._sensors and abs(apart_s) > _APART_S:
            if [*self._sensors] != [_GYROSCOPE]:
                return self._left_out(name, apart_s, " and the ".join(self._sensors))
            self._left_out(_GYROSCOPE, -apart_s, name)
            self._sensors.clear()
            self._newest_s = time_s
        steps_s, behind_s = (deque[float](maxlen=_REMEMBERED) for _ in range(2))
        self._sensors[name] = _Sensor(self.shift_s, time_s, steps_s, behind_s)
        self._newest_s = max(self._newest_s, time_s)
        return time_s

    def _left_out(self, name: str, apart_s: float, others: str) -> Untimed:
        where = "ahead of" if apart_s > 0 else "behind"
        note = f"the clock of the {name} is {_seconds(abs(apart_s))} {where} that of the {others}"
        self._apart.setdefault(name, note)
        return Untimed(Reason.CLOCKS_APART, note)

    def _accept(self, name: str, sensor: _Sensor, time_s: float) -> None:
        ahead_s = time_s - max(self._newest_s, sensor.last_s + sensor.period_s)
        if ahead_s > _STALL_S and len(self._sensors) > 1:
            self._jump = name, ahead_s
        elif self._jump is not None and name != self._jump[0]:
            self._jump = None  # it paused, as the others did
        sensor.steps_s.append(time_s - sensor.last_s)
        sensor.behind_s.append(self._newest_s - time_s)
        sensor.last_s, sensor.has_continued = time_s, sensor.has_continued or time_s > self._held_from_s
        self._newest_s = max(self._newest_s, time_s)

    def _lags(self, name: str, sensor: _Sensor, time_s: float) -> bool:
        """Whether an event lags by the same time as another sensor's clock seems to have leapt."""
        if self._jump is None or self._jump[0] == name or not sensor.behind_s:
            return False
        later_s = self._newest_s - time_s - median(sensor.behind_s)
        # The newest event is older the longer the period of the sensor that leapt.
        within_s = max(_STALL_S / 2, min(1.5 * self._sensors[self._jump[0]].period_s, _STALL_S))
        return later_s > 0 and abs(later_s - self._jump[1]) < within_s

    def _has_leapt(self, sensor: _Sensor, time_s: float) -> bool:
        """Whether the held stamps are a leap, and the behaviour of the other sensors is known."""
        longest_s = max(self.settings.leap_s, 2 * sensor.period_s)
        if sensor.held_s and not 0 < time_s - sensor.held_s[-1] < longest_s:
            sensor.held_s.clear()  # noise, not one clock
        if not sensor.held_s:
            for other in self._sensors.values():
                other.has_continued = False
            self._held_from_s = self._newest_s  # events that were on their way then do not show a leap
        sensor.held_s.append(time_s)
        if len(sensor.held_s) < self.settings.followers:
            return False
        waited = time_s - sensor.held_s[0] > self.settings.active_s
        return waited or all(
            other.has_continued or (other.held_s and abs(sensor.leap_s - other.leap_s) < _ALIKE_S)
            for other in self._others(sensor)
        )

    def _others(self, sensor: _Sensor) -> list[_Sensor]:
        """The other sensors with an event just before the leap, or since."""
        since_s = sensor.last_s - self.settings.active_s
        return [other for other in self._sensors.values() if other is not sensor and other.last_s >= since_s]

    def _accept_leap(self, name: str, sensor: _Sensor) -> None:
        """Shift the offset of this sensor if others continued meanwhile, else those of all sensors."""
        if any(other.has_continued for other in self._others(sensor)):
            among_others_s = self._newest_s - (median(sensor.behind_s) if sensor.behind_s else 0.0)
            next_s = sensor.last_s + sensor.period_s
            without_loss_s = next_s + sensor.held_s[-1] - sensor.held_s[0]
            is_whole = abs(without_loss_s - among_others_s) <= _STALL_S
            # Session time of the last held stamp, by the events of the other sensors.
            continued_s = without_loss_s if is_whole else max(among_others_s, next_s)
            by_s, leapt = sensor.held_s[-1] - continued_s, {name: sensor}
        else:
            # A clock that is set back shows no pause: the held stamps are one period apart.
            without_s = sensor.period_s + sensor.held_s[-1] - sensor.held_s[0]
            pause_s = _PAUSE_S if sensor.held_s[-1] > self._newest_s else without_s
            by_s = sensor.held_s[-1] - self._newest_s - pause_s
            leapt = dict(self._sensors)
            self.shift_s += by_s
            self._newest_s += pause_s
        for each in leapt.values():
            each.offset_s += by_s
            each.held_s.clear()
        self._warn_of_leap(list(leapt), by_s)

    def _warn_of_leap(self, names: list[str], by_s: float) -> None:
        if len(self._leaps) < _MOST_WARNINGS:
            clocks = f"clock{'s' if len(names) > 1 else ''} of the {' and the '.join(names)}"
            continuation = "events after it continue without a break"
            silent = ", or all sensors paused that long" if by_s > 0 and len(names) == len(self._sensors) else ""
            self._leaps.append(f"The {clocks} leapt by {_seconds(by_s)}{silent}: {continuation}.")


def _seconds(seconds: float) -> str:
    return f"{seconds:.3g} s" if abs(seconds) < 1e4 else f"{seconds:.3e} s"
