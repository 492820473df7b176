"""Motions that are known, found again: by depth and grey, by depth alone, through lenses, shutters and gaps."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import cv2
import numpy as np
import pytest
from narrowing import not_none
from odometry.dense.scenes import SMALL, Bench, Plane, apart, bench, dense, frame_of, render, rolled
from odometry.views import room_frame, run
from synthetic import CAMERA, render_room, wobbling_trajectory

from wheelsight.core.calibration import Calibration
from wheelsight.core.geometry import PinholeCamera, se3, so3
from wheelsight.core.keyframes import PredictedView
from wheelsight.core.messages import RgbdFrame
from wheelsight.vision.dense.alignment import PreviousPose, Reference

TRUTH = wobbling_trajectory(30)
T_WORLD_FIRST = np.array(TRUTH.T_frame_body[0])
MOTIONS = {
    "forward": [0.0, 0.0, 0.05, 0.0, 0.0, 0.0],
    "sideways": [0.06, -0.02, 0.0, 0.0, 0.0, 0.0],
    "turn": [0.0, 0.0, 0.0, 0.01, 0.06, -0.03],
    "all": [0.03, -0.02, 0.04, -0.02, 0.04, 0.03],
}


def room_pair(motion: list[float], **how: Any) -> tuple[np.ndarray, RgbdFrame, RgbdFrame]:
    """T_first_second and both frames."""
    T = se3.exp(motion)
    return T, room_frame(T_WORLD_FIRST, 0.0, **how), room_frame(T_WORLD_FIRST @ T, 0.03, **how)


@pytest.mark.parametrize("color_weight", [0.5, 0.0])
@pytest.mark.parametrize("motion", MOTIONS.values(), ids=MOTIONS)
def test_motion_is_found(motion: list[float], color_weight: float) -> None:
    T, first, second = room_pair(motion)
    metres, radians = apart(T, bench(color_weight=color_weight).align(first, second).T_reference_frame)
    assert metres < 1e-3
    assert radians < 5e-4


def test_motion_is_found_in_noise() -> None:
    T, first, second = room_pair(MOTIONS["all"], depth_noise=True)
    found = bench().align(first, second)
    assert apart(T, found.T_reference_frame)[0] < 2e-3
    assert found.residual == pytest.approx(1.0, abs=0.25)


def noiseless_view(parts: Bench, frame: RgbdFrame) -> Reference:
    """What a map would predict that has averaged all noise out."""
    level = parts.grid(frame).levels[0]
    view = PredictedView(level.depth_m, parts.maker.normals(level), level.grey)
    return parts.maker.of_view(view, np.eye(4), level.intrinsics)


@pytest.mark.parametrize("is_map", [False, pytest.param(True, marks=pytest.mark.slow)], ids=["frame", "map"])
def test_the_noise_of_walls_does_not_pull_along_a_corridor(is_map: bool) -> None:
    """Walls beside the way say nothing of it, and what errs by chance errs both ways: in two frames of one place."""
    sides = [Plane((1, 0, 0), 0.9), Plane((-1, 0, 0), 1.3), Plane((0, 1, 0), 0.9), Plane((0, -1, 0), 1.5)]
    corridor, parts, found = [*sides, Plane((0, 0, 1), 7.0)], bench(color_weight=0), []
    for seed in range(16):
        first, second = (frame_of(corridor, np.eye(4), 0.0, noise_seed=n) for n in (100 + seed, seed))
        known = noiseless_view(parts, frame_of(corridor, np.eye(4), 0.0)) if is_map else parts.reference(first)
        found.append(se3.log(parts.aligner.align(parts.grid(second), known, np.eye(4)).T_reference_frame))
    mean, spread = np.mean(found, axis=0), np.std(found, axis=0)
    # 7 ± 2.8 mm nearer, always, with normals that turn with their pixel's own noise; turned by 0.005° with neighbours
    # that err as the pixel does, and levers as long as depth happens to be. Against a map 2.4 mm with these.
    assert abs(mean[2]) < 0.6e-3
    assert spread[2] < (1.3e-3 if is_map else 1e-3)
    assert np.degrees(np.abs(mean[3:]).max()) < 2.5e-3


def before_boards(T_map_camera: np.ndarray, stamp_s: float) -> RgbdFrame:
    """A painted wall, dark boards half before it, and a lens that spreads what is dark by a pixel."""
    wall, boards = (render([Plane((0, 0, 1), z, is_painted=True)], T_map_camera) for z in (2.0, 1.85))
    x = T_map_camera[0, 3] + SMALL.rays()[..., 0] * boards[1]
    is_board = np.abs(x) % 0.5 < 0.2
    depth_m = np.where(is_board, boards[1], wall[1])
    grey = cv2.GaussianBlur(np.where(is_board, 30, wall[0][..., 0]).astype(np.float32), (0, 0), 1.0)
    return RgbdFrame(stamp_s, np.repeat(np.rint(grey).astype(np.uint8)[..., None], 3, axis=2), depth_m)


@pytest.mark.slow
def test_what_stands_out_before_a_wall_does_not_carry_the_camera_along() -> None:
    """Its rim is spread over the wall, whose depth makes of it a longer way."""
    off_m = []
    for begin_m in np.arange(6) / 12:
        for way_m in (0.08, -0.08):
            T_map_first, T = se3.exp([begin_m, 0, 0, 0, 0, 0]), se3.exp([way_m, 0, 0, 0, 0, 0])
            first, second = before_boards(T_map_first, 0.0), before_boards(T_map_first @ T, 0.1)
            found = bench().align(first, second, T).T_reference_frame
            off_m.append(np.sign(way_m) * (found[0, 3] - way_m))
    assert abs(np.mean(off_m)) < 0.5e-3  # 2.2 mm too far with what is grey beside the boards


@pytest.fixture
def noise_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Grey counts on a plain wall too, where noise makes its gradient, and an alignment follows it by small steps."""
    monkeypatch.setattr("wheelsight.vision.dense.alignment.MIN_GRADIENT", 0.5)
    monkeypatch.setattr("wheelsight.vision.dense.alignment._SMALL_STEP", 1e-4)


