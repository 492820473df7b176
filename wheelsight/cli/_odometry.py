"""The odometry of a run that names none."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from wheelsight.config import Config
    from wheelsight.recordings import Recording

# Settings that any odometry has go with these two; which ones it is to be is decided once the recording is known.
ANY = "wheels,dense"


def names_odometry(config: Path | None) -> bool:
    """Whether a file of settings, if any, names one. Raises ConfigError."""
    from wheelsight.config import is_named

    return is_named("odometry", config)


def chosen_odometry(recording: Recording, settings: Config) -> tuple[str, str]:
    """What suits the recording, as `--odometry` takes it; and what is then not used of it, and why, or nothing."""
    from wheelsight.pipeline import default_odometry

    choice = default_odometry(recording, settings)
    return ",".join(choice.odometry), choice.unused
