"""What a recording's stamps say of its clocks, before anything is decoded: their units, and whether they fit."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from wheelsight.errors import RecordingError
from wheelsight.events import RgbdFrame, SkippedFrame, WheelSpeeds, WheelTicks
from wheelsight.geometry import FloatArray
from wheelsight.recordings.protocol import ListedFrame, ListsFrames, Recording
from wheelsight.stamps import NUMBERS, StampUnit, unit_of

FRAMES, WHEELS = "frames", "wheels"
# Streams of one drive overlap nearly wholly; one that is found in less of the other was cut, or its clock is another.
_LEAST_SHARE = 0.5
_SHOWN = 3
# Longer than a stall of any sensor.
_LEAST_LEAP_S, _LEAP_PERIODS = 10.0, 50
_FASTEST_CAMERA_HZ = 2000.0


def listed_stamps(recording: Recording) -> dict[str, FloatArray]:
    """Stamps (N,) of FRAMES and of WHEELS, in the recording's own order; of those that it tells without decoding."""
    stamps: dict[str, list[float]] = {FRAMES: [], WHEELS: []}
    lists = recording.listed() if isinstance(recording, ListsFrames) else recording.events(images=False)
    for item in lists:
        if isinstance(item, ListedFrame | RgbdFrame | SkippedFrame):
            stamps[FRAMES].append(item.stamp_s)
        elif isinstance(item, WheelTicks | WheelSpeeds):
            stamps[WHEELS].append(item.stamp_s)
    return {name: np.array(found, float) for name, found in stamps.items() if found}


def stamp_warnings(stamps: Mapping[str, FloatArray]) -> list[str]:
    """Sentences on FRAMES and WHEELS whose stamps are no seconds or leap, and one where they share little time."""
    found = [tell(name, stamps_s) for tell in (_unit_warning, _leap_warning) for name, stamps_s in stamps.items()]
    return [*filter(None, found), *_overlap_warning(stamps)]


def refuse_if_apart(recording: Recording, least_s: float = 0.0) -> None:
    """Raise RecordingError where frames and wheel readings share no time, or less than `least_s` seconds."""
    stamps = listed_stamps(recording)
    if len(stamps) < 2:
        return
    spans = [(stamps[name][0], stamps[name][-1]) for name in (WHEELS, FRAMES)]
    told = apart(spans[0], spans[1], least_s)
    if told is not None:
        problem, fix = told
        raise RecordingError(problem, path=recording.path, fix=_fix_of(stamps) or fix)


def apart(wheels_s: tuple[float, float], frames_s: tuple[float, float], least_s: float = 0.0) -> tuple[str, str] | None:
    """Problem and fix where two spans, first and last stamp in seconds, share no time, or less than `least_s`."""
    shared_s = _shared_s(wheels_s, frames_s)
    if shared_s > 0 and shared_s >= least_s:
        return None
    spans = f"wheels ({_span(wheels_s)}) and camera ({_span(frames_s)}) share {max(shared_s, 0.0):.1f} s"
    return f"{spans}: their clocks count from different moments", "stamp both by one clock, to within half a second"


def _shared_s(a_s: tuple[float, float], b_s: tuple[float, float]) -> float:
    return min(a_s[1], b_s[1]) - max(a_s[0], b_s[0])


def _span(span_s: tuple[float, float]) -> str:
    return f"{span_s[0]:.3f} to {span_s[1]:.3f} s"


def _overlap_warning(stamps: Mapping[str, FloatArray]) -> list[str]:
    if len(stamps) < 2 or any(len(stamps_s) < 2 for stamps_s in stamps.values()):
        return []
    wheels_s, frames_s = ((float(stamps[name][0]), float(stamps[name][-1])) for name in (WHEELS, FRAMES))
    told = apart(wheels_s, frames_s)
    if told is not None:
        return [f"{told[0][0].upper()}{told[0][1:]}; {told[1]}."]
    shared_s, shorter_s = _shared_s(wheels_s, frames_s), min(wheels_s[1] - wheels_s[0], frames_s[1] - frames_s[0])
    if shared_s >= _LEAST_SHARE * shorter_s:
        return []
    return [
        f"Wheels ({_span(wheels_s)}) and camera ({_span(frames_s)}) share only {shared_s:.1f} s: one of them was "
        "cut, or their clocks count from different moments."
    ]


def _unit_warning(name: str, stamps_s: FloatArray) -> str | None:
    unit = unit_of(stamps_s)
    whose = "The frames' stamps" if name == FRAMES else "The wheels' stamps"
    shown = f"({', '.join(f'{stamp_s:.6f}'.rstrip('0').rstrip('.') for stamp_s in stamps_s[:_SHOWN])}, …)"
    if unit is not None:
        kind = f"numbers of {'frames' if name == FRAMES else 'readings'}" if unit is NUMBERS else unit.name
        return f"{whose} {shown} look like {kind}, not seconds: {_remedy(name, unit)}."
    if name == FRAMES and len(stamps_s) > 2 and stamps_s[-1] - stamps_s[0] < (len(stamps_s) - 1) / _FASTEST_CAMERA_HZ:
        return f"{whose} {shown} are too near each other for seconds: no camera gives so many frames a second."
    return None


def _leap_warning(name: str, stamps_s: FloatArray) -> str | None:
    """That stamps go on much later all of a sudden, in seconds."""
    steps_s = np.diff(stamps_s)
    if not len(steps_s) or unit_of(stamps_s) is not None:
        return None
    usual_s, at = float(np.median(steps_s)), int(steps_s.argmax())
    if steps_s[at] < max(_LEAST_LEAP_S, _LEAP_PERIODS * usual_s):
        return None
    return (
        f"The {name}' stamps leap by {steps_s[at]:.1f} s after {stamps_s[at]:.3f} s: the clock was set, or the "
        "recording paused; where the robot went meanwhile is not known."
    )


def _remedy(name: str, unit: StampUnit) -> str:
    if name == WHEELS:
        by = "the readings a second" if unit.per_second is None else f"{unit.per_second:.0f}"
        return f"divide them by {by}"
    return "give the camera's rate, such as --rate-hz 30" if unit is NUMBERS else f"--rate-hz {unit.per_second:.0f}"


def _fix_of(stamps: Mapping[str, FloatArray]) -> str | None:
    """What to do about streams that do not overlap because one does not count seconds."""
    told = [_unit_warning(name, stamps_s) for name, stamps_s in stamps.items() if unit_of(stamps_s) is not None]
    return "; ".join(f"{text[0].lower()}{text[1:].rstrip('.')}" for text in told if text) or None
