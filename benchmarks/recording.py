"""`python -m benchmarks.recording`: whether a camera at 30 Hz is recorded without a frame dropped.

Frames of a real recording, decoded beforehand and with noise as JPEG takes it away, come as from a camera, 640×480, in
their time, and are recorded by the same threads as `wheelsight record` uses, on two cores. "CPU" is what the whole
program used a frame, "cores" how many that keeps busy. First, what each way to encode an image takes. Where the machine
is busy with others' work, frames are late or dropped for that: the CPU figures stand all the same.
"""

from __future__ import annotations

import argparse
import itertools
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import get_args

import cv2
import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from benchmarks import machine
from benchmarks.measure import keep_to
from benchmarks.sequences import default_data_folder
from benchmarks.table import Sheet, targets_sheet, write_page
from benchmarks.targets import Target
from wheelsight.core.calibration import Calibration
from wheelsight.core.messages import RgbdFrame
from wheelsight.io.devices.cameras import PlayedCamera
from wheelsight.io.devices.recorder import LiveRecorder, RecordingSession
from wheelsight.io.recordings import RecordingWriter, open_recording
from wheelsight.io.recordings.images import FAST_PNG, JPEG_QUALITY, ColorFormat
from wheelsight.io.recordings.tum_datasets import DEPTH_FACTOR

RECORDING = "rgbd_dataset_freiburg1_desk"
RATE_HZ, SECONDS, FRAMES, NOISE = 30.0, 20.0, 40, 3
SLOW_PNG = (cv2.IMWRITE_PNG_COMPRESSION, 1)
_ONE_FILTER = (*SLOW_PNG, cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_SUB)
ENCODERS: tuple[tuple[str, str, tuple[int, ...]], ...] = (
    ("PNG 1, all filters tried", ".png", SLOW_PNG),
    ("PNG 1, one filter", ".png", _ONE_FILTER),
    ("PNG 1, one filter, runs alone", ".png", FAST_PNG),
    ("PNG 0", ".png", (cv2.IMWRITE_PNG_COMPRESSION, 0)),
    (f"JPEG {JPEG_QUALITY}", ".jpg", (cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY)),
)


@dataclass(frozen=True, slots=True)
class Recorded:
    """How one recording went.

    Attributes:
        color: as it was kept.
        seconds: it took.
        frames: that are in it.
        lost: by cause.
        size_mb: of the images.
        cpu_s: that the program used.
    """

    color: str
    seconds: float
    frames: int
    lost: dict[str, int]
    size_mb: float
    cpu_s: float

    @property
    def rate_hz(self) -> float:
        """Frames a second that were written."""
        return self.frames / self.seconds

    @property
    def cpu_ms(self) -> float:
        """A frame."""
        return 1e3 * self.cpu_s / max(self.frames, 1)

    @property
    def row(self) -> tuple[str, ...]:
        """Of the table."""
        lost = ", ".join(f"{cause} {count}" for cause, count in self.lost.items()) or "0"
        share = f"{RATE_HZ * self.cpu_ms / 1e3:.2f}"
        return (
            *(self.color, str(self.frames), f"{self.rate_hz:.1f}", lost),
            *(f"{self.cpu_ms:.1f}", share, f"{self.size_mb / self.seconds:.1f}"),
        )


