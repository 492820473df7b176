"""What is wrong with wheels or camera is found from motions whose fault is known."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from wheelsight.core.calibration_parts import HolonomicWheels, Wheels
from wheelsight.core.geometry import FloatArray, se3, so3
from wheelsight.estimation.agreement import MotionComparison, RobotSensor, height_below

WHEELS = Wheels(0.17, 0.17, 0.52, 3200.0)
T_BASE_CAMERA = np.array([[0.0, -0.1, 0.995, 0.3], [-1, 0, 0, 0.0], [0, -0.995, -0.1, 0.9], [0, 0, 0, 1]])
STRAIGHT = [(0.1, 0.0)] * 10
BENDS = [(0.1, 0.05)] * 10 + [(0.0, -0.1)] * 6 + [(0.1, 0.0)] * 4
Piece = tuple[float, float]


def seen(
    T_base: FloatArray, T_true: FloatArray = T_BASE_CAMERA, depth: float = 1.0, flip: int | None = None
) -> FloatArray:
    """The base's motion (4, 4) as a camera shows it that truly sits at `T_true`, whose depth and images are wrong."""
    T = se3.invert(se3.nearest(T_true)) @ T_base @ se3.nearest(T_true)
    if flip is not None:
        S = np.eye(4)
        S[flip, flip] = -1
        T = S @ T @ S
    T[:3, 3] *= depth
    return np.asarray(se3.nearest(T_BASE_CAMERA) @ T @ se3.invert(se3.nearest(T_BASE_CAMERA)))


def compared(
    pieces: list[Piece],
    reported: Callable[[float, float], Piece] = lambda way, turn: (way, turn),
    by_camera: Callable[[FloatArray], FloatArray] = seen,
    gyro: Callable[[float, float], float] | None = None,
) -> MotionComparison:
    agreement = MotionComparison(WHEELS, T_BASE_CAMERA)
    for way, turn in pieces:
        T_by_wheels, T_true = (se3.exp([w, 0, 0, 0, 0, t]) for w, t in (reported(way, turn), (way, turn)))
        assert agreement.add(T_by_wheels, by_camera(T_true), None if gyro is None else gyro(way, turn))
    return agreement


def wheels_with(left: float, right: float, *, swaps: bool = False) -> Callable[[float, float], Piece]:
    """Way and turn by the wheels where the true ones are given and each wheel counts a factor more."""

    def reported(way: float, turn: float) -> Piece:
        half = WHEELS.track_width_m / 2
        ways = [(way - turn * half) * left, (way + turn * half) * right]
        first, second = ways[::-1] if swaps else ways
        return (first + second) / 2, (second - first) / 2 / half

    return reported


def turned(axis: int, degrees: float) -> Callable[[FloatArray], FloatArray]:
    T = T_BASE_CAMERA.copy()
    T[:3, :3] = so3.exp(np.radians(degrees) * np.eye(3)[axis]) @ T[:3, :3]
    return lambda T_base: seen(T_base, T)


def found(agreement: MotionComparison, floor_ratio: float | None = None) -> dict[RobotSensor, str]:
    explanations = agreement.explanations(floor_ratio)
    sensors = {one.sensor for one in explanations}
    return {who: "; ".join(one.cause for one in explanations if one.sensor is who) for who in sensors}


def test_a_sound_drive_needs_no_explanation() -> None:
    for pieces in (STRAIGHT, BENDS):
        agreement = compared(pieces)
        assert agreement.agrees()
        assert found(agreement, 1.0) == {}


@pytest.mark.parametrize("factor", [0.97, 1.03, 0.9, 1.1])
def test_nor_do_radii_that_filters_allow_for(factor: float) -> None:
    assert found(compared(BENDS, wheels_with(factor, factor)), 1.0) == {}


def test_nor_do_wheels_that_slip_now_and_then() -> None:
    def reported(way: float, turn: float) -> Piece:
        return (way * (3.0 if next(count) % 4 == 0 else 1.0), turn)

    count = iter(range(100))
    assert found(compared(STRAIGHT * 2, reported), 1.0) == {}


def test_nor_does_a_wheel_that_turns_in_the_air() -> None:
    assert found(compared([(0.05, 0.19)] * 20, lambda way, turn: (0.1, 0.0)), 1.0) == {}


