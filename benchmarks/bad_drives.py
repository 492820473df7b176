"""Short simulated drives for what a camera may meet: each rendered once, then spoilt in one way after another."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np

from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.messages import Event
from wheelsight_sim import (
    ManualVelocities,
    RealismName,
    Renderer,
    RobotModel,
    SimulatedRecording,
    SimulationSettings,
    build_world,
    camera_model,
    realism_of,
    simulate_drive,
)
from wheelsight_sim.drivers import Driver, follow_route
from wheelsight_sim.faults import (
    CableOut,
    CameraFault,
    Covered,
    DarkRoom,
    DepthHoles,
    DirectSun,
    ExposureSteps,
    FramesDropped,
    GlassWall,
    LightsOff,
    LowRate,
    Mirror,
    Silence,
    StillView,
    StuckImage,
    WheelsStand,
)
from wheelsight_sim.people import RADIUS_M, Passersby

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

    record: Callable[[RealismName], SimulatedRecording]
    cases: Callable[[SimulatedRecording], tuple[Case, ...]]


def _home(realism: RealismName) -> SimulatedRecording:
    """Through the living room of `flat`, round two corners."""
    return _driven(realism, "flat", 1, _along_the_route, 13.0)


def _along_the_route(route: FloatArray) -> Driver:
    return follow_route(route, is_loop=True, speed_m_s=0.5)


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
        Case("carried off while covered, 4 s", *_carried(4.0)),
        during("glass wall in 40 % of the view, 3 s", GlassWall),
        during("mirror in 40 % of the view, 3 s", Mirror),
        during("direct sun, 3 s", DirectSun),
        during("dark room, 3 s", DarkRoom),
        during("view stands still while wheels turn, 3 s", StillView),
        during("elevator: view stands still, wheels too, 3 s", _Elevator),
        Case("USB silent, 5 s", _BEGIN_S, _BEGIN_S + 5.0, (Silence(begin_s=_BEGIN_S, end_s=_BEGIN_S + 5.0),)),
    )


def _carried(lasting_s: float) -> tuple[float, float, tuple[CameraFault, ...]]:
    """A camera covered by a hand, and wheels in the air, while the robot is carried along the drive."""
    begin_s, end_s = _BEGIN_S, _BEGIN_S + lasting_s
    return begin_s, end_s, (Covered(begin_s=begin_s, end_s=end_s), WheelsStand(begin_s=begin_s, end_s=end_s))


@dataclass(frozen=True, kw_only=True)
class _Elevator(StillView):
    """Wheels and view stand still; then it opens at another place."""

    def apply(self, events: Iterable[Event]) -> Iterator[Event]:
        """The events, with both faults."""
        return super().apply(WheelsStand(begin_s=self.begin_s, end_s=self.end_s).apply(events))


def _other_camera(camera: str, size: tuple[int, int], realism: RealismName) -> SimulatedRecording:
    """The same way with images of another size; shorter, for memory's sake."""
    return _driven(realism, "flat", 1, _along_the_route, 4.0, camera=camera, size=size)


def _as_it_is(recording: SimulatedRecording) -> tuple[Case, ...]:
    width, height = recording.settings.size or (0, 0)
    return (Case(f"camera of {width}×{height}"),)


def _crowd(seed: int, realism: RealismName) -> SimulatedRecording:
    """The same room with four people in it, seldom out of the way."""
    return _driven(realism, "flat", seed, _along_the_route, 13.0, people=4)


def _crossed(recording: SimulatedRecording) -> tuple[Case, ...]:
    stamps_s = np.arange(0.0, recording.drive.duration_s, 0.1)
    settings = recording.settings
    people = Passersby(recording.world, recording.drive, settings.passersby, settings.seed, settings.robot)
    hidden = np.array([_hidden_share(recording, people, float(stamp_s)) for stamp_s in stamps_s])
    in_the_way_s = stamps_s[hidden > _IN_THE_WAY]
    name = f"people walk by, up to {100 * hidden.max():.0f} % of the view, crowd {settings.seed}"
    return (Case(name, float(in_the_way_s[0]), float(in_the_way_s[-1])),)


