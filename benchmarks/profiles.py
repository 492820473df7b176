"""`python -m benchmarks.profiles`: what `--profile pi` saves and costs, on one core.

Each frame goes to two localizers in turn, one with default settings and one with the profile's, so that what else the
machine does hits both alike; all is held to one core, as with one thread. Read the ratio of both columns, not
milliseconds, which are this machine's. Real recordings are followed by features, and by dense odometry with a map; the
simulated drive is a flat at 640×480 by a Kinect, wheels and camera joined, with a map and loops. "Median ms" is from a
frame to its answer; "CPU ms" is the mean processor time of the whole program, with all threads.
Errors are the RMSE after rigid alignment of the poses that are there, so read them with their share. Controllers of
`wheelsight drive` are timed at the end.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from benchmarks import machine
from benchmarks.control import CHAIR, command_ms, places
from benchmarks.joined_hour import events_apart
from benchmarks.measure import keep_to
from benchmarks.sequences import default_data_folder
from benchmarks.table import Sheet, write_page
from wheelsight.config import Config, load_config
from wheelsight.core.errors import EvaluationError
from wheelsight.core.estimates import Estimate
from wheelsight.core.geometry import FloatArray
from wheelsight.core.messages import Event, RgbdFrame
from wheelsight.core.trajectory import Trajectory
from wheelsight.estimation import Localizer
from wheelsight.evaluation import ate
from wheelsight.io.recordings import express_for, open_recording
from wheelsight.navigation.controllers import MppiController
from wheelsight_sim import SimulationSettings, simulate

RECORDINGS = "rgbd_dataset_freiburg1_desk", "freiburg1_rpy_part", "red_kitchen"
PROFILE = "pi"
NAMES: Mapping[str, str | None] = {"default": None, PROFILE: PROFILE}
ALONE: Mapping[str, Mapping[str, str]] = {
    "features": {"odometry": "features"},
    "dense, map": {"odometry": "dense", "map": "surfels"},
}
JOINED = {"odometry": "wheels,dense", "map": "surfels", "loops.source": "keyframes"}
SECONDS, RATE_HZ, SEED = 60.0, 10.0, 1
_WARM_UP_FRAMES = 5
HEADER = ("drive", "settings", "frames", "poses", "error m", "median ms", "p95 ms", "CPU ms", "keyframes", "surfels")


@dataclass(slots=True)
class Followed:
    """What one localizer made of a drive.

    Attributes:
        localizer: with the settings in question.
        frame_s, cpu_s: of each frame, seconds from it to its answer, and of processor time.
        posed: the frames' answers that have a pose.
    """

    localizer: Localizer
    frame_s: list[float] = field(default_factory=list)
    cpu_s: list[float] = field(default_factory=list)
    posed: list[Estimate] = field(default_factory=list)

    def answer(self, event: Event) -> None:
        """Time one event; wheel readings are heard and not counted."""
        begin_s, cpu_s = time.perf_counter(), time.process_time()
        estimate = self.localizer.process(event)
        if not isinstance(event, RgbdFrame):
            return
        self.frame_s.append(time.perf_counter() - begin_s)
        self.cpu_s.append(time.process_time() - cpu_s)
        if estimate is not None and estimate.T_odom_body is not None:
            self.posed.append(estimate)

    def trajectory(self, body: str) -> Trajectory | None:
        """Of all that has a pose, at the poses as they were reported; None of less than two."""
        stamps_s = np.array([estimate.stamp_s for estimate in self.posed])
        poses: list[FloatArray] = [np.asarray(estimate.T_map_body) for estimate in self.posed]
        return Trajectory(stamps_s, np.array(poses), body=body) if len(poses) > 1 else None


@dataclass(frozen=True, slots=True)
class Cost:
    """A row of the table.

    Attributes:
        drive, settings: which.
        frames, posed: how many frames came, and have a pose.
        error_m: RMSE of positions after alignment; None where it cannot be reported.
        median_ms, p95_ms, cpu_ms: of a frame.
        keyframes, surfels: kept at the end; None where there is no map.
    """

    drive: str
    settings: str
    frames: int
    posed: int
    error_m: float | None
    median_ms: float
    p95_ms: float
    cpu_ms: float
    keyframes: int
    surfels: int | None

    @property
    def row(self) -> tuple[str, ...]:
        """Of the table."""
        share = f"{100 * self.posed / self.frames:.1f} %"
        error = "—" if self.error_m is None else f"{self.error_m:.4f}"
        times = f"{self.median_ms:.1f}", f"{self.p95_ms:.1f}", f"{self.cpu_ms:.1f}"
        surfels = "—" if self.surfels is None else f"{self.surfels:,}"
        return self.drive, self.settings, str(self.frames), share, error, *times, str(self.keyframes), surfels


def configs(base: Mapping[str, Any]) -> dict[str, Config]:
    """Default settings and the profile's, by name, both on one thread."""
    return {name: load_config(overrides={**base, "profile": profile}) for name, profile in NAMES.items()}


def costs_of(drive: str, events: Iterable[Event], truth: Trajectory, localizers: Mapping[str, Localizer]) -> list[Cost]:
    """Each localizer's row, of the same events, one event after the other."""
    followed = {name: Followed(localizer) for name, localizer in localizers.items()}
    for event in events:
        for one in followed.values():
            one.answer(event)
    for one in followed.values():
        one.localizer.close()
    return [_cost(drive, name, one, truth) for name, one in followed.items()]


