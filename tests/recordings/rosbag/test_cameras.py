"""Cameras by CameraInfo and their places by tf."""

from __future__ import annotations

import re

import numpy as np
import pytest
from narrowing import not_none
from written_bags import (
    COLOR,
    DEPTH,
    DEPTH_OPTICAL,
    FOCAL_PX,
    HEIGHT,
    LOOKS_AHEAD,
    OPTICAL,
    WIDTH,
    Drive,
    Messages,
    camera_drive,
    color_image,
    depth_mm,
)

from wheelsight.core.calibration import Calibration, save_calibration
from wheelsight.core.errors import CalibrationError, RecordingError
from wheelsight.core.geometry import PinholeCamera, se3
from wheelsight.core.messages import RgbdFrame
from wheelsight.io.recordings.bags.images import camera_of

MAKE, MAKE1 = Messages(is_ros1=False), Messages(is_ros1=True)
INFO = "/camera/color/camera_info"
RAW_DEPTH = "/camera/depth/image_rect_raw"
T_BASE_CAMERA = se3.from_quaternion([0.1, 0.0, 0.4], LOOKS_AHEAD)


@pytest.mark.parametrize("make", [MAKE, MAKE1])
def test_brown_distortion(make: Messages) -> None:
    D = (0.1, -0.2, 0.001, 0.002, 0.05)
    camera, reported = camera_of(make.info(OPTICAL, D=D), False)
    assert (camera.width, camera.height, camera.fx, camera.cx) == (WIDTH, HEIGHT, FOCAL_PX, (WIDTH - 1) / 2)
    assert camera.distortion == D
    assert reported is None


def test_a_rectified_image_has_the_projections_numbers_and_no_distortion() -> None:
    P = [50.0, 0, 30, 0, 0, 51, 22, 0, 0, 0, 1, 0]
    camera, _ = camera_of(MAKE.info(OPTICAL, D=(0.1, 0, 0, 0, 0), P=P), True)
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (50, 51, 30, 22)
    assert not camera.has_distortion


def test_a_part_of_the_sensor_with_joined_pixels() -> None:
    whole, _ = camera_of(MAKE.info(OPTICAL), False)
    part, _ = camera_of(MAKE.info(OPTICAL, roi=(8, 16, 24, 32), binning=2), False)
    assert (part.width, part.height) == (16, 12)
    p = np.array([0.05, -0.02, 1.0])
    px, _ = whole.project(p)
    # Corners of pixels, not their middles, go along with joining.
    np.testing.assert_allclose(part.project(p)[0], (px + 0.5 - [8, 16]) / 2 - 0.5)


def test_eight_coefficients_are_fitted_by_five() -> None:
    rational = (0.4, 0.02, 1e-4, -2e-4, 0.001, 0.3, 0.01, 0.002)
    wide = {"fx": 400.0, "width": 640, "height": 480}
    camera, reported = camera_of(MAKE.info(OPTICAL, "rational_polynomial", rational, **wide), False)
    assert reported is None
    k1, k2, p1, p2, k3, k4, k5, k6 = rational
    x, y = np.meshgrid(np.linspace(-0.8, 0.8, 9), np.linspace(-0.6, 0.6, 7))
    r2 = x**2 + y**2
    radial = (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3) / (1 + k4 * r2 + k5 * r2**2 + k6 * r2**3)
    seen = np.stack(
        [x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2), y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y]
    )
    wanted = 400 * np.moveaxis(seen, 0, -1) + [camera.cx, camera.cy]
    assert np.abs(camera.denormalise(np.stack([x, y], -1)) - wanted).max() < 0.5


def test_a_lens_that_five_coefficients_miss_is_said_by_its_median_and_share() -> None:
    wild = (30.0, 5.0, 0.0, 0.0, 1.0, 29.0, 16.0, 0.5)
    _, reported = camera_of(MAKE.info(OPTICAL, "rational_polynomial", wild, fx=320.0, width=640, height=480), False)
    assert "0.81 px in the median, and by more than 0.5 px in 69 % of the image" in not_none(reported)


def test_a_pole_outside_the_image_spoils_no_fit() -> None:
    """1 - 1.2 r² is 0 at r = 0.91, within the image's size but beyond what it shows: 0.68 in its corners."""
    pole = (-0.3, 0.1, 0.0, 0.0, 0.0, -1.2, 0.0, 0.0)
    info = MAKE.info(OPTICAL, "rational_polynomial", pole, fx=350.0, width=640, height=480)
    camera, reported = camera_of(info, False)
    assert "0.16 px in the median, and by more than 0.5 px in 1 % of the image" in not_none(reported)
    p = np.array([0.5, 0.3, 1.0])
    r2 = 0.34
    seen = p[:2] * (1 - 0.3 * r2 + 0.1 * r2**2) / (1 - 1.2 * r2)
    np.testing.assert_allclose(camera.project(p)[0], 350 * seen + [camera.cx, camera.cy], atol=0.5)


