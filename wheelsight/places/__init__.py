"""Places: recognition of keyframes, and classification of the area of a building."""

from wheelsight.places.describers import (
    Describer,
    FrameSize,
    HistogramDescriber,
    HistogramSettings,
    LayoutDescriber,
    LayoutSettings,
    describer_from,
)
from wheelsight.places.model import (
    Forest,
    ForestSettings,
    HeldOutFigures,
    PlaceMatch,
    PlaceModel,
    ProbabilityScale,
    Unknown,
)

__all__ = [
    "Describer",
    "Forest",
    "ForestSettings",
    "FrameSize",
    "HeldOutFigures",
    "HistogramDescriber",
    "HistogramSettings",
    "LayoutDescriber",
    "LayoutSettings",
    "PlaceMatch",
    "PlaceModel",
    "ProbabilityScale",
    "Unknown",
    "describer_from",
]
