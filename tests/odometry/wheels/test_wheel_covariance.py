"""The covariance of dead reckoning: against numeric Jacobians, and against what really comes of noisy wheels."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.stats import chi2

from wheelsight.calibration import Gyro, Wheels
from wheelsight.geometry import se2
from wheelsight.odometry.wheels import _kernels as kernels
from wheelsight.odometry.wheels import integrate_log
from wheelsight.odometry.wheels.odometry import Integration

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
        state = np.zeros(kernels.STATE_SIZE)
        state[:3] = (0.4, -0.7, 0.6)
        kernels.move(state, CODES[integration], *step)
        return state[:3]

    state = np.zeros(kernels.STATE_SIZE)
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


def test_the_covariance_with_a_gyroscope_is_that_of_first_order(rng: np.random.Generator) -> None:
    """For noise of rates and bias; the weights, which go by the wheels' ways, are kept."""
    gyro = Gyro(0.01, 0.02, bias_sigma_rad_s=0.005, bias_walk_rad_s_per_sqrt_s=0.0)
    ways = np.concatenate([[[0.0, 0.0]], np.cumsum(rng.uniform(0.02, 0.15, (12, 2)), axis=0)])
    stamps, rates = PERIOD_S * np.arange(13), rng.normal(0, 0.5, 13)

    def pose(values: np.ndarray) -> np.ndarray:
        biased = Gyro(0.01, 0.02 + values[-1], 0.005, 0.0)
        given = np.concatenate([rates[:1], rates[1:] + values[:-1]])
        track = integrate_log(WHEELS, stamps, *ways.T, yaw_rates_rad_s=given, gyro=biased)
        return se2.from_parts(*track.poses[-1])

    T = pose(np.zeros(13))
    J = numeric_jacobian(lambda values: se2.log(pose(values) @ se2.invert(T)), np.zeros(13))
    of_gyro = J @ np.diag([*[0.01**2 / PERIOD_S] * 12, 0.005**2]) @ J.T
    total = integrate_log(WHEELS, stamps, *ways.T, yaw_rates_rad_s=rates, gyro=gyro).covariances[-1]
    of_wheels = total - of_gyro
    assert np.linalg.eigvalsh(of_wheels).min() > -1e-12
    # what remains is that of the wheels' noise, through the same weights
    G = _wheel_jacobian(ways, stamps, rates, gyro)
    variances = SLIP**2 * np.abs(np.diff(ways, axis=0)).ravel()
    np.testing.assert_allclose(of_wheels, G @ np.diag(variances) @ G.T, rtol=1e-5, atol=1e-10)


def _wheel_jacobian(ways: np.ndarray, stamps: np.ndarray, rates: np.ndarray, gyro: Gyro) -> np.ndarray:
    """(3, 2 N) by the wheels' travels, the gains held at those of the true travels: a plain Kalman update a step."""
    steps, dt = np.diff(ways, axis=0), np.diff(stamps)

    def pose(values: np.ndarray) -> np.ndarray:
        T = np.eye(3)
        for step, noisy, rate, seconds in zip(steps, values.reshape(-1, 2), rates[1:], dt, strict=True):
            H = np.array([[0.5, 0.5], [-1 / 0.5, 1 / 0.5]])
            P = H @ np.diag(SLIP**2 * np.abs(step)) @ H.T
            variance = P[1, 1] + gyro.noise_rad_per_sqrt_s**2 * seconds + (gyro.bias_sigma_rad_s * seconds) ** 2
            u = H @ noisy
            u[1] += P[1, 1] / variance * ((rate - gyro.bias_rad_s) * seconds - u[1])
            T = T @ se2.exp([u[0], 0, u[1]])
        return T

    T = pose(steps.ravel())
    return numeric_jacobian(lambda values: se2.log(pose(values) @ se2.invert(T)), steps.ravel())


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


@pytest.mark.parametrize(("standing_s", "bias_sigma_rad_s"), [(0.0, 0.003), (3.0, 0.02)])
def test_with_a_biased_gyroscope_too(standing_s: float, bias_sigma_rad_s: float, rng: np.random.Generator) -> None:
    """As long as the yaw is known to a tenth of a radian: beyond that, first order is not enough."""
    gyro = Gyro(0.004, 0.0, bias_sigma_rad_s=bias_sigma_rad_s, bias_walk_rad_s_per_sqrt_s=1e-4)
    standing = round(standing_s / PERIOD_S)
    true = np.concatenate([np.zeros((standing, 2)), true_steps(rng)])
    T_true, _ = final(true, "arc")
    stamps, yaw_steps = PERIOD_S * np.arange(len(true) + 1), (true[:, 1] - true[:, 0]) / 0.5
    errors, covariances = [], []
    for _ in range(RUNS):
        noisy = true + rng.normal(0, SLIP * np.sqrt(np.abs(true)))
        walk = np.cumsum(rng.normal(0, 1e-4 * math.sqrt(PERIOD_S), len(true)))
        noise = rng.normal(0, 0.004 / math.sqrt(PERIOD_S), len(true))
        rates = yaw_steps / PERIOD_S + rng.normal(0, bias_sigma_rad_s) + walk + noise
        ways = np.concatenate([[[0.0, 0.0]], np.cumsum(noisy, axis=0)])
        given = np.concatenate([[np.nan], rates])
        track = integrate_log(WHEELS, stamps, *ways.T, yaw_rates_rad_s=given, gyro=gyro)
        errors.append(se2.log(T_true @ se2.invert(se2.from_parts(*track.poses[-1]))))
        covariances.append(track.covariances[-1])
    assert_consistent(nees_of(np.array(errors), np.array(covariances)))


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
