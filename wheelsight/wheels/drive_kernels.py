"""Compiled response of a drive to a series of commands."""

from __future__ import annotations

import math

import numpy as np

from wheelsight.core.compiled import kernel
from wheelsight.core.geometry.arrays import FloatArray


@kernel
def responses(
    change_s: FloatArray, towards_m_s: FloatArray, stamps_s: FloatArray, start_m_s: float, rise_s: float, fall_s: float
) -> FloatArray:
    """Return speeds and ways (N, 2) at stamps (N,), for speeds (K,) that the wheels are led towards from times (K,) on.

    The first of them holds before its time, too. Both arrays of times grow. The lag is that of
    `drive_model.lagged`, integrated exactly; the way is 0 at the first stamp.
    """
    out = np.empty((len(stamps_s), 2))
    speed, way, now_s, k = start_m_s, 0.0, stamps_s[0], 0
    while k + 1 < len(change_s) and change_s[k + 1] <= now_s:
        k += 1
    for i in range(len(stamps_s)):
        while now_s < stamps_s[i]:
            end_s = stamps_s[i]
            if k + 1 < len(change_s) and change_s[k + 1] < end_s:
                end_s = max(change_s[k + 1], now_s)
            towards, left_s = towards_m_s[k], end_s - now_s
            if speed * towards < 0:
                to_zero_s = fall_s * math.log1p(-speed / towards)
                part_s = min(left_s, to_zero_s)
                decay = math.exp(-part_s / fall_s)
                way += towards * part_s + (speed - towards) * fall_s * (1.0 - decay)
                speed = towards + (speed - towards) * decay if left_s < to_zero_s else 0.0
                left_s -= part_s
            time_s = rise_s if abs(towards) > abs(speed) else fall_s
            decay = math.exp(-left_s / time_s)
            way += towards * left_s + (speed - towards) * time_s * (1.0 - decay)
            speed = towards + (speed - towards) * decay
            now_s = end_s
            if k + 1 < len(change_s) and change_s[k + 1] <= now_s:
                k += 1
        out[i, 0], out[i, 1] = speed, way
    return out
