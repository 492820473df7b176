"""A simulated drive as a recording: events in order of time, rendered as they are asked for."""

from __future__ import annotations

import heapq
from collections.abc import Generator, Iterable, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter1d

from wheelsight.core.calibration import Calibration
from wheelsight.core.calibration_parts import HolonomicWheels, Wheels
from wheelsight.core.errors import ConfigError
from wheelsight.core.geometry import FloatArray, se3, so3
from wheelsight.core.messages import Event, RgbdFrame
from wheelsight.core.runtime import needed
from wheelsight.core.trajectory import Trajectory
from wheelsight.io.recordings import AssociationReport
from wheelsight_sim.cameras import Carriage, camera_model
from wheelsight_sim.faults import CameraFault, events_with
from wheelsight_sim.frames import Renderer
from wheelsight_sim.physics import nominal_wheels, owned_wheels
from wheelsight_sim.readings import as_stamped
from wheelsight_sim.robot import Drive, RobotModel, as_calibrated
from wheelsight_sim.settings import SimulationSettings, realism_of, stream
from wheelsight_sim.world import World
from wheelsight_sim.worlds import build_world


@dataclass(frozen=True, eq=False)
class SimulatedRecording:
    """A `Recording` that needs no disk; memory stays flat however long the drive is."""

    settings: SimulationSettings
    world: World
    drive: Drive
    renderer: Renderer

    @property
    def name(self) -> str:
        """World and seed, and the day where it is not the first."""
        day = f"-day{self.settings.day}" if self.settings.day else ""
        return f"{self.world.name}-{self.settings.seed}{day}"

    @property
    def path(self) -> Path:
        """No folder holds it; this says where it came from."""
        return Path("simulation") / self.name

    @property
    def format(self) -> str:
        """No reader's: it was simulated."""
        return "simulation"

    @property
    def body(self) -> str:
        """The robot's base."""
        return "base"

    @property
    def calibration(self) -> Calibration:
        """What the robot's owner measured: the nominal wheels and camera mount, none of the errors injected.

        Of a real robot whose wheels were given no errors, they are as a calibration has left them.
        """
        return as_owned(self.settings, self.renderer.calibration)

    @property
    def true_calibration(self) -> Calibration:
        """What the robot truly is."""
        T_base_camera, settings = self.renderer.carriage.T_base_camera, self.settings
        is_holonomic = settings.base != "differential"
        wheels = nominal_wheels(settings) if is_holonomic else settings.robot.wheels
        return calibration_of(wheels, T_base_camera, self.renderer.true_calibration, "true")

    @property
    def camera_truth(self) -> Trajectory:
        """T_world_camera, on a body that may move against the base."""
        stamps_s = self.drive.truth.stamps_s
        return Trajectory(stamps_s, self.renderer.carriage.T_world_camera(stamps_s), body="camera")

    @property
    def frame_count(self) -> int:
        """How many frames `events()` will yield."""
        return self.renderer.frame_count

    @property
    def wheel_count(self) -> int:
        """How many wheel readings `events()` will yield."""
        return len(self.drive.readings)

    @property
    def association(self) -> AssociationReport:
        """Each colour image has its depth image, of the same moment."""
        count = self.frame_count
        return AssociationReport(count, count, count, 0.0)

    @property
    def ground_truth(self) -> Trajectory:
        """T_world_base, as physics had it."""
        return self.drive.truth

    @property
    def warnings(self) -> tuple[str, ...]:
        """Those of the world, and why the drive ended before the end of its route, unless that was asked for."""
        is_asked_for = self.settings.duration_s is not None and self.drive.duration_s >= self.settings.duration_s
        if self.drive.is_complete or is_asked_for:
            return self.world.warnings
        return (*self.world.warnings, f"The drive ended early: {self.drive.reason}.")

    def events(self, *, images: bool = True) -> Generator[Event]:
        """Readings and frames (unless without `images`) in order of time; frames are rendered a few ahead."""
        frames = self.renderer.frames()
        realism, drive, seed = realism_of(self.settings.realism), self.drive, self.settings.day_seed
        readings: tuple[Sequence[Event], ...] = drive.yaw_rates, drive.readings
        if realism is not None:
            readings = (
                as_stamped(drive.yaw_rates, realism.stamps, stream(seed, "gyro stamps")),
                as_stamped(drive.readings, realism.stamps, stream(seed, "wheel stamps")),
            )
        sources: tuple[Iterable[Event], ...] = (*readings, frames) if images else readings
        try:
            yield from heapq.merge(*sources, key=lambda event: event.stamp_s)
        finally:
            frames.close()

    def area_at(self, stamp_s: float) -> str | None:
        """The area in which the base truly was."""
        T_world_base = self.drive.truth.at(np.clip(stamp_s, *self.drive.truth.stamps_s[[0, -1]]))[0]
        return self.world.areas.name_at(float(T_world_base[0, 3]), float(T_world_base[1, 3]))


