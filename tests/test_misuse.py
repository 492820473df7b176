"""What people hand in by mistake, at each way in: one typed line that names the field, what came, and what to do."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from synthetic import CAMERA, render_room, wobbling_trajectory

from wheelsight import Calibration, Localizer, RgbdFrame, Wheels, WheelTicks, YawRate, open_recording
from wheelsight.config import load_config
from wheelsight.core.calibration_parts import DepthNoise, Gyro
from wheelsight.core.errors import ArgumentError, CalibrationError, InputError, MapError
from wheelsight.core.geometry import PinholeCamera, se3, so3
from wheelsight.core.keyframes import FrameSurface
from wheelsight.core.messages import Event, WheelSpeeds
from wheelsight.io.recordings import RecordingWriter
from wheelsight.mapping import SurfelMap
from wheelsight.vision.dense import DenseOdometry
from wheelsight.vision.features import FeatureOdometry
from wheelsight.wheels import WheelOdometry

Process = Callable[[Event], Any]

MOUNT = np.array([[0.0, 0, 1, 0.3], [-1, 0, 0, 0], [0, -1, 0, 1.1], [0, 0, 0, 1]])
WHEELS = Wheels(0.17, 0.17, 0.52, 3200.0)
CALIBRATION = Calibration.registered_camera(CAMERA, wheels=WHEELS, T_base_camera=MOUNT)
COLOR, DEPTH_M = render_room(wobbling_trajectory(1).T_frame_body[0])
FRAME = RgbdFrame(1.0, COLOR, DEPTH_M)


def localizer(odometry: str) -> Process:
    return Localizer(CALIBRATION, load_config(overrides={"odometry": odometry})).process


ODOMETRIES: dict[str, Callable[[], Any]] = {
    "FeatureOdometry": lambda: FeatureOdometry(CALIBRATION),
    "DenseOdometry": lambda: DenseOdometry(CALIBRATION),
    "WheelOdometry": lambda: WheelOdometry(WHEELS),
}
FRAMES_GO_IN = ("RecordingWriter", "FeatureOdometry", "DenseOdometry", "features", "dense", "wheels,dense")
READINGS_GO_IN = ("RecordingWriter", "WheelOdometry", "wheels", "wheels,dense")


@pytest.fixture
def begin(tmp_path: Path) -> Iterator[Callable[[str], Process]]:
    """Given one of the ways in, begins: what takes events there."""
    with ExitStack() as opened:

        def begun(way_in: str) -> Process:
            if way_in == "RecordingWriter":
                return opened.enter_context(RecordingWriter(tmp_path / "recording", CALIBRATION)).add
            process: Process = ODOMETRIES[way_in]().process if way_in in ODOMETRIES else localizer(way_in)
            return process

        yield begun


Begin = Callable[[str], Process]


def spoilt(image: np.ndarray, value: float) -> np.ndarray:
    image = image.copy()
    image[7, 11] = value
    return image


WRONG_IMAGES: dict[str, tuple[dict[str, Any], str]] = {
    "raw millimetres": (
        {"depth_m": (1000 * DEPTH_M).astype(np.uint16)},
        r"depth_m is of uint16, not float32 \(.*\(depth / 1000\).astype\(np.float32\)",
    ),
    "millimetres": ({"depth_m": 1000 * DEPTH_M}, r"depth_m is \d+.* no metres \(.*millimetres by 1000"),
    "TUM's units": ({"depth_m": 5000 * DEPTH_M}, r"depth_m is \d+.* no metres \(.*TUM's files by 5000"),
    "divided twice": ({"depth_m": DEPTH_M / 1000}, r"depth_m is 0.00\d+ m at most.*\(divide raw depth once"),
    "doubles": ({"depth_m": DEPTH_M.astype(float)}, r"depth_m is of float64.*\(depth_m.astype\(np.float32\)\)"),
    "depth not a number": ({"depth_m": spoilt(DEPTH_M, np.nan)}, r"depth_m has numbers.*not finite \(0 where nothing"),
    "depth infinite": ({"depth_m": spoilt(DEPTH_M, np.inf)}, r"depth_m has numbers.*not finite \(0 where nothing"),
    "depth negative": ({"depth_m": spoilt(DEPTH_M, -0.5)}, r"depth_m is -0.5 m somewhere \(depth grows forwards"),
    "depth of half the size": (
        {"depth_m": DEPTH_M[::2, ::2]},
        r"depth_m is of shape \(120, 160\).*calibration of 160×120 ones, with fx, fy, cx, cy times 0.5.*T_color_depth",
    ),
    "depth turned": ({"depth_m": DEPTH_M.T}, r"depth_m is of shape \(320, 240\).*transpose.*or swap width and height"),
    "depth with a channel": ({"depth_m": DEPTH_M[..., None]}, r"depth_m is of shape.*\(depth_m.squeeze\(\)\)"),
    "depth as a picture": ({"depth_m": COLOR}, r"depth_m is of shape.*\(give depth itself, not a picture"),
    "no depth": ({"depth_m": None}, r"depth_m is None, not an array \(240, 320\)"),
    "grey": ({"color": COLOR[..., 0]}, r"color is of shape \(240, 320\), not .*\(of a grey image, cv2.cvtColor"),
    "four channels": ({"color": np.dstack([COLOR, COLOR[..., :1]])}, r"color is of shape.*\(color\[..., :3\]"),
    "channels first": ({"color": COLOR.transpose(2, 0, 1)}, r"color is of shape.*\(color.transpose\(1, 2, 0\)\)"),
    "colour of 0 to 1": ({"color": (COLOR / 255).astype(np.float32)}, r"color is of float32.*\(of 0 to 1, \(255 \* "),
    "colour of 0 to 255": ({"color": COLOR.astype(float)}, r"color is of float64.*\(of 0 to 255, color.astype"),
    "colour of 16 bits": ({"color": COLOR.astype(np.uint16) << 8}, r"color is of uint16.*color >> 8"),
    "colour turned": ({"color": COLOR.transpose(1, 0, 2)}, r"color is of shape.*transpose.*or swap width and height"),
    "both of half the size": (
        {"color": COLOR[::2, ::2], "depth_m": DEPTH_M[::2, ::2]},
        r"color is of shape \(120, 160, 3\), not \(240, 320, 3\) \(the calibration is of 320×240 images",
    ),
    "a stamp as text": ({"stamp_s": "1.0"}, "stamp_s of RgbdFrame is a str, not a number"),
}


@pytest.mark.parametrize("mistake", WRONG_IMAGES)
@pytest.mark.parametrize("way_in", FRAMES_GO_IN)
def test_a_wrong_frame_is_refused_with_what_to_do(begin: Begin, way_in: str, mistake: str) -> None:
    change, reported = WRONG_IMAGES[mistake]
    process = begin(way_in)
    with pytest.raises(ArgumentError, match=reported):
        process(replace(FRAME, **change))


@pytest.mark.parametrize("way_in", ["FeatureOdometry", "DenseOdometry", "RecordingWriter"])
def test_a_frame_without_a_time_is_refused_where_no_clock_is_kept(begin: Begin, way_in: str) -> None:
    with pytest.raises(ArgumentError, match="stamp_s of RgbdFrame is nan"):
        begin(way_in)(replace(FRAME, stamp_s=np.nan))


@pytest.mark.parametrize("way_in", FRAMES_GO_IN)
def test_arrays_need_not_be_contiguous_nor_writable(begin: Begin, tmp_path: Path, way_in: str) -> None:
    """Views of a driver's buffer: every second row of a larger one, Fortran's order, read-only."""
    color, depth_m = np.repeat(COLOR, 2, axis=0)[::2], np.asfortranarray(DEPTH_M)
    color.flags.writeable = depth_m.flags.writeable = False
    process = begin(way_in)
    if way_in == "wheels,dense":
        process(WheelTicks(1.0, 0, 0))
    answer = process(RgbdFrame(1.0, color, depth_m))
    if way_in == "RecordingWriter":
        read = next(event for event in open_recording(tmp_path / "recording").events() if isinstance(event, RgbdFrame))
        np.testing.assert_array_equal(read.color, COLOR)
        np.testing.assert_allclose(read.depth_m, DEPTH_M, atol=1e-4)
    else:
        assert answer.T_odom_body is not None


def test_one_pixel_far_away_makes_no_millimetres(begin: Begin) -> None:
    """A stereo camera's wrong match may be anywhere."""
    for way_in in FRAMES_GO_IN:
        begin(way_in)(replace(FRAME, depth_m=spoilt(DEPTH_M, 900.0)))


