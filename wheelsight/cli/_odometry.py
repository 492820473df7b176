"""The odometry of a run that names none."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from wheelsight.config import Config
    from wheelsight.sources import EventSource

# Settings that any odometry has go with these two; which ones it is to be is decided once the recording is known.
ANY = "wheels,dense"


def names_odometry(config: Path | None) -> bool:
    """Whether a file of settings, if any, names one. Raises ConfigError."""
    from wheelsight.config import is_named

    return is_named("odometry", config)


def chosen_odometry(source: EventSource, settings: Config) -> tuple[str, str]:
    """What suits the source, as `--odometry` takes it, and the line that tells of it. Raises ConfigError."""
    from wheelsight.pipeline import default_odometry

    choice = default_odometry(source, settings)
    return ",".join(choice.odometry), choice.told
