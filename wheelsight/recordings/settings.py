"""RecordingSettings: what a user says about a recording, as `Config` holds it."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator, PlainSerializer

from wheelsight.recordings.protocol import OpenOptions
from wheelsight.recordings.rosbag.settings import BagSettings
from wheelsight.settings import ASKED, CHOSEN, Settings, setting


def _listed(files: Any) -> Any:
    """One file, or none, as a list of them."""
    return (() if files is None else files) if not isinstance(files, str) else (files,)


def _unlisted(files: tuple[str, ...]) -> str | list[str] | None:
    return list(files) if len(files) > 1 else next(iter(files), None)


class RecordingSettings(Settings):
    """What a user says about a recording that its files do not."""

    camera: str | None = setting(None, "name of a shipped calibration, or a calibration.yaml", ASKED)
    max_gap_s: float = setting(
        0.02, "largest distance in time between colour and depth of one frame", CHOSEN, ge=0, le=3600
    )
    depth_factor: float | None = setting(None, "depth units a metre, if not the usual", ASKED, gt=0, le=1e6)
    calibration: Annotated[tuple[str, ...], BeforeValidator(_listed), PlainSerializer(_unlisted)] = setting(
        (), "a calibration.yaml, or several, laid over the recording's: what a later one tells wins", ASKED
    )
    rate_hz: float | None = setting(
        None,
        "how many a second the images' stamps count, if they are numbers of frames or no seconds",
        ASKED,
        gt=0,
        le=1e9,
    )

    topics: Annotated[tuple[str, ...], BeforeValidator(_listed), PlainSerializer(_unlisted)] = setting(
        (), "which topics of a bag are what, such as color=/camera/color/image_raw", ASKED
    )
    bag: BagSettings = setting(BagSettings(), "how bags are read", ASKED)

    def open_options(self) -> OpenOptions:
        """The same, as `open_recording` takes it."""
        of_images = (self.camera, self.max_gap_s, self.depth_factor, self.calibration, self.rate_hz)
        return OpenOptions(*of_images, self.topics, self.bag)
