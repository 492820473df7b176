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

from wheelsight.estimates import Reason
from wheelsight.fusion.error_state import _trust as trust
from wheelsight.fusion.error_state._changed import changed
from wheelsight.fusion.error_state._measurements import Look, WheelStep
from wheelsight.fusion.error_state._pose_belief import PoseBelief
from wheelsight.fusion.error_state._trust import Court
from wheelsight.fusion.error_state._wheel_noise import Ride, WheelNoise
from wheelsight.fusion.error_state.settings import FilterParameters
from wheelsight.geometry import FloatArray

_SAME_S = 1e-6  # by which stamps that were reckoned may differ


@dataclass(frozen=True, eq=False)
class FusionState:
    """All that the filter knows after an event.

    Attributes:
        court: beliefs, and whom to trust.
        stamp_s: of the event; None before any.
        told_s: until when any sensor told anything.
        vision_s: when vision was last believed.
        is_lost: no sensor told anything for too long, and no look has been believed since.
        is_degenerate: the last look did not show all directions.
        reason: why the event was not believed, or None.
    """

    court: Court
    stamp_s: float | None = None
    told_s: float = -np.inf
    vision_s: float = -np.inf
    is_lost: bool = False
    is_degenerate: bool = False
    reason: Reason | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Happening:
    """An event; the one field that is not None says which, but that a look or its failure may be remembered at once.

    Attributes:
        stamp_s: when.
        wheels: a step of the wheels that ends then.
        yaw_rate_rad_s: of a gyroscope.
        look: of the camera. `failure`: why it had none.
        position: x, y (2,) in the map, and covariance (2, 2).
        gyro_bias: what the gyroscope shows at rest beyond what was said before the drive, and its variance.
        clone: the pose is remembered by that name; `spread` (6, 6) by which the camera may have it wrong. `drop`: it no
            longer is.
    """

    stamp_s: float
    wheels: WheelStep | None = None
    yaw_rate_rad_s: float | None = None
    look: Look | None = None
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
        kinds = (self.wheels, *of_gyro, self.look, self.failure, self.position, self.drop, self.clone)
        return next(rank for rank, kind in enumerate(kinds) if kind is not None)

    @property
    def since_s(self) -> float:
        """From when on it matters: of a step of the wheels, its begin."""
        return self.stamp_s if self.wheels is None else self.wheels.begin_s


def after(state: FusionState, event: Happening, events: Sequence[Happening], settings: FilterParameters) -> FusionState:
    """The state after an event, of all those known: the whole step of the filter."""
    if event.yaw_rate_rad_s is not None:
        return _heard(state, event.yaw_rate_rad_s, event.stamp_s, events, settings)
    now = state if state.stamp_s == event.stamp_s else moved_to(state, event.stamp_s, events, settings)
    now = changed(now, court=_turned_until(now.court, event.stamp_s, settings))
    court = changed(trust.end_doubt(now.court, event.stamp_s, settings), nis=None)
    now = changed(now, court=court, reason=None)
    if event.look is not None:
        now = _looked(now, event.look, event.stamp_s, settings)
    if event.failure is not None:
        now = changed(now, court=trust.fail(now.court, event.stamp_s, settings), reason=event.failure)
    if event.gyro_bias is not None:
        told = event.gyro_bias
        return changed(now, court=_each(now.court, lambda belief: belief.corrected(belief.gyro_bias(*told))))
    if event.position is not None:
        return _placed(now, *event.position, settings)
    if event.clone is not None:
        return changed(now, court=_remembered(now.court, event.clone, event.stamp_s, event.spread, settings))
    if event.drop is not None:
        forgotten = event.drop
        return changed(now, court=_each(now.court, lambda belief: belief.dropped(forgotten)))
    return now


def moved_to(
    state: FusionState, stamp_s: float, events: Sequence[Happening], settings: FilterParameters
) -> FusionState:
    """The state at a stamp: by the wheels where they tell, of all events known, else by the speed there was."""
    court, told_s, begin_s, is_lost = state.court, state.told_s, state.stamp_s, state.is_lost
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
        court = _gone_on(court, step, start_s, until_s, settings)
        told_s = told_s if step is None else end_s
        if not is_lost and end_s - told_s > settings.lost_after_s:
            court, is_lost = _each(court, lambda belief: belief.scattered(settings)), True
    return changed(state, court=court, stamp_s=stamp_s, told_s=told_s, is_lost=is_lost)


