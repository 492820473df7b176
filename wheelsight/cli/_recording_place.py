"""Where `wheelsight record` writes: a folder, or a bag."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from wheelsight.errors import ConfigError

if TYPE_CHECKING:
    from wheelsight.calibration import Calibration
    from wheelsight.recordings.rosbag.live import LiveBag
    from wheelsight.settings import RecorderSettings


@dataclass(frozen=True, slots=True)
class BagPlace:
    """A bag that is to be written."""

    path: Path

    def check(self, *, has_infrared: bool, force: bool, resume: bool) -> None:
        """Raises ConfigError, OutputError before a device is touched, for what a bag cannot be or hold."""
        from wheelsight.cli._outputs import check_out
        from wheelsight.recordings.rosbag.writing import check_growing_name, check_library

        if resume:
            raise ConfigError("a bag cannot be resumed", fix="choose another name: a folder is read as one bag")
        if has_infrared:
            raise ConfigError("--infrared is not kept in bags", fix="record into a folder, --out")
        check_growing_name(self.path)
        check_library()
        check_out(self.path, force)

    def settings(self, of_recorder: RecorderSettings) -> RecorderSettings:
        """Frames wait no longer than readers of bags do."""
        wait_s = min(of_recorder.longest_wait_s, of_recorder.bag_wait_s)
        return of_recorder.model_copy(update={"longest_wait_s": wait_s})

    def writer(self, calibration: Calibration | None, color: str, settings: RecorderSettings) -> LiveBag:
        """What writes it. Raises CalibrationError, OutputError."""
        from wheelsight.recordings.rosbag.live import LiveBag

        return LiveBag(self.path, calibration, color, settings.bag_flush_s)  # type: ignore[arg-type]


def place_of(out: Path | None, bag: Path | None) -> Path | BagPlace:
    """Where to, by --out and --bag. Raises ConfigError unless one of them is given."""
    if out is not None and bag is not None:
        raise ConfigError("--out and --bag are two recordings", fix="one of them; `wheelsight export` makes the other")
    if bag is not None:
        return BagPlace(bag)
    if out is None:
        raise ConfigError("--out or --bag is needed", fix="--out DIR, or --bag FILE.mcap")
    return out
