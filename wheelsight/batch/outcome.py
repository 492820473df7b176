"""What became of a job: its figures, or why there are none."""

from __future__ import annotations

import traceback
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from wheelsight.errors import WheelsightError


@dataclass(frozen=True, slots=True)
class Outcome:
    """Of one job.

    Attributes:
        job: its identity.
        problem: why it broke, one line, or None.
        is_killed: whether its process ended without a word, rather than the recording being at fault.
        figures: by their names in `table.FIGURES`; None where one cannot be had, as an ATE without ground truth.
        metrics: what metrics.json of `wheelsight run` holds.
        elapsed_s: how long it took.
    """

    job: str
    problem: str | None = None
    is_killed: bool = False
    figures: Mapping[str, float | None] = field(default_factory=dict)
    metrics: Mapping[str, Any] = field(default_factory=dict)
    elapsed_s: float = 0.0


def problem_of(error: BaseException) -> str:
    """One line for a table: what a user did wrong, what the system refused, or where a bug showed."""
    if isinstance(error, WheelsightError):
        return str(error)
    if isinstance(error, MemoryError):
        return "memory ran out"
    if isinstance(error, OSError):
        where = "" if error.filename is None else f"{error.filename}: "
        return f"{where}{error.strerror or error}"
    last = traceback.extract_tb(error.__traceback__)[-1:]
    where = "".join(f" ({Path(frame.filename).name}:{frame.lineno})" for frame in last)
    return f"a bug: {type(error).__name__}: {' '.join(str(error).split())}{where}"
