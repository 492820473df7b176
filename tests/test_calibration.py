"""Calibrations: what they refuse, and that calibration.yaml keeps them to the last bit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from narrowing import not_none

from wheelsight.core.calibration import FORMAT, Calibration, load_calibration, save_calibration
from wheelsight.core.calibration_parts import DepthNoise, Gyro, HolonomicWheels, Wheels
from wheelsight.core.errors import CalibrationError, OutputError
from wheelsight.core.geometry import PinholeCamera, se3

COLOR = PinholeCamera(640, 480, 517.3, 516.5, 318.6, 255.3, (0.2624, -0.9531, -0.0054, 0.0026, 1.1633))
DEPTH = PinholeCamera(512, 424, 365.0, 365.5, 255.0, 211.0)
T_COLOR_DEPTH = se3.exp([0.025, -0.001, 0.002, 0.01, -0.02, 0.003])
T_BASE_CAMERA = se3.exp([0.3, 0.0, 1.1, -1.2, 1.2, -1.2])

small = st.floats(-2, 2)


def camera(width: int, height: int, focal: list[float], x: float, y: float, *others: Any) -> PinholeCamera:
    fx, fy = (share * max(width, height) for share in focal)
    return PinholeCamera(width, height, fx, fy, x * width - 0.5, y * height - 0.5, *others)


cameras = st.builds(
    camera,
    *(st.integers(1, 5000), st.integers(1, 5000), st.lists(st.floats(0.11, 990), min_size=2, max_size=2)),
    *(st.floats(0.4, 0.6), st.floats(0.4, 0.6)),
    st.tuples(*[st.floats(-0.1, 0.1)] * 2, *[st.floats(-0.01, 0.01)] * 3),
).filter(lambda known: known.lens_fault() is None)
motions = st.none() | st.tuples(*[st.floats(-0.5, 0.5)] * 3, *[small] * 3).map(se3.exp)
wheels = st.none() | st.builds(
    Wheels,
    *(st.floats(0.005, 2), st.floats(0.005, 2), st.floats(0.02, 10), st.floats(1, 1e9), st.integers(0, 64), small),
    *(st.floats(1e-6, 1), st.floats(0.01, 100), st.floats(0.001, 3600)),
)
gyros = st.builds(Gyro, st.floats(1e-6, 10), small, st.floats(0, 1), st.floats(0, 1))
noises = st.builds(DepthNoise, st.floats(0, 1), st.floats(1e-6, 1), st.floats(0, 1), st.floats(1.5, 100))


def assert_same(first: Calibration, second: Calibration) -> None:
    assert (first.color, first.depth) == (second.color, second.depth)
    for name in ("depth_noise", "rolling_shutter_s", "color_sigma_px", "depth_late_s", "wheels", "gyro", "source"):
        assert getattr(first, name) == getattr(second, name)
    for name in ("T_color_depth", "T_base_camera"):
        np.testing.assert_equal(getattr(first, name), getattr(second, name))


@given(
    cameras,
    cameras,
    motions,
    motions,
    noises,
    st.floats(0, 0.2),
    st.floats(0, 0.9),
    wheels,
    gyros,
    st.text(max_size=20),
)
def test_yaml_keeps_everything_to_the_last_bit(
    tmp_path_factory: pytest.TempPathFactory,
    color: PinholeCamera,
    depth: PinholeCamera,
    T_color_depth: np.ndarray | None,
    T_base_camera: np.ndarray | None,
    noise: DepthNoise,
    shutter_s: float,
    sigma_px: float,
    wheels: Wheels | None,
    gyro: Gyro,
    source: str,
) -> None:
    depth = color if T_color_depth is None else depth
    calibration = Calibration(
        color,
        depth,
        T_color_depth,
        noise,
        shutter_s,
        sigma_px,
        T_base_camera,
        wheels,
        Gyro() if wheels is None else gyro,
        source,
    )
    path = tmp_path_factory.mktemp("calibration") / "calibration.yaml"
    save_calibration(calibration, path)
    assert_same(load_calibration(path), calibration)


def test_numpy_numbers_are_written_as_numbers(tmp_path: Path) -> None:
    numbers: list[Any] = [np.int64(640), np.int32(480), *np.array([500.0, 501.0, 320.0, 240.0]), np.zeros(5)]
    camera = PinholeCamera(*numbers)
    save_calibration(Calibration.registered_camera(camera), tmp_path / "c.yaml")
    assert load_calibration(tmp_path / "c.yaml").color == camera


def test_a_hand_written_file_needs_only_the_colour_camera(tmp_path: Path) -> None:
    path = tmp_path / "calibration.yaml"
    path.write_text(
        "# our robot\nformat: wheelsight-calibration-1\n"
        "color: {width: 640, height: 480, fx: 5.25e2, fy: 525, cx: 3195e-1, cy: 239.5}\n"
    )
    calibration = load_calibration(path)
    assert calibration.is_registered
    assert calibration.depth == calibration.color == PinholeCamera(640, 480, 525.0, 525.0, 319.5, 239.5)
    assert calibration.depth_noise == DepthNoise()
    assert calibration.T_base_camera is None


def document(**changes: Any) -> dict[str, Any]:
    camera = {"width": 640, "height": 480, "fx": 525.0, "fy": 525.0, "cx": 319.5, "cy": 239.5}
    return {"format": "wheelsight-calibration-1", "color": camera} | changes


def color(**changes: Any) -> dict[str, Any]:
    return document(color={k: v for k, v in (document()["color"] | changes).items() if v != "gone"})


def wheeled(**changes: Any) -> dict[str, Any]:
    wheels = {"left_radius_m": 0.17, "right_radius_m": 0.17, "track_width_m": 0.6, "ticks_per_turn": 3200}
    return {
        "format": "wheelsight-calibration-1",
        "wheels": {k: v for k, v in (wheels | changes).items() if v != "gone"},
    }


EYE = np.eye(4).tolist()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ([1, 2], "field calibration must hold names and values"),
        (None, "field calibration must hold names and values"),
        ({"color": {}}, "field format is None.*write format"),
        (document(format="other-2"), "field format is 'other-2'"),
        ({"format": "wheelsight-calibration-1"}, "field color is missing"),
        (document(colour={}), "unknown entry 'colour'.*known: format"),
        (document(color=3), "field color must hold"),
        (color(fx="gone"), "field color.fx is missing"),
        (color(width="gone"), "field color.width is missing"),
        (color(focal=3), "field color has an unknown entry 'focal'"),
        (color(fx="wide"), "field color.fx is 'wide', not a number"),
        (color(fx=True), "field color.fx is True, not a number"),
        (color(fx=None), "field color.fx is None, not a number"),
        (color(cy=float("nan")), "field color.cy is nan, not a number"),
        (color(fx=-5.0), "field color: .*must be positive"),
        (color(width=10**9), r"field color: width 1000000000 × height 480 .*larger.*at most 34 million"),
        (color(fx=1e14), r"field color: fx is 1e\+14, not 64 to 640000 px in an image of 640×480 .*in pixels"),
        (color(fy=0.82), r"field color: fy is 0.82, not 64 to 640000 px .*in pixels"),
        (color(distortion=[0, 0, 1e9, 0, 0]), r"field color: distortion holds 1e\+09, more than 10000"),
        (color(width=640.5), "field color.width is 640.5, not a whole number"),
        (color(distortion=[0.1, 0.2]), "field color.distortion takes five numbers"),
        (color(distortion=0.1), "field color.distortion takes five numbers"),
        (color(distortion=[0, 0, 0, 0, "x"]), "field color.distortion is 'x'"),
        (document(depth=None), "field depth must hold"),
        (document(depth=color(fx=300.0)["color"]), "no T_color_depth says how they are joined.*register"),
        (document(T_color_depth=[[1, 0], [0, 1]]), "field T_color_depth must be four rows"),
        (document(T_color_depth=[1, [2]]), "field T_color_depth must be four rows"),
        (document(T_color_depth="x"), "field T_color_depth must be four rows"),
        (document(T_base_camera=(2 * np.eye(4)).tolist()), "T_base_camera is not a rigid motion"),
        (document(T_base_camera=np.diag([1, 1, -1.0, 1]).tolist()), "T_base_camera is not a rigid motion"),
        (document(T_base_camera=[*EYE[:3], [0, 0, 1, 1]]), "T_base_camera is not a rigid motion"),
        (document(T_base_camera=[*EYE[:3], [0, 0, float("nan"), 1]]), "T_base_camera is not a rigid motion"),
        (document(T_base_camera=[*EYE[:2], [0, 0, 1, 1100], EYE[3]]), "T_base_camera is 1100, not 0 to 10 m .*are 1.1"),
        (
            document(depth=color()["color"], T_color_depth=[[1, 0, 0, 25], *EYE[1:]]),
            "T_color_depth is 25, not 0 to 1 m .*are 0.025",
        ),
        (document(depth_noise={"constant_m": 2.0}), "field depth_noise: constant_m is 2, not 0 to 1 m"),
        (document(depth_noise={"quadratic_per_m": 1.4}), "field depth_noise: quadratic_per_m is 1.4, not 0 to 1 1/m"),
        (document(depth_noise={"far_m": 4000}), "field depth_noise: far_m is 4000, not 0 to 1000 m .*are 4"),
        (document(depth_noise=0.01), "field depth_noise must hold"),
        (document(depth_noise={"sigma": 1}), "unknown entry 'sigma'.*known: constant_m"),
        (document(depth_noise={"constant_m": "big"}), "field depth_noise.constant_m is 'big'"),
        (document(depth_noise={"constant_m": -1.0}), "not negative"),
        (document(depth_noise={"constant_m": 0.0, "quadratic_per_m": 0.0}), "not both zero"),
        (document(rolling_shutter_s=-0.01), "rolling_shutter_s is -0.01, not 0 to 0.2"),
        (document(rolling_shutter_s="slow"), "field rolling_shutter_s is 'slow', not a number"),
        (document(color_sigma_px=-1.0), "color_sigma_px is -1.0, not 0 to"),
        (document(wheels=3), "field wheels must hold"),
        (wheeled(radius_m=0.1), "field wheels has an unknown entry 'radius_m'.*known: left_radius_m"),
        (wheeled(track_width_m="gone"), "field wheels.track_width_m is missing"),
        (wheeled(left_radius_m="round"), "field wheels.left_radius_m is 'round', not a number"),
        (wheeled(left_radius_m=0), "field wheels: left_radius_m is 0.0, not positive"),
        (wheeled(right_radius_m=-0.1), "field wheels: right_radius_m is -0.1, not positive"),
        (wheeled(track_width_m=float("inf")), "field wheels.track_width_m is inf, not a number"),
        (wheeled(ticks_per_turn=0), "field wheels: ticks_per_turn is 0.0, not positive"),
        (wheeled(ticks_per_turn=None), "field wheels.ticks_per_turn is None, not a number"),
        (wheeled(left_radius_m=170), r"left_radius_m is 170, not 0.005 to 2 m \(give metres: 170 mm are 0.17\)"),
        (wheeled(right_radius_m=17), r"right_radius_m is 17, not 0.005 to 2 m \(give metres"),
        (wheeled(left_radius_m=0.0017), "left_radius_m is 0.0017, not 0.005 to 2 m"),
        (wheeled(track_width_m=520), r"track_width_m is 520, not 0.02 to 10 m \(give metres: 520 mm are 0.52\)"),
        (wheeled(track_width_m=0.001), "track_width_m is 0.001, not 0.02 to 10 m"),
        (wheeled(ticks_per_turn=0.25), "ticks_per_turn is 0.25, not 1 to 1e.09"),
        (wheeled(ticks_per_turn=1e12), r"ticks_per_turn is 1e\+12, not 1 to 1e.09"),
        (wheeled(counter_bits=65), "field wheels: counter_bits is 65 .1 to 64, or 0"),
        (wheeled(counter_bits=-8), "field wheels: counter_bits is -8 .1 to 64, or 0"),
        (wheeled(counter_modulus=1), "field wheels: counter_modulus is 1 .9000 for a counter of 0 … 8999"),
        (wheeled(counter_modulus=-9000), "field wheels: counter_modulus is -9000"),
        (wheeled(counter_modulus=2.5), "field wheels.counter_modulus is 2.5, not a whole number$"),
        (wheeled(counter_modulus=9000, counter_bits=12), "counter_bits and counter_modulus are both given"),
        (wheeled(counter_bits=8.5), "field wheels.counter_bits is 8.5, not a whole number$"),
        (wheeled(delay_s=float("nan")), "field wheels.delay_s is nan, not a number"),
        (wheeled(delay_s=20), r"field wheels: delay_s is 20, not -10 to 10 s \(give seconds: 20 ms are 0.02\)"),
        (wheeled(delay_s=-1e9), "field wheels: delay_s is -1e.09, not -10 to 10 s"),
        (wheeled(slip_m_per_sqrt_m=1e9), "field wheels: slip_m_per_sqrt_m is 1e.09, not 0 to 1 m/√m"),
        (wheeled(max_speed_m_s=1e12), "field wheels: max_speed_m_s is 1e.12, not 0.01 to 100 m/s"),
        (wheeled(max_gap_s=1e12), "field wheels: max_gap_s is 1e.12, not 0.001 to 3600 s"),
        (wheeled(slip_m_per_sqrt_m=0), "field wheels: slip_m_per_sqrt_m is 0.0, not positive"),
        (wheeled(max_speed_m_s=-1), "field wheels: max_speed_m_s is -1.0, not positive"),
        (wheeled(max_gap_s=0), "field wheels: max_gap_s is 0.0, not positive"),
        (wheeled() | {"gyro": 1}, "field gyro must hold"),
        (wheeled() | {"gyro": {"bias": 1}}, "field gyro has an unknown entry 'bias'"),
        (wheeled() | {"gyro": {"bias_sigma_rad_s": -1}}, "field gyro: bias_sigma_rad_s is -1.0, not a number from 0"),
        (wheeled() | {"gyro": {"bias_rad_s": -1e9}}, "field gyro: bias_rad_s is -1e.09, not -10 to 10 rad/s"),
        (wheeled() | {"gyro": {"bias_sigma_rad_s": 1e9}}, "field gyro: bias_sigma_rad_s is 1e.09, not 0 to 10 rad/s"),
        (wheeled() | {"gyro": {"noise_rad_per_sqrt_s": 1e9}}, "field gyro: noise_rad_per_sqrt_s is 1e.09, not 0 to 10"),
        (wheeled() | {"gyro": {"bias_walk_rad_s_per_sqrt_s": 9}}, "bias_walk_rad_s_per_sqrt_s is 9, not 0 to 1"),
        (wheeled() | {"gyro": {"noise_rad_per_sqrt_s": 0}}, "no gyroscope is without noise"),
        (wheeled() | {"T_color_depth": EYE}, "field color is missing"),
        (wheeled() | {"depth_noise": {}}, "field color is missing"),
        (document(depth_noise={"near_m": 5.0, "far_m": 4.0}), "range 5.0 to 4.0 m is empty"),
    ],
)
def test_a_bad_file_is_named_with_field_and_problem(tmp_path: Path, content: Any, message: str) -> None:
    path = tmp_path / "calibration.yaml"
    path.write_text(yaml.safe_dump(content))
    with pytest.raises(CalibrationError, match=message) as caught:
        load_calibration(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"color: [1, 2\nfx: }", "is not YAML"),
        (b"\xff\xfe\x00", "is not a text file"),
        (b"a: \x07", "which YAML does not allow"),
        (b"", "field"),
    ],
)
def test_what_is_not_yaml_is_said_in_one_line(tmp_path: Path, data: bytes, message: str) -> None:
    path = tmp_path / "calibration.yaml"
    path.write_bytes(data)
    with pytest.raises(CalibrationError, match=message) as caught:
        load_calibration(path)
    assert "\n" not in str(caught.value)


def test_a_missing_file_and_a_folder_are_said(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match=r"none\.yaml: cannot be read: No such file"):
        load_calibration(tmp_path / "none.yaml")
    with pytest.raises(CalibrationError, match="is a folder, not a file"):
        load_calibration(tmp_path)


def test_no_code_is_run_from_a_file(tmp_path: Path) -> None:
    path = tmp_path / "calibration.yaml"
    path.write_text("!!python/object/apply:os.mkdir ['made']\n")
    with pytest.raises(CalibrationError, match=r"calibration.yaml:1: has the tag .*os.mkdir"):
        load_calibration(path)


def test_saving_into_a_missing_folder(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="does not exist"):
        save_calibration(Calibration.registered_camera(COLOR), tmp_path / "nowhere" / "c.yaml")


def test_cameras_that_differ_need_the_motion_between_them() -> None:
    with pytest.raises(CalibrationError, match="no T_color_depth"):
        Calibration(COLOR, DEPTH)
    assert not Calibration(COLOR, DEPTH, T_COLOR_DEPTH).is_registered
    assert Calibration.registered_camera(COLOR).is_registered


def test_a_calibration_cannot_be_changed_from_outside() -> None:
    T = T_BASE_CAMERA.copy()
    calibration = Calibration.registered_camera(COLOR, T_base_camera=T)
    T[0, 3] = 99.0
    np.testing.assert_array_equal(calibration.T_base_camera, T_BASE_CAMERA)
    with pytest.raises(ValueError, match="read-only"):
        not_none(calibration.T_base_camera)[0, 3] = 99.0


def test_a_stack_of_motions_is_not_one() -> None:
    with pytest.raises(CalibrationError, match="not a rigid motion"):
        Calibration.registered_camera(COLOR, T_base_camera=np.stack([T_BASE_CAMERA] * 2))


def test_depth_noise_grows_with_the_square_of_depth() -> None:
    noise = DepthNoise(constant_m=0.001, quadratic_per_m=0.002)
    np.testing.assert_allclose(noise.sigma_m([0.0, 1.0, 3.0]), [0.001, 0.003, 0.019], atol=1e-15)
    assert DepthNoise().sigma_m(2.0) == pytest.approx(6.7e-3)


WHEELS = Wheels(0.17, 0.16, 0.6, 3200.0, counter_bits=16)


def test_a_robot_may_have_wheels_alone(tmp_path: Path) -> None:
    path = tmp_path / "calibration.yaml"
    path.write_text(yaml.safe_dump(wheeled()))
    calibration = load_calibration(path)
    assert calibration.wheels == Wheels(0.17, 0.17, 0.6, 3200.0)
    assert calibration.color is None
    assert calibration.depth is None
    with pytest.raises(CalibrationError, match=r"has no cameras .give color"):
        _ = calibration.cameras


def test_a_camera_has_two_halves() -> None:
    with pytest.raises(CalibrationError, match="one camera of two is missing"):
        Calibration(color=COLOR, wheels=WHEELS)
    with pytest.raises(CalibrationError, match="T_color_depth is given, but no camera"):
        Calibration(wheels=WHEELS, T_color_depth=T_COLOR_DEPTH)


def test_a_tick_is_a_part_of_the_wheels_circumference() -> None:
    assert WHEELS.left_m_per_tick == pytest.approx(2 * np.pi * 0.17 / 3200)
    assert WHEELS.right_m_per_tick == pytest.approx(2 * np.pi * 0.16 / 3200)


def test_a_calibration_of_the_wheels_leaves_the_cameras_as_they_are() -> None:
    gyro = Gyro(bias_rad_s=0.01)
    robot = Calibration(COLOR, DEPTH, T_COLOR_DEPTH, T_base_camera=T_BASE_CAMERA, wheels=WHEELS, source="factory")
    better = Calibration(wheels=Wheels(0.18, 0.17, 0.61, 3200.0), gyro=gyro, source="squares")
    updated = robot.updated_by(better)
    assert updated.cameras == (COLOR, DEPTH)
    assert (updated.wheels, updated.gyro) == (better.wheels, gyro)
    assert updated.source == "factory, updated by: squares"
    np.testing.assert_array_equal(updated.T_base_camera, T_BASE_CAMERA)


def test_a_calibration_of_the_cameras_leaves_the_wheels_as_they_are() -> None:
    robot = Calibration(COLOR, DEPTH, T_COLOR_DEPTH, T_base_camera=T_BASE_CAMERA, wheels=WHEELS)
    updated = robot.updated_by(Calibration.registered_camera(COLOR, color_sigma_px=0.5))
    assert updated.wheels == WHEELS
    assert updated.cameras == (COLOR, COLOR)
    assert updated.is_registered
    assert updated.color_sigma_px == 0.5
    np.testing.assert_array_equal(updated.T_base_camera, T_BASE_CAMERA)


def test_a_mount_updates_the_mount_alone(tmp_path: Path) -> None:
    """What `calibrate base` writes: wheels and mount, no lens."""
    robot = Calibration(COLOR, DEPTH, T_COLOR_DEPTH, T_base_camera=np.eye(4), wheels=WHEELS)
    path = tmp_path / "base.yaml"
    save_calibration(Calibration(T_base_camera=T_BASE_CAMERA, wheels=replace(WHEELS, delay_s=0.02)), path)
    updated = robot.updated_by(load_calibration(path))
    np.testing.assert_array_equal(updated.T_base_camera, T_BASE_CAMERA)
    np.testing.assert_array_equal(updated.T_color_depth, T_COLOR_DEPTH)
    assert updated.cameras == (COLOR, DEPTH)
    assert updated.wheels == replace(WHEELS, delay_s=0.02)


@pytest.mark.parametrize(
    ("counter", "span"), [({}, 0), ({"counter_bits": 12}, 4096), ({"counter_modulus": 9000}, 9000)]
)
def test_counters_of_any_width_or_modulus_keep_it_in_a_file(tmp_path: Path, counter: dict[str, int], span: int) -> None:
    save_calibration(Calibration(wheels=Wheels(0.17, 0.17, 0.6, 3200.0, **counter)), tmp_path / "c.yaml")
    read = load_calibration(tmp_path / "c.yaml").wheels
    assert read is not None
    assert read.counter_span == span
    assert read.never_rolling_over.counter_span == 0
    assert isinstance(yaml.safe_load((tmp_path / "c.yaml").read_text())["wheels"]["counter_modulus"], int)


def test_the_camera_frame_is_the_colour_camera_s_where_depth_was_registered() -> None:
    np.testing.assert_array_equal(Calibration.registered_camera(COLOR).T_color_camera, np.eye(4))
    apart = Calibration(color=COLOR, depth=DEPTH, T_color_depth=T_COLOR_DEPTH)
    np.testing.assert_array_equal(apart.T_color_camera, T_COLOR_DEPTH)


MECANUM = HolonomicWheels("mecanum", radius_m=0.05, half_length_m=0.2, half_width_m=0.15, ticks_per_turn=4096)
OMNI = HolonomicWheels(
    "omni",
    radius_m=0.04,
    distance_m=0.18,
    angles_rad=(1.0472, 3.1416, 5.236),
    ticks_per_turn=2000,
    counter_bits=16,
    delay_s=0.01,
    turn_sigma=0.02,
)


@pytest.mark.parametrize("wheels", [MECANUM, OMNI, HolonomicWheels("increments")], ids=lambda wheels: wheels.layout)
def test_holonomic_wheels_come_back_from_their_file(wheels: HolonomicWheels, tmp_path: Path) -> None:
    path = tmp_path / "calibration.yaml"
    save_calibration(Calibration(holonomic=wheels), path)
    assert "kind: holonomic" in path.read_text()
    back = load_calibration(path)
    assert (back.holonomic, back.wheels, back.any_wheels) == (wheels, None, wheels)


def _loaded(folder: Path, *texts: str) -> Calibration:
    paths = [folder / f"{index}.yaml" for index in range(len(texts))]
    for path, text in zip(paths, texts, strict=True):
        path.write_text(f"format: {FORMAT}\nwheels: {{{text}}}\n")
    return load_calibration(*paths)


_MECANUM = "kind: holonomic, layout: mecanum, radius_m: 0.05, half_length_m: 0.2, half_width_m: 0.15"
_OMNI = "kind: holonomic, layout: omni, radius_m: 0.05, distance_m: 0.2, ticks_per_turn: 4096"
_TWO = "left_radius_m: 0.1, right_radius_m: 0.1, track_width_m: 0.4, ticks_per_turn: 1000"


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (_MECANUM, r"field wheels.ticks_per_turn is missing \(layout mecanum needs radius_m"),
        ("kind: holonomic", r"field wheels.layout is None \(one of mecanum, omni, increments"),
        ("kind: mecanum", r"field wheels.kind is 'mecanum' \(differential or holonomic"),
        (f"{_MECANUM}, ticks_per_turn: 4096, track_width_m: 0.4", "unknown entry 'track_width_m'"),
        (f"{_OMNI}, angles_rad: [60, 180, 300]", "not -2π to 2π .radians: 60° are 1.0472"),
        (f"{_OMNI}, angles_rad: [0.0, 0.1, 0.2]", "do not measure every direction"),
        (f"{_OMNI}, angles_rad: [0.0, 3.1416]", "angles_rad has 2 angles .one a wheel, three or four"),
        (f"{_OMNI}, angles_rad: 1.0", "angles_rad is no list"),
        (f"{_MECANUM}, ticks_per_turn: 4096, counter_bits: 70", "counter_bits is 70"),
        (f"{_MECANUM}, ticks_per_turn: 4096, slip_m_per_sqrt_m: 0", "slip_m_per_sqrt_m is 0"),
        (_MECANUM.replace("0.05", "50") + ", ticks_per_turn: 4096", r"radius_m is 50, .*50 mm are 0.05"),
    ],
)
def test_holonomic_wheels_that_cannot_be_are_refused_by_field(text: str, problem: str, tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match=problem) as refused:
        _loaded(tmp_path, text)
    assert str(refused.value).startswith(str(tmp_path / "0.yaml"))


def test_layers_of_one_kind_merge_and_of_another_replace(tmp_path: Path) -> None:
    delayed = _loaded(tmp_path, f"{_MECANUM}, ticks_per_turn: 4096", "delay_s: 0.02").holonomic
    assert delayed is not None
    assert (delayed.radius_m, delayed.delay_s) == (0.05, 0.02)
    replaced = _loaded(tmp_path, f"{_TWO}, delay_s: 0.02", f"{_MECANUM}, ticks_per_turn: 4096")
    assert (replaced.holonomic, replaced.wheels) == (MECANUM, None)
    assert _loaded(tmp_path, f"{_MECANUM}, ticks_per_turn: 1", f"kind: differential, {_TWO}").wheels is not None
    two = Calibration(wheels=Wheels(0.1, 0.1, 0.4, 1000))
    assert two.updated_by(Calibration(holonomic=OMNI)).any_wheels == OMNI
    assert Calibration(holonomic=OMNI).updated_by(two).any_wheels == two.wheels


def test_a_robot_has_one_kind_of_wheels() -> None:
    with pytest.raises(CalibrationError, match="wheels and holonomic are both given"):
        Calibration(wheels=Wheels(0.1, 0.1, 0.4, 1000), holonomic=MECANUM)


@pytest.mark.parametrize("name", ["color", "depth"])
def test_a_distortion_that_is_no_lens_is_refused_with_its_numbers(tmp_path: Path, name: str) -> None:
    """Wherever it comes from: each way into a run makes a calibration, that of a file as well."""
    wrong = replace(COLOR, distortion=(1389.0, -512.0, 103.0, 1420.0, -480.0))
    cameras = {"color": COLOR, "depth": DEPTH, name: wrong}
    with pytest.raises(CalibrationError, match=rf"\(1389, -512, 103, 1420, -480\) of {name} folds"):
        Calibration(cameras["color"], cameras["depth"], T_COLOR_DEPTH)
    save_calibration(Calibration(COLOR, DEPTH, T_COLOR_DEPTH), tmp_path / "calibration.yaml")
    document = yaml.safe_load((tmp_path / "calibration.yaml").read_text())
    document[name]["distortion"] = list(wrong.distortion)
    (tmp_path / "calibration.yaml").write_text(yaml.safe_dump(document))
    with pytest.raises(CalibrationError, match=r"calibration\.yaml.*1389, -512"):
        load_calibration(tmp_path / "calibration.yaml")
