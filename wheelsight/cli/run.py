"""`wheelsight run`: where the camera went."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from wheelsight.cli._console import INTERRUPTED
from wheelsight.cli._options import CalibrationFile, Camera, DepthFactor, MaxGap, RecordingPath, settings_from
from wheelsight.cli._summary import print_summary

if TYPE_CHECKING:
    from wheelsight.config import Config
    from wheelsight.recordings import Recording
    from wheelsight.report import FrameRecord, RunRecord


Out = Annotated[Path, typer.Option(metavar="DIR", help="Folder for the results; made if need be.", show_default=False)]
Odometry = Annotated[
    str | None,
    typer.Option(
        metavar="NAME[,NAME]",
        help="How motion is estimated: features, wheels, or both, each alone.",
        show_default="features",
    ),
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
    With several odometries each has a folder of its name, and report.html and metrics.json join them.

    Ctrl-C stops early and keeps what was found until then.

    [bold]Examples[/bold]

    wheelsight run rgbd_dataset_freiburg1_desk --out results

    wheelsight run my_recording --camera my_camera.yaml --config settings.yaml --out results --force

    wheelsight run my_recording --odometry wheels --calibration my_wheels.yaml --out results

    wheelsight run my_recording --odometry wheels,features --out results
    """
    of_recording = {"--camera": camera, "--calibration": calibration, "--depth-factor": depth_factor}
    of_features = {"--max-gap": max_gap, "--reference": reference, "--seed": seed}
    of_wheels = {"--integration": integration, "--gyro": gyro}
    settings = settings_from({"--odometry": odometry, **of_recording, **of_features, **of_wheels}, config)
    print_summary(_track(recording, settings, out, force), out)


def _track(folder: Path, settings: Config, out: Path, force: bool) -> Sequence[RunRecord]:
    from wheelsight import pipeline
    from wheelsight.cli._console import print_note
    from wheelsight.cli._progress import FrameProgress
    from wheelsight.recordings import open_recording

    source = open_recording(folder, settings.recording.open_options())
    at_first = "" if _kernels_are_compiled() else "compiling kernels, once after installation"
    statuses: dict[str, str] = {}

    def show(answers: Mapping[str, FrameRecord]) -> None:
        statuses.update({odometry: str(answer.status) for odometry, answer in answers.items()})
        several = len(settings.odometry) > 1
        progress.advance(", ".join(f"{of} {now}" if several else now for of, now in statuses.items()))

    try:
        with FrameProgress("tracking", *_expected(source, settings, at_first)) as progress:
            return pipeline.run_each(source, settings, out, force=force, on_event=show)
    except KeyboardInterrupt as interruption:
        print_note(f"interrupted; what was found until then is in {out}")
        raise typer.Exit(INTERRUPTED) from interruption


def _expected(source: Recording, settings: Config, at_first: str) -> tuple[int, str, str]:
    """How many events will be answered, what to say until the first is, and what they are called."""
    if settings.odometry == ("wheels",):
        return source.wheel_count, at_first, "readings"
    if "wheels" not in settings.odometry:
        return source.frame_count, at_first, "frames"
    return source.wheel_count + source.frame_count, at_first, "events"


def _kernels_are_compiled() -> bool:
    """Whether odometry's compiled kernels are in numba's cache, beside their sources or where NUMBA_CACHE_DIR says."""
    from wheelsight import odometry

    folder = Path(os.environ.get("NUMBA_CACHE_DIR") or Path(odometry.__file__).parent)
    return any(folder.rglob("*kernels*.nbi"))