UNITS = {"milliseconds": (1e3, "1e3"), "microseconds": (1e6, "1e6"), "nanoseconds": (1e9, "1e9")}


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("start_s", [100.0, 1.76e9])
@pytest.mark.parametrize("way_in", FRAMES_GO_IN)
def test_frames_stamped_in_other_units_are_refused(begin: Begin, way_in: str, start_s: float, unit: str) -> None:
    """Stamps over 150 years old are refused at the first frame, others once four frames show their step."""
    per_second, divisor = UNITS[unit]
    process, unsaid = begin(way_in), 0 if start_s * per_second > 5e9 else 3
    reported = (
        "no seconds since any time .divide milliseconds" if unsaid == 0 else f"{unit}, not seconds .divide by {divisor}"
    )
    for k in range(unsaid):
        process(replace(FRAME, stamp_s=(start_s + k / 30) * per_second))
    frame = replace(FRAME, stamp_s=(start_s + unsaid / 30) * per_second)
    for _ in range(2):
        with pytest.raises(ArgumentError, match=f"stamp_s of RgbdFrame is .*: {reported}"):
            process(frame)


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("way_in", READINGS_GO_IN)
def test_so_are_readings(begin: Begin, way_in: str, unit: str) -> None:
    per_second, divisor = UNITS[unit]
    process = begin(way_in)
    for k in range(3):
        process(WheelTicks((2.0 + k / 50) * per_second, 10 * k, 10 * k))
    with pytest.raises(ArgumentError, match=f"stamp_s of WheelTicks is .*: {unit}, not seconds .divide by {divisor}"):
        process(WheelTicks(2.06 * per_second, 30, 30))


