"""A localizer of a holonomic base: by wheels alone, with a gyroscope, and joined with a camera that sees the truth."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from grids import mostly_slow
from localizer.joined_drives import CALIBRATION as WITH_CAMERA
from localizer.joined_drives import Eye, joined
from narrowing import not_none, of_type
from stand_ins import frame

from wheelsight.config import load_config
from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import ArgumentError
from wheelsight.core.estimates import Estimate, Status
from wheelsight.core.messages import Event, WheelTicks
from wheelsight.core.trajectory import Trajectory
from wheelsight.estimation import FusedEstimate, Localizer, choose_odometry
from wheelsight_sim import Patch, RobotModel, SimulationSettings, WheelFaults
from wheelsight_sim.physics import nominal_wheels, simulate_holonomic_drive
from wheelsight_sim.robot import Drive
from wheelsight_sim.simulate import world_of

SETTINGS = SimulationSettings(world="flat", base="mecanum", duration_s=15.0, robot=RobotModel(has_gyro=True))
CALIBRATION = Calibration(holonomic=nominal_wheels(SETTINGS), source="data sheet")


@cache
def driven(settings: SimulationSettings = SETTINGS) -> Drive:
    return simulate_holonomic_drive(settings, world_of(settings))


def off_m(answer: Estimate, drive: Drive) -> float:
    """How far a pose in odom is from the truth, both begun alike."""
    T_true = np.linalg.inv(drive.truth.T_frame_body[0]) @ drive.truth.at(np.array([answer.stamp_s]))[0]
    return float(np.linalg.norm(not_none(answer.T_odom_body)[:3, 3] - T_true[:3, 3]))


def followed(localizer: Localizer, events: list[Event]) -> list[Estimate]:
    answers = [localizer.process(event) for event in events]
    return [answer for answer in answers if answer is not None]


def test_wheels_alone_are_chosen_and_followed_sideways() -> None:
    assert choose_odometry(CALIBRATION, load_config()).odometry == ("wheels",)
    drive = driven()
    with Localizer(CALIBRATION) as localizer:
        answers = followed(localizer, list(drive.holonomic))
    assert all(answer.status is Status.TRACKING for answer in answers)
    assert max(off_m(answer, drive) for answer in answers) < 0.15
    moved_m = not_none(answers[-1].T_odom_body)[:2, 3] - not_none(answers[0].T_odom_body)[:2, 3]
    assert np.linalg.norm(moved_m) > 2


def test_a_gyroscope_joins_in_once_it_has_agreed() -> None:
    drive = driven()
    events: list[Event] = sorted([*drive.holonomic, *drive.yaw_rates], key=lambda event: event.stamp_s)
    with Localizer(CALIBRATION) as localizer, Localizer(CALIBRATION) as alone:
        by_both, by_wheels = followed(localizer, events), followed(alone, list(drive.holonomic))
        assert localizer.warnings == ()
    spreads = [not_none(answers[-1].covariance)[5, 5] for answers in (by_both, by_wheels)]
    assert spreads[0] < 0.9 * spreads[1]  # its bias is known by no rest
    assert off_m(by_both[-1], drive) < 0.15


def test_a_wheel_that_spins_is_said() -> None:
    x_m, y_m, _ = driven().truth.positions_m[1500]
    faults = WheelFaults(patches=(Patch(float(x_m), float(y_m), 0.4),))
    drive, notes = driven(SimulationSettings(world="flat", base="mecanum", duration_s=15.0, faults=faults)), []
    with Localizer(CALIBRATION) as localizer:
        for event in drive.holonomic:
            localizer.process(event)
            notes.append(localizer.note)
    assert "a wheel slips: the wheels contradict each other" in notes
    assert not any(notes[:300])


@pytest.mark.parametrize("kind", mostly_slow(["dense", "features"], ["dense"]))
def test_joined_with_a_camera_the_way_to_the_side_is_believed(monkeypatch: pytest.MonkeyPatch, kind: str) -> None:
    """The camera sees the truth: wheels that go sideways contradict nothing, and no slip is suspected."""
    drive, truth = driven(), driven().truth
    T_odom_base = np.linalg.inv(truth.T_frame_body[0]) @ truth.T_frame_body
    eye = Eye(Trajectory(truth.stamps_s, T_odom_base, body="base"))
    stamps_s = np.arange(0.051, 14.9, 0.1).tolist()
    frames = [replace(frame(index % 200, stamp_s), index=index) for index, stamp_s in enumerate(stamps_s)]
    events: list[Event] = sorted([*drive.holonomic, *frames], key=lambda event: event.stamp_s)
    calibration = replace(WITH_CAMERA, wheels=None, holonomic=CALIBRATION.holonomic)
    subject, _ = joined(monkeypatch, eye, kind, calibration)
    answers = [of_type(FusedEstimate, answer) for answer in followed(subject, events)[5:]]
    assert max(off_m(answer, drive) for answer in answers) < 0.03
    assert {answer.status for answer in answers[10:]} == {Status.TRACKING}
    assert not any(answer.slip or answer.doubtful or answer.reason for answer in answers)
    assert subject.warnings == ()


def test_readings_of_two_wheels_are_refused_with_what_to_give() -> None:
    with Localizer(CALIBRATION) as localizer, pytest.raises(ArgumentError, match="no reading of a holonomic base"):
        localizer.process(WheelTicks(0.0, 1, 2))
