"""Simulated drives of holonomic bases: where they go, what their wheels say of it, and what is honest about that."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from grids import mostly_slow

from wheelsight.core.errors import ConfigError
from wheelsight.core.estimates import MotionEstimate
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.messages import HolonomicReading, OdometryReading, WheelCounts
from wheelsight.estimation import ErrorStateFilter
from wheelsight.estimation.pose_belief import FilterParameters
from wheelsight.wheels import HolonomicOdometry
from wheelsight_sim import Patch, SimulationSettings, WheelFaults
from wheelsight_sim.physics import nominal_wheels, owned_wheels, simulate_holonomic_drive
from wheelsight_sim.robot import Drive, WheelSizeSettings
from wheelsight_sim.settings import BaseName
from wheelsight_sim.simulate import world_of

BASES: tuple[BaseName, ...] = ("mecanum", "omni-3", "omni-4", "increments")
SETTINGS = SimulationSettings(world="flat", base="mecanum", duration_s=30.0)


@cache
def driven(settings: SimulationSettings) -> Drive:
    return simulate_holonomic_drive(settings, world_of(SETTINGS))


def of(**changes: object) -> SimulationSettings:
    return replace(SETTINGS, **changes)  # type: ignore[arg-type]


def readings_of(drive: Drive) -> list[HolonomicReading]:
    return list(drive.holonomic)


def twists_of(drive: Drive) -> FloatArray:
    """(N, 3) ahead, left and turn of each step of the truth."""
    T = drive.truth.T_frame_body
    return se3.log(np.linalg.inv(T[:-1]) @ T[1:])[:, [0, 1, 5]]


def test_the_base_goes_sideways_and_turns_as_it_goes() -> None:
    steps = twists_of(driven(SETTINGS))
    way_m = np.hypot(*steps[:, :2].T).sum()
    assert np.abs(steps[:, 1]).sum() > 0.3 * way_m
    assert np.abs(steps[:, 2]).sum() > np.pi
    assert np.hypot(*steps[:, :2].T).max() <= SETTINGS.speed_m_s * 0.005 + 1e-6


@pytest.mark.parametrize("base", mostly_slow(BASES, ["mecanum"]))
def test_wheels_that_do_not_slip_lead_where_the_base_went(base: BaseName) -> None:
    drive = driven(of(base=base, has_slip=False))
    odometry = HolonomicOdometry(nominal_wheels(of(base=base)))
    for reading in readings_of(drive):
        odometry.process(reading)
    T_world_base = drive.truth.T_frame_body[0] @ odometry.T_odom_base
    np.testing.assert_allclose(T_world_base[:3, 3], drive.truth.positions_m[-1], atol=0.01)
    kind = OdometryReading if base == "increments" else WheelCounts
    assert {type(reading) for reading in drive.holonomic} == {kind}
    assert not odometry.is_slipping


@pytest.mark.parametrize("base", mostly_slow(BASES, ["mecanum"]))
def test_wheels_alone_say_how_far_off_they_are(base: BaseName) -> None:
    """The mean of NEES over drives, of 3 freedoms: slip is drawn by the model, and rounding adds hardly anything."""
    nees = []
    for seed in range(8):
        settings = of(base=base, seed=seed, duration_s=8.0)
        drive, odometry = driven(settings), HolonomicOdometry(nominal_wheels(settings))
        for reading in readings_of(drive):
            odometry.process(reading)
        T = drive.truth.T_frame_body
        off = se3.log(se3.invert(T[0]) @ T[-1] @ se3.invert(odometry.T_odom_base))[[0, 1, 5]]
        nees.append(off @ np.linalg.solve(odometry.covariance[np.ix_([0, 1, 5], [0, 1, 5])], off))
    # Of χ² with 24 degrees of freedom, 99.9 % lie below 51.2; increments state the slip of one wheel for that of four.
    assert np.sum(nees) < 51.2
    assert base == "increments" or np.sum(nees) > 8.1


def fused_nees(seed: int) -> list[float]:
    """NEES of the plane pose each second, of a base joined with a camera that errs as it says."""
    settings = of(seed=seed, duration_s=20.0)
    drive, rng = driven(settings), np.random.default_rng([seed, 9])
    sizes = WheelSizeSettings(scale_sigma=0.01, turn_sigma=0.01)
    wheels = owned_wheels(settings, sizes, np.random.default_rng([seed, 8]))
    odometry, begin = HolonomicOdometry(wheels), drive.truth.T_frame_body[0]
    fusion = ErrorStateFilter(settings=FilterParameters.of(wheels=wheels))
    sigmas = np.array([2e-3, 2e-3, 2e-3, 1e-3, 1e-3, 1e-3])
    covariance, none = np.diag(sigmas**2), 1e-12 * np.eye(6)
    T_reference, found = None, []
    for index, reading in enumerate(readings_of(drive)):
        fusion.predict_to(odometry.process(reading))
        if index % 10:
            continue
        T_true = drive.truth.at(np.array([reading.stamp_s]))[0]
        if T_reference is None:
            fusion.begin_frame(reading.stamp_s, none)
        else:
            seen = se3.exp(sigmas * rng.standard_normal(6)) @ se3.invert(T_reference) @ T_true
            motion = MotionEstimate(seen, covariance, None, 200, 180)
            update = fusion.update_frame(reading.stamp_s, motion, none, is_far=True)
            assert update.answer.reason is None
        T_reference = T_true
        answer = fusion.estimate
        if index % 50 == 0 and answer.T_odom_body is not None and answer.covariance is not None and index:
            off = se3.log(se3.invert(begin) @ T_true @ se3.invert(answer.T_odom_body))[[0, 1, 5]]
            found.append(float(off @ np.linalg.solve(answer.covariance[np.ix_([0, 1, 5], [0, 1, 5])], off)))
    return found


@pytest.mark.slow
def test_joined_with_a_camera_it_says_how_far_off_it_is() -> None:
    """Wheels 1 % off are known to be so, and the way to the side is believed as the one ahead is."""
    nees = np.array([fused_nees(seed) for seed in range(4)])
    assert nees.mean() < 3 * 2.0  # three freedoms; those of one drive go together
    assert np.median(nees) > 0.2


def test_a_base_that_goes_sideways_coasts_sideways() -> None:
    """No reading for 0.3 s: the speed to the side goes on as one ahead does, and may change as fast."""
    wheels = nominal_wheels(SETTINGS)
    spreads = []
    for twist in ([0.4, 0.0, 0.0], [0.0, 0.4, 0.0]):
        fusion = ErrorStateFilter(settings=FilterParameters.of(wheels=wheels))
        odometry, ways = HolonomicOdometry(wheels), wheels.jacobian @ twist
        for index in range(50):
            counts = tuple(int(count) for count in np.rint(ways * 0.02 * index / wheels.m_per_tick))
            fusion.predict_to(odometry.process(WheelCounts(0.02 * index, counts)))
        answer = fusion.clone(0.98 + 0.3, "then")
        assert answer.T_odom_body is not None
        assert answer.covariance is not None
        np.testing.assert_allclose(answer.T_odom_body[:2, 3], np.array(twist[:2]) * 1.28, atol=2e-3)
        along = np.flatnonzero(twist)[0]
        spreads.append(np.sqrt(se3.position_covariance(answer.T_odom_body, answer.covariance)[along, along]))
    assert spreads[1] == pytest.approx(spreads[0], rel=0.1)


def test_on_ice_a_wheel_spins_and_the_others_show_it() -> None:
    drive = driven(of(has_slip=False))
    x_m, y_m, _ = drive.truth.positions_m[2000]
    icy = driven(of(has_slip=False, faults=WheelFaults(patches=(Patch(float(x_m), float(y_m), 0.4),))))
    odometry, slipping = HolonomicOdometry(nominal_wheels(SETTINGS)), []
    for reading in readings_of(icy):
        odometry.process(reading)
        slipping.append(odometry.is_slipping)
    assert any(slipping[480:540])
    assert not any(slipping[:400])


def test_readings_drop_out_and_pulses_are_lost() -> None:
    faults = WheelFaults(dropouts_s=((5.0, 6.0),), unplugged_s=((10.0, 11.0),))
    readings = readings_of(driven(of(faults=faults)))
    stamps_s = np.array([reading.stamp_s for reading in readings])
    assert not ((stamps_s >= 5.0) & (stamps_s < 6.0)).any()
    counts = [r.counts for r in readings if isinstance(r, WheelCounts) and 10.0 <= r.stamp_s < 11.0]
    assert all(before == now for before, now in pairwise(counts))


def test_the_gyroscope_turns_as_the_base_does() -> None:
    settings = of()
    drive = driven(replace(settings, robot=replace(settings.robot, has_gyro=True)))
    rates = np.array([reading.yaw_rate_rad_s for reading in drive.yaw_rates])
    true = np.append(twists_of(drive)[:, 2], 0.0)[::2] / 0.005
    assert np.corrcoef(rates, true)[0, 1] > 0.99


def test_what_a_holonomic_base_has_not_is_refused() -> None:
    with pytest.raises(ConfigError, match="--lift means nothing with --base mecanum"):
        driven(of(faults=WheelFaults(lifted_s=((1.0, 2.0),))))
    with pytest.raises(ConfigError, match=r"--base is 'tricycle' \(one of differential, mecanum"):
        of(base="tricycle")


@pytest.mark.parametrize("base", mostly_slow(["mecanum", "omni-3", "omni-4"], ["mecanum"]))
def test_wheels_of_a_real_unit_are_unequal_by_what_its_calibration_states(base: BaseName) -> None:
    """The turn by a metre ahead, of 24 units, has the stated σ: 99.9 % of such spreads are 0.57 to 1.5 of it."""
    wheels, sizes = nominal_wheels(of(base=base)), WheelSizeSettings()
    assert owned_wheels(of(base=base), sizes, np.random.default_rng(1)).drift_sigma_rad_per_m == 0.001
    drifts_rad_per_m = []
    for seed in range(24):
        rolled = []
        for realism in ("real", "ideal"):
            drive = driven(of(base=base, realism=realism, seed=seed, day=0, duration_s=6.0, has_slip=False))
            counts = [reading.counts for reading in drive.holonomic if isinstance(reading, WheelCounts)]
            rolled.append(np.abs(np.diff(counts, axis=0)).sum(axis=0))
        unequal = rolled[0] / rolled[1] - 1
        drifts_rad_per_m.append(wheels.to_base[2] @ (unequal * wheels.jacobian[:, 0]))
    assert 0.57 * 0.001 < np.sqrt(np.mean(np.square(drifts_rad_per_m))) < 1.5 * 0.001
