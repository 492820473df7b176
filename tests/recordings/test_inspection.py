from __future__ import annotations

import math
from dataclasses import replace
from itertools import islice
from pathlib import Path

import cv2
import numpy as np
import pytest
from grids import mostly_slow
from stand_ins import MemoryRecording
from synthetic import CAMERA, make_tum_recording, render_room, wobbling_trajectory

from wheelsight.core.calibration import Calibration
from wheelsight.core.calibration_parts import DepthNoise
from wheelsight.core.geometry import ByteArray
from wheelsight.core.messages import Event, RgbdFrame, SkippedFrame, WheelTicks
from wheelsight.io.recordings import OpenOptions, open_recording
from wheelsight.io.recordings.images import DepthEncoding, read_depth
from wheelsight.io.recordings.inspection import Inspection, RegistrationOffset, inspect_recording

REGISTERED = Calibration.registered_camera(CAMERA)


def flat(index: int, stamp_s: float, depth_m: float = 2.0, measured: int = 240) -> RgbdFrame:
    """A grey frame before a wall; depth is measured in the upper `measured` rows."""
    depth = np.zeros((240, 320), np.float32)
    depth[:measured] = depth_m
    return RgbdFrame(stamp_s, np.full((240, 320, 3), 99, np.uint8), depth, index)


def inspect(events: list[Event], calibration: Calibration = REGISTERED) -> Inspection:
    return inspect_recording(MemoryRecording(events, calibration=calibration))


def moved(color: ByteArray, right: float, down: float, scale: float) -> ByteArray:
    """The image shown larger about its middle, then moved."""
    height, width = color.shape[:2]
    A = cv2.getRotationMatrix2D(((width - 1) / 2, (height - 1) / 2), 0.0, scale)
    A[:, 2] += np.array([right, down])
    return np.asarray(cv2.warpAffine(color, A, (width, height), borderMode=cv2.BORDER_REFLECT), np.uint8)


def room_frames(right: float = 0, down: float = 0, scale: float = 1, number: int = 4) -> list[Event]:
    frames: list[Event] = []
    for index, (stamp_s, T_frame_camera) in enumerate(wobbling_trajectory(number, rate_hz=number / 8)):
        color, depth_m = render_room(T_frame_camera)
        frames.append(RgbdFrame(stamp_s, moved(color, right, down, scale), depth_m, index))
    return frames


def test_counts_rates_and_gaps() -> None:
    stamps_s = [0.0, 0.1, 0.2, 0.3, 0.9, 1.0, 1.25]
    events: list[Event] = [flat(index, stamp_s) for index, stamp_s in enumerate(stamps_s)]
    events[2] = SkippedFrame(0.2, "cut off", 2)
    events.insert(1, WheelTicks(0.05, 1, 1))
    inspection = inspect(events)
    assert (inspection.frames, inspection.wheel_readings) == (7, 1)
    assert inspection.skipped == (("cut off", 1),)
    assert inspection.duration_s == pytest.approx(1.25)
    assert inspection.rate_hz == pytest.approx(10)
    (gap,) = inspection.gaps
    assert gap.start_s == 0.3
    assert gap.length_s == pytest.approx(0.6)


def test_depth_is_reported_by_share_and_percentiles() -> None:
    inspection = inspect([flat(0, 0.0, 1.0), flat(1, 0.1, 2.0), flat(2, 0.2, 4.0, measured=120)])
    assert inspection.valid_depth_share == pytest.approx((1 + 1 + 0.5) / 3)
    assert inspection.depth_m["p5"] == pytest.approx(1.0, rel=0.003)
    assert inspection.depth_m["median"] == pytest.approx(2.0, rel=0.003)
    assert inspection.depth_m["p95"] == pytest.approx(4.0, rel=0.003)


def test_a_recording_without_a_usable_frame_is_reported_too() -> None:
    inspection = inspect([SkippedFrame(0.0, "cut off", 0)])
    assert math.isnan(inspection.valid_depth_share)
    assert math.isnan(inspection.depth_m["median"])
    assert inspection.offset is None
    assert inspection.warnings == ()


def test_depth_outside_the_trusted_range_is_warned_of() -> None:
    noise = DepthNoise(near_m=0.5, far_m=5.0)
    calibration = Calibration.registered_camera(CAMERA, depth_noise=noise)
    for depth_m, suspicious in ((0.4, True), (1.0, False), (12.0, True)):
        warned = any("--depth-factor" in warning for warning in inspect([flat(0, 0.0, depth_m)], calibration).warnings)
        assert warned is suspicious