@pytest.mark.usefixtures("noise_counts")
def test_a_guess_holds_what_only_noise_shows() -> None:
    """Before a plain wall the noise of grey values would pull along it, step by step."""
    wall, off_m = [Plane((0, 0, 1), 1.0)], []
    for sigma_m in (np.inf, 0.02):
        parts = bench()
        reference, frame = (
            parts.reference(frame_of(wall, np.eye(4), 0.0, 1)),
            parts.grid(frame_of(wall, np.eye(4), 0.1, 2)),
        )
        found = parts.aligner.align(frame, reference, np.eye(4), held_m=(sigma_m, sigma_m))
        off_m.append(np.linalg.norm(found.T_reference_frame[:2, 3]))
    assert off_m[1] < 0.005 < off_m[0]


# A camera that looks ahead, a metre above the floor.
ON_WHEELS = replace(
    Calibration.registered_camera(SMALL),
    T_base_camera=np.array([[0, 0, 1, 0.1], [-1, 0, 0, 0], [0, -1, 0, 1.0], [0, 0, 0, 1.0]]),
)


@pytest.mark.usefixtures("noise_counts")
def test_on_wheels_a_guess_holds_most_what_would_leave_the_floor() -> None:
    """A plain wall shows neither a rise nor a roll, and noise would have the camera climb it."""
    calibration, wall, climbed = ON_WHEELS, [Plane((0, 0, 1), 1.0)], {}
    for held_m in ((0.2, 0.2), (0.2, 0.03), (np.inf, 0.03)):
        parts, motions = bench(calibration), []
        for seed in range(3):
            reference = parts.reference(frame_of(wall, np.eye(4), 0.0, 2 * seed + 1))
            frame = parts.grid(frame_of(wall, np.eye(4), 0.1, 2 * seed + 2))
            found = parts.aligner.align(frame, reference, np.eye(4), held_m=held_m)
            motions.append(se3.log(found.T_reference_frame))
        climbed[held_m] = np.sqrt(np.mean(np.square(motions), axis=0))[[1, 5]]
    assert (climbed[0.2, 0.03] < 0.3 * climbed[0.2, 0.2]).all()
    assert (climbed[np.inf, 0.03] < 0.3 * climbed[0.2, 0.2]).all()


