"""Clocks of a recording: units of stamps, sensors that do not overlap, counters that roll over, and offsets between
sensors by their turns.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.errors import RecordingError
from wheelsight.core.geometry import ByteArray, Float32Array, FloatArray
from wheelsight.core.messages import Event, RgbdFrame, SkippedFrame, WheelReading, WheelSpeeds, WheelTicks, YawRate
from wheelsight.core.stamps import NUMBERS, StampUnit, unit_of
from wheelsight.io.recordings.recording import HasEndStamps, ListedFrame, ListsFrames, Recording

FRAMES, WHEELS, TRUTH = "frames", "wheels", "ground truth"
# Streams of one drive overlap nearly completely. A smaller share means that one was cut, or that clocks differ.
_LEAST_SHARE = 0.5
# Integer stamps that span at least this share of another stream's seconds are seconds too.
_SAME_SPAN = 0.8
_SHOWN = 3
# Longer than a stall of any sensor.
_LEAST_LEAP_S, _LEAP_PERIODS = 10.0, 50
_FASTEST_CAMERA_HZ = 500.0


def listed_stamps(recording: Recording) -> dict[str, FloatArray]:
    """Stamps (N,) of FRAMES, WHEELS and TRUTH in the recording's order, read without decoding images.

    For a recording that is too long to list, only the first few and the last.
    """
    if isinstance(recording, HasEndStamps):
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
    """Warnings about stamps of FRAMES and WHEELS that are not seconds, or jump, or hardly overlap."""
    units = _units(stamps)
    of_units = [_unit_sentence(name, units[name], stamps[name]) for name in units]
    leaps = [_leap_warning(name, stamps[name]) for name in _sensors(stamps) if name not in units]
    warnings = [*of_units, *filter(None, leaps)]
    if any(len(stamps.get(name, ())) < 2 for name in (WHEELS, FRAMES)):
        return warnings
    wheels_s, frames_s = ((float(stamps[name][0]), float(stamps[name][-1])) for name in (WHEELS, FRAMES))
    gap, shared_s = apart(wheels_s, frames_s), _shared_s(wheels_s, frames_s)
    if gap is not None:
        warnings.append(f"{gap[0][0].upper()}{gap[0][1:]}; {gap[1]}.")
    elif shared_s < _LEAST_SHARE * min(wheels_s[1] - wheels_s[0], frames_s[1] - frames_s[0]):
        warnings.append(
            f"Wheels ({_span(wheels_s)}) and camera ({_span(frames_s)}) share only {shared_s:.1f} s: one of them was "
            "cut, or their clocks count from different moments."
        )
    return warnings


def refuse_if_apart(recording: Recording, least_s: float = 0.0) -> None:
    """Raise RecordingError where frames and wheel readings share less than `least_s`, or have different units."""
    stamps = listed_stamps(recording)
    if len(_sensors(stamps)) < 2:
        return
    units = _units(stamps)
    remedy = "; ".join(_remedy(name, unit) for name, unit in units.items())
    wheels_s, frames_s = ((float(stamps[name][0]), float(stamps[name][-1])) for name in (WHEELS, FRAMES))
    gap = apart(wheels_s, frames_s, least_s)
    if gap is not None:
        of_units = [_unit_sentence(name, unit, stamps[name]).rstrip(".") for name, unit in units.items()]
        fix = "; ".join(f"{text[0].lower()}{text[1:]}" for text in of_units)
        raise RecordingError(gap[0], path=recording.path, fix=fix or gap[1])
    if units.get(WHEELS) != units.get(FRAMES):
        looks = " and ".join(f"the {name}' stamps like {_kind(name, unit)}" for name, unit in units.items())
        raise RecordingError(f"wheels and camera do not count one unit: {looks}", path=recording.path, fix=remedy)


def refuse_other_units(recording: Recording, sensors: Collection[str]) -> None:
    """Raise RecordingError where stamps of FRAMES or WHEELS are not seconds.

    Frame numbers pass, since a camera may give one frame per second. Recordings that do not list stamps pass too; their
    stamps are checked event by event.

    Args:
        sensors: those of FRAMES and WHEELS that are used.
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
    """The units of FRAMES and WHEELS other than seconds. Integers that last as long as other stamps are seconds."""
    units = {name: unit_of(found) for name, found in stamps.items()}
    in_seconds = [stamps[name] for name, unit in units.items() if unit is None]

    def last_alike(*both_s: FloatArray) -> bool:
        spans = [(float(stamps_s[0]), float(stamps_s[-1])) for stamps_s in both_s]
        return _shared_s(spans[0], spans[1]) >= _SAME_SPAN * max(end_s - begin_s for begin_s, end_s in spans)

    return {
        name: unit
        for name in _sensors(stamps)
        if (unit := units[name]) is not None
        and not (unit is NUMBERS and any(last_alike(stamps[name], other) for other in in_seconds))
    }


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


