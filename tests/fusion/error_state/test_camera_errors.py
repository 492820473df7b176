"""What is wrong with a camera alike in all its motions: how it adds up, that it is learned, and else covered."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise, product
from typing import Any

import numpy as np
import pytest
from fusion.error_state.fused_drives import T_BASE_CAMERA, Drive, Step, by_ratios, error_of, looked, run, simulate
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from narrowing import not_none

from wheelsight.core.calibration_parts import Gyro
from wheelsight.core.estimates import Reason
from wheelsight.core.geometry import motion_kernels as motions
from wheelsight.core.geometry import se3
from wheelsight.estimation import ErrorStateFilter
from wheelsight.estimation import filter_kernels as relative
from wheelsight.estimation.pose_belief import CAMERA_ERRORS, FilterParameters, PoseBelief, WheelStep

SETTINGS = FilterParameters.of()
_STEPS = 2000
# A camera whose focal length is hardly known.
COARSE: dict[str, Any] = {"camera_turn_walk": 0.0005}
tangents = st.lists(st.floats(-1.2, 1.2), min_size=6, max_size=6).map(np.array)


def travelled(
    xi: np.ndarray, scale: float = 0.0, drift_rad_per_m: float = 0.0, turn: float = 0.0, pitch_rad_per_m: float = 0.0
) -> np.ndarray:
    """exp(ξ) in many steps, each wrong by so much."""
    step = xi / _STEPS
    way_m = np.linalg.norm(step[:3])
    step[:3] *= 1 + scale
    step[4] += pitch_rad_per_m * way_m
    step[5] = step[5] * (1 + turn) + drift_rad_per_m * way_m
    return np.linalg.matrix_power(se3.exp(step), _STEPS)


def of_camera(fusion: ErrorStateFilter) -> tuple[np.ndarray, np.ndarray]:
    """The camera's errors (9,) as the filter has them, and their standard deviations."""
    belief = fusion.state.detection.primary
    return belief.aux[CAMERA_ERRORS], np.sqrt(np.diag(belief.covariance)[belief.aux_slice(CAMERA_ERRORS)])


def turned(before: Step, step: Step) -> float:
    """The true yaw rate of a step, as a gyroscope has it."""
    return float(motions.log(se3.invert(before.T_truth) @ step.T_truth)[5]) / (step.end_s - step.begin_s)


def missed(error: str, xi: np.ndarray) -> np.ndarray:
    """Left perturbation (6,) of a motion, a unit of an error, by the numbers."""
    h = 1e-5
    return se3.log(travelled(xi.copy(), **{error: h}) @ se3.invert(travelled(xi.copy(), **{error: -h}))) / (2 * h)


def driven(T_reference: np.ndarray, xi: np.ndarray, steps: int = 200) -> PoseBelief:
    """A belief after the wheels' steps along exp(ξ) from a remembered pose."""
    belief = PoseBelief.begin(T_reference, 1e-6 * np.eye(6), SETTINGS).cloned("reference", 0.0, 4)
    for k in range(steps):
        step = WheelStep(0.1 * k, 0.1 * (k + 1), xi / steps, 1e-9 * np.eye(6))
        belief = belief.moved_by_wheels(step, 1.0, replace(SETTINGS, level_sigma_rad=None), is_slipping=False)
    return belief


STRAIGHT, ASIDE, BENT = [0.5, 0, 0, 0, 0, 0], [0.3, -0.4, 0, 0, 0, 0], [0.5, 0.02, 0, 0, 0, 0.3]


# A pitch a metre is reported motions that hardly bend.
WAYS = [*product((STRAIGHT, ASIDE, BENT), (0, 1, 2)), (STRAIGHT, 3), (ASIDE, 3), ([0.5, 0.02, 0, 0, 0, 0.02], 3)]


@pytest.mark.parametrize(("xi", "column"), WAYS)
def test_errors_add_up_as_steps_do(rng: np.random.Generator, xi: list[float], column: int) -> None:
    error = ("scale", "drift_rad_per_m", "turn", "pitch_rad_per_m")[column]
    belief = driven(se3.exp(rng.standard_normal(6)), np.array(xi))
    B = relative.expected(*belief.since(1))[1]
    ahead = xi[0] / np.hypot(xi[0], xi[1]) if column == 1 else 1.0  # a drift counts by the way ahead
    np.testing.assert_allclose(B[:, column], ahead * missed(error, np.array(xi)), atol=6e-3)


@pytest.mark.parametrize("xi", [[0.3, -0.4, 0.1, 0, 0, 0], [0.5, 0.02, 0, 0, 0, 0.02]])
@pytest.mark.parametrize("column", [0, 1, 2])
def test_the_simulators_errors_add_up_as_steps_do(xi: list[float], column: int) -> None:
    error = ("scale", "drift_rad_per_m", "turn")[column]
    np.testing.assert_allclose(by_ratios(se3.exp(xi))[:, column], missed(error, np.array(xi)), atol=6e-3)


