"""The covariance of dead reckoning: against numeric Jacobians, and against what really comes of noisy wheels."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from wheelsight.core.calibration_parts import Gyro, Wheels
from wheelsight.core.geometry import se2
from wheelsight.wheels import integrate_log
from wheelsight.wheels import odometry_kernels as kernels
from wheelsight.wheels import state_kernels as at
from wheelsight.wheels.odometry import Integration

SLIP = 0.02
WHEELS = Wheels(1 / (2 * math.pi), 1 / (2 * math.pi), 0.5, 1.0, slip_m_per_sqrt_m=SLIP)  # a tick is a metre
ALL: tuple[Integration, ...] = ("arc", "midpoint", "euler")
CODES = {"euler": kernels.EULER, "midpoint": kernels.MIDPOINT, "arc": kernels.ARC}
PERIOD_S = 0.05


def numeric_jacobian(f: Callable[[np.ndarray], np.ndarray], x: np.ndarray, h: float = 1e-6) -> np.ndarray:
    columns = [(f(x + h * e) - f(x - h * e)) / (2 * h) for e in np.eye(len(x))]
    return np.stack(columns, axis=-1)


def final(steps: np.ndarray, integration: Integration) -> tuple[np.ndarray, np.ndarray]:
    """T_odom_base (3, 3) and covariance (3, 3) after wheel travels (N, 2) in metres."""
    ways = np.concatenate([[[0.0, 0.0]], np.cumsum(steps, axis=0)])
    track = integrate_log(WHEELS, PERIOD_S * np.arange(len(ways)), *ways.T, integration=integration)
    assert not track.is_refused.any()
    return se2.from_parts(*track.poses[-1]), track.covariances[-1]


@pytest.mark.parametrize("integration", ALL)
@pytest.mark.parametrize("turn", [0.0, 1e-9, 1e-4, 0.0999, 0.199, 0.2001, -0.7, 2.5])
def test_derivatives_of_a_step_are_the_numeric_ones(integration: Integration, turn: float) -> None:
    def moved(step: np.ndarray) -> np.ndarray:
        state = np.zeros(at.STATE_SIZE)
        state[:3] = (0.4, -0.7, 0.6)
        kernels.move(state, CODES[integration], *step)
        return state[:3]

    state = np.zeros(at.STATE_SIZE)
    state[:3] = (0.4, -0.7, 0.6)
    along_way, along_turn = kernels.move(state, CODES[integration], 0.3, turn)
    J = numeric_jacobian(moved, np.array([0.3, turn]))
    np.testing.assert_allclose(np.transpose([along_way, along_turn]), J[:2], atol=1e-9)
    np.testing.assert_allclose(J[2], [0, 1], atol=1e-9)


@pytest.mark.parametrize("integration", ALL)
def test_the_covariance_is_that_of_first_order(integration: Integration, rng: np.random.Generator) -> None:
    steps = rng.uniform(-0.05, 0.15, (12, 2))
    T_odom_base, covariance = final(steps, integration)

    def perturbation(values: np.ndarray) -> np.ndarray:
        return se2.log(final(values.reshape(-1, 2), integration)[0] @ se2.invert(T_odom_base))

    J = numeric_jacobian(perturbation, steps.ravel())
    np.testing.assert_allclose(covariance, J @ np.diag(SLIP**2 * np.abs(steps.ravel())) @ J.T, rtol=1e-6, atol=1e-12)


FINE = replace(WHEELS, ticks_per_turn=1e6)  # of the same size, with counts that are no noise


def log_of(
    true: np.ndarray, gyro: Gyro, rng: np.random.Generator, slip: float = SLIP
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stamps, ticks (N, 2) and yaw rates of true travels (N, 2): of wheels that slip and a gyroscope as is stated."""
    noisy = true + rng.normal(0, slip * np.sqrt(np.abs(true)))
    bias = gyro.bias_sigma_rad_s * rng.standard_normal() + np.cumsum(
        gyro.bias_walk_rad_s_per_sqrt_s * math.sqrt(PERIOD_S) * rng.standard_normal(len(true))
    )
    noise = gyro.noise_rad_per_sqrt_s / math.sqrt(PERIOD_S) * rng.standard_normal(len(true))
    rates = np.concatenate([[np.nan], (true[:, 1] - true[:, 0]) / 0.5 / PERIOD_S + bias + noise])
    ways = np.concatenate([[[0.0, 0.0]], np.cumsum(noisy, axis=0)])
    return PERIOD_S * np.arange(len(ways)), ways / FINE.left_m_per_tick, rates


