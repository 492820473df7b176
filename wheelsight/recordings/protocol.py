"""Recording: what every source of recorded events offers, whatever its format."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol, runtime_checkable

from wheelsight.calibration import Calibration
from wheelsight.events import Event
from wheelsight.trajectory import Trajectory


@dataclass(frozen=True, slots=True)
class AssociationReport:
    """How colour images found their depth images: counts, and the largest gap kept."""

    color_images: int
    depth_images: int
    pairs: int
    max_gap_s: float
    largest_gap_s: float = 0.0

    @property
    def dropped_color(self) -> int:
        """Colour images without a depth image near enough."""
        return self.color_images - self.pairs

    @property
    def dropped_depth(self) -> int:
        """Depth images without a colour image near enough."""
        return self.depth_images - self.pairs


@runtime_checkable
class Recording(Protocol):
    """A finished recording: calibration, events in order of time, and the true trajectory if it has one.

    Attributes:
        name: for titles and file names.
        path: the folder it was read from.
        format: the reader's name in the registry.
        body: the frame its trajectory describes, "base" where the calibration says T_base_camera, else "camera".
        calibration: of the sensors.
        frame_count: how many RGB-D frames `events()` will yield, skipped ones included.
        association: how colour and depth were paired.
        ground_truth: T_world_body of `body`'s frame named in it, or None.
        warnings: what a user should know before trusting results, one sentence each.
    """

    name: str
    path: Path
    format: str
    calibration: Calibration
    frame_count: int
    association: AssociationReport
    ground_truth: Trajectory | None
    warnings: tuple[str, ...]

    def events(self) -> Iterator[Event]:
        """The events in order of time, from the start at each call; images are decoded as they are asked for."""
        ...


@dataclass(frozen=True, slots=True)
class OpenOptions:
    """What a user may say about a recording that its files do not.

    Attributes:
        camera: name of a shipped calibration (see `camera_names()`), or a calibration.yaml; None to go by the files.
        max_gap_s: largest distance in time between a colour and a depth image of one frame.
        depth_factor: depth units a metre, where it differs from the format's own.
    """

    camera: str | None = None
    max_gap_s: float = 0.02
    depth_factor: float | None = None
    extra: dict[str, str] = field(default_factory=dict)
