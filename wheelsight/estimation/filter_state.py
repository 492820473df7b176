"""State and events of the default filter. `after` returns the state after an event.

A gyroscope may give a thousand readings per second, while steps of the wheels take a fiftieth of a second. Its readings
are integrated up to the end of such a step, or up to a frame. The mean rate is one measurement, of the twist over the
same time as that of the wheels. Single readings would each be tested, and some of a thousand always fail a gate. They
would also count as if the wheels had independent errors each time.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from operator import attrgetter

import numpy as np

from wheelsight.core.estimates import STEP_BEGIN, Reason
from wheelsight.core.geometry import FloatArray
from wheelsight.core.settings.fusion import FilterParameters
from wheelsight.estimation import fault_detection as faults
from wheelsight.estimation.fault_detection import FaultDetection
from wheelsight.estimation.pose_belief import PoseBelief, Preintegration, RelativePose, WheelStep, changed

_SAME_S = 1e-6  # rounding of computed stamps


@dataclass(frozen=True, eq=False)
class FusionState:
    """State of the filter after an event.

    Attributes:
        detection: fault detection, with the hypotheses.
        stamp_s: of the event; None before any.
        measured_s: end of the last wheel step, or stamp of the last camera measurement.
        vision_s: stamp of the last accepted camera measurement.
        is_lost: no sensor has measured for too long, and no measurement has been accepted since.
        is_degenerate: the last measurement did not show all directions.
        reason: why the event was rejected, or None.
    """

    detection: FaultDetection
    stamp_s: float | None = None
    measured_s: float = -np.inf
    vision_s: float = -np.inf
    is_lost: bool = False
    is_degenerate: bool = False
    reason: Reason | None = None


@dataclass(frozen=True, slots=True, eq=False)
class FilterEvent:
    """An event. The one field that is not None gives its kind; a measurement may have `clone` as well.

    Attributes:
        stamp_s: time of the event.
        wheels: step of the wheels that ends then.
        yaw_rate_rad_s: of a gyroscope.
        measurement: of the camera.
        failure: why the camera has no measurement.
        position: x, y (2,) in the map, and covariance (2, 2).
        gyro_bias: bias of the gyroscope relative to the calibration's, and its variance.
        clone: name by which to remember the pose.
        drop: name of a pose to forget.
        spread: (6, 6) error of the camera's pose at `clone`.
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
        """Order at equal stamps: measurements before changes of remembered poses."""
        of_gyro = (self.gyro_bias, self.yaw_rate_rad_s)
        kinds = (self.wheels, *of_gyro, self.measurement, self.failure, self.position, self.drop, self.clone)
        return next(rank for rank, kind in enumerate(kinds) if kind is not None)

    @property
    def since_s(self) -> float:
        """Stamp from which on it changes states: the begin of a wheel step."""
        return self.stamp_s if self.wheels is None else self.wheels.begin_s


def after(
    state: FusionState, event: FilterEvent, events: Sequence[FilterEvent], settings: FilterParameters
) -> FusionState:
    """Return the state after an event: predict to its stamp, then update. `events` are all that are known."""
    if event.yaw_rate_rad_s is not None:
        return _add_yaw_rate(state, event.yaw_rate_rad_s, event.stamp_s, events, settings)
    now = state if state.stamp_s == event.stamp_s else moved_to(state, event.stamp_s, events, settings)
    now = changed(now, detection=_update_turn_until(now.detection, event.stamp_s, settings))
    detection = changed(faults.end_undecided(now.detection, event.stamp_s, settings), nis=None)
    now = changed(now, detection=detection, reason=None)
    if event.measurement is not None:
        now = _update_relative(now, event.measurement, event.stamp_s, settings)
    if event.failure is not None:
        now = changed(now, detection=faults.vision_failed(now.detection, event.stamp_s, settings), reason=event.failure)
    if event.gyro_bias is not None:
        bias = event.gyro_bias
        return changed(now, detection=_each(now.detection, lambda belief: belief.corrected(belief.gyro_bias(*bias))))
    if event.position is not None:
        return _update_position(now, *event.position, settings)
    if event.clone is not None:
        return changed(now, detection=_remember(now.detection, event.clone, event.stamp_s, event.spread, settings))
    if event.drop is not None:
        name = event.drop
        return changed(now, detection=_each(now.detection, lambda belief: belief.dropped(name)))
    return now


