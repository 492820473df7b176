"""The options of `wheelsight batch`."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Annotated

import typer

from wheelsight.cli._options import OUTPUT
from wheelsight.errors import ConfigError

_RUNS, _BASELINE = "What is run", "Against a baseline"

Recordings = Annotated[
    list[str],
    typer.Argument(
        metavar="RECORDING...",
        help="Recordings, folders that hold some, or patterns such as 'data/2026-*'.",
        show_default=False,
    ),
]
Out = Annotated[
    Path,
    typer.Option(
        metavar="DIR",
        help="Folder for the table and what is done; made if need be.",
        show_default=False,
        rich_help_panel=OUTPUT,
    ),
]
Configs = Annotated[
    list[Path] | None,
    typer.Option(
        "--config",
        metavar="FILE",
        help="Settings in YAML. May be given again.",
        show_default="the defaults alone",
        rich_help_panel=_RUNS,
    ),
]
Seeds = Annotated[
    int,
    typer.Option(
        min=1, metavar="N", help="Runs of each; where nothing is random, one is made, not N.", rich_help_panel=_RUNS
    ),
]
Jobs = Annotated[
    int | None,
    typer.Option(
        "--jobs", min=1, metavar="N", help="Processes at once.", show_default="one a core", rich_help_panel=_RUNS
    ),
]
Scheduler = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS",
        help="Run on the workers of a Dask scheduler, such as tcp://192.168.1.5:8786.",
        show_default="on this computer",
        rich_help_panel=_RUNS,
    ),
]
Baseline = Annotated[
    Path | None,
    typer.Option(
        metavar="CSV",
        help="table.csv of an earlier batch; what is worse is named.",
        show_default="none",
        rich_help_panel=_BASELINE,
    ),
]
Tolerance = Annotated[
    str,
    typer.Option(
        metavar="SHARE",
        help="By how much errors may grow, and frames with a pose get fewer.",
        rich_help_panel=_BASELINE,
    ),
]
CostTolerance = Annotated[
    str | None,
    typer.Option(
        metavar="SHARE",
        help="By how much time and memory may grow; only where the baseline is of the same computer.",
        show_default="not judged",
        rich_help_panel=_BASELINE,
    ),
]


def share(text: str, option: str) -> float:
    """Of "10%" or "0.1". Raises ConfigError."""
    try:
        value = float(text.removesuffix("%").strip()) / (100 if text.endswith("%") else 1)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value >= 0):
        raise ConfigError(f"{option} is {text}, not a share from 0 up", fix="such as 10% or 0.1")
    return value


def cores() -> int:
    """How many this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