def test_a_blank_wall_does_not_tell_whether_colour_is_registered() -> None:
    assert inspect([flat(index, 0.1 * index) for index in range(4)]).offset is None


def test_registered_images_are_found_so() -> None:
    inspection = inspect(room_frames())
    assert inspection.offset is not None
    assert not inspection.offset.is_clear
    assert inspection.warnings == ()


@pytest.mark.parametrize(("right", "down", "scale"), [(9, 0, 1.0), (-6, 3, 1.0), (0, 0, 1.06), (4, 0, 0.94)])
def test_images_that_are_not_registered_are_measured(right: float, down: float, scale: float) -> None:
    inspection = inspect(room_frames(right, down, scale))
    offset = inspection.offset
    assert offset is not None
    assert offset.is_clear
    assert offset.shift_px == pytest.approx((right, down), abs=1.01)
    assert offset.scale == pytest.approx(scale, abs=0.02)
    assert any("not registered, though the calibration says so" in warning for warning in inspection.warnings)


def test_an_offset_is_reported_in_words() -> None:
    words = str(RegistrationOffset((-8.0, 2.0), 0.9, strength=1.0, strength_as_is=0.1))
    assert words == (
        "in the middle of the image colour lies 8 px left and 2 px down of depth, and shows things 0.90 times as large"
    )


def test_a_calibration_that_knows_of_it_is_not_warned_of() -> None:
    calibration = Calibration(replace(CAMERA, cx=CAMERA.cx + 9), CAMERA, T_color_depth=np.eye(4))
    inspection = inspect(room_frames(9), calibration)
    assert inspection.offset is not None
    assert inspection.offset.is_clear
    assert inspection.warnings == ()


@pytest.mark.parametrize(("right", "reported"), [(0, "colour and depth share pixels"), (-9, "colour lies 9 px left")])
def test_a_calibration_that_images_contradict_is_probably_another_cameras(right: int, reported: str) -> None:
    calibration = Calibration(replace(CAMERA, cx=CAMERA.cx + 9), CAMERA, T_color_depth=np.eye(4), source="nominal")
    (warning,) = inspect(room_frames(right), calibration).warnings
    assert warning.startswith("The calibration (nominal) says that colour and depth are not registered, but by the")
    assert reported in warning
    assert "--camera" in warning
    near = Calibration(replace(CAMERA, cx=CAMERA.cx + 2), CAMERA, T_color_depth=np.eye(4))
    assert inspect(room_frames(), near).warnings == ()


@pytest.mark.parametrize("scale", mostly_slow([0.55, 0.71, 0.8, 1.25, 1.4, 1.8], quick=[0.55, 1.25]))
def test_depth_of_another_lens_is_reported_with_how_much_it_shows(scale: float) -> None:
    inspection = inspect(room_frames(4, -3, scale, number=8))
    assert inspection.offset is not None
    assert inspection.offset.scale == pytest.approx(scale, rel=0.04)
    assert inspection.offset.shift_px == pytest.approx((4, -3), abs=4)
    (warning,) = inspection.warnings
    assert "Colour and depth are not registered, though the calibration says so" in warning


@pytest.mark.parametrize(
    ("across", "along", "reported"),
    [(-1, 1, "mirrored left to right"), (1, -1, "upside down"), (-1, -1, "turned by 180°")],
)
@pytest.mark.parametrize("registered", [True, False])
def test_images_that_are_mirrored_against_each_other_are_reported(
    across: int, along: int, reported: str, registered: bool
) -> None:
    frames = [replace(f, color=f.color[::along, ::across].copy()) for f in room_frames() if isinstance(f, RgbdFrame)]
    calibration = REGISTERED if registered else Calibration(CAMERA, CAMERA, T_color_depth=np.eye(4))
    (warning,) = inspect([*frames], calibration).warnings
    assert warning.startswith("Colour and depth are mirrored against each other")
    assert reported in warning


@pytest.mark.parametrize(("share", "reported"), [(0.1, False), (0.3, True)])
def test_much_depth_nearer_than_the_sensor_measures_is_a_wrong_scale(share: float, reported: bool) -> None:
    depth_m = np.full((240, 320), 0.6, np.float32)
    depth_m[: int(240 * share)] = 0.2
    (frame,) = [replace(flat(0, 0.0), depth_m=depth_m)]
    warnings = inspect([frame], Calibration.registered_camera(CAMERA, depth_noise=DepthNoise(near_m=0.45))).warnings
    assert any("--depth-factor 1000" in warning for warning in warnings) is reported


