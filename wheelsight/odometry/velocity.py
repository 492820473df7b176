"""How fast a camera moved between two poses."""

from __future__ import annotations

import numpy as np

from wheelsight.geometry import FloatArray, se3, so3

# Over a longer gap the mean velocity says little about the velocity at the frame.
LONGEST_STEP_S = 0.35


def twist_between(T_map_before: FloatArray, T_map_now: FloatArray, seconds: float) -> FloatArray:
    """Mean velocity (6,) of a camera between two poses, (v, ω) a second in its own frame."""
    T_before_now = se3.invert(T_map_before) @ T_map_now
    return np.concatenate([T_before_now[:3, 3], so3.log(T_before_now[:3, :3])]) / seconds
