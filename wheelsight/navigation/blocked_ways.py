"""BlockedWays: where plans turned out to be blocked a while ago, so that the next ones lead elsewhere where they can.

What blocks a way is seen from close by alone: things behind others, floor that no camera has looked at, a gap that is
too narrow by a cell. From farther off it looks free again, and the shortest way leads back.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from wheelsight.geometry import FloatArray
from wheelsight.navigation.costmap import Costmap
from wheelsight.navigation.navigator_settings import BlockedSettings

# So many times at one place count, not more: it may be the only way.
_MOST = 3


@dataclass(frozen=True, slots=True)
class BlockedWays:
    """Places, and when each was found.

    Attributes:
        settings: how dear ways are there, and for how long.
        free_visits: so many count for nothing: in a map of before it may have been somebody who stood there.
        found: (x, y, stamp) in the map, one for each visit, at its end.
    """

    settings: BlockedSettings
    free_visits: int = 0
    found: tuple[tuple[float, float, float], ...] = ()

    def with_place(self, xy: FloatArray, now_s: float) -> BlockedWays:
        """And a way was found to be blocked with the axle at (2,)."""
        kept = tuple(one for one in self.found if self._is_another_visit(one, xy, now_s))
        return replace(self, found=(*kept, (float(xy[0]), float(xy[1]), now_s)))

    def on(self, costmap: Costmap, now_s: float) -> Costmap:
        """The same costmap, on which ways cost more there."""
        times = np.zeros(costmap.state.shape, np.float32)
        reach = int(np.ceil(self.settings.radius_m / costmap.resolution_m))
        for x, y, stamp_s in self.found:
            if now_s - stamp_s >= self.settings.seconds:
                continue
            row, column = costmap.cells_at((x, y)).tolist()
            low = np.clip([row - reach, column - reach], 0, times.shape)
            high = np.clip([row + reach + 1, column + reach + 1], 0, times.shape)
            rows, columns = (np.arange(a, b) for a, b in zip(low.tolist(), high.tolist(), strict=True))
            is_near = np.hypot(*np.meshgrid(rows - row, columns - column, indexing="ij")) <= reach
            times[low[0] : high[0], low[1] : high[1]] += is_near
        if times.max(initial=0) <= self.free_visits:
            return costmap
        return replace(
            costmap, dearness=1 + np.float32(self.settings.cost) * np.clip(times - self.free_visits, 0, _MOST)
        )

    def _is_another_visit(self, one: tuple[float, float, float], xy: FloatArray, now_s: float) -> bool:
        x, y, stamp_s = one
        age_s = now_s - stamp_s
        is_here = np.hypot(x - xy[0], y - xy[1]) <= self.settings.radius_m
        return age_s < self.settings.seconds and not (is_here and age_s < self.settings.visit_s)
