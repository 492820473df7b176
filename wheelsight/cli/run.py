"""`wheelsight run`: where the camera went."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from wheelsight.cli._console import INTERRUPTED
from wheelsight.cli._options import CalibrationFile, Camera, DepthFactor, MaxGap, RecordingPath, settings_from

if TYPE_CHECKING:
    from wheelsight.config import Config
    from wheelsight.report import RunRecord


Out = Annotated[Path, typer.Option(metavar="DIR", help="Folder for the results; made if need be.", show_default=False)]
Odometry = Annotated[
    str | None,
    typer.Option(metavar="NAME", help="How motion is estimated: features or wheels.", show_default="features"),
]
SettingsFile = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="Settings in YAML; options given here win over it.", show_default=False),
]
Reference = Annotated[
    str | None,
    typer.Option(metavar="NAME", help="What a frame is aligned with: previous or keyframes.", show_default="keyframes"),
]
Integration = Annotated[
    str | None,
    typer.Option(metavar="NAME", help="How wheels are integrated: arc, midpoint or euler.", show_default="arc"),
]
Gyro = Annotated[
    bool | None, typer.Option("--gyro/--no-gyro", help="Join a gyroscope with the wheels.", show_default="--gyro")
]
Seed = Annotated[int | None, typer.Option(help="Seed of all random choices.", show_default="0")]
Force = Annotated[bool, typer.Option("--force", help="Overwrite results in DIR.")]


def run(
    recording: RecordingPath,
    out: Out,
    odometry: Odometry = None,
    camera: Camera = None,
    calibration: CalibrationFile = None,
    config: SettingsFile = None,
    depth_factor: DepthFactor = None,
    max_gap: MaxGap = None,
    reference: Reference = None,
    integration: Integration = None,
    gyro: Gyro = None,
    seed: Seed = None,
    force: Force = False,
) -> None:
    """Find where the robot or its camera went: trajectory, status of each frame, metrics and a report go to DIR.

    DIR gets trajectory.txt (TUM), status.csv, metrics.json, the resolved config.yaml and report.html.

    Ctrl-C stops early and keeps what was found until then.

    [bold]Examples[/bold]

    wheelsight run rgbd_dataset_freiburg1_desk --out results

    wheelsight run my_recording --camera my_camera.yaml --config settings.yaml --out results --force

    wheelsight run my_recording --odometry wheels --calibration my_wheels.yaml --out results
    """
    of_recording = {"--camera": camera, "--calibration": calibration, "--depth-factor": depth_factor}
    of_features = {"--max-gap": max_gap, "--reference": reference, "--seed": seed}
    of_wheels = {"--integration": integration, "--gyro": gyro}
    settings = settings_from({"--odometry": odometry, **of_recording, **of_features, **of_wheels}, config)
    _print_summary(_track(recording, settings, out, force), out)


def _track(folder: Path, settings: Config, out: Path, force: bool) -> RunRecord:
    from wheelsight import pipeline
    from wheelsight.cli._console import print_note
    from wheelsight.cli._progress import FrameProgress
    from wheelsight.recordings import open_recording

    source = open_recording(folder, settings.recording.open_options())
    at_first = "" if _kernels_are_compiled() else "compiling kernels, once after installation"
    try:
        count = source.wheel_count if settings.odometry == "wheels" else source.frame_count
        with FrameProgress("tracking", count, at_first) as progress:
            return pipeline.run(source, settings, out, force=force, on_frame=lambda f: progress.advance(str(f.status)))
    except KeyboardInterrupt as interruption:
        print_note(f"interrupted; what was found until then is in {out}")
        raise typer.Exit(INTERRUPTED) from interruption


def _kernels_are_compiled() -> bool:
    """Whether odometry's compiled kernels are in numba's cache, beside their sources or where NUMBA_CACHE_DIR says."""
    from wheelsight import odometry

    folder = Path(os.environ.get("NUMBA_CACHE_DIR") or Path(odometry.__file__).parent)
    return any(folder.rglob("*kernels*.nbi"))


def _print_summary(record: RunRecord, out: Path) -> None:
    from wheelsight.cli._console import console, facts_table, print_warning
    from wheelsight.cli.evaluate import evaluation_table

    stdout = console()
    stdout.print(facts_table(f"{record.recording}: T_{record.estimate.world}_{record.estimate.body}", _facts(record)))
    if record.evaluation is not None:
        stdout.print(evaluation_table(record.evaluation))
    for warning in record.warnings:
        print_warning(warning)
    stdout.print(f"report: {out / 'report.html'}")


def _facts(record: RunRecord) -> Iterator[tuple[str, str]]:
    from wheelsight.cli._console import percent
    from wheelsight.report import summarise

    summary = summarise(record)
    digits = ".1f" if summary.unit == "frame" else ".4f"
    yield f"{summary.unit}s", f"{summary.posed} of {summary.frames} with a pose ({percent(summary.pose_share)})"
    for why, count in summary.skips:
        yield "skipped", f"{count} × {why}"
    for why, count in summary.failures:
        yield "no pose", f"{count} × {why}"
    if summary.lost_episodes:
        times = "once" if summary.lost_episodes == 1 else f"{summary.lost_episodes} times"
        yield "lost", f"{times}, for {summary.lost_s:.2f} s in all"
    yield "way", f"{summary.length_m:.2f} m in {summary.duration_s:.2f} s"
    yield (
        f"time a {summary.unit}",
        f"median {1e3 * summary.median_s:{digits}} ms, 95 % within {1e3 * summary.p95_s:{digits}} ms",
    )
    if record.evaluation is None:
        yield "not evaluated", record.evaluation_problem or ""
