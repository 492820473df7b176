"""What can happen to the default filter, and the state after each: FusionState, and `after`.

A gyroscope may tell a thousand times a second, of steps of the wheels that take a fiftieth. Its readings are summed up
until the end of such a step, or a frame: there the mean is one measurement, of the twist that the wheels tell of just
that time. Were each reading one, each would be tested, and some of a thousand are always outside a gate; and each
would count as if the wheels had erred anew.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from wheelsight.core.estimates import STEP_BEGIN, Reason
from wheelsight.core.geometry import FloatArray
from wheelsight.core.settings.fusion import FilterParameters
from wheelsight.estimation import fault_detection as faults
from wheelsight.estimation.fault_detection import FaultDetection
from wheelsight.estimation.pose_belief import PoseBelief, Preintegration, RelativePose, WheelNoise, WheelStep, changed

_SAME_S = 1e-6  # by which stamps that were reckoned may differ


@dataclass(frozen=True, eq=False)
class FusionState:
    """All that the filter knows after an event.

    Attributes:
        detection: of faults, with the hypotheses.
        stamp_s: of the event; None before any.
        told_s: until when any sensor told anything.
        vision_s: when vision was last believed.
        is_lost: no sensor told anything for too long, and no measurement has been believed since.
        is_degenerate: the last measurement did not show all directions.
        reason: why the event was not believed, or None.
    """

    detection: FaultDetection
    stamp_s: float | None = None
    told_s: float = -np.inf
    vision_s: float = -np.inf
    is_lost: bool = False
    is_degenerate: bool = False
    reason: Reason | None = None


@dataclass(frozen=True, slots=True, eq=False)
class FilterEvent:
    """An event; the one field that is not None says which, but that a measured pose may be remembered at once.

    Attributes:
        stamp_s: when.
        wheels: a step of the wheels that ends then.
        yaw_rate_rad_s: of a gyroscope.
        measurement: of the camera. `failure`: why it had none.
        position: x, y (2,) in the map, and covariance (2, 2).
        gyro_bias: what the gyroscope shows at rest beyond what was said before the drive, and its variance.
        clone: the pose is remembered by that name; `spread` (6, 6) by which the camera may have it wrong. `drop`: it no
            longer is.
    """

    stamp_s: float
    wheels: WheelStep | None = None
    yaw_rate_rad_s: float | None = None
    measurement: RelativePose | None = None
    failure: Reason | None = None
    position: tuple[FloatArray, FloatArray] | None = None
    gyro_bias: tuple[float, float] | None = None
    clone: str | None = None
    drop: str | None = None
    spread: FloatArray | None = None

    @property
    def rank(self) -> int:
        """What measures comes before what remembers."""
        of_gyro = (self.gyro_bias, self.yaw_rate_rad_s)
        kinds = (self.wheels, *of_gyro, self.measurement, self.failure, self.position, self.drop, self.clone)
        return next(rank for rank, kind in enumerate(kinds) if kind is not None)

    @property
    def since_s(self) -> float:
        """From when on it matters: of a step of the wheels, its begin."""
        return self.stamp_s if self.wheels is None else self.wheels.begin_s


def after(
    state: FusionState, event: FilterEvent, events: Sequence[FilterEvent], settings: FilterParameters
) -> FusionState:
    """The state after an event, of all those known: the whole step of the filter."""
    if event.yaw_rate_rad_s is not None:
        return _heard(state, event.yaw_rate_rad_s, event.stamp_s, events, settings)
    now = state if state.stamp_s == event.stamp_s else moved_to(state, event.stamp_s, events, settings)
    now = changed(now, detection=_turned_until(now.detection, event.stamp_s, settings))
    detection = changed(faults.end_undecided(now.detection, event.stamp_s, settings), nis=None)
    now = changed(now, detection=detection, reason=None)
    if event.measurement is not None:
        now = _measured(now, event.measurement, event.stamp_s, settings)
    if event.failure is not None:
        now = changed(now, detection=faults.vision_failed(now.detection, event.stamp_s, settings), reason=event.failure)
    if event.gyro_bias is not None:
        told = event.gyro_bias
        return changed(now, detection=_each(now.detection, lambda belief: belief.corrected(belief.gyro_bias(*told))))
    if event.position is not None:
        return _placed(now, *event.position, settings)
    if event.clone is not None:
        return changed(now, detection=_remembered(now.detection, event.clone, event.stamp_s, event.spread, settings))
    if event.drop is not None:
        forgotten = event.drop
        return changed(now, detection=_each(now.detection, lambda belief: belief.dropped(forgotten)))
    return now


def moved_to(
    state: FusionState, stamp_s: float, events: Sequence[FilterEvent], settings: FilterParameters
) -> FusionState:
    """The state at a stamp: by the wheels where they tell, of all events known, else by the speed there was."""
    detection, told_s, begin_s, is_lost = state.detection, state.told_s, state.stamp_s, state.is_lost
    if begin_s is None:
        begin_s = told_s = min([stamp_s, *(event.wheels.begin_s for event in events if event.wheels is not None)])
    covering = sorted((step for step in _steps_after(begin_s, events) if step.begin_s < stamp_s), key=_begin)
    borders = {begin_s, stamp_s}
    ends = (border for step in covering for border in (step.begin_s, step.end_s))
    borders.update(border for border in ends if begin_s + _SAME_S < border < stamp_s - _SAME_S)
    for start_s, end_s in pairwise(sorted(borders)):
        step = next((step for step in covering if _covers(step, start_s, end_s)), None)
        # From then on the base is lost, and a speed of long ago would carry it anywhere.
        until_s = end_s if step is not None else max(start_s, min(end_s, told_s + settings.lost_after_s))
        detection = _gone_on(detection, step, start_s, until_s, settings)
        told_s = told_s if step is None else end_s
        if not is_lost and end_s - told_s > settings.lost_after_s:
            detection, is_lost = _each(detection, lambda belief: belief.scattered(settings)), True
    return changed(state, detection=detection, stamp_s=stamp_s, told_s=told_s, is_lost=is_lost)


def _covers(step: WheelStep, start_s: float, end_s: float) -> bool:
    return step.begin_s <= start_s + _SAME_S and end_s <= step.end_s + _SAME_S


def _steps_after(stamp_s: float, events: Sequence[FilterEvent]) -> list[WheelStep]:
    """Steps of the wheels that end after a stamp: as events stand in order, the last ones."""
    first = bisect_right(events, stamp_s, key=_stamp)
    return [event.wheels for event in events[first:] if event.wheels is not None]


def _stamp(event: FilterEvent) -> float:
    return event.stamp_s


def _begin(step: WheelStep) -> float:
    return step.begin_s


def _gone_on(
    detection: FaultDetection, step: WheelStep | None, start_s: float, end_s: float, settings: FilterParameters
) -> FaultDetection:
    def on(belief: PoseBelief | None, is_slipping: bool) -> PoseBelief | None:
        if belief is None:
            return None
        if step is None:
            return belief.coasted(end_s - start_s, settings)
        return belief.moved_by_wheels(step, (end_s - start_s) / (step.end_s - step.begin_s), settings, is_slipping)

    odometer = detection.odometer
    if step is not None:
        odometer = odometer.moved_by_wheels(step, (end_s - start_s) / (step.end_s - step.begin_s))
        step = WheelStep(step.begin_s, step.end_s, step.xi, step.covariance * detection.noise.ratio)
    belief = on(detection.primary, detection.fault is faults.Fault.WHEEL_SLIP)
    assert belief is not None
    return changed(detection, primary=belief, alternative=on(detection.alternative, True), odometer=odometer)


def _remembered(
    detection: FaultDetection, name: str, stamp_s: float, spread: FloatArray | None, settings: FilterParameters
) -> FaultDetection:
    """With the pose now remembered; from it on the wheels are preintegrated, if the camera measures against it."""
    last = detection.last
    measurement = None if last is None or last.measurement.name != name else last.measurement
    is_known = name in detection.primary.names
    begins = measurement is not None or detection.preintegration is None or detection.preintegration.name == name
    if begins and name != STEP_BEGIN:
        is_of_now = last is not None and last.stamp_s == stamp_s and detection.agreed > 0
        noise = detection.noise
        if measurement is not None and is_of_now and is_known and detection.fault is faults.Fault.NONE:
            noise = _noise_after(detection, measurement, stamp_s, settings)
        begin = Preintegration.of(name, stamp_s, detection.odometer, spread, detection.primary)
        detection = changed(detection, noise=noise, preintegration=begin)
    given = (name, stamp_s, settings.max_clones, spread)
    return _each(detection, lambda belief: belief.cloned(*given))


def _noise_after(
    detection: FaultDetection, measurement: RelativePose, stamp_s: float, settings: FilterParameters
) -> WheelNoise:
    """The wheels' noise, after a measurement against the pose from which they were preintegrated."""
    preintegration, noise = detection.preintegration, detection.noise
    if preintegration is None or preintegration.name != measurement.name:
        return noise
    told = detection.odometer.since(preintegration.begin)
    if not preintegration.is_told(told, stamp_s, settings.wheel_noise_heard_share):
        return noise
    return noise.after(preintegration, told, measurement, detection.primary, settings)


