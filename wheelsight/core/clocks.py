"""SessionClock: one time for the events of all sensors, whatever their clocks do.

A stamp is a sensor's word for when something was. Clocks are set while a robot drives (NTP, GPS), hosts sleep, drivers
begin to count anew. Session time goes on through all that. It is a sensor's stamp less an offset, which changes only
where that sensor's clock leaps:

- leap all sensors together, or all have paused, then session time goes on `pause_s` later for all of them, or at once
  where clocks were set back, and what lay between their stamps stays;
- leaps one alone while others go on, then its events go on as they came before: one period after its last, or as long
  after those of the others as usual. Of a leap by less than a stall may last, that one is only known once the others
  come later than usual by just as much; then it is they that are mapped.

One stamp far away is no leap: it is refused, and a leap is believed when others follow. A sensor whose first stamp is
far from all others counts from another moment; it is refused by name until it comes near.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from statistics import median

from wheelsight.core.estimates import Reason
from wheelsight.core.messages import Event, RgbdFrame, SkippedFrame, WheelReading
from wheelsight.core.settings import CHOSEN, Settings, setting

# It only helps, so none of the others is left out for its sake.
_GYROSCOPE = "gyroscope"
_STALLS = "reckoned from rates and stalls of sensors, not tuned"


class ClockSettings(Settings):
    """What is a leap of a clock, and when it is believed."""

    leap_s: float = setting(
        1.0,
        "a stamp that is so far ahead of all sensors is of a clock that leapt, or all have paused, seconds; longer "
        "than a busy host or a hanging USB stalls (half a second)",
        _STALLS,
        gt=0,
        le=3600,
    )
    back_s: float = setting(
        0.1,
        "one that is so far behind the sensor's own last is of a clock that was set back, seconds; less is jitter",
        _STALLS,
        ge=0,
        le=3600,
    )
    pause_s: float = setting(
        0.4,
        "how much session time passes where all leap, seconds; longer than it takes to call a pose that no camera "
        "confirms coasting (0.3 s), for the robot may have moved; shorter than the gaps that wheels bridge (0.5 s)",
        _STALLS,
        gt=0,
        le=3600,
    )
    followers: int = setting(3, "so many stamps in a row are a leap; fewer are noise on a line", _STALLS, ge=1, le=1000)
    active_s: float = setting(
        1.1,
        "a sensor heard within so long before a leap is waited for, as long: it may leap as well, seconds; a camera at "
        "1 Hz is",
        _STALLS,
        ge=0,
        le=3600,
    )
    alike_s: float = setting(1.0, "leaps of two sensors that differ by less are one, seconds", _STALLS, ge=0, le=3600)
    stall_s: float = setting(
        0.25,
        "readings that go on one period after the last have lost none, if others' stamps say so to within this, "
        "seconds; smaller leaps of one clock are not noticed",
        _STALLS,
        gt=0,
        le=3600,
    )
    apart_s: float = setting(
        2.0,
        "clocks whose first stamps are farther apart, seconds, count from different moments",
        _STALLS,
        gt=0,
        le=3600,
    )
    remembered: int = setting(
        15,
        "of so many events the usual time between them, and behind the others, is the median",
        CHOSEN,
        ge=1,
        le=100_000,
    )
    most_warnings: int = setting(
        10, "sentences on leaps that a run tells at most; nobody reads more", CHOSEN, ge=0, le=100_000
    )


@dataclass(frozen=True, slots=True)
class Untimed:
    """Why a stamp has no session time.

    Attributes:
        reason: of the answer.
        note: for a user.
    """

    reason: Reason
    note: str


@dataclass
class _Sensor:
    """What is known of a sensor's clock.

    `offset_s` is what to take from its stamps; `last_s` its newest session time; `steps_s` and `behind_s` how long
    after its last, and behind the newest of all sensors, its events come; `held_s` stamps, less the offset, that are
    far away and wait for others; `goes_on` whether it has told of a time since another's were held, as expected.
    """

    offset_s: float
    last_s: float
    steps_s: deque[float]
    behind_s: deque[float]
    held_s: list[float] = field(default_factory=list)
    goes_on: bool = False

    @property
    def period_s(self) -> float:
        """The usual time between its events; 0 where that is not known."""
        return median(self.steps_s) if self.steps_s else 0.0


class SessionClock:
    """See the module.

    Attributes:
        shift_s: what to add to a session time for the stamp that the sensors would give it.
    """

    def __init__(self, settings: ClockSettings | None = None) -> None:
        self.settings = settings or ClockSettings()
        self.shift_s = 0.0
        self._leaps: list[str] = []
        self._apart: dict[str, str] = {}
        self._sensors: dict[str, _Sensor] = {}
        self._newest_s = self._held_from_s = -math.inf
        self._jump: tuple[str, float] | None = None  # who was last ahead of all by more than usual, and how far

    @property
    def warnings(self) -> tuple[str, ...]:
        """A sentence for each of the first leaps that were believed, and for each sensor whose clock is another."""
        left_out = (
            f"The {name} {'are' if name == 'wheels' else 'is'} left out: {note}; stamp all sensors by one clock."
            for name, note in self._apart.items()
        )
        return (*left_out, *self._leaps)

    def time_of(self, event: Event) -> float | Untimed:
        """The session time of an event, in seconds, or why it has none. Events are given in the order they come."""
        name = _name_of(event)
        if not math.isfinite(event.stamp_s):
            return Untimed(Reason.INVALID, f"its stamp is {event.stamp_s}")
        sensor = self._sensors.get(name)
        if sensor is None:
            return self._begin(name, event.stamp_s)
        time_s = event.stamp_s - sensor.offset_s
        if self._is_far(sensor, time_s):
            if not self._has_leapt(sensor, time_s):
                by = _seconds(time_s - sensor.last_s)
                return Untimed(Reason.CLOCKS_APART, f"the clock of the {name} leaps by {by}")
            self._follow(name, sensor)
            time_s = event.stamp_s - sensor.offset_s
        elif self._lags(name, sensor, time_s):
            sensor.held_s.append(time_s)
            if len(sensor.held_s) < self.settings.followers:
                return Untimed(Reason.CLOCKS_APART, "the clock of another sensor leaps")
            time_s = self._catch_up(sensor, event.stamp_s)
        sensor.held_s.clear()
        if time_s <= sensor.last_s:
            last = f"{sensor.last_s + self.shift_s:.6f} s"
            return Untimed(Reason.CLOCK_BACKWARDS, f"its stamp does not come after {last}")
        self._hear(name, sensor, time_s)
        return time_s

    def _begin(self, name: str, stamp_s: float) -> float | Untimed:
        time_s = stamp_s - self.shift_s
        apart_s = time_s - self._newest_s
        if self._sensors and abs(apart_s) > self.settings.apart_s:
            if [*self._sensors] != [_GYROSCOPE]:
                return self._left_out(name, apart_s, " and the ".join(self._sensors))
            self._left_out(_GYROSCOPE, -apart_s, name)
            self._sensors.clear()
            self._newest_s = time_s
        steps_s, behind_s = (deque[float](maxlen=self.settings.remembered) for _ in range(2))
        self._sensors[name] = _Sensor(self.shift_s, time_s, steps_s, behind_s)
        self._newest_s = max(self._newest_s, time_s)
        return time_s

    def _left_out(self, name: str, apart_s: float, others: str) -> Untimed:
        where = "ahead of" if apart_s > 0 else "behind"
        note = f"the clock of the {name} is {_seconds(abs(apart_s))} {where} that of the {others}"
        self._apart.setdefault(name, note)
        return Untimed(Reason.CLOCKS_APART, note)

    def _hear(self, name: str, sensor: _Sensor, time_s: float) -> None:
        ahead_s = time_s - max(self._newest_s, sensor.last_s + sensor.period_s)
        if ahead_s > self.settings.stall_s and len(self._sensors) > 1:
            self._jump = name, ahead_s
        elif self._jump is not None and name != self._jump[0]:
            self._jump = None  # it paused, as the others did
        sensor.steps_s.append(time_s - sensor.last_s)
        sensor.behind_s.append(self._newest_s - time_s)
        sensor.last_s, sensor.goes_on = time_s, sensor.goes_on or time_s > self._held_from_s
        self._newest_s = max(self._newest_s, time_s)

    def _is_far(self, sensor: _Sensor, time_s: float) -> bool:
        """Whether a time is not one to be expected. A sensor alone may be slow, or pause, as long as it likes."""
        ahead = len(self._sensors) > 1 and time_s > self._newest_s + self.settings.leap_s
        return ahead or time_s < sensor.last_s - self.settings.back_s

    def _lags(self, name: str, sensor: _Sensor, time_s: float) -> bool:
        """Whether an event comes later than usual by as much as another sensor's clock seems to have leapt."""
        if self._jump is None or self._jump[0] == name or not sensor.behind_s:
            return False
        later_s, stall_s = self._newest_s - time_s - median(sensor.behind_s), self.settings.stall_s
        # What is newest is older the slower the one is that leapt.
        within_s = max(stall_s / 2, min(1.5 * self._sensors[self._jump[0]].period_s, stall_s))
        return later_s > 0 and abs(later_s - self._jump[1]) < within_s

    def _catch_up(self, sensor: _Sensor, stamp_s: float) -> float:
        """Map a sensor, and all others that have not leapt, to where the one is that has."""
        assert self._jump is not None
        leapt, by_s = self._jump
        self._tell_leap([leapt], by_s)
        for name, other in self._sensors.items():
            if name != leapt:
                other.offset_s -= by_s
                other.last_s += by_s
        self._jump = None
        return stamp_s - sensor.offset_s

    def _has_leapt(self, sensor: _Sensor, time_s: float) -> bool:
        """Whether a stamp that is far away, and those before it, are of a clock that leapt, and others' are known."""
        longest_s = max(self.settings.leap_s, 2 * sensor.period_s)
        if sensor.held_s and not 0 < time_s - sensor.held_s[-1] < longest_s:
            sensor.held_s.clear()  # noise, not one clock
        if not sensor.held_s:
            for other in self._sensors.values():
                other.goes_on = False
            self._held_from_s = self._newest_s  # what was on its way then tells nothing of its clock since
        sensor.held_s.append(time_s)
        if len(sensor.held_s) < self.settings.followers:
            return False
        waited = time_s - sensor.held_s[0] > self.settings.active_s
        others = self._others(sensor)
        return waited or all(other.goes_on or _leap_alike(sensor, other, self.settings.alike_s) for other in others)

    def _others(self, sensor: _Sensor) -> list[_Sensor]:
        """Those that were heard just before it leapt, or since."""
        since_s = sensor.last_s - self.settings.active_s
        return [other for other in self._sensors.values() if other is not sensor and other.last_s >= since_s]

    def _follow(self, name: str, sensor: _Sensor) -> None:
        """Go on: this sensor alone, where others went on meanwhile, or all of them."""
        if any(other.goes_on for other in self._others(sensor)):
            by_s, leapt = sensor.held_s[-1] - self._going_on_s(sensor), {name: sensor}
        else:
            # A clock that is set back tells of no pause: what is held was one period after another.
            without_s = sensor.period_s + sensor.held_s[-1] - sensor.held_s[0]
            pause_s = self.settings.pause_s if sensor.held_s[-1] > self._newest_s else without_s
            by_s = sensor.held_s[-1] - self._newest_s - pause_s
            leapt = dict(self._sensors)
            self.shift_s += by_s
            self._newest_s += pause_s
        for each in leapt.values():
            each.offset_s += by_s
            each.held_s.clear()
        self._tell_leap(list(leapt), by_s)

    def _tell_leap(self, names: list[str], by_s: float) -> None:
        if len(self._leaps) < self.settings.most_warnings:
            clocks = f"clock{'s' if len(names) > 1 else ''} of the {' and the '.join(names)}"
            going_on = "what came after is taken to go on without a break"
            silent = ", or nothing was heard for so long" if by_s > 0 and len(names) == len(self._sensors) else ""
            self._leaps.append(f"The {clocks} leapt by {_seconds(by_s)}{silent}: {going_on}.")

    def _going_on_s(self, sensor: _Sensor) -> float:
        """The session time of the stamp that is held last, as the others tell when it came."""
        among_others_s = self._newest_s - (median(sensor.behind_s) if sensor.behind_s else 0.0)
        next_s = sensor.last_s + sensor.period_s
        without_loss_s = next_s + sensor.held_s[-1] - sensor.held_s[0]
        is_whole = abs(without_loss_s - among_others_s) <= self.settings.stall_s
        return without_loss_s if is_whole else max(among_others_s, next_s)


def _leap_alike(one: _Sensor, other: _Sensor, within_s: float) -> bool:
    if not (one.held_s and other.held_s):
        return False
    first, second = (sensor.held_s[0] - sensor.last_s - sensor.period_s for sensor in (one, other))
    return abs(first - second) < within_s


def _name_of(event: Event) -> str:
    if isinstance(event, RgbdFrame | SkippedFrame):
        return "camera"
    return "wheels" if isinstance(event, WheelReading) else _GYROSCOPE


def _seconds(seconds: float) -> str:
    return f"{seconds:.3g} s" if abs(seconds) < 1e4 else f"{seconds:.3e} s"