@pytest.mark.usefixtures("noise_counts")
def test_on_wheels_a_guess_is_not_followed_where_wheels_do_not_roll() -> None:
    """Sideways, up, and rolled about the way ahead: the base is held where the frame before had it."""
    wall, T_guess = [Plane((0, 0, 1), 1.0)], se3.exp([0.02, -0.03, 0, 0, 0, 0.05])
    for calibration, step, is_rolling in (
        (ON_WHEELS, PreviousPose(np.eye(4), 0.1), True),
        (ON_WHEELS, None, False),
        (Calibration.registered_camera(SMALL), PreviousPose(np.eye(4), 0.1), False),
    ):
        parts = bench(calibration)
        reference = parts.reference(frame_of(wall, np.eye(4), 0.0, 1))
        frame = parts.grid(frame_of(wall, np.eye(4), 0.1, 2))
        found = parts.aligner.align(frame, reference, T_guess, step, held_m=(0.02, 0.005))
        x, y, _, _, _, roll = se3.log(found.T_reference_frame)
        assert (x, y, roll) == pytest.approx((0.0, 0.0, 0.0) if is_rolling else (0.02, -0.03, 0.05), abs=0.01)


@pytest.mark.usefixtures("noise_counts")
def test_a_base_that_turns_carries_a_camera_beside_it_along() -> None:
    """What wheels roll is held as the guess has it: here a turn, which takes the camera sideways and ahead."""
    T_base_camera = not_none(ON_WHEELS.T_base_camera).copy()
    T_base_camera[:2, 3] = 0.4, 0.3
    T_guess = se3.invert(T_base_camera) @ se3.exp([0.03, 0, 0, 0, 0, 0.08]) @ T_base_camera
    wall, parts = [Plane((0, 0, 1), 1.0)], bench(replace(ON_WHEELS, T_base_camera=T_base_camera))
    reference = parts.reference(frame_of(wall, np.eye(4), 0.0, 1))
    frame = parts.grid(frame_of(wall, T_guess, 0.1, 2))
    found = parts.aligner.align(frame, reference, T_guess, PreviousPose(np.eye(4), 0.1), held_m=(0.005, 0.001))
    metres, radians = apart(T_guess, found.T_reference_frame)
    assert np.linalg.norm(T_guess[:2, 3]) > 0.02
    assert metres < 0.004
    assert radians < 0.003


def test_along_a_wall_the_start_from_which_grey_fits_is_taken() -> None:
    """Planes fit from either; from the wrong one, marks of the wall fit others' places."""
    wall, true = [Plane((0, 0, 1), 1.0, is_painted=True)], se3.exp([0.02, 0.01, 0, 0, 0, 0])
    parts, wrong = bench(), se3.exp([0.25, 0.1, 0, 0, 0, 0])
    reference, frame = parts.reference(frame_of(wall, np.eye(4), 0.0, 1)), parts.grid(frame_of(wall, true, 0.1, 2))
    lured = parts.aligner.align(frame, reference, wrong)
    assert apart(true, lured.T_reference_frame)[0] > 0.1
    assert lured.residual < 1
    for starts in ([wrong, np.eye(4)], [np.eye(4), wrong]):
        assert apart(true, parts.aligner.align_clearest(frame, reference, starts).T_reference_frame)[0] < 1e-3


