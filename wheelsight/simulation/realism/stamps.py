"""When frames and readings are taken, and when the host says that they were."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from wheelsight.events import WheelReading, YawRate
from wheelsight.geometry import FloatArray, IntArray

SHORTEST_S = 1e-4
STAMP_DECIMALS = 6

Reading = TypeVar("Reading", bound=WheelReading | YawRate)


@dataclass(frozen=True, slots=True)
class StampSettings:
    """How stamps differ from true times.

    Attributes:
        camera_late_s: (least, most) mean delay of the camera's stamps, one a drive. Chosen: a frame of 30 Hz at most.
        camera_jitter_s: deviation of a stamp; steps between colour images of freiburg1_desk deviate by 1.9 ms, those
            of freiburg1_rpy by 2.9 ms, each of two stamps.
        dropped: share of frames that are lost. 18 of 613 have no partner in freiburg1_desk.
        dropped_together: mean number of frames lost at a time. Chosen.
        wheel_jitter_s: deviation of a wheel reading's stamp: steps between readings of `skid_steer_run20` (40 Hz)
            deviate by 3.7 ms in all; half of them by no more than 1.5 ms.
        burst_share, burst_s: share of the readings that a busy bus holds back, and for how long at most; the readings
            behind arrive together with them. The same steps go down to 3 and up to 51 ms.
    """

    camera_late_s: tuple[float, float] = (0.0, 0.02)
    camera_jitter_s: float = 0.0017
    dropped: float = 0.02
    dropped_together: float = 1.5
    wheel_jitter_s: float = 0.001
    burst_share: float = 0.01
    burst_s: float = 0.025


@dataclass(frozen=True, slots=True, eq=False)
class FrameTimes:
    """Of the frames that arrive.

    Attributes:
        taken_s: (N,) when the middle row is exposed, by the true clock.
        told_s: (N,) the stamps, growing strictly.
    """

    taken_s: FloatArray
    told_s: FloatArray

    def __len__(self) -> int:
        return len(self.taken_s)


def exact_times(count: int, rate_hz: float) -> FrameTimes:
    """Frames at their rate from 0 s on, stamped when they are taken."""
    stamps_s = np.round(np.arange(count) / rate_hz, STAMP_DECIMALS)
    return FrameTimes(stamps_s, stamps_s)


def frame_times(count: int, rate_hz: float, settings: StampSettings, rng: np.random.Generator) -> FrameTimes:
    """Frames at their rate, of which some are lost, stamped late and not evenly. The first always arrives."""
    taken_s = exact_times(count, rate_hz).taken_s
    late_s = rng.uniform(*settings.camera_late_s) + settings.camera_jitter_s * rng.standard_normal(count)
    told_s = _growing(taken_s + late_s)
    kept = _kept(count, settings, rng)
    return FrameTimes(taken_s[kept], told_s[kept])


def as_stamped(readings: Sequence[Reading], settings: StampSettings, rng: np.random.Generator) -> tuple[Reading, ...]:
    """Readings with the stamps of the host, in their order."""
    if not readings:
        return ()
    taken_s = np.array([reading.stamp_s for reading in readings])
    late_s = np.abs(settings.wheel_jitter_s * rng.standard_normal(len(taken_s)))
    is_held = rng.random(len(taken_s)) < settings.burst_share
    late_s += is_held * rng.uniform(0, settings.burst_s, len(taken_s))
    told_s = _growing(taken_s + late_s)
    return tuple(replace(reading, stamp_s=stamp_s) for reading, stamp_s in zip(readings, told_s.tolist(), strict=True))


def _growing(stamps_s: FloatArray) -> FloatArray:
    """What is held back holds back what is behind it: each is at least `SHORTEST_S` after the one before."""
    steps_s = SHORTEST_S * np.arange(len(stamps_s))
    return np.asarray(np.round(np.maximum.accumulate(stamps_s - steps_s) + steps_s, STAMP_DECIMALS), float)


def _kept(count: int, settings: StampSettings, rng: np.random.Generator) -> IntArray:
    begins = rng.random(count) < settings.dropped / settings.dropped_together
    lengths = rng.geometric(1 / settings.dropped_together, count)
    is_lost = np.zeros(count, bool)
    for begin in np.flatnonzero(begins):
        is_lost[begin : begin + lengths[begin]] = True
    is_lost[0] = False
    return np.flatnonzero(~is_lost)