def test_a_rational_lens_that_shows_little_of_the_image_is_refused() -> None:
    info = MAKE.info(OPTICAL, "rational_polynomial", (1389.0, -512, 103, 1420, -480, 0, 0, 0))
    with pytest.raises(CalibrationError, match="of the image show no point"):
        camera_of(info, False)


@pytest.mark.parametrize(
    ("D", "problem"),
    [
        ((1389, -512, 103, 1420, -480), "(1389, -512, 103, 1420, -480) folds the image"),
        ((1389, -512, 0, 0, 0), "stretches the image"),
        ((-1389, 512, 0, 0, 0), "folds the image: 100 %"),
        ((-0.9, 0, 0, 0, 0), "folds the image"),
    ],
)
def test_a_lens_that_folds_or_stretches_within_its_image_is_none(opened, D, problem: str) -> None:
    drive = camera_drive().without(INFO)
    drive.add(0.0, INFO, drive.make.info(OPTICAL, D=D))
    with pytest.raises(CalibrationError, match=re.escape(problem)) as caught:
        opened(drive)
    assert INFO in str(caught.value)


def test_two_cameras_that_carry_one_frame_are_not_joined(opened) -> None:
    drive = unregistered(with_tf=False)
    renamed = Drive()
    for at_s, topic, message in drive.messages:
        if hasattr(message, "header"):
            message.header.frame_id = "0"
        renamed.add(at_s, topic, message)
    with pytest.raises(CalibrationError, match=r"carry one frame with different CameraInfo.*realsense:FILE"):
        opened(renamed)


@pytest.mark.parametrize(
    ("info", "problem"),
    [
        (MAKE.info(OPTICAL, fx=0.0), "not calibrated"),
        (MAKE.info(OPTICAL, "equidistant", (0.1, 0.1, 0.1, 0.1)), "'equidistant', which is no pinhole"),
    ],
)
def test_a_camera_that_cannot_be_used(info, problem: str) -> None:
    with pytest.raises(CalibrationError, match=problem):
        camera_of(info, False)


@pytest.mark.parametrize("is_ros1", [True, False])
def test_the_mount_comes_from_tf(opened, is_ros1: bool) -> None:
    recording = opened(camera_drive(is_ros1))
    calibration = recording.calibration
    np.testing.assert_allclose(calibration.T_base_camera, T_BASE_CAMERA, atol=1e-12)
    assert calibration.is_registered
    assert calibration.color == PinholeCamera(WIDTH, HEIGHT, FOCAL_PX, FOCAL_PX, (WIDTH - 1) / 2, (HEIGHT - 1) / 2)
    assert recording.warnings == ()


def test_a_footprint_on_the_ground_is_the_base(opened) -> None:
    drive = camera_drive()
    drive.add(0.0, "/tf", drive.make.tf(("base_footprint", "base_link", (0, 0, 0.2), (0, 0, 0, 1))))
    np.testing.assert_allclose(opened(drive).calibration.T_base_camera[:3, 3], [0.1, 0, 0.6], atol=1e-12)


def test_without_tf_the_mount_is_not_known(opened) -> None:
    recording = opened(camera_drive().without("/tf_static"))
    assert recording.calibration.T_base_camera is None
    assert recording.body == "camera"
    assert any("calibrate base" in warning for warning in recording.warnings)


def test_a_camera_on_a_moving_neck_has_no_mount(opened) -> None:
    drive = camera_drive().without("/tf_static")
    for number in range(5):
        mount = ("base_link", OPTICAL, (0.1, 0.01 * number, 0.4), LOOKS_AHEAD)
        drive.add(0.1 * number, "/tf", drive.make.tf(mount))
    recording = opened(drive)
    assert recording.calibration.T_base_camera is None
    assert any(f"base_link to {OPTICAL} moves" in warning for warning in recording.warnings)


def test_tf_that_contradicts_itself_is_said(opened) -> None:
    drive = camera_drive()
    again = [("base_link", "camera_link", (0.5, 0, 0), (0, 0, 0, 1)), ("mast", OPTICAL, (0, 0, 0), LOOKS_AHEAD)]
    drive.add(0.2, "/tf_static", drive.make.tf(*again))
    recording = opened(drive)
    reported = [warning for warning in recording.warnings if "contradicts itself" in warning]
    assert len(reported) == 2
    np.testing.assert_allclose(recording.calibration.T_base_camera, T_BASE_CAMERA, atol=1e-12)


def test_numbers_that_are_no_rotation_are_left_out(opened) -> None:
    drive = camera_drive()
    broken = [("base_link", "arm", (0, 0, 0), (0, 0, 0, 0)), ("base_link", "hand", (float("nan"), 0, 0), (0, 0, 0, 1))]
    drive.add(0.0, "/tf", drive.make.tf(*broken))
    assert sum("no rigid motion" in warning for warning in opened(drive).warnings) == 2


