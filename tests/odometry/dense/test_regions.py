"""Regions that move by themselves are found and left out; a wrong pose moves all of them, and none is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from odometry.dense.scenes import EXACT, SMALL, Bench, apart, bench
from odometry.views import room_frame

from wheelsight.core.calibration_parts import DepthNoise
from wheelsight.core.geometry import BoolArray, FloatArray, se3
from wheelsight.core.messages import RgbdFrame
from wheelsight.core.threads import Stopwatch
from wheelsight.vision.dense.settings import DenseSettings
from wheelsight.vision.dense.tracking import (
    REGION_COLUMNS,
    REGION_ROWS,
    Locator,
    Misfits,
    ViewCache,
    misfits,
    without,
)

MOTION = se3.exp([0.02, -0.01, 0.03, 0.004, 0.01, -0.006])
# Columns of the image that a person hides: two of eight regions' width.
HIDDEN = slice(80, 160)


@pytest.fixture(scope="module")
def parts() -> Bench:
    return bench()


def with_person(frame: RgbdFrame, depth_m: float, seed: int) -> RgbdFrame:
    """A frame before which somebody stands, upright at one depth, in a striped shirt that moves along."""
    depth, color = frame.depth_m.copy(), frame.color.copy()
    depth[:, HIDDEN] = np.float32(depth_m)
    stripes = np.random.default_rng(seed).integers(0, 255, (SMALL.height // 8, 10), np.uint8)
    color[:, HIDDEN] = np.kron(stripes, np.ones((8, 8), np.uint8))[..., None]
    return replace(frame, depth_m=depth, color=color)


def seen(T: FloatArray, stamp_s: float, person_m: float | None = None) -> RgbdFrame:
    frame = room_frame(T, stamp_s, SMALL, depth_noise=True)
    return frame if person_m is None else with_person(frame, person_m, seed=3)


def misfits_of(parts: Bench, first: RgbdFrame, second: RgbdFrame, T: FloatArray) -> Misfits:
    return misfits(parts.grid(second), parts.reference(first), T, DepthNoise())


def moving(parts: Bench, first: RgbdFrame, second: RgbdFrame, T: FloatArray) -> BoolArray:
    return misfits_of(parts, first, second, T).moving


def test_who_comes_nearer_moves_and_the_room_does_not(parts: Bench) -> None:
    moves = moving(parts, seen(np.eye(4), 0.0, 1.0), seen(MOTION, 0.1, 0.85), MOTION)
    assert moves[:, 2:4].mean() > 0.9
    assert not moves[:, [0, 1, 5, 6, 7]].any()


def test_a_room_that_stands_still_has_no_moving_region(parts: Bench) -> None:
    assert not moving(parts, seen(np.eye(4), 0.0), seen(MOTION, 0.1), MOTION).any()


def test_at_a_wrong_pose_all_would_move_so_none_does(parts: Bench) -> None:
    wrong = se3.exp([0.0, 0.0, 0.3, 0.0, 0.0, 0.0]) @ MOTION
    assert not moving(parts, seen(np.eye(4), 0.0), seen(MOTION, 0.1), wrong).any()


def test_a_pose_that_the_room_contradicts_may_be_as_far_off_as_that_says(parts: Bench) -> None:
    """Anyone who follows somebody close by has most pixels on his side, and most of the room against him."""
    first, second = seen(np.eye(4), 0.0, 1.0), seen(MOTION, 0.1, 0.8)
    with_person = se3.exp([0.0, 0.0, 0.2, 0.0, 0.0, 0.0]) @ MOTION
    assert misfits_of(parts, first, second, MOTION).pose_error()[0] == 0
    assert 0.05 < misfits_of(parts, first, second, with_person).pose_error()[0] < 0.4


def test_a_misfit_enlarges_the_covariance_of_a_camera_alone(parts: Bench) -> None:
    """Beside wheels it does not, so that they contradict the camera."""
    settings, watch = DenseSettings(), Stopwatch()
    views = ViewCache(settings, parts.gridder, parts.maker, watch)
    locator = Locator(EXACT, settings, parts.aligner, views, watch)
    first, second = seen(np.eye(4), 0.0, 1.0), seen(MOTION, 0.1, 0.8)
    asked = parts.grid(second), parts.reference(first), se3.exp([0.0, 0.0, 0.2, 0.0, 0.0, 0.0]) @ MOTION
    alone, beside_wheels = (locator.by_regions(*asked, is_helped=is_helped) for is_helped in (False, True))
    assert 0.05**2 < alone[0][0, 0] < 0.4**2
    assert not beside_wheels[0].any()
    assert alone[1] == beside_wheels[1]


def test_the_share_of_regions_that_fit_is_all_but_the_persons_at_the_true_pose_and_few_at_his(parts: Bench) -> None:
    first, second = seen(np.eye(4), 0.0, 1.0), seen(MOTION, 0.1, 0.8)
    by_person = se3.exp([0.0, 0.0, 0.2, 0.0, 0.0, 0.0]) @ MOTION
    assert misfits_of(parts, seen(np.eye(4), 0.0), seen(MOTION, 0.1), MOTION).pose_error()[1] == 1.0
    assert 0.6 < (misfits_of(parts, first, second, MOTION).pose_error()[1] or 0.0) < 0.9
    assert (misfits_of(parts, first, second, by_person).pose_error()[1] or 0.0) < 0.5
    blank = replace(second, depth_m=np.zeros_like(second.depth_m))
    assert misfits_of(parts, first, blank, MOTION).pose_error()[1] is None


def test_alignment_goes_by_the_room_once_the_person_is_left_out(parts: Bench) -> None:
    first, second = seen(np.eye(4), 0.0, 1.0), seen(MOTION, 0.1, 0.92)
    reference, frame = parts.reference(first), parts.grid(second)
    regions = moving(parts, first, second, MOTION)
    assert regions.any()
    with_all = parts.aligner.align(frame, reference, MOTION).T_reference_frame
    without_them = parts.aligner.align(without(frame, regions), reference, MOTION).T_reference_frame
    assert apart(without_them, MOTION)[0] < 0.5 * apart(with_all, MOTION)[0]
    assert apart(without_them, MOTION)[0] < 0.004


def test_left_out_regions_have_no_depth_at_any_level_and_others_keep_theirs(parts: Bench) -> None:
    frame = parts.grid(seen(np.eye(4), 0.0))
    regions = np.zeros((REGION_ROWS, REGION_COLUMNS), bool)
    regions[1, 2] = True
    for before, after in zip(frame.levels, without(frame, regions).levels, strict=True):
        h, w = before.depth_m.shape
        inside = (slice(h // 6 + 1, 2 * h // 6 - 1), slice(2 * w // 8 + 1, 3 * w // 8 - 1))
        assert not after.depth_m[inside].any()
        changed = before.depth_m != after.depth_m
        assert changed.mean() < 1.6 / regions.size


def test_few_regions_with_depth_say_nothing(parts: Bench) -> None:
    first, second = seen(np.eye(4), 0.0, 1.0), seen(MOTION, 0.1, 0.8)
    second.depth_m[:, 160:] = 0
    second.depth_m[120:] = 0
    assert not moving(parts, first, second, MOTION).any()