def _covers(step: WheelStep, start_s: float, end_s: float) -> bool:
    return step.begin_s <= start_s + _SAME_S and end_s <= step.end_s + _SAME_S


def _steps_after(stamp_s: float, events: Sequence[Happening]) -> list[WheelStep]:
    """Steps of the wheels that end after a stamp: as events stand in order, the last ones."""
    first = bisect_right(events, stamp_s, key=_stamp)
    return [event.wheels for event in events[first:] if event.wheels is not None]


def _stamp(event: Happening) -> float:
    return event.stamp_s


def _begin(step: WheelStep) -> float:
    return step.begin_s


def _gone_on(court: Court, step: WheelStep | None, start_s: float, end_s: float, settings: FilterParameters) -> Court:
    def on(belief: PoseBelief | None, is_slipping: bool) -> PoseBelief | None:
        if belief is None:
            return None
        if step is None:
            return belief.glided(end_s - start_s, settings)
        return belief.rolled(step, (end_s - start_s) / (step.end_s - step.begin_s), settings, is_slipping)

    odometer = court.odometer
    if step is not None:
        odometer = odometer.rolled(step, (end_s - start_s) / (step.end_s - step.begin_s))
        step = WheelStep(step.begin_s, step.end_s, step.xi, step.covariance * court.noise.ratio)
    belief = on(court.belief, court.trust is trust.Trust.CAMERA)
    assert belief is not None
    return changed(court, belief=belief, rival=on(court.rival, True), odometer=odometer)


def _remembered(
    court: Court, name: str, stamp_s: float, spread: FloatArray | None, settings: FilterParameters
) -> Court:
    """With the pose now remembered, against which the wheels' next ride is then judged if the camera looks at it."""
    look = None if court.glance is None or court.glance.look.name != name else court.glance.look
    is_of_now = court.glance is not None and court.glance.stamp_s == stamp_s and court.agreed > 0
    agrees = look is not None and is_of_now and court.trust is trust.Trust.BOTH and name in court.belief.names
    if look is not None or court.ride is None or court.ride.name == name:
        noise = _noise_after(court, look, stamp_s, settings) if agrees and look is not None else court.noise
        court = changed(court, noise=noise, ride=Ride.of(name, stamp_s, court.odometer, spread, court.belief))
    if agrees and look is not None and spread is not None and len(look.covariance) == 6:
        return changed(court, belief=court.belief.chained(look, stamp_s, spread, settings))
    given = (name, stamp_s, settings.max_clones, spread)
    return _each(court, lambda belief: belief.cloned(*given))


def _noise_after(court: Court, look: Look, stamp_s: float, settings: FilterParameters) -> WheelNoise:
    """The wheels' noise, after a look at the pose from which they rode."""
    ride, noise = court.ride, court.noise
    if ride is None or ride.name != look.name:
        return noise
    told = court.odometer.since(ride.begin)
    if not ride.is_told(told, stamp_s):
        return noise
    return noise.after(ride, told, look, court.belief, settings)


def _looked(state: FusionState, look: Look, stamp_s: float, settings: FilterParameters) -> FusionState:
    if look.name not in state.court.belief.names:
        return changed(state, reason=Reason.UNKNOWN_REFERENCE)
    is_degenerate = len(look.covariance) < 6
    court, reason = trust.see(state.court, stamp_s, look, settings)
    heard = changed(state, court=court, reason=reason, is_degenerate=is_degenerate, told_s=stamp_s)
    return heard if reason is not None else changed(heard, vision_s=stamp_s, is_lost=False)


def _placed(state: FusionState, xy: FloatArray, covariance: FloatArray, settings: FilterParameters) -> FusionState:
    court = state.court
    by = court.belief.position(xy, covariance)
    rivals = None if court.rival is None else court.rival.position(xy, covariance)
    most, court = trust.gate(settings, 2), changed(court, nis=(by.nis, 2))
    if by.nis > most and (rivals is None or rivals.nis > most):
        return changed(state, court=court, reason=Reason.OUTLIER)
    if court.rival is not None and rivals is not None:
        cap = settings.leap_chi2_cap
        evidence = court.evidence + (min(by.nis, cap) - min(rivals.nis, cap)) / 2
        rival = court.rival.corrected(rivals) if rivals.nis <= most else court.rival
        court = changed(court, rival=rival, evidence=evidence)
    belief = court.belief.corrected(by) if by.nis <= most else court.belief
    return changed(state, court=changed(court, belief=belief))