def moved_to(
    state: FusionState, stamp_s: float, events: Sequence[FilterEvent], settings: FilterParameters
) -> FusionState:
    """Predict the state at a stamp: by the wheel steps among all known events, else at constant twist."""
    detection, measured_s, begin_s, is_lost = state.detection, state.measured_s, state.stamp_s, state.is_lost
    if begin_s is None:
        begin_s = measured_s = min([stamp_s, *(event.wheels.begin_s for event in events if event.wheels is not None)])
    covering = sorted(
        (step for step in _steps_after(begin_s, events) if step.begin_s < stamp_s), key=attrgetter("begin_s")
    )
    borders = {begin_s, stamp_s}
    ends = (border for step in covering for border in (step.begin_s, step.end_s))
    borders.update(border for border in ends if begin_s + _SAME_S < border < stamp_s - _SAME_S)
    for start_s, end_s in pairwise(sorted(borders)):
        covers = (one for one in covering if one.begin_s <= start_s + _SAME_S and end_s <= one.end_s + _SAME_S)
        step = next(covers, None)
        # Once the base is lost, it keeps its pose: an old twist would carry it anywhere.
        until_s = end_s if step is not None else max(start_s, min(end_s, measured_s + settings.lost_after_s))
        detection = _predict(detection, step, start_s, until_s, settings)
        measured_s = measured_s if step is None else end_s
        if not is_lost and end_s - measured_s > settings.lost_after_s:
            detection, is_lost = _each(detection, lambda belief: belief.scattered(settings)), True
    return changed(state, detection=detection, stamp_s=stamp_s, measured_s=measured_s, is_lost=is_lost)


def _steps_after(stamp_s: float, events: Sequence[FilterEvent]) -> list[WheelStep]:
    """Return the wheel steps that end after a stamp. Events are in the order of their stamps."""
    first = bisect_right(events, stamp_s, key=attrgetter("stamp_s"))
    return [event.wheels for event in events[first:] if event.wheels is not None]


def _predict(
    detection: FaultDetection, step: WheelStep | None, start_s: float, end_s: float, settings: FilterParameters
) -> FaultDetection:
    """Predict all hypotheses over an interval: by a share of a wheel step, or at constant twist."""

    def predicted(belief: PoseBelief | None, is_slipping: bool) -> PoseBelief | None:
        if belief is None:
            return None
        if step is None:
            return belief.coasted(end_s - start_s, settings)
        return belief.moved_by_wheels(step, (end_s - start_s) / (step.end_s - step.begin_s), settings, is_slipping)

    odometer = detection.odometer
    if step is not None:
        odometer = odometer.moved_by_wheels(step, (end_s - start_s) / (step.end_s - step.begin_s))
        step = WheelStep(step.begin_s, step.end_s, step.xi, step.covariance * detection.noise.ratio)
    belief = predicted(detection.primary, detection.fault is faults.Fault.WHEEL_SLIP)
    assert belief is not None
    return changed(detection, primary=belief, alternative=predicted(detection.alternative, True), odometer=odometer)


def _update_relative(
    state: FusionState, measurement: RelativePose, stamp_s: float, settings: FilterParameters
) -> FusionState:
    """Update by a camera measurement."""
    if measurement.name not in state.detection.primary.names:
        return changed(state, reason=Reason.UNKNOWN_REFERENCE)
    is_degenerate = len(measurement.covariance) < 6
    detection, reason = faults.updated(state.detection, stamp_s, measurement, settings)
    now = changed(state, detection=detection, reason=reason, is_degenerate=is_degenerate, measured_s=stamp_s)
    return now if reason is not None else changed(now, vision_s=stamp_s, is_lost=False)


def _update_position(
    state: FusionState, xy: FloatArray, covariance: FloatArray, settings: FilterParameters
) -> FusionState:
    """Update by a position (2,) in the map. It also changes the odds of the hypotheses."""
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


