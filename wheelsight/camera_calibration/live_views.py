"""Views of a board from a live camera: taken by themselves where the board stands still and shows something new."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from wheelsight.camera_calibration.board import Board
from wheelsight.camera_calibration.coach import Advice, advise
from wheelsight.camera_calibration.detection import as_grey, find_corners
from wheelsight.camera_calibration.settings import CameraCalibrationSettings
from wheelsight.camera_calibration.views import Corners
from wheelsight.events import RgbdFrame
from wheelsight.files import make_output_folder
from wheelsight.geometry import FloatArray, PinholeCamera
from wheelsight.geometry.arrays import UInt16Array
from wheelsight.recordings.image_files import write_color, write_units

_NONE = np.iinfo(np.uint16).max


class ViewTaker:
    """Looks at frames, and says which are views.

    Args:
        board: that is shown.
        lens: of colour, as it is known before.
        settings: of detection and coach.
        seen: corners of views that are there already.

    Attributes:
        seen: corners of all views.
    """

    def __init__(
        self,
        board: Board,
        lens: PinholeCamera,
        settings: CameraCalibrationSettings | None = None,
        seen: Sequence[Corners] = (),
    ) -> None:
        self._board, self._lens, self._settings = board, lens, settings or CameraCalibrationSettings()
        self.seen = list(seen)
        self._still: tuple[float, Corners] | None = None
        self._more = 0

    @property
    def advice(self) -> Advice:
        """What to show next."""
        size = self._lens.width, self._lens.height
        return advise(self.seen, self._board, size, self._settings.coach, self._lens)

    def has_enough(self) -> bool:
        """Whether nothing is missing, and as many views came since `ask_more` as were asked for."""
        return len(self.seen) >= self._more and not self.advice.missing

    def ask_more(self) -> None:
        """The views did not determine it: some more, before it is tried again."""
        self._more = len(self.seen) + self._settings.coach.more_views

    def look(self, frame: RgbdFrame) -> str:
        """Why a frame is no view; "" where it is one, and counts from now on."""
        found = find_corners(as_grey(frame.color[..., ::-1]), self._board, self._settings.detection)
        if isinstance(found, str):
            self._still = None
            return found
        coach, width = self._settings.coach, self._lens.width
        if self._still is None or np.median(_apart_px(found, self._still[1])) > coach.still_share * width:
            self._still = frame.stamp_s, found
        if any(_apart_px(found, other).max() < coach.new_share * width for other in self.seen):
            return "such a view is there already: move the board"
        if frame.stamp_s - self._still[0] < coach.still_s:
            return "hold still"
        self.seen.append(found)
        return ""


def _apart_px(one: Corners, other: Corners) -> FloatArray:
    """By how far each corner that both show lies from itself; one that is infinite where they share none."""
    _, first, second = np.intersect1d(one.ids, other.ids, return_indices=True)
    if not len(first):
        return np.array([np.inf])
    return np.asarray(np.linalg.norm(one.px[first] - other.px[second], axis=1))


def save_view(folder: Path, frame: RgbdFrame, infrared: UInt16Array | None = None, depth_factor: float = 1000.0) -> str:
    """Write a view into a folder as `read_views` reads it, beside those that are there; its name.

    Raises OutputError.
    """
    make_output_folder(folder, force=True)
    number = 1
    while (folder / f"{number:03d}-color.png").exists():
        number += 1
    name = f"{number:03d}"
    units = np.rint(np.asarray(frame.depth_m, np.float64) * depth_factor)
    write_units(folder / f"{name}-depth.png", np.where(units < _NONE, units, 0).astype(np.uint16))
    if infrared is not None:
        write_units(folder / f"{name}-ir.png", infrared)
    write_color(folder / f"{name}-color.png", frame.color, "png")
    return name
