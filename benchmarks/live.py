"""`python -m benchmarks.live`: what closing loops costs a robot while it drives.

Real recordings are played at their own pace, frames decoded beforehand, once without loops and once with them, on two
threads. The loop thread works in parallel, and no frame waits for it; the table counts keyframes that it skipped. "A
frame" is the time from the frame to its answer. "The longest closure" is the longest time that a frame stood still for
keyframes to be moved. With `--minutes` wheels and camera, joined, also drive laps of a simulated house that long,
with loops closed and a map built and written: what do memory and the time of a frame do? The drive is rendered by
another process, so that what this one holds is what `wheelsight run --live` would hold, its records and results too.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from rich.console import Console

from benchmarks import machine
from benchmarks.live_hour import Hour, driven_apart, hour_sheets, judge_hour
from benchmarks.measure import keep_to
from benchmarks.sequences import default_data_folder
from benchmarks.table import Sheet, targets_sheet, write_page
from benchmarks.targets import Target
from wheelsight.config import load_config
from wheelsight.core.errors import InputError
from wheelsight.core.geometry import FloatArray
from wheelsight.core.keyframes import KeyframeId
from wheelsight.core.messages import RgbdFrame
from wheelsight.estimation import Localizer
from wheelsight.io.recordings import open_recording

RECORDINGS = "rgbd_dataset_freiburg1_desk", "freiburg1_rpy_part", "red_kitchen"
WITHOUT, WITH = "without", "with"
GROWTH_PERCENT, CLOSURE_MS = 10.0, 50.0
_WARM_UP_FRAMES = 5
_MORE_S = 2.0  # of the loop thread, after the last frame, so that the next drive does not wait for it
HEADER = "recording", "loops", "frames", "median ms", "p95 ms", "closures", "the longest closure ms", "not compared"


class MovesKeyframes(Protocol):
    """`Localizer.loops`, as far as closures go."""

    def move_keyframes(self, stamp_s: float, keyframe: KeyframeId | None) -> FloatArray | None:
        """See there."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """One recording, played once.

    Attributes:
        name: of the recording.
        loops: whether they were closed.
        frame_s: (N,) seconds from each frame to its answer.
        closure_s: seconds for which frames stood still, one for each time that keyframes were moved.
        unseen: keyframes that the loop thread had no time for.
    """

    name: str
    loops: str
    frame_s: FloatArray
    closure_s: tuple[float, ...] = ()
    unseen: int = 0

    @property
    def median_ms(self) -> float:
        """Of a frame."""
        return 1e3 * float(np.median(self.frame_s))

    @property
    def p95_ms(self) -> float:
        """95 % of frames take no longer."""
        return 1e3 * float(np.percentile(self.frame_s, 95))

    @property
    def row(self) -> tuple[str, ...]:
        """Of the table."""
        longest = f"{1e3 * max(self.closure_s):.1f}" if self.closure_s else "—"
        counts = str(len(self.closure_s)), longest, str(self.unseen)
        return self.name, self.loops, str(len(self.frame_s)), f"{self.median_ms:.1f}", f"{self.p95_ms:.1f}", *counts


def played(path: Path, loops: str) -> Drive:
    """A recording at its own pace, by dense odometry with a map.

    Raises InputError for one without frames that can be read.
    """
    recording = open_recording(path)
    frames = [event for event in recording.events() if isinstance(event, RgbdFrame)]
    if len(frames) <= _WARM_UP_FRAMES:
        raise InputError("has hardly a frame", path=path, fix="name another recording")
    source = {"loops.source": "keyframes"} if loops == WITH else {}
    settings = {"odometry": "dense", "map": "surfels", **source}
    localizer = Localizer(recording.calibration, load_config(overrides=settings))
    closures = [] if localizer.loops is None else timed(localizer.loops)
    frame_s = np.array(list(_paced(localizer, frames)))
    unseen = 0
    if localizer.loops is not None:
        time.sleep(_MORE_S)
        unseen = localizer.loops.finish().unseen
    localizer.close()
    return Drive(path.name, loops, frame_s[_WARM_UP_FRAMES:], tuple(closures), unseen)


def timed(loops: MovesKeyframes) -> list[float]:
    """A list that grows by the seconds of each closure from now on."""
    closures: list[float] = []
    move = loops.move_keyframes

    def moved(stamp_s: float, keyframe: KeyframeId | None) -> FloatArray | None:
        begin_s = time.perf_counter()
        answer = move(stamp_s, keyframe)
        if answer is not None:
            closures.append(time.perf_counter() - begin_s)
        return answer

    vars(loops)["move_keyframes"] = moved
    return closures


def _paced(localizer: Localizer, frames: Sequence[RgbdFrame]) -> Iterator[float]:
    """Seconds of each frame, which is given at its own time, or right after the one before where that took longer."""
    first_s, begin_s = frames[0].stamp_s, time.perf_counter()
    for frame in frames:
        time.sleep(max(0.0, begin_s + frame.stamp_s - first_s - time.perf_counter()))
        given_s = time.perf_counter()
        localizer.process(frame)
        yield time.perf_counter() - given_s


def judge(drives: Sequence[Drive], hour: Hour | None) -> Iterator[Target]:
    """What must be reached."""
    for bare, looped in zip(drives[::2], drives[1::2], strict=True):
        name = bare.name
        pairs = {"median": (bare.median_ms, looped.median_ms), "95 %": (bare.p95_ms, looped.p95_ms)}
        for figure, (before_ms, after_ms) in pairs.items():
            more = 100 * (after_ms / before_ms - 1)
            yield Target(f"{name}: {figure} of a frame, more than without loops", GROWTH_PERCENT, more, "%")
    closures = [seconds for drive in drives for seconds in drive.closure_s]
    if drives:
        longest_ms = 1e3 * max(closures) if closures else None
        yield Target(f"the longest closure of {len(closures)}", CLOSURE_MS, longest_ms, "ms")
    if hour is not None:
        yield from judge_hour(hour)


def sheets_of(drives: Sequence[Drive], hour: Hour | None) -> list[Sheet]:
    """What was measured, and what must be reached."""
    sheets = [Sheet("Frames at their own pace", HEADER, tuple(drive.row for drive in drives))] if drives else []
    sheets += [] if hour is None else hour_sheets(hour)
    return [*sheets, targets_sheet(list(judge(drives, hour)))]


def main() -> None:
    """Print what was measured, and write it where asked to."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.live", description=__doc__)
    parser.add_argument("--data", type=Path, default=default_data_folder(), help="folder with rgbd/RECORDING in it")
    parser.add_argument("--recordings", nargs="*", default=list(RECORDINGS), metavar="RECORDING")
    parser.add_argument("--minutes", type=float, default=0.0, help="of the simulated drive; none if 0")
    parser.add_argument("--out", type=Path, help="Markdown to write")
    arguments = parser.parse_args()
    about, console, drives = machine.description(), Console(width=150), list[Drive]()
    about["Command"] = f"`python -m benchmarks.live --minutes {arguments.minutes:g}`"
    keep_to(2)
    for name in arguments.recordings:
        for loops in (WITHOUT, WITH):
            drives.append(played(arguments.data / "rgbd" / name, loops))
            console.print(" · ".join(drives[-1].row))
    sheets = sheets_of(drives, driven_apart(arguments.minutes) if arguments.minutes > 0 else None)
    for sheet in sheets:
        console.print(sheet.to_rich())
    if arguments.out is not None:
        write_page(arguments.out, "While driving", __doc__ or "", about, sheets)


if __name__ == "__main__":
    main()