def _remember(
    detection: FaultDetection, name: str, stamp_s: float, spread: FloatArray | None, settings: FilterParameters
) -> FaultDetection:
    """Remember the current pose. If the camera measures against it, preintegration of the wheels restarts here."""
    last, preintegration = detection.last, detection.preintegration
    measurement = None if last is None or last.measurement.name != name else last.measurement
    is_known = name in detection.primary.names
    begins = measurement is not None or preintegration is None or preintegration.name == name
    if begins and name != STEP_BEGIN:
        is_current = last is not None and last.stamp_s == stamp_s and detection.agreed > 0
        is_sound = is_known and detection.fault is faults.Fault.NONE
        noise, is_of_start = detection.noise, preintegration is not None and preintegration.name == name
        if measurement is not None and preintegration is not None and is_of_start and is_current and is_sound:
            # A measurement against the start of the preintegration updates the wheels' noise.
            rolled = detection.odometer.since(preintegration.begin)
            if preintegration.is_covered(rolled, stamp_s, settings.wheel_noise_heard_share):
                noise = noise.after(preintegration, rolled, measurement, detection.primary, settings)
        begin = Preintegration.of(name, stamp_s, detection.odometer, spread, detection.primary)
        detection = changed(detection, noise=noise, preintegration=begin)
    given = (name, stamp_s, settings.max_clones, spread)
    return _each(detection, lambda belief: belief.cloned(*given))


def _add_yaw_rate(
    state: FusionState, rate_rad_s: float, stamp_s: float, events: Sequence[FilterEvent], settings: FilterParameters
) -> FusionState:
    """Add a reading of the gyroscope, the mean rate since the one before.

    The part before the state's stamp updates the state. The rest is integrated until the wheels cover that time, and
    the state keeps its stamp.
    """
    detection, before_s = changed(state.detection, nis=None), state.detection.gyro_s
    state = changed(state, reason=None)
    if before_s is None or not 0 < stamp_s - before_s <= settings.coast_after_s:
        detection = changed(detection, gyro_s=stamp_s, gyro_rad=0.0, gyro_sum_s=0.0)
        added = changed(state, detection=detection)
        return added if state.stamp_s is not None else moved_to(added, stamp_s, events, settings)
    if state.stamp_s is not None and before_s < state.stamp_s <= stamp_s:
        detection = _update_turn(_integrate(detection, rate_rad_s, state.stamp_s), state.stamp_s, settings)
    detection = detection if detection.gyro_s == stamp_s else _integrate(detection, rate_rad_s, stamp_s)
    added = changed(state, detection=detection)
    if detection.gyro_sum_s < settings.gyro_mean_s - _SAME_S:
        return added
    if any(step.begin_s < stamp_s for step in _steps_after(stamp_s, events)):  # a wheel step covers the stamp
        return added
    now = moved_to(added, stamp_s, events, settings)
    detection = faults.end_undecided(now.detection, stamp_s, settings)
    return changed(now, detection=_update_turn(detection, stamp_s, settings))


def _integrate(detection: FaultDetection, rate_rad_s: float, stamp_s: float) -> FaultDetection:
    """Integrate a yaw rate up to a stamp."""
    assert detection.gyro_s is not None
    seconds = stamp_s - detection.gyro_s
    turn_rad = rate_rad_s * seconds
    odometer = detection.odometer.turned(turn_rad - detection.primary.gyro_bias_rad_s * seconds, seconds)
    sums = {"gyro_rad": detection.gyro_rad + turn_rad, "gyro_sum_s": detection.gyro_sum_s + seconds}
    return changed(detection, odometer=odometer, gyro_s=stamp_s, **sums)


def _update_turn_until(detection: FaultDetection, stamp_s: float, settings: FilterParameters) -> FaultDetection:
    """Update by the gyroscope if it covers most of the time up to a stamp, as if it covered all of it."""
    if detection.gyro_s is None:
        return detection
    seconds = stamp_s - detection.gyro_s + detection.gyro_sum_s
    if not detection.gyro_sum_s > settings.gyro_told_share * seconds:
        return detection
    return changed(_update_turn(detection, stamp_s, settings), gyro_s=stamp_s)


def _update_turn(detection: FaultDetection, stamp_s: float, settings: FilterParameters) -> FaultDetection:
    """Update by the gyroscope's mean rate since the last such update, if there is any."""
    seconds = detection.gyro_sum_s
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
    now = changed(detection, primary=belief, alternative=alternative, nis=(nis, 1), gyro_rad=0.0, gyro_sum_s=0.0)
    return changed(now, turn_slip_s=stamp_s) if nis > most else now


def _each(detection: FaultDetection, change: Callable[[PoseBelief], PoseBelief]) -> FaultDetection:
    """Apply a change to the beliefs of all hypotheses."""
    return changed(
        detection,
        primary=change(detection.primary),
        alternative=None if detection.alternative is None else change(detection.alternative),
    )