def _unit_sentence(name: str, unit: StampUnit, stamps: FloatArray) -> str:
    shown = f"({', '.join(f'{stamp:.6f}'.rstrip('0').rstrip('.') for stamp in stamps[:_SHOWN])}, …)"
    return f"The {name}' stamps {shown} look like {_kind(name, unit)}, not seconds: {_remedy(name, unit)}."


def _kind(name: str, unit: StampUnit) -> str:
    return unit.name if unit is not NUMBERS else f"numbers of {'frames' if name == FRAMES else 'readings'}"


def _leap_warning(name: str, stamps_s: FloatArray) -> str | None:
    """A warning about stamps, seconds, that jump forward, or are too dense for seconds; else None."""
    steps_s = np.diff(stamps_s)
    if len(steps_s) < 2:
        return None
    if name == FRAMES and steps_s.sum() < len(steps_s) / _FASTEST_CAMERA_HZ:
        return "The frames' stamps are too close for seconds: no camera is that fast."
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


# Counters that roll over

_FEWEST_READINGS = 10
# A jump covers at least the first share of a counter's range, all other steps at most the second one.
_LEAST_REACH = 32
_LEAP_SHARE, _STEP_SHARE = 0.5, 0.1
# Relative accuracy of the modulus from a jump: the motion during it is interpolated from the steps beside it.
_SAME = 0.03


def counter_warnings(wheels: Wheels | None, readings: Sequence[WheelReading]) -> list[str]:
    """Warnings about counters that roll over without a stated modulus, and those that may roll over undetected."""
    ticks = [reading for reading in readings if isinstance(reading, WheelTicks)]
    if wheels is None or len(ticks) < _FEWEST_READINGS:
        return []
    warnings, first = list[str](), ticks[0]
    sides = {
        "left": np.array([reading.left - first.left for reading in ticks], float),
        "right": np.array([reading.right - first.right for reading in ticks], float),
    }
    leaps = {side: leap for side, counts in sides.items() if (leap := _leap(counts, wheels.counter_span)) is not None}
    if leaps:
        index, side = min((index, side) for side, (index, _) in leaps.items())
        before, after = (getattr(ticks[i], side) for i in (index, index + 1))
        modulus = float(np.median([modulus for _, modulus in leaps.values()]))
        bits = _bits(modulus)
        remedy = f"about {modulus:.0f}: set wheels.counter_modulus in the calibration"
        if bits is not None:
            remedy = f"{2**bits}: set wheels.counter_bits to {bits} in the calibration"
        at_s = ticks[index + 1].stamp_s
        warnings.append(
            f"The {side} counter leaps from {before} to {after} at {at_s:.3f} s: it seems to wrap at {remedy}."
        )
    # A wheel at top speed may turn by half the counter's range or more in the usual period.
    period_s = float(np.median(np.diff([reading.stamp_s for reading in ticks])))
    half_m = 0.5 * wheels.counter_span * min(wheels.left_m_per_tick, wheels.right_m_per_tick)
    if wheels.counter_span and period_s > 0 and wheels.max_speed_m_s * period_s >= half_m:
        warnings.append(
            f"Counters of {wheels.counter_span} values, read each {1e3 * period_s:.3g} ms, may roll over unseen at "
            f"{wheels.max_speed_m_s:g} m/s, so readings are refused: where wheels never roll so fast, set "
            f"wheels.max_speed_m_s to what they do, below {half_m / period_s:.2g}."
        )
    return warnings


