"""What errors of a camera's points make of motions, against motions that are known and fits that are made again."""

from __future__ import annotations

import numpy as np
import pytest

from wheelsight.core.calibration import Calibration
from wheelsight.core.camera_errors import errors_of, place_errors
from wheelsight.core.depth_errors import NOMINAL_ERRORS, PointErrors, mode_of
from wheelsight.core.geometry import FloatArray, PinholeCamera, se2, se3
from wheelsight_calibration.motion_errors import motion_errors, typical_motion_errors, with_error
from wheelsight_sim import RobotModel

CAMERA = PinholeCamera(320, 240, 262.5, 262.5, 159.5, 119.5)
MOUNT = RobotModel(camera_pitch_rad=0.3, camera_yaw_rad=0.2, camera_forward_m=0.25).T_base_camera


@pytest.fixture
def points_m(rng: np.random.Generator) -> FloatArray:
    rays = rng.uniform((-0.6, -0.45, 1.0), (0.6, 0.45, 1.0), (500, 3))
    return rays * rng.uniform(0.7, 4.0, (500, 1))


def known(points_m: FloatArray, moved_m: FloatArray, **others: FloatArray) -> Calibration:
    errors = PointErrors((tuple(mode_of(points_m, moved_m).tolist()),))
    return Calibration.registered_camera(CAMERA, point_errors=errors, **others)


def test_a_scale_makes_ways_longer_and_leaves_turns(points_m: FloatArray) -> None:
    calibration = known(points_m, 0.01 * points_m)
    level = se3.from_parts(MOUNT[:3, :3], np.zeros(3))
    np.testing.assert_allclose(
        motion_errors(calibration, level, points_m)[0], np.diag([0.01, 0.01, 0.0]), rtol=0, atol=1e-6
    )
    # A base that turns moves the camera aside, by a way that seems longer too.
    off = motion_errors(calibration, MOUNT, points_m)[0]
    np.testing.assert_allclose(np.diag(off), [0.01, 0.01, 0.0], atol=1e-6)
    np.testing.assert_allclose(off[:2, 2], 0.01 * np.array([-MOUNT[1, 3], MOUNT[0, 3]]), atol=1e-6)


def test_a_camera_that_looks_aside_is_another_mount(points_m: FloatArray) -> None:
    """All motions are then those of a body that is turned and shifted: in the plane the adjoint's derivative."""
    turn_rad, level = np.array([0.0, 0.004, 0.0]), se3.from_parts(MOUNT[:3, :3], np.zeros(3))
    calibration = known(points_m, np.cross(turn_rad, points_m))
    turned_base = MOUNT[:3, :3] @ turn_rad
    off = motion_errors(calibration, level, points_m)[0]
    np.testing.assert_allclose(off[:2, :2], turned_base[2] * np.array([[0, -1], [1, 0]]), atol=1e-6)
    assert off[2, 2] == pytest.approx(0, abs=1e-6)


def test_a_small_motion_is_found_as_a_fit_to_moved_points_finds_it(points_m: FloatArray) -> None:
    """Every nominal error by itself: a rigid motion is fitted to points that are moved before and after."""
    level, twist = se3.from_parts(MOUNT[:3, :3], np.zeros(3)), np.array([0.01, 0.004, 0.02])
    motion_base = se3.exp([twist[0], twist[1], 0, 0, 0, twist[2]])
    T_before_after = se3.invert(level) @ motion_base @ level
    after_m = se3.apply(se3.invert(T_before_after), points_m)
    for mode in NOMINAL_ERRORS.modes:
        some = PointErrors((tuple(0.1 * c for c in mode),))
        calibration = Calibration.registered_camera(CAMERA, point_errors=some)
        seen = [points + some.moved_m(points)[0] for points in (points_m, after_m)]
        fitted = level @ _rigid(seen[1], seen[0], 1 / points_m[:, 2]) @ se3.invert(level)
        off = (se3.log(fitted) - se3.log(motion_base))[[0, 1, 5]]
        stated = motion_errors(calibration, level, points_m)[0] @ twist
        np.testing.assert_allclose(stated, off, atol=0.05 * np.abs(off).max() + 1e-6)