def test_odometry_takes_the_other_motion_where_the_one_expected_is_wrong() -> None:
    wall, true = [Plane((0, 0, 1), 1.0, is_painted=True)], se3.exp([0.22, 0.09, 0, 0, 0, 0])
    wrong, near = se3.exp([-0.03, -0.01, 0, 0, 0, 0]), se3.exp([0.2, 0.1, 0, 0, 0, 0])
    for others, is_right in (((), False), ((near,), True)):
        odometry = dense()
        odometry.process(frame_of(wall, np.eye(4), 0.0, 1))
        found = odometry.process(frame_of(wall, true, 0.1, 2), wrong, *others)
        assert found.T_odom_body is not None
        assert (apart(true, found.T_odom_body)[0] < 1e-3) == is_right


def test_alignment_begins_where_depth_fits() -> None:
    T, first, second = room_pair(MOTIONS["all"])
    wrong, near = T @ se3.exp([0.1, 0.0, -0.1, 0.0, 0.3, 0.0]), T @ se3.exp([0.002, 0.0, 0.0, 0.0, 0.001, 0.0])
    parts = bench()
    start = partial(parts.aligner.start, parts.grid(second), parts.reference(first))
    for guesses in ([wrong, near], [near, wrong], [near]):
        assert apart(T, start(guesses))[0] < 0.01
    np.testing.assert_array_equal(start([near, T]), start([near]))  # where none is clearly better, it is the first


def test_turn_alone_brings_a_quick_turn_near() -> None:
    T, first, second = room_pair([0, 0, 0, 0.02, 0.05, -0.02])
    parts = bench()
    turned = parts.aligner.turn(parts.grid(second), parts.reference(first), np.eye(4))
    assert so3.angle(T[:3, :3]) > 0.05
    assert apart(T, turned)[1] < 0.01
    np.testing.assert_array_equal(turned[:3, 3], 0)


def test_turn_alone_is_right_where_the_reference_lies_back() -> None:
    """What is near does not turn as what is far does once there is a way, too."""
    T, first, second = room_pair([0.35, 0.05, 0.3, 0.02, 0.05, -0.02])
    parts, on_the_spot = bench(), np.eye(4)
    on_the_spot[:3, 3] = T[:3, 3]
    turned = parts.aligner.turn(parts.grid(second), parts.reference(first), on_the_spot)
    assert apart(T, turned)[1] < 0.015


@pytest.mark.parametrize(("gain", "offset"), [(0.6, 30.0), (1.4, 5.0)])
def test_turn_does_not_depend_on_exposure(gain: float, offset: float) -> None:
    T, first, second = room_pair([0, 0, 0, 0.02, 0.05, -0.02])
    parts = bench()
    reference, frame = parts.reference(first), parts.grid(second)
    levels = tuple(replace(level, grey=gain * level.grey + offset) for level in frame.levels)
    plain, exposed = (parts.aligner.turn(seen, reference, np.eye(4)) for seen in (frame, replace(frame, levels=levels)))
    assert apart(T, exposed)[1] < 0.01
    assert apart(plain, exposed)[1] < 2e-3  # four of the least steps taken


def test_exposure_is_taken_out() -> None:
    T, first, second = room_pair(MOTIONS["all"])
    darker = replace(second, color=(0.6 * second.color + 10).astype(np.uint8))
    assert apart(T, bench().align(first, darker).T_reference_frame)[0] < 1.5e-3


def test_lens_is_taken_out(rng: np.random.Generator) -> None:
    lens = replace(CAMERA, distortion=(0.1, -0.2, 0.002, -0.001, 0.05))
    T = se3.exp(MOTIONS["all"])
    first, second = (RgbdFrame(0.03 * k, *render_room(T_WORLD_FIRST @ (T if k else np.eye(4)), lens)) for k in range(2))
    straight = bench(Calibration.registered_camera(lens)).align(first, second)
    assert apart(T, straight.T_reference_frame)[0] < 2e-3
    crooked = bench(Calibration.registered_camera(CAMERA)).align(first, second)
    assert apart(T, crooked.T_reference_frame)[0] > 2 * apart(T, straight.T_reference_frame)[0]