@pytest.mark.parametrize("off_m", [(0.03, 0.0), (-0.04, 0.0), (0.0, 0.05), (0.0, -0.06)])
def test_nor_do_turns_on_the_spot_whose_ways_are_millimetres(off_m: tuple[float, float]) -> None:
    """A camera some centimetres from where it is said to sit goes millimetres in a piece: less than clocks make."""
    T_true = T_BASE_CAMERA.copy()
    T_true[:2, 3] += off_m
    turns = [(0.0, 0.08)] * 12
    assert compared(turns, by_camera=lambda T: seen(T, T_true)).agrees()
    assert found(compared(turns, by_camera=lambda T: seen(T, T_true))) == {}


def test_nor_does_a_leap_of_the_camera_in_turns_on_the_spot_turn_its_mount(rng: np.random.Generator) -> None:
    """It looks like the swing of a camera that sits elsewhere, but which way that looks no one has seen."""
    for leap_m in 0.15 * rng.standard_normal((20, 2)):
        astray = np.eye(4)
        astray[:2, 3] = leap_m
        agreement = MotionComparison(WHEELS, T_BASE_CAMERA)
        T_turn = se3.exp([0.0001, 0, 0, 0, 0, 0.08])
        assert agreement.add(T_turn, astray @ T_turn, None)
        assert not agreement.agrees()
        assert found(agreement, 1.0) == {}


def test_turns_on_the_spot_the_other_way_are_reported_all_the_same() -> None:
    mirrored = compared([(0.0, 0.08)] * 12, by_camera=lambda T: seen(T, flip=0))
    assert "mirrored left to right" in found(mirrored)[RobotSensor.CAMERA]


@pytest.mark.parametrize("depth", [0.2, 0.5, 1.3, 5.0])
@pytest.mark.parametrize("pieces", [STRAIGHT, BENDS], ids=["straight", "bends"])
def test_depth_is_wrong_where_ways_and_floor_are_by_one_factor(depth: float, pieces: list[Piece]) -> None:
    causes = found(compared(pieces, by_camera=lambda T: seen(T, depth=depth)), depth)
    assert list(causes) == [RobotSensor.CAMERA]
    assert f"depth is {depth:.2g} times the true one: check depth_factor" in causes[RobotSensor.CAMERA]


@pytest.mark.parametrize("factor", [0.25, 4.0, 1.3])
def test_wheels_are_wrong_where_ways_are_and_the_floor_is_not(factor: float) -> None:
    for pieces in (STRAIGHT, BENDS):
        causes = found(compared(pieces, wheels_with(factor, factor)), 1.02)
        assert list(causes) == [RobotSensor.WHEELS]
        assert f"are {factor:.2g} times the true ones: check ticks_per_turn" in causes[RobotSensor.WHEELS]


def test_without_a_floor_a_straight_way_does_not_tell_whose_are_wrong_but_turns_do() -> None:
    halved = wheels_with(0.5, 0.5)
    assert set(found(compared(STRAIGHT, halved))) == {RobotSensor.WHEELS, RobotSensor.CAMERA}
    assert list(found(compared(BENDS, halved))) == [RobotSensor.WHEELS]


def test_a_track_width_is_wrong_where_turns_alone_are() -> None:
    causes = found(compared(BENDS, lambda way, turn: (way, turn / 1.5)), 1.0)
    assert causes == {RobotSensor.WHEELS: "their turns are 0.67 times the true ones: check track_width_m"}


@pytest.mark.parametrize(
    ("reported", "cause"),
    [
        (wheels_with(-1, 1), "the left wheel counts backwards"),
        (wheels_with(1, -1), "the right wheel counts backwards"),
        (wheels_with(-1, -1), "both wheels count backwards"),
        (wheels_with(-1, 1, swaps=True), "left and right wheel are swapped, and one counts backwards"),
    ],
)
def test_signs_of_wheels(reported: Callable[[float, float], Piece], cause: str) -> None:
    causes = found(compared(BENDS, reported), 1.0)
    assert list(causes) == [RobotSensor.WHEELS]
    assert causes[RobotSensor.WHEELS].startswith(cause)