def _cost(drive: str, name: str, one: Followed, truth: Trajectory) -> Cost:
    localizer, frame_ms = one.localizer, 1e3 * np.array(one.frame_s[_WARM_UP_FRAMES:])
    trajectory = one.trajectory(localizer.body)
    try:
        error_m = None if trajectory is None else float(ate(trajectory, truth).translation.rmse)
    except EvaluationError:
        error_m = None
    times = float(np.median(frame_ms)), float(np.percentile(frame_ms, 95)), 1e3 * float(np.mean(one.cpu_s[5:]))
    kept = 0 if localizer.keyframes is None else len(localizer.keyframes)
    surfels = None if localizer.map is None else len(localizer.map)
    return Cost(drive, name, len(one.frame_s), len(one.posed), error_m, *times, kept, surfels)


def of_recording(path: Path, way: str, limit: int | None) -> list[Cost]:
    """A real recording by one odometry. Raises InputError where it cannot be read."""
    recording = open_recording(path)
    assert recording.ground_truth is not None
    localizers = {name: Localizer(recording.calibration, config) for name, config in configs(ALONE[way]).items()}
    body = next(iter(localizers.values())).body
    truth = express_for(body, recording.ground_truth, recording.calibration)
    frames = (event for event in recording.events() if isinstance(event, RgbdFrame))
    return costs_of(f"{path.name}, {way}", _first(frames, limit), truth, localizers)


def of_simulation(seconds: float) -> list[Cost]:
    """Wheels and camera joined in a simulated flat, by a Kinect at full size."""
    settings = SimulationSettings("flat", size=(640, 480), rate_hz=RATE_HZ, duration_s=seconds, seed=SEED)
    recording = simulate(settings)
    localizers = {
        name: Localizer(recording.calibration, config, waits=True) for name, config in configs(JOINED).items()
    }
    truth = express_for("base", recording.ground_truth, recording.calibration)
    return costs_of("simulated flat, joined", events_apart(recording), truth, localizers)


def _first(events: Iterable[Event], limit: int | None) -> Iterator[Event]:
    for number, event in enumerate(events):
        if limit is not None and number >= limit:
            return
        yield event


def control_sheet() -> Sheet:
    """What a command takes by default and by the profile."""
    by = {name: load_config(overrides={"profile": profile}).navigation for name, profile in NAMES.items()}
    rows = []
    for place, (cost_field, people) in places().items():
        medians = [
            command_ms(MppiController(CHAIR, settings=navigation.mppi), cost_field, people)[1]
            for navigation in by.values()
        ]
        rows.append((place, *(f"{ms:.2f}" for ms in medians), f"{medians[1] / medians[0]:.2f}"))
    rollouts = ", ".join(f"{name} {navigation.mppi.rollouts}" for name, navigation in by.items())
    heads = "place", *(f"{name}, ms" for name in NAMES), "ratio"
    return Sheet(f"A command by MPPI, median of processor time; rollouts: {rollouts}", heads, tuple(rows))


def ratio_sheet(costs: Sequence[Cost]) -> Sheet:
    """The profile's figures as shares of the default's."""
    rows = [
        (
            plain.drive,
            f"{small.median_ms / plain.median_ms:.2f}",
            f"{small.cpu_ms / plain.cpu_ms:.2f}",
            "—" if plain.error_m is None or small.error_m is None else f"{small.error_m / plain.error_m:.2f}",
            f"{100 * (small.posed / small.frames - plain.posed / plain.frames):+.1f}",
        )
        for plain, small in zip(costs[::2], costs[1::2], strict=True)
    ]
    heads = "drive", "median of a frame", "CPU of a frame", "error", "poses, points of a hundred"
    return Sheet(f"--profile {PROFILE} over the default", heads, tuple(rows))


def main() -> None:
    """Print what was measured, and write it where asked to."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.profiles", description=__doc__)
    parser.add_argument("--data", type=Path, default=default_data_folder(), help="folder with rgbd/RECORDING in it")
    parser.add_argument("--recordings", nargs="*", default=list(RECORDINGS), metavar="RECORDING")
    parser.add_argument("--frames", type=int, help="only the first so many frames of each recording")
    parser.add_argument("--seconds", type=float, default=SECONDS, help="of the simulated drive; none if 0")
    parser.add_argument("--out", type=Path, help="Markdown to write")
    arguments = parser.parse_args()
    about, console, costs = machine.description(), Console(width=160), list[Cost]()
    about["Command"] = f"`python -m benchmarks.profiles --seconds {arguments.seconds:g}`"
    keep_to(1)
    for name in arguments.recordings:
        for way in ALONE:
            costs += of_recording(arguments.data / "rgbd" / name, way, arguments.frames)
            console.print(*(" · ".join(cost.row) for cost in costs[-2:]), sep="\n")
    costs += of_simulation(arguments.seconds) if arguments.seconds > 0 else []
    sheets = [ratio_sheet(costs), Sheet("Frames on one core", HEADER, tuple(cost.row for cost in costs))]
    sheets.append(control_sheet())
    for sheet in sheets:
        console.print(sheet.to_rich())
    if arguments.out is not None:
        write_page(arguments.out, "A small computer", __doc__ or "", about, sheets)


if __name__ == "__main__":
    main()
