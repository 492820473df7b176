"""`wheelsight places`: label a recording by areas, train a model on it, test the model, let it name areas."""

from __future__ import annotations

import typer

from wheelsight.cli import _places as work
from wheelsight.cli import _places_options as options
from wheelsight.cli._help import Command, Group
from wheelsight.cli._options import RecordingPath, Topics

app = typer.Typer(cls=Group, no_args_is_help=True, rich_markup_mode="rich")


@app.callback()
def _about() -> None:
    """Which area of a building a frame was taken in: label, train, test, predict."""


@app.command(cls=Command)
def label(
    recording: RecordingPath,
    out: options.Page,
    labels: options.Labels = None,
    areas: options.Areas = None,
    trajectory: options.Trajectory = None,
    every: options.Every = None,
    topic: Topics = None,
    force: options.Force = False,
) -> None:
    """Make a page of thumbnails along time, on which a person says which area each part of a drive is in.

    Open PAGE in a browser: select thumbnails, press the area's key, save. The CSV it saves is what --labels takes.
    What labels, or areas and trajectory, already tell is filled in, to be checked.

    [bold]Examples[/bold]

    wheelsight places label my_drive --out labels.html

    wheelsight places label my_drive --labels my_drive-labels.csv --every 0.5 --out check.html
    """
    work.label(recording, out, labels, areas, trajectory, every, topic, force)


@app.command(cls=Command)
def train(
    recordings: options.Recordings,
    out: options.ModelToWrite,
    labels: options.LabelFiles = None,
    areas: options.Areas = None,
    description: options.Description = options.Kind.LAYOUT,
    trees: options.Trees = 64,
    depth: options.Depth = 16,
    seed: options.Seed = 0,
    topic: Topics = None,
    force: options.Force = False,
) -> None:
    """Grow a random forest that names the area of a frame, and calibrate how sure it says to be.

    Areas come from --labels; else from polygons, and the ground truth. Several drives of one building, in other
    light and on other days, make a better model than one: each is then held out once to calibrate.

    [bold]Examples[/bold]

    wheelsight places train monday tuesday --out floor.places

    wheelsight places train my_drive --labels my_drive-labels.csv --description histograms --trees 6 --out six.places
    """
    forest = {"trees": trees, "max_depth": depth, "seed": seed}
    work.train(recordings, out, labels or [], areas, description, forest, topic, force)


@app.command("test", cls=Command)
def try_model(
    model: options.Model,
    recording: RecordingPath,
    labels: options.Labels = None,
    areas: options.Areas = None,
    trajectory: options.Trajectory = None,
    out: options.PageIfWanted = None,
    topic: Topics = None,
    as_json: options.AsJson = False,
    force: options.Force = False,
) -> None:
    """Try a model on a drive that it was not trained on: what it takes for what, and whether it knows how sure it is.

    [bold]Examples[/bold]

    wheelsight places test floor.places wednesday --out wednesday.html

    wheelsight places test floor.places my_drive --labels my_drive-labels.csv --json
    """
    work.try_model(model, recording, labels, areas, trajectory, out, topic, as_json, force)


@app.command(cls=Command)
def predict(
    model: options.Model,
    recording: RecordingPath,
    out: options.Table,
    topic: Topics = None,
    force: options.Force = False,
) -> None:
    """Name the area of each frame: stamp_s, area (empty: unknown), and the probability of every area.

    [bold]Examples[/bold]

    wheelsight places predict floor.places thursday --out predictions.csv

    wheelsight places label thursday --labels predictions.csv --out check.html
    """
    work.predict(model, recording, out, topic, force)
