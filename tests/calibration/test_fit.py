from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from drives import MIXED, SimulatedDrive, simulate
from hypothesis import given, settings
from hypothesis import strategies as st

from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.errors import CalibrationError
from wheelsight.core.geometry import se3
from wheelsight.core.trajectory import Trajectory
from wheelsight_calibration.wheel_drive import WheelDrive, drive_from_ticks, drive_path, yaw_at_readings
from wheelsight_calibration.wheels import PARAMETERS, WheelFit, fit_wheels

NOMINAL = Wheels(left_radius_m=0.17, right_radius_m=0.17, track_width_m=0.58, ticks_per_turn=3200)
TRUE = replace(NOMINAL, left_radius_m=0.171, right_radius_m=0.1695, track_width_m=0.615, delay_s=0.083)
SIZES = PARAMETERS[:3]


def drive_of(simulated: SimulatedDrive) -> WheelDrive:
    return drive_from_ticks(NOMINAL, simulated.stamps_s, simulated.left, simulated.right)


def fit(simulated: SimulatedDrive, nominal: Wheels = NOMINAL, **options: object) -> WheelFit:
    return fit_wheels(nominal, drive_of(simulated), simulated.truth, **options)  # type: ignore[arg-type]


@pytest.mark.slow
@settings(max_examples=6)
@given(
    ratio=st.floats(0.98, 1.02), track_m=st.floats(0.45, 0.8), delay_s=st.floats(-0.4, 0.4), seed=st.integers(0, 1000)
)
def test_injected_sizes_are_found_within_two_parts_in_a_thousand(
    ratio: float, track_m: float, delay_s: float, seed: int
) -> None:
    """In spite of noisy wheels, a noisy reference, and a slip of half a metre every 20 s or so."""
    true = replace(NOMINAL, right_radius_m=0.17 * ratio, track_width_m=track_m, delay_s=delay_s)
    noisy = replace(true, slip_m_per_sqrt_m=0.002)
    rng = np.random.default_rng(seed)
    found = fit(simulate(noisy, rng=rng, slips=8, reference_sigma_m=0.002, reference_sigma_rad=0.002)).wheels
    for name in SIZES:
        assert getattr(found, name) == pytest.approx(getattr(true, name), rel=2e-3)
    assert found.delay_s == pytest.approx(delay_s, abs=5e-3)


def test_exact_readings_give_exact_wheels() -> None:
    result = fit(simulate(TRUE))
    for name in PARAMETERS:
        off = abs(getattr(result.wheels, name) - getattr(TRUE, name))
        assert off < max(4 * result.sigmas[name], 2e-5)
    assert not result.is_slip.any()
    assert (result.weights > 0.5).all()


def test_slips_are_reported_from_noise(rng: np.random.Generator) -> None:
    noisy = replace(TRUE, slip_m_per_sqrt_m=0.003)
    clean, slipping = (fit(simulate(noisy, rng=rng, slips=slips, reference_sigma_m=0.002)) for slips in (0, 10))
    assert 10 <= slipping.is_slip.sum() - clean.is_slip.sum() <= 20
    assert slipping.weights[slipping.is_slip].max() < 0.3
    assert clean.is_slip.mean() < 0.06


@pytest.mark.slow
@pytest.mark.parametrize(
    ("slip", "sigma_m", "sigma_rad", "slips"),
    [(0.005, 0.0, 0.0, 0), (0.003, 0.01, 0.01, 0), (0.005, 0.003, 0.002, 8)],
    ids=["wheels-only", "poor-reference", "with-slips"],
)
def test_standard_deviations_are_honest(slip: float, sigma_m: float, sigma_rad: float, slips: int) -> None:
    """Over 20 drives, errors are as large as stated, within what 20 drives can tell."""
    noisy = replace(TRUE, slip_m_per_sqrt_m=slip)
    errors, stated = [], []
    for seed in range(20):
        rng = np.random.default_rng([7, seed])
        result = fit(simulate(noisy, rng=rng, slips=slips, reference_sigma_m=sigma_m, reference_sigma_rad=sigma_rad))
        errors.append([getattr(result.wheels, name) - getattr(TRUE, name) for name in PARAMETERS])
        stated.append([result.sigmas[name] for name in PARAMETERS])
    ratio = np.sqrt(np.mean(np.square(errors), axis=0) / np.mean(np.square(stated), axis=0))
    assert (ratio < 1.4).all(), ratio
    assert (ratio > 0.55).all(), ratio