def noisy_frames(folder: Path) -> tuple[Calibration, list[RgbdFrame]]:
    """Frames spread over a recording, with noise of a few levels. Raises InputError."""
    recording, rng = open_recording(folder), np.random.default_rng(0)
    step = max(recording.frame_count // FRAMES, 1)
    found = [event for event in recording.events() if isinstance(event, RgbdFrame) and event.index % step == 0]
    noisy = []
    for frame in found[:FRAMES]:
        noise = rng.integers(-NOISE, NOISE + 1, frame.color.shape)
        noisy.append(replace(frame, color=np.clip(frame.color + noise, 0, 255).astype(np.uint8)))
    return recording.calibration, noisy


def encoded(frames: Sequence[RgbdFrame]) -> Iterator[tuple[str, ...]]:
    """For each way to encode: CPU and size of colour and of depth."""
    color = [cv2.cvtColor(frame.color, cv2.COLOR_RGB2BGR) for frame in frames]
    depth = [np.rint(np.minimum(frame.depth_m * DEPTH_FACTOR, 65535)).astype(np.uint16) for frame in frames]
    for name, kind, flags in ENCODERS:
        of_depth = ("—", "—") if kind == ".jpg" else _timed(depth, kind, flags)
        yield name, *_timed(color, kind, flags), *of_depth


def _timed(images: Sequence[NDArray[np.integer | np.floating]], kind: str, flags: Sequence[int]) -> tuple[str, str]:
    begin_s, size = time.thread_time(), 0
    for image in images:
        size += cv2.imencode(kind, image, flags)[1].size
    return f"{1e3 * (time.thread_time() - begin_s) / len(images):.1f}", f"{size / len(images) / 1e3:.0f}"


def recorded(calibration: Calibration, frames: Sequence[RgbdFrame], color: ColorFormat, seconds: float) -> Recorded:
    """A camera of these frames, over and over, recorded for so long."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "recording"
        camera = PlayedCamera("frames", calibration, in_time(frames))
        with LiveRecorder(RecordingWriter(out, calibration, color=color)) as recorder:
            session = RecordingSession(recorder, out, camera, None)
            begin_s, cpu_s = time.perf_counter(), time.process_time()
            session.run(lambda: False, seconds=seconds)
            look = session.status()
            camera.close()
        took_s, cpu_s = time.perf_counter() - begin_s, time.process_time() - cpu_s
        report = recorder.report()
    return Recorded(color, took_s, report.frames, look.drops, report.size_bytes / 1e6, cpu_s)


def in_time(frames: Sequence[RgbdFrame]) -> Iterator[RgbdFrame]:
    """The frames over and over, at the camera's rate."""
    for number, frame in enumerate(itertools.cycle(frames)):
        yield replace(frame, stamp_s=number / RATE_HZ, index=number)


def judge(runs: Sequence[Recorded]) -> Iterator[Target]:
    """What must be reached."""
    for run in runs:
        yield Target(f"{run.color}: frames a second", RATE_HZ - 0.5, run.rate_hz, "frames/s", is_least=True)
        yield Target(f"{run.color}: frames dropped", 0, sum(run.lost.values()), "frames", 0)
        yield Target(f"{run.color}: cores at {RATE_HZ:g} Hz", 2.0, RATE_HZ * run.cpu_ms / 1e3, "cores", 2)


def main() -> None:
    """Print what was measured, and write it where asked to."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.recording", description=__doc__)
    parser.add_argument("--data", type=Path, default=default_data_folder(), help="folder with rgbd/RECORDING in it")
    parser.add_argument("--recording", default=RECORDING, metavar="RECORDING")
    parser.add_argument("--seconds", type=float, default=SECONDS, help="of each recording")
    parser.add_argument("--out", type=Path, help="Markdown to write")
    arguments = parser.parse_args()
    about, console = machine.description(), Console(width=140)
    about["Command"] = f"`python -m benchmarks.recording --seconds {arguments.seconds:g}`"
    keep_to(2)
    calibration, frames = noisy_frames(arguments.data / "rgbd" / arguments.recording)
    rows = tuple(encoded(frames))
    runs = [recorded(calibration, frames, color, arguments.seconds) for color in get_args(ColorFormat)]
    sheets = [
        Sheet("Encoders, a frame", ("encoder", "colour ms", "colour kB", "depth ms", "depth kB"), rows),
        Sheet(
            "A camera at 30 Hz, recorded",
            ("colour", "frames", "frames/s", "dropped", "CPU ms/frame", "cores", "MB/s"),
            tuple(run.row for run in runs),
        ),
        targets_sheet(list(judge(runs))),
    ]
    for sheet in sheets:
        console.print(sheet.to_rich())
    if arguments.out is not None:
        write_page(arguments.out, "Recording a camera", __doc__ or "", about, sheets)


if __name__ == "__main__":
    main()
