"""The options of `wheelsight run`, in the order of its help."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from wheelsight.cli._options import (
    OUTPUT,
    SETTINGS,
    STARTS_IN_KNOWN_MAP,
    CalibrationFile,
    DepthFactor,
    MaxGap,
    Profile,
    RateHz,
    Rerun,
    Topics,
)
from wheelsight.cli._run_live_options import (
    Baud,
    Live,
    LiveCamera,
    LiveRecording,
    RealTime,
    Record,
    Seconds,
    Wheels,
    WheelsFrom,
)
from wheelsight.cli._run_map_options import Extend, Loops, Map, MapFrom, Start
from wheelsight.cli._run_odometry_options import (
    Areas,
    Fusion,
    Gyro,
    Integration,
    Model,
    Odometry,
    OdometryTerm,
    Rectify,
    Reference,
    Seed,
    Weights,
)

Out = Annotated[
    Path,
    typer.Option(
        metavar="DIR", help="Folder for the results; made if need be.", show_default=False, rich_help_panel=OUTPUT
    ),
]
SettingsFile = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="Settings in YAML; options given here win over it.",
        show_default=False,
        rich_help_panel=SETTINGS,
    ),
]
Force = Annotated[bool, typer.Option("--force", help="Overwrite results in DIR.", rich_help_panel=OUTPUT)]


@dataclass(frozen=True, slots=True)
class RunOptions:
    """What a user typed; None where an option was left out."""

    out: Out
    recording: LiveRecording = None
    camera: LiveCamera = None
    calibration: CalibrationFile = None
    depth_factor: DepthFactor = None
    max_gap: MaxGap = None
    rate_hz: RateHz = None
    topic: Topics = None
    force: Force = False
    rerun: Rerun = None
    odometry: Odometry = None
    fusion: Fusion = None
    reference: Reference = None
    integration: Integration = None
    gyro: Gyro = None
    seed: Seed = None
    map_: Map = None
    loops: Loops = None
    map_from: MapFrom = None
    extend: Extend = False
    start: Start = None
    config: SettingsFile = None
    profile: Profile = None
    places: Model = None
    rectify: Rectify = None
    areas: Areas = None
    odometry_term: OdometryTerm = None
    weights: Weights = None
    realtime: RealTime = False
    wheels_from: WheelsFrom = None
    baud: Baud = None
    live: Live = False
    wheels: Wheels = None
    seconds: Seconds = None
    record: Record = None

    def settings(self) -> dict[str, object]:
        """Options that are settings of `Config`, by their names, as `settings_from` takes them."""
        return {
            "--profile": self.profile,
            "--odometry": self.odometry,
            "--fusion": self.fusion,
            "--map": self.map_,
            "--loops": self.loops,
            "--map-from": None if self.map_from is None else str(self.map_from),
            "--extend": self.extend or None,
            # Of a live run it names a device.
            "--camera": None if self.live else self.camera,
            "--calibration": self.calibration,
            "--depth-factor": self.depth_factor,
            "--max-gap": self.max_gap,
            "--rate-hz": self.rate_hz,
            "--topic": self.topic,
            "--reference": self.reference,
            "--seed": self.seed,
            "--integration": self.integration,
            "--gyro": self.gyro,
            "--places": self.places,
            "--areas": self.areas,
            "--rectify": self.rectify,
            "--start" if self.map_from is None else STARTS_IN_KNOWN_MAP: self.start,
            "--odometry-term": self.odometry_term,
            "--weights": self.weights,
        }
