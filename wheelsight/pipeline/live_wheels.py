"""Wheel readings beside the recording that is played: from a serial port, the telemetry pipe, or a file."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import replace

from wheelsight.devices import BAUDRATE, ClockMap, LinkStatus, TicksFile, WheelSource, open_wheels
from wheelsight.errors import DeviceError
from wheelsight.events import WheelTicks
from wheelsight.pipeline.playing import Clock, MonotonicClock

THREAD = "wheelsight-wheels"
_SILENT = (LinkStatus.VANISHED, LinkStatus.NO_DATA, LinkStatus.NOISE, LinkStatus.TEXT)


class RecordedWheels:
    """The readings of a wheels.csv, or of a recording's folder that holds one.

    Attributes:
        where: the path.
        ticks: in order of time, by the clock of the recording beside which they are played.
        count: how many.
        warnings: about lines left out.

    Raises:
        RecordingError: it cannot be read.
    """

    def __init__(self, where: str) -> None:
        source = open_wheels(where)
        self.where, self.ticks = where, tuple(source.ticks())
        self.count = len(self.ticks)
        self.warnings = tuple(source.warnings) if isinstance(source, TicksFile) else ()


class LiveWheels:
    """A source of ticks, listened to by a thread; use it in a `with` block.

    The source stamps by a clock of its own: the link in host time as mapped from the controller's clock, the pipe as
    its writer did. `ClockMap` maps it to the time at which readings arrive here, later by the smallest delay of the
    way, so that stamps do not tremble with the transport. A source that falls silent ends nothing.

    Args:
        where: a serial port, or a named pipe.
        baudrate: of the port.
        clock: tells when readings arrive.
        source: in place of what would be opened at `where`.

    Attributes:
        where: as given.
        count: readings that were of use.
        is_silent: whether it has fallen silent.

    Raises:
        DeviceError: the port or pipe cannot be opened.
    """

    def __init__(
        self,
        where: str,
        baudrate: int = BAUDRATE,
        clock: Clock | None = None,
        source: WheelSource | None = None,
    ) -> None:
        self.where = where
        self.count = 0
        self.is_silent = False
        self._silences: list[str] = []
        self._clock = clock or MonotonicClock()
        self._listener: Callable[[WheelTicks], bool] | None = None
        self._map, self._last_s = ClockMap(), -math.inf
        self._is_over = False
        self._source = source or open_wheels(where, baudrate, self._told)
        self._thread = threading.Thread(target=self._listen, name=THREAD, daemon=True)
        self._thread.start()

    @property
    def warnings(self) -> tuple[str, ...]:
        """When it fell silent, and that it never spoke."""
        if not self.count and not self._silences:
            return (f"No wheel reading came from {self.where}.",)
        return tuple(f"The wheels ({self.where}) fell silent after {why}." for why in self._silences)

    def tell(self, listener: Callable[[WheelTicks], bool] | None) -> None:
        """Who hears each reading from now on, in the thread and stamped by `clock`, and says whether it is of use."""
        self._listener = listener

    def close(self) -> None:
        """Give port or pipe back; may be called twice."""
        self._is_over, self._listener = True, None
        self._source.close()
        self._thread.join()

    def __enter__(self) -> LiveWheels:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _listen(self) -> None:
        try:
            for ticks in self._source.ticks():
                stamped = replace(ticks, stamp_s=self._stamp_s(ticks.stamp_s))
                listener = self._listener
                self.count += listener is not None and listener(stamped)
            self._fall_silent("its other end was closed")
        except DeviceError as error:
            self._fall_silent(error.problem)
        except OSError as error:
            self._fall_silent(error.strerror or str(error))

    def _stamp_s(self, source_s: float) -> float:
        """By `clock`; what is no number stays so, for whoever answers it to refuse."""
        if not math.isfinite(source_s):
            return math.nan
        if source_s <= self._last_s:
            self._map = ClockMap()  # the source's clock began anew
        self._last_s = source_s
        self._map.update(source_s, self._clock.now_s())
        return self._map.stamp_s(source_s)

    def _told(self, status: LinkStatus) -> None:
        """The link has a new status."""
        if status in _SILENT:
            self._fall_silent(str(status).split(":")[0])
        elif status is LinkStatus.CONNECTED:
            self.is_silent = False

    def _fall_silent(self, why: str) -> None:
        """Note it, once until readings come again."""
        if not (self._is_over or self.is_silent):
            self.is_silent = True
            self._silences.append(f"{self.count} readings: {why}")