@pytest.mark.parametrize("rate_hz", [0.5, 1.0, 30.0, 200.0])
@pytest.mark.parametrize("start_s", [0.0, -3.0, 1.76e9])
def test_seconds_of_any_rate_are_seconds(begin: Begin, start_s: float, rate_hz: float) -> None:
    process = begin("wheels")
    answers = [process(WheelTicks(start_s + k / rate_hz, k, k)) for k in range(8)]
    assert all(answer is not None for answer in answers)


WRONG_READINGS: dict[str, tuple[Event, str]] = {
    "metres for counts": (WheelTicks(0.0, 0.17, 0), r"left of WheelTicks is 0.17, not a whole number of counts \(give"),  # type: ignore[arg-type]
    "half a count": (WheelTicks(0.0, 3, np.float32(2.5)), r"right of WheelTicks is 2.5, not a whole number"),  # type: ignore[arg-type]
    "counts as text": (WheelTicks(0.0, "3", 2), "left of WheelTicks is a str, not a number"),  # type: ignore[arg-type]
    "a list": (YawRate(0.0, [1.0]), "yaw_rate_rad_s of YawRate is a list"),  # type: ignore[arg-type]
    "no stamp": (WheelTicks(None, 1, 2), "stamp_s of WheelTicks is None"),  # type: ignore[arg-type]
}


@pytest.mark.parametrize("mistake", WRONG_READINGS)
@pytest.mark.parametrize("way_in", READINGS_GO_IN)
def test_a_wrong_reading_is_refused(begin: Begin, way_in: str, mistake: str) -> None:
    event, reported = WRONG_READINGS[mistake]
    with pytest.raises(ArgumentError, match=reported):
        begin(way_in)(event)


def test_whole_counts_are_counts_of_whatever_type(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "new", None) as new:
        new.add(WheelTicks(0.0, 3.0, np.int64(4)))  # type: ignore[arg-type]
    assert (tmp_path / "new" / "wheels.csv").read_text().splitlines()[-1] == "0.000000,3,4"


@pytest.mark.parametrize(
    "event",
    [
        WheelTicks(0.0, np.nan, 2),  # type: ignore[arg-type]
        WheelTicks(np.inf, 1, 2),
        YawRate(0.0, np.nan),
    ],
)
def test_what_could_not_be_read_again_is_not_recorded(tmp_path: Path, event: Event) -> None:
    with RecordingWriter(tmp_path / "new", CALIBRATION) as new, pytest.raises(ArgumentError, match=r"is (nan|inf)"):
        new.add(event)


def test_a_yaw_rate_beside_a_reading_is_a_number() -> None:
    with pytest.raises(ArgumentError, match="yaw_rate_rad_s is a str"):
        WheelOdometry(WHEELS).process(WheelSpeeds(0.0, 1.0, 1.0), "0.1")  # type: ignore[arg-type]


