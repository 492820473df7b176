"""How far off points may be: what modes move, the modes of what moves points, and files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from wheelsight.core.calibration import Calibration, load_calibration, save_calibration, save_layer
from wheelsight.core.depth_errors import MOST_MODES, NOMINAL_ERRORS, TERMS, PointErrors, mode_of
from wheelsight.core.errors import CalibrationError
from wheelsight.core.geometry import FloatArray, PinholeCamera, so3

CAMERA = PinholeCamera(640, 480, 525.0, 525.0, 319.5, 239.5)


@pytest.fixture
def points_m(rng: np.random.Generator) -> FloatArray:
    rays = rng.uniform((-0.6, -0.45, 1.0), (0.6, 0.45, 1.0), (400, 3))
    return rays * rng.uniform(0.7, 4.0, (400, 1))


def moved_by(mode: FloatArray, points_m: FloatArray) -> FloatArray:
    return PointErrors((tuple(mode.tolist()),)).moved_m(points_m)[0]


def test_a_scale_moves_points_along_themselves(points_m: FloatArray) -> None:
    mode = mode_of(points_m, 0.01 * points_m)
    assert np.count_nonzero(np.abs(mode) > 1e-9) == 1
    np.testing.assert_allclose(moved_by(mode, points_m), 0.01 * points_m, atol=1e-9)


def test_a_small_turn_and_a_shift_of_the_camera_are_modes(points_m: FloatArray) -> None:
    moved_m = np.cross(points_m, [1e-3, -2e-3, 3e-3])
    np.testing.assert_allclose(moved_by(mode_of(points_m, moved_m), points_m), moved_m, atol=1e-9)
    aside_m = np.tile([0.002, -0.003, 0.0], (len(points_m), 1))
    np.testing.assert_allclose(moved_by(mode_of(points_m, aside_m), points_m), aside_m, atol=1e-9)


def test_modes_are_found_again(points_m: FloatArray, rng: np.random.Generator) -> None:
    modes = 1e-3 * rng.standard_normal((5, TERMS))
    moved_m = PointErrors(tuple(map(tuple, modes))).moved_m(points_m)
    assert moved_m.shape == (5, len(points_m), 3)
    np.testing.assert_allclose(mode_of(points_m, moved_m), modes, atol=1e-9)


def test_nominal_values_are_off_by_centimetres(points_m: FloatArray) -> None:
    at_2_m = 2 * points_m / points_m[:, 2:]
    sigma_m = np.sqrt((NOMINAL_ERRORS.moved_m(at_2_m) ** 2).sum(axis=0).mean(axis=0))
    assert (sigma_m > 0.02).all()
    assert (sigma_m < 0.1).all()


def test_a_file_keeps_them_to_four_digits(tmp_path: Path) -> None:
    known = Calibration.registered_camera(CAMERA, point_errors=NOMINAL_ERRORS)
    save_calibration(known, tmp_path / "known.yaml")
    found = load_calibration(tmp_path / "known.yaml").point_errors
    assert found is not None
    np.testing.assert_allclose(found.modes, NOMINAL_ERRORS.modes, rtol=1e-3)
    for errors in (None, PointErrors()):
        save_calibration(Calibration.registered_camera(CAMERA, point_errors=errors), tmp_path / "other.yaml")
        assert load_calibration(tmp_path / "other.yaml").point_errors == errors


def test_another_lens_does_not_inherit_them(tmp_path: Path) -> None:
    known = Calibration.registered_camera(CAMERA, point_errors=NOMINAL_ERRORS)
    lens = {"width": 640, "height": 480, "fx": 520.0, "fy": 520.0, "cx": 319.5, "cy": 239.5}
    save_layer({"format": "wheelsight-calibration-1", "color": lens}, tmp_path / "lens.yaml")
    assert load_calibration(tmp_path / "lens.yaml", under=known).point_errors is None


@pytest.mark.parametrize(
    ("value", "reported"),
    [
        (3.0, "list of lists"),
        ([1.0], "list of lists"),
        ([[1.0, 2.0]], f"not of {TERMS} numbers"),
        ([[float("nan")] * TERMS], "not a number"),
        ([["x"] * TERMS], "not a number"),
        ([[0.0] * TERMS] * (MOST_MODES + 1), f"more than {MOST_MODES}"),
    ],
    ids=["a number", "numbers", "short", "not finite", "text", "many"],
)
def test_what_is_none_is_refused(value: Any, reported: str, tmp_path: Path) -> None:
    save_calibration(Calibration.registered_camera(CAMERA), tmp_path / "bad.yaml")
    document = yaml.safe_load((tmp_path / "bad.yaml").read_text()) | {"point_errors": value}
    (tmp_path / "bad.yaml").write_text(yaml.safe_dump(document))
    with pytest.raises(CalibrationError, match=reported) as refused:
        load_calibration(tmp_path / "bad.yaml")
    assert "point_errors" in str(refused.value)


def test_a_turn_is_as_so3_has_it(points_m: FloatArray) -> None:
    turned = points_m @ so3.exp([0.0, 1e-4, 0.0]).T
    mode = mode_of(points_m, turned - points_m)
    np.testing.assert_allclose(moved_by(mode, points_m), turned - points_m, atol=1e-7)
