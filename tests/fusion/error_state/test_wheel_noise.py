"""How noisy the wheels are, learned from preintegrated motions; and the odometer by which these are reported."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from fusion.error_state.fused_drives import T_BASE_CAMERA, Drive, looked, simulate, wheel_covariance
from narrowing import not_none

from wheelsight.core.estimates import MotionEstimate, Reason
from wheelsight.core.geometry import se3
from wheelsight.estimation import ErrorStateFilter
from wheelsight.estimation.pose_belief import (
    ERRORS,
    LAG,
    FilterParameters,
    Odometer,
    PoseBelief,
    Preintegration,
    RelativeMotion,
    WheelNoise,
    WheelStep,
)

SETTINGS = FilterParameters.of()
# Wheels and camera err by noise alone.
_KNOWN: dict[str, Any] = dict.fromkeys(
    ("scale_sigma", "drift_sigma_rad_per_m", "turn_sigma", "camera_lag_sigma_s"), 1e-6
) | dict.fromkeys(("scale_walk", "drift_walk_rad_per_m", "turn_walk", "camera_lag_walk_s"), 0.0)
RIGHT = replace(SETTINGS, **_KNOWN)
STATED_SLIP = 0.004
# Thirteen ratios from a sixteenth to four; one that is twice as large or small is less likely by half a nat.
BEFORE = -0.25 * np.abs(np.arange(-16, 5))


def remembering(memory_m: float) -> FilterParameters:
    return replace(SETTINGS, wheel_noise_memory_m=memory_m)


def test_an_odometer_shows_a_stretch_what_wheels_alone_would(rng: np.random.Generator) -> None:
    whole, stretch, middle = Odometer(), Odometer(), None
    for i in range(12):
        step = WheelStep(0.1 * i, 0.1 * (i + 1), rng.normal(size=6) * 0.1, np.diag(rng.uniform(1e-4, 2e-4, 6)))
        whole = whole.moved_by_wheels(step, 0.4).moved_by_wheels(step, 0.6).turned(0.02, 0.1)
        if i == 4:
            middle = whole
        if i > 4:
            stretch = stretch.moved_by_wheels(step, 1.0).turned(0.02, 0.1)
    assert middle is not None
    reported = whole.since(middle)
    np.testing.assert_allclose(reported.T, stretch.T, atol=1e-12)
    # In two parts a step's noise enters at two places.
    np.testing.assert_allclose(reported.covariance, stretch.covariance, rtol=0.1, atol=2e-5)
    for name in ("way_m", "rolled_s", "turn_rad", "turned_s"):
        np.testing.assert_allclose(getattr(reported, name), getattr(stretch, name), atol=1e-12)


def noise_after(ratio: float, seed: int, seconds: float = 60.0, slips_s: float = np.inf) -> list[float]:
    """What a filter thinks of wheels whose variance is `ratio` of what is stated, after each anchor."""
    rng = np.random.default_rng(seed)
    drive = Drive(seconds, step_s=0.1, slip_m_per_sqrt_m=STATED_SLIP * np.sqrt(ratio))
    fusion = ErrorStateFilter(T_BASE_CAMERA, settings=RIGHT)
    fusion.clone(0.0, "anchor")
    T_anchor, found = np.eye(4), []
    for i, step in enumerate(simulate(drive, rng, RIGHT)):
        xi = se3.log(step.wheels)
        wheels = np.eye(4) if abs(step.begin_s - slips_s) < 1.0 else step.wheels
        fusion.predict(step.end_s, wheels, wheel_covariance(xi, STATED_SLIP), step.begin_s)
        measurement = looked(rng, se3.invert(T_anchor) @ step.T_truth)
        fusion.update_relative(step.end_s, measurement, "anchor")
        if i % 10 == 9:
            fusion.clone(step.end_s, "anchor")
            T_anchor = step.T_truth
        found.append(fusion.state.detection.noise.ratio)
    return found


@pytest.mark.parametrize("ratio", [1 / 16, pytest.param(3.0, marks=pytest.mark.slow)])
def test_noise_is_learned_whatever_the_calibration_says(ratio: float) -> None:
    found = [noise_after(ratio, seed, seconds=45.0)[-1] for seed in range(2)]
    assert 0.5 * ratio < np.mean(found) < 2 * ratio


def test_wheels_that_slip_once_are_forgiven() -> None:
    """A preintegration that no noise explains is one: the noise soon is what it was."""
    found = noise_after(1 / 4, 0, seconds=80.0, slips_s=30.0)
    assert max(found[300:400]) < 2.0
    assert found[-1] < 0.5


def ride_and_look(off_rad: float, spread: float = 1e-3) -> tuple[Preintegration, Odometer, RelativeMotion, PoseBelief]:
    """A straight preintegration of a metre, and a camera that saw it turn by so much."""
    belief = PoseBelief.begin(np.eye(4), 1e-6 * np.eye(6), RIGHT).cloned("anchor", 0.0, 4)
    preintegration, odometer = Preintegration.of("anchor", 0.0, Odometer(), None, belief), Odometer()
    for i in range(10):
        step = WheelStep(0.1 * i, 0.1 * (i + 1), np.array([0.1, 0, 0, 0, 0, 0]), np.diag([1e-6, 1e-6, 0, 0, 0, 1e-6]))
        odometer, belief = odometer.moved_by_wheels(step, 1.0), belief.moved_by_wheels(step, 1.0, RIGHT, False)
    Z = odometer.T @ se3.exp(np.array([0, 0, 0, 0, 0, off_rad]))
    return (
        preintegration,
        odometer,
        RelativeMotion("anchor", Z, np.eye(6), spread**2 * np.eye(6), spread**2 * np.eye(6)),
        belief,
    )


def test_a_ride_that_fits_too_well_makes_wheels_better_and_one_that_does_not_worse() -> None:
    for off_rad, is_better in ((0.0, True), (0.012, False)):
        preintegration, reported, measurement, belief = ride_and_look(off_rad)
        ratio = WheelNoise().after(preintegration, reported, measurement, belief, SETTINGS).ratio
        assert (ratio < WheelNoise().ratio) == is_better


def test_no_single_ride_decides() -> None:
    preintegration, reported, measurement, belief = ride_and_look(1.0)
    nats = not_none(WheelNoise().after(preintegration, reported, measurement, belief, remembering(1e6)).nats)
    assert np.ptp(nats - BEFORE) <= 4.0 + 1e-9


def test_what_was_known_fades_along_the_way() -> None:
    preintegration, reported, measurement, belief = ride_and_look(0.0, spread=1.0)  # which shows nothing
    known = WheelNoise(nats=np.linspace(5.0, 0.0, 21), ratio=0.1)
    kept, lost = (
        known.after(preintegration, reported, measurement, belief, remembering(memory_m)).nats
        for memory_m in (1e9, 1e-3)
    )
    np.testing.assert_allclose(not_none(kept), not_none(known.nats), atol=1e-3)
    np.testing.assert_allclose(not_none(lost), BEFORE, atol=1e-3)


def test_a_ride_that_wheels_reported_half_of_is_not_judged() -> None:
    preintegration, reported, _, _ = ride_and_look(0.0)
    assert preintegration.is_covered(reported, 1.0, share=0.95)
    assert not preintegration.is_covered(reported, 2.0, share=0.95)
    assert preintegration.is_covered(reported, 2.0, share=0.4)
    assert not preintegration.is_covered(Odometer(rolled_s=1.0), 1.0, share=0.95)


def test_errors_as_known_when_the_ride_began_are_no_noise() -> None:
    """Wheels that are known to turn too little are expected to, and the less that is sure, the less it shows."""
    preintegration, reported, measurement, belief = ride_and_look(0.02)
    drift = np.zeros(LAG + 1 - ERRORS.start)
    drift[1] = 0.02  # rad/m
    d, R, N = replace(preintegration, errors=drift).against(measurement, reported, belief)
    np.testing.assert_allclose(d, 0, atol=1e-3)
    _, wider, same = replace(preintegration, unsure=preintegration.unsure + np.diag(np.square(drift))).against(
        measurement, reported, belief
    )
    np.testing.assert_allclose(wider[1, 1] - R[1, 1], 0.02**2, rtol=0.1)
    np.testing.assert_allclose(same, N)


def test_a_motion_that_fails_says_nothing_of_the_wheels() -> None:
    fusion = ErrorStateFilter(T_BASE_CAMERA, settings=RIGHT)
    fusion.clone(0.0, "anchor")
    fusion.predict(0.1, se3.from_plane(0.05, 0, 0), wheel_covariance(np.array([0.05, 0, 0, 0, 0, 0])), 0.0)
    fusion.update_relative(0.1, MotionEstimate.failed(Reason.TOO_LITTLE_DEPTH), "anchor")
    fusion.clone(0.1, "anchor")
    assert fusion.state.detection.noise.ratio == WheelNoise().ratio