WRONG_PARTS: dict[str, tuple[Callable[[], object], str]] = {
    "radius in mm": (lambda: Wheels(170, 170, 0.52, 3200), r"left_radius_m is 170, .*\(give metres: 170 mm are 0.17"),
    "track in mm": (lambda: Wheels(0.17, 0.17, 520, 3200), r"track_width_m is 520, .*\(give metres: 520 mm are 0.52"),
    "delay in ms": (lambda: replace(WHEELS, delay_s=20.0), r"delay_s is 20, .*\(give seconds: 20 ms are 0.02"),
    "a radius as text": (lambda: Wheels("0.17", 0.17, 0.52, 3200), "left_radius_m of Wheels is a str, not a number"),  # type: ignore[arg-type]
    "no track": (lambda: Wheels(0.17, 0.17, None, 3200), "track_width_m of Wheels is a NoneType"),  # type: ignore[arg-type]
    "radius nan": (lambda: Wheels(0.17, np.nan, 0.52, 3200), "right_radius_m is nan"),
    "noise as text": (lambda: DepthNoise("1"), "constant_m of DepthNoise is a str"),  # type: ignore[arg-type]
    "far in mm": (lambda: DepthNoise(far_m=8000), r"far_m is 8000, .*\(give metres: 8000 mm are 8"),
    "gyro nan": (lambda: Gyro(bias_rad_s=np.nan), "bias_rad_s is nan"),
    "a width as text": (lambda: PinholeCamera("640", 480, 525, 525, 320, 240), "width of a camera is a str"),  # type: ignore[arg-type]
    "half a pixel": (lambda: PinholeCamera(640.5, 480, 525, 525, 320, 240), "width is 640.5, not a whole number"),  # type: ignore[arg-type]
    "focal length in mm": (lambda: PinholeCamera(640, 480, 1.93, 1.93, 320, 240), r"fx is 1.93, .*\(give the focal"),
    "no distortion": (lambda: PinholeCamera(640, 480, 525, 525, 320, 240, None), "distortion takes five numbers"),  # type: ignore[arg-type]
    "K for a camera": (lambda: Calibration.registered_camera(np.eye(3)), r"color is a ndarray \(give it as Pinhole"),  # type: ignore[arg-type]
    "a radius for wheels": (lambda: Calibration(wheels=0.17), r"wheels is a float \(give it as Wheels"),  # type: ignore[arg-type]
    "a shutter as text": (lambda: seen_by(CAMERA, rolling_shutter_s="0"), "rolling_shutter_s of Calibration is a str"),
    "shutter in ms": (lambda: seen_by(CAMERA, rolling_shutter_s=26.0), "rolling_shutter_s is 26, not 0 to 0.2 s"),
    "of 640×480 in 320×240": (
        lambda: seen_by(PinholeCamera(320, 240, 525, 525, 319.5, 239.5)),
        r"principal point \(319.5, 239.5\) of color is far.*320×240 image \(.*by about 0.5",
    ),
    "of 320×240 in 640×480": (
        lambda: seen_by(PinholeCamera(640, 480, 262, 262, 159.5, 119.5)),
        r"\(159.5, 119.5\) of color is far.*640×480 image \(.*by about 2,",
    ),
    "of 1280×720 in 1920×1080": (
        lambda: seen_by(PinholeCamera(1920, 1080, 910, 910, 640.2, 355.0)),
        r"\(640.2, 355\) of color is far.*1920×1080 image \(.*by about 1.5,",
    ),
    "principal point left out": (
        lambda: seen_by(PinholeCamera(640, 480, 525, 525, 0, 0)),
        r"\(cx, cy are pixels",
    ),
    "width and height swapped": (
        lambda: seen_by(PinholeCamera(480, 640, 525, 525, 319.5, 239.5)),
        r"\(319.5, 239.5\) of color is that of a 640×480 image \(swap width and height",
    ),
}


def seen_by(camera: PinholeCamera, **others: Any) -> Calibration:
    return Calibration.registered_camera(camera, **others)


@pytest.mark.parametrize("mistake", WRONG_PARTS)
def test_a_wrong_calibration_is_refused_where_it_is_made(mistake: str) -> None:
    make, reported = WRONG_PARTS[mistake]
    with pytest.raises(CalibrationError, match=reported):
        make()