def _heard(
    state: FusionState, rate_rad_s: float, stamp_s: float, events: Sequence[Happening], settings: FilterParameters
) -> FusionState:
    """After a reading of the gyroscope, of the time since the one before.

    What of that was before the state is measured there; the rest waits for what the wheels tell of it, and the state
    stays as of when it was.
    """
    court, before_s = changed(state.court, nis=None), state.court.gyro_s
    state = changed(state, reason=None)
    if before_s is None or not 0 < stamp_s - before_s <= settings.coast_after_s:
        court = changed(court, gyro_s=stamp_s, gyro_rad=0.0, gyro_told_s=0.0)
        heard = changed(state, court=court)
        return heard if state.stamp_s is not None else moved_to(heard, stamp_s, events, settings)
    if state.stamp_s is not None and before_s < state.stamp_s <= stamp_s:
        court = _turned(_summed(court, rate_rad_s, state.stamp_s), state.stamp_s, settings)
    court = court if court.gyro_s == stamp_s else _summed(court, rate_rad_s, stamp_s)
    heard = changed(state, court=court)
    if court.gyro_told_s < settings.gyro_mean_s - _SAME_S or _is_told(stamp_s, events):
        return heard
    now = moved_to(heard, stamp_s, events, settings)
    return changed(now, court=_turned(trust.end_doubt(now.court, stamp_s, settings), stamp_s, settings))


def _summed(court: Court, rate_rad_s: float, stamp_s: float) -> Court:
    """With the turn until a stamp."""
    assert court.gyro_s is not None
    seconds = stamp_s - court.gyro_s
    turn_rad = rate_rad_s * seconds
    odometer = court.odometer.turned(turn_rad - court.belief.gyro_bias_rad_s * seconds, seconds)
    sums = {"gyro_rad": court.gyro_rad + turn_rad, "gyro_told_s": court.gyro_told_s + seconds}
    return changed(court, odometer=odometer, gyro_s=stamp_s, **sums)


def _is_told(stamp_s: float, events: Sequence[Happening]) -> bool:
    """Whether a step of the wheels goes on at a stamp."""
    return any(step.begin_s < stamp_s for step in _steps_after(stamp_s, events))


def _turned_until(court: Court, stamp_s: float, settings: FilterParameters) -> Court:
    """Measured by the gyroscope where it told of most of the time until a stamp, as if of all of it."""
    if court.gyro_s is None:
        return court
    seconds = stamp_s - court.gyro_s + court.gyro_told_s
    if not court.gyro_told_s > settings.gyro_told_share * seconds:
        return court
    return changed(_turned(court, stamp_s, settings), gyro_s=stamp_s)


def _turned(court: Court, stamp_s: float, settings: FilterParameters) -> Court:
    """After the mean of what the gyroscope told since the last measurement, if anything."""
    seconds = court.gyro_told_s
    if not seconds > 0:
        return court
    rate_rad_s, variance = court.gyro_rad / seconds, settings.gyro.noise_rad_per_sqrt_s**2 / seconds
    most = trust.gate_of((1 - settings.confidence) * min(seconds / settings.gyro_test_s, 1.0))

    def turned(belief: PoseBelief) -> tuple[PoseBelief, float]:
        by = belief.yaw_rate(rate_rad_s, variance)
        if by.nis <= most:
            return belief.corrected(by).turn_known(), by.nis
        freed = belief.turn_distrusted(settings)
        return freed.corrected(freed.yaw_rate(rate_rad_s, variance)).turn_known(), by.nis

    belief, nis = turned(court.belief)
    rival = None if court.rival is None else turned(court.rival)[0]
    told = changed(court, belief=belief, rival=rival, nis=(nis, 1), gyro_rad=0.0, gyro_told_s=0.0)
    return changed(told, turn_slip_s=stamp_s) if nis > most else told


def _each(court: Court, change: Callable[[PoseBelief], PoseBelief]) -> Court:
    """Both beliefs changed alike."""
    return changed(court, belief=change(court.belief), rival=None if court.rival is None else change(court.rival))