def _leap(counts: FloatArray, span: int) -> tuple[int, float] | None:
    """The index before the first jump of counts (N,), and the modulus that explains it; None without any."""
    reach = float(np.ptp(counts))
    steps = np.diff(counts)
    if span:
        steps = steps - span * np.floor(steps / span + 0.5)
    is_leap = np.abs(steps) > _LEAP_SHARE * reach
    others = np.abs(steps[~is_leap])
    if (
        not is_leap.any()
        or reach < _LEAST_REACH
        or len(others) < _FEWEST_READINGS // 2
        or others.max() > _STEP_SHARE * reach
    ):
        return None
    usual = np.interp(np.flatnonzero(is_leap), np.flatnonzero(~is_leap), steps[~is_leap])
    moduli = np.abs(steps[is_leap] - usual)
    is_one = np.ptp(moduli) <= _SAME * moduli.max()
    if not is_one or (len(moduli) < 2 and _bits(float(moduli[0])) is None):
        return None  # a reset counter jumps too, once and from any value
    return int(np.flatnonzero(is_leap)[0]), float(np.median(moduli))


def _bits(modulus: float) -> int | None:
    """The number of bits of a modulus that is a power of two, or None."""
    bits = round(np.log2(modulus))
    return bits if abs(modulus / 2.0**bits - 1) < _SAME else None


# Clock offsets from turns

# The largest offset of clocks that is searched, and the steps, seconds. Receipt times show larger ones.
_MOST_S, _STEP_S, _FINE_S = 3.5, 0.02, 0.002
# Width of the compared images, and the least time between them: less shows no turn.
_WIDTH_PX, _APART_S = 160, 0.06
# Peaks of phase correlation below this are of views that have little in common.
_LEAST_RESPONSE = 0.1
# Least correlation at the best offset, and least ratio of unexplained variance at offsets this far from it, seconds. A
# robot that turns at a constant rate shows no offset.
_LEAST_AGREEMENT, _LEAST_RATIO, _OTHER_S = 0.8, 1.5, 0.3
# Least turn in radians, and least number of compared pairs of frames.
_LEAST_TURN_RAD, _FEWEST = 0.6, 20
# A camera whose optical axis is within 30° of the vertical sees turns about it, not to the side.
_LEAST_SIDEWAYS = 0.5
# Largest turn of one reading; a larger step is a counter that rolled over.
_LARGEST_STEP_RAD = 1.0
# Longest gap over which a rate is integrated, seconds.
_LONGEST_STEP_S = 1.0
# Smallest offset of different clocks: drivers delay messages by less.
LEAST_OFFSET_S = 0.05
# How long the turns at a beginning are compared, or less once the robot has turned enough: a second of work.
MOST_COMPARED_S, _COMPARED_S, _ENOUGH_TURNED_RAD = 60.0, 20.0, 4.0


@dataclass(frozen=True, slots=True)
class MotionOffset:
    """The offset between the clocks of the camera and another sensor, from the turns that both measure.

    Attributes:
        offset_s: by how much the camera's stamps are ahead; None where the turns do not determine it.
        sigma_s: its standard deviation.
        agreement: correlation of the turns at this offset, 0 to 1.
        turned_rad: the sum of the absolute turns that were compared.
        why_not: why it is unknown; empty where it is known.
        as_stamped: correlation of the turns at no offset.
    """

    offset_s: float | None
    sigma_s: float = 0.0
    agreement: float = 0.0
    turned_rad: float = 0.0
    why_not: str = ""
    as_stamped: float = 0.0

    @property
    def is_apart(self) -> bool:
        """Whether the offset is significant, and larger than the delays of drivers."""
        return self.offset_s is not None and abs(self.offset_s) > max(LEAST_OFFSET_S, 3 * self.sigma_s)

    def __str__(self) -> str:
        if self.offset_s is None:
            return f"the turns of both do not show it: {self.why_not}"
        side = "ahead" if self.offset_s > 0 else "behind"
        found = f"{abs(self.offset_s):.3f} s {side} (σ {self.sigma_s:.3f} s, correlation {self.agreement:.2f}"
        return f"{found} over {self.turned_rad:.1f} rad of turns)"