def test_two_views_of_one_place_err_alike_and_a_scale_makes_the_way_between_others_longer(points_m: FloatArray) -> None:
    calibration = known(points_m, 0.01 * points_m)
    T_first_second = se3.exp([0.3, -0.1, 0.2, 0.05, 0.4, -0.1])
    np.testing.assert_allclose(place_errors(calibration, np.eye(4), points_m), np.zeros((1, 6)), atol=1e-12)
    off = place_errors(calibration, T_first_second, points_m + [0, 0, 1.0])
    np.testing.assert_allclose(off, [[*(0.01 * T_first_second[:3, 3]), 0, 0, 0]], atol=1e-6)
    exact = Calibration.registered_camera(CAMERA, point_errors=PointErrors())
    assert place_errors(exact, T_first_second, points_m).shape == (0, 6)


def test_a_place_is_found_as_a_fit_to_what_both_views_show_finds_it(points_m: FloatArray) -> None:
    """Every nominal error by itself, of views half a metre and 0.3 rad apart."""
    first_m = points_m + [0, 0, 0.8]
    T_first_second = se3.exp([0.2, 0.1, 0.4, 0.05, 0.3, -0.05])
    second_m = se3.apply(se3.invert(T_first_second), first_m)
    stated = place_errors(Calibration.registered_camera(CAMERA), T_first_second, first_m)
    for mode, expected in zip(NOMINAL_ERRORS.modes, stated, strict=True):
        some = PointErrors((tuple(0.1 * c for c in mode),))
        seen = [points + some.moved_m(points)[0] for points in (second_m, first_m)]
        fitted = _rigid(seen[0], seen[1], 1 / first_m[:, 2])
        off = 10 * se3.log(fitted @ se3.invert(T_first_second))
        np.testing.assert_allclose(expected, off, atol=0.05 * np.abs(off).max() + 1e-6)


def _rigid(a: FloatArray, b: FloatArray, weights: FloatArray) -> FloatArray:
    """T (4, 4) by weighted least squares with b = T a (Umeyama 1991, without scale)."""
    share = weights / weights.sum()
    middles = share @ a, share @ b
    U, _, Vt = np.linalg.svd((share[:, None] * (b - middles[1])).T @ (a - middles[0]))
    R = U @ np.diag([1, 1, np.linalg.det(U @ Vt)]) @ Vt
    return se3.from_parts(R, middles[1] - R @ middles[0])


def test_motions_are_changed_by_their_own_share(rng: np.random.Generator) -> None:
    motions = rng.uniform(-1, 1, (20, 3))
    np.testing.assert_allclose(with_error(motions, np.zeros((3, 3))), motions, atol=1e-12)
    longer = with_error(motions, np.diag([0.1, 0.1, 0.0]))
    np.testing.assert_allclose(longer, motions * [1.1, 1.1, 1.0], atol=1e-12)
    turned = se2.to_parts(se2.exp(1.1 * se2.log(se2.from_parts(*motions.T))))
    np.testing.assert_allclose(with_error(motions, 0.1 * np.eye(3)), np.stack(turned, axis=-1), atol=1e-12)


def test_who_does_not_say_has_nominal_errors() -> None:
    silent = Calibration.registered_camera(CAMERA, T_base_camera=MOUNT)
    exact = Calibration.registered_camera(CAMERA, T_base_camera=MOUNT, point_errors=PointErrors())
    assert errors_of(silent) is NOMINAL_ERRORS
    assert typical_motion_errors(exact).shape == (0, 3, 3)
    of_way = np.sqrt((typical_motion_errors(silent)[:, 0, 0] ** 2).sum())
    assert 0.01 < of_way < 0.04