def _wall(realism: RealismName) -> SimulatedRecording:
    """In the corridor of `blank`: towards its dressed end, a turn to the plain wall, up to it and away, and back."""
    stamps_s = (0, 1, 3, 4, 6.6, 7.0, 8.5, 10, 10.4, 13, 14)
    v_m_s = (0, 0.5, 0, 0, 0, 0.1, -0.1, 0, 0, 0.5, 0)
    yaw_rates = (0, 0, 0, 0.6, 0, 0, 0, 0, -0.6, 0, 0)
    start = se3.from_plane(12.0, 1.2, math.pi)
    return _driven(realism, "blank", 1, lambda _: _Given(start, stamps_s, v_m_s, yaw_rates), 14.0)


def _filled(_: SimulatedRecording) -> tuple[Case, ...]:
    # From 8 m east on the wall is bare; the view's right edge passes there at these times of the turns.
    return (Case("plain wall fills the view", 5.4, 11.8),)


def _spin(seed: int, realism: RealismName) -> SimulatedRecording:
    """On the spot in `flat`: a quarter to and fro, then half a turn each way, at 90°/s."""
    rate = _RIGHT_ANGLE_S
    stamps_s, yaw_rates = (0, 1, 2, 3, 4, 5, 7, 8, 10, 11), (0, rate, 0, -rate, 0, rate, 0, -rate, 0, 0)
    return _driven(realism, "flat", seed, lambda _: ManualVelocities(stamps_s, np.zeros(10), yaw_rates), 11.0)


def _turning(recording: SimulatedRecording) -> tuple[Case, ...]:
    slow, where = (LowRate(),), f"flat {recording.settings.seed}"
    return Case(f"turns of 90°/s, {where}", 1.0, 10.0), Case(f"the same at 5 frames a second, {where}", 1.0, 10.0, slow)


# What people and quick turns do to a tracker is chance: three of each.
_CROWDS, _SPINS = (10, 12, 15), (1, 2, 5)
# A RealSense's images, and a Kinect v2's; a Kinect v1's are 640×480.
_OTHER_CAMERAS = (("kinect-v1", (848, 480)), ("kinect-v2", (512, 424)))
DRIVES = (
    BadDrive(_home, _spoilt),
    *(BadDrive(partial(_crowd, seed), _crossed) for seed in _CROWDS),
    BadDrive(_wall, _filled),
    *(BadDrive(partial(_spin, seed), _turning) for seed in _SPINS),
    *(BadDrive(partial(_other_camera, *camera), _as_it_is) for camera in _OTHER_CAMERAS),
)


class _Given(ManualVelocities):
    """Velocities given for times, from a place given."""

    def __init__(self, T_world_start: FloatArray, *velocities: tuple[float, ...]) -> None:
        super().__init__(*velocities)
        self.T_world_start = T_world_start


def _driven(
    realism: RealismName,
    world_name: str,
    seed: int,
    driver: Callable[[FloatArray], Driver],
    duration_s: float,
    people: int = 0,
    camera: str = "kinect-v1",
    size: tuple[int, int] = _SIZE,
) -> SimulatedRecording:
    """What a camera sees of a drive, a Kinect v1's 320×240 unless reported otherwise, at 30 frames a second."""
    settings = SimulationSettings(
        world_name, camera, size=size, seed=seed, duration_s=duration_s, passersby=people, realism=realism
    )
    world, robot, as_real = build_world(world_name, seed), RobotModel(), realism_of(realism)
    drive = simulate_drive(world, robot, driver(world.route), seed=seed, realism=as_real, time_limit_s=duration_s)
    return SimulatedRecording(settings, world, drive, Renderer(world, drive, settings, camera_model(camera, size)))


def _hidden_share(recording: SimulatedRecording, people: Passersby, stamp_s: float) -> float:
    """Share of the view's width behind a person who hides most of it."""
    camera = camera_model(recording.settings.camera, recording.settings.size).camera
    T_camera_odom = se3.invert(recording.renderer.carriage.T_world_camera(stamp_s)[0])
    shares = [0.0]
    for x, y in people.positions_at(stamp_s):
        right_m, _, ahead_m = T_camera_odom[:3, :3] @ (x, y, 0.9) + T_camera_odom[:3, 3]
        if ahead_m > RADIUS_M:
            edges_px = camera.cx + camera.fx * (right_m + np.array([-RADIUS_M, RADIUS_M])) / ahead_m
            shares.append(float(np.ptp(edges_px.clip(0, camera.width))) / camera.width)
    return max(shares)
