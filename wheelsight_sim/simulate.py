"""Simulate a drive, and write it down: the verbs behind `wheelsight simulate`."""

from __future__ import annotations

import platform
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from wheelsight import __version__
from wheelsight.core.areas import save_areas
from wheelsight.core.calibration import save_calibration
from wheelsight.core.errors import ConfigError
from wheelsight.core.files import StrPath, make_output_folder, write_bytes, write_text
from wheelsight.core.inputs import read_bytes
from wheelsight.core.messages import RgbdFrame
from wheelsight.core.runtime import needed
from wheelsight.io.recordings import RecordingWriter
from wheelsight.io.recordings.tables import LIST
from wheelsight_sim import physics
from wheelsight_sim.cameras import camera_model
from wheelsight_sim.doors import swinging
from wheelsight_sim.faults import Covered
from wheelsight_sim.frames import Renderer
from wheelsight_sim.settings import SimulationSettings, realism_of
from wheelsight_sim.simulated_recording import SimulatedRecording, with_camera_faults
from wheelsight_sim.world import World
from wheelsight_sim.worlds import build_floor_plan, build_world

_LONGEST_DRIVE_S = 4 * 3600.0
_FORMAT = "wheelsight-simulation-1"
_PARTS = ("mujoco", "numpy", "numba", "opencv-python-headless")


def simulate(
    settings: SimulationSettings,
    on_progress: Callable[[float, float | None], None] | None = None,
    *,
    refused: StrPath | None = None,
) -> SimulatedRecording:
    """Simulate a drive through a world; reading the recording's events renders the images.

    Args:
        settings: of the simulation.
        on_progress: called about once a simulated second with the driven and the expected seconds.
        refused: path for a picture of an impossible route; default none.

    Raises:
        ConfigError: an unknown world or camera, a value out of range, a way through a wall, a fault that begins after
            the drive has ended, or MuJoCo is missing.
        InputError: a file of velocities that cannot be read; names file and line.
    """
    refused = None if refused is None else Path(refused)
    needed("mujoco")
    camera = camera_model(settings.camera, settings.size)
    world = world_of(settings)
    swinging(world, settings.doors, settings.day_seed)  # refused before the long drive
    driver = physics.driver_of(settings, world)
    physics.refuse_walls(settings, world, driver, refused)
    covers = [Covered(begin_s=begin_s, end_s=end_s, seed=settings.seed) for begin_s, end_s in settings.covered_s]
    _refuse_never(settings, settings.duration_s or _LONGEST_DRIVE_S)
    total_s = physics.expected_s(settings, world)
    report = None if on_progress is None else lambda driven_s: on_progress(driven_s, total_s)
    if settings.base != "differential":
        drive = physics.simulate_holonomic_drive(settings, world, report)
    else:
        drive = physics.simulate_drive(
            world,
            settings.robot,
            driver,
            faults=settings.faults,
            slip=settings.has_slip,
            seed=settings.day_seed,
            floor_seed=settings.seed,
            realism=realism_of(settings.realism),
            time_limit_s=settings.duration_s or _LONGEST_DRIVE_S,
            on_progress=report,
        )
    _refuse_never(settings, drive.duration_s)
    recording = SimulatedRecording(settings, world, drive, Renderer(world, drive, settings, camera))
    return with_camera_faults(recording, *covers) if covers else recording


def world_of(settings: SimulationSettings, begin: tuple[float, float, float] | None = None) -> World:
    """The world that the settings name, or that of their floor plan. Raises InputError where it cannot be built.

    Furniture of a floor plan keeps clear of where a robot begins: x, y, yaw in `map`; None: at the route's start.
    """
    if settings.plan is not None:
        least_m = 0.0 if settings.duration_s is None else settings.duration_s * settings.speed_m_s
        of = settings.plan, settings.seed, settings.robot, least_m
        return build_floor_plan(*of, day=settings.day, begin=begin)
    return build_world(settings.world, settings.seed, settings.day, has_leaves=settings.doors > 0)


