"""ErrorStateFilter over many drives: whether its covariances are those of its errors (Bar-Shalom et al. 2001, 5.4)."""

from __future__ import annotations

import gc
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from fusion.error_state.fused_drives import T_BASE_CAMERA, Drive, blind, error_of, run, simulate
from narrowing import not_none
from scipy.stats import chi2

from wheelsight.core.calibration_parts import Gyro
from wheelsight.estimation import ErrorStateFilter
from wheelsight.estimation.pose_belief import FilterParameters

# Gates off and no pull to level: what is left is a plain Kalman filter, whose NEES and NIS are χ².
PLAIN = replace(FilterParameters.of(), level_sigma_rad=None, confidence=1 - 1e-9, clock_sigma_s=0.0)
RUNS = 100
ALONG = np.array([[0.0, 0, 1, 0, 0, 0]])
FAULTS = {
    "every measurement": lambda t, motion: motion,
    "corridor": lambda t, motion: replace(motion, degenerate=ALONG),
    "coasting": lambda t, motion: motion if t < 3 else blind(motion),
}


def errors_of_wheels(rng, settings):
    return tuple(rng.normal(size=3) * [settings.scale_sigma, settings.drift_sigma_rad_per_m, settings.turn_sigma])


def errors_of_camera(rng, settings):
    s = settings
    drift, mount = s.camera_drift_sigma_rad_per_m, [*[s.mount_sigma_m] * 2, *[s.mount_sigma_rad] * 3]
    return tuple(rng.normal(size=9) * [s.camera_scale_sigma, drift, s.camera_turn_sigma, drift, *mount])


def bounds(degrees, runs, probability=0.99):
    return chi2.ppf([(1 - probability) / 2, (1 + probability) / 2], degrees * runs) / runs


def within(mean, degrees, runs):
    low, high = bounds(degrees, runs)
    return low < mean < high


@pytest.mark.slow
@pytest.mark.parametrize("kind", FAULTS)
def test_nees_and_nis_are_chi_squared(kind):
    nees, nis = [], []
    for seed in range(RUNS):
        rng = np.random.default_rng(seed)
        wrong = errors_of_wheels(rng, PLAIN), errors_of_camera(rng, PLAIN), rng.normal() * PLAIN.camera_lag_sigma_s
        drive = Drive(5.0, 0.1, 2, 0.8, *wrong, 0.01, camera_fault=FAULTS[kind])
        steps = simulate(drive, rng, PLAIN)
        answers = run(steps, PLAIN)
        off = error_of(answers[-1], steps[-1].T_truth)
        nees.append(off @ np.linalg.solve(not_none(answers[-1].covariance), off))
        nis += [a.nis[0] for a in answers if a.nis is not None]
    degrees = 5 if kind == "corridor" else 6
    assert within(np.mean(nees), 6, RUNS)
    # What lag and twist do together is counted at both ends of a measurement, so measurements seem a little too good.
    assert 0.95 * degrees < np.mean(nis) < bounds(degrees, len(nis))[1]


@pytest.mark.slow
def test_nis_of_gyroscope_and_places_are_chi_squared():
    of_gyro, of_places = [], []
    for seed in range(RUNS):
        rng = np.random.default_rng(seed)
        fusion = ErrorStateFilter(settings=PLAIN)
        bias = rng.normal() * Gyro().bias_sigma_rad_s
        drive = Drive(3.0, 0.1, 99, 0.8, errors_of_wheels(rng, PLAIN), slip_m_per_sqrt_m=0.01)
        for i, step in enumerate(simulate(drive, rng, PLAIN)):
            fusion.predict(step.end_s, step.wheels, step.wheel_covariance, step.begin_s)
            rate = drive.twist(step.begin_s + 0.05)[2] + bias + rng.normal() * Gyro().noise_rad_per_sqrt_s / 0.1**0.5
            answer = fusion.update_yaw_rate(step.end_s, rate)
            of_gyro += [answer.nis[0]] if answer.nis else []
            if i % 10 == 9:
                place = step.T_truth[:2, 3] + rng.normal(size=2) * 0.05
                of_places.append(not_none(fusion.update_position(step.end_s, place, 0.05**2 * np.eye(2)).nis)[0])
    assert within(np.mean(of_gyro), 1, len(of_gyro))
    assert within(np.mean(of_places), 2, len(of_places))


def test_what_is_held_does_not_grow(rng):
    """The time of an event is measured by `benchmarks.joined_hour`."""
    steps = simulate(Drive(seconds=40.0), rng, PLAIN)
    follow(ErrorStateFilter(T_BASE_CAMERA), steps)  # loads kernels: some are called first in the middle of the drive
    fusion, held = ErrorStateFilter(T_BASE_CAMERA), []
    tracemalloc.start()
    for part in np.array_split(np.arange(len(steps)), 8):
        follow(fusion, [steps[i] for i in part])
        gc.collect()
        held.append(tracemalloc.get_traced_memory()[0])
    tracemalloc.stop()
    assert held[-1] - held[4] < 50_000  # until then its windows, of up to 21 s, fill


def follow(fusion, steps):
    fusion.clone(steps[0].begin_s, "frame")
    for step in steps:
        fusion.predict(step.end_s, step.wheels, step.wheel_covariance, step.begin_s)
        fusion.update_relative(step.end_s, step.measurement, "frame")
        fusion.clone(step.end_s, "frame")
