"""What answers where a robot that is led is: in step with a simulator, or in a process of its own beside a robot."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

from wheelsight.calibration import Calibration
from wheelsight.config import Config
from wheelsight.errors import ConfigError
from wheelsight.localizer import Localizer, LocalizerApart, LocalizerBeside, LocalizerInStep
from wheelsight.localizer.in_step import Make
from wheelsight.navigation.localization import Localization
from wheelsight.pipeline.known_maps import open_known
from wheelsight.slam.sessions import find_map


@contextmanager
def localization_of(
    make: Make, *arguments: Any, in_step: bool, tells_keyframes: bool = False
) -> Iterator[Localization]:
    """Ready to answer; what was made is closed at the end.

    Args:
        make: of what answers; called with the arguments and `waits`. See `LocalizerApart`.
        arguments: of it.
        in_step: whether it answers before the robot goes on.
        tells_keyframes: see `LocalizerApart`.

    Raises what `make` raises, and DeviceError where the process that localizes dies.
    """
    if in_step:
        with make(*arguments, waits=True) as answering:
            yield LocalizerInStep(answering)
        return
    apart = LocalizerApart(make, *arguments, tells_keyframes=tells_keyframes)
    with closing(LocalizerBeside(apart)) as beside:
        yield beside


def known_map_path(config: Config) -> Path:
    """The folder of the map that settings name. Raises ConfigError where they name none, and MapError for no map."""
    if config.known_map.path is None:
        raise ConfigError("there is no map to drive in", fix="--map DIR, of a run with --map surfels")
    return find_map(config.known_map.path)


@contextmanager
def known_localizer(calibration: Calibration, config: Config, *, waits: bool = False) -> Iterator[Localizer]:
    """Of the map of before that settings name. Raises as `open_known`, and ConfigError where they name none."""
    known_map_path(config)
    opened = open_known(calibration, config)
    assert opened is not None
    known, folder = opened
    with closing(folder), closing(Localizer(calibration, config, known=known, waits=waits)) as localizer:
        yield localizer
