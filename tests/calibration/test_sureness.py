"""Calibrated wheels say how sure their sizes are: in files, and to the filter that joins them with a camera."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from wheelsight.core.calibration import Calibration, load_calibration, save_calibration
from wheelsight.core.calibration_parts import HolonomicWheels, Wheels
from wheelsight.core.errors import CalibrationError
from wheelsight.estimation import ErrorStateSettings
from wheelsight_calibration.parameters import DAILY_DRIFT_RAD_PER_M, stated
from wheelsight_sim.robot import WheelSizeSettings, as_calibrated

WHEELS = Wheels(0.17, 0.17, 0.5, 3200.0)
SURE = replace(WHEELS, scale_sigma=0.003, drift_sigma_rad_per_m=0.001, turn_sigma=0.004)


def test_what_is_stated_is_kept_and_what_is_not_is_not_written(tmp_path: Path) -> None:
    for wheels in (WHEELS, SURE):
        path = tmp_path / "calibration.yaml"
        save_calibration(Calibration(wheels=wheels), path)
        assert load_calibration(path).wheels == wheels
        assert ("turn_sigma" in path.read_text(encoding="utf-8")) == (wheels is SURE)


def test_the_filter_goes_by_what_is_stated() -> None:
    settings = ErrorStateSettings()
    assert settings.with_wheels(None) == settings.with_wheels(WHEELS) == settings
    reported = settings.with_wheels(replace(WHEELS, turn_sigma=0.004))
    assert reported.turn_sigma == 0.004
    assert reported.scale_sigma == settings.scale_sigma
    assert settings.with_wheels(SURE).drift_sigma_rad_per_m == 0.001


AROUND = (np.pi / 4, 3 * np.pi / 4, 5 * np.pi / 4, 7 * np.pi / 4)


def test_the_drift_of_a_holonomic_base_by_its_data_sheet_is_that_of_its_wheels() -> None:
    """The spread of turns by a metre ahead with radii, two of them 1 % apart."""
    rng, settings = np.random.default_rng(1), ErrorStateSettings()
    for wheels in (
        HolonomicWheels("mecanum", 0.05, 0.2, 0.18, ticks_per_turn=4096),
        HolonomicWheels("omni", 0.05, distance_m=0.2, angles_rad=AROUND, ticks_per_turn=4096),
    ):
        errors = 0.01 / np.sqrt(2) * rng.standard_normal((20_000, 4))
        turns_rad = (errors * wheels.jacobian[:, 0]) @ wheels.to_base[2]
        found = settings.with_wheels(wheels)
        assert found.drift_sigma_rad_per_m == pytest.approx(turns_rad.std(), rel=0.03)
        assert found.scale_sigma == settings.scale_sigma
        stated_wheels = replace(wheels, drift_sigma_rad_per_m=0.004)
        assert settings.with_wheels(stated_wheels).drift_sigma_rad_per_m == 0.004
        chosen = ErrorStateSettings(drift_sigma_rad_per_m=0.03)
        assert chosen.with_wheels(wheels).drift_sigma_rad_per_m == 0.03
    increments = settings.with_wheels(HolonomicWheels("increments", distance_m=0.2))
    assert increments.drift_sigma_rad_per_m == pytest.approx(found.drift_sigma_rad_per_m)


def test_a_fit_is_never_surer_than_tyres_are_from_day_to_day() -> None:
    found = stated(WHEELS, 1e-9, 1e-9, 1e-9)
    assert found.drift_sigma_rad_per_m == pytest.approx(DAILY_DRIFT_RAD_PER_M)
    # A ratio known to a thousandth, on wheels half a metre apart, is two milliradians a metre.
    assert stated(WHEELS, 1e-3, 0.01).drift_sigma_rad_per_m == pytest.approx(np.hypot(2e-3, DAILY_DRIFT_RAD_PER_M))
    assert stated(WHEELS, 1e-3, 0.01).scale_sigma == 0


def test_a_simulated_calibration_is_off_by_what_it_states() -> None:
    settings = WheelSizeSettings()
    drawn = [as_calibrated(WHEELS, settings, np.random.default_rng(seed)) for seed in range(400)]
    drift = [np.log(w.right_radius_m / w.left_radius_m) / WHEELS.track_width_m for w in drawn]
    scale = [(w.left_radius_m + w.right_radius_m) / 0.34 - 1 for w in drawn]
    turn = [w.track_width_m / 0.5 - 1 for w in drawn]
    for errors, name in ((drift, "drift_sigma_rad_per_m"), (scale, "scale_sigma"), (turn, "turn_sigma")):
        assert np.std(errors) == pytest.approx(getattr(drawn[0], name), rel=0.1)


def test_sigmas_that_no_one_has_are_refused() -> None:
    with pytest.raises(CalibrationError, match="turn_sigma"):
        replace(WHEELS, turn_sigma=-0.1)
    with pytest.raises(CalibrationError, match="drift_sigma_rad_per_m"):
        replace(WHEELS, drift_sigma_rad_per_m=3.0)
