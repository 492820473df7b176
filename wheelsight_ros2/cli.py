"""`wheelsight foxglove-layout`: the panels with which Foxglove shows and leads a robot."""

from __future__ import annotations

import json

import typer


def foxglove_layout() -> None:
    """Print a layout for Foxglove, which its menu imports: map, plan and surfels in 3D, image, plots, stick and STOP.

    Open the address that --foxglove of run, drive or serve prints as a Foxglove WebSocket.

    [bold]Examples[/bold]

    wheelsight foxglove-layout > layout.json
    """
    from wheelsight_export.bag import foxglove_layout as layout_of
    from wheelsight_export.topics import MAP, TOPICS

    live = [topic.name for topic in TOPICS.values() if topic.is_live]
    typer.echo(json.dumps(layout_of(live, MAP), indent=2))
