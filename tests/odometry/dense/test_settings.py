"""Settings of dense odometry: each is read, and reaches the run from a file. Constants that decide a keyframe count."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import yaml
from narrowing import not_none
from odometry.dense.scenes import bench, dense
from odometry.views import room_frame, run
from synthetic import wobbling_trajectory

import wheelsight.vision.dense as package
from wheelsight.config import load_config, save_config
from wheelsight.core.errors import ConfigError
from wheelsight.core.geometry import FloatArray
from wheelsight.vision.dense import DenseSettings

FILES = [
    path
    for path in sorted(Path(package.__file__).parent.glob("*.py"))
    if not path.stem.endswith("_kernels") and not path.stem.startswith("settings")
]


@pytest.fixture(scope="module")
def read() -> set[str]:
    """Names of all attributes that the modules read."""
    trees = [ast.parse(path.read_text()) for path in FILES]
    return {node.attr for tree in trees for node in ast.walk(tree) if isinstance(node, ast.Attribute)}


@pytest.mark.parametrize("name", DenseSettings.model_fields)
def test_each_setting_is_read_and_described(read: set[str], name: str) -> None:
    assert name in read
    assert DenseSettings.model_fields[name].description


def test_settings_are_read_from_a_file_and_written_beside_the_results(tmp_path: Path) -> None:
    given = tmp_path / "given.yaml"
    given.write_text("dense:\n  kept_keyframes: 40\n")
    config = load_config(given, {"dense.max_unseen_s": 0.2})
    assert (config.dense.kept_keyframes, config.dense.max_unseen_s) == (40, 0.2)
    assert config.dense.lost_after == DenseSettings().lost_after
    save_config(config, tmp_path / "resolved.yaml")
    written = yaml.safe_load((tmp_path / "resolved.yaml").read_text())["dense"]
    assert (written["kept_keyframes"], written["max_unseen_s"]) == (40, 0.2)
    assert load_config(tmp_path / "resolved.yaml") == config


@pytest.mark.parametrize("text", ["max_unseen_s: -1", "leaps: 1", "keyframe_overlap: 1.5"])
def test_what_makes_no_sense_is_refused_by_its_line(tmp_path: Path, text: str) -> None:
    given = tmp_path / "given.yaml"
    given.write_text(f"dense:\n  {text}\n")
    with pytest.raises(ConfigError, match=r"given\.yaml:2: .*dense\.\w+"):
        load_config(given)


TRUTH = wobbling_trajectory(10)


def last_covariance() -> FloatArray:
    """With so much in sight that keyframes are made on the way."""
    frames = [room_frame(T, stamp_s, depth_noise=True) for stamp_s, T in TRUTH]
    return not_none(run(dense(keyframe_overlap=0.9), frames)[-1].covariance)


@cache
def usual_covariance() -> FloatArray:
    return last_covariance()


def test_the_same_settings_give_the_same_answer() -> None:
    np.testing.assert_array_equal(last_covariance(), usual_covariance())


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("tracking._FINENESS", 1.0),
        ("alignment._DEPTH_JUMP_SIGMAS", 0.0),
        ("alignment._CREASE_SIGMAS", 0.1),
        ("alignment._OCCLUSION_SHARE", 1.0),
        ("alignment._OCCLUSION_SIGMAS", 0.0),
        ("alignment._DARK_GREY", 255.0),
    ],
)
def test_these_constants_count(monkeypatch: pytest.MonkeyPatch, name: str, value: float) -> None:
    usual = usual_covariance()
    monkeypatch.setattr(f"wheelsight.vision.dense.{name}", value)
    assert not np.array_equal(last_covariance(), usual)


def test_grey_of_a_dark_image_is_unknown(monkeypatch: pytest.MonkeyPatch) -> None:
    frame, parts = room_frame(np.array(TRUTH.T_frame_body[0]), 0.0), bench()
    assert (parts.grid(frame).levels[0].grey >= 0).any()
    monkeypatch.setattr("wheelsight.vision.dense.alignment._DARK_GREY", 255.0)
    assert (parts.grid(frame).levels[0].grey == -1).all()
