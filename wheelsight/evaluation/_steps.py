"""Steps of one length along a growing quantity: time, or distance travelled."""

from __future__ import annotations

import numpy as np

from wheelsight.geometry import FloatArray, IntArray


def steps_along(along: FloatArray, delta: float) -> tuple[IntArray, IntArray]:
    """From each of values (N,) that never fall to the later one nearest to `delta` further on: indices (N-1,) twice.

    Of equally near ones it is the first. How near it is, the caller must judge.
    """
    start = np.arange(len(along) - 1)
    wanted = along[:-1] + delta
    after = np.searchsorted(along, wanted).clip(1, len(along) - 1)
    end = np.where(wanted - along[after - 1] <= along[after] - wanted, after - 1, after)
    end = np.searchsorted(along, along[end])
    return start, np.maximum(end, start + 1)
