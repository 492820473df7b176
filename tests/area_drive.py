"""A drive through three areas by wheels that turn the robot aside, with frames whose look shows the area."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from drives import simulate
from places.made import NAMES, frame_of, trained
from stand_ins import CAMERA, MemoryRecording

from wheelsight.config import Config, load_config
from wheelsight.core.areas import Area, AreaMap, save_areas
from wheelsight.core.calibration import Calibration
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.geometry import se3
from wheelsight.core.messages import Event, RgbdFrame, WheelTicks
from wheelsight.core.trajectory import Trajectory
from wheelsight.io.recordings import RecordingWriter

TRUE_WHEELS = Wheels(0.17, 0.17, 0.52, 3200.0)
BELIEVED_WHEELS = replace(TRUE_WHEELS, right_radius_m=0.1713)
AREAS = AreaMap(
    (
        Area(NAMES[0], np.array([[-2, -2], [20, -2], [20, 2], [-2, 2]], float), y_m=0.0),
        Area(NAMES[1], np.array([[20, -2], [23, -2], [23, 13.5], [20, 13.5]], float), x_m=21.0),
        Area(NAMES[2], np.array([[-2, 10], [20, 10], [20, 13.5], [-2, 13.5]], float), y_m=11.9),
    )
)
T_WORLD_START = se3.from_plane(0.5, 0.0, 0.0)
_LEGS = [(20.0, 1.0, 0.0), (3.0, 0.5, np.pi / 6), (10.0, 1.0, 0.0), (3.0, 0.5, np.pi / 6), (18.0, 1.0, 0.0)]
# Half of the drive's readings, so that tests are quick.
_EVERY, _FRAME_EVERY = 2, 10


@dataclass(frozen=True)
class AreaDrive:
    """Events in order of time, and the true T_odom_base at each reading."""

    events: tuple[Event, ...]
    truth: Trajectory

    @property
    def frames(self) -> list[RgbdFrame]:
        return [event for event in self.events if isinstance(event, RgbdFrame)]


@cache
def area_drive() -> AreaDrive:
    """25 readings and 5 frames a second; areas are distinguished by what frames show, but at borders some err."""
    rng = np.random.default_rng(5)
    drive = simulate(TRUE_WHEELS, _LEGS, rng=rng)
    truth = drive.truth.moved(T_WORLD_START)
    events: list[Event] = []
    for i in range(0, len(truth), _EVERY):
        stamp_s = float(truth.stamps_s[i])
        events.append(WheelTicks(stamp_s, int(drive.left[i]), int(drive.right[i])))
        if i % _FRAME_EVERY == 0:
            area = int(AREAS.index_at(truth.T_frame_body[i, :2, 3]))
            shown = frame_of(max(area, 0), rng)
            events.append(replace(shown, stamp_s=stamp_s + 0.001, index=i // _FRAME_EVERY))
    return AreaDrive(tuple(events), truth.select(slice(None, None, _EVERY)))


def calibration() -> Calibration:
    return Calibration.registered_camera(CAMERA, wheels=BELIEVED_WHEELS, T_base_camera=np.eye(4), source="drive")


def area_recording(folder: Path, with_truth: bool = True) -> MemoryRecording:
    """The drive in memory; areas and model lie in `folder`, as areas.yaml and three.places."""
    save_areas(AREAS, folder / "areas.yaml")
    trained().save(folder / "three.places")
    drive = area_drive()
    truth = drive.truth if with_truth else None
    return MemoryRecording(drive.events, truth, calibration=calibration(), path=folder)


def by_areas(folder: Path, **places: object) -> Config:
    """Settings of wheels that the model in `folder` rectifies."""
    given = {f"places.{name}": value for name, value in {"model": str(folder / "three.places"), **places}.items()}
    return load_config(overrides={"odometry": "wheels", **given})


def write_area_drive(folder: Path, every_frame: int = 10) -> Path:
    """A part of the drive as a recording on disk, areas.yaml beside it; the model's path."""
    drive = area_drive()
    with RecordingWriter(folder, calibration()) as writer:
        for event in drive.events:
            if not isinstance(event, RgbdFrame) or event.index % every_frame == 0:
                writer.add(event)
        writer.add_ground_truth(drive.truth)
    save_areas(AREAS, folder / "areas.yaml")
    model = folder.parent / "three.places"
    trained().save(model)
    return model
