"""What a recording's stamps say of its clocks, before anything is decoded: their units, and whether they fit."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np

from wheelsight.errors import RecordingError
from wheelsight.events import RgbdFrame, SkippedFrame, WheelReading
from wheelsight.geometry import FloatArray
from wheelsight.recordings.protocol import ListedFrame, ListsFrames, Recording, TellsEnds
from wheelsight.stamps import NUMBERS, StampUnit, unit_of

FRAMES, WHEELS, TRUTH = "frames", "wheels", "ground truth"
# Streams of one drive overlap nearly wholly; one that is found in less of the other was cut, or its clock is another.
_LEAST_SHARE = 0.5
# A stream whose whole numbers span so much of what another's seconds do counts seconds too.
_SAME_SPAN = 0.8
_SHOWN = 3
# Longer than a stall of any sensor.
_LEAST_LEAP_S, _LEAP_PERIODS = 10.0, 50
_FASTEST_CAMERA_HZ = 500.0


def listed_stamps(recording: Recording) -> dict[str, FloatArray]:
    """Stamps (N,) of FRAMES, WHEELS and TRUTH, in the recording's own order; of those it tells without decoding.

    Of a recording that is too long to be listed, the first ones and the last.
    """
    if isinstance(recording, TellsEnds):
        return dict(recording.end_stamps())
    stamps: dict[str, list[float]] = {FRAMES: [], WHEELS: []}
    lists = recording.listed() if isinstance(recording, ListsFrames) else recording.events(images=False)
    for item in lists:
        if isinstance(item, ListedFrame | RgbdFrame | SkippedFrame):
            stamps[FRAMES].append(item.stamp_s)
        elif isinstance(item, WheelReading):
            stamps[WHEELS].append(item.stamp_s)
    if recording.ground_truth is not None:
        stamps[TRUTH] = recording.ground_truth.stamps_s.tolist()
    return {name: np.array(found, float) for name, found in stamps.items() if found}


def stamp_warnings(stamps: Mapping[str, FloatArray]) -> list[str]:
    """Sentences on FRAMES and WHEELS whose stamps are no seconds or leap, and one where they share little time."""
    units = _units(stamps)
    of_units = [_unit_sentence(name, units[name], stamps[name]) for name in units]
    leaps = [_leap_warning(name, stamps[name]) for name in _sensors(stamps) if name not in units]
    return [*of_units, *filter(None, leaps), *_overlap_warning(stamps)]


def refuse_if_apart(recording: Recording, least_s: float = 0.0) -> None:
    """Raise RecordingError where frames and wheel readings share no time, less than `least_s`, or not their unit."""
    stamps = listed_stamps(recording)
    if len(_sensors(stamps)) < 2:
        return
    units = _units(stamps)
    remedy = "; ".join(_remedy(name, unit) for name, unit in units.items())
    wheels_s, frames_s = ((float(stamps[name][0]), float(stamps[name][-1])) for name in (WHEELS, FRAMES))
    told = apart(wheels_s, frames_s, least_s)
    if told is not None:
        of_units = [_unit_sentence(name, unit, stamps[name]).rstrip(".") for name, unit in units.items()]
        fix = "; ".join(f"{text[0].lower()}{text[1:]}" for text in of_units)
        raise RecordingError(told[0], path=recording.path, fix=fix or told[1])
    if units.get(WHEELS) != units.get(FRAMES):
        looks = " and ".join(f"the {name}' stamps like {_kind(name, unit)}" for name, unit in units.items())
        raise RecordingError(f"wheels and camera do not count one unit: {looks}", path=recording.path, fix=remedy)


def refuse_other_units(recording: Recording, sensors: Collection[str]) -> None:
    """Raise RecordingError where stamps of FRAMES or WHEELS, of those that are followed, plainly are no seconds.

    Numbers of frames pass: a camera may give one a second. What lists no stamps is judged event by event, as it comes.
    """
    if not isinstance(recording, ListsFrames):
        return
    stamps = listed_stamps(recording)
    for name, unit in _units(stamps).items():
        if name in sensors and unit is not NUMBERS:
            shown = _unit_sentence(name, unit, stamps[name]).rpartition(":")[0]
            raise RecordingError(shown, path=recording.path, fix=_remedy(name, unit))


def _sensors(stamps: Mapping[str, FloatArray]) -> list[str]:
    return [name for name in (FRAMES, WHEELS) if name in stamps]


def _units(stamps: Mapping[str, FloatArray]) -> dict[str, StampUnit]:
    """What FRAMES and WHEELS count that do not count seconds; whole seconds are told by what else lasts as long."""
    units = {name: unit_of(found) for name, found in stamps.items()}
    in_seconds = [stamps[name] for name, unit in units.items() if unit is None]
    return {
        name: unit
        for name in _sensors(stamps)
        if (unit := units[name]) is not None
        and not (unit is NUMBERS and any(_last_alike(stamps[name], other) for other in in_seconds))
    }


def _last_alike(a_s: FloatArray, b_s: FloatArray) -> bool:
    spans = [(float(stamps_s[0]), float(stamps_s[-1])) for stamps_s in (a_s, b_s)]
    return _shared_s(*spans) >= _SAME_SPAN * max(end_s - begin_s for begin_s, end_s in spans)


def apart(wheels_s: tuple[float, float], frames_s: tuple[float, float], least_s: float = 0.0) -> tuple[str, str] | None:
    """Problem and fix where two spans, first and last stamp in seconds, share no time, or less than `least_s`."""
    shared_s = _shared_s(wheels_s, frames_s)
    if shared_s >= least_s:
        return None
    spans = f"wheels ({_span(wheels_s)}) and camera ({_span(frames_s)}) share {max(shared_s, 0.0):.1f} s"
    return f"{spans}: their clocks count from different moments", "stamp both by one clock, to within half a second"


def _shared_s(a_s: tuple[float, float], b_s: tuple[float, float]) -> float:
    return min(a_s[1], b_s[1]) - max(a_s[0], b_s[0])


def _span(span_s: tuple[float, float]) -> str:
    return f"{span_s[0]:.3f} to {span_s[1]:.3f} s"


def _overlap_warning(stamps: Mapping[str, FloatArray]) -> list[str]:
    if len(_sensors(stamps)) < 2 or any(len(stamps[name]) < 2 for name in (WHEELS, FRAMES)):
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


def _unit_sentence(name: str, unit: StampUnit, stamps: FloatArray) -> str:
    shown = f"({', '.join(f'{stamp:.6f}'.rstrip('0').rstrip('.') for stamp in stamps[:_SHOWN])}, …)"
    return f"The {name}' stamps {shown} look like {_kind(name, unit)}, not seconds: {_remedy(name, unit)}."


def _kind(name: str, unit: StampUnit) -> str:
    return unit.name if unit is not NUMBERS else f"numbers of {'frames' if name == FRAMES else 'readings'}"


def _leap_warning(name: str, stamps_s: FloatArray) -> str | None:
    """That stamps, seconds, go on much later all of a sudden; or that they are too near each other for seconds."""
    steps_s = np.diff(stamps_s)
    if len(steps_s) < 2:
        return None
    if name == FRAMES and steps_s.sum() < len(steps_s) / _FASTEST_CAMERA_HZ:
        return "The frames' stamps are too near each other for seconds: no camera gives so many frames a second."
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