def _measured(state: FusionState, measurement: RelativePose, stamp_s: float, settings: FilterParameters) -> FusionState:
    if measurement.name not in state.detection.primary.names:
        return changed(state, reason=Reason.UNKNOWN_REFERENCE)
    is_degenerate = len(measurement.covariance) < 6
    detection, reason = faults.updated(state.detection, stamp_s, measurement, settings)
    heard = changed(state, detection=detection, reason=reason, is_degenerate=is_degenerate, told_s=stamp_s)
    return heard if reason is not None else changed(heard, vision_s=stamp_s, is_lost=False)


def _placed(state: FusionState, xy: FloatArray, covariance: FloatArray, settings: FilterParameters) -> FusionState:
    detection = state.detection
    by = detection.primary.position(xy, covariance)
    of_alternative = None if detection.alternative is None else detection.alternative.position(xy, covariance)
    most, detection = faults.gate(settings, 2), changed(detection, nis=(by.nis, 2))
    if by.nis > most and (of_alternative is None or of_alternative.nis > most):
        return changed(state, detection=detection, reason=Reason.OUTLIER)
    if detection.alternative is not None and of_alternative is not None:
        cap = settings.leap_chi2_cap
        log_ratio = detection.log_ratio + (min(by.nis, cap) - min(of_alternative.nis, cap)) / 2
        alternative = (
            detection.alternative.corrected(of_alternative) if of_alternative.nis <= most else detection.alternative
        )
        detection = changed(detection, alternative=alternative, log_ratio=log_ratio)
    belief = detection.primary.corrected(by) if by.nis <= most else detection.primary
    return changed(state, detection=changed(detection, primary=belief))