@given(tangents)
def test_a_camera_that_is_mounted_otherwise_sees_the_motion_turned(by: np.ndarray) -> None:
    h = 1e-6
    B = relative.by_camera_errors(se3.exp(by), np.zeros((6, 3)))
    for column, axis in enumerate((0, 1, 3, 4, 5), start=4):
        mount = se3.exp(h * np.eye(6)[axis])
        true = mount @ se3.exp(by) @ se3.invert(mount)
        np.testing.assert_allclose(B[:, column], se3.log(true @ se3.invert(se3.exp(by))) / h, atol=1e-4)


def test_a_turn_on_the_spot_is_wrong_by_its_ratio_alone() -> None:
    B = relative.expected(*driven(np.eye(4), np.array([0, 0, 0, 0, 0, 0.8])).since(1))[1]
    np.testing.assert_allclose(B[:, 2], [0, 0, 0, 0, 0, 0.8], atol=1e-9)
    np.testing.assert_allclose(B[:, :2], 0, atol=1e-12)


@hypothesis_settings(max_examples=30)
@given(tangents, tangents, st.lists(st.floats(-1e-4, 1e-4), min_size=9, max_size=9).map(np.array))
def test_a_motion_that_misses_what_is_known_to_be_missed_is_as_expected(
    reference: np.ndarray, by: np.ndarray, errors: np.ndarray
) -> None:
    T_reference = se3.exp(reference)
    reported = se3.adjoint(T_reference) @ by_ratios(se3.exp(by))
    since = T_reference @ se3.exp(by), T_reference, reported
    seen = se3.exp(-relative.expected(*since)[1] @ errors) @ se3.exp(by)
    np.testing.assert_allclose(relative.residual_kernel(*since, seen, errors), 0, atol=1e-9)
    assert np.abs(relative.residual_kernel(*since, seen, np.zeros(9))).max() <= 3e-3


@pytest.mark.slow
def test_what_wheels_and_camera_err_by_alike_is_not_learned_from_noise() -> None:
    """Nobody sees it, so nothing may move it: what noise taught of it would go one way, and never be mended."""
    still: dict[str, Any] = dict.fromkeys(("scale_walk", "turn_walk", "camera_scale_walk", "camera_turn_walk"), 0.0)
    settings, learned = replace(SETTINGS, **still), []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        fusion = ErrorStateFilter(T_BASE_CAMERA, settings=settings)
        run(simulate(Drive(seconds=30), rng, settings), fusion=fusion)
        learned.append(of_camera(fusion)[0][[0, 2]])
    assert np.abs(learned).max() < SETTINGS.camera_scale_sigma / 2
    assert (np.abs(np.mean(learned, axis=0)) < 4 * np.std(learned, axis=0) / np.sqrt(len(learned))).all()


def test_wheels_that_are_known_well_tell_what_is_wrong_with_the_camera(rng: np.random.Generator) -> None:
    sure: dict[str, Any] = {"scale_sigma": 1e-4, "drift_sigma_rad_per_m": 1e-5, "turn_sigma": 1e-4}
    still: dict[str, Any] = dict.fromkeys(("scale_walk", "drift_walk_rad_per_m", "turn_walk"), 0.0)
    settings = replace(SETTINGS, **{**sure, **still, **COARSE})
    wrong = (0.01, 0.0, -0.01)
    steps = simulate(Drive(seconds=30, camera_errors=wrong, slip_m_per_sqrt_m=0.001), rng, settings)
    fusion = ErrorStateFilter(T_BASE_CAMERA, settings=settings)
    run(steps, fusion=fusion)
    learned, sigma = of_camera(fusion)
    assert learned[0] == pytest.approx(0.01, abs=0.003)
    assert (np.abs(learned[:3] - wrong) < 3 * sigma[:3]).all()
    assert sigma[0] < 0.5 * SETTINGS.camera_scale_sigma
    assert sigma[2] < 0.8 * settings.camera_turn_sigma


def test_a_gyroscope_shows_that_the_cameras_turns_are_too_small(rng: np.random.Generator) -> None:
    steps = simulate(Drive(seconds=30, camera_errors=(0.0, 0.0, 0.015)), rng, SETTINGS)
    steps = [replace(step, yaw_rate_rad_s=turned(before, step)) for before, step in pairwise(steps)]
    settings = replace(SETTINGS, **COARSE)
    fusion = ErrorStateFilter(T_BASE_CAMERA, settings=settings, gyro=Gyro(bias_sigma_rad_s=1e-4))
    run(steps, fusion=fusion)
    learned, sigma = of_camera(fusion)
    assert learned[2] == pytest.approx(0.015, abs=0.006)
    assert sigma[2] < 0.5 * settings.camera_turn_sigma


SHIFT = slice(4, 6)