def test_truth_is_reported_in_zhangs_figures(tmp_path: Path) -> None:
    truth = make_tum_recording(tmp_path / "room", frames=4)
    calls: list[None] = []
    inspection = inspect_recording(open_recording(tmp_path / "room"), lambda: calls.append(None))
    assert len(calls) == 4
    assert inspection.ground_truth is not None
    assert inspection.ground_truth.duration_s == pytest.approx(truth.duration_s, abs=1e-5)
    assert inspection.to_dict()["association"]["pairs"] == 4


def every_32nd_frame(folder: Path) -> tuple[Calibration, list[RgbdFrame]]:
    """Of a real recording's first 256 events, as if it had no others."""
    recording = open_recording(folder, OpenOptions())
    frames = [event for event in islice(recording.events(), 256) if isinstance(event, RgbdFrame)][::32]
    return recording.calibration, [replace(frame, index=number) for number, frame in enumerate(frames)]


@pytest.fixture(scope="module")
def handheld(data_folder: Path) -> tuple[Calibration, list[RgbdFrame]]:
    return every_32nd_frame(data_folder / "rgbd" / "freiburg1_rpy_part")


@pytest.mark.data
def test_a_real_camera_whose_colour_lies_elsewhere(data_folder: Path) -> None:
    """A colour camera of f = 525 beside a depth camera of 585."""
    calibration, frames = every_32nd_frame(data_folder / "rgbd" / "red_kitchen")
    offset = inspect([*frames], calibration).offset
    assert offset is not None
    assert offset.is_clear
    assert offset.scale == pytest.approx(525 / 585, abs=0.02)
    assert offset.shift_px[0] == pytest.approx(-8, abs=4)


@pytest.mark.data
def test_a_real_camera_that_is_registered(handheld: tuple[Calibration, list[RgbdFrame]]) -> None:
    calibration, frames = handheld
    offset = inspect([*frames], calibration).offset
    assert offset is not None
    assert not offset.is_clear
    assert np.abs(offset.shift_px).max() <= 4
    assert offset.scale == 1


@pytest.mark.data
@pytest.mark.parametrize(
    ("turned", "reported"),
    mostly_slow(
        [((1, 1), None), ((1, -1), "mirrored left to right"), ((-1, 1), "upside down"), ((-1, -1), "turned by 180°")],
        quick=[((1, -1), "mirrored left to right")],
    ),
)
def test_real_images_mirrored_against_each_other(
    handheld: tuple[Calibration, list[RgbdFrame]], turned: tuple[int, int], reported: str | None
) -> None:
    calibration, frames = handheld
    along, across = turned
    events = [replace(frame, color=frame.color[::along, ::across].copy()) for frame in frames]
    warnings = inspect([*events], calibration).warnings
    assert not warnings if reported is None else reported in warnings[0]


@pytest.mark.data
def test_a_real_cameras_own_depth_is_not_its_depth_laid_on_colour(data_folder: Path) -> None:
    """A D435i: 611 px of focal length for colour, about 425 px for depth."""
    folder = data_folder / "rgbd" / "openloris_sample"
    if not folder.is_dir():
        pytest.skip("the recording is not there")
    aligned = open_recording(folder)
    offset = inspect_recording(aligned).offset
    assert offset is not None
    assert not offset.is_clear
    raw = [
        replace(event, depth_m=read_depth(path, DepthEncoding(1000.0)))
        for event, path in zip(aligned.events(), sorted((folder / "depth").glob("*.png")), strict=False)
        if isinstance(event, RgbdFrame)
    ]
    offset = inspect([*raw], aligned.calibration).offset
    assert offset is not None
    assert offset.is_clear
    assert offset.scale == pytest.approx(611 / 425, abs=0.07)


def test_images_that_came_before_are_counted() -> None:
    frames = [frame for frame in room_frames() if isinstance(frame, RgbdFrame)]
    twice = [frame for f in frames for frame in (f, replace(f, stamp_s=f.stamp_s + 1.0))]
    (warning,) = inspect([replace(frame, index=number) for number, frame in enumerate(twice)]).warnings
    assert warning.startswith("4 of 8 frames show the same image as the frame before")