def test_a_bodys_frame_is_taken_for_an_optical_one_and_said(opened) -> None:
    drive = camera_drive().without("/tf_static")
    drive.add(0.0, "/tf_static", drive.make.tf(("base_link", OPTICAL, (0.1, 0.0, 0.4), (0, 0, 0, 1))))
    recording = opened(drive)
    np.testing.assert_allclose(recording.calibration.T_base_camera, T_BASE_CAMERA, atol=1e-12)
    assert any("looks upwards" in warning for warning in recording.warnings)


def unregistered(with_tf: bool = True) -> Drive:
    """Depth of its own, smaller camera, 15 mm beside the colour camera."""
    drive = camera_drive().without(DEPTH)
    for number in range(3):
        taken_s = 0.1 + number / 30
        small = np.ascontiguousarray(depth_mm(number)[::2, ::2])
        drive.add(taken_s + 0.05, RAW_DEPTH, drive.make.image(taken_s, DEPTH_OPTICAL, "16UC1", small))
    info = drive.make.info(DEPTH_OPTICAL, fx=30.0, width=WIDTH // 2, height=HEIGHT // 2)
    drive.add(0.0, "/camera/depth/camera_info", info)
    if with_tf:
        drive.add(0.0, "/tf", drive.make.tf((OPTICAL, DEPTH_OPTICAL, (0.015, 0, 0), (0, 0, 0, 1))))
    return drive


def test_depth_that_is_not_registered_is_joined_by_tf(opened) -> None:
    recording = opened(unregistered())
    calibration = recording.calibration
    np.testing.assert_allclose(calibration.T_color_depth[:3, 3], [0.015, 0, 0])
    assert (calibration.depth.fx, calibration.depth.width) == (30, WIDTH // 2)
    # The camera's frame is that in which depth is measured.
    np.testing.assert_allclose(calibration.T_base_camera[:3, 3], [0.1, -0.015, 0.4], atol=1e-12)
    assert any("not registered" in warning for warning in recording.warnings)
    frames = [event for event in recording.events() if isinstance(event, RgbdFrame)]
    assert [frame.depth_m.shape for frame in frames] == [(HEIGHT // 2, WIDTH // 2)] * 3


def test_depth_that_nothing_joins_is_refused(opened) -> None:
    with pytest.raises(CalibrationError, match="tf does not join them"):
        opened(unregistered(with_tf=False))


def test_without_camera_info_a_camera_must_be_given(opened, tmp_path) -> None:
    drive = camera_drive().without(INFO)
    with pytest.raises(CalibrationError, match=f"no CameraInfo describes the camera of {COLOR}"):
        opened(drive)
    camera = PinholeCamera(WIDTH, HEIGHT, 60.0, 60.0, 31.5, 23.5)
    save_calibration(Calibration.registered_camera(camera), tmp_path / "camera.yaml")
    calibration = opened(drive, camera=str(tmp_path / "camera.yaml")).calibration
    assert calibration.color.fx == 60
    np.testing.assert_allclose(calibration.T_base_camera, T_BASE_CAMERA, atol=1e-12)


def test_camera_info_of_another_size_is_refused(opened) -> None:
    drive = camera_drive().without(INFO)
    drive.add(0.0, INFO, drive.make.info(OPTICAL, width=2 * WIDTH, height=2 * HEIGHT, fx=100.0))
    with pytest.raises(RecordingError, match="colour image is 64×48, the calibration's 128×96"):
        opened(drive)


def two_cameras() -> Drive:
    drive = camera_drive()
    for number in range(3):
        taken_s = 0.1 + number / 30
        image = drive.make.image(taken_s, "rear", "rgb8", 255 - color_image(number))
        drive.add(taken_s + 0.05, "/rear/color/image_raw", image)
        image = drive.make.image(taken_s, "rear", "16UC1", depth_mm(number))
        drive.add(taken_s + 0.05, "/rear/aligned_depth_to_color/image_raw", image)
    return drive.add(0.0, "/rear/color/camera_info", drive.make.info("rear", fx=70.0))


def test_of_two_cameras_one_is_taken_and_said_and_the_other_can_be_chosen(opened) -> None:
    recording = opened(two_cameras())
    assert recording.calibration.color.fx == FOCAL_PX
    assert any("several cameras" in warning for warning in recording.warnings)
    used = {topic.used_as: topic.name for topic in recording.topics if topic.used_as}
    assert used == {"color": COLOR, "depth": DEPTH, "color_info": INFO}
    rear = opened(two_cameras(), topics=("color=/rear/color/image_raw", "depth=/rear/aligned_depth_to_color/image_raw"))
    assert rear.calibration.color.fx == 70
    assert len(list(rear.events())) == 3
