"""Events handed out when their time comes: readings all, frames only the newest."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Generator, Iterator
from typing import Protocol

from wheelsight.events import Event, RgbdFrame, SkippedFrame
from wheelsight.recordings import ListedFrame
from wheelsight.settings import RealTimeSettings

_LONGEST_WAIT_S = 60.0  # of one wait, after which it goes on: no thread sleeps for ever
THREAD = "wheelsight-player"


class Clock(Protocol):
    """The time that a recording is played by, and waiting for it."""

    def now_s(self) -> float:
        """Seconds since some moment; never backwards."""

    def wait(self, condition: threading.Condition, until_s: float) -> None:
        """Wait until woken, or until that time, which may be infinite; sometimes for less. `condition` is held."""

    def wake(self, condition: threading.Condition) -> None:
        """Wake all who wait; `condition` is held."""


class MonotonicClock:
    """The host's time, as it passes."""

    def now_s(self) -> float:
        """As `time.monotonic`."""
        return time.monotonic()

    def wait(self, condition: threading.Condition, until_s: float) -> None:
        """Up to a minute."""
        condition.wait(min(max(until_s - self.now_s(), 0.0), _LONGEST_WAIT_S))

    def wake(self, condition: threading.Condition) -> None:
        """All of them."""
        condition.notify_all()


