"""Settings of extrinsics: nonsense is refused, and each that is changed reaches what it is about."""

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
from wheelsight.vision.extrinsics import (
    Agreement,
    AgreementSettings,
    ExtrinsicsSettings,
    FloorSettings,
    Sightings,
    base_from,
    height_below,
)

# Of each section, a value so strict or so wide that a good drive is refused or measured differently.
CHANGED: dict[str, dict[str, Any]] = {
    "floor": {"farthest_m": 1.8, "least_height_m": 2.0, "highest_m": 0.3, "bands_m": (0.5,)}
    | {"robust_steps": 1, "outlier_chi2": 0.5, "fewest_points": 10**5, "fewest_views": 10**5, "fewest_share": 1.0}
    | {"most_sway_deg": 1e-6, "most_sway_m": 1e-7},
    "mount": {"segment_m": 1.0, "segment_rad": 1.0, "slide_sigma_s": 1e-6},
    "turning": {"step_s": 0.5, "interval_s": 1.0, "longest_interval_s": 0.1},
    "drive": {"least_shared_s": 1e4, "fewest_tracked": 10**5, "least_agreement": 1.0, "fewest_segments": 10**4}
    | {"most_tilt_deg": 1e-4, "largest_factor": 1.0000001}
    | {"most_uncertain_deg": 1e-4, "most_uncertain_m": 1e-5, "most_uncertain_s": 1e-6},
}


@pytest.mark.parametrize(
    "wrong",
    [{"floor": {"steep": 1.0}}, {"floor": {"bands_m": ()}}, {"agreement": {"disagrees": 0}}, {"unknown": {}}]
    + [{"mount": {"largest_delay_s": -1}}, {"drive": {"largest_factor": 1.0}}],
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


def told_apart(scale: float, **settings: float) -> Agreement:
    """Of a camera that sees ways and turns so many times as long."""
    agreement = Agreement(WHEELS, np.eye(4), AgreementSettings(**settings))
    for _ in range(30):
        agreement.add(se3.exp([0.1, 0, 0, 0, 0, 0.05]), se3.exp([0.1 * scale, 0, 0, 0, 0, 0.05 * scale]), None)
    return agreement


def test_agreement_goes_by_its_settings() -> None:
    assert told_apart(1.15).agrees()
    assert not told_apart(1.15, disagrees=0.001).agrees()
    assert not told_apart(1.5).agrees()
    assert told_apart(1.5, disagrees=0.9).agrees()
    assert told_apart(1.0).pieces == 30
    assert told_apart(1.0, piece_m=0.2, piece_rad=0.2).pieces == 0
    assert told_apart(1.5).unexplained(np.zeros((6, 2))) != told_apart(1.5, usual_m=0.2).unexplained(np.zeros((6, 2)))
    assert told_apart(1.5).drift < told_apart(1.5, slips=50.0).drift
    assert told_apart(1.5).drift < told_apart(1.5, drift_rad_per_m=0.5).drift
    assert told_apart(3.0).explanations(None)
    assert not told_apart(3.0, explained=1e-9).explanations(None)
    assert not told_apart(3.0, largest_factor=2.0).explanations(None)


def test_the_height_by_one_view_goes_by_its_settings() -> None:
    rays = np.column_stack([np.zeros(200), np.linspace(0.05, 0.6, 200), np.ones(200)])
    depth_m, up = 0.9 / rays[:, 1], np.array([0.0, -1.0, 0.0])
    assert height_below(rays, depth_m, up, 0.9) == pytest.approx(0.9, rel=0.01)
    sloping = {"steepest_deg": 0.01}
    assert height_below(rays, depth_m * (1 + 0.05 * rays[:, 1]), up, 0.9, FloorSettings(**sloping)) is None
    for change in ({"steep": 0.9}, {"fewest_points": 10**4}, {"range_log": 0.01}, {"bin_log": 1.0, "range_log": 0.5}):
        assert height_below(rays, depth_m, up, 0.9, FloorSettings(**change)) is None
    board = np.concatenate([depth_m, np.tile(0.5 / rays[:, 1], 5)])  # nearer, and five times as many points
    many = np.tile(rays, (6, 1))
    assert height_below(many, board, up, 0.9) == pytest.approx(0.9, rel=0.02)
    assert height_below(many, board, up, 0.9, FloorSettings(peak_share=0.5)) == pytest.approx(0.5, rel=0.02)
