"""Simulated drives on which wheels and camera are joined, and what goes wrong on them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.geometry import FloatArray
from wheelsight.core.trajectory import Trajectory
from wheelsight_sim import (
    FloorPlan,
    Patch,
    Renderer,
    RobotModel,
    SimulatedRecording,
    SimulationSettings,
    WheelFaults,
    build_world,
    camera_model,
    follow_route,
    realism_of,
    simulate,
    simulate_drive,
)
from wheelsight_sim.faults import CameraFault, Covered, FramesDropped, LateClock
from wheelsight_sim.robot import NOMINAL_RADIUS_M, NOMINAL_TRACK_WIDTH_M, WheelSizeSettings, as_calibrated

DURATION_S, RATE_HZ, SIZE = 45.0, 10.0, (320, 240)
LONG_M = 200.0
BLANK_M = (8.0, 36.0)  # along x: where the world `blank` shows nothing
LIFT_S = 3.0
PEOPLE = 4
ICE_RADIUS_M = 0.8
WRONG_RADII = 1.02
_STREAM = 0x701
# A chair that one wheel turns about does not run into a wall from so slow a drive.
_LIFTED_M_S = 0.4
# Least and most relative error of the wheels' size and track width, and by how much radii differ.
_WHEEL_ERROR, _UNEQUAL = (0.005, 0.01), (0.001, 0.0025)
# Of the mount: standard deviations, as a good calibration leaves them.
_MOUNT_M, _MOUNT_RAD = 0.003, math.radians(0.1)


class Expected(Enum):
    """Which status is right while a fault lasts."""

    TRACKING = "tracking"
    COASTING = "coasting"
    SLIP = "slip or doubt reported while a wheel slips"
    DEGENERATE = "degenerate, or coasting"
    POSED = "tracking, or coasting where the view is taken; no slip reported"


class Way(Enum):
    """A drive to be rendered."""

    CLEAN = "clean"
    LIFTED = "lifted"
    ICE = "ice"
    PEOPLE = "people"
    BLANK = "blank"
    LONG = "long"


@dataclass(frozen=True, slots=True)
class Case:
    """What happens on a drive.

    Attributes:
        name: as it stands in the table.
        way: the drive.
        expected: the right status.
        blackout_s: for how long the camera is covered.
        faults: of the camera, over the whole drive.
        radii: of the wheels as they are believed to be, as a share of the true ones; None for the data sheet's wheels.
        is_calibrated: whether wheels are as a calibration leaves them, which states how sure it is.
    """

    name: str
    way: Way
    expected: Expected = Expected.TRACKING
    blackout_s: float = 0.0
    faults: tuple[CameraFault, ...] = ()
    radii: float | None = None
    is_calibrated: bool = False

    @property
    def is_ordinary(self) -> bool:
        """Whether nothing goes wrong."""
        return self.name.startswith("ordinary")

    def lasts_s(self, recording: SimulatedRecording) -> tuple[float, float]:
        """When it begins and ends."""
        if self.way is Way.BLANK:
            return _blind_s(recording)
        begin_s = fault_begin_s(recording.settings.duration_s or DURATION_S)
        return (begin_s, begin_s + self.blackout_s) if self.blackout_s else (0.0, math.inf)

    def camera_faults(self, recording: SimulatedRecording) -> tuple[CameraFault, ...]:
        """All that goes wrong with the camera."""
        if not self.blackout_s:
            return self.faults
        begin_s, end_s = self.lasts_s(recording)
        return (*self.faults, Covered(begin_s=begin_s, end_s=end_s))

    def calibration(self, recording: SimulatedRecording) -> Calibration:
        """What the robot's owner believes."""
        calibration, wheels = recording.calibration, recording.true_calibration.wheels
        assert wheels is not None
        if self.is_calibrated:
            drawn = as_calibrated(
                wheels, WheelSizeSettings(), np.random.default_rng([recording.settings.seed, _STREAM])
            )
            return replace(calibration, wheels=drawn)
        if self.radii is None:
            return calibration
        left, right = wheels.left_radius_m * self.radii, wheels.right_radius_m * self.radii
        return replace(calibration, wheels=replace(wheels, left_radius_m=left, right_radius_m=right))


CASES = (
    Case("ordinary", Way.CLEAN),
    Case("ordinary, 200 m", Way.LONG),
    *(Case(f"camera covered, {seconds} s", Way.CLEAN, Expected.COASTING, seconds) for seconds in (1, 5, 20)),
    Case("featureless corridor", Way.BLANK, Expected.DEGENERATE),
    Case("a wheel lifted, 3 s", Way.LIFTED, Expected.SLIP),
    Case("a patch of ice", Way.ICE, Expected.SLIP),
    Case("wheels calibrated", Way.CLEAN, is_calibrated=True),
    Case("radii 2 % wrong", Way.CLEAN, radii=WRONG_RADII),
    Case("camera clock 30 ms late", Way.CLEAN, faults=(LateClock(late_s=0.03),)),
    Case("20 % of frames dropped", Way.CLEAN, faults=(FramesDropped(share=0.2),)),
    Case(f"{PEOPLE} people walk by", Way.PEOPLE, Expected.POSED),
)


