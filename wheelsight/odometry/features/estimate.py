"""FeatureEstimate: what feature odometry answers at a frame, with the pixels that it matched."""

from __future__ import annotations

from dataclasses import dataclass, field

from wheelsight.estimates import CameraEstimate
from wheelsight.geometry import BoolArray, FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class MatchedPixels:
    """Which pixels of a frame were matched with which of its reference.

    Attributes:
        reference_stamp_s: of the reference frame, seconds.
        px, reference_px: (N, 2) in the two colour images.
        is_inlier: (N,) which pairs agree with the motion found.
    """

    reference_stamp_s: float
    px: FloatArray
    reference_px: FloatArray
    is_inlier: BoolArray


@dataclass(frozen=True, slots=True, eq=False)
class FeatureEstimate(CameraEstimate):
    """A camera's estimate, with the pixels by which the frame was found.

    Attributes:
        matched: the pixels matched with those of an earlier frame, or None where there are none.
    """

    matched: MatchedPixels | None = field(default=None, kw_only=True)
