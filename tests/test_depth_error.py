"""What a depth camera is off by: the closed form, images as single readings, files, and recordings freed of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from wheelsight.core.calibration import Calibration, load_calibration, save_calibration
from wheelsight.core.depth_errors import NO_DISPARITY, DepthError, depth_error_fields, depth_error_from, pattern_weights
from wheelsight.core.errors import CalibrationError
from wheelsight.core.geometry import PinholeCamera
from wheelsight.core.messages import RgbdFrame
from wheelsight.io.recordings import RecordingWriter, open_recording
from wheelsight.io.recordings.native import write_recording

CAMERA = PinholeCamera(64, 48, 60.0, 61.0, 31.0, 24.5, (0.1, -0.2, 0.001, -0.002, 0.05))
FULL = DepthError(
    scale=1.01,
    offset_m=-0.02,
    radial_m=0.03,
    inverse_per_m=0.004,
    fade_m=0.5,
    pattern_per_m=((0.001, 0.002, -0.001), (0.0, 0.003, 0.001)),
    lasting_per_m=((0.002, 0.001, 0.0), (-0.002, 0.003, 0.001)),
    curve_m=((1.0, 0.005), (2.0, -0.004), (3.0, 0.0)),
)
DISPARITY = DepthError(disparity_at_zero_per_m=3.1, disparity_step_per_m=-0.00285)

errors = st.builds(
    DepthError,
    *(st.floats(0.6, 1.9), st.floats(-0.9, 0.9), st.floats(-0.9, 0.9), st.floats(-0.9, 0.9), st.floats(0, 9)),
    st.sampled_from([(), ((0.1, 0.2), (0.3, -0.4))]),
    st.sampled_from([(), ((0.2, 0.0), (0.3, -0.1), (0.1, 0.1))]),
    st.sampled_from([(), ((0.5, 0.01), (2.0, -0.02))]),
)


def by_hand(error: DepthError, z: float, x: float, y: float, pattern: float, lasting: float) -> float:
    q = 1 / z + error.inverse_per_m + lasting + pattern * np.exp(error.fade_m * (1 / z - 1))
    knots = np.array(error.curve_m)
    return float(
        error.scale / q + error.offset_m + error.radial_m * (x**2 + y**2) + np.interp(1 / q, knots[:, 0], knots[:, 1])
    )


def test_a_reading_is_corrected_as_the_formula_says() -> None:
    for px, z in (((10.0, 7.0), 1.3), ((60.0, 40.0), 2.6), ((0.0, 0.0), 5.0)):
        x, y = CAMERA.normalise(px)
        a, b = px[0] / 63 * 2, px[1] / 47
        i = min(int(a), 1)
        patterns = []
        for knots in (FULL.pattern_per_m, FULL.lasting_per_m):
            rows = [row[i] * (1 - (a - i)) + row[i + 1] * (a - i) for row in knots]
            patterns.append(rows[0] * (1 - b) + rows[1] * b)
        expected = by_hand(FULL, z, x, y, *patterns)
        np.testing.assert_allclose(FULL.of_readings([z], [px], CAMERA), expected, rtol=1e-12)


def test_images_are_corrected_as_single_readings_are(rng: np.random.Generator) -> None:
    depth_m = rng.uniform(0.5, 4, (48, 64)).astype(np.float32)
    depth_m[3, 5] = 0
    found = FULL.corrected(depth_m, CAMERA)
    v, u = np.nonzero(depth_m)
    px = np.stack([u, v], axis=-1).astype(float)
    np.testing.assert_allclose(found[v, u], FULL.of_readings(depth_m[v, u], px, CAMERA), rtol=1e-5)
    assert found[3, 5] == 0
    assert found.dtype == np.float32


def test_nothing_is_lost_where_nothing_is_off(rng: np.random.Generator) -> None:
    depth_m = rng.uniform(0.5, 4, (48, 64)).astype(np.float32)
    assert DepthError().corrected(depth_m, CAMERA) is depth_m
    assert DISPARITY.corrected(depth_m, CAMERA) is depth_m
    assert DepthError().changes_nothing
    assert not DISPARITY.changes_nothing


def test_what_would_lie_behind_the_camera_is_not_measured() -> None:
    error = DepthError(offset_m=-0.5)
    found = error.corrected(np.array([[0.4, 0.6]], np.float32), CAMERA)
    np.testing.assert_allclose(found, [[0, 0.1]], atol=1e-6)


def test_weights_of_a_pattern_add_up_to_one(rng: np.random.Generator) -> None:
    px = rng.uniform(0, 47, (50, 2))
    np.testing.assert_allclose(pattern_weights(px, CAMERA, (4, 5)).sum(axis=1), 1)


def test_disparities_become_depths() -> None:
    raw = np.array([[700, 1000, NO_DISPARITY, 1090]], np.uint16)
    depth_m = DISPARITY.of_disparity(raw)
    np.testing.assert_allclose(depth_m[0, :2], [1 / (3.1 - 0.00285 * 700), 1 / (3.1 - 0.00285 * 1000)], rtol=1e-5)
    assert depth_m[0, 2] == depth_m[0, 3] == 0  # none, and one behind infinity


@given(errors)
def test_a_file_keeps_it_to_the_last_bit(error: DepthError) -> None:
    document = yaml.safe_load(yaml.safe_dump(depth_error_fields(error)))
    assert depth_error_from(document) == error


def test_a_calibration_file_holds_it_and_another_lens_drops_it(tmp_path: Path) -> None:
    one = Calibration.registered_camera(CAMERA, depth_error=FULL)
    save_calibration(one, tmp_path / "one.yaml")
    assert load_calibration(tmp_path / "one.yaml").depth_error == FULL
    save_calibration(Calibration.registered_camera(replace(CAMERA, fx=70.0)), tmp_path / "two.yaml")
    assert load_calibration(tmp_path / "one.yaml", tmp_path / "two.yaml").depth_error.changes_nothing


@pytest.mark.parametrize(
    ("wrong", "reported"),
    [
        ({"scale": 1000}, "scale is 1000, not 0.5 to 2"),
        ({"offset_m": 24}, "offset_m is 24, not -1 to 1 m"),
        ({"offset_m": "far"}, "offset_m is 'far', not a number"),
        ({"pattern_per_m": [[0.1, 0.2], [0.1]]}, "no grid"),
        ({"pattern_per_m": [[0.1, 2.0], [0.1, 0.1]]}, "pattern_per_m is 2"),
        ({"pattern_per_m": 0.1}, "list of lists"),
        ({"curve_m": [[2, 0.1], [1, 0.1]]}, "not in order of depth"),
        ({"curve_m": [[2, 0.1, 3]]}, "no list of pairs"),
        ({"disparity_step_per_m": -0.00285}, "both"),
        ({"slope": 1}, "unknown entry 'slope'"),
    ],
)
def test_what_no_depth_camera_has_is_refused(wrong: dict[str, object], reported: str) -> None:
    with pytest.raises(CalibrationError, match="depth_error") as refusal:
        depth_error_from(wrong)
    assert reported in str(refusal.value)


def recording_with(folder: Path, calibration: Calibration) -> Path:
    """A wall at 1.5 m, then the calibration it is to be read by."""
    with RecordingWriter(folder, Calibration.registered_camera(CAMERA)) as writer:
        for index in range(2):
            color = np.full((48, 64, 3), 80, np.uint8)
            writer.add(RgbdFrame(1.0 + index, color, np.full((48, 64), 1.5, np.float32), index))
    save_calibration(calibration, folder / "calibration.yaml")
    return folder


def test_recordings_are_freed_of_it_as_they_are_read_and_once_only(tmp_path: Path) -> None:
    folder = recording_with(tmp_path / "one", Calibration.registered_camera(CAMERA, depth_error=DepthError(scale=1.1)))
    recording = open_recording(folder)
    (frame, *_) = [event for event in recording.events() if isinstance(event, RgbdFrame)]
    np.testing.assert_allclose(frame.depth_m, 1.65, rtol=1e-5)
    write_recording(tmp_path / "copy", recording)
    (copied, *_) = [event for event in open_recording(tmp_path / "copy").events() if isinstance(event, RgbdFrame)]
    np.testing.assert_allclose(copied.depth_m, 1.65, rtol=1e-4)


def test_recordings_of_raw_disparities_are_read(tmp_path: Path) -> None:
    folder = recording_with(tmp_path / "raw", Calibration.registered_camera(CAMERA, depth_error=DISPARITY))
    raw = np.full((48, 64), 900, np.uint16)
    raw[:, :10] = NO_DISPARITY
    for path in (folder / "depth").glob("*.png"):
        cv2.imwrite(str(path), raw)
    (frame, *_) = [event for event in open_recording(folder).events() if isinstance(event, RgbdFrame)]
    np.testing.assert_allclose(frame.depth_m[:, 10:], 1 / (3.1 - 0.00285 * 900), rtol=1e-5)
    assert not frame.depth_m[:, :10].any()
