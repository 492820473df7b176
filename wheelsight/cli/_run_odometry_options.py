"""Options of `wheelsight run`: how motion is estimated, and rectified by areas."""

from __future__ import annotations

from typing import Annotated

import typer

_ODOMETRY, _AREAS = "Odometry", "Areas that rectify wheels"

Odometry = Annotated[
    str | None,
    typer.Option(
        metavar="NAME[,NAME]",
        help="How motion is estimated: features, dense, wheels, or several; wheels and a camera are joined too.",
        show_default="all sensors that the recording has, joined",
        rich_help_panel=_ODOMETRY,
    ),
]
Fusion = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="How wheels and camera are joined: default, ligocki (eq. 2), or none.",
        show_default="default, where both are named",
        rich_help_panel=_ODOMETRY,
    ),
]
Reference = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="What a frame is aligned with: previous or keyframes.",
        show_default="keyframes",
        rich_help_panel=_ODOMETRY,
    ),
]
Integration = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="How wheels are integrated: arc, midpoint or euler.",
        show_default="arc",
        rich_help_panel=_ODOMETRY,
    ),
]
Gyro = Annotated[
    bool | None,
    typer.Option(
        "--gyro/--no-gyro", help="Join a gyroscope with the wheels.", show_default="--gyro", rich_help_panel=_ODOMETRY
    ),
]
Seed = Annotated[
    int | None, typer.Option(help="Seed of all random choices.", show_default="0", rich_help_panel=_ODOMETRY)
]
Model = Annotated[
    str | None,
    typer.Option(
        "--places",
        metavar="MODEL",
        help="Rectify wheels, joined or alone, by the areas that frames show.",
        show_default=False,
        rich_help_panel=_AREAS,
    ),
]
Rectify = Annotated[
    str | None,
    typer.Option(
        metavar="WAY",
        help="probabilistic: a filter with covariance; paper: eq. 5.",
        show_default="probabilistic",
        rich_help_panel=_AREAS,
    ),
]
Areas = Annotated[
    str | None,
    typer.Option(
        metavar="FILE",
        help="areas.yaml of the model.",
        show_default="that in the recording's folder",
        rich_help_panel=_AREAS,
    ),
]
OdometryTerm = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="Odometry in eq. 5: increment or absolute.",
        show_default="increment",
        rich_help_panel=_AREAS,
    ),
]
Weights = Annotated[
    str | None,
    typer.Option(
        metavar="A,B,G", help="alpha, beta, gamma of eq. 5.", show_default="0,0.9,0.1", rich_help_panel=_AREAS
    ),
]