@pytest.mark.parametrize(
    "camera",
    [
        PinholeCamera(640, 480, 517.3, 516.5, 318.6, 255.3),  # a Kinect v1's
        PinholeCamera(512, 424, 365.0, 365.5, 255.0, 211.0),  # a Kinect v2's
        PinholeCamera(848, 480, 424.0, 424.0, 423.5, 239.5),  # a RealSense's
        PinholeCamera(480, 640, 525.0, 525.0, 239.5, 319.5),  # one on its side
        PinholeCamera(640, 240, 525.0, 525.0, 319.5, 30.0),  # rows cut out
    ],
)
def test_cameras_that_are_there_are_taken(camera: PinholeCamera) -> None:
    assert seen_by(camera).color == camera


def rotated(R: Any, t: Any = (0.3, 0.0, 1.1)) -> np.ndarray:
    return se3.from_parts(np.asarray(R, float), np.asarray(t, float))


R_MOUNT = MOUNT[:3, :3]
WRONG_MOTIONS: dict[str, tuple[Any, str]] = {
    "mirrored": (rotated(np.diag([1, 1, -1.0]) @ R_MOUNT), r"its rotation mirrors, determinant -1 \(turn one axis"),
    "rows for columns": (MOUNT.T, r"its translation stands in the last row \(transpose it"),
    "three rows": (MOUNT[:3], r"it is of shape \(3, 4\), not \(4, 4\) \(rotation and translation in three rows"),
    "a position": ([0.3, 0.0, 1.1], r"it is of shape \(3,\), not \(4, 4\)"),
    "scaled": (rotated(2 * R_MOUNT), r"its rotation is scaled by 2 \(divide"),
    "few digits": (rotated(np.round(so3.exp([0.3, -0.2, 0.5]), 2)), r"orthonormal within 0.0\d+, not .*\(give more d"),
    "angles": (rotated(np.diag([90.0, 0.0, -90.0])), r"its rotation is not orthonormal \(its columns are the axes"),
    "not a number": (np.where(np.arange(16).reshape(4, 4) == 3, np.nan, MOUNT), "not finite"),
    "a last row": (np.vstack([MOUNT[:3], [0.1, 0, 0, 1]]), r"its last row is 0.1 0 0 1, not 0 0 0 1 \(give"),
}


@pytest.mark.parametrize("name", ["T_base_camera", "T_color_depth"])
@pytest.mark.parametrize("mistake", WRONG_MOTIONS)
def test_a_mount_that_is_none_is_refused_by_what_is_wrong(name: str, mistake: str) -> None:
    T, reported = WRONG_MOTIONS[mistake]
    with pytest.raises(CalibrationError, match=f"{name} is not a rigid motion: .*{reported}"):
        seen_by(CAMERA, **{name: T})


@pytest.mark.parametrize("mistake", sorted(set(WRONG_MOTIONS) - {"three rows", "a position"}))
def test_so_is_an_expected_motion_and_the_pose_of_a_map(mistake: str) -> None:
    T, reported = WRONG_MOTIONS[mistake]
    with pytest.raises(ArgumentError, match=f"prior .*{reported}"):
        FeatureOdometry(CALIBRATION).process(FRAME, T)
    with pytest.raises(MapError, match=f"T_map_camera is not a rigid motion: .*{reported}"):
        SurfelMap().fuse(SURFACE, GRID, T, 0.0)


@pytest.mark.parametrize("T", ["there", None, [[1, 2], [3]]])
def test_what_is_no_matrix_is_no_mount_and_no_pose(T: Any) -> None:
    with pytest.raises(MapError, match="T_map_camera is "):
        SurfelMap().fuse(SURFACE, GRID, T, 0.0)
    if T is not None:
        with pytest.raises(CalibrationError, match=r"T_base_camera is a \w+, not \(4, 4\) of numbers"):
            seen_by(CAMERA, T_base_camera=T)


def test_a_mount_in_mm_is_reported_as_metres() -> None:
    with pytest.raises(CalibrationError, match=r"T_base_camera is 1140.18, not 0 to 10 m \(give metres: 1140.18 mm"):
        seen_by(CAMERA, T_base_camera=rotated(R_MOUNT, [300.0, 0.0, 1100.0]))


SHAPE, GRID = (12, 16), np.array([14.0, 14.0, 7.5, 5.5])
SURFACE = FrameSurface(
    np.full(SHAPE, 2.0, np.float32),
    np.broadcast_to(np.array([0, 0, -1], np.float32), (*SHAPE, 3)),
    np.full(SHAPE, 99.0, np.float32),
)