class MotionClock:
    """Estimates clock offsets between camera, wheels and gyroscope from the robot's turns.

    A turn moves the image sideways. With one clock, the image moves while the wheels turn the robot; otherwise it moves
    earlier or later, by the offset. Events may come in any order of sensors.

    Args:
        calibration: of the cameras, and of two wheels. A holonomic base shows no offset: its way to the side moves the
            image as a turn does.
    """

    def __init__(self, calibration: Calibration) -> None:
        self._wheels, self._is_holonomic = calibration.wheels, calibration.holonomic is not None
        color, T_base_camera = calibration.color, calibration.T_base_camera
        self._focal_px = None if color is None else (color.fx / color.width, color.fy / color.width)
        up = np.array([0.0, -1.0, 0.0])  # the camera looks ahead
        if T_base_camera is not None and color is not None:
            up = calibration.T_color_camera[:3, :3] @ T_base_camera[:3, :3].T[:, 2]
        # Motion of the image centre to the right and down per radian of turn, in tangents.
        self._moves = np.array([-up[1], up[0]])
        self._last: tuple[float, Float32Array] | None = None
        self._shifts: list[tuple[float, float, float]] = []
        self._headings: dict[str, list[tuple[float, float]]] = {"wheels": [], "gyroscope": []}
        self._reading: WheelTicks | WheelSpeeds | None = None
        self._rate: YawRate | None = None
        self._hanning: Float32Array | None = None

    @property
    def turned_rad(self) -> float:
        """The sum of absolute turns by the wheels so far."""
        turned = np.array([rad for _, rad in self._headings["wheels"]])
        return float(np.abs(np.diff(turned)).sum())

    def add(self, event: Event) -> None:
        """Add a frame or a reading. Frames too soon after the last one are ignored."""
        if isinstance(event, RgbdFrame):
            self.add_image(event.stamp_s, event.color)
        elif isinstance(event, YawRate):
            # Integrate the mean rate of two readings.
            headings, before = self._headings["gyroscope"], self._rate or event
            step_s = min(max(event.stamp_s - before.stamp_s, 0.0), _LONGEST_STEP_S)
            mean_rad_s = (before.yaw_rate_rad_s + event.yaw_rate_rad_s) / 2
            headings.append((event.stamp_s, (headings[-1][1] if headings else 0.0) + mean_rad_s * step_s))
            self._rate = event
        elif isinstance(event, WheelTicks | WheelSpeeds):
            self._read(event)

    def is_enough(self, compared_s: float) -> bool:
        """Whether turns were compared for long enough at the beginning of a recording."""
        turned = compared_s > _COMPARED_S and self.turned_rad > _ENOUGH_TURNED_RAD
        return turned or compared_s > MOST_COMPARED_S

    @property
    def may_show(self) -> bool:
        """Whether the wheels have turned the robot enough to show an offset."""
        return self.turned_rad >= _LEAST_TURN_RAD

    def needs_image(self, stamp_s: float) -> bool:
        """Whether an image of a stamp is long enough after the last one."""
        return self._last is None or stamp_s - self._last[0] >= _APART_S

    def add_image(self, stamp_s: float, color: ByteArray) -> None:
        """Add a colour image (H, W, 3)."""
        if self._focal_px is None or not self.needs_image(stamp_s):
            return
        grey = np.asarray(cv2.cvtColor(color, cv2.COLOR_RGB2GRAY))
        size = (_WIDTH_PX, max(1, round(_WIDTH_PX * grey.shape[0] / grey.shape[1])))
        now = np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), np.float32)
        last, self._last = self._last, (stamp_s, now)
        if last is None or last[1].shape != now.shape:
            return
        if self._hanning is None or self._hanning.shape != now.shape:
            self._hanning = np.asarray(cv2.createHanningWindow(now.shape[::-1], cv2.CV_32F), np.float32)
        shift_px, response = cv2.phaseCorrelate(last[1], now, self._hanning)
        if response < _LEAST_RESPONSE:
            return
        moved = np.array(shift_px) / _WIDTH_PX / self._focal_px
        self._shifts.append((last[0], stamp_s, float(self._moves @ moved)))

    def offset(self, sensor: str = "wheels") -> MotionOffset:
        """The offset of the camera against the "wheels" or the "gyroscope", from all events so far."""
        if self._is_holonomic:
            return MotionOffset(None, why_not="the base moves to the side too, which moves the image as a turn does")
        headings, shifts = np.array(self._headings[sensor]).reshape(-1, 2), np.array(self._shifts).reshape(-1, 3)
        if len(headings) < 2 or len(shifts) < _FEWEST:
            return MotionOffset(None, why_not=f"only {len(shifts)} pairs of images and {len(headings)} readings")
        if np.linalg.norm(self._moves) < _LEAST_SIDEWAYS:
            return MotionOffset(None, why_not="the camera looks along the axis of the turns")
        headings = headings[np.concatenate([[True], np.diff(headings[:, 0]) > 0])]
        lags_s = np.arange(-_MOST_S, _MOST_S + _STEP_S / 2, _STEP_S)
        found = np.array([_agreement(headings, shifts, lag_s) for lag_s in lags_s])
        best = int(found.argmax())
        near_s = lags_s[best] + np.arange(-_STEP_S, _STEP_S + _FINE_S / 2, _FINE_S)
        offset_s = float(near_s[np.argmax([_agreement(headings, shifts, lag_s) for lag_s in near_s])])
        turned = _turned(headings, shifts, offset_s)
        turned_rad = float(np.abs(turned[0]).sum())
        others = found[np.abs(lags_s - offset_s) > _OTHER_S]
        shown = 0.0, float(found[best]), turned_rad
        if turned_rad < _LEAST_TURN_RAD or len(turned[0]) < _FEWEST:
            return MotionOffset(None, *shown, f"{turned_rad:.2f} rad were turned, {_LEAST_TURN_RAD:g} show it")
        if found[best] < _LEAST_AGREEMENT:
            why_not = f"turns agree by {found[best]:.2f} at best, {_LEAST_AGREEMENT:g} would show it"
            return MotionOffset(None, *shown, why_not)
        if 1 - max(others.max(initial=0.0), 0.0) ** 2 < _LEAST_RATIO * (1 - found[best] ** 2):
            return MotionOffset(None, *shown, "they agree at other differences nearly as well")
        # σ: the residual of turns over their derivative by the offset.
        turns, seen = turned
        gain = float(turns @ seen) / max(float(turns @ turns), 1e-12)
        ends = [_turned(headings, shifts, offset_s + side * _STEP_S)[0] for side in (-1, 1)]
        count = min(len(turns), *map(len, ends))
        slope = gain * (ends[1][:count] - ends[0][:count]) / (2 * _STEP_S)
        scatter = float(np.mean((seen - gain * turns) ** 2))
        sigma_s = float(np.sqrt(scatter / max(float(slope @ slope), 1e-12)))
        return MotionOffset(offset_s, sigma_s, *shown[1:], as_stamped=_agreement(headings, shifts, 0.0))

    def _read(self, reading: WheelTicks | WheelSpeeds) -> None:
        """Integrate the turn of a wheel reading."""
        of = self._wheels
        if of is None:
            return
        before, self._reading = self._reading, reading
        if isinstance(reading, WheelSpeeds):  # from its stamp until the next one
            was = before if isinstance(before, WheelSpeeds) else reading
            rate = (was.right_rad_s * of.right_radius_m - was.left_rad_s * of.left_radius_m) / of.track_width_m
            step_rad = rate * (reading.stamp_s - was.stamp_s)
        else:
            start = before if isinstance(before, WheelTicks) else reading
            left, right = reading.left - start.left, reading.right - start.right
            turns_m = (right * of.right_radius_m - left * of.left_radius_m) * 2 * np.pi / of.ticks_per_turn
            step_rad = turns_m / of.track_width_m
        headings = self._headings["wheels"]
        last_rad = headings[-1][1] if headings else 0.0
        step_rad = step_rad if abs(step_rad) < _LARGEST_STEP_RAD else 0.0
        headings.append((reading.stamp_s - of.delay_s, last_rad + step_rad))


def _turned(headings: FloatArray, shifts: FloatArray, lag_s: float) -> tuple[FloatArray, FloatArray]:
    """Turns (M,) by the sensor between images within its readings, and turns (M,) by the images."""
    begin_s, end_s = shifts[:, 0] - lag_s, shifts[:, 1] - lag_s
    inside = (begin_s >= headings[0, 0]) & (end_s <= headings[-1, 0])
    ends = (np.interp(at_s[inside], headings[:, 0], headings[:, 1]) for at_s in (end_s, begin_s))
    return np.subtract(*ends), shifts[inside, 2]


def _agreement(headings: FloatArray, shifts: FloatArray, lag_s: float) -> float:
    """The correlation of turns at an offset of clocks; 0 where fewer than half of the images overlap."""
    turned, seen = _turned(headings, shifts, lag_s)
    if len(turned) < max(_FEWEST, len(shifts) / 2):
        return 0.0
    size = float(np.sqrt(np.sum(turned**2) * np.sum(seen**2)))
    return float(turned @ seen) / size if size > 0 else 0.0
