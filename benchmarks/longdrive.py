"""`python -m benchmarks.longdrive`: whether 20 minutes of a simulated drive make the surfel map slower or larger."""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from dataclasses import replace

from rich.console import Console

from benchmarks.growth import Growth, growth_of, growth_sheet, judge_growth
from benchmarks.known_poses import KnownSurfels, TruePoses
from benchmarks.measure import Passage, keep_to, peak_memory_mb
from benchmarks.table import targets_sheet
from wheelsight.core.messages import RgbdFrame
from wheelsight_sim import SimulatedRecording, SimulationSettings, simulate

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
    yardstick, passage = drive(recording, surfels)
    name = f"floor4, {recording.drive.duration_s / 60:.0f} minutes, processor time"
    growth, slower = growth_of(name, passage), growth_of(name, yardstick)
    console = Console(width=130)
    console.print(growth_sheet(growth).to_rich())
    console.print(
        f"preparing a frame, which knows no map: {slower.first_ms:.1f} ms in the first quarter, "
        f"{slower.last_ms:.1f} ms in the last: so much slower was the machine, {slower.percent:+.1f} %"
    )
    console.print(targets_sheet(judge_growth(against(growth, slower))).to_rich())
    status = surfels.map.status()
    console.print(
        f"{status.surfels:,} surfels, {status.dropped:,} given up, {status.memory_bytes / 1e6:.0f} MB of arrays"
    )


def against(growth: Growth, yardstick: Growth) -> Growth:
    """With the last quarter as it would be, had what should take the same time all along done so."""
    return replace(growth, last_ms=growth.last_ms * yardstick.first_ms / yardstick.last_ms)


def drive(recording: SimulatedRecording, surfels: KnownSurfels) -> tuple[Passage, Passage]:
    """Predict and fuse each frame where it truly was; how long it took to prepare frames, and to do that.

    Processor time of all threads together, since a drive takes long and other programs hardly change it; but machines
    get slower when they are warm or their memory is full. The time to prepare a frame, without the map, shows that.
    """
    poses = TruePoses(recording)
    stamps_s: list[float] = []
    preparing_s: list[float] = []
    mapping_s: list[float] = []
    for frame in _apart(recording):
        T_odom_camera, begin = poses.at(frame.stamp_s), time.process_time()
        prepared = surfels.prepare(frame, poses)
        between = time.process_time()
        surfels.step(prepared, T_odom_camera, frame.stamp_s)
        mapping_s.append(time.process_time() - between)
        preparing_s.append(between - begin)
        stamps_s.append(frame.stamp_s)
    memory_mb = peak_memory_mb()
    return Passage(stamps_s, preparing_s, memory_mb), Passage(stamps_s, mapping_s, memory_mb)


def _apart(recording: SimulatedRecording) -> Iterator[RgbdFrame]:
    """Frames made one by one, for none to be rendered while another is timed."""
    return map(recording.renderer.frame, range(recording.frame_count))


if __name__ == "__main__":
    main()