@pytest.mark.parametrize(("axis", "degrees"), [(2, 90.0), (2, -30.0), (1, 30.0), (0, 60.0), (1, -90.0)])
def test_a_mount_is_wrong_where_directions_are(axis: int, degrees: float) -> None:
    causes = found(compared(BENDS, by_camera=turned(axis, degrees)))
    assert list(causes) == [RobotSensor.CAMERA]
    assert "T_base_camera" in causes[RobotSensor.CAMERA]
    if abs(degrees) < 90:
        stated = float(causes[RobotSensor.CAMERA].split("about ")[1].split("°")[0])
        assert stated == pytest.approx(abs(degrees), abs=3)


def test_mirrored_images_and_swapped_wheels_are_alike_until_a_gyroscope_shows() -> None:
    swapped = wheels_with(1, 1, swaps=True)

    def mirrored(T: FloatArray) -> FloatArray:
        return seen(T, flip=0)

    for agreement in (compared(BENDS, swapped), compared(BENDS, by_camera=mirrored)):
        causes = found(agreement, 1.0)
        assert set(causes) == {RobotSensor.WHEELS, RobotSensor.CAMERA}
        assert "swapped" in causes[RobotSensor.WHEELS]
        assert "mirrored left to right" in causes[RobotSensor.CAMERA]

    def turns(way: float, turn: float) -> float:
        return turn + 0.002

    assert list(found(compared(BENDS, swapped, gyro=turns), 1.0)) == [RobotSensor.WHEELS]
    assert list(found(compared(BENDS, by_camera=mirrored, gyro=turns), 1.0)) == [RobotSensor.CAMERA]


def test_a_piece_waits_until_there_is_some_motion() -> None:
    agreement = MotionComparison(WHEELS, T_BASE_CAMERA)
    assert not agreement.add(np.eye(4), se3.exp([0.02, 0, 0, 0, 0, 0.02]), None)
    assert agreement.pieces == 0


@pytest.mark.parametrize("factor", [1.0, 0.2, 5.0])
def test_the_floor_is_seen_whatever_unit_depth_has(factor: float) -> None:
    y, x = np.mgrid[-0.4:0.4:30j, -0.5:0.5:40j]
    rays = np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3)
    up, down = T_BASE_CAMERA[2, :3], -(rays @ T_BASE_CAMERA[2, :3])
    depth_m = np.where(down > 0.1, 0.9 / np.maximum(down, 0.1), 4.0) * factor
    assert height_below(rays, depth_m, up, 0.9) == pytest.approx(0.9 * factor, rel=0.05)
    assert height_below(rays, depth_m, -up, 0.9) != pytest.approx(0.9 * factor, rel=0.2)
    assert height_below(rays, np.zeros(len(rays)), up, 0.9) is None


@pytest.mark.parametrize("turned_deg", [0.0, 30.0, -60.0])
@pytest.mark.parametrize("wall_m", [0.6, 1.0, 1.5])
def test_a_wall_that_fills_the_view_is_no_floor(wall_m: float, turned_deg: float, rng: np.random.Generator) -> None:
    y, x = np.mgrid[-0.4:0.4:30j, -0.5:0.5:40j]
    rays = np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3)
    up, turned_rad = T_BASE_CAMERA[2, :3], np.radians(turned_deg)
    off = rays @ np.array([np.sin(turned_rad), 0.0, np.cos(turned_rad)])
    depth_m = np.where(off > 0.1, wall_m / np.maximum(off, 0.1), 0.0)
    depth_m *= 1 + 0.003 * rng.standard_normal(len(depth_m))
    assert height_below(rays, depth_m, up, 0.9) is None
    below = -(rays @ up)
    floor_m = np.where(below > 0.05, 0.9 / np.maximum(below, 0.05), np.inf)
    before_it = height_below(rays, np.where(depth_m > 0, np.minimum(depth_m, floor_m), floor_m), up, 0.9)
    assert before_it is None or before_it == pytest.approx(0.9, rel=0.1)


HOLONOMIC = HolonomicWheels("increments", distance_m=0.25)
# Ahead, sideways, back and askew, turning or not.
ASKEW = [(0.1, 0.0, 0.0)] * 4 + [(0.0, 0.1, 0.05)] * 6 + [(-0.07, 0.07, 0.0)] * 4 + [(0.0, 0.0, -0.1)] * 4


