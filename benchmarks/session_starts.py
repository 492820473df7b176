"""Two days in one building: the map of the first, and starts in it on the second."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import nan
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.calibrated_sources import with_calibration
from benchmarks.calibrated_unit import calibration_for
from wheelsight.app.run.maps import open_known
from wheelsight.app.runs import run_each
from wheelsight.config import load_config
from wheelsight.core.calibration import Calibration
from wheelsight.core.estimates import Estimate, Status
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.keyframes import KeyframeId
from wheelsight.core.messages import Event, RgbdFrame
from wheelsight.core.trajectory import Trajectory
from wheelsight.estimation import Localizer
from wheelsight.slam.maps import MapFolder, find_map, in_largest_piece
from wheelsight_sim import FloorPlan, SimulatedRecording, SimulationSettings, simulate

ALONE, JOINED = "camera alone", "joined"
MODES = (ALONE, JOINED)
_ODOMETRY = {ALONE: "dense", JOINED: "wheels,dense"}
WINDOW_S, SEEN_S = 10.0, 3.0
WRONG_M, WRONG_DEG = 0.5, 10.0
_SEED, _PEOPLE = 5, 2


@dataclass(frozen=True)
class Building:
    """A world of the simulator, or a floor plan."""

    name: str
    world: str
    plan: FloorPlan | None

    @property
    def where(self) -> dict[str, Any]:
        """The setting of the simulator that names it."""
        return {"world": self.world} if self.plan is None else {"plan": self.plan}


@dataclass(frozen=True, eq=False)
class FirstDay:
    """What the first day left.

    Attributes:
        name: of the building.
        folder: of the map.
        T_world_map: (4, 4) by rigid alignment of the corrected trajectory.
        T_world_base, T_map_base: (K, 4, 4) at keyframes that hang together: as they truly are, and as the map has it.
        ate_m: what that leaves, RMSE.
        way_m: how long the lap was.
        keyframes, together: of the map, and how many of them hang together: the others are not recognised.
    """

    name: str
    folder: Path
    T_world_map: FloatArray
    T_world_base: FloatArray
    T_map_base: FloatArray
    ate_m: float
    way_m: float
    keyframes: int
    together: int


@dataclass(frozen=True, eq=False)
class SecondDay:
    """Its events in order, kept to be begun anywhere, and the truth."""

    events: list[Event]
    truth: Trajectory
    source: SimulatedRecording


@dataclass(frozen=True)
class Start:
    """What became of a start.

    Attributes:
        building, mode: where it is, and by what.
        moment_s: of the second day.
        found_s: after how many seconds it was found; None where it was not.
        first_m, first_deg: how far off it was then, beside the map's nearest keyframe.
        error_m, error_deg: medians of that from then on.
        aligned_m, aligned_deg: medians likewise, by the one alignment of the whole map.
        keyframe_ms: what the loop thread took for each keyframe.
    """

    building: str
    mode: str
    moment_s: float
    found_s: float | None
    first_m: float
    first_deg: float
    error_m: float
    error_deg: float
    aligned_m: float
    aligned_deg: float
    keyframe_ms: tuple[float, ...]

    @property
    def is_wrong(self) -> bool:
        """Whether another place was taken for it."""
        return self.found_s is not None and (self.first_m > WRONG_M or self.first_deg > WRONG_DEG)

    def is_found_within(self, limit_s: float) -> bool:
        """And rightly so."""
        return self.found_s is not None and self.found_s <= limit_s and not self.is_wrong

    @property
    def sentence(self) -> str:
        """For the terminal."""
        where = f"{self.building} at {self.moment_s:.1f} s, {self.mode}"
        if self.found_s is None:
            return f"{where}: not found"
        return f"{where}: found after {self.found_s:.1f} s, {self.error_m:.3f} m and {self.error_deg:.2f}° off"


def first_day(building: Building, folder: Path, rate_hz: float, units: Path | None = None) -> FirstDay:
    """Drive a lap and map it, by wheels and camera joined; `units` as in `drive_in`."""
    config = load_config(overrides={"odometry": "wheels,dense", "map": "surfels", "loops.source": "keyframes"})
    source = _driven(building, rate_hz, units, day=0)
    record = next(one for one in run_each(source, config, folder) if one.odometry == JOINED)
    assert record.correction is not None
    assert record.correction.evaluation is not None
    found = record.correction.evaluation.ate
    path = find_map(folder / JOINED)
    left = MapFolder.open(path)
    together = in_largest_piece(left)
    counts = len(left.store), int(together.sum())
    numbers = [KeyframeId(int(number)) for number in np.flatnonzero(together)]
    T_camera_base = se3.invert(np.asarray(left.calibration.T_base_camera))
    T_map_base = left.store.T_map_keyframe[together] @ T_camera_base
    truth = record.ground_truth
    assert truth is not None
    way_m = float(truth.distances_m[-1])
    T_world_base = truth.at(np.clip([left.store[number].stamp_s for number in numbers], *truth.stamps_s[[0, -1]]))
    poses = found.T_truth_estimate, T_world_base, T_map_base
    return FirstDay(building.name, path, *poses, found.translation.rmse, way_m, *counts)


def second_day(building: Building, rate_hz: float, units: Path | None = None) -> tuple[Calibration, SecondDay]:
    """Drive a lap of another day; `units` as in `drive_in`."""
    source = _driven(building, rate_hz, units, day=1)
    return source.calibration, SecondDay(list(source.events()), source.ground_truth, source)


def _driven(building: Building, rate_hz: float, units: Path | None, *, day: int) -> SimulatedRecording:
    return drive_in(building, rate_hz, _SEED, day=day, passersby=_PEOPLE if day else 0, units=units)


def drive_in(
    building: Building,
    rate_hz: float,
    seed: int,
    *,
    day: int = 0,
    passersby: int = 0,
    laps: int = 1,
    units: Path | None = None,
) -> SimulatedRecording:
    """A simulated drive by real sensors; what it is given is as in `SimulationSettings`.

    With a folder `units` of calibrations, its robot is calibrated, once for all its drives; else it is believed to be
    as the data sheet says.
    """
    how = {"size": (320, 240), "rate_hz": rate_hz, "seed": seed, "realism": "real"}
    settings = SimulationSettings(day=day, passersby=passersby, laps=laps, **building.where, **how)  # type: ignore[arg-type]
    recording = simulate(settings)
    return recording if units is None else with_calibration(recording, calibration_for(settings, units))


def moments_of(day: SecondDay, count: int) -> list[float]:
    """So many stamps, evenly over the drive, from its begin to where there is just time enough."""
    begin_s, end_s = day.events[0].stamp_s, day.events[-1].stamp_s
    return [float(moment_s) for moment_s in np.linspace(begin_s, end_s - WINDOW_S, count)]


def start_at(
    moment_s: float,
    mode: str,
    calibration: Calibration,
    day: SecondDay,
    known: FirstDay,
    building: str,
    *,
    has_truth: bool = True,
) -> Start:
    """Begin the second day at a moment, in the map of a first one."""
    subject, close = localizer_in(known, mode, calibration, day)
    seen = found_by(subject, [event for event in day.events if moment_s <= event.stamp_s < moment_s + WINDOW_S])
    loops = subject.loops
    assert loops is not None
    keyframe_ms = tuple(1e3 * float(seconds) for seconds in loops.finish().processing_s)
    subject.close()
    close()
    found_s = seen[0].stamp_s - moment_s if seen else None
    if not (seen and has_truth):
        return Start(building, mode, moment_s, found_s, nan, nan, nan, nan, nan, nan, keyframe_ms)
    off = np.array([off_by(estimate, day.truth, known) for estimate in seen])
    first_m, first_deg = off[0, :2].tolist()
    error_m, error_deg, aligned_m, aligned_deg = np.median(off, axis=0).tolist()
    errors = error_m, error_deg, aligned_m, aligned_deg
    return Start(building, mode, moment_s, found_s, first_m, first_deg, *errors, keyframe_ms)


def localizer_in(
    known: FirstDay, mode: str, calibration: Calibration, day: SecondDay
) -> tuple[Localizer, Callable[[], None]]:
    """A localizer that begins somewhere in the map of the first day, and what closes the map."""
    config = load_config(overrides={"odometry": _ODOMETRY[mode], "known_map.path": str(known.folder)})
    opened = open_known(day.source.calibration, config)
    assert opened is not None
    return Localizer(calibration, config, known=opened[0], waits=True), opened[1].close


def found_by(subject: Localizer, events: Sequence[Event], seen_s: float = SEEN_S) -> list[Estimate]:
    """What frames were answered from the first that was found in the map, for so many seconds."""
    seen: list[Estimate] = []
    for event in events:
        answer = subject.process(event)
        if not isinstance(event, RgbdFrame) or answer is None:
            continue
        if answer.status is Status.TRACKING and answer.T_map_body is not None:
            seen.append(answer)
        if seen and answer.stamp_s > seen[0].stamp_s + seen_s:
            break
    return seen


def off_by(estimate: Estimate, truth: Trajectory, known: FirstDay) -> tuple[float, float, float, float]:
    """Metres and degrees of heading: beside the map's nearest keyframe, and by the alignment of the whole map."""
    T_world_base, T_map_found = truth.at([estimate.stamp_s])[0], np.asarray(estimate.T_map_body)
    T_map_true = beside_nearest(T_world_base, known.T_world_base, known.T_map_base)
    here, aligned = (se3.invert(T) @ T_map_found for T in (T_map_true, se3.invert(known.T_world_map) @ T_world_base))
    return (*_size(here), *_size(aligned))


def beside_nearest(T: FloatArray, T_of: FloatArray, T_to: FloatArray) -> FloatArray:
    """A pose (4, 4) in another frame, by the nearest of keyframes, which lie in its own and in the other (K, 4, 4)."""
    nearest = int(se3.view_shift_m(se3.invert(T_of) @ T).argmin())
    return np.asarray(T_to[nearest] @ se3.invert(T_of[nearest]) @ T)


def _size(D: FloatArray) -> tuple[float, float]:
    return float(np.linalg.norm(D[:3, 3])), float(np.degrees(abs(np.arctan2(D[1, 0], D[0, 0]))))