class Playing:
    """One passage through a recording in real time; a thread reads ahead some frames and readings.

    Its clock, the playing clock, shows the recording's time: the first event's stamp when what is read ahead is ready,
    and then seconds as they pass. An event is due when the clock shows its stamp. Due events are taken in the order of
    their stamps; a frame is dropped as soon as the one after it is due too. Where the recording lists its frames, one
    that is overtaken before it was decoded never is.

    Attributes:
        frames, dropped, unread: frames taken or dropped so far; dropped; and of these never decoded.
        readings: taken so far, of all sensors but the camera.
    """

    def __init__(
        self, items: Iterator[Event | ListedFrame], clock: Clock, settings: RealTimeSettings | None = None
    ) -> None:
        self.settings = settings or RealTimeSettings()
        self.frames = self.dropped = self.unread = self.readings = 0
        self._items, self._clock = items, clock
        self._frames: deque[RgbdFrame | SkippedFrame] = deque()
        self._readings: deque[Event] = deque()
        self._heard: deque[Event] = deque()
        self._behind_s: float | None = None  # from the recording's time to the clock's
        self._began_s = self._ended_s = math.nan
        self._is_ready = self._is_read = self._is_over = False
        self._error: BaseException | None = None
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._read, name=THREAD, daemon=True)
        self._thread.start()

    @property
    def now_s(self) -> float:
        """What the playing clock shows; -∞ before it began."""
        return -math.inf if self._behind_s is None else self._clock.now_s() - self._behind_s

    @property
    def played_s(self) -> float:
        """How long it has run, or ran."""
        end_s = self._ended_s if self._is_over else self._clock.now_s()
        return 0.0 if self._behind_s is None else end_s - self._began_s

    def take(self) -> Event | None:
        """The next event, once it is due; None at the end. Raises what stopped the recording, at its place."""
        with self._changed:
            while True:
                self._begin()
                self._drop_overtaken()
                event = self._next()
                if event is not None and self._is_due(event.stamp_s):
                    return self._taken(event)
                if event is None and self._is_read:
                    if self._error is not None:
                        raise self._error
                    return None
                self._clock.wait(self._changed, self._due_s(math.inf if event is None else event.stamp_s))

    def hear(self, event: Event) -> None:
        """An event from elsewhere, stamped by the recording's clock; it is due by now."""
        with self._changed:
            self._heard.append(event)
            self._clock.wake(self._changed)

    def shown_s(self, clock_s: float) -> float | None:
        """What the playing clock shows when `clock` shows `clock_s`; None if it had not begun by now."""
        return None if self._behind_s is None else clock_s - self._behind_s

    def close(self) -> None:
        """End it; the thread ends after the frame that it decodes."""
        with self._changed:
            self._is_over = True
            self._ended_s = self._clock.now_s()
            self._clock.wake(self._changed)
        self._thread.join()

    def _begin(self) -> None:
        """Let the playing clock run, as soon as what is read ahead is ready."""
        first = self._next()
        if self._behind_s is None and self._is_ready and first is not None:
            self._began_s = self._clock.now_s()
            self._behind_s = self._began_s - first.stamp_s
            self._clock.wake(self._changed)

    def _next(self) -> Event | None:
        """The oldest that is at hand; of several at one stamp, readings before the frame."""
        at_hand = [queue[0] for queue in (self._heard, self._readings, self._frames) if queue]
        return min(at_hand, key=_stamp_s, default=None)

    def _taken(self, event: Event) -> Event:
        queues = (self._heard, self._readings, self._frames)
        next(queue for queue in queues if queue and queue[0] is event).popleft()
        if isinstance(event, RgbdFrame | SkippedFrame):
            self.frames += 1
            self._clock.wake(self._changed)  # there is room for another
        else:
            self.readings += 1
        return event

    def _drop_overtaken(self) -> None:
        while len(self._frames) > 1 and self._is_due(self._frames[1].stamp_s):
            self._frames.popleft()
            self.frames += 1
            self.dropped += 1

    def _due_s(self, stamp_s: float) -> float:
        """The clock's time at which the playing clock shows a stamp; infinite before it began."""
        return math.inf if self._behind_s is None else stamp_s + self._behind_s

    def _is_due(self, stamp_s: float) -> bool:
        """Whether it shows it by now; it always does one that is no number."""
        return not self._due_s(stamp_s) > self._clock.now_s()

    def _read(self) -> None:
        """The thread: decode ahead, as far as there is room, until the recording ends or nobody plays it any more."""
        try:
            for item in self._items:
                if not self._is_wanted(item):
                    if self._is_over:
                        break
                    continue
                event = item.read() if isinstance(item, ListedFrame) else item
                with self._changed:
                    is_frame = isinstance(event, RgbdFrame | SkippedFrame)
                    (self._frames if is_frame else self._readings).append(event)  # type: ignore[arg-type]
                    if self._next() is event:  # else it is something before it that is waited for
                        self._clock.wake(self._changed)
        except BaseException as error:
            self._error = error
        finally:
            if isinstance(self._items, Generator):
                self._items.close()
            with self._changed:
                self._is_read = self._is_ready = True
                self._clock.wake(self._changed)

    def _is_wanted(self, item: Event | ListedFrame) -> bool:
        """Wait for room; False for a frame that was overtaken meanwhile, and for all once it is over."""
        with self._changed:
            while not self._is_over and (look_again_s := self._has_room_at(item)) is not None:
                if not self._is_ready:
                    self._is_ready = True
                    self._clock.wake(self._changed)
                self._clock.wait(self._changed, self._due_s(look_again_s))
            is_overtaken = isinstance(item, ListedFrame) and self._is_due(item.next_stamp_s)
            if is_overtaken and not self._is_over:
                self.frames += 1
                self.dropped += 1
                self.unread += 1
            return not (self._is_over or is_overtaken)

    def _has_room_at(self, item: Event | ListedFrame) -> float | None:
        """None where there is room, else the stamp at which to look again."""
        self._drop_overtaken()
        if isinstance(item, ListedFrame | RgbdFrame | SkippedFrame):
            return self._frames[1].stamp_s if len(self._frames) >= self.settings.frames_ahead else None
        ahead_s = self.settings.readings_ahead_s
        there_s = item.stamp_s - ahead_s
        first = self._next()
        has_room = first is None or self._is_due(there_s) or (self._behind_s is None and there_s <= first.stamp_s)
        return None if has_room else there_s + ahead_s / 2  # rather many at once than each by itself


def _stamp_s(event: Event) -> float:
    """A stamp that is no number comes first: whoever takes it refuses it."""
    return -math.inf if math.isnan(event.stamp_s) else event.stamp_s