@pytest.mark.parametrize(
    ("change", "reported"),
    [
        ({"depth_m": np.full(SHAPE, 2000.0, np.float32)}, r"depth_m is 2000 .*no metres \(.*millimetres by 1000"),
        ({"depth_m": np.full(SHAPE, 2000, np.uint16)}, r"depth_m is of uint16, not float32 \(.*depth / 1000"),
        ({"depth_m": np.full(SHAPE, 0.002, np.float32)}, "depth_m is 0.002 m at most"),
        ({"depth_m": SURFACE.depth_m.tolist()}, "depth_m is a list, not an array"),
        ({"depth_m": SURFACE.depth_m[::2, ::2]}, r"normal is of shape \(12, 16, 3\), not \(6, 8, 3\)"),
        ({"grey": np.full(SHAPE, 99, np.uint8)}, r"grey is of uint8, not float32 \(0 to 255, -1 where unknown"),
        ({"color": np.zeros((*SHAPE, 4), np.float32)}, r"color is of shape \(12, 16, 4\), not \(12, 16, 3\)"),
        ({"normal": None}, "normal is a NoneType, not an array"),
    ],
)
def test_a_map_takes_no_surface_that_is_none(change: dict[str, Any], reported: str) -> None:
    surfel_map = SurfelMap()
    with pytest.raises(MapError, match=reported):
        surfel_map.fuse(replace(SURFACE, **change), GRID, np.eye(4), 0.0)
    assert surfel_map.frames == len(surfel_map) == 0
    surfel_map.fuse(SURFACE, GRID, np.eye(4), 0.0)
    assert len(surfel_map) > 0


WRONG_BEGINNINGS: dict[str, tuple[Callable[[], object], str]] = {
    "a path": (lambda: Localizer("robot.yaml"), r"calibration is a str, not a Calibration \(load_calibration\(PATH\)"),  # type: ignore[arg-type]
    "no calibration": (lambda: Localizer(None), "calibration is None, not a Calibration"),  # type: ignore[arg-type]
    "the odometry's name": (lambda: Localizer(CALIBRATION, "dense"), r"config is a str, not a Config \(load_config"),  # type: ignore[arg-type]
    "a camera": (lambda: FeatureOdometry(CAMERA), r"calibration is a PinholeCamera.*registered_camera\(CAMERA\)"),  # type: ignore[arg-type]
    "a matrix": (lambda: DenseOdometry(np.eye(3)), "calibration is a ndarray, not a Calibration"),  # type: ignore[arg-type]
    "a whole robot": (lambda: WheelOdometry(CALIBRATION), r"wheels is a Calibration.*\(calibration.wheels\)"),  # type: ignore[arg-type]
    "an unknown integration": (lambda: WheelOdometry(WHEELS, "rk4"), r"integration is 'rk4' \(one of euler, midpoint"),  # type: ignore[arg-type]
    "a rotation alone": (
        lambda: FeatureOdometry(CALIBRATION, None, np.eye(3)),
        r"T_map_first is of shape \(3, 3",
    ),
    "a scaled pose": (
        lambda: DenseOdometry(CALIBRATION, None, None, rotated(2 * R_MOUNT)),
        "T_map_first.*scaled",
    ),
    "3 numbers": (
        lambda: FeatureOdometry(CALIBRATION).process(FRAME, twist=np.zeros(3)),
        r"twist is of shape \(3,",
    ),
    "no twist": (lambda: DenseOdometry(CALIBRATION).process(FRAME, twist=np.full(6, np.nan)), "twist has.*not finite"),
}


@pytest.mark.parametrize("mistake", WRONG_BEGINNINGS)
def test_what_is_begun_with_is_looked_at(mistake: str) -> None:
    make, reported = WRONG_BEGINNINGS[mistake]
    with pytest.raises(ArgumentError, match=reported):
        make()


def test_a_recording_is_not_begun_of_no_calibration(tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match="calibration is a str"):
        RecordingWriter(tmp_path / "new", "robot.yaml")  # type: ignore[arg-type]
    assert not (tmp_path / "new").exists()


def test_every_message_says_what_to_do() -> None:
    """In brackets, at the end of one line that a terminal shows whole."""
    for number, (change, _) in enumerate(WRONG_IMAGES.values()):
        if "stamp_s" in change:
            continue
        with pytest.raises(InputError) as caught:
            FeatureOdometry(CALIBRATION).process(replace(FRAME, stamp_s=float(number), **change))
        assert caught.value.fix
        assert "\n" not in str(caught.value)
        assert len(str(caught.value)) < 260
