"""Settings of extrinsics: nonsense is refused, and each that is changed reaches its step; constants that decide."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from sighted_drives import MOUNT, USUAL, nominal, sighted

from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.errors import CalibrationError
from wheelsight.core.geometry import se3
from wheelsight.vision.extrinsics import Agreement, ExtrinsicsSettings, Sightings, base_from, height_below

# Of each section, a value so strict or so wide that a good drive is refused or measured differently.
CHANGED: dict[str, dict[str, Any]] = {
    "floor": {"farthest_m": 1.8, "highest_m": 0.3},
    "drive": {"most_uncertain_deg": 1e-4, "most_uncertain_m": 1e-5, "most_uncertain_s": 1e-6},
}


@pytest.mark.parametrize(
    "wrong",
    [{"floor": {"highest_m": 0.0}}, {"drive": {"most_uncertain_s": -1}}, {"unknown": {}}, {"floor": {"unknown": 1}}],
)
def test_impossible_settings_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        ExtrinsicsSettings(**wrong)


@pytest.fixture(scope="module")
def seen() -> Sightings:
    """With a view that shows no floor, and clocks that are apart."""
    seen = sighted(rng=np.random.default_rng(5), blur=USUAL, camera_late_s=0.03)
    depth_m = seen.views.depth_m.copy()
    depth_m[3] = 0
    return replace(seen, views=replace(seen.views, depth_m=depth_m))


def outcome(seen: Sightings, settings: ExtrinsicsSettings) -> object:
    try:
        found = base_from(seen, nominal(MOUNT), settings)
    except CalibrationError as error:
        return str(error)
    return found.values | {f"σ {name}": sigma for name, sigma in found.sigmas.items()}


@pytest.fixture(scope="module")
def usual(seen: Sightings) -> object:
    return outcome(seen, ExtrinsicsSettings())


# The first of each section is tried always, the others by continuous integration: each is a calibration anew.
@pytest.mark.parametrize(
    ("section", "name"),
    [
        pytest.param(part, name, marks=[pytest.mark.slow] if k else [])
        for part, names in CHANGED.items()
        for k, name in enumerate(names)
    ],
)
def test_each_setting_shows_in_the_outcome(seen: Sightings, usual: object, section: str, name: str) -> None:
    settings = ExtrinsicsSettings(**{section: {name: CHANGED[section][name]}})
    assert outcome(seen, settings) != usual


WHEELS = Wheels(0.17, 0.17, 0.5, 3200.0)


def compared(scale: float) -> Agreement:
    """Of a camera whose ways and turns are `scale` times those of the wheels."""
    agreement = Agreement(WHEELS, np.eye(4))
    for _ in range(30):
        agreement.add(se3.exp([0.1, 0, 0, 0, 0, 0.05]), se3.exp([0.1 * scale, 0, 0, 0, 0, 0.05 * scale]), None)
    return agreement


def test_a_scale_of_15_percent_agrees_and_one_of_50_is_explained() -> None:
    assert compared(1.0).pieces == 30
    assert compared(1.15).agrees()
    assert not compared(1.15).agrees(0.001)
    assert not compared(1.5).agrees()
    assert compared(1.5).agrees(0.9)
    assert compared(3.0).explanations(None)


def test_shorter_motions_are_no_piece() -> None:
    agreement = Agreement(WHEELS, np.eye(4))
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
    monkeypatch.setattr("wheelsight.vision.extrinsics.mount._PEAK_SHARE", 0.5)
    assert height_below(many, board, up, 0.9) == pytest.approx(0.5, rel=0.02)
    monkeypatch.setattr("wheelsight.vision.extrinsics.mount._STEEPEST_DEG", 0.01)
    assert height_below(rays, depth_m * (1 + 0.05 * rays[:, 1]), up, 0.9) is None
