"""`wheelsight places`: labels a recording by areas, trains a model, tests it, and names areas with it."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from wheelsight.app.cli.console import CliCommand, Group
from wheelsight.app.cli.options import RecordingPath, Topics
from wheelsight.app.cli.places_tasks import label_images, predict_places, train_model, try_model_on

# Options


class DescriberKind(StrEnum):
    """The descriptor of a frame."""

    HISTOGRAMS = "histograms"
    LAYOUT = "layout"


Recordings = Annotated[
    list[Path], typer.Argument(metavar="RECORDING...", help="Folders of recordings.", show_default=False)
]
Model = Annotated[Path, typer.Argument(metavar="MODEL", help="What places train wrote.", show_default=False)]
LabelFiles = Annotated[
    list[Path] | None,
    typer.Option(
        "--labels",
        metavar="FILE",
        help="CSV of labels, from_s,to_s,area or stamp_s,area; one for each recording, in their order.",
        show_default="by areas and trajectory",
    ),
]
Labels = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE", help="CSV of labels, from_s,to_s,area or stamp_s,area.", show_default="by areas and trajectory"
    ),
]
Areas = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="areas.yaml with polygons.", show_default="that in the recording's folder"),
]
Trajectory = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="Where the robot went, TUM text.", show_default="the recording's ground truth"),
]
Description = Annotated[
    DescriberKind, typer.Option(help="How a frame is described: the paper's histograms, or layout, with geometry.")
]
Trees = Annotated[int, typer.Option(metavar="T", min=1, max=1000, help="How many trees; the paper tries 1 to 6.")]
Depth = Annotated[int, typer.Option(metavar="D", min=1, max=64, help="Splits from root to leaf, at most.")]
Seed = Annotated[
    int, typer.Option(min=0, max=2**32 - 1, help="Of everything random; the same seed grows the same forest.")
]
Force = Annotated[bool, typer.Option("--force", help="Overwrite what is there.")]

Page = Annotated[Path, typer.Option(metavar="PAGE", help="HTML page to write.", show_default=False)]
PageIfWanted = Annotated[
    Path | None, typer.Option(metavar="PAGE", help="HTML page with figures to write.", show_default="none")
]
ModelToWrite = Annotated[
    Path, typer.Option(metavar="MODEL", help="Model to write, such as floor.places.", show_default=False)
]
Table = Annotated[Path, typer.Option(metavar="FILE", help="CSV to write.", show_default=False)]
Every = Annotated[
    float | None,
    typer.Option(metavar="SECONDS", min=0.01, help="Time between thumbnails.", show_default="1, for up to 600"),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")]


# Commands


places_app = typer.Typer(cls=Group, no_args_is_help=True, rich_markup_mode="rich")


@places_app.callback()
def _about() -> None:
    """Which area of a building a frame was taken in: label, train, test, predict."""


@places_app.command(cls=CliCommand)
def label(
    recording: RecordingPath,
    out: Page,
    labels: Labels = None,
    areas: Areas = None,
    trajectory: Trajectory = None,
    every: Every = None,
    topic: Topics = None,
    force: Force = False,
) -> None:
    """Make a page of thumbnails along time, on which a person says which area each part of a drive is in.

    Open PAGE in a browser: select thumbnails, press the area's key, save. The CSV it saves is what --labels takes.
    Known labels, from labels or from areas and trajectory, are filled in, to be checked.

    [bold]Examples[/bold]

    wheelsight places label my_drive --out labels.html

    wheelsight places label my_drive --labels my_drive-labels.csv --every 0.5 --out check.html
    """
    label_images(recording, out, labels, areas, trajectory, every, topic, force)


@places_app.command(cls=CliCommand)
def train(
    recordings: Recordings,
    out: ModelToWrite,
    labels: LabelFiles = None,
    areas: Areas = None,
    description: Description = DescriberKind.LAYOUT,
    trees: Trees = 64,
    depth: Depth = 16,
    seed: Seed = 0,
    topic: Topics = None,
    force: Force = False,
) -> None:
    """Grow a random forest that names the area of a frame, and calibrate how sure it says to be.

    Areas come from --labels; else from polygons, and the ground truth. Several drives of one building, in other
    light and on other days, make a better model than one: each is then held out once to calibrate.

    [bold]Examples[/bold]

    wheelsight places train monday tuesday --out floor.places

    wheelsight places train my_drive --labels my_drive-labels.csv --description histograms --trees 6 --out six.places
    """
    forest = {"trees": trees, "max_depth": depth, "seed": seed}
    train_model(recordings, out, labels or [], areas, description, forest, topic, force)


@places_app.command("test", cls=CliCommand)
def try_model(
    model: Model,
    recording: RecordingPath,
    labels: Labels = None,
    areas: Areas = None,
    trajectory: Trajectory = None,
    out: PageIfWanted = None,
    topic: Topics = None,
    as_json: AsJson = False,
    force: Force = False,
) -> None:
    """Try a model on a drive that it was not trained on: what it takes for what, and whether it knows how sure it is.

    [bold]Examples[/bold]

    wheelsight places test floor.places wednesday --out wednesday.html

    wheelsight places test floor.places my_drive --labels my_drive-labels.csv --json
    """
    try_model_on(model, recording, labels, areas, trajectory, out, topic, as_json, force)


@places_app.command(cls=CliCommand)
def predict(
    model: Model,
    recording: RecordingPath,
    out: Table,
    topic: Topics = None,
    force: Force = False,
) -> None:
    """Name the area of each frame: stamp_s, area (empty: unknown), and the probability of every area.

    [bold]Examples[/bold]

    wheelsight places predict floor.places thursday --out predictions.csv

    wheelsight places label thursday --labels predictions.csv --out check.html
    """
    predict_places(model, recording, out, topic, force)
