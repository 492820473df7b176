"""A robot that is carried elsewhere in its building, in the dark: does it notice, and does it find itself again?

The second day's drive is cut: it stands for some seconds in the dark, and goes on at another moment of the same drive.
Counts of the wheels go on as they were: anyone who is carried turns no wheel.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.session_starts import MODES, WRONG_DEG, WRONG_M, FirstDay, SecondDay, localizer_in, off_by
from wheelsight.core.calibration import Calibration
from wheelsight.core.estimates import Estimate, Status
from wheelsight.core.messages import Event, RgbdFrame, WheelTicks, YawRate

FIND_S, DARK_S, NOTICE_S, WATCHED_S = 8.0, 4.0, 3.0, 10.0


@dataclass(frozen=True)
class Kidnapping:
    """What became of one.

    Attributes:
        building, mode: where, and by what it is localized.
        moment_s, moment_to_s: of the drive: where it was taken from, and to.
        was_found: whether it had found itself in the map before; without that it cannot be contradicted.
        is_unnoticed: whether, three seconds after the light came back or later, a frame was answered `tracking` at a
            wrong place, while it had not been found again.
        is_astray: whether a frame was answered so after it had been found again, rightly.
        again_s: when it was found again, rightly, after the light came back; None where it was not.
    """

    building: str
    mode: str
    moment_s: float
    moment_to_s: float
    was_found: bool
    is_unnoticed: bool
    is_astray: bool
    again_s: float | None

    @property
    def sentence(self) -> str:
        """For the terminal."""
        where = f"{self.building} from {self.moment_s:.1f} to {self.moment_to_s:.1f} s, {self.mode}"
        if not self.was_found:
            return f"{where}: not found before"
        reported = "UNNOTICED, " if self.is_unnoticed else ""
        again = "not found again" if self.again_s is None else f"found again after {self.again_s:.1f} s"
        return f"{where}: {reported}{again}{', then LED ASTRAY' if self.is_astray else ''}"


def carried_off(events: Sequence[Event], from_s: float, to_s: float, dark_s: float = DARK_S) -> Iterator[Event]:
    """The events before a moment, a dark in which wheels stand, and those from another moment on, later by as much."""
    before = [event for event in events if from_s - FIND_S <= event.stamp_s < from_s]
    after = [event for event in events if event.stamp_s >= to_s]
    yield from before
    stood = next((event for event in reversed(before) if isinstance(event, WheelTicks)), None)
    yield from _dark([event for event in before if event.stamp_s >= from_s - 1.0], stood, dark_s)
    shift_s = from_s + dark_s - to_s
    first = next((event for event in after if isinstance(event, WheelTicks)), None)
    for event in after:
        if isinstance(event, WheelTicks) and stood is not None and first is not None:
            left, right = event.left - first.left + stood.left, event.right - first.right + stood.right
            yield WheelTicks(event.stamp_s + shift_s, left, right)
        else:
            yield replace(event, stamp_s=event.stamp_s + shift_s)


def _dark(last: Sequence[Event], stood: WheelTicks | None, dark_s: float) -> Iterator[Event]:
    """What came in the last second, again and again, with black images and wheels that stand."""
    for second in range(int(dark_s)):
        for event in last:
            stamp_s = event.stamp_s + 1.0 + second
            if isinstance(event, RgbdFrame):
                yield RgbdFrame(stamp_s, np.zeros_like(event.color), np.zeros_like(event.depth_m), event.index)
            elif isinstance(event, WheelTicks) and stood is not None:
                yield replace(event, stamp_s=stamp_s, left=stood.left, right=stood.right)
            elif isinstance(event, YawRate):
                yield YawRate(stamp_s, 0.0)


def kidnapped_at(
    moments_s: tuple[float, float], mode: str, calibration: Calibration, day: SecondDay, known: FirstDay
) -> Kidnapping:
    """Begin some seconds before a moment, be carried off at it to another one, and go on there."""
    from_s, to_s = moments_s
    subject, close = localizer_in(known, mode, calibration, day)
    light_s = from_s + DARK_S
    was_found = is_unnoticed = is_astray = False
    again_s = None
    for event in carried_off(day.events, from_s, to_s):
        if event.stamp_s > light_s + WATCHED_S:
            break
        answer = subject.process(event)
        if not isinstance(event, RgbdFrame) or answer is None:
            continue
        if event.stamp_s < from_s:
            was_found |= _is_there(answer)
        elif event.stamp_s >= light_s and _is_there(answer):
            is_right = _is_right(answer, day, known, to_s - light_s)
            is_unnoticed |= not is_right and again_s is None and event.stamp_s >= light_s + NOTICE_S
            is_astray |= not is_right and again_s is not None
            again_s = event.stamp_s - light_s if is_right and again_s is None else again_s
    subject.close()
    close()
    return Kidnapping(known.name, mode, *moments_s, was_found, was_found and is_unnoticed, is_astray, again_s)


def _is_there(answer: Estimate) -> bool:
    return answer.status is Status.TRACKING and answer.T_map_body is not None


def _is_right(answer: Estimate, day: SecondDay, known: FirstDay, shift_s: float) -> bool:
    here = replace(answer, stamp_s=answer.stamp_s + shift_s)
    error_m, error_deg, _, _ = off_by(here, day.truth, known)
    return error_m <= WRONG_M and error_deg <= WRONG_DEG


def kidnap_moments(count: int, day: SecondDay) -> Iterator[tuple[tuple[float, float], str]]:
    """So many moments evenly over the drive, each with one half a drive on, by camera alone and joined in turn."""
    begin_s, end_s = day.events[0].stamp_s + FIND_S, day.events[-1].stamp_s - WATCHED_S
    moments_s = np.linspace(begin_s, end_s, count)
    for number, from_s in enumerate(moments_s.tolist()):
        to_s = begin_s + (from_s - begin_s + (end_s - begin_s) / 2) % (end_s - begin_s)
        yield (from_s, to_s), MODES[number % len(MODES)]
