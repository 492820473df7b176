"""AnswerTimes: how late the answers of a run in real time are."""

from __future__ import annotations

from array import array
from collections import deque

import numpy as np

from wheelsight.events import Event, RgbdFrame, SkippedFrame


class AnswerTimes:
    """Latencies, from an event's stamp until the next event is asked for.

    Args:
        recent: frames over which `lately` tells.
    """

    def __init__(self, recent: int) -> None:
        self._frames_s, self._readings_s = array("d"), array("d")
        self._lately: deque[tuple[float, float]] = deque(maxlen=recent)

    def add(self, event: Event, now_s: float) -> None:
        """One more event was answered."""
        if not isinstance(event, RgbdFrame | SkippedFrame):
            self._readings_s.append(now_s - event.stamp_s)
            return
        self._frames_s.append(now_s - event.stamp_s)
        self._lately.append((now_s, now_s - event.stamp_s))

    def lately(self) -> tuple[float, float] | None:
        """Frames a second and their median latency over the last of them; None before two."""
        if len(self._lately) < 2 or self._lately[-1][0] <= self._lately[0][0]:
            return None
        rate = (len(self._lately) - 1) / (self._lately[-1][0] - self._lately[0][0])
        return rate, float(np.median([latency_s for _, latency_s in self._lately]))

    def median_and_p95_s(self) -> tuple[float | None, float | None]:
        """Of frames, else of readings; None of none."""
        latencies_s = self._frames_s or self._readings_s
        if not latencies_s:
            return None, None
        median_s, p95_s = np.percentile(latencies_s, [50, 95])
        return float(median_s), float(p95_s)
