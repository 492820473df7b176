"""FloorViews: how far below the camera its frames show the floor."""

from __future__ import annotations

from heapq import nlargest

import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.events import RgbdFrame
from wheelsight.geometry import FloatArray
from wheelsight.odometry.extrinsics import FloorSettings, height_below
from wheelsight.settings import BaseCheckSettings


class FloorViews:
    """Looks for the floor in some rows of each frame.

    The floor is the lowest that lies level. A robot that begins before a table or a bed sees that first, and the floor
    when it has turned: so the lowest views count.

    Args:
        calibration: with the camera.
        T_base_camera: (4, 4), rigid.
        settings: how many of the lowest views, and of each how many rows.
        of_floor: how the floor is told in one view.
    """

    def __init__(
        self,
        calibration: Calibration,
        T_base_camera: FloatArray,
        settings: BaseCheckSettings,
        of_floor: FloorSettings,
    ) -> None:
        camera = calibration.cameras[1]
        step = max(1, camera.height // settings.floor_rows)
        self._grid = np.s_[step // 2 :: step, step // 2 :: step]
        self._rays = camera.rays()[self._grid].reshape(-1, 3)
        self._up, self._height_m = T_base_camera[2, :3], float(T_base_camera[2, 3])
        self._most_views, self._of_floor = settings.floor_views, of_floor
        self._ratios: list[float] = []

    @property
    def ratio(self) -> float | None:
        """The height over the floor that is seen, over that of the mount; None where none was seen yet."""
        return float(np.median(self._ratios)) if self._ratios else None

    def look(self, frame: RgbdFrame) -> None:
        """Take a frame."""
        if not self._height_m > 0:
            return
        depth_m = frame.depth_m[self._grid].ravel().astype(float)
        found_m = height_below(self._rays, depth_m, self._up, self._height_m, self._of_floor)
        if found_m is not None:
            self._ratios = nlargest(self._most_views, [*self._ratios, found_m / self._height_m])
