"""Drives for `trinh_rectification.py`: simulated, their frames described twice over, and kept in files."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np

import wheelsight
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.errors import InputError
from wheelsight.core.files import atomic_write
from wheelsight.core.geometry import Float32Array, FloatArray, IntArray, se3
from wheelsight.core.messages import RgbdFrame
from wheelsight.core.trajectory import Trajectory
from wheelsight.places import HistogramDescriber, LayoutDescriber
from wheelsight.places.describers import has_depth, size_of
from wheelsight.wheels import integrate_log
from wheelsight_sim import SimulatedRecording, SimulationSettings
from wheelsight_sim.simulate import simulate

HISTOGRAMS, LAYOUT = HistogramDescriber(), LayoutDescriber()
_MADE_BY = (
    "wheelsight_sim/**/*.py",
    "wheelsight/places/describers.py",
    "wheelsight/places/describer_kernels.py",
)
_THREADS = 2
# Physics of a second take about as long as half a frame.
_FRAMES_A_SECOND = 0.5
_ABOUT_A_LAP_S = 160.0


@dataclass(frozen=True)
class DriveSettings:
    """Which drive: how it is simulated, and how many of its frames are described, evenly spread over it."""

    simulation: SimulationSettings
    frames: int

    @property
    def work(self) -> float:
        """About how long it takes, in frames."""
        return self.frames + _FRAMES_A_SECOND * _ABOUT_A_LAP_S * self.simulation.laps

    def file(self, folder: Path) -> Path:
        """Where it is kept; another name for other settings, and for other code that would make another drive."""
        says = {"drive": self.simulation.to_dict(), "frames": self.frames, "code": _code()}
        says |= {"histograms": HISTOGRAMS.settings, "layout": LAYOUT.settings}
        digest = hashlib.sha256(json.dumps(says, sort_keys=True).encode()).hexdigest()[:16]
        return folder / f"drive-{self.simulation.seed}-{digest}.npz"


@dataclass(frozen=True, eq=False)
class DescribedDrive:
    """A drive at its N frames.

    Attributes:
        stamps_s: (N,).
        T_map_base: (N, 4, 4) where the base truly was.
        labels: (N,) index of the area it truly was in.
        histograms, layout: (N, D) the frames in numbers.
        has_depth: (N,) whether enough depth was measured for the area to be told.
        frame_size: (4,) height and width of colour, then of depth.
        ticks: (M, 3) stamps and counts of the left and the right wheel.
        T_map_start: (4, 4) where the base was at the first of these.
    """

    stamps_s: FloatArray
    T_map_base: FloatArray
    labels: IntArray
    histograms: Float32Array
    layout: Float32Array
    has_depth: Any
    frame_size: IntArray
    ticks: FloatArray
    T_map_start: FloatArray

    @property
    def truth(self) -> FloatArray:
        """(N, 2) metres."""
        return self.T_map_base[:, :2, 3]

    def reckoned(self, wheels: Wheels) -> Trajectory:
        """T_odom_base at the readings, with covariances."""
        return integrate_log(wheels, *self.ticks.T).trajectory()

    def odometry(self, wheels: Wheels) -> FloatArray:
        """(N, 2) metres in the world, by the wheels alone from the true start on."""
        T_odom_base = self.reckoned(wheels).at(np.clip(self.stamps_s, *self.ticks[[0, -1], 0]))
        return np.asarray(se3.compose(self.T_map_start, T_odom_base)[:, :2, 3])

    def save(self, path: Path) -> None:
        """Write it, atomically."""
        with atomic_write(path, "wb") as stream:
            np.savez_compressed(stream, allow_pickle=False, **vars(self))

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read it. Raises InputError for a file that is damaged."""
        try:
            with np.load(path, allow_pickle=False) as kept:
                return cls(**kept)
        except (OSError, ValueError, TypeError, KeyError, EOFError) as error:
            raise InputError("is no drive", path=path, fix="delete it; it will be made again") from error


def make_drives(wanted: Sequence[DriveSettings], folder: Path, *, is_quiet: bool = False) -> list[DescribedDrive]:
    """The drives, read from `folder` where they are, else made, two at a time, and kept there."""
    missing = [settings for settings in dict.fromkeys(wanted) if not settings.file(folder).is_file()]
    with _progress(is_quiet) as progress, ThreadPoolExecutor(_THREADS) as pool:
        bar = progress.add_task("driving and looking", total=sum(settings.work for settings in missing) or 1)
        jobs = {
            pool.submit(_make, settings, lambda work: progress.advance(bar, work)): settings for settings in missing
        }
        try:
            for job in as_completed(jobs):
                job.result().save(jobs[job].file(folder))
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    return [DescribedDrive.load(settings.file(folder)) for settings in wanted]


def _make(settings: DriveSettings, advance: Any) -> DescribedDrive:
    driven_s = 0.0

    def on_progress(now_s: float, _: float | None) -> None:
        nonlocal driven_s
        advance(_FRAMES_A_SECOND * (now_s - driven_s))
        driven_s = now_s

    recording = simulate(settings.simulation, on_progress)
    return described(recording, settings.frames, advance)


def described(recording: SimulatedRecording, count: int, advance: Any = lambda work: None) -> DescribedDrive:
    """A simulated drive with `count` of its frames in numbers; only these are rendered."""
    numbers = np.unique(np.linspace(0, recording.frame_count - 1, count).round().astype(int))
    rows = [_row(frame, advance) for frame in _frames(recording, numbers)]
    histograms, layout, seen, sizes, stamps_s = zip(*rows, strict=True)
    truth, ticks = recording.ground_truth, recording.drive.ticks
    T_map_base = truth.at(np.clip(stamps_s, *truth.stamps_s[[0, -1]]))
    return DescribedDrive(
        np.array(stamps_s),
        T_map_base,
        recording.world.areas.index_at(T_map_base[:, :2, 3]),
        np.array(histograms),
        np.array(layout),
        np.array(seen),
        np.array(sizes[0]),
        np.array([(reading.stamp_s, reading.left, reading.right) for reading in ticks], float),
        truth.at([ticks[0].stamp_s])[0],
    )


def _frames(recording: SimulatedRecording, numbers: IntArray) -> Iterator[RgbdFrame]:
    for number in numbers:
        yield recording.renderer.frame(int(number))


def _row(frame: RgbdFrame, advance: Any) -> tuple[Any, ...]:
    advance(1)
    return HISTOGRAMS.describe(frame), LAYOUT.describe(frame), has_depth(frame), size_of(frame), frame.stamp_s


def _code() -> str:
    """Of the files whose change would make another drive."""
    root = Path(wheelsight.__file__).parent.parent
    digest = hashlib.sha256()
    for path in sorted({path for pattern in _MADE_BY for path in root.glob(pattern)}):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def _progress(is_quiet: bool) -> Any:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    return Progress(*columns, console=console, disable=is_quiet or not console.is_terminal, transient=True)
