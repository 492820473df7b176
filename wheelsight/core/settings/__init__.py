"""Settings of parts that stand below `Config`: each with its unit, its bounds, and why it is what it is.

What an odometry, a map or a filter goes by stands beside it; here is what a localizer and a run in real time go by,
and by what places are recognised.
"""

from wheelsight.core.settings.base import ASKED, CHOSEN, ON_SIMULATOR, Settings, bounds, conflict, setting
from wheelsight.core.settings.parts import (
    LiveCameraSettings,
    LivePageSettings,
    LocalizerSettings,
    RealTimeSettings,
    RecognitionSettings,
    RecorderSettings,
    ViewerSettings,
)

__all__ = [
    "ASKED",
    "CHOSEN",
    "ON_SIMULATOR",
    "LiveCameraSettings",
    "LivePageSettings",
    "LocalizerSettings",
    "RealTimeSettings",
    "RecognitionSettings",
    "RecorderSettings",
    "Settings",
    "ViewerSettings",
    "bounds",
    "conflict",
    "setting",
]