def test_the_delay_can_be_kept() -> None:
    result = fit(simulate(TRUE), replace(NOMINAL, delay_s=0.083), with_delay=False)
    assert result.wheels.delay_s == 0.083
    assert set(result.sigmas) == set(SIZES)
    assert result.wheels.track_width_m == pytest.approx(0.615, rel=1e-3)


def test_a_reference_of_few_poses_will_do() -> None:
    simulated = simulate(TRUE)
    sparse = simulated.truth.select(slice(None, None, 37))
    result = fit_wheels(NOMINAL, drive_of(simulated), sparse)
    assert result.wheels.track_width_m == pytest.approx(0.615, rel=1e-3)


def test_where_readings_are_missing_nothing_is_compared() -> None:
    simulated = simulate(TRUE)
    there = (simulated.stamps_s < 1040) | (simulated.stamps_s > 1055)
    ticks = (simulated.stamps_s[there], simulated.left[there], simulated.right[there])
    result = fit_wheels(NOMINAL, drive_from_ticks(NOMINAL, *ticks), simulated.truth)
    during = (result.segments.end_s > 1040) & (result.segments.start_s < 1055)
    assert not during.any()
    assert not result.is_slip.any()


def test_where_a_counter_is_set_back_nothing_is_compared() -> None:
    simulated = simulate(TRUE)
    left, right = simulated.left.copy(), simulated.right.copy()
    left[3000:] -= left[3000]
    right[3000:] -= right[3000]
    drive, stamp_s = drive_from_ticks(NOMINAL, simulated.stamps_s, left, right), simulated.stamps_s[3000]
    result = fit_wheels(NOMINAL, drive, simulated.truth)
    assert not ((result.segments.end_s > stamp_s) & (result.segments.start_s < stamp_s)).any()
    assert not result.is_slip.any()
    assert result.wheels.track_width_m == pytest.approx(0.615, rel=1e-3)


@pytest.mark.parametrize("bits", [8, 12, 16, 32])
def test_counters_roll_over(bits: int) -> None:
    simulated = simulate(TRUE)
    rolled = [(ticks + (1 << (bits - 1)) - 5) % (1 << bits) for ticks in (simulated.left, simulated.right)]
    drive = drive_from_ticks(replace(NOMINAL, counter_bits=bits), simulated.stamps_s, *rolled)
    np.testing.assert_array_equal(drive.left_rad, drive_of(simulated).left_rad)


def test_the_path_is_that_of_the_robot() -> None:
    simulated = simulate(replace(TRUE, ticks_per_turn=1e6))
    drive = drive_from_ticks(replace(TRUE, ticks_per_turn=1e6), simulated.stamps_s, simulated.left, simulated.right)
    between = simulated.truth.stamps_s[10:-10] + 0.007
    path = drive_path(drive, TRUE, between)
    assert (path.body, path.frame) == ("base", "odom")
    np.testing.assert_allclose(path.positions_m, simulated.truth.at(between)[:, :3, 3], atol=2e-3)
    yaw_rad = np.interp(between + TRUE.delay_s, drive.stamps_s, yaw_at_readings(drive, TRUE))
    R = path.T_frame_body[:, :3, :3]
    np.testing.assert_allclose(np.exp(1j * yaw_rad), R[:, 0, 0] + 1j * R[:, 1, 0], atol=1e-9)


@pytest.mark.parametrize(
    ("legs", "reported", "advice"),
    [
        ([(120.0, 0.8, 0.0), (2.0, 0.0, 0.0)], "track width", "hardly turns: drive some full turns"),
        ([(4.0, 0.0, 0.8), (2.0, 0.0, -0.6)] * 20, "radius", "drive straight for some metres"),
        ([(120.0, 0.6, 0.5)], "track width", "turns one way only"),
    ],
    ids=["straight", "on-the-spot", "circles"],
)
def test_a_drive_that_leaves_something_open_is_refused(
    legs: list[tuple[float, float, float]], reported: str, advice: str, rng: np.random.Generator
) -> None:
    simulated = simulate(replace(TRUE, slip_m_per_sqrt_m=0.003), legs, rng=rng, reference_sigma_m=0.002)
    with pytest.raises(CalibrationError, match="the drive does not determine") as caught:
        fit(simulated)
    assert reported in caught.value.problem
    assert advice in (caught.value.fix or "")


def test_even_without_noise_a_straight_drive_is_refused() -> None:
    with pytest.raises(CalibrationError, match=r"does not determine: .*track width \(σ over 100 %\)"):
        fit(simulate(TRUE, [(20.0, 0.8, 0.0), (2.0, 0.0, 0.0)] * 4))


