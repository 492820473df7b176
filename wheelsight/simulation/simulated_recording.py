"""A simulated drive as a recording: events in order of time, rendered as they are asked for."""

from __future__ import annotations

import heapq
from collections.abc import Generator, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from wheelsight.calibration import Calibration, HolonomicWheels, Wheels
from wheelsight.events import Event
from wheelsight.geometry import FloatArray
from wheelsight.recordings import AssociationReport
from wheelsight.simulation.drive import Drive
from wheelsight.simulation.holonomic import nominal_wheels, owned_wheels
from wheelsight.simulation.realism import realism_of, stream
from wheelsight.simulation.realism.stamps import as_stamped
from wheelsight.simulation.realism.wheel_sizes import as_calibrated
from wheelsight.simulation.renderer import Renderer
from wheelsight.simulation.robot import Robot
from wheelsight.simulation.settings import SimulationSettings
from wheelsight.simulation.world import World
from wheelsight.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class SimulatedRecording:
    """A `Recording` that needs no disk; memory stays flat however long the drive is. Attributes beside the protocol's:

    settings: what it was made of.
    world: what was driven through.
    drive: what physics left; `ground_truth` is its truth.
    renderer: makes the frames.
    """

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
        return (
            *self.world.warnings,
            f"The drive ended early: {self.drive.reason}.",
        )

    def events(self, *, images: bool = True) -> Generator[Event]:
        """Readings and frames (unless without `images`) in order of time; frames are rendered a few ahead."""
        frames = self.renderer.frames()
        readings = self._readings()
        sources: tuple[Iterable[Event], ...] = (*readings, frames) if images else readings
        try:
            yield from heapq.merge(*sources, key=lambda event: event.stamp_s)
        finally:
            frames.close()

    def _readings(self) -> tuple[Sequence[Event], ...]:
        """Of gyroscope and wheels, as they are stamped."""
        realism, drive, seed = realism_of(self.settings.realism), self.drive, self.settings.day_seed
        if realism is None:
            return drive.yaw_rates, drive.readings
        gyro, wheels = stream(seed, "gyro stamps"), stream(seed, "wheel stamps")
        return as_stamped(drive.yaw_rates, realism.stamps, gyro), as_stamped(drive.readings, realism.stamps, wheels)

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
        return calibration_of(holonomic, Robot().T_base_camera, camera, "nominal")
    wheels, T_base_camera = robot.nominal, Robot().T_base_camera
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
