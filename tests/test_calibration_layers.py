"""Calibrations laid over each other: what a later one shows stands, and what is missing or wrong names its file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from wheelsight.core.calibration import Calibration, load_calibration, save_calibration
from wheelsight.core.calibration_parts import Gyro, Wheels
from wheelsight.core.errors import CalibrationError
from wheelsight.core.geometry import PinholeCamera, se3

COLOR = PinholeCamera(640, 480, 517.3, 516.5, 318.6, 255.3, (0.2624, -0.9531, -0.0054, 0.0026, 1.1633))
DEPTH = PinholeCamera(512, 424, 365.0, 365.5, 255.0, 211.0)
T_COLOR_DEPTH = se3.exp([0.025, -0.001, 0.002, 0.01, -0.02, 0.003])
T_BASE_CAMERA = se3.exp([0.3, 0.0, 1.1, -1.2, 1.2, -1.2])
WHEELS = Wheels(0.17, 0.16, 0.6, 3200.0, counter_bits=16)
PLAIN = {"left_radius_m": 0.17, "right_radius_m": 0.17, "track_width_m": 0.6, "ticks_per_turn": 3200}
EYE = np.eye(4).tolist()


def written(path: Path, **fields: Any) -> Path:
    path.write_text(yaml.safe_dump({"format": "wheelsight-calibration-1", **fields}))
    return path


def test_files_are_laid_over_each_other_part_by_part(tmp_path: Path) -> None:
    """Each shows something else; a later one wins field by field, and what none shows stays as it was."""
    own = tmp_path / "own.yaml"
    save_calibration(
        Calibration(COLOR, DEPTH, T_COLOR_DEPTH, rolling_shutter_s=0.02, wheels=WHEELS, source="factory"), own
    )
    mount = written(tmp_path / "mount.yaml", source="tape", T_base_camera=T_BASE_CAMERA.tolist())
    sizes = written(tmp_path / "sizes.yaml", source="squares", wheels={"left_radius_m": 0.175, "delay_s": 0.5})
    delay = written(tmp_path / "delay.yaml", source="turns", wheels={"delay_s": -0.009})
    gyro = written(tmp_path / "gyro.yaml", source="rest", gyro={"bias_rad_s": 0.1})
    found = load_calibration(own, mount, sizes, delay, gyro)
    assert found.cameras == (COLOR, DEPTH)
    assert found.rolling_shutter_s == 0.02
    np.testing.assert_array_equal(found.T_base_camera, T_BASE_CAMERA)
    assert found.wheels == replace(WHEELS, left_radius_m=0.175, delay_s=-0.009)
    assert found.gyro == Gyro(bias_rad_s=0.1)
    assert found.source == "factory" + "".join(f", updated by: {who}" for who in ("tape", "squares", "turns", "rest"))
    assert load_calibration(mount, under=load_calibration(own)).wheels == WHEELS


def test_one_lens_is_not_mixed_with_another(tmp_path: Path) -> None:
    own = Calibration(COLOR, DEPTH, T_COLOR_DEPTH, color_sigma_px=2.0, rolling_shutter_s=0.02)
    lens = written(tmp_path / "lens.yaml", color={"width": 64, "height": 48, "fx": 50, "fy": 50, "cx": 32, "cy": 24})
    found = load_calibration(lens, under=own)
    assert found.is_registered
    assert found.color == PinholeCamera(64, 48, 50.0, 50.0, 32.0, 24.0)
    assert (found.color_sigma_px, found.rolling_shutter_s) == (0.0, 0.02)


def test_what_was_known_before_lies_below_everything(tmp_path: Path) -> None:
    nominal = {"wheels": PLAIN | {"counter_bits": 16, "track_width_m": 9.0}}
    found = written(tmp_path / "found.yaml", wheels={"track_width_m": 0.61}, nominal=nominal)
    assert load_calibration(found).wheels == Wheels(0.17, 0.17, 0.61, 3200.0, counter_bits=16)
    over = load_calibration(found, under=Calibration(wheels=WHEELS)).wheels
    assert over == replace(WHEELS, track_width_m=0.61)


def test_a_mount_alone_is_a_calibration(tmp_path: Path) -> None:
    found = load_calibration(written(tmp_path / "mount.yaml", T_base_camera=T_BASE_CAMERA.tolist()))
    np.testing.assert_array_equal(found.T_base_camera, T_BASE_CAMERA)
    with pytest.raises(CalibrationError, match="has no cameras"):
        _ = found.cameras


def test_what_is_missing_in_the_end_is_named_with_the_file_that_begins_it(tmp_path: Path) -> None:
    delay = written(tmp_path / "delay.yaml", wheels={"delay_s": 0.02})
    mount = written(tmp_path / "mount.yaml", T_base_camera=EYE)
    with pytest.raises(CalibrationError, match=r"delay\.yaml: field wheels\.left_radius_m is missing .*--calibration"):
        load_calibration(delay, mount)
    shutter = written(tmp_path / "shutter.yaml", rolling_shutter_s=0.02)
    with pytest.raises(CalibrationError, match=r"shutter\.yaml: field color is missing"):
        load_calibration(shutter, mount)


@pytest.mark.parametrize(
    ("fields", "reported"),
    [
        ({"wheels": {"track_width_m": -1.0}}, r"field wheels: track_width_m is -1\.0"),
        ({"wheels": {"track": 1.0}}, "field wheels has an unknown entry 'track'"),
        ({"nominal": {"color": {}}}, "field nominal has an unknown entry 'color'"),
        ({"gyro": {"bias_rad_s": "much"}}, "field gyro.bias_rad_s is 'much', not a number"),
    ],
)
def test_what_is_wrong_with_a_layer_names_its_file(tmp_path: Path, fields: dict[str, Any], reported: str) -> None:
    wrong, right = written(tmp_path / "wrong.yaml", **fields), written(tmp_path / "right.yaml", T_base_camera=EYE)
    with pytest.raises(CalibrationError, match=r"wrong\.yaml: " + reported):
        load_calibration(wrong, right, under=Calibration(wheels=WHEELS))
