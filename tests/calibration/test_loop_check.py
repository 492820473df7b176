"""Loops of simulated wheels: closed within what is stated of them, and what is wrong with wheels that are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from drives import SimulatedDrive, simulate, square_legs

from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.errors import CalibrationError
from wheelsight_calibration.loop_check import LoopCause, check_loop, with_sigmas
from wheelsight_calibration.wheel_drive import WheelDrive, drive_from_ticks

# A tyre that grips, on wheels that are calibrated as well as `calibrate wheels` has it.
WHEELS = Wheels(
    0.17, 0.17, 0.52, 3200,
    slip_m_per_sqrt_m=0.002, scale_sigma=0.004, drift_sigma_rad_per_m=0.0015, turn_sigma=0.005,
)  # fmt: skip


def looped(true: Wheels, sense: int = 1, seed: int | None = None) -> SimulatedDrive:
    """A square that truly closes, driven on wheels that are truly so."""
    rng = None if seed is None else np.random.default_rng(seed)
    return simulate(true, square_legs(true, true, sense), rng=rng)


def drive_of(true: Wheels, believed: Wheels = WHEELS, sense: int = 1, seed: int | None = None) -> WheelDrive:
    found = looped(true, sense, seed)
    return drive_from_ticks(believed, found.stamps_s, found.left, found.right)


def test_wheels_that_are_as_stated_close_it() -> None:
    for sense in (1, -1):
        found = check_loop(drive_of(WHEELS, sense=sense, seed=3), WHEELS)
        assert found.way_m == pytest.approx(16.0, abs=0.8)
        assert found.turns == sense
        assert found.is_as_stated
        assert found.is_good
        assert found.causes == ()


def test_a_track_width_that_is_wrong_turns_it_by_the_loops_own_sense() -> None:
    believed = replace(WHEELS, track_width_m=0.52 / 1.05)
    for sense in (1, -1):
        found = check_loop(drive_of(WHEELS, believed, sense), believed)
        assert found.turns == sense
        # Turns are taken 5 % too large: by so much more than one turn.
        assert np.degrees(found.off_rad) == pytest.approx(sense * 18.0, abs=0.6)
        assert not found.is_as_stated
        causes = dict(found.causes)
        assert causes[LoopCause.TURN] == pytest.approx(0.05, abs=0.004)


def test_unequal_radii_turn_it_to_one_side_whichever_way_it_goes() -> None:
    believed = replace(WHEELS, left_radius_m=0.17 * 0.995, right_radius_m=0.17 * 1.005)
    drift = 0.01 / 0.52
    for sense in (1, -1):
        found = check_loop(drive_of(WHEELS, believed, sense), believed)
        assert found.off_rad > np.radians(10)
        assert not found.is_as_stated
        causes = dict(found.causes)
        assert causes[LoopCause.DRIFT] == pytest.approx(drift, rel=0.05)


def test_a_wheel_that_slipped_is_no_size() -> None:
    """Half a metre of spin on the second side: neither size alone ends up where that does."""
    found = looped(WHEELS, seed=1)
    spun = found.right + np.where(np.arange(len(found.right)) > 600, round(0.5 / WHEELS.right_m_per_tick), 0)
    reported = check_loop(drive_from_ticks(WHEELS, found.stamps_s, found.left, spun), WHEELS)
    assert not reported.is_as_stated
    assert not reported.is_good
    assert reported.causes == ()


def test_sigmas_are_the_spread_over_drives_of_wheels_that_are_off_by_what_is_stated() -> None:
    rng = np.random.default_rng(0)
    over_sigma, as_stated = [], 0
    for seed in range(60):
        scale, drift, turn = rng.standard_normal(3) * (0.004, 0.0015, 0.005)
        half = drift * 0.52 / 2
        true = replace(
            WHEELS,
            left_radius_m=0.17 * (1 + scale + half),
            right_radius_m=0.17 * (1 + scale - half),
            track_width_m=0.52 * (1 + scale + turn),
        )
        found = check_loop(drive_of(true, WHEELS, seed=seed), WHEELS, mark_m=1e-3, mark_deg=0.1)
        over_sigma.append(found.off_rad / found.off_sigma_rad)
        as_stated += found.is_as_stated
    assert np.sqrt(np.mean(np.square(over_sigma))) == pytest.approx(1.0, abs=0.25)
    assert as_stated >= 57


def test_a_drive_too_short_is_refused() -> None:
    short = simulate(WHEELS, [(2.0, 0.5, 0.0)])
    drive = drive_from_ticks(WHEELS, short.stamps_s, short.left, short.right)
    with pytest.raises(CalibrationError, match=r"drive of 1\.\d m"):
        check_loop(drive, WHEELS)


def test_only_wheels_without_sigmas_get_some() -> None:
    assert with_sigmas(WHEELS, 0.04, 0.02, 0.03) is WHEELS
    bare = Wheels(0.17, 0.17, 0.52, 3200)
    assert with_sigmas(bare, 0.04, 0.02, 0.03).turn_sigma == 0.03