def _refuse_never(settings: SimulationSettings, end_s: float) -> None:
    """Refuse what is to happen after the drive has ended. Raises ConfigError naming the option."""
    faults = settings.faults
    times = {"--cover": settings.covered_s, "--lift": faults.lifted_s}
    times |= {"--dropout": faults.dropouts_s, "--unplug": faults.unplugged_s}
    for option, spans_s in times.items():
        for begin_s, until_s in spans_s:
            if begin_s >= end_s:
                problem = f"{option} {begin_s:g}:{until_s:g} never comes: the drive ends at {end_s:.1f} s"
                raise ConfigError(problem, fix="let it begin earlier, or drive longer")


def write_simulation(
    recording: SimulatedRecording,
    folder: StrPath,
    *,
    force: bool = False,
    on_frame: Callable[[RgbdFrame], None] | None = None,
) -> RecordingWriter:
    """Render a simulated recording into a folder in wheelsight's own layout; answers the closed writer.

    Beside what every recording has, the folder gets areas.yaml, labels.csv, plan.png, and in truth/ the true
    calibration, the settings and the world. The same settings leave the same bytes. Whatever breaks the writing off
    leaves a valid shorter recording, its truth and labels as far as its frames.

    Args:
        recording: from `simulate`.
        folder: made if need be.
        force: write into a folder that holds something already.
        on_frame: called after each frame, for a progress bar.

    Raises:
        OutputError: the folder is not empty and `force` is off, cannot be written, or the disk is full.
    """
    folder = Path(folder)
    with RecordingWriter(folder, recording.calibration, force) as writer:
        _write_surroundings(recording, writer.folder)
        camera_truth = recording.camera_truth
        events, written = recording.events(), 0

        def write_truth_until(stamp_s: float) -> None:
            """Of base and camera, up to the first pose at or after `stamp_s`."""
            nonlocal written
            end = int(np.searchsorted(recording.ground_truth.stamps_s, stamp_s)) + 1
            for truth in (recording.ground_truth, camera_truth):
                writer.append_ground_truth(truth.select(slice(written, end)))
            written = max(written, end)

        try:
            for event in events:
                if isinstance(event, RgbdFrame):
                    write_truth_until(event.stamp_s)
                    writer.add_label(event.stamp_s, recording.area_at(event.stamp_s))
                writer.add(event)
                if on_frame is not None and isinstance(event, RgbdFrame):
                    on_frame(event)
        finally:
            events.close()
        write_truth_until(np.inf)
    return writer


def _write_surroundings(recording: SimulatedRecording, folder: Path) -> None:
    """All that is known before the first frame."""
    import yaml

    from wheelsight_sim.clearance import draw_plan

    settings, world = recording.settings, recording.world
    if world.areas.areas:
        save_areas(world.areas, folder / "areas.yaml")
    draw_plan(
        world,
        folder / "plan.png",
        route=physics.route_of(settings, world),
        track=recording.ground_truth.positions_m[:, :2],
    )
    truth = make_output_folder(folder / "truth", force=True)
    save_calibration(recording.true_calibration, truth / "calibration.yaml")
    write_text(truth / "world.xml", world.mjcf)
    drive = recording.drive
    versions = {"wheelsight": __version__, "python": platform.python_version()}
    document: dict[str, Any] = {
        "format": _FORMAT,
        "settings": recording.settings.to_dict(),
        "drive": {"duration_s": drive.duration_s, "is_complete": drive.is_complete, "reason": drive.reason},
        "versions": versions | {part: version(part) for part in _PARTS},
    }
    text = str(yaml.safe_dump(document, sort_keys=False, default_flow_style=None, width=100))
    write_text(truth / "settings.yaml", text)
    if settings.velocities is not None:
        write_bytes(truth / "velocities.csv", read_bytes(Path(settings.velocities), LIST, ConfigError))
    if recording.renderer.doors is not None:
        write_text(truth / "doors.csv", recording.renderer.doors.to_csv())