SHUTTER_S, TWIST = 0.03, np.array([0.3, -0.2, 0.4, 0.4, 1.2, -0.5])


def rolling_frame(T_map_middle: np.ndarray, stamp_s: float) -> RgbdFrame:
    """Every row taken from where the camera was at the row's time; bands of rows share a rendering."""
    bands = 24
    rows = []
    for band in range(bands):
        share = (band + 0.5) / bands - 0.5
        frame = room_frame(T_map_middle @ se3.exp(share * SHUTTER_S * TWIST), stamp_s)
        rows += [frame] * (CAMERA.height // bands)
    return rolled(rows, stamp_s)


@pytest.fixture(scope="module")
def rolling_pair() -> tuple[np.ndarray, RgbdFrame, RgbdFrame]:
    T = se3.exp(TWIST / 30)
    return T, rolling_frame(T_WORLD_FIRST, 0.0), rolling_frame(T_WORLD_FIRST @ T, 1 / 30)


def shuttered() -> Calibration:
    return Calibration.registered_camera(CAMERA, rolling_shutter_s=SHUTTER_S)


def test_known_speed_straightens_a_rolling_shutter(rolling_pair: tuple) -> None:
    _, bent, _ = rolling_pair
    exact = room_frame(T_WORLD_FIRST, 0.0).depth_m
    straight = bench(shuttered()).grid(bent, TWIST).levels[0].depth_m
    known = straight > 0
    assert known.mean() > 0.95
    off, off_before = (np.mean(np.abs(image - exact)[known] > 0.01) for image in (straight, bent.depth_m))
    assert off < 0.25 * off_before


def test_speed_is_refined_on_the_way(rolling_pair: tuple) -> None:
    T, first, second = rolling_pair
    parts = bench(shuttered())
    reference = parts.maker.of_frame(parts.grid(first, TWIST), np.eye(4))
    slow = parts.grid(second, 0.5 * TWIST)
    refined = parts.aligner.align(slow, reference, np.eye(4), PreviousPose(np.eye(4), 1 / 30))
    left = parts.aligner.align(slow, reference, np.eye(4))
    assert apart(T, refined.T_reference_frame)[1] < 2e-3
    assert apart(T, refined.T_reference_frame)[1] < 0.7 * apart(T, left.T_reference_frame)[1]


def test_unregistered_colour_lies_where_it_belongs() -> None:
    color, depth = (
        PinholeCamera(400, 300, 330.0, 331.0, 198.0, 151.0),
        PinholeCamera(320, 240, 250.0, 249.0, 163.0, 117.0),
    )
    T_color_depth = se3.exp(np.array([-0.08, 0.03, 0.02, 0.05, -0.12, 0.08]))
    T = se3.exp(MOTIONS["all"])

    def frame(T_map_depth: np.ndarray) -> RgbdFrame:
        image, _ = render_room(T_map_depth @ se3.invert(T_color_depth), color)
        return RgbdFrame(0.0, image, render_room(T_map_depth, depth)[1])

    parts = bench(Calibration(color, depth, T_color_depth))
    first = frame(T_WORLD_FIRST)
    grey = parts.grid(first).levels[0].grey
    direct = render_room(T_WORLD_FIRST, depth)[0].mean(axis=2)
    assert np.corrcoef(grey[grey >= 0], direct[grey >= 0])[0, 1] > 0.9
    assert apart(T, parts.align(first, frame(T_WORLD_FIRST @ T)).T_reference_frame)[0] < 1.5e-3


@pytest.mark.parametrize("reference", ["keyframes", "previous"])
def test_a_way_through_the_room(reference: str) -> None:
    frames = [room_frame(T, stamp_s, depth_noise=True) for stamp_s, T in TRUTH]
    answers = run(dense(reference=reference), frames)
    worst = max(
        apart(se3.invert(T_WORLD_FIRST) @ T, not_none(a.T_odom_body))[0]
        for (_, T), a in zip(TRUTH, answers, strict=True)
    )
    assert worst < 5e-3