def _heard(
    state: FusionState, rate_rad_s: float, stamp_s: float, events: Sequence[FilterEvent], settings: FilterParameters
) -> FusionState:
    """After a reading of the gyroscope, of the time since the one before.

    What of that was before the state is measured there; the rest waits for what the wheels tell of it, and the state
    stays as of when it was.
    """
    detection, before_s = changed(state.detection, nis=None), state.detection.gyro_s
    state = changed(state, reason=None)
    if before_s is None or not 0 < stamp_s - before_s <= settings.coast_after_s:
        detection = changed(detection, gyro_s=stamp_s, gyro_rad=0.0, gyro_told_s=0.0)
        heard = changed(state, detection=detection)
        return heard if state.stamp_s is not None else moved_to(heard, stamp_s, events, settings)
    if state.stamp_s is not None and before_s < state.stamp_s <= stamp_s:
        detection = _turned(_summed(detection, rate_rad_s, state.stamp_s), state.stamp_s, settings)
    detection = detection if detection.gyro_s == stamp_s else _summed(detection, rate_rad_s, stamp_s)
    heard = changed(state, detection=detection)
    if detection.gyro_told_s < settings.gyro_mean_s - _SAME_S or _is_told(stamp_s, events):
        return heard
    now = moved_to(heard, stamp_s, events, settings)
    return changed(now, detection=_turned(faults.end_undecided(now.detection, stamp_s, settings), stamp_s, settings))


def _summed(detection: FaultDetection, rate_rad_s: float, stamp_s: float) -> FaultDetection:
    """With the turn until a stamp."""
    assert detection.gyro_s is not None
    seconds = stamp_s - detection.gyro_s
    turn_rad = rate_rad_s * seconds
    odometer = detection.odometer.turned(turn_rad - detection.primary.gyro_bias_rad_s * seconds, seconds)
    sums = {"gyro_rad": detection.gyro_rad + turn_rad, "gyro_told_s": detection.gyro_told_s + seconds}
    return changed(detection, odometer=odometer, gyro_s=stamp_s, **sums)


def _is_told(stamp_s: float, events: Sequence[FilterEvent]) -> bool:
    """Whether a step of the wheels goes on at a stamp."""
    return any(step.begin_s < stamp_s for step in _steps_after(stamp_s, events))


def _turned_until(detection: FaultDetection, stamp_s: float, settings: FilterParameters) -> FaultDetection:
    """Measured by the gyroscope where it told of most of the time until a stamp, as if of all of it."""
    if detection.gyro_s is None:
        return detection
    seconds = stamp_s - detection.gyro_s + detection.gyro_told_s
    if not detection.gyro_told_s > settings.gyro_told_share * seconds:
        return detection
    return changed(_turned(detection, stamp_s, settings), gyro_s=stamp_s)


def _turned(detection: FaultDetection, stamp_s: float, settings: FilterParameters) -> FaultDetection:
    """After the mean of what the gyroscope told since the last measurement, if anything."""
    seconds = detection.gyro_told_s
    if not seconds > 0:
        return detection
    rate_rad_s, variance = detection.gyro_rad / seconds, settings.gyro.noise_rad_per_sqrt_s**2 / seconds
    most = faults.gate_of((1 - settings.confidence) * min(seconds / settings.gyro_test_s, 1.0))

    def turned(belief: PoseBelief) -> tuple[PoseBelief, float]:
        by = belief.yaw_rate(rate_rad_s, variance)
        if by.nis <= most:
            return belief.corrected(by).turn_known(), by.nis
        freed = belief.turn_slipped(settings)
        return freed.corrected(freed.yaw_rate(rate_rad_s, variance)).turn_known(), by.nis

    belief, nis = turned(detection.primary)
    alternative = None if detection.alternative is None else turned(detection.alternative)[0]
    told = changed(detection, primary=belief, alternative=alternative, nis=(nis, 1), gyro_rad=0.0, gyro_told_s=0.0)
    return changed(told, turn_slip_s=stamp_s) if nis > most else told


def _each(detection: FaultDetection, change: Callable[[PoseBelief], PoseBelief]) -> FaultDetection:
    """Both beliefs changed alike."""
    return changed(
        detection,
        primary=change(detection.primary),
        alternative=None if detection.alternative is None else change(detection.alternative),
    )