def _blind_s(recording: SimulatedRecording) -> tuple[float, float]:
    """From when until when nothing but plain surfaces lies within the depth camera's reach."""
    calibration, truth = recording.true_calibration, recording.ground_truth
    assert calibration.T_base_camera is not None
    sight_m = calibration.T_base_camera[0, 3] + calibration.depth_noise.far_m
    x_m = truth.positions_m[:, 0]
    blind_s = truth.stamps_s[(x_m > BLANK_M[0]) & (x_m < BLANK_M[1] - sight_m)]
    return (float(blind_s[0]), float(blind_s[-1])) if len(blind_s) else (math.inf, math.inf)


def fault_begin_s(duration_s: float) -> float:
    """When a fault begins that has a time of its own."""
    return duration_s / 3


def robot_of(seed: int) -> RobotModel:
    """A robot as robots are: nothing of it is quite what its owner believes.

    Wheels' size and track width are each 0.5 to 1 % off the data sheet, radii differ by 0.1 to 0.25 %, and the camera
    is off its mount by about 3 mm and 0.1° about each axis.
    """
    rng = np.random.default_rng([seed, _STREAM])
    signs = rng.choice([-1, 1], 3)
    size, track, unequal = (signs * [*rng.uniform(*_WHEEL_ERROR, 2), rng.uniform(*_UNEQUAL)]).tolist()
    forward, left, height = (_MOUNT_M * rng.standard_normal(3)).tolist()
    pitch, yaw, roll = (_MOUNT_RAD * rng.standard_normal(3)).tolist()
    nominal = RobotModel()
    return replace(
        nominal,
        left_radius_m=NOMINAL_RADIUS_M * (1 + size - unequal / 2),
        right_radius_m=NOMINAL_RADIUS_M * (1 + size + unequal / 2),
        track_width_m=NOMINAL_TRACK_WIDTH_M * (1 + track),
        camera_forward_m=nominal.camera_forward_m + forward,
        camera_left_m=nominal.camera_left_m + left,
        camera_height_m=nominal.camera_height_m + height,
        camera_pitch_rad=nominal.camera_pitch_rad + pitch,
        camera_yaw_rad=nominal.camera_yaw_rad + yaw,
        camera_roll_rad=nominal.camera_roll_rad + roll,
    )


def drive_of(way: Way, seed: int, duration_s: float = DURATION_S, plan: FloorPlan | None = None) -> SimulatedRecording:
    """The drive of a seed: odd ones through `floor4`, even ones through `flat`; every second pair backwards.

    The long one is through `floor4`, as are the slow one on which a wheel is lifted and the one with ice in a bend.
    With a plan, all but the one through the blank corridor are through its building.
    """
    world = "floor4" if seed % 2 else "flat"
    settings = SimulationSettings(
        world,
        size=SIZE,
        rate_hz=RATE_HZ,
        seed=seed,
        duration_s=duration_s,
        laps=3,
        robot=robot_of(seed),
        realism="real",
    )
    settings = replace(settings, is_reverse=(seed - 1) // 2 % 2 == 1, plan=plan)
    if way is Way.BLANK:
        settings = replace(settings, plan=None, world="blank", laps=1, duration_s=None, is_reverse=False)
    if way is Way.LONG:
        settings = replace(settings, world="floor4", duration_s=_seconds_for(LONG_M, replace(settings, world="floor4")))
    if way is Way.LIFTED:
        begin_s = fault_begin_s(duration_s)
        faults = WheelFaults(lifted_s=((begin_s, begin_s + LIFT_S),))
        settings = replace(settings, world="floor4", is_reverse=False, speed_m_s=_LIFTED_M_S, faults=faults)
    if way is Way.ICE:
        settings = replace(settings, world="floor4", is_reverse=True)  # bends come soon, and have room
        settings = replace(settings, faults=WheelFaults(patches=(_ice_on(simulate(settings).ground_truth),)))
    return simulate(replace(settings, passersby=PEOPLE if way is Way.PEOPLE else 0))


def recorded_along(route: FloatArray, settings: SimulationSettings) -> SimulatedRecording:
    """A drive along waypoints (N, 2) of one's own, in metres; no one checks that they keep clear of walls."""
    world = build_world(settings.world, settings.seed)
    driver = follow_route(route, is_loop=False, speed_m_s=settings.speed_m_s)
    drive = simulate_drive(
        world,
        settings.robot,
        driver,
        faults=settings.faults,
        slip=settings.has_slip,
        seed=settings.seed,
        realism=realism_of(settings.realism),
        time_limit_s=settings.duration_s or 3600.0,
    )
    camera = camera_model(settings.camera, settings.size)
    return SimulatedRecording(settings, world, drive, Renderer(world, drive, settings, camera))


def _seconds_for(way_m: float, settings: SimulationSettings) -> float:
    """How long it takes to drive so far."""
    truth = simulate(replace(settings, duration_s=None)).ground_truth
    return float(np.interp(way_m, truth.distances_m, truth.stamps_s))


def _ice_on(truth: Trajectory) -> Patch:
    """In the sharpest bend of a drive, once it is under way."""
    yaw_rad = np.unwrap(np.arctan2(truth.T_frame_body[:, 1, 0], truth.T_frame_body[:, 0, 0]))
    rates = np.where(truth.stamps_s > fault_begin_s(truth.duration_s), np.abs(np.gradient(yaw_rad)), 0.0)
    x_m, y_m, _ = truth.positions_m[int(np.argmax(rates))]
    return Patch(float(x_m), float(y_m), ICE_RADIUS_M)