@pytest.mark.parametrize("legs", [[(60.0, 0.0, 0.0)], MIXED[:2]], ids=["at-rest", "short"])
def test_too_little_is_refused(legs: list[tuple[float, float, float]]) -> None:
    with pytest.raises(CalibrationError, match=r"the drive holds \d+ pieces of 1 m or a radian .* 12 are needed"):
        fit(simulate(TRUE, legs))


def test_a_reference_of_another_time_is_refused() -> None:
    simulated = simulate(TRUE)
    later = Trajectory(simulated.truth.stamps_s + 5000, simulated.truth.T_frame_body, body="base")
    with pytest.raises(CalibrationError, match=r"share less than the 1 s"):
        fit_wheels(NOMINAL, drive_of(simulated), later)


def test_a_reference_of_the_camera_is_refused() -> None:
    simulated = simulate(TRUE)
    camera = Trajectory(simulated.truth.stamps_s, simulated.truth.T_frame_body, body="camera")
    with pytest.raises(CalibrationError, match="the reference is of the camera, but wheels move the base"):
        fit_wheels(NOMINAL, drive_of(simulated), camera)


@pytest.mark.slow
def test_swapped_and_backward_wheels_are_named() -> None:
    simulated = simulate(TRUE)
    swapped = drive_from_ticks(NOMINAL, simulated.stamps_s, simulated.right, simulated.left)
    with pytest.raises(CalibrationError, match="left and right are swapped"):
        fit_wheels(NOMINAL, swapped, simulated.truth)
    backward = drive_from_ticks(NOMINAL, simulated.stamps_s, -simulated.left, -simulated.right)
    with pytest.raises(CalibrationError, match="both wheels count backwards"):
        fit_wheels(NOMINAL, backward, simulated.truth)


def test_a_reference_of_another_drive_is_refused() -> None:
    simulated = simulate(TRUE)
    other = simulate(TRUE, MIXED[::-1] * 4).truth
    with pytest.raises(CalibrationError, match="are not of one drive"):
        fit_wheels(NOMINAL, drive_of(simulated), other)


def test_wrong_units_are_refused() -> None:
    simulated = simulate(TRUE)
    T = simulated.truth.T_frame_body.copy()
    T[:, :3, 3] *= 3.28
    feet = Trajectory(simulated.truth.stamps_s, T, body="base")
    with pytest.raises(CalibrationError, match=r"asks for 3\.\d+ times the nominal left radius"):
        fit_wheels(NOMINAL, drive_of(simulated), feet)


def test_a_delay_beyond_the_search_is_refused() -> None:
    simulated = simulate(replace(TRUE, delay_s=0.62))
    with pytest.raises(CalibrationError, match=r"seem \+0.6\d s apart"):
        fit(simulated)


def test_the_references_world_is_no_matter() -> None:
    simulated = simulate(TRUE)
    T_map_odom = se3.exp(np.array([12.0, -3.0, 0.5, 0.0, 0.0, 2.1]))
    moved = fit_wheels(NOMINAL, drive_of(simulated), simulated.truth.moved(T_map_odom))
    assert moved.wheels.track_width_m == pytest.approx(fit(simulated).wheels.track_width_m, rel=1e-6)


def test_readings_that_run_backwards_are_refused() -> None:
    with pytest.raises(CalibrationError, match="strictly growing"):
        drive_from_ticks(NOMINAL, [0.0, 1.0, 0.5], [0, 1, 2], [0, 1, 2])


def test_a_reference_that_may_be_too_long_makes_both_radii_as_unsure() -> None:
    """By 1 % of all ways and half a per cent of turns: as σ of both radii and the track, not of one over the other."""
    seen = simulate(TRUE)
    way, turn = np.diag([0.01, 0.01, 0.0]), np.diag([0.0, 0.0, 0.005])
    exact, open_ = fit(seen), fit(seen, camera_errors=np.stack([way, turn]))
    assert open_.ratio_sigma == pytest.approx(exact.ratio_sigma, rel=1e-3)
    for name in ("left_radius_m", "right_radius_m"):
        assert open_.sigmas[name] / getattr(TRUE, name) == pytest.approx(0.01, rel=0.02)
    assert open_.sigmas["track_width_m"] / TRUE.track_width_m == pytest.approx(np.hypot(0.01, 0.005), rel=0.02)
    assert open_.wheels.scale_sigma == pytest.approx(np.hypot(0.01, 0.003), rel=0.02)
    T = seen.truth.T_frame_body.copy()
    T[:, :3, 3] *= 1.01
    refitted = fit_wheels(NOMINAL, drive_of(seen), replace(seen.truth, T_frame_body=T)).wheels
    assert refitted.left_radius_m / exact.wheels.left_radius_m == pytest.approx(1.01, rel=1e-4)
