"""Short simulated drives for what a camera may meet: each rendered once, then spoilt in one way after another."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from wheelsight.geometry import FloatArray, se3
from wheelsight.simulation import (
    ManualVelocities,
    Renderer,
    Robot,
    SimulatedRecording,
    SimulationSettings,
    build_world,
    camera_model,
    simulate_drive,
)
from wheelsight.simulation.camera_faults import (
    CableOut,
    CameraFault,
    Covered,
    DepthHoles,
    ExposureSteps,
    FramesDropped,
    LightsOff,
    LowRate,
    StuckImage,
)
from wheelsight.simulation.drivers import Driver, follow_route
from wheelsight.simulation.passersby import RADIUS_M, Passersby
from wheelsight.simulation.realism import realism_of

_SIZE = (320, 240)
_BEGIN_S, _END_S = 4.0, 7.0
_RIGHT_ANGLE_S = math.pi / 2
# A person is in the way who hides this share of the view's width.
_IN_THE_WAY = 0.2


@dataclass(frozen=True, slots=True)
class Case:
    """Something a camera meets.

    Attributes:
        name: as it stands in the table.
        begin_s, end_s: when; an infinite end is that of the drive.
        faults: laid over the drive's events; none where the drive itself is what is hard.
    """

    name: str
    begin_s: float = 0.0
    end_s: float = math.inf
    faults: tuple[CameraFault, ...] = ()


@dataclass(frozen=True, slots=True)
class BadDrive:
    """A drive and what is made of it: makes its recording, then its cases, which the recording may decide on."""

    record: Callable[[], SimulatedRecording]
    cases: Callable[[SimulatedRecording], tuple[Case, ...]]


def _home() -> SimulatedRecording:
    """Through the living room of `flat`, round two corners."""
    return _driven("flat", 1, lambda route: follow_route(route, is_loop=True, speed_m_s=0.5), 13.0)


def _spoilt(_: SimulatedRecording) -> tuple[Case, ...]:
    def during(name: str, fault: Callable[..., CameraFault]) -> Case:
        return Case(name, _BEGIN_S, _END_S, (fault(begin_s=_BEGIN_S, end_s=_END_S),))

    return (
        Case("clean"),
        Case("depth with holes", faults=(DepthHoles(),)),
        Case("exposure in steps", faults=(ExposureSteps(),)),
        during("lights off, 3 s", LightsOff),
        during("camera covered, 3 s", Covered),
        during("cable out, 3 s", CableOut),
        during("image stuck, 3 s", StuckImage),
        Case("20 % of frames lost", faults=(FramesDropped(),)),
        Case("5 frames a second", faults=(LowRate(),)),
    )


def _crowd(seed: int) -> SimulatedRecording:
    """The same room with four people in it, seldom out of the way."""
    return _driven("flat", seed, lambda route: follow_route(route, is_loop=True, speed_m_s=0.5), 13.0, people=4)


def _crossed(recording: SimulatedRecording) -> tuple[Case, ...]:
    stamps_s = np.arange(0.0, recording.drive.duration_s, 0.1)
    settings = recording.settings
    people = Passersby(recording.world, recording.drive, settings.passersby, settings.seed, settings.robot)
    hidden = np.array([_hidden_share(recording, people, float(stamp_s)) for stamp_s in stamps_s])
    in_the_way_s = stamps_s[hidden > _IN_THE_WAY]
    name = f"people walk by, up to {100 * hidden.max():.0f} % of the view, crowd {settings.seed}"
    return (Case(name, float(in_the_way_s[0]), float(in_the_way_s[-1])),)


def _wall() -> SimulatedRecording:
    """In the corridor of `blank`: towards its dressed end, a turn to the plain wall, up to it and away, and back."""
    stamps_s = (0, 1, 3, 4, 6.6, 7.0, 8.5, 10, 10.4, 13, 14)
    v_m_s = (0, 0.5, 0, 0, 0, 0.1, -0.1, 0, 0, 0.5, 0)
    yaw_rates = (0, 0, 0, 0.6, 0, 0, 0, 0, -0.6, 0, 0)
    start = se3.from_plane(12.0, 1.2, math.pi)
    return _driven("blank", 1, lambda _: _Given(start, stamps_s, v_m_s, yaw_rates), 14.0)


def _filled(_: SimulatedRecording) -> tuple[Case, ...]:
    # From 8 m east on the wall is bare; the view's right edge passes there at these times of the turns.
    return (Case("plain wall fills the view", 5.4, 11.8),)


def _spin(seed: int) -> SimulatedRecording:
    """On the spot in `flat`: a quarter to and fro, then half a turn each way, at 90°/s."""
    rate = _RIGHT_ANGLE_S
    stamps_s, yaw_rates = (0, 1, 2, 3, 4, 5, 7, 8, 10, 11), (0, rate, 0, -rate, 0, rate, 0, -rate, 0, 0)
    return _driven("flat", seed, lambda _: ManualVelocities(stamps_s, np.zeros(10), yaw_rates), 11.0)


def _turning(recording: SimulatedRecording) -> tuple[Case, ...]:
    slow, where = (LowRate(),), f"flat {recording.settings.seed}"
    return Case(f"turns of 90°/s, {where}", 1.0, 10.0), Case(f"the same at 5 frames a second, {where}", 1.0, 10.0, slow)


# What people and quick turns do to a tracker is chance: three of each.
_CROWDS, _SPINS = (10, 12, 15), (1, 2, 5)
DRIVES = (
    BadDrive(_home, _spoilt),
    *(BadDrive(partial(_crowd, seed), _crossed) for seed in _CROWDS),
    BadDrive(_wall, _filled),
    *(BadDrive(partial(_spin, seed), _turning) for seed in _SPINS),
)


class _Given(ManualVelocities):
    """Velocities given for times, from a place given."""

    def __init__(self, T_world_start: FloatArray, *velocities: tuple[float, ...]) -> None:
        super().__init__(*velocities)
        self.T_world_start = T_world_start


def _driven(
    world_name: str, seed: int, driver: Callable[[FloatArray], Driver], duration_s: float, people: int = 0
) -> SimulatedRecording:
    """What a Kinect v1 sees of a drive, 320×240 at 30 frames a second."""
    settings = SimulationSettings(
        world_name, size=_SIZE, seed=seed, duration_s=duration_s, passersby=people, realism="real"
    )
    world, realism = build_world(world_name, seed), realism_of(settings.realism)
    drive = simulate_drive(world, Robot(), driver(world.route), seed=seed, realism=realism, time_limit_s=duration_s)
    return SimulatedRecording(
        settings, world, drive, Renderer(world, drive, settings, camera_model("kinect-v1", _SIZE))
    )


def _hidden_share(recording: SimulatedRecording, people: Passersby, stamp_s: float) -> float:
    """Share of the view's width behind whoever hides most of it."""
    camera = camera_model(recording.settings.camera, recording.settings.size).camera
    T_camera_odom = se3.invert(recording.renderer.carriage.T_world_camera(stamp_s)[0])
    shares = [0.0]
    for x, y in people.positions_at(stamp_s):
        right_m, _, ahead_m = T_camera_odom[:3, :3] @ (x, y, 0.9) + T_camera_odom[:3, 3]
        if ahead_m > RADIUS_M:
            edges_px = camera.cx + camera.fx * (right_m + np.array([-RADIUS_M, RADIUS_M])) / ahead_m
            shares.append(float(np.ptp(edges_px.clip(0, camera.width))) / camera.width)
    return max(shares)