def as_owned(settings: SimulationSettings, camera: Calibration) -> Calibration:
    """What a robot's owner measured; `camera` is the calibration of the camera alone, as they have it."""
    robot, realism = settings.robot, realism_of(settings.realism)
    if settings.base != "differential":
        holonomic = nominal_wheels(settings)
        if realism is not None:
            holonomic = owned_wheels(settings, realism.wheel_sizes, stream(settings.seed, "wheel sizes"))
        return calibration_of(holonomic, RobotModel().T_base_camera, camera, "nominal")
    wheels, T_base_camera = robot.nominal, RobotModel().T_base_camera
    if realism is not None and robot.wheels == wheels:
        wheels = as_calibrated(wheels, realism.wheel_sizes, stream(settings.seed, "wheel sizes"))
    return calibration_of(wheels, T_base_camera, camera, "nominal")


def calibration_of(
    wheels: Wheels | HolonomicWheels, T_base_camera: FloatArray, camera: Calibration, kind: str
) -> Calibration:
    """Cameras, mount and wheels in one; `camera` is the calibration of the camera alone, `kind` a word for reports."""
    if isinstance(wheels, HolonomicWheels):
        source = f"{camera.source}, {kind} holonomic base, simulated"
        return replace(camera, T_base_camera=T_base_camera, holonomic=wheels, source=source)
    source = f"{camera.source}, {kind} wheelchair, simulated"
    return replace(camera, T_base_camera=T_base_camera, wheels=wheels, source=source)


@dataclass(frozen=True, eq=False)
class FaultyRecording(SimulatedRecording):
    """A `SimulatedRecording` seen through camera faults; truth and wheel readings are the same.

    Attributes:
        camera_faults: the first acts first.
    """

    camera_faults: tuple[CameraFault, ...] = ()

    @property
    def frame_count(self) -> int:
        """How many frames are left."""
        blank = np.zeros((2, 2, 3), np.uint8), np.zeros((2, 2), np.float32)
        stamps_s = (self.renderer.stamp_s(index) for index in range(self.renderer.frame_count))
        frames = (RgbdFrame(stamp_s, *blank, index) for index, stamp_s in enumerate(stamps_s))
        return sum(1 for _ in events_with(self.camera_faults, frames))

    def events(self, *, images: bool = True) -> Generator[Event]:
        """Readings and frames (unless without `images`) in order of time, as they come with the faults."""
        events = super().events(images=images)
        try:
            yield from events_with(self.camera_faults, events)
        finally:
            events.close()


def with_camera_faults(recording: SimulatedRecording, *faults: CameraFault) -> FaultyRecording:
    """The same drive with a camera that fails."""
    made_of = {field.name: getattr(recording, field.name) for field in fields(SimulatedRecording)}
    return FaultyRecording(**made_of, camera_faults=faults)


_PERIOD_S = 0.005


def replay(
    settings: SimulationSettings, T_world_camera: Trajectory, world: World | None = None, *, smooth_s: float = 0.02
) -> SimulatedRecording:
    """A recording by a camera that moves as another one did; its stamps begin at 0 s.

    Args:
        settings: world, camera, size, rate, seed, realism, and `duration_s`, which may end it early. There is no robot:
            nothing drives, and the mount is exact.
        T_world_camera: the way, in the world: x and y on the floor, z up.
        world: in place of the one the settings name.
        smooth_s: deviation of the Gaussian that takes the jitter of the system that measured the way out of it; 1 mm of
            it from one pose of 100 Hz to the next is 0.1 m/s that was not. 0 leaves the way as it is.

    Raises:
        ConfigError: an unknown world or camera, a way too short for a frame, or MuJoCo is missing.
    """
    needed("mujoco")
    if len(T_world_camera) < 2:
        raise ConfigError(f"a way of {len(T_world_camera)} poses has no motion", fix="give a trajectory of a recording")
    if world is None:
        world = build_world(settings.world, settings.seed, settings.day, has_leaves=settings.doors > 0)
    # From 0 s on, every 5 ms.
    way_s, begin_s = T_world_camera.duration_s, T_world_camera.stamps_s[0]
    whole_s = way_s if settings.duration_s is None else min(way_s, settings.duration_s)
    stamps_s = np.asarray(_PERIOD_S * np.arange(int(whole_s / _PERIOD_S + 1e-9) + 1), np.float64)
    T = T_world_camera.at((stamps_s + begin_s).clip(None, T_world_camera.stamps_s[-1]))
    if smooth_s > 0:
        quaternions = so3.to_quaternion(T[:, :3, :3])
        # q and -q are one rotation: each takes the sign that is nearer to the one before.
        signs = np.where(np.einsum("ni,ni->n", quaternions[1:], quaternions[:-1]) < 0, -1.0, 1.0)
        quaternions[1:] *= np.cumprod(signs)[:, None]
        sigma = smooth_s / _PERIOD_S
        positions = gaussian_filter1d(T[:, :3, 3], sigma, axis=0, mode="nearest")
        quaternions = gaussian_filter1d(quaternions, sigma, axis=0, mode="nearest")
        quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
        T = se3.from_quaternion(positions, quaternions)
    T_base_camera = settings.robot.T_base_camera
    drive = Drive(Trajectory(stamps_s, se3.compose(T, se3.invert(T_base_camera)), body="base"), ())
    model = camera_model(settings.camera, settings.size)
    renderer = Renderer(world, drive, settings, model, Carriage(drive.truth, T_base_camera))
    return SimulatedRecording(settings, world, drive, renderer)