@pytest.mark.parametrize("bias_sigma_rad_s", [1e-3, 0.02, 0.5])
def test_on_the_spot_the_yaw_is_as_sure_as_all_that_was_reported_makes_it(bias_sigma_rad_s: float) -> None:
    """By closed form, of wheels W ~ N(θ, q) and a gyroscope G ~ N(θ + b T, g), b ~ N(0, σ²): of G - W all is seen."""
    gyro, sigmas = Gyro(0.004, 0.0, bias_sigma_rad_s, 0.0), []
    true = np.tile([-0.01, 0.01], (401, 1))
    for seed in range(20):
        stamps, ticks, rates = log_of(true, gyro, np.random.default_rng(seed))
        rates[-1] = np.nan  # which ends the stretch
        track = integrate_log(FINE, stamps[:-1], *ticks[:-1].T, yaw_rates_rad_s=rates[1:], gyro=gyro)
        sigmas.append(math.sqrt(track.covariances[-1][2, 2]))
    seconds = 400 * PERIOD_S
    q, g = 400 * 2 * SLIP**2 * 0.01 / 0.5**2, 0.004**2 * seconds
    expected = math.sqrt(q - q**2 / (q + g + (bias_sigma_rad_s * seconds) ** 2))
    # how noisy the wheels are is learned of the drive itself, to a tenth or two
    assert np.median(sigmas) == pytest.approx(expected, rel=0.15)


RUNS, STEPS = 1500, 400


def true_steps(rng: np.random.Generator) -> np.ndarray:
    """Wheel travels (STEPS, 2) of a drive through curves, forward and back."""
    t = np.arange(STEPS)
    speed, turn = 0.05 * np.sign(np.sin(t / 70 + 0.5)), 0.02 * np.sin(t / 23)
    return np.stack([speed - turn / 2, speed + turn / 2], axis=-1) + rng.uniform(-1e-3, 1e-3, (STEPS, 2))


def nees_of(errors: np.ndarray, covariances: np.ndarray) -> float:
    return float(np.einsum("ni,nij,nj->n", errors, np.linalg.inv(covariances), errors).mean())


def assert_consistent(nees: float) -> None:
    """Mean of RUNS normalised squared errors of three dimensions, within what chance allows in 99.9 % of cases."""
    low, high = chi2.ppf([5e-4, 1 - 5e-4], 3 * RUNS) / RUNS
    assert low < nees < high


@pytest.mark.parametrize("integration", ALL)
def test_errors_of_noisy_wheels_are_as_large_as_the_covariance_says(
    integration: Integration, rng: np.random.Generator
) -> None:
    true = true_steps(rng)
    T_true, _ = final(true, integration)
    errors, covariances = [], []
    for _ in range(RUNS):
        T, covariance = final(true + rng.normal(0, SLIP * np.sqrt(np.abs(true))), integration)
        errors.append(se2.log(T_true @ se2.invert(T)))
        covariances.append(covariance)
    assert_consistent(nees_of(np.array(errors), np.array(covariances)))


@pytest.mark.parametrize(
    ("standing_s", "bias_sigma_rad_s", "slip"),
    [(0.0, 0.003, SLIP), (3.0, 0.02, SLIP), (0.0, 0.02, SLIP), (0.0, 0.1, SLIP), (0.0, 0.02, SLIP / 4)],
)
def test_with_a_biased_gyroscope_too(
    standing_s: float, bias_sigma_rad_s: float, slip: float, rng: np.random.Generator
) -> None:
    """Of wheels as noisy as said or less so, after a rest or without. That ways are less noisy, too, no one shows."""
    gyro = Gyro(0.004, 0.0, bias_sigma_rad_s=bias_sigma_rad_s, bias_walk_rad_s_per_sqrt_s=1e-4)
    true = np.concatenate([np.zeros((round(standing_s / PERIOD_S), 2)), true_steps(rng)])
    T_true, _ = final(true, "arc")
    errors, covariances = [], []
    for _ in range(RUNS // 3):
        stamps, ticks, rates = log_of(true, gyro, rng, slip)
        track = integrate_log(FINE, stamps, *ticks.T, yaw_rates_rad_s=rates, gyro=gyro)
        errors.append(se2.log(T_true @ se2.invert(se2.from_parts(*track.poses[-1]))))
        covariances.append(track.covariances[-1])
    of_all = nees_of(np.array(errors), np.array(covariances)) / 3
    of_yaw = float(np.mean(np.square(errors)[:, 2] / np.array(covariances)[:, 2, 2]))
    assert 0.6 < of_all < 1.35  # by chance within 0.88 and 1.13, of noise that need not be learned
    assert 0.8 < of_yaw < 1.55


def test_standing_still_adds_nothing() -> None:
    track = integrate_log(
        WHEELS, np.arange(0, 10, 0.1), np.zeros(100), np.zeros(100), yaw_rates_rad_s=np.full(100, 0.3)
    )
    np.testing.assert_array_equal(track.poses, np.zeros((100, 3)))
    np.testing.assert_array_equal(track.covariances, np.zeros((100, 3, 3)))


def test_a_straight_metre_is_as_uncertain_as_the_slip_says() -> None:
    _, covariance = final(np.full((20, 2), 0.05), "arc")
    assert covariance[0, 0] == pytest.approx(SLIP**2 / 2)
    assert covariance[2, 2] == pytest.approx(2 * SLIP**2 / 0.5**2)