def turning(shift_m: tuple[float, float], slide_m_s: float = 0.0) -> list[Step]:
    """A drive with a camera that sits so far ahead and aside of where it is said to; and ice on the way."""

    def ice(t: float, truth: np.ndarray, wheels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        aside = np.array([0.0, slide_m_s * 0.05 if 3.0 < t < 4.0 else 0.0, 0, 0, 0, 0])
        return truth + aside, wheels

    drive = Drive(40.0, 0.05, 5, camera_errors=(0, 0, 0, 0, *shift_m), wheel_fault=ice)
    return simulate(drive, np.random.default_rng(3), SETTINGS)


@pytest.mark.parametrize("shift_m", [(0.01, -0.008), (-0.012, 0.0)])
def test_where_a_camera_sits_is_learned_from_turns(shift_m: tuple[float, float]) -> None:
    fusion = ErrorStateFilter(T_BASE_CAMERA)
    run(turning(shift_m), fusion=fusion)
    learned, sigma = of_camera(fusion)
    assert (np.abs(learned[SHIFT] - shift_m) < 3 * sigma[SHIFT]).all()
    assert (sigma[SHIFT] < 0.6 * SETTINGS.mount_sigma_m).all()
    assert np.linalg.norm(learned[SHIFT] - shift_m) < 0.5 * np.linalg.norm(shift_m)


def test_a_base_that_slides_aside_moves_the_camera_by_less_than_a_ruler_errs() -> None:
    """A turn about a point before the wheels looks like a camera that sits farther back."""
    steps, shifts = turning((0.0, 0.0), slide_m_s=0.4), []
    for count in (60, 160):  # until it slides, and four seconds later
        fusion = ErrorStateFilter(T_BASE_CAMERA)
        answers = run(steps[:count], fusion=fusion)
        shifts.append(of_camera(fusion)[0][SHIFT])
    assert any(answer.doubtful for answer in answers)
    np.testing.assert_allclose(shifts[0], shifts[1], atol=SETTINGS.mount_sigma_m)


def test_what_no_one_shows_a_camera_is_covered() -> None:
    """Wheels and camera are both too short, by twice the camera's standard deviation: no event shows."""
    drive = Drive(seconds=40, camera_errors=(0.01, 0.0, 0.0), errors=(0.01, 0.0, 0.0))
    steps = simulate(drive, np.random.default_rng(1), SETTINGS)
    none: dict[str, Any] = dict.fromkeys(
        (name for name in vars(SETTINGS) if name.startswith(("camera_", "mount_"))), 0.0
    )
    knowing, trusting = (run(steps, settings)[-1] for settings in (SETTINGS, replace(SETTINGS, **none)))
    error = error_of(knowing, steps[-1].T_truth)
    sigma, too_sure = (np.sqrt(not_none(answer.covariance)[0, 0]) for answer in (knowing, trusting))
    assert 0.15 < abs(error[0]) < 3 * sigma
    way_m = steps[-1].T_truth[0, 3]
    assert np.sqrt(sigma**2 - too_sure**2) > 0.8 * SETTINGS.camera_scale_sigma * way_m


def cloned(covariance: np.ndarray | None) -> ErrorStateFilter:
    """A pose on the way, remembered, of a camera whose stamps are in time."""
    fusion = ErrorStateFilter(T_BASE_CAMERA, settings=replace(SETTINGS, camera_lag_sigma_s=0.0))
    fusion.predict(0.1, se3.from_plane(0.05, 0.0, 0.02), 1e-6 * np.eye(6), 0.0)
    fusion.clone(0.1, "anchor", covariance)
    return fusion


def test_a_remembered_pose_may_be_elsewhere_to_the_camera(rng: np.random.Generator) -> None:
    """The covariance is of the camera's left perturbation in its own frame, which `expect` gives back as it is."""
    A = 1e-2 * rng.standard_normal((6, 6))
    C = A @ A.T
    T, found = not_none(cloned(C).expect(0.1, "anchor"))
    np.testing.assert_allclose(T, np.eye(4), atol=1e-12)
    np.testing.assert_allclose(found, C, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(not_none(cloned(None).expect(0.1, "anchor"))[1], 0, atol=1e-12)


def test_looks_against_one_remembered_pose_share_its_error(rng: np.random.Generator) -> None:
    spread = np.diag(np.square([0.01] * 3 + [0.001] * 3))
    sigmas = {}
    for name, covariance in (("shared", spread), ("none", None)):
        fusion = cloned(covariance)
        fusion.predict(0.2, np.eye(4), 1e-2 * np.eye(6), 0.1)
        for _ in range(30):
            answer = fusion.update_relative(0.2, looked(rng, np.eye(4), 1e-6 * np.eye(6)), "anchor")
        sigmas[name] = np.sqrt(not_none(answer.covariance)[:3, :3].diagonal())
    assert (
        sigmas["shared"] > 0.0095
    ).all()  # thirty measurements would make a tenth of a millimetre of their own error
    assert (sigmas["none"] < 0.003).all()


@pytest.mark.parametrize("wrong", [np.full((6, 6), np.nan), -np.eye(6), np.eye(5)], ids=["NaN", "negative", "shape"])
def test_a_covariance_that_is_none_is_refused_and_nothing_is_remembered(wrong: np.ndarray) -> None:
    fusion = ErrorStateFilter(T_BASE_CAMERA)
    fusion.predict(0.1, np.eye(4), 1e-6 * np.eye(6), 0.0)
    assert fusion.clone(0.1, "anchor", wrong).reason is Reason.INVALID
    assert fusion.expect(0.1, "anchor") is None
