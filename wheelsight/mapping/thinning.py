"""Which frames are worth fusing: those whose view has moved, and some of those that stand still."""

from __future__ import annotations

import numpy as np

from wheelsight.geometry import FloatArray, se3
from wheelsight.mapping.settings import SurfelSettings


class Thinning:
    """Remembers the last frame that was fused, and counts those left out since.

    A frame from the same place shows the same pixels with the same errors of the sensor: it costs as much as one from
    elsewhere, and teaches less.
    """

    def __init__(self, settings: SurfelSettings) -> None:
        self._settings = settings
        self._T_map_last: FloatArray | None = None
        self._last_s, self._left_out = -np.inf, 0

    def count(self, T_map_camera: FloatArray, stamp_s: float) -> int:
        """As how many frames one at a pose (4, 4) is to be fused, with those left out before; 0 to leave it out too."""
        if self._T_map_last is not None and stamp_s - self._last_s < self._settings.fused_after_s:
            shift_m = se3.view_shift_m(se3.invert(self._T_map_last) @ T_map_camera)
            if shift_m < self._settings.fused_way_m:
                self._left_out += 1
                return 0
        frames, self._left_out = self._left_out + 1, 0
        self._T_map_last, self._last_s = T_map_camera, stamp_s
        return frames
