"""`python -m benchmarks.longdrive`: whether 20 minutes of a simulated drive make the surfel map slower or larger."""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator

from rich.console import Console

from benchmarks.growth import growth_of, growth_sheet, judge_growth
from benchmarks.known_poses import KnownSurfels, TruePoses
from benchmarks.measure import Passage, keep_to, peak_memory_mb
from benchmarks.table import targets_sheet
from wheelsight.events import RgbdFrame
from wheelsight.simulation import SimulatedRecording, SimulationSettings, simulate

_LAPS = 8


def main() -> None:
    """Drive, and print what frames took in the first and in the last quarter."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.longdrive", description=__doc__)
    parser.add_argument("--minutes", type=float, default=20.0)
    parser.add_argument("--rate", type=float, default=5.0, help="images a second")
    arguments = parser.parse_args()
    keep_to(2)
    seconds = 60 * arguments.minutes
    settings = SimulationSettings("floor4", rate_hz=arguments.rate, laps=_LAPS, duration_s=seconds, seed=1)
    recording = simulate(settings)
    surfels = KnownSurfels(recording.calibration)
    passage = drive(recording, surfels)
    name = f"floor4, {recording.drive.duration_s / 60:.0f} minutes, processor time"
    growth = growth_of(name, passage)
    console = Console(width=130)
    console.print(growth_sheet(growth).to_rich())
    console.print(targets_sheet(judge_growth(growth)).to_rich())
    status = surfels.map.status()
    console.print(
        f"{status.surfels:,} surfels, {status.dropped:,} given up, {status.memory_bytes / 1e6:.0f} MB of arrays"
    )


def drive(recording: SimulatedRecording, surfels: KnownSurfels) -> Passage:
    """Predict and fuse each frame where it truly was; only that is timed, not what renders and prepares frames.

    Processor time of all threads together: a drive takes long, and other programs hardly change it.
    """
    poses, passage = TruePoses(recording), Passage([], [], 0.0)
    for frame in _apart(recording):
        prepared, T_world_camera = surfels.prepare(frame, poses), poses.at(frame.stamp_s)
        begin = time.process_time()
        surfels.step(prepared, T_world_camera, frame.stamp_s)
        passage.seconds.append(time.process_time() - begin)
        passage.stamps_s.append(frame.stamp_s)
    return Passage(passage.stamps_s, passage.seconds, peak_memory_mb())


def _apart(recording: SimulatedRecording) -> Iterator[RgbdFrame]:
    """Frames made one by one, for none to be rendered while another is timed."""
    return map(recording.renderer.frame, range(recording.frame_count))


if __name__ == "__main__":
    main()