def of_holonomic(
    reported: Callable[[FloatArray], FloatArray] = lambda twist: twist,
    by_camera: Callable[[FloatArray], FloatArray] = seen,
) -> MotionComparison:
    agreement = MotionComparison(HOLONOMIC, T_BASE_CAMERA)
    for way_m, left_m, turn_rad in ASKEW:
        twist = np.array([way_m, left_m, 0.0, 0.0, 0.0, turn_rad])
        assert agreement.add(se3.exp(reported(twist)), by_camera(se3.exp(twist)), None)
    return agreement


def test_a_holonomic_base_agrees_wherever_it_goes() -> None:
    assert of_holonomic().agrees()
    assert found(of_holonomic(), 1.0) == {}


def test_two_wheels_would_not_agree_with_what_goes_sideways() -> None:
    agreement = MotionComparison(WHEELS, T_BASE_CAMERA)
    for way_m, left_m, turn_rad in ASKEW:
        T = se3.exp([way_m, left_m, 0.0, 0.0, 0.0, turn_rad])
        agreement.add(T, seen(T), None)
    assert not agreement.agrees()


def test_wrong_sizes_signs_and_depth_of_a_holonomic_base_are_named() -> None:
    wrong = of_holonomic(lambda twist: 1.5 * twist)
    assert not wrong.agrees()
    assert "1.5 times the true ones" in found(wrong, 1.0)[RobotSensor.WHEELS]
    assert "all wheels count backwards" in found(of_holonomic(lambda twist: -twist), 1.0)[RobotSensor.WHEELS]
    shallow = of_holonomic(by_camera=lambda T_base: seen(T_base, depth=0.5))
    # About: what a turn moves the camera aside is not known by the direction of the way.
    assert "depth is 0.47 times the true one" in found(shallow, 0.5)[RobotSensor.CAMERA]


def test_a_camera_that_looks_elsewhere_on_a_holonomic_base_does_not_agree() -> None:
    assert not of_holonomic(by_camera=turned(2, 40.0)).agrees()


def scaled(scale: float) -> MotionComparison:
    """Of a camera whose ways and turns are `scale` times those of the wheels."""
    agreement = MotionComparison(WHEELS, np.eye(4))
    for _ in range(30):
        agreement.add(se3.exp([0.1, 0, 0, 0, 0, 0.05]), se3.exp([0.1 * scale, 0, 0, 0, 0, 0.05 * scale]), None)
    return agreement


def test_a_scale_of_15_percent_agrees_and_one_of_50_is_explained() -> None:
    assert scaled(1.0).pieces == 30
    assert scaled(1.15).agrees()
    assert not scaled(1.15).agrees(0.001)
    assert not scaled(1.5).agrees()
    assert scaled(1.5).agrees(0.9)
    assert scaled(3.0).explanations(None)


def test_shorter_motions_are_no_piece() -> None:
    agreement = MotionComparison(WHEELS, np.eye(4))
    assert not agreement.add(se3.exp([0.05, 0, 0, 0, 0, 0.05]), np.eye(4), None)
    assert agreement.pieces == 0


def test_the_height_by_one_view_needs_many_steep_rays_to_a_level_plane(monkeypatch: pytest.MonkeyPatch) -> None:
    rays = np.column_stack([np.zeros(200), np.linspace(0.05, 0.6, 200), np.ones(200)])
    depth_m, up = 0.9 / rays[:, 1], np.array([0.0, -1.0, 0.0])
    assert height_below(rays, depth_m, up, 0.9) == pytest.approx(0.9, rel=0.01)
    assert height_below(rays[:60], depth_m[:60], up, 0.9) is None
    assert height_below(rays[::8], depth_m[::8], up, 0.9) is None
    board = np.concatenate([depth_m, np.tile(0.5 / rays[:, 1], 5)])  # nearer, and five times as many points
    many = np.tile(rays, (6, 1))
    assert height_below(many, board, up, 0.9) == pytest.approx(0.9, rel=0.02)
    monkeypatch.setattr("wheelsight.estimation.agreement._PEAK_SHARE", 0.5)
    assert height_below(many, board, up, 0.9) == pytest.approx(0.5, rel=0.02)
    monkeypatch.setattr("wheelsight.estimation.agreement._STEEPEST_DEG", 0.01)
    assert height_below(rays, depth_m * (1 + 0.05 * rays[:, 1]), up, 0.9) is None
