"""Settings of extrinsics: nonsense is refused, and each that is changed reaches its step."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from sighted_drives import MOUNT, USUAL, nominal, sighted

from wheelsight.core.errors import CalibrationError
from wheelsight.core.settings.calibration import ExtrinsicsSettings
from wheelsight_calibration.base import Sightings, base_from

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


# The first of each section is tried always, the others by continuous integration: each is a calibration again.
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
