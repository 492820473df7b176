"""Settings of dense odometry: each is read, and reaches the run from a file."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from narrowing import not_none
from odometry.dense.scenes import bench, dense
from odometry.views import room_frame, run
from pydantic import BaseModel
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


def parts(settings: BaseModel = DenseSettings(), name: str = "dense") -> Iterator[tuple[str, BaseModel]]:  # noqa: B008
    yield name, settings
    for field, value in settings:
        if isinstance(value, BaseModel):
            yield from parts(value, f"{name}.{field}")


def fields() -> list[str]:
    return [f"{name}.{field}" for name, part in parts() for field, value in part if not isinstance(value, BaseModel)]


@pytest.fixture(scope="module")
def read() -> set[str]:
    """Names of all attributes that the modules read."""
    trees = [ast.parse(path.read_text()) for path in FILES]
    return {node.attr for tree in trees for node in ast.walk(tree) if isinstance(node, ast.Attribute)}


@pytest.mark.parametrize("name", fields())
def test_each_setting_is_read_and_told_what_for(read: set[str], name: str) -> None:
    *path, field = name.split(".")
    assert field in read
    part = dict(parts())[".".join(path)]
    assert type(part).model_fields[field].description or field in {"levels"}


def test_parts_are_read_from_a_file_and_written_beside_the_results(tmp_path: Path) -> None:
    given = tmp_path / "given.yaml"
    given.write_text("dense:\n  faults: {leap_m_s: 0.7}\n  verification:\n    clear_inliers: 80\n")
    config = load_config(given, {"dense.vignetting.sigma": 0.2})
    assert (config.dense.faults.leap_m_s, config.dense.verification.clear_inliers) == (0.7, 80)
    assert config.dense.keyframes == DenseSettings().keyframes
    save_config(config, tmp_path / "resolved.yaml")
    written = yaml.safe_load((tmp_path / "resolved.yaml").read_text())["dense"]
    assert written["vignetting"]["sigma"] == 0.2
    assert written["starts"]["turn_misfit"] == 3.0
    assert load_config(tmp_path / "resolved.yaml") == config


@pytest.mark.parametrize("text", ["faults: {leap_m_s: -1}", "faults: {leaps: 1}", "verification: {clear_share: 1.5}"])
def test_what_makes_no_sense_is_refused_by_its_line(tmp_path: Path, text: str) -> None:
    given = tmp_path / "given.yaml"
    given.write_text(f"dense:\n  {text}\n")
    with pytest.raises(ConfigError, match=r"given\.yaml:2: .*dense\.(faults|verification)\.\w+"):
        load_config(given)


TRUTH = wobbling_trajectory(10)
# So much in sight that keyframes are made on the way.
BUSY = {"keyframe_overlap": 0.9}


def last_covariance(**changed: Any) -> FloatArray:
    frames = [room_frame(T, stamp_s, depth_noise=True) for stamp_s, T in TRUTH]
    return not_none(run(dense(**BUSY | changed), frames)[-1].covariance)


@cache
def usual_covariance() -> FloatArray:
    return last_covariance()


def test_the_same_settings_give_the_same_answer() -> None:
    np.testing.assert_array_equal(last_covariance(), usual_covariance())


@pytest.mark.parametrize(
    "changed",
    [
        {"keyframes": {"fineness": 1.0}},
        {"depth_jump_sigmas": 0.0},
        {"crease_sigmas": 0.1},
        {"occlusion_share": 1.0},
        {"occlusion_sigmas": 0.0},
        {"dark_grey": 255.0},
    ],
    ids=str,
)
def test_what_is_changed_changes_the_answer(changed: dict[str, Any]) -> None:
    assert not np.array_equal(last_covariance(**changed), usual_covariance())


def test_a_dim_image_is_dark_where_it_is_set_so() -> None:
    frame = room_frame(np.array(TRUTH.T_frame_body[0]), 0.0)
    given: list[tuple[dict[str, Any], bool]] = [
        ({}, False),
        ({"dark_grey": 255.0}, True),
        ({"dark_share": 0.0, "dark_grey": 255.0}, False),
    ]
    for settings, is_dark in given:
        grey = bench(**settings).grid(frame).levels[0].grey
        assert (grey == -1).all() == is_dark
